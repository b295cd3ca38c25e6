"""Text output of the commands."""

from __future__ import annotations

import fcntl
import json
import math
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pipeline.engine.progress import duration, last_state, sentence
from pipeline.graph.plan import Plan, Summary
from pipeline.grid import costs
from pipeline.paths import sidecar_path
from pipeline.study import corners
from tasks.registry import FITS, VARIABLES

#: Units in degrees for those in radians; a rate of a walker in consistent units has the unit 1.
_DEGREES = {"rad": "deg", "rad s-1": "deg s-1", "1": "deg per unit of time"}


def plan(planned: Plan, counts: Summary, path: Path) -> Iterator[str]:
    """Describe a plan: for each task what runs and why, what is cached, and what is not requested."""
    study = planned.study
    walkers = [f"{len(study.walkers)} walkers"] if study.walker_axis else []
    axes, total = study.axes, f"{study.points:,} points"
    if study.kind in ("design", "cascade", "curve"):  # whose slopes are a window
        name = "design" if study.kind == "design" else "line"
        axes, total = study.line_axes, f"{study.lines:,} {name}{'s' if study.lines > 1 else ''}"
    shape = [*walkers, *(f"{len(a)} {a.name}" for a in axes)]
    yield f"{study.name}: {' x '.join(shape)}{', ' if shape else ''}{total} -> {path}"
    for name, layer in planned.graph.layers.items():
        what = "point" if name == "points" else "line" if layer.per_line else "study"
        parts = [f"{n:,} {why}" for why, n in sorted(counts.todo[name].items()) if n]
        parts += [f"{counts.cached[name]:,} cached"] if counts.cached[name] else []
        yield f"  {name:<12} version {layer.task.version}  per {what}: {', '.join(parts) or 'none'}"
    every = sum(counts.todo["points"].values()) if "points" in counts.todo else 0
    if (integrated := costs.integrated(planned.study, every)) < every:
        yield f"  integrated: about {integrated:,} points to an accuracy of {planned.study.accuracy:g}, all others not"
    yield from (f"  note: {sentence}" for sentence in corners.notes(planned.study))
    yield f"  not wanted: {', '.join(_omitted(planned)) or 'nothing'}"
    yield f"  about {duration(counts.seconds)} of work for one core" if counts.seconds else "  nothing to do"


def plan_record(planned: Plan, counts: Summary, path: Path) -> dict[str, Any]:
    """A plan for machines.

    Parameters
    ----------
    planned : Plan
    counts : Summary
    path : Path
        The archive.

    Returns
    -------
    dict
        `study`, `archive`, `points` of the grid; of these (of the lines, in studies of other kinds) how many are
        `new`, `changed` (failures that are tried again included) and `cached`; `not_wanted`, names of variables and
        tasks; `flown`, about how many points are integrated; `seconds` of work for one core; and `tasks`, the counts
        of each.
    """
    study = planned.study
    main = "points" if study.kind == "grid" else study.kind
    new, every = counts.todo[main]["new"], sum(counts.todo[main].values())
    tasks = {name: {**dict(todo), "cached": counts.cached[name]} for name, todo in counts.todo.items()}
    return {
        "study": study.name,
        "archive": str(path),
        "points": study.points,
        "new": new,
        "changed": every - new,
        "cached": counts.cached[main],
        "not_wanted": _omitted(planned),
        "flown": costs.integrated(study, every) if main == "points" else 0,
        "seconds": counts.seconds,
        "tasks": tasks,
    }


def _omitted(planned: Plan) -> list[str]:
    """What the study does not want: whole groups, other variables, and tasks."""
    tasks, variables = planned.omissions()
    names = [name for name in tasks if name in (*FITS, "trace", "claims")]
    if planned.study.kind != "grid":
        return names
    groups = {v.group for v in VARIABLES.values()} - {VARIABLES[v].group for v in planned.graph.variables}
    return list(dict.fromkeys(VARIABLES[v].group if VARIABLES[v].group in groups else v for v in variables)) + names


def after(archives: list[Path], unfinished: list[str], seconds: float) -> Iterator[str]:
    """Closing lines of a run: outcomes of its studies, unfinished ones, and how to see the results."""
    counts: Counter[str] = Counter()
    for path in archives:
        try:
            counts.update(json.loads(sidecar_path(path, ".run.json").read_text(encoding="utf-8"))["counts"])
        except (OSError, ValueError, KeyError):
            continue
    if len(archives) + len(unfinished) > 1:
        count = f"{len(archives)} of {len(archives) + len(unfinished)}" if unfinished else f"{len(archives)}"
        parts = [", ".join(f"{k} {n:,}" for k, n in counts.items())] if counts else []
        parts += [f"not run to the end: {', '.join(unfinished)}"] if unfinished else []
        yield f"{count} studies in {duration(seconds)}: {'; '.join(parts)}"
    if archives:
        folder = archives[0].parent / "*.nc" if len(archives) > 1 and len({p.parent for p in archives}) == 1 else None
        shown = str(folder) if folder else " ".join(shlex.quote(str(path)) for path in archives)
        yield f"To see it: gaitsweep report {shown}  (makes {Path('reports', 'index.html')})"


