"""The ledger: what the paper claims, what is computed of it, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.paper import published_tables, tuned_walkers
from gaitsweep.tasks.paper.certificates import backed
from gaitsweep.tasks.paper.claim import CLAIMS, NOT_CHECKABLE, Claim, ClaimResult
from gaitsweep.tasks.paper.lines import set_tables, use_atlases
from gaitsweep.tasks.registry import VARIABLES

Arrays = dict[str, np.ndarray]
#: Tables that go with a claim.
_TABLES = {
    "P1": (published_tables.rounding,),
    "T1": (published_tables.figure9,),
    "Z6": (published_tables.figure10, published_tables.figure10_cells),
    "T7": (lambda: {f"offsets/{k}": v for k, v in tuned_walkers.offsets().items()},),
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
    # Claims are about walkers of the catalogue, which alone go by a name.
    named = [
        (line, data) for line, data in zip(params["lines"], inputs, strict=False) if isinstance(line["walker"], str)
    ]
    atlases = (
        {k: v for k, v in data.items() if k not in VARIABLES and k not in ("slope", "reasons") and "/" not in k}
        for _, data in named
    )
    use_atlases((line["walker"], line["set"], a) for (line, _), a in zip(named, atlases, strict=True) if a)
    set_tables((line["walker"], line["set"], {k: v for k, v in data.items() if "/" in k}) for line, data in named)
    wanted = sorted((CLAIMS[name] for name in params["ids"]), key=lambda c: (c.id[0], int(c.id[1:])))
    rows = [_row(claim, backed(claim.id, _check(claim))) for claim in wanted]
    out: Arrays = {f"claims/{k}": np.array([row[k] for row in rows]) for k in (rows[0] if rows else {})}
    for claim in wanted if params.get("tables", True) else ():
        for table in _TABLES.get(claim.id, ()):
            out |= table()
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
    set_tables([])
    table = claims({"lines": [], "ids": list(params["ids"]) or list(CLAIMS), "tables": False}, [])
    rows = zip(*(column.tolist() for column in table.values()), strict=True)
    names = [name.removeprefix("claims/") for name in table]
    return [{k: None if v != v else v for k, v in zip(names, row, strict=True)} for row in rows]


def _check(claim: Claim) -> ClaimResult:
    """Result of a claim's function; a claim whose gaits are lost is not checkable, and says why."""
    try:
        with np.errstate(all="ignore"):
            return claim.find()
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
        "printed_value": float(result.printed),
        "printed_half_unit": float(result.half_unit),
        "interval": f"{result.low:.12g} to {result.high:.12g}" if result.low <= result.high else "",
        "interval_low": float(result.low),
        "interval_high": float(result.high),
        "verdict": result.verdict,
        "figure": claim.figure,
        "command": f"gaitsweep claims {claim.id}",
    }
