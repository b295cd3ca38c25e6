"""The ledger: what the paper claims, what is computed of it, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.tables import Arrays, table
from gaitsweep.tasks.ledger import published_tables, tuned_walkers
from gaitsweep.tasks.ledger.certificates import backed
from gaitsweep.tasks.ledger.claim import CLAIMS, NOT_CHECKABLE, Claim, ClaimResult
from gaitsweep.tasks.ledger.lines import Paper, paper_of

#: Rows of the tables that go with a claim, by the tables' names.
_TABLES: dict[str, dict[str, Callable[[Paper], list[dict[str, Any]]]]] = {
    "P1": {"rounding": published_tables.rounding},
    "T1": {"figure9": published_tables.figure9},
    "Z6": {
        "figure10": published_tables.figure10,
        "figure10_cells": published_tables.figure10_cells,
    },
    "T7": {"offsets": tuned_walkers.offsets},
}


#: Least share of its end that an interval is wide to be told in digits.
_LEAST = 1e-12


def claims(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Check claims of the paper.

    Parameters
    ----------
    params : mapping
        `ids`, names of claims; `lines` of the study.
    inputs : list
        One dict a line, with its atlas and the tables of the study's own task; what a
        claim needs beyond them is computed in place.

    Returns
    -------
    dict
        Table `claims`: id, printed, quotation, source, computed, value, printed_value,
        printed_half_unit, interval, interval_low, interval_high, verdict, figure,
        command, shape (claims,); with claim P1 `rounding`, with T1 `figure9`, with Z6
        `figure10` and `figure10_cells`, with T7 `offsets`.

    Raises
    ------
    ValueError
        If there is no such claim.
    """
    paper = paper_of(params["lines"], inputs)
    rows = _rows(params["ids"], paper)
    out = table("claims", rows)
    for row in rows:
        for group, tabulate in _TABLES.get(row["id"], {}).items():
            out |= table(group, tabulate(paper))
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
    rows = _rows(params["ids"] or CLAIMS, paper_of([], []))
    return [
        {name: None if value != value else value for name, value in row.items()}
        for row in rows
    ]


def _rows(ids: Iterable[str], paper: Paper) -> list[dict[str, Any]]:
    """Rows of some claims, by family and number."""
    unknown = [name for name in ids if name not in CLAIMS]
    if unknown:
        raise ValueError(
            f"there is no claim {unknown[0]}; there are {', '.join(CLAIMS)}"
        )

    wanted = sorted(
        (CLAIMS[name] for name in ids), key=lambda c: (c.id[0], int(c.id[1:]))
    )
    return [_row(claim, backed(claim.id, _check(claim, paper))) for claim in wanted]


def _check(claim: Claim, paper: Paper) -> ClaimResult:
    """Result of a claim's function; a claim whose gaits are lost is not checkable, and
    says why.
    """
    try:
        with np.errstate(all="ignore"):
            return claim.find(paper)
    except (ValueError, ArithmeticError, LookupError, np.linalg.LinAlgError) as error:
        return ClaimResult(f"{type(error).__name__}: {error}", NOT_CHECKABLE)


def _interval(low: float, high: float) -> str:
    """An interval in words, with three digits of its width; empty if there is none."""
    if not low <= high:
        return ""
    size = max(abs(low), abs(high)) or 1.0
    digits = 3 + math.ceil(math.log10(size / max(high - low, _LEAST * size)))
    return f"{low:.{digits}g} to {high:.{digits}g}"


def _row(claim: Claim, result: ClaimResult) -> dict[str, Any]:
    return {
        "id": claim.id,
        "printed": claim.printed,
        "quotation": claim.quotation,
        "source": claim.source,
        "computed": result.computed,
        "value": result.value,
        "printed_value": float(claim.number.number),
        "printed_half_unit": float(claim.number.half_unit),
        "interval": _interval(result.low, result.high),
        "interval_low": result.low,
        "interval_high": result.high,
        "verdict": result.verdict,
        "figure": claim.figure,
        "command": f"gaitsweep claims {claim.id}",
    }
