"""Read a study: which walker, which axes, and what is wanted of every point.

A study is checked whole before anything runs. Every error names the key, its value, the bound it breaks (or
the nearest known key), the file and the place in it.
"""

from __future__ import annotations

import importlib.util
import itertools
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pipeline import dispatch
from pipeline.study import options
from pipeline.study.files import _toml, walker
from pipeline.study.location import Location
from pipeline.study.model import Axis, Limits, Study
from tasks import registry
from tasks.registry import ALWAYS, CLAIMS, COSTLY, FIGURES, GAITS, SHOWN_BY, TASKS, VARIABLES

#: Tasks that no study is named after.
_SERVANTS = ("atlas", "points", "trace")
#: Axis keys that are not a walker's own.
EXTRA_AXES = ("slope", "foot_mass_ratio", "detuning")
#: Longest axis and largest grid that are taken for meant.
MAX_VALUES, MAX_POINTS = 10_000_000, 10**12
_UNITS = {
    "": 1,
    "B": 1,
    **{f"{p}B": 1000**i for i, p in enumerate("kMGT", 1)},
    **{f"{p}iB": 1024**i for i, p in enumerate("KMGT", 1)},
}


def kinds() -> tuple[str, ...]:
    """Kinds of study; every one but `grid` is the task of that name, over each line."""
    return ("grid", *(t.name for t in TASKS.values() if set(t.needs) <= {"atlas"} and t.name not in _SERVANTS))


def read(path: str | Path) -> Study:
    """Read and check a study file.

    Raises
    ------
    StudyError
        If the file cannot be read or anything in it cannot be.
    """
    path = Path(path)
    text, table = _toml(path, str(path))
    return parse(table, text, path)


def parse(table: Mapping[str, Any], text: str, path: Path) -> Study:
    """Check a study's table; `path` names it in errors and anchors the files it names."""
    top = Location(path.name)
    known = ("name", "kind", "walker", "gaits", "axes", "want", "limits", "options")
    for key in table:
        if key not in known:
            raise top.unknown(key, known)
    name = table.get("name")
    if name is None:
        raise top.error("A study needs a `name`")
    if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", name):
        raise top.at("name").wrong("must be letters, digits, dots, dashes or underscores", name)
    kind = table.get("kind", "grid")
    if not isinstance(kind, str):
        raise top.at("kind").wrong(f"must be one of {', '.join(kinds())}", kind)
    if kind not in kinds():
        raise top.at("kind").unknown(kind, kinds())
    gaits = _names(table.get("gaits", list(GAITS)), GAITS, top.at("gaits"))
    want: dict[str, Any] = dict(_want(table.get("want", {}), kind, top.at("want")))
    axes, tolerance = _axes(table.get("axes"), top.at("axes"), kind)
    chosen = options.check(table.get("options", {}), kind, _keys(), top.at("options"))
    walkers = _walkers(table.get("walker"), path, top.at("walker"))
    listed = isinstance(table.get("walker"), list)
    study = Study(
        name=name,
        text=text,
        kind=kind,
        path=path,
        options={**chosen, "adaptive": tolerance} if tolerance else chosen,
        walker_axis=listed,
        names=tuple(table["walker"] if listed else (w if isinstance(w, str) else "walker" for w in walkers)),
        gaits=tuple(g for g in GAITS if g in gaits),
        limits=_limits(table, top),
        walkers=walkers,
        axes=axes,
        **want,
    )
    if study.points > MAX_POINTS:
        raise top.at("axes").error(f"The grid has {study.points:.3g} points, more than {MAX_POINTS:.0e}")
    return _checked(study, top)


def _table(value: object, known: Iterable[str], place: Location) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise place.wrong("must be a table", value)
    for key in value:
        if key not in known:
            raise place.unknown(key, known)
    return value


def _names(value: object, known: Iterable[str], place: Location) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) for v in value) or not value:
        raise place.wrong("must be a list of names", value)
    for name in value:
        if name not in known:
            raise place.unknown(name, known)
    return tuple(dict.fromkeys(value))


