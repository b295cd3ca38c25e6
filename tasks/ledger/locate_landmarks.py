"""The tasks `landmarks`, `corners`, `crises`: slopes that the paper prints, as
computed, and what rounding allows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.registry import LOSS_WINDOWS
from gaitsweep.tasks.contract.tables import Arrays, table
from gaitsweep.tasks.ledger.claim import NOT_PRINTED, PRINTED
from gaitsweep.tasks.ledger.kneed_chaos import corner_crises, crisis
from gaitsweep.tasks.ledger.lines import paper_of
from gaitsweep.tasks.ledger.rounding_intervals import HALF_UNITS, LANDMARKS, interval

_COLUMNS = (
    "landmark",
    "walker",
    "point",
    "printed",
    "half_unit",
    "slope",
    "slope_low",
    "slope_high",
    "stance_angle",
)
#: Slopes [rad] up to which the paper finds persistent walking (sections 3 and 7), and
#: of the first period doubling of walkers without rounded parameters (section 3).
_CRISES = {"D": PRINTED["D8"], "C": PRINTED["K2"], "C-printed": PRINTED["K2"]}
_FLIPS = {"D": PRINTED["D2"]}


def landmarks(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Locate the folds, flips and ends that the paper prints or numbers, of the
    catalogue's walkers in a study.

    Parameters
    ----------
    params : mapping
        `lines` of the study.
    inputs : list
        One dict a line, with its atlas.

    Returns
    -------
    dict
        Table `landmarks`: landmark; walker; point, its number in figure 6 or "";
        printed [rad], NaN where the paper has no number, and half a unit of its last
        digit; slope, stance_angle, and slope_low and slope_high, between which the
        rounding of the printed parameters allows the slope [rad].
    """
    paper = paper_of(params["lines"], inputs)
    rows: list[tuple[Any, ...]] = []
    for walker in _walkers(params):
        for name, mark in LANDMARKS.items():
            if mark.walker == walker:
                at = interval(paper, name)
                place = (at.value, at.low, at.high, at.angle)
                rows.append((name, walker, mark.point, *mark.printed, *place))

        special_of = paper.line(walker).special_of
        if walker == "physical-straight":
            for end in special_of("end_zero_step")[:1]:
                place = (end["slope"], np.nan, np.nan, end["stance_angle"])
                rows.append(("point 4", walker, "4", *NOT_PRINTED, *place))

        if walker in _FLIPS:
            flip = special_of("flip")[0]
            slope = flip["slope"]
            place = (slope, slope, slope, flip["stance_angle"])
            rows.append((f"{walker} flip", walker, "", *_FLIPS[walker], *place))

    return table("landmarks", rows, _COLUMNS) if rows else {}


def crises(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Bracket the slopes at which the catalogue's walkers in a study lose persistent
    walking.

    Parameters
    ----------
    params : mapping
        `lines` of the study.
    inputs : list
        One dict a line, with its atlas and the tables of its tasks `cascade` and
        `corners`.

    Returns
    -------
    dict
        Table `crises` with the columns of `landmarks`; stance_angle is NaN, and
        slope_low and slope_high are the bracket where the walker's parameters are exact
        by definition.
    """
    paper = paper_of(params["lines"], inputs)
    rows: list[tuple[Any, ...]] = []
    for walker in _walkers(params):
        if walker not in _CRISES:
            continue

        low, high = crisis(paper, walker, "1")
        middle = 0.5 * (low + high)
        if walker in HALF_UNITS:
            (low, _), (_, high) = corner_crises(paper, walker)
        name = f"{walker} loss of walking"
        place = (middle, low, high, np.nan)
        rows.append((name, walker, "", *_CRISES[walker], *place))

    return table("crises", rows, _COLUMNS) if rows else {}


def corners(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Bracket the loss of walking at the two corners of the rounding of a line's
    walker.

    Parameters
    ----------
    params : mapping
        `line`.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Table `corners`, of two rows: low and high [rad]; of none where the paper prints
        no loss of walking, or the walker's parameters are exact.
    """
    line = params["line"]
    (name, *_) = _walkers({"lines": [line]}) or [""]
    is_rounded = name in LOSS_WINDOWS and name in HALF_UNITS
    brackets = corner_crises(paper_of([line], inputs), name) if is_rounded else ()
    return table("corners", brackets, ("low", "high"))


def _walkers(params: Mapping[str, Any]) -> list[str]:
    """Walkers of the catalogue among a study's lines, as they are there."""
    return [
        line["walker"]
        for line in params["lines"]
        if isinstance(line["walker"], str) and not line["set"]
    ]
