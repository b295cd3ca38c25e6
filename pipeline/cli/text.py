"""What the commands print for people."""

from __future__ import annotations

import fcntl
import json
import shlex
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pipeline.execution.progress import duration, last_state, sentence
from pipeline.paths import sidecar_path
from pipeline.plan.missing import Plan, Summary


def plan(found: Plan, counts: Summary, path: Path) -> Iterator[str]:
    """A plan: per task what runs and why, what is cached, what is not wanted."""
    study = found.study
    walkers = [f"{len(study.walkers)} walkers"] if study.walker_axis else []
    shape = " x ".join([*walkers, *(f"{len(a)} {a.name}" for a in study.axes)])
    yield f"{study.name}: {shape}, {study.points:,} points -> {path}"
    for name, layer in found.layers.items():
        what = "point" if name == "points" else "line" if layer.per_line else "study"
        parts = [f"{n:,} {why}" for why, n in sorted(counts.todo[name].items()) if n]
        parts += [f"{counts.cached[name]:,} cached"] if counts.cached[name] else []
        yield f"  {name:<12} version {layer.task.version}  per {what}: {', '.join(parts) or 'none'}"
    tasks, variables = found.unwanted()
    yield f"  not wanted: {', '.join(tasks + variables) or 'nothing'}"
    yield f"  about {duration(counts.seconds)} of work for one core" if counts.seconds else "  nothing to do"


def after(archives: list[Path], others: list[str], seconds: float) -> Iterator[str]:
    """What a run ends with: how its studies went, which `others` did not come to their end, and how to see it."""
    counts: Counter[str] = Counter()
    for path in archives:
        try:
            counts.update(json.loads(sidecar_path(path, ".run.json").read_text(encoding="utf-8"))["counts"])
        except (OSError, ValueError, KeyError):
            continue
    if len(archives) + len(others) > 1:
        ended = f"{len(archives)} of {len(archives) + len(others)}" if others else f"{len(archives)}"
        told = [", ".join(f"{k} {n:,}" for k, n in counts.items())] if counts else []
        told += [f"not run to the end: {', '.join(others)}"] if others else []
        yield f"{ended} studies in {duration(seconds)}: {'; '.join(told)}"
    if archives:
        folder = archives[0].parent / "*.nc" if len(archives) > 1 and len({p.parent for p in archives}) == 1 else None
        shown = str(folder) if folder else " ".join(shlex.quote(str(path)) for path in archives)
        yield f"To see it: gaitsweep report {shown}  (makes {Path('reports', 'index.html')})"


def state(path: Path) -> dict[str, Any] | None:
    """State of the run of an archive, with `running` and, if so, who holds it."""
    found = last_state(sidecar_path(path, ".events.jsonl"))
    if found is None:
        return None
    found["running"] = False
    try:
        with open(sidecar_path(path, ".lock"), encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                found |= {"running": True, "holder": json.load(file)}
    except (OSError, ValueError):
        pass
    return found


def status(path: Path, found: dict[str, Any] | None) -> Iterator[str]:
    """A state in a few lines."""
    if found is None:
        yield f"{path}: no run has left a trace."
        return
    holder = found.get("holder", {})
    how = (
        f"running as process {holder.get('pid')} on {holder.get('host')}"
        if found["running"]
        else "finished"
        if found.get("over")
        else "stopped"
    )
    yield f"{path}: {how}; {sentence(found)}"
    yield f"  after {duration(found['elapsed'])}; memory {found['memory'] / 2**20:.0f} MiB" + "".join(
        f"; worker {w['pid']} {w['memory'] / 2**20:.0f} MiB" for w in found["workers"]
    )
    if found["counts"]:
        yield "  " + ", ".join(f"{name} {n:,}" for name, n in sorted(found["counts"].items()))


def table(name: str, values: dict[str, Any]) -> Iterator[str]:
    """A TOML table."""
    yield f"[{name}]"
    for key, value in values.items():
        yield f"{key} = {json.dumps(value)}"


def tuned(found: dict[str, Any]) -> Iterator[str]:
    """The nearest tuned walker as a TOML table; what moved and what the conditions miss stand above it as comments."""
    if not found["moved"]:
        yield "# It meets the zero-slope conditions as it is; nothing was moved."
    for key, (old, new) in found["moved"].items():
        yield f"# {key} moved from {old!r} to {new!r}"
    for name, before in found["before"].items():
        yield f"# {name.replace('_', ' ')}: {before + 0.0:.3g} before, {found['after'][name] + 0.0:.3g} after"
    yield from table("walker", found["walker"])


def gaits(found: Iterable[dict[str, Any]], units: dict[str, str]) -> Iterator[str]:
    """Gaits at one point, a paragraph each; numbers with their units, where they have any."""
    nothing = True
    for gait in found:
        nothing = False
        yield f"{gait['gait']} ({'stable' if gait['stable'] else 'unstable'}, {gait['status']})"
        for key, value in gait.items():
            if key in ("gait", "stable", "status") or value is None:
                continue
            if key == "multipliers":
                value = ", ".join(f"{re:.12g}{im:+.12g}j" if im else f"{re:.12g}" for re, im in value)
            elif isinstance(value, float):
                value = f"{value:.15g} {units.get(key, '1')}".removesuffix(" 1")
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            yield f"  {key:<16} {value}"
    if nothing:
        yield "no gait"


def walkers(found: Iterable[dict[str, Any]], whole: bool) -> Iterator[str]:
    """The catalogue, a line each, or one walker whole."""
    for one in found:
        if not whole:
            yield f"{one['name']:<18} {one['description']}"
            continue
        yield f"{one['name']}: {one['description']}"
        yield one["drawing"]
        yield from table("walker", one["parameters"])
        yield ""
        for key, value in one["statics"].items():
            yield f"{key:<16} {value + 0.0:.12g}"
        yield "Zero where a walker may walk on slopes near zero; `gaitsweep tune` shows the nearest that is."