def _walkers(value: object, path: Path, place: Location) -> tuple[str | dict[str, Any], ...]:
    if isinstance(value, list):
        if not value or not all(isinstance(v, str) for v in value) or len(set(value)) < len(value):
            raise place.wrong("must be a list of different names", value)
        return tuple(walker(v, path.parent, place) for v in value)
    if isinstance(value, str | dict):
        return (walker(value, path.parent, place),)
    if value is None:
        raise place.error("A study needs a `walker`: a name, a file, a table, or a list of names")
    raise place.wrong("must be a name, a file, a table, or a list of names", value)


def _keys() -> tuple[str, ...]:
    """What an axis may be called."""
    return (*EXTRA_AXES, *dispatch.resolve("tasks.walkers.walker:NUMBERS"))


def _axes(value: object, place: Location, kind: str) -> tuple[tuple[Axis, ...], float]:
    """The axes, and the tolerance of an adaptive slope axis (0: none)."""
    if not isinstance(value, dict) or not value:
        raise place.error("A study needs axes, at least `slope`")
    for key in value:
        if key not in _keys():
            raise place.unknown(key, _keys())
    if "slope" not in value:
        raise place.error("A study needs the axis `slope`")
    slope, tolerance = value["slope"], 0.0
    if isinstance(slope, dict) and "adaptive" in slope:
        tolerance, slope = _adaptive(slope, place.at("slope"), kind)
    axes = tuple(Axis(key, _values(slope if key == "slope" else v, place.at(key))) for key, v in value.items())
    for axis in axes:
        if axis.name == "slope" and not (axis.values.min() > 0 and axis.values.max() < 0.5):
            worst = axis.values.min() if axis.values.min() <= 0 else axis.values.max()
            raise place.at("slope").wrong("must lie in (0, 0.5) rad", float(worst))
    return axes, tolerance


def _adaptive(slope: dict[str, Any], place: Location, kind: str) -> tuple[float, dict[str, Any]]:
    """The tolerance of an adaptive slope axis, and its window as an axis of two values."""
    if kind != "branch":
        raise place.at("adaptive").error('`adaptive` is for studies of kind "branch", whose points follow the gaits')
    window = _table(slope, ("from", "to", "adaptive"), place)
    tolerance = place.at("adaptive").number(window["adaptive"])
    if not 1e-6 <= tolerance <= 0.1:
        raise place.at("adaptive").wrong("must lie in [1e-6, 0.1]", tolerance)
    return tolerance, {**{k: v for k, v in window.items() if k != "adaptive"}, "n": 2}


def _values(value: object, place: Location) -> np.ndarray:
    if isinstance(value, list):
        if not value:
            raise place.wrong("must hold at least one value", value)
        values = np.array([place.number(v) for v in value])
        step = np.diff(values)
        if not (np.all(step > 0) or np.all(step < 0)):
            raise place.wrong("must rise or fall throughout", value)
        return values
    if not isinstance(value, dict):
        raise place.wrong("must be a list, or a table of from, to, n and spacing", value)
    table = _table(value, ("from", "to", "n", "spacing"), place)
    for key in ("from", "to", "n"):
        if key not in table:
            raise place.error(f"`{key}` is missing")
    start, stop = place.at("from").number(table["from"]), place.at("to").number(table["to"])
    n, spacing = table["n"], table.get("spacing", "linear")
    if isinstance(n, bool) or not isinstance(n, int) or not 1 <= n <= MAX_VALUES:
        raise place.at("n").wrong(f"must be a whole number from 1 to {MAX_VALUES:,}", n)
    if spacing not in ("linear", "log"):
        raise place.at("spacing").wrong('must be "linear" or "log"', spacing)
    if start >= stop:
        raise place.at("from").wrong(f"must be less than `to` = {stop!r}", start)
    if spacing == "log" and start <= 0:
        raise place.at("from").wrong("must be > 0 for log spacing", start)
    values = (np.geomspace if spacing == "log" else np.linspace)(start, stop, n)
    if n > 1 and not np.all(np.diff(values) > 0):
        raise place.at("n").wrong("is too many: neighbouring values would be equal", n)
    return values


def need_proofs(place: Location) -> None:
    """Check that the extra `proof` is installed; raises StudyError if it is not."""
    if importlib.util.find_spec("flint") is None:
        raise place.error("Proofs need the extra `proof` (python-flint): pip install 'gaitsweep[proof]'")


