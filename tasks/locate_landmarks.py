"""The tasks `landmarks`, `corners`, `crises`: slopes that the paper prints, as computed, and what rounding allows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.paper.kneed_chaos import corner_crises, crisis
from gaitsweep.tasks.paper.lines import line, set_tables, use_atlases
from gaitsweep.tasks.paper.published import HALF_UNITS
from gaitsweep.tasks.paper.rounding_intervals import LANDMARKS, interval
from gaitsweep.tasks.registry import LOSS_WINDOWS

Arrays = dict[str, np.ndarray]
_COLUMNS = ("landmark", "walker", "point", "printed", "half_unit", "slope", "slope_low", "slope_high", "stance_angle")
#: Slope [rad] up to which the paper finds persistent walking, and half a unit of its last digit (sections 3 and 7).
_CRISES = {"D": (0.019, 5e-4), "C": (0.103, 5e-4), "C-printed": (0.103, 5e-4)}
#: Slope [rad] of the first period doubling of walkers without rounded parameters, and half a unit (section 3).
_FLIPS = {"D": (0.015, 5e-4)}


def landmarks(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Locate the folds, flips and ends that the paper prints or numbers, of the catalogue's walkers in a study.

    Parameters
    ----------
    params : mapping
        `lines` of the study.
    inputs : list
        One dict a line, with its atlas.

    Returns
    -------
    dict
        Table `landmarks`: landmark; walker; point, its number in figure 6 or ""; printed [rad], NaN where the paper
        has no number, and half a unit of its last digit; slope, stance_angle, and slope_low and slope_high, between
        which the rounding of the printed parameters allows the slope [rad].
    """
    rows = []
    for walker in _walkers(params, inputs):
        for name, mark in LANDMARKS.items():
            if mark.walker == walker:
                bounds = interval(name)
                place = (bounds.value, bounds.low, bounds.high, bounds.angle)
                rows.append((name, walker, mark.point, mark.printed, mark.half_unit, *place))
        for end in line(walker).special_of("end_zero_step")[:1] if walker == "physical-straight" else ():
            place = (end["slope"], np.nan, np.nan, end["stance_angle"])
            rows.append(("point 4", walker, "4", np.nan, np.nan, *place))
        if walker in _FLIPS:
            flip = line(walker).special_of("flip")[0]
            place = (flip["slope"], flip["slope"], flip["slope"], flip["stance_angle"])
            rows.append((f"{walker} flip", walker, "", *_FLIPS[walker], *place))
    return _table("landmarks", rows)


def crises(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Bracket the slopes at which the catalogue's walkers in a study lose persistent walking.

    Parameters
    ----------
    params : mapping
        `lines` of the study.
    inputs : list
        One dict a line, with its atlas and the tables of its tasks `cascade` and `corners`.

    Returns
    -------
    dict
        Table `crises` with the columns of `landmarks`; stance_angle is NaN, and slope_low and slope_high are the
        bracket where the walker's parameters are exact by definition.
    """
    rows = []
    for walker in _walkers(params, inputs):
        if walker in _CRISES:
            low, high = crisis(walker, "1")
            bounds = (low, high)
            if walker in HALF_UNITS:
                (least, _), (_, most) = corner_crises(walker)
                bounds = (least, most)
            place = (0.5 * (low + high), *bounds, np.nan)
            rows.append((f"{walker} loss of walking", walker, "", *_CRISES[walker], *place))
    return _table("crises", rows)


def corners(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Bracket the loss of walking at the two corners of the rounding of a line's walker.

    Parameters
    ----------
    params : mapping
        `line`.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Table `corners`, of two rows: low and high [rad]; of none where the paper prints no loss of walking, or the
        walker's parameters are exact.
    """
    walker = params["line"]["walker"]
    (name, *_) = _walkers({"lines": [params["line"]]}, inputs) or [""]
    brackets = corner_crises(walker) if name in LOSS_WINDOWS and name in HALF_UNITS else ()
    return {f"corners/{side}": np.array([pair[k] for pair in brackets]) for k, side in enumerate(("low", "high"))}


def _walkers(params: Mapping[str, Any], inputs: list[Arrays]) -> list[str]:
    """Walkers of the catalogue among a study's lines, as they are there; their atlases are kept for the look-ups."""
    known = [
        (one["walker"], data)
        for one, data in zip(params["lines"], inputs, strict=True)
        if isinstance(one["walker"], str) and not one["set"]
    ]
    atlases = [(walker, {k: v for k, v in data.items() if "/" not in k}) for walker, data in known]
    use_atlases((walker, {}, atlas) for walker, atlas in atlases if atlas)
    set_tables((walker, {}, {k: v for k, v in data.items() if "/" in k}) for walker, data in known)
    return [walker for walker, _ in known]


def _table(group: str, rows: Iterable[tuple[Any, ...]]) -> Arrays:
    columns = zip(*rows, strict=True)
    return {f"{group}/{name}": np.array(column) for name, column in zip(_COLUMNS, columns, strict=False)}
