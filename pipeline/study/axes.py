"""The axes of a study: lists of values, ranges, and slopes, or values of what else
drives, that follow the gaits.
"""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.study import slopes
from gaitsweep.pipeline.study.fields import RANGE, axis_names, value_of
from gaitsweep.pipeline.study.files import other
from gaitsweep.pipeline.study.location import Location, clip
from gaitsweep.pipeline.study.model import Axis, Definition
from gaitsweep.tasks.contract.registry import DRIVES

_MAX_DIGITS = 15  # decimals of a linear axis


def without_toward(
    axes: object, path: Path, location: Location
) -> tuple[object, Definition | None]:
    """Axes without the walker toward which `detuning` leads, and that walker, if one is
    named.
    """
    if not isinstance(axes, dict):
        return axes, None

    detuning = axes.get("detuning")
    if not isinstance(detuning, dict) or "toward" not in detuning:
        return axes, None

    rest = {key: value for key, value in detuning.items() if key != "toward"}
    walker = other(detuning["toward"], path.parent, location)
    return {**axes, "detuning": rest}, walker


def read(
    value: object, location: Location, at: Mapping[str, Any] | None = None
) -> tuple[tuple[Axis, ...], dict[str, float]]:
    """Axes of a study, and the tolerances of those that are adaptive, by their names.

    Parameters
    ----------
    value : object
        The table of the axes.
    location : Location
    at : mapping, optional
        `measure`, of which an axis holds the values, and `vary`, which can be no axis.

    Raises
    ------
    StudyError
        If one is unknown or invalid, or the slope is missing.
    """
    if not isinstance(value, dict) or not value:
        raise location.error("A study needs axes, at least `slope`")

    _check_names(value, location, at or {})
    given = dict(value)
    tolerances = {}
    if not at or at["vary"] != "slope":
        if "slope" not in value:
            raise location.error("A study needs the axis `slope`")

        for name in ("slope", *DRIVES):
            axis = value.get(name)
            if isinstance(axis, dict) and "adaptive" in axis:
                tolerances[name], given[name] = _adaptive(axis, location.at(name))

    axes = [_axis(name, values, location) for name, values in given.items()]
    return tuple(axes), tolerances


def _check_names(
    value: Mapping[str, Any], location: Location, at: Mapping[str, Any]
) -> None:
    """Check that axes are known, and that what is varied is none."""
    if at and at["vary"] in value:
        vary = at["vary"]
        raise location.at(vary).error(
            f"`{vary}` is varied until gaits have the value of `at`, and can be no axis"
        )

    for key in ("units", "trailing_knee"):
        if key in value:
            raise location.error(
                f"`{key}` holds a text and is no axis: it stands in the table of a walker"
            )

    known = [*axis_names()]
    if at:
        known.append(at["measure"])
    for key in value:
        if key in known:
            continue
        why = ask("why_no_key", {"key": key})
        if why:
            raise location.error(f"`{clip(str(key))}` is no axis: {why}")

    location.check_names(value, known, "key")


def _axis(name: str, values: object, location: Location) -> Axis:
    """An axis, checked."""
    place = location.at(name)
    axis = Axis(name, _values(values, place))
    if name == "slope":
        _check_slopes(axis.values, place)
    return axis


def _check_slopes(values: np.ndarray, location: Location) -> None:
    wrong = values[~(slopes.is_slope(values) | slopes.is_level(values))]
    for slope in wrong.tolist():
        slopes.check(slope, location)


def _adaptive(axis: dict[str, Any], location: Location) -> tuple[float, dict[str, Any]]:
    """Tolerance of an adaptive axis, and its window as an axis of two values."""
    if "n" in axis:
        raise location.at("n").error(
            "`adaptive` chooses as many points as its tolerance needs: leave out either "
            f"`n` or `adaptive`; got n = {axis['n']!r} and adaptive = {axis['adaptive']!r}"
        )

    location.check_names(axis, ("from", "to", "adaptive"), "key")
    tolerance = value_of(RANGE, "adaptive", axis, location)
    window = {key: value for key, value in axis.items() if key != "adaptive"}
    return tolerance, {**window, "n": 2}


def _values(value: object, location: Location) -> np.ndarray:
    """Values of an axis, shape (n,)."""
    if isinstance(value, list):
        return _listed(value, location)
    if isinstance(value, dict):
        return _spaced(value, location)
    raise location.wrong("must be a list, or a table of from, to, n and spacing", value)


def _listed(value: list[Any], location: Location) -> np.ndarray:
    if not value:
        raise location.wrong("must hold at least one value", value)
    values = np.array([location.number(v) for v in value])
    step = np.diff(values)
    if not (np.all(step > 0) or np.all(step < 0)):
        raise location.wrong("must rise or fall throughout", value)
    return values


def _spaced(value: dict[str, Any], location: Location) -> np.ndarray:
    location.check_names(value, ("from", "to", "n", "spacing"), "key")
    for key in ("from", "to", "n"):
        if key not in value:
            raise location.error(f"`{key}` is missing")

    start = value_of(RANGE, "from", value, location)
    stop = value_of(RANGE, "to", value, location)
    n = value_of(RANGE, "n", value, location)
    spacing = value_of(RANGE, "spacing", value, location)

    if start >= stop:
        raise location.at("from").wrong(f"must be less than `to` = {stop!r}", start)
    if spacing == "log" and start <= 0:
        raise location.at("from").wrong("must be > 0 for log spacing", start)

    values = _linear(start, stop, n)
    if spacing == "log":
        values = np.geomspace(start, stop, n)
    if n > 1 and not np.all(np.diff(values) > 0):
        raise location.at("n").wrong(
            "is too large: neighbouring values would be equal", n
        )

    return values


def _linear(start: float, stop: float, n: int) -> np.ndarray:
    """Equal steps, shape (n,), written as decimals where they are short ones: 0.3 and
    not 3 times 0.1.
    """
    values = np.linspace(start, stop, n)
    first = Fraction(repr(start))
    step = (Fraction(repr(stop)) - first) / max(n - 1, 1)
    for digits in range(_MAX_DIGITS + 1):
        unit = 10**digits
        are_whole = (first * unit).denominator == (step * unit).denominator == 1
        if not are_whole:
            continue

        largest = max(abs(start), abs(stop)) * unit
        if largest < 2**53:
            # Whole numbers over a power of ten that are both exact: the quotient is the
            # double nearest the decimal.
            return np.rint(values * unit) / unit
        break

    return values