def _want(value: object, kind: str, place: Location) -> dict[str, tuple[str, ...]]:
    table = _table(value, ("variables", "fits", "figures", "claims"), place)
    groups = sorted({v.group for v in VARIABLES.values()} - {""})
    wanted = tuple(v.name for v in VARIABLES.values() if v.group not in COSTLY)
    if "variables" in table:
        asked = {*_names(table["variables"], (*VARIABLES, *groups), place.at("variables")), *ALWAYS}
        wanted = tuple(v.name for v in VARIABLES.values() if {v.name, v.group} & asked)
        if any(VARIABLES[name].group == "proofs" for name in wanted):
            need_proofs(place.at("variables"))
    names = {key: _free_names(table.get(key, []), place.at(key)) for key in ("fits", "figures", "claims")}
    for fit in names["fits"]:
        if fit not in TASKS:
            raise place.at("fits").unknown(fit, [t for t in TASKS if t not in (*kinds(), *_SERVANTS, "claims")])
    for figure in names["figures"]:
        if figure not in FIGURES:
            raise place.at("figures").unknown(figure, FIGURES)
        if SHOWN_BY.get(figure, kind) != kind:
            raise place.at("figures").error(
                f"`{figure}` shows a study of kind `{SHOWN_BY[figure]}`; this one is `{kind}`"
            )
    for claim in names["claims"]:
        if claim not in CLAIMS:
            raise place.at("claims").unknown(claim, CLAIMS)
    return {"variables": wanted, **names}


def _free_names(value: object, place: Location) -> tuple[str, ...]:
    if not isinstance(value, list) or not all(isinstance(v, str) and re.fullmatch(r"\w{1,60}", v) for v in value):
        raise place.wrong("must be a list of names", value)
    return tuple(dict.fromkeys(value))


def _limits(table: Mapping[str, Any], top: Location) -> Limits:
    place = top.at("limits")
    limits = _table(table.get("limits", {}), ("seconds", "memory"), place)
    seconds = place.at("seconds").number(limits.get("seconds", Limits.seconds))
    if not 0 < seconds <= 1e6:
        raise place.at("seconds").wrong("must be > 0 and at most 1e6 s", seconds)
    memory = limits.get("memory", Limits.memory)
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?([A-Za-z]*)", memory) if isinstance(memory, str) else None
    if found and found[2] in _UNITS:
        memory = int(float(found[1]) * _UNITS[found[2]])
    if isinstance(memory, bool) or not isinstance(memory, int) or not 1 << 26 <= memory <= 1 << 50:
        raise place.at("memory").wrong('must be at least 64 MiB, as in "2 GiB"', limits.get("memory"))
    return Limits(seconds, memory)


def _checked(study: Study, top: Location) -> Study:
    """Check every walker at the corners of the grid of lines; keep what `tasks` says of each."""
    ends = [sorted({float(a.values[0]), float(a.values[-1])}) for a in study.line_axes]
    names = [a.name for a in study.line_axes]
    checks = []
    for one in study.walkers:
        for corner in itertools.islice(itertools.product(*ends), 256):
            given = dict(zip(names, corner, strict=True))
            try:
                found = dispatch.call("check_walker", {"walker": one, "set": given})
            except ValueError as error:
                key = getattr(error, "key", "walker")
                place = top.at("axes", key) if key in names else top.at("walker")
                raise place.error(str(error)) from error
            if study.kind == "curve":
                _followed(study, one, given, top.at("options"))
        checks.append(found)
    object.__setattr__(study, "checks", tuple(checks))
    return study


def _followed(study: Study, walker: str | dict[str, Any], given: dict[str, float], place: Location) -> None:
    """Check a walker at both ends of the range of the key that curves are followed over."""
    options = registry.options("curve", study.options)
    for end in ("from", "to"):
        try:
            dispatch.call("check_walker", {"walker": walker, "set": {**given, options["key"]: options[end]}})
        except ValueError as error:
            value = getattr(error, "key", "") == options["key"]
            sentence = str(error) if value else f"`{options['key']}` = {options[end]!r} leaves no walker: {error}"
            raise place.at(end if end in study.options else "key").error(sentence) from error