def state(path: Path) -> dict[str, Any] | None:
    """State of the run of an archive, with `running` and, if so, its `holder`; None without a record."""
    last = last_state(sidecar_path(path, ".events.jsonl"))
    if last is None:
        return None
    last["running"] = False
    lock = sidecar_path(path, ".journal-lock")
    if not lock.is_file():  # another one might be waited for
        return last
    try:
        with open(lock, encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                last |= {"running": True, "holder": json.load(file)}
    except (OSError, ValueError):
        pass
    return last


def status(path: Path, run_state: dict[str, Any] | None) -> Iterator[str]:
    """Describe the state of a run in a few lines."""
    if run_state is None:
        yield f"{path}: there is no record of a run."
        return
    try:
        yield from list(_described(path, run_state))
    except (LookupError, TypeError, ValueError, AttributeError):  # of another version, or of another program
        yield f"{path}: its record of a run is not one of this version."


def _described(path: Path, run_state: dict[str, Any]) -> Iterator[str]:
    holder = run_state.get("holder", {})
    condition = (
        f"running as process {holder.get('pid')} on {holder.get('host')}"
        if run_state["running"]
        else "finished"
        if run_state.get("over")
        else "stopped"
    )
    yield f"{path}: {condition}; {sentence(run_state)}"
    yield f"  after {duration(run_state['elapsed'])}; memory {run_state['memory'] / 2**20:.0f} MiB" + "".join(
        f"; worker {w['pid']} {w['memory'] / 2**20:.0f} MiB" for w in run_state["workers"]
    )
    if run_state["counts"]:
        yield "  " + ", ".join(f"{name} {n:,}" for name, n in sorted(run_state["counts"].items()))


def table(name: str, values: dict[str, Any]) -> Iterator[str]:
    """Format a TOML table."""
    yield f"[{name}]"
    for key, value in values.items():
        yield f"{key} = {json.dumps(value)}"


def tuned_walker(answer: dict[str, Any]) -> Iterator[str]:
    """Nearest tuned walker as a TOML table; changed keys and residuals of the conditions precede it as comments."""
    if not answer["moved"]:
        yield "# It meets the zero-slope conditions already; no key was changed."
    for key, (old, new) in answer["moved"].items():
        yield f"# {key} changed from {old!r} to {new!r}"
    for name, before in answer["before"].items():
        yield f"# {name.replace('_', ' ')}: {before + 0.0:.3g} before, {answer['after'][name] + 0.0:.3g} after"
    yield from table("walker", answer["walker"])


def gaits(all_gaits: Iterable[dict[str, Any]], units: dict[str, str], in_degrees: bool = False) -> Iterator[str]:
    """Gaits at one point, a paragraph each, with units; angles and rates in degrees if asked."""
    is_empty, has_others = True, False
    for gait in all_gaits:
        is_empty = False
        width = max(16, *(len(key) for key, value in gait.items() if value is not None))
        yield f"{gait['gait']} ({'stable' if gait['stable'] else 'unstable'}, {gait['status']})"
        for key, value in gait.items():
            if key in ("gait", "stable", "status", "contact_mass_matrix") or value is None:
                continue
            if key == "multipliers":
                value = ", ".join(f"{re:.12g}{im:+.12g}j" if im else f"{re:.12g}" for re, im in value)
            elif isinstance(value, float):
                unit = units.get(key, "1")
                if in_degrees and (key == "slope" or (key in VARIABLES and VARIABLES[key].kind in ("angle", "rate"))):
                    value, unit = math.degrees(value), _DEGREES[unit]
                value = f"{value:.15g} {unit}".removesuffix(" 1")
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            yield f"  {key:<{width}} {value}"
        has_others = has_others or str(gait["gait"]).startswith("other")
    if has_others:
        yield "Of several gaits under one label that of the largest stance angle has it; others are other1, other2, ..."
    if is_empty:
        yield "no gait"


def walkers(descriptions: Iterable[dict[str, Any]], in_full: bool) -> Iterator[str]:
    """The catalogue, a line for each walker, or one walker in full."""
    for walker in descriptions:
        if not in_full:
            yield f"{walker['name']:<18} {walker['description']}"
            continue
        yield f"{walker['name']}: {walker['description']}"
        yield walker["drawing"]
        yield from table("walker", walker["parameters"])
        yield ""
        for key, value in walker["statics"].items():
            yield f"{key:<16} {value + 0.0:.12g}"
        yield "Only a walker with zero residuals can walk at vanishing slope, and not every such walker does."
        yield "`gaitsweep tune` shows the nearest one, `gaitsweep solve` whether it walks."
