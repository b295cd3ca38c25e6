"""Read a study: its walkers, axes and requested results.

A study is checked completely before anything runs: each field by `fields`, all together
by `rules`, its walkers at the corners of the grid. Every error names the key, its
value, the violated bound or the nearest known key, the file and the place in it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gaitsweep.pipeline.errors import WalkerFileError
from gaitsweep.pipeline.study import axes as axes_of_studies
from gaitsweep.pipeline.study import options, overlay, rules, target, want
from gaitsweep.pipeline.study.corners import check_walkers
from gaitsweep.pipeline.study.fields import (
    BESIDE,
    LIMITS,
    OVERLAY,
    STUDY,
    WANT,
    Field,
    value_of,
)
from gaitsweep.pipeline.study.files import changed, read_toml, walker
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.model import Axis, Definition, Limits, Study
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES


def read(path: str | Path, asked: float | None = None) -> Study:
    """Read and check a study file.

    Parameters
    ----------
    path : str or Path
    asked : float, optional
        Accuracy instead of the study's own.

    Raises
    ------
    StudyError
        If the file cannot be read or is invalid.
    """
    path = Path(path)
    text, table = read_toml(path, str(path))
    return parse(table, text, path, asked)


def parse(
    table: Mapping[str, Any], text: str, path: Path, asked: float | None = None
) -> Study:
    """Check the table of a study.

    Parameters
    ----------
    table : mapping
    text : str
        Source of the table, for the archive.
    path : Path
        Name of the study in errors; files it names are relative to its folder.
    asked : float, optional
        Accuracy instead of the table's own.

    Raises
    ------
    StudyError
        If anything in it is invalid.
    """
    top = Location(path.name)
    _check_is_study(table, top)
    kind = value_of(STUDY, "kind", table, top)
    accuracy = _accuracy(table, top, asked)
    grid = _grid(table, kind, path, top)

    walkers = _walkers(table.get("walker"), path, top.at("walker"))
    gaits = _gaits(table, top)
    results = _results(table, accuracy, grid, top)

    study = Study(
        name=value_of(STUDY, "name", table, top),
        text=text,
        kind=kind,
        path=path,
        options=grid.options,
        walker_axis=isinstance(table["walker"], list),
        names=_names(table["walker"], walkers),
        gaits=gaits,
        limits=_limits(table, top),
        walkers=tuple(changed(each, grid.toward, grid.tuned) for each in walkers),
        axes=grid.axes,
        accuracy=accuracy,
        **results,
    )
    _check(study, grid, top)
    study = _with_checks(study, table.get("want", {}), top, grid.toward_at)

    measured = _measurements(table, study, top.at("figures"))
    return replace(study, overlay=measured)


def _results(
    table: Mapping[str, Any], accuracy: float, grid: "_Grid", top: Location
) -> dict[str, Any]:
    """What a study wants, and the tolerances of keys that its figures show."""
    location, at = top.at("want"), grid.options.get("at")
    wants = _table(table.get("want", {}), WANT, location)
    place = top.at("figures")
    beside = _beside(table, place)

    return {
        **want.read(wants, accuracy, location, at),
        "tolerances": value_of(BESIDE, "tolerances", beside, place) or {},
    }


def _check(study: Study, grid: "_Grid", top: Location) -> None:
    """Check a study by the rules for its fields, and that axes which follow the gaits
    are those along which they are followed.
    """
    for name in grid.adaptive:
        if name != study.along:
            raise top.at("axes", name, "adaptive").error(
                f"`adaptive` is of the axis along which gaits are followed, `{study.along}`"
            )
    rules.check(study, top)


def _gaits(table: Mapping[str, Any], top: Location) -> tuple[str, ...]:
    """Labels of the gaits that are wanted, in their own order."""
    labels = value_of(STUDY, "gaits", table, top) or GAITS
    return tuple(label for label in GAITS if label in labels)


class _Grid(NamedTuple):
    """Axes and options of a study, and how these change its walkers.

    Attributes
    ----------
    axes : tuple of Axis
    options : dict
        Those that tasks take, the tolerance of adaptive slopes, and what gaits are
        sought `at` instead of slopes.
    toward : str or dict, optional
        The walker toward which `detuning` leads, if one is named.
    toward_at : Location
        Where it is named, or would be by the walker.
    tuned : sequence of str
        Keys that are changed so that the walkers are tuned.
    adaptive : sequence of str
        Axes whose values follow the gaits.
    """

    axes: tuple[Axis, ...]
    options: dict[str, Any]
    toward: Definition | None
    toward_at: Location
    tuned: Sequence[str]
    adaptive: Sequence[str]


def _grid(table: Mapping[str, Any], kind: str, path: Path, top: Location) -> _Grid:
    """Read the axes and the options of a study."""
    toward_at = top.at("axes", "detuning", "toward")
    without, toward = axes_of_studies.without_toward(table.get("axes"), path, toward_at)
    if toward is None:
        toward_at = top.at("walker", "toward")
    if "at" in table and kind != "grid":
        raise top.at("at").error(
            f"`at` is of the gaits of a grid; this study is a `{kind}`"
        )
    at, values = target.read(table, without, top)
    axes, tolerances = axes_of_studies.read(values, top.at("axes"), at)

    chosen = options.check(table.get("options", {}), kind, top.at("options"))
    tuned = chosen.pop("tuned", ())
    for tolerance in tolerances.values():
        chosen["adaptive"] = tolerance
    if at:
        chosen["at"] = at
    return _Grid(axes, chosen, toward, toward_at, tuned, tuple(tolerances))


def _check_is_study(table: Mapping[str, Any], top: Location) -> None:
    """Check that a table has the keys of a study, and a name."""
    if list(table) == ["walker"]:
        sentence = "This file holds a walker and no study; `gaitsweep solve --walker FILE.toml` solves its gaits"
        raise WalkerFileError(str(top.error(sentence)))
    _table(table, STUDY, top)
    if table.get("name") is None:
        raise top.error("A study needs a `name`")


def _table(
    value: object, fields: Mapping[str, Field], location: Location
) -> Mapping[str, Any]:
    """A table of a study, of which all keys are known."""
    if not isinstance(value, Mapping):
        raise location.wrong("must be a table", value)
    location.check_names(value, fields, "key")
    return value


def _accuracy(table: Mapping[str, Any], top: Location, asked: float | None) -> float:
    """Largest error bound that is wanted: the one asked for, or the study's own; 0 for
    none.
    """
    if asked is not None:
        return accuracy(asked, Location("", "accuracy"))
    return value_of(STUDY, "accuracy", table, top) or 0.0


def accuracy(value: object, location: Location) -> float:
    """Largest error bound wanted: 1 or 3 times a power of ten, not above the value.

    Raises
    ------
    StudyError
        If it is not a number from 1e-15 to 1e-2.
    """
    bound: float = STUDY["accuracy"].value.read(value, location)
    return bound


def _names(value: object, walkers: Sequence[Definition]) -> tuple[str, ...]:
    """Labels of the walkers of a study."""
    if isinstance(value, list):
        return tuple(value)
    return tuple(each if isinstance(each, str) else "walker" for each in walkers)


def _walkers(value: object, path: Path, location: Location) -> tuple[Definition, ...]:
    if isinstance(value, list):
        is_named = value and all(isinstance(name, str) for name in value)
        if not is_named or len(set(value)) < len(value):
            raise location.wrong("must be a list of different names", value)
        return tuple(walker(name, path.parent, location) for name in value)

    words = "a name, a file, a table, or a list of names"
    if value is None:
        raise location.error(f"A study needs a `walker`: {words}")
    if not isinstance(value, str | dict):
        raise location.wrong(f"must be {words}", value)

    return (walker(value, path.parent, location),)


def _with_checks(
    study: Study, wanted: Mapping[str, Any], top: Location, way: Location
) -> Study:
    """A study whose walkers are checked, without the variables of what none of them
    has; those that it names itself stay.
    """
    study = replace(study, checks=check_walkers(study, top, way))
    named = wanted.get("variables") or ()
    kept = [
        name
        for name in study.variables
        if name in named or not VARIABLES[name].is_left_out(study.features)
    ]
    rules.check_with_walkers(study, top)
    return replace(study, variables=tuple(kept))


def _limits(table: Mapping[str, Any], top: Location) -> Limits:
    location = top.at("limits")
    limits = _table(table.get("limits", {}), LIMITS, location)
    return Limits(**{name: value_of(LIMITS, name, limits, location) for name in LIMITS})


def _beside(table: Mapping[str, Any], location: Location) -> Mapping[str, Any]:
    """What a study's figures show beside the computed gaits."""
    value = table.get("figures", {})
    if isinstance(value, list):
        raise location.wrong(
            "must be a table; names of figures belong to `[want]`", value
        )
    return _table(value, BESIDE, location)


def _measurements(
    table: Mapping[str, Any], study: Study, location: Location
) -> dict[str, np.ndarray]:
    """The user's measurements, if the study names a file of them."""
    beside = _beside(table, location)
    if "overlay" not in beside:
        return {}

    entry = _table(beside["overlay"], OVERLAY, location.at("overlay"))
    place = location.at("overlay", "file")
    file = OVERLAY["file"].value.read(entry.get("file"), place)
    return overlay.read(file, study, place)
