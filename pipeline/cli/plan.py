"""`gaitsweep plan`: what would run and why."""

import argparse
import math
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.cli import kinds, studies
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import GaitsweepError
from gaitsweep.pipeline.graph.layers import Layer
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
    yield f"{study.name}: {_extent(study)} -> {path}"
    for name, layer in planned.graph.layers.items():
        yield f"  {name:<12} {_layer(name, layer, counts)}"

    by_charts, by_lines = seconds_over_plane(study)
    if study.plane and by_lines < math.inf:
        keys = " and ".join(study.plane.region["keys"])
        chosen = "charts" if by_charts < by_lines else "lines one by one"
        charts = f"by charts over {keys} {duration(by_charts)}"
        yield f"  method: {chosen}; {charts}, line by line {duration(by_lines)}"

    points = counts.todo.get("points", Counter()).total()
    integrated = costs.integrated(study, points, planned.graph.method)
    if integrated < points:
        wanted = f"to an accuracy of {study.accuracy:g}"
        yield f"  integrated: about {integrated:,} points {wanted}, all others not"

    for sentence in [*corners.notes(study), *_idle(study)]:
        yield f"  note: {sentence}"
    if counts.seconds:
        yield f"  about {duration(counts.seconds)} of work for one core"
    else:
        yield "  nothing to do"


def _extent(study: Study) -> str:
    """The axes of a study, and how many points or lines it has."""
    axes, total = study.axes, counted(study.points, "point")
    if study.kind in ("design", "cascade", "curve"):  # whose slopes are a window
        noun = "design" if study.kind == "design" else "line"
        axes, total = study.line_axes, counted(study.lines, noun)

    sides = [f"{len(axis)} {axis.name}" for axis in axes]
    if study.walker_axis:
        sides.insert(0, f"{len(study.walkers)} walkers")
    return ", ".join([" x ".join(sides), total]) if sides else total


def _layer(name: str, layer: Layer, counts: Summary) -> str:
    """A task, what there is one of, and how many of these run and why or are cached."""
    whole = "line" if layer.per_line else "study"
    what = "point" if name == "points" else whole
    parts = [f"{n:,} {why}" for why, n in sorted(counts.todo[name].items()) if n]
    if counts.cached[name]:
        parts.append(f"{counts.cached[name]:,} cached")
    return f"per {what}: {', '.join(parts) or 'none'}"


def _idle(study: Study) -> Iterator[str]:
    """Say what a study wants of a grid that is too small for it."""
    wide = [axis.name for axis in study.axes if len(axis) > 1]
    if "heatmap" in study.figures and len(wide) < 2:
        over = f"only {wide[0]} has" if wide else "none has"
        yield f"`heatmap` needs two axes of several values, but {over}; it is not drawn."

    keys = [name for name in wide if name not in ("slope", "walker")]
    if "over_key" in study.figures and not keys:
        yield "`over_key` needs an axis of a key with several values; it is not drawn."
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
        included) and `cached`; `omitted`, names of variables and tasks that the study
        does not want; `integrated`, about how many points are; `seconds` of work for
        one core; and `tasks`, the counts of each.
    """
    study = planned.study
    main = "points" if study.kind == "grid" else study.kind
    new, every = counts.todo[main]["new"], counts.todo[main].total()
    integrated = 0
    if main == "points":
        integrated = costs.integrated(study, every, planned.graph.method)
    tasks = {
        name: {**todo, "cached": counts.cached[name]}
        for name, todo in counts.todo.items()
    }

    return {
        "study": study.name,
        "archive": str(path),
        "points": study.points,
        "new": new,
        "changed": every - new,
        "cached": counts.cached[main],
        "omitted": _omitted(planned),
        "integrated": integrated,
        "seconds": counts.seconds,
        "tasks": tasks,
    }


def _omitted(planned: Plan) -> list[str]:
    """What the study does not want: whole groups, other variables, and tasks."""
    graph = planned.graph
    others = (*FITS, "trace", "claims")
    tasks = [name for name in TASKS if name in others and name not in graph.layers]
    if planned.study.kind != "grid":
        return tasks

    features = planned.study.features
    elsewhere = (OF_TARGETS, SENSITIVITIES)
    wanted = {VARIABLES[name].group for name in graph.variables}
    names = []
    for variable in VARIABLES.values():
        if variable.name in graph.variables or variable.group in elsewhere:
            continue
        if not variable.is_left_out(features):
            is_partly = variable.group in wanted
            names.append(variable.name if is_partly else variable.group)

    return [*dict.fromkeys(names), *tasks]
