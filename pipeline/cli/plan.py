"""`gaitsweep plan`: what would run and why."""

import argparse
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.cli import kinds, studies
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import GaitsweepError
from gaitsweep.pipeline.graph.plan import Plan, Summary, summary
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.choose_method import seconds_over_plane
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study import corners
from gaitsweep.pipeline.study.model import Study
from gaitsweep.pipeline.terminal import counted, duration
from gaitsweep.tasks.contract.registry import (
    FITS,
    OF_TARGETS,
    SENSITIVITIES,
    TASKS,
    VARIABLES,
)

#: Slopes below which a plan says that a fitted law may not be found.
_LEAST_SLOPES = 20


def run(options: argparse.Namespace) -> int:
    """Print the plan of every study; returns the gravest exit code."""
    targets, invalid = studies.targets(options)
    codes = [*invalid.values()]
    records, described = [], list[str]()
    for study, path in targets:
        try:
            store = Journal(Companions(path).journal, write=False)
            planned = Plan(study, store, options.retry_failed)
            counts = summary(planned)
        except GaitsweepError as error:
            codes.append(say(error, options.debug))
            continue
        records.append(_record(planned, counts, path))
        described += lines(planned, counts, path)

    if records:
        kinds.show(options, records, described)
    return gravest(codes)


def lines(planned: Plan, counts: Summary, path: Path) -> Iterator[str]:
    """Describe a plan: for each task what runs and why, and what is cached."""
    study = planned.study
    walkers = [f"{len(study.walkers)} walkers"] if study.walker_axis else []
    axes, total = study.axes, counted(study.points, "point")
    if study.kind in ("design", "cascade", "curve"):  # whose slopes are a window
        axes, total = (
            study.line_axes,
            counted(study.lines, "design" if study.kind == "design" else "line"),
        )
    shape = [*walkers, *(f"{len(a)} {a.name}" for a in axes)]
    yield f"{study.name}: {' x '.join(shape)}{', ' if shape else ''}{total} -> {path}"
    for name, layer in planned.graph.layers.items():
        what = "point" if name == "points" else "line" if layer.per_line else "study"
        parts = [f"{n:,} {why}" for why, n in sorted(counts.todo[name].items()) if n]
        parts += [f"{counts.cached[name]:,} cached"] if counts.cached[name] else []
        yield f"  {name:<12} per {what}: {', '.join(parts) or 'none'}"
    by_charts, by_lines = seconds_over_plane(study)
    if study.plane and by_lines < math.inf:
        keys = " and ".join(study.plane.region["keys"])
        chosen = "charts" if by_charts < by_lines else "lines one by one"
        yield f"  method: {chosen}; by charts over {keys} {duration(by_charts)}, line by line {duration(by_lines)}"
    every = sum(counts.todo["points"].values()) if "points" in counts.todo else 0
    if (integrated := costs.integrated(study, every, planned.graph.method)) < every:
        yield f"  integrated: about {integrated:,} points to an accuracy of {study.accuracy:g}, all others not"
    sentences = [*corners.notes(study), *_idle(study)]
    yield from (f"  note: {sentence}" for sentence in sentences)
    yield (
        f"  about {duration(counts.seconds)} of work for one core"
        if counts.seconds
        else "  nothing to do"
    )


def _idle(study: Study) -> Iterator[str]:
    """Say what a study wants of a grid that is too small for it."""
    wide = [axis.name for axis in study.axes if len(axis) > 1]
    if "heatmap" in study.figures and len(wide) < 2:
        over = f"only {wide[0]} has" if wide else "none has"
        yield f"`heatmap` needs two axes of several values, but {over}; it is not drawn."
    slopes = sum(len(axis) for axis in study.axes if axis.name == "slope")
    for name in ("scaling", "transition"):
        if name in study.fits and slopes < _LEAST_SLOPES:
            yield f"`{name}` fits laws over slopes; {counted(slopes, 'slope')} may not be enough."


def _record(planned: Plan, counts: Summary, path: Path) -> dict[str, Any]:
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
        `study`, `archive`, `points` of the grid; of these (of the lines, in studies of
        other kinds) how many are `new`, `changed` (failures that are tried again
        included) and `cached`; `not_wanted`, names of variables and tasks; `flown`,
        about how many points are integrated; `seconds` of work for one core; and
        `tasks`, the counts of each.
    """
    study = planned.study
    main = "points" if study.kind == "grid" else study.kind
    new, every = counts.todo[main]["new"], sum(counts.todo[main].values())
    tasks = {
        name: {**dict(todo), "cached": counts.cached[name]}
        for name, todo in counts.todo.items()
    }
    return {
        "study": study.name,
        "archive": str(path),
        "points": study.points,
        "new": new,
        "changed": every - new,
        "cached": counts.cached[main],
        "not_wanted": _omitted(planned),
        "flown": costs.integrated(study, every, planned.graph.method)
        if main == "points"
        else 0,
        "seconds": counts.seconds,
        "tasks": tasks,
    }


def _omitted(planned: Plan) -> list[str]:
    """What the study does not want: whole groups, other variables, and tasks."""
    graph = planned.graph
    names = [
        name
        for name in TASKS
        if name in (*FITS, "trace", "claims") and name not in graph.layers
    ]
    if planned.study.kind != "grid":
        return names
    groups = {v.group for v in VARIABLES.values()}
    groups -= {VARIABLES[v].group for v in graph.variables}
    features = planned.study.features
    left = [
        v
        for v in VARIABLES.values()
        if v.name not in graph.variables
        and v.group not in (OF_TARGETS, SENSITIVITIES)
        and not v.is_left_out(features)
    ]
    return (
        list(dict.fromkeys(v.group if v.group in groups else v.name for v in left))
        + names
    )
