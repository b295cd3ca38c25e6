"""Gaits at values of a measure: the field `at` of a study, and the arguments `at`,
`vary` and `between` of Python.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.pipeline.study import slopes
from gaitsweep.pipeline.study.fields import AT, value_of
from gaitsweep.pipeline.study.location import Location
from gaitsweep.tasks.contract.registry import VARIABLES, nameable


def read(
    table: Mapping[str, Any], axes: object, top: Location
) -> tuple[dict[str, Any], object]:
    """What gaits are sought at, and the axes with that of the measure.

    Parameters
    ----------
    table : mapping
        Of the study. Its `at` has a measure with its values, unless these are an axis,
        and the fields of `AT`.
    axes : object
        The table `axes`.
    top : Location

    Returns
    -------
    at : dict
        `measure`, `vary`, and `between` where it is given; empty without `at`.
    axes : object

    Raises
    ------
    StudyError
        If `at` is invalid, or names a measure where an axis is one.
    """
    if "at" not in table:
        return {}, axes

    value, place = table["at"], top.at("at")
    if not isinstance(value, Mapping):
        raise place.wrong("must be a table", value)

    place.check_names(value, (*AT, *nameable()), "measure")
    if not isinstance(axes, dict | None):
        raise top.at("axes").wrong("must be a table", axes)

    given = axes or {}
    measure, is_axis = _measure(value, given, place)
    asked = {"measure": measure, **fields(value, place)}
    if is_axis:
        return asked, given

    values = value[measure]
    if not isinstance(values, list | dict):
        values = [place.at(measure).number(values)]
    return asked, {**given, measure: values}


def _measure(
    value: Mapping[str, Any], axes: Mapping[str, Any], place: Location
) -> tuple[str, bool]:
    """The one measure that is named, and whether it is an axis."""
    named = [name for name in value if name not in AT]
    of_axes = [name for name in axes if name in VARIABLES]
    measures = [*named, *of_axes]
    if len(measures) != 1:
        names = named + [f"axes.{name}" for name in of_axes]
        bound = "must name one measure, here or among the axes"
        raise place.wrong(bound, ", ".join(names) or "none")

    return measures[0], bool(of_axes)


def check_steps(steps: int, asked: Mapping[str, Any], place: Location) -> None:
    """Check that gaits of some steps can be sought as is asked: over slopes those of
    several are followed where these lead down.

    Raises
    ------
    StudyError
        At a place, if they cannot.
    """
    if steps == 1 or asked["vary"] != "slope":
        return
    low, _ = asked.get("between", (1.0, 1.0))
    if low <= 0:
        raise place.wrong("must be 1 where `between` has slopes of 0 or below", steps)


def check_is_asked(vary: str, between: Any) -> None:
    """Check that nothing is varied where no measure is asked for.

    Raises
    ------
    StudyError
        If something is.
    """
    needs = "needs `at`, a measure with its value"
    if vary != "slope":
        raise Location("", "vary").wrong(needs, vary)
    if between is not None:
        raise Location("", "between").wrong(needs, between)


def varied(vary: str, between: Any) -> dict[str, Any]:
    """What is varied, and its range unless it is None, as arguments give them, checked."""
    given: dict[str, Any] = {"vary": vary}
    if between is not None:
        given["between"] = between
        if np.iterable(between):
            given["between"] = list(between)
    return fields(given, Location("", ""))


def fields(value: Mapping[str, Any], place: Location) -> dict[str, Any]:
    """What is varied, and its range where it is given, checked."""
    vary = value_of(AT, "vary", value, place)
    between = value_of(AT, "between", value, place)
    if between is None:
        return {"vary": vary}
    if vary == "slope":
        for end in between:
            slopes.check(end, place.at("between"), may_be_level=True)

    return {"vary": vary, "between": between}
