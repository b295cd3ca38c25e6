"""A claim of the paper and the result of checking it; the list of all claims.

A claim's function finds numbers; the sentence that tells of them is in `claims.toml`,
and knows the constants of the function's module, and the usual grid of slopes, by their
names too.
"""

from __future__ import annotations

import math
import string
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, SupportsFloat

import numpy as np

from gaitsweep.tasks.ledger.lines import GRID, Paper

#: The verdicts on a claim. It is reproduced where it holds and the computed number
#: rounds to the printed one; proved where it is reproduced and the number that decides
#: it has a certificate; and consistent within rounding where the computed number does
#: not round to the printed one, but the rounding of the printed parameters allows that.
PROVED = "proved"
REPRODUCED, CONSISTENT, APPROXIMATE = (
    "reproduced",
    "consistent within rounding",
    "approximate",
)
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
        Interval of `value` that the rounding of the printed parameters allows; NaN
        where they are exact.
    """

    computed: str
    verdict: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"`{self.verdict}` is no verdict")


class Printed(NamedTuple):
    """A number as printed, and half a unit of its last digit (zero if it is exact); NaN
    where none is printed.
    """

    number: float = math.nan
    half_unit: float = math.nan

    def compare(
        self, value: float, low: float = math.nan, high: float = math.nan
    ) -> str:
        """Give the verdict on the number.

        Parameters
        ----------
        value, low, high : float
            The computed number, and the interval that the rounding of the printed
            parameters allows it.

        Returns
        -------
        str
            `reproduced` if the computed number rounds to the printed one, `consistent
            within rounding` if the interval holds the printed one, else `not
            reproduced`.
        """
        if abs(value - self.number) <= self.half_unit:
            return REPRODUCED
        return CONSISTENT if low <= self.number <= high else NOT_REPRODUCED


NOT_PRINTED = Printed()


@dataclass(frozen=True)
class Claim:
    """A claim: its name in the ledger, what `claims.toml` says of it, and the function
    that checks it.

    `printed` is a paraphrase of the paper and `quotation` its words, at the place
    `source`; `figure` shows it, as "study/figure".
    """

    id: str
    printed: str
    quotation: str
    source: str
    figure: str
    find: Callable[[Paper], ClaimResult]
    number: Printed = NOT_PRINTED


class _Sentences(string.Formatter):
    """Sentences with numbers: a list is formatted value by value, a mapping likewise,
    each value behind its name, with a colon where that holds a number itself.

    `plain` are numbers as they are written by hand: 1e-8.
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Format a value."""
        if isinstance(value, Mapping):
            return ", ".join(
                f"{_apart(str(name))} {self.format_field(one, format_spec)}"
                for name, one in value.items()
            )
        if isinstance(value, list | tuple | np.ndarray):
            return ", ".join(self.format_field(one, format_spec) for one in value)

        return (
            f"{value:g}".replace("e-0", "e-")
            if format_spec == "plain"
            else format(value, format_spec)
        )


def _apart(name: str) -> str:
    """A name that can be told from the number behind it."""
    return f"{name}:" if any(character.isdigit() for character in name) else name


class Found(NamedTuple):
    """What a claim's function finds: the result without its words, and the numbers of
    these by name.
    """

    result: ClaimResult
    numbers: Mapping[str, Any]


def found(
    verdict: str,
    value: SupportsFloat = math.nan,
    low: float = math.nan,
    high: float = math.nan,
    /,
    **numbers: Any,
) -> Found:
    """A claim's verdict, its own number with its interval, which its sentence knows
    too, and others that it names.
    """
    return Found(ClaimResult("", verdict, float(value), low, high), numbers)


#: What the paper says, by claim.
TEXTS = tomllib.loads(
    Path(__file__).with_name("claims.toml").read_text(encoding="utf-8")
)
#: What is said of the numbers found, by claim.
_SAID = {id: text.pop("computed") for id, text in TEXTS.items()}
#: Certificates that back a claim; the first one's interval of slopes must hold the
#: number its verdict rests on.
BACKED: dict[str, list[str]] = {
    id: text.pop("certificates") for id, text in TEXTS.items() if "certificates" in text
}
#: The numbers that the paper prints, by claim, and one that a claim has beside its own
#: by the name that it has there.
PRINTED = {id: Printed(*text.pop("number", ())) for id, text in TEXTS.items()}
PRINTED |= {
    name: Printed(*pair)
    for text in TEXTS.values()
    for name, pair in text.pop("numbers", {}).items()
}
#: Every claim by its id, in order of definition.
CLAIMS: dict[str, Claim] = {}


def claim(id: str) -> Callable[[Callable[[Paper], Found]], Callable[[Paper], Found]]:
    """Enter a function as the computation behind a claim.

    Raises
    ------
    ValueError
        If the claim is entered twice.
    """

    def enter(compute: Callable[[Paper], Found]) -> Callable[[Paper], Found]:
        if id in CLAIMS:
            raise ValueError(f"claim {id} is entered twice")

        def find(paper: Paper) -> ClaimResult:
            result, numbers = compute(paper)
            constants = {
                k: value
                for k, value in {"GRID": GRID, **compute.__globals__}.items()
                if k.isupper()
            }
            return replace(
                result,
                computed=_Sentences().vformat(
                    _SAID[id], (), constants | vars(result) | {**numbers}
                ),
            )

        CLAIMS[id] = Claim(id, find=find, number=PRINTED[id], **TEXTS[id])
        return compute

    return enter


def farthest(values: Iterable[float], wanted: float) -> float:
    """Return the largest distance of numbers from one."""
    return max(abs(value - wanted) for value in values)


def verdict(holds: bool | np.bool, nearly: bool | np.bool = False) -> str:
    """Give the verdict `reproduced` where a claim holds, `approximate` where it nearly
    does.
    """
    return REPRODUCED if holds else APPROXIMATE if nearly else NOT_REPRODUCED
