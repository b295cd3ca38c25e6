"""The ledger: what the paper claims, what is computed of it, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.paper import published_tables, tuned_walkers
from gaitsweep.tasks.paper.certificates import backed
from gaitsweep.tasks.paper.claim import CLAIMS, NOT_CHECKABLE, Claim, ClaimResult
from gaitsweep.tasks.paper.lines import Paper, paper_of
from gaitsweep.tasks.tables import Arrays, table

#: Tables that go with a claim.
_TABLES = {
    "P1": (published_tables.rounding,),
    "T1": (published_tables.figure9,),
    "Z6": (published_tables.figure10, published_tables.figure10_cells),
    "T7": (tuned_walkers.offsets,),
}


def claims(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Check claims of the paper.

    Parameters
    ----------
    params : mapping
        `ids`, names of claims; `lines` of the study; `tables`, whether the tables that go with claims are wanted too.
    inputs : list
        One dict a line, with its atlas and the tables of the study's own task; what a claim needs beyond them is
        computed in place.

    Returns
    -------
    dict
        Table `claims`: id, printed, quotation, source, computed, value, printed_value, printed_half_unit,
        interval, interval_low, interval_high, verdict, figure,
        command, shape (claims,); with claim P1 `rounding`, with T1 `figure9`, with Z6 `figure10` and
        `figure10_cells`, with T7 `offsets`.

    Raises
    ------
    ValueError
        If there is no such claim.
    """
    unknown = [name for name in params["ids"] if name not in CLAIMS]
    if unknown:
        raise ValueError(f"there is no claim {unknown[0]}; there are {', '.join(CLAIMS)}")
    paper = paper_of(params["lines"], inputs)
    wanted = sorted((CLAIMS[name] for name in params["ids"]), key=lambda c: (c.id[0], int(c.id[1:])))
    out = table("claims", [_row(claim, backed(claim.id, _check(claim, paper))) for claim in wanted])
    for claim in wanted if params.get("tables", True) else ():
        for make in _TABLES.get(claim.id, ()):
            out |= make(paper)
    return out


def check(params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Check claims at once, without a study.

    Parameters
    ----------
    params : mapping
        `ids`, names of claims; all of them if there are none.

    Returns
    -------
    list of dict
        The columns of table `claims` of each, NaN as None.

    Raises
    ------
    ValueError
        If there is no such claim.
    """
    found = claims({"lines": [], "ids": list(params["ids"]) or list(CLAIMS), "tables": False}, [])
    rows = zip(*(column.tolist() for column in found.values()), strict=True)
    names = [name.removeprefix("claims/") for name in found]
    return [{k: None if v != v else v for k, v in zip(names, row, strict=True)} for row in rows]


def _check(claim: Claim, paper: Paper) -> ClaimResult:
    """Result of a claim's function; a claim whose gaits are lost is not checkable, and says why."""
    try:
        with np.errstate(all="ignore"):
            return claim.find(paper)
    except (ValueError, ArithmeticError, LookupError, np.linalg.LinAlgError) as error:
        return ClaimResult(f"{type(error).__name__}: {error}", NOT_CHECKABLE)


def _row(claim: Claim, result: ClaimResult) -> dict[str, Any]:
    return {
        "id": claim.id,
        "printed": claim.printed,
        "quotation": claim.quotation,
        "source": claim.source,
        "computed": result.computed,
        "value": float(result.value),
        "printed_value": claim.number.number,
        "printed_half_unit": claim.number.half_unit,
        "interval": f"{result.low:.12g} to {result.high:.12g}" if result.low <= result.high else "",
        "interval_low": float(result.low),
        "interval_high": float(result.high),
        "verdict": result.verdict,
        "figure": claim.figure,
        "command": f"gaitsweep claims {claim.id}",
    }
