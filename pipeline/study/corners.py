"""The walkers of a study at the corners of its grid: whether each is valid, and if not,
where the study is wrong.
"""

import itertools
from collections.abc import Iterator
from typing import Any

from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.model import Definition, Study, line_of
from gaitsweep.tasks.contract import registry

#: Most corners of a grid at which a walker is checked.
_MOST = 256


def check_walkers(
    study: Study, top: Location, way: Location
) -> tuple[dict[str, Any], ...]:
    """Check every walker at the corners of the grid of lines; returns the properties of
    each.

    `top` is the place of the study in errors, `way` that of the walker toward which
    detuning leads.

    Raises
    ------
    StudyError
        If a walker is invalid.
    """
    checks: dict[int, dict[str, Any]] = {}
    for number, candidate, values in _corners(study):
        keys = line_of(candidate, values)["set"]
        try:
            check = _checked(study, candidate, keys)
        except ValueError as error:
            place = way
            if getattr(error, "key", "") != "toward":
                place = _fault(study, candidate, keys, error, top)
            raise place.error(str(error)) from error

        if study.kind == "curve":
            _check_curve(study, candidate, values, top.at("options"))
        if study.kind == "optimum":
            _check_optimum(study, candidate, values, top.at("options"))
        for each in (*_checks_in_ranges(study, line_of(candidate, values)), check):
            checks[number] = _together(checks.get(number, each), each)

    return tuple(checks.values())


def _together(known: dict[str, Any], check: dict[str, Any]) -> dict[str, Any]:
    """What is known of a walker after another corner: what it has at any corner, it has
    on some lines; what changes only units at one corner must at all.
    """
    features = dict.fromkeys((*known["features"], *check["features"]))
    scaling = (key for key in check["scaling"] if key in known["scaling"])
    return {
        **check,
        "scaling": tuple(scaling),
        "features": tuple(features),
        "driven": known["driven"] or check["driven"],
        "massless_leg": known["massless_leg"] or check["massless_leg"],
        "keys": max(known["keys"], check["keys"]),
    }


def _checked(
    study: Study, walker: Definition, keys: dict[str, float]
) -> dict[str, Any]:
    """What `tasks` reports of a walker, with the keys that are varied where its gaits
    are sought at values of a measure.
    """
    line = {"walker": walker, "set": keys}
    name = "check_target" if study.at else "check_walker"
    check: dict[str, Any] = dispatch.call(
        name, {**line, **study.at, "values": study.values_along}
    )
    return check


def _corners(study: Study) -> Iterator[tuple[int, Definition, dict[str, float]]]:
    """Number of each walker, the walker, and values of the axes at the corners of the
    grid.
    """
    axes = [*study.line_axes]
    axes += [axis for axis in study.axes if axis.name == study.drive]
    ends = [sorted({float(axis.values[0]), float(axis.values[-1])}) for axis in axes]
    names = [axis.name for axis in axes]
    for number, walker in enumerate(study.walkers):
        for corner in itertools.islice(itertools.product(*ends), _MOST):
            yield number, walker, dict(zip(names, corner, strict=True))


def parameters(study: Study) -> Iterator[dict[str, Any]]:
    """The tables of its walkers at the corners of the grid."""
    for _, walker, values in _corners(study):
        yield _checked(study, walker, line_of(walker, values)["set"])["parameters"]


def notes(study: Study) -> list[str]:
    """What a user may not know of the walkers of a study: keys that move a tuned one
    off the static conditions.
    """
    lines = (line_of(walker, values) for _, walker, values in _corners(study))
    sentences = {
        str(line["walker"]): sentence
        for line in lines
        if (sentence := dispatch.ask("untuned", line))
    }
    return [*sentences.values(), *_not_led(study)]


def _not_led(study: Study) -> list[str]:
    """Say of walkers with a way to another that none goes it."""
    is_led = "detuning" in _keys_of_curves(study) if study.kind == "curve" else False
    led = is_led or any(axis.name == "detuning" for axis in study.line_axes)
    return [
        f"`toward` changes nothing without `detuning`: the walker is {check['way']['start']}."
        for walker, check in zip(study.walkers, study.checks, strict=True)
        if "toward" in walker and "detuning" not in walker and not led
    ]


