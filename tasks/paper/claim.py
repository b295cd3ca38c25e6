"""A claim of the paper and the result of checking it; the list of all claims."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

#: The verdicts on a claim; it is proved where it is reproduced and the number that decides it has a certificate.
PROVED = "proved"
REPRODUCED, APPROXIMATELY = "reproduced", "reproduced approximately"
NOT_REPRODUCED, NOT_CHECKABLE = "not reproduced", "not checkable"
VERDICTS = (PROVED, REPRODUCED, APPROXIMATELY, NOT_REPRODUCED, NOT_CHECKABLE)


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
        Bounds of `value` under the rounding of the printed parameters, or, where the walker is exact, under the
        rounding of the printed number.
    """

    computed: str
    verdict: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"`{self.verdict}` is no verdict")


@dataclass(frozen=True)
class Claim:
    """A claim: its name in the ledger, a paraphrase of the paper, the place there, and the function that checks it."""

    id: str
    printed: str
    source: str
    figure: str
    command: str
    find: Callable[[], ClaimResult]


#: Every claim by its id, in order of definition.
CLAIMS: dict[str, Claim] = {}


def claim(
    id: str, printed: str, source: str, figure: str, command: str
) -> Callable[[Callable[[], ClaimResult]], Callable[[], ClaimResult]]:
    """Enter a function as the computation behind a claim.

    Parameters
    ----------
    id, printed, source : str
        Its name, a paraphrase of what the paper says, and the place there.
    figure : str
        The figure that shows it, as "study/figure".
    command : str
        A command that reproduces its number, or the gaits it is read from.

    Raises
    ------
    ValueError
        If the claim is entered twice.
    """

    def enter(find: Callable[[], ClaimResult]) -> Callable[[], ClaimResult]:
        if id in CLAIMS:
            raise ValueError(f"claim {id} is entered twice")
        CLAIMS[id] = Claim(id, printed, source, figure, command, find)
        return find

    return enter


def verdict(holds: bool, nearly: bool = False) -> str:
    """Give the verdict `reproduced` where a claim holds, `reproduced approximately` where it nearly does."""
    return REPRODUCED if holds else APPROXIMATELY if nearly else NOT_REPRODUCED


def within(printed: float, low: float, high: float) -> str:
    """Give the verdict on a printed number by whether it lies in the interval that rounding allows."""
    return verdict(low <= printed <= high)


def rounded(printed: float, half_unit: float, computed: float) -> ClaimResult:
    """Compare a number of an exact walker with the printed one: the interval is all that rounds to the latter."""
    low, high = printed - half_unit, printed + half_unit
    return ClaimResult(
        f"{computed:.10g}; {low:g}-{high:g} rounds to the printed {printed:g}",
        within(computed, low, high),
        computed,
        low,
        high,
    )
