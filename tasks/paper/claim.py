"""A claim of the paper and the result of checking it; the list of all claims."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

#: The verdicts on a claim. It is reproduced where it holds and the computed number rounds to the printed one;
#: proved where it is reproduced and the number that decides it has a certificate; and consistent within rounding where
#: the computed number does not round to the printed one, but the rounding of the printed parameters allows that.
PROVED = "proved"
REPRODUCED, CONSISTENT, APPROXIMATE = "reproduced", "consistent within rounding", "approximate"
NOT_REPRODUCED, NOT_CHECKABLE = "not reproduced", "not checkable"
VERDICTS = (PROVED, REPRODUCED, CONSISTENT, APPROXIMATE, NOT_REPRODUCED, NOT_CHECKABLE)


@dataclass(frozen=True)
class ClaimResult:
    """The computed counterpart of a claim.

    Attributes
    ----------
    computed : str
        The result in words.
    verdict : str
        One of `VERDICTS`.
    value : float
        The claim's own number; NaN where it has none.
    low, high : float
        Interval of `value` that the rounding of the printed parameters allows; NaN where they are exact.
    printed, half_unit : float
        The number as printed, and half a unit of its last digit (zero if it is exact); NaN where none is printed.
    """

    computed: str
    verdict: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    printed: float = math.nan
    half_unit: float = math.nan

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"`{self.verdict}` is no verdict")


@dataclass(frozen=True)
class Claim:
    """A claim: its name in the ledger, what `claims.toml` says of it, and the function that checks it.

    `printed` is a paraphrase of the paper and `quotation` its words, at the place `source`; `figure` shows it, as
    "study/figure".
    """

    id: str
    printed: str
    quotation: str
    source: str
    figure: str
    find: Callable[[], ClaimResult]


#: What the paper says, by claim.
TEXTS = tomllib.loads(Path(__file__).with_name("claims.toml").read_text(encoding="utf-8"))
#: Every claim by its id, in order of definition.
CLAIMS: dict[str, Claim] = {}


def claim(id: str) -> Callable[[Callable[[], ClaimResult]], Callable[[], ClaimResult]]:
    """Enter a function as the computation behind a claim.

    Raises
    ------
    ValueError
        If the claim is entered twice.
    """

    def enter(find: Callable[[], ClaimResult]) -> Callable[[], ClaimResult]:
        if id in CLAIMS:
            raise ValueError(f"claim {id} is entered twice")
        CLAIMS[id] = Claim(id, find=find, **TEXTS[id])
        return find

    return enter


def verdict(holds: bool, nearly: bool = False) -> str:
    """Give the verdict `reproduced` where a claim holds, `approximate` where it nearly does."""
    return REPRODUCED if holds else APPROXIMATE if nearly else NOT_REPRODUCED


def compare(printed: float, half_unit: float, value: float, low: float = math.nan, high: float = math.nan) -> str:
    """Give the verdict on a printed number.

    Parameters
    ----------
    printed, half_unit : float
        The number, and half a unit of its last digit.
    value, low, high : float
        The computed number, and the interval that the rounding of the printed parameters allows it.

    Returns
    -------
    str
        `reproduced` if the computed number rounds to the printed one, `consistent within rounding` if the interval
        holds the printed one, else `not reproduced`.
    """
    if abs(value - printed) <= half_unit:
        return REPRODUCED
    return CONSISTENT if low <= printed <= high else NOT_REPRODUCED


def rounded(printed: float, half_unit: float, computed: float) -> ClaimResult:
    """Compare a number of an exact walker with the printed one.

    Parameters
    ----------
    printed, half_unit : float
        The number, and half a unit of its last digit.
    computed : float

    Returns
    -------
    ClaimResult
    """
    return ClaimResult(
        f"{computed:.10g}; {printed - half_unit:g}-{printed + half_unit:g} rounds to the printed {printed:g}",
        compare(printed, half_unit, computed),
        computed,
        printed=printed,
        half_unit=half_unit,
    )