def _keys_of_curves(study: Study) -> tuple[str, ...]:
    """Keys over which the curves of a study are followed."""
    options = registry.options("curve", study.options)
    return tuple(options["plane"] or [options["key"]])


def _fault(
    study: Study,
    walker: Definition,
    values: dict[str, float],
    error: ValueError,
    top: Location,
) -> Location:
    """Place of what is wrong with a walker at values of the axes: the walker, the one
    axis at fault, the axes, or what is varied.
    """
    key = getattr(error, "key", "walker")
    sought = top.at("at")
    if key in ("at", "between", "vary"):
        return sought
    if key == study.at.get("vary") and _can_be(walker, values):
        return sought.at("between") if "between" in study.at else sought
    if key in values:
        return top.at("axes", key)
    # A key that an axis owns is wrong where it is set, though the walker is valid
    # without the axis.
    if getattr(error, "bound", "").startswith("is set by") or not _can_be(walker, {}):
        return top.at("walker")

    at_fault = [
        name
        for name in values
        if _can_be(walker, {k: v for k, v in values.items() if k != name})
    ]
    return top.at("axes", *at_fault) if len(at_fault) == 1 else top.at("axes")


def _can_be(walker: Definition, values: dict[str, float]) -> bool:
    try:
        dispatch.call("check_walker", {"walker": walker, "set": values})
    except ValueError:
        return False
    return True


def _checks_in_ranges(study: Study, line: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """What `tasks` reports of a walker at each corner of the plane over which curves are
    followed, or of the ranges of the keys that are free.
    """
    ranges = study.options.get("plane") or study.options.get("free") or {}
    if not ranges:
        return
    for corner in itertools.product(*ranges.values()):
        own = dict(zip(ranges, corner, strict=True))
        yield dispatch.call("check_walker", {**line, "set": {**line["set"], **own}})


def _check_plane(
    plane: dict[str, list[float]],
    walker: Definition,
    values: dict[str, float],
    location: Location,
) -> None:
    """Check a walker at the corners of the plane over which curves are followed."""
    for corner in itertools.product(*plane.values()):
        own = dict(zip(plane, corner, strict=True))
        try:
            dispatch.call("check_walker", {"walker": walker, "set": {**values, **own}})
        except ValueError as error:
            where = ", ".join(f"{key} = {value!r}" for key, value in own.items())
            raise location.error(f"{where} leave no walker: {error}") from error


def _check_curve(
    study: Study, walker: Definition, values: dict[str, float], location: Location
) -> None:
    """Check a walker at both ends of the range over which curves are continued."""
    options = registry.options("curve", study.options)
    asked = {"walker": walker, "set": values, "options": dict(study.options)}
    try:
        dispatch.call("check_curve", asked)
    except ValueError as error:
        raise location.at("levels").error(str(error)) from error

    if options["plane"]:
        _check_plane(options["plane"], walker, values, location.at("plane"))
        return

    for end in ("from", "to"):
        try:
            dispatch.call(
                "check_walker",
                {"walker": walker, "set": {**values, options["key"]: options[end]}},
            )
        except ValueError as error:
            sentence = str(error)
            if getattr(error, "key", "") != options["key"]:
                value = f"`{options['key']}` = {options[end]!r}"
                sentence = f"{value} leaves no walker: {error}"
            place = location.at(end if end in study.options else "key")
            raise place.error(sentence) from error


def _check_optimum(
    study: Study, walker: Definition, values: dict[str, float], location: Location
) -> None:
    """Check a walker at the corners of the ranges of its free keys, and that its gaits
    have the measures that are named.
    """
    line = {"walker": walker, "set": values}
    try:
        dispatch.call("check_optimum", {**line, "options": dict(study.options)})
    except ValueError as error:
        key = getattr(error, "key", "")
        raise location.at(key if key in study.options else "free").error(
            str(error)
        ) from error
