"""Read a study: its walkers, axes and requested results.

A study is checked completely before anything runs. Every error names the key, its
value, the violated bound or the nearest known key, the file and the place in it.
"""

import importlib.util
import re
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep import extensions
from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.study import options, overlay, slopes
from gaitsweep.pipeline.study.corners import check_walkers
from gaitsweep.pipeline.study.files import changed, other, read_toml, walker
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.model import Axis, Definition, Limits, Study
from gaitsweep.pipeline.study.plot import Plot
from gaitsweep.tasks.contract import accuracy as accuracies
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import (
    CLAIMS,
    COSTLY,
    FIGURES,
    GAITS,
    NEEDED_KINDS,
    OPTIONS,
    READS,
    VARIABLES,
)

#: Keys of a study, of `want` and of `limits`, and axes that are not keys of a walker,
#: and what each is.
KEYS, WANTED, LIMITS, EXTRA_AXES = tomllib.loads(
    Path(__file__).with_name("keys.toml").read_text(encoding="utf-8")
).values()
_UNITS = {"": 1, "B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_UNITS |= {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30, "TiB": 1 << 40}
#: What a name and an amount of memory look like.
NAME, MEMORY = (
    "[A-Za-z0-9][A-Za-z0-9._-]{0,99}",
    rf"([0-9]+(?:\.[0-9]+)?) ?({'|'.join(_UNITS)})",
)
#: Tolerances of an adaptive slope axis, the longest time [s] and the memory [byte] that
#: limits may name.
TOLERANCES, MAX_SECONDS, MEMORIES = (1e-6, 0.1), 1e6, (1 << 26, 1 << 50)
_ONE_LINK = "gaitsweep.tasks.walkers.walker:ONE_LINK"
#: Largest axis and grid; anything above is taken for a mistake.
MAX_VALUES, MAX_POINTS = 10_000_000, 10**12
_MAX_DIGITS = 15  # decimals of a linear axis


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
    if list(table) == ["walker"]:
        raise top.error(
            "This file holds a walker and no study; `gaitsweep solve --walker FILE.toml` solves its gaits"
        )
    _table(table, KEYS, top)
    name = table.get("name")
    if name is None:
        raise top.error("A study needs a `name`")
    if not isinstance(name, str) or not re.fullmatch(NAME, name):
        allowed = "must be up to 100 letters, digits, dots, dashes or underscores, the first a letter or digit"
        raise top.at("name").wrong(allowed, name)
    kind = table.get("kind", "grid")
    if not isinstance(kind, str):
        raise top.at("kind").wrong(f"must be one of {', '.join(OPTIONS)}", kind)
    top.at("kind").check_names([kind], OPTIONS)
    gaits = _names(table.get("gaits", list(GAITS)), GAITS, top.at("gaits"))
    own = table.get("accuracy"), top.at("accuracy")
    value, place = own if asked is None else (asked, Location("", "accuracy"))
    asked = 0.0 if value is None else accuracy(value, place)
    if asked and kind != "grid":
        raise top.at("accuracy").error(
            f"`accuracy` is of the gaits of a grid; this study is a `{kind}`"
        )
    want: dict[str, Any] = dict(
        _want(table.get("want", {}), kind, asked, top.at("want"))
    )
    way = top.at("axes", "detuning", "toward")
    given, toward = _toward(table.get("axes"), path, way)
    axes, tolerance = _axes(given, top.at("axes"), kind)
    chosen = options.check(
        table.get("options", {}), kind, axis_keys(), top.at("options")
    )
    tuned = chosen.pop("tuned", ())
    walkers = _walkers(table.get("walker"), path, top.at("walker"))
    listed = isinstance(table.get("walker"), list)
    study = Study(
        name=name,
        text=text,
        kind=kind,
        path=path,
        options={**chosen, "adaptive": tolerance} if tolerance else chosen,
        walker_axis=listed,
        names=tuple(
            table["walker"]
            if listed
            else (w if isinstance(w, str) else "walker" for w in walkers)
        ),
        gaits=tuple(g for g in GAITS if g in gaits),
        limits=_limits(table, top),
        walkers=tuple(changed(each, toward, tuned) for each in walkers),
        axes=axes,
        accuracy=asked,
        **want,
    )
    if "transition" in study.fits and "short" not in gaits:
        raise top.at("gaits").error(
            "`transition` is a law of short gaits, which `gaits` leaves out"
        )
    # The slopes of designs are a window.
    count = study.lines if kind == "design" else study.points
    if count > MAX_POINTS:
        raise top.at("axes").error(
            f"The grid has {count:.3g} points, more than {MAX_POINTS:.0e}"
        )
    way = way if toward is not None else top.at("walker", "toward")
    study = _with_checks(study, table, top, way)
    if kind in registry.WINDOWED and study.slope.min() == study.slope.max():
        sentence = f"The slopes of a `{kind}` are a window: give at least two; got {study.slope[0]:g}"
        raise top.at("axes", "slope").error(sentence)
    if study.steps > 1:
        _check_of_one_step(study, top)
    measured = _measurements(table.get("figures", {}), study, top.at("figures"))
    return replace(study, overlay=measured) if measured else study


def _check_of_one_step(study: Study, top: Location) -> None:
    """Check that a study of gaits of several steps wants nothing known for one step
    only.
    """
    for key in WANTED:
        for name in getattr(study, key):
            if name in registry.OF_ONE_STEP or key == "claims":
                raise top.at("want", key).error(
                    f"`{name}` is of gaits of one step, and `steps` is {study.steps}"
                )
    if "adaptive" in study.options:
        sentence = f"`adaptive` is for gaits of one step, and `steps` is {study.steps}: give `n`"
        raise top.at("axes", "slope").error(sentence)


def _measurements(
    value: object, study: Study, location: Location
) -> dict[str, np.ndarray]:
    """The user's measurements, if the study names a file of them."""
    table = _table(value, ("overlay",), location)
    if "overlay" not in table:
        return {}
    entry = _table(table["overlay"], ("file",), location.at("overlay"))
    return overlay.read(entry.get("file"), study, location.at("overlay", "file"))


def _table(value: object, known: Collection[str], location: Location) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise location.wrong("must be a table", value)
    location.check_names(value, known, "key")
    return value


def _names(
    value: object, known: Collection[str], location: Location
) -> tuple[str, ...]:
    if (
        not isinstance(value, list)
        or not all(isinstance(v, str) for v in value)
        or not value
    ):
        raise location.wrong("must be a list of names", value)
    location.check_names(value, known)
    return tuple(dict.fromkeys(value))


def _walkers(value: object, path: Path, location: Location) -> tuple[Definition, ...]:
    if isinstance(value, list):
        if (
            not value
            or not all(isinstance(v, str) for v in value)
            or len(set(value)) < len(value)
        ):
            raise location.wrong("must be a list of different names", value)
        return tuple(walker(v, path.parent, location) for v in value)
    if isinstance(value, str | dict):
        return (walker(value, path.parent, location),)
    if value is None:
        raise location.error(
            "A study needs a `walker`: a name, a file, a table, or a list of names"
        )
    raise location.wrong("must be a name, a file, a table, or a list of names", value)


def _toward(
    axes: object, path: Path, location: Location
) -> tuple[object, Definition | None]:
    """Axes without the walker toward which `detuning` leads, and that walker, if one is
    named.
    """
    way = axes.get("detuning") if isinstance(axes, dict) else None
    if not isinstance(axes, dict) or not isinstance(way, dict) or "toward" not in way:
        return axes, None
    rest = {key: value for key, value in way.items() if key != "toward"}
    return {**axes, "detuning": rest}, other(way["toward"], path.parent, location)


def axis_keys() -> tuple[str, ...]:
    """Names that an axis may have."""
    return (
        *EXTRA_AXES,
        *dispatch.resolve("gaitsweep.tasks.walkers.walker:NUMBERS"),
        *dispatch.resolve(_ONE_LINK),
    )


def _axes(
    value: object, location: Location, kind: str
) -> tuple[tuple[Axis, ...], float]:
    """Axes, and the tolerance of an adaptive slope axis (0: none)."""
    if not isinstance(value, dict) or not value:
        raise location.error("A study needs axes, at least `slope`")
    for key in ("units", "trailing_knee"):
        if key in value:
            raise location.error(
                f"`{key}` holds a text and is no axis: it stands in the table of a walker"
            )
    location.check_names(value, axis_keys(), "key")
    if "slope" not in value:
        raise location.error("A study needs the axis `slope`")
    slope, tolerance = value["slope"], 0.0
    if isinstance(slope, dict) and "adaptive" in slope:
        tolerance, slope = _adaptive(slope, location.at("slope"), kind)
    axes = tuple(
        Axis(key, _values(slope if key == "slope" else v, location.at(key)))
        for key, v in value.items()
    )
    for axis in axes:
        for wrong in (
            axis.values[~slopes.is_slope(axis.values)].tolist()
            if axis.name == "slope"
            else ()
        ):
            slopes.check(wrong, location.at("slope"))
    return axes, tolerance


def _adaptive(
    slope: dict[str, Any], location: Location, kind: str
) -> tuple[float, dict[str, Any]]:
    """Tolerance of an adaptive slope axis, and its window as an axis of two values."""
    if kind != "branch":
        raise location.at("adaptive").error(
            '`adaptive` is for studies of kind "branch", whose points follow the gaits'
        )
    window = _table(slope, ("from", "to", "adaptive"), location)
    tolerance = location.at("adaptive").number(window["adaptive"])
    if not TOLERANCES[0] <= tolerance <= TOLERANCES[1]:
        raise location.at("adaptive").wrong("must lie in [1e-6, 0.1]", tolerance)
    return tolerance, {**{k: v for k, v in window.items() if k != "adaptive"}, "n": 2}


def _values(value: object, location: Location) -> np.ndarray:
    if isinstance(value, list):
        if not value:
            raise location.wrong("must hold at least one value", value)
        values = np.array([location.number(v) for v in value])
        step = np.diff(values)
        if not (np.all(step > 0) or np.all(step < 0)):
            raise location.wrong("must rise or fall throughout", value)
        return values
    if not isinstance(value, dict):
        raise location.wrong(
            "must be a list, or a table of from, to, n and spacing", value
        )
    table = _table(value, ("from", "to", "n", "spacing"), location)
    for key in ("from", "to", "n"):
        if key not in table:
            raise location.error(f"`{key}` is missing")
    start, stop = (
        location.at("from").number(table["from"]),
        location.at("to").number(table["to"]),
    )
    n, spacing = (
        location.at("n").count(table["n"], MAX_VALUES),
        table.get("spacing", "linear"),
    )
    if spacing not in ("linear", "log"):
        raise location.at("spacing").wrong('must be "linear" or "log"', spacing)
    if start >= stop:
        raise location.at("from").wrong(f"must be less than `to` = {stop!r}", start)
    if spacing == "log" and start <= 0:
        raise location.at("from").wrong("must be > 0 for log spacing", start)
    values = (
        np.geomspace(start, stop, n) if spacing == "log" else _linear(start, stop, n)
    )
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
    first, last = (Fraction(repr(x)) for x in (start, stop))
    step = (last - first) / max(n - 1, 1)
    for digits in range(_MAX_DIGITS + 1):
        unit = 10**digits
        if (first * unit).denominator == (step * unit).denominator == 1:
            largest = max(abs(start), abs(stop)) * unit
            # Whole numbers over a power of ten that are both exact: the quotient is the
            # double nearest the decimal.
            return np.rint(values * unit) / unit if largest < 2**53 else values
    return values


def need_proofs(location: Location) -> None:
    """Check that the extra `proof` is installed; raises StudyError if it is not."""
    if importlib.util.find_spec("flint") is None:
        raise location.error(
            "Proofs need the extra `proof` (python-flint): pip install 'gaitsweep[proof]'"
        )


def accuracy(value: object, location: Location) -> float:
    """Largest error bound wanted: 1 or 3 times a power of ten, not above the value.

    Raises
    ------
    StudyError
        If it is not a number from 1e-15 to 1e-2.
    """
    number = location.number(value)
    least, most = accuracies.ACCURACIES
    if not least <= number <= most:
        raise location.wrong(f"must lie in [{least:g}, {most:g}]", number)
    candidates = [
        float(f"{digit}e{power}") for power in range(-16, -1) for digit in (1, 3)
    ]
    return max(each for each in candidates if each <= number)


def variables(value: object, location: Location, asked: float = 0.0) -> tuple[str, ...]:
    """Names of the variables that a list of names and groups asks for.

    Parameters
    ----------
    value : object
        If it is None, all but the costly ones, and of an accuracy those that need not
        be integrated.
    location : Location
    asked : float
        Accuracy, 0 for none.

    Raises
    ------
    StudyError
        If a name is unknown.
    """
    if value is None:
        left = {*COSTLY, "multipliers"} if asked else set(COSTLY)
        without = accuracies.OF_INTEGRATION if asked else ()
        return tuple(
            v.name
            for v in VARIABLES.values()
            if v.group not in left and v.name not in without
        )
    if isinstance(value, list):
        location.blamed(
            registry.admit, [name for name in value if isinstance(name, str)]
        )
    groups = sorted({v.group for v in VARIABLES.values()} - {""})
    requested = {
        *_names(value, (*VARIABLES, *groups), location),
        *accuracies.always(asked),
    }
    wanted = tuple(v.name for v in VARIABLES.values() if {v.name, v.group} & requested)
    if any(VARIABLES[name].group == "proofs" for name in wanted):
        need_proofs(location)
    return wanted


def _with_checks(
    study: Study, table: Mapping[str, Any], top: Location, way: Location
) -> Study:
    """A study whose walkers are checked, without the variables that only walkers have
    that lock the trailing knee, if none of its does; those that it names itself stay.
    """
    study = replace(study, checks=check_walkers(study, top, way))
    if any(check["locks_trailing_knee"] for check in study.checks):
        return study
    named = table.get("want", {}).get("variables") or ()
    kept = [
        name
        for name in study.variables
        if name in named or not VARIABLES[name].is_of_locked_knee
    ]
    return replace(study, variables=tuple(kept))


def _want(
    value: object, kind: str, asked: float, location: Location
) -> dict[str, tuple[str, ...]]:
    table = _table(value, WANTED, location)
    wanted = {
        "variables": variables(table.get("variables"), location.at("variables"), asked)
    }
    for key, known in (
        ("fits", registry.FITS),
        ("figures", FIGURES),
        ("claims", CLAIMS),
    ):
        place, names = location.at(key), table.get(key, [])
        if not isinstance(names, list) or not all(
            isinstance(n, str) and re.fullmatch(r"\w{1,60}", n) for n in names
        ):
            raise place.wrong("must be a list of names", names)
        wanted[key] = tuple(dict.fromkeys(names))
        for name in wanted[key]:
            plot = (
                place.blamed(extensions.find, key, name, Plot)
                if key == "figures" and name not in known
                else None
            )
            if plot:
                READS[name] = variables(list(plot.reads), place)
            else:
                place.check_names([name], known)
            if NEEDED_KINDS.get(name, kind) != kind:
                raise place.error(
                    f"`{name}` needs a study of kind `{NEEDED_KINDS[name]}`; this one is `{kind}`"
                )
            if kind == "design" and name in registry.OVER_LINES:
                raise place.error(
                    f"`{name}` needs a study of another kind than `design`"
                )
    return wanted


def _limits(table: Mapping[str, Any], top: Location) -> Limits:
    location = top.at("limits")
    limits = _table(table.get("limits", {}), LIMITS, location)
    seconds = location.at("seconds").number(limits.get("seconds", Limits.seconds))
    if not 0 < seconds <= MAX_SECONDS:
        raise location.at("seconds").wrong("must be > 0 and at most 1e6 s", seconds)
    memory = limits.get("memory", Limits.memory)
    match = re.fullmatch(MEMORY, memory) if isinstance(memory, str) else None
    if match:
        memory = int(min(float(match[1]) * _UNITS[match[2]], 1 << 51))
    if (
        isinstance(memory, bool)
        or not isinstance(memory, int)
        or not MEMORIES[0] <= memory <= MEMORIES[1]
    ):
        raise location.at("memory").wrong(
            'must be at least 64 MiB and at most 1024 TiB, as in "2 GiB"',
            limits.get("memory"),
        )
    return Limits(seconds, memory)
