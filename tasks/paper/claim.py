"""A claim of the paper and what was found of it; the one list all claims are in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

#: What can be said of a claim. It is proved where it is reproduced and the number that decides it has a certificate.
PROVED = "proved"
REPRODUCED, APPROXIMATELY = "reproduced", "reproduced approximately"
NOT_REPRODUCED, NOT_CHECKABLE = "not reproduced", "not checkable"
VERDICTS = (PROVED, REPRODUCED, APPROXIMATELY, NOT_REPRODUCED, NOT_CHECKABLE)


@dataclass(frozen=True)
class ClaimResult:
    """What was computed of a claim.

    `value` is the claim's own number where it has one; `low` and `high` bound it under the rounding of the printed
    parameters, or, where the walker is exact, under the rounding of the printed number.
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
    """A claim: its name in the ledger, the paper's words in short, where they stand, and what computes it."""

    id: str
    printed: str
    source: str
    figure: str
    command: str
    find: Callable[[], ClaimResult]


#: Every claim by its id, in the order they are written down.
CLAIMS: dict[str, Claim] = {}


def claim(
    id: str, printed: str, source: str, figure: str, command: str
) -> Callable[[Callable[[], ClaimResult]], Callable[[], ClaimResult]]:
    """Enter a function as the computation behind a claim.

    Parameters
    ----------
    id, printed, source : str
        Its name, a paraphrase of what the paper says, and where.
    figure : str
        The picture that shows it, as "study/figure".
    command : str
        A command that computes its number, or the gaits it is read from, again.
    """

    def enter(find: Callable[[], ClaimResult]) -> Callable[[], ClaimResult]:
        if id in CLAIMS:
            raise ValueError(f"claim {id} is entered twice")
        CLAIMS[id] = Claim(id, printed, source, figure, command, find)
        return find

    return enter


def verdict(holds: bool, nearly: bool = False) -> str:
    """`reproduced` where a claim holds, `reproduced approximately` where it nearly does."""
    return REPRODUCED if holds else APPROXIMATELY if nearly else NOT_REPRODUCED


def within(printed: float, low: float, high: float) -> str:
    """The verdict on a printed number: is it in the interval that rounding leaves around the computed one?"""
    return verdict(low <= printed <= high)


def rounded(printed: float, half_unit: float, computed: float) -> ClaimResult:
    """A finding of an exact walker: the interval is what rounds to the printed number."""
    low, high = printed - half_unit, printed + half_unit
    return ClaimResult(
        f"{computed:.10g}, where {low:g} to {high:g} is printed as {printed:g}",
        within(computed, low, high),
        computed,
        low,
        high,
    )
