"""Processor time of planes of keys: the cost of making charts, and of every further
walker.
"""

import functools
import time
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from benchmarks.harness import what_more_take
from gaitsweep.pipeline.graph.graph import Graph, boxes
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.study.parse import parse
from gaitsweep.tasks.charts import cell
from gaitsweep.tasks.studies import solve_planes

#: Walkers, a slope, and the two keys with their ranges.
PLANES: dict[str, tuple[float, dict[str, tuple[float, float]]]] = {
    "B": (0.01, {"m_s": (0.05, 0.15), "R": (0.0, 0.25)}),
    "C": (0.04, {"detuning": (0.0, 1.0), "m_h": (0.0, 1.5)}),
}
#: Walkers along each key in the smaller and in the larger study of a full and of a
#: quick run.
_ACROSS = {False: (40, 120), True: (32, 48)}


def table(quick: bool) -> list[dict[str, float | str]]:
    """Measure planes of walkers at one slope.

    Two studies have the same charts and differ in their number of walkers; the
    difference is what further gaits take, with multipliers, error bounds, journal and
    archive.
    """
    rows: list[dict[str, float | str]] = []
    for name, (slope, keys) in list(PLANES.items())[: 1 if quick else None]:
        study = functools.partial(_study, name, slope, keys)
        further = what_more_take(study, *_ACROSS[quick])
        plane = made(study(_ACROSS[quick][0]))
        rows.append(
            {
                "walker": name,
                "keys": " × ".join(keys),
                "gaits": float(further.gaits + further.gaits_of_fewer),
                "s a further gait": further.seconds / further.gaits,
                "s of charts": plane.seconds,
                "boxes": float(plane.boxes),
                "charts": float(plane.charts),
            }
        )
    return rows


def _study(
    walker: str, slope: float, keys: dict[str, tuple[float, float]], n: int
) -> dict[str, Any]:
    axes = {
        key: np.linspace(low, high, n).tolist() for key, (low, high) in keys.items()
    }
    return {"name": "plane", "walker": walker, "axes": {"slope": [slope], **axes}}


class Made(NamedTuple):
    """A plane: processor time of making its charts [s], boxes of keys, charts, lines
    surveyed, points left to lines.
    """

    seconds: float = 0.0
    boxes: int = 0
    charts: int = 0
    surveyed: int = 0
    fell_back: int = 0


def made(table: dict[str, Any]) -> Made:
    """Make the charts of a study's first plane, if it has one, and solve its points by
    them.
    """
    graph = Graph(parse(table, "", Path("plane.toml")), in_memory=True)
    if graph.method is not Method.PLANE:
        return Made()
    first, arrays = graph.node("charts", 0), {}
    params = graph.params(first)
    solve_planes.charts(params, [])  # loads code
    own = [
        k for k in range(graph.study.lines) if graph.line_keys(k)["charts"] == first.key
    ]
    with mock.patch.object(
        cell, "survey_lines", side_effect=cell.survey_lines
    ) as survey:
        begin = time.process_time()
        for chunk in (graph.grid.chunk(k) for k in range(graph.grid.chunks)):
            for node in (
                graph.charts_of(chunk, lambda node: boxes(arrays[node.key], "halves"))
                if chunk.numbers[0] in own
                else ()
            ):
                if node.key not in arrays:
                    arrays[node.key] = solve_planes.charts(graph.params(node), [])
        seconds = time.process_time() - begin
    accepted = 0

    def solve(*arguments: Any) -> Any:
        nonlocal accepted
        solved, which = solved_by_charts(*arguments)
        accepted += int(which.sum())
        return solved, which

    solved_by_charts, study = solve_planes.solve, graph.study
    with mock.patch.object(solve_planes, "solve", solve):
        solve_planes.lines(
            {
                **params,
                "lines": [study.line(k) for k in own],
                "slope": study.values_along,
            },
            [*arrays.values()],
        )
    own_boxes = [
        box for made_there in arrays.values() for box in cell.parts(made_there)
    ]
    return Made(
        seconds,
        len(own_boxes),
        sum(len(cell.parts(box)) for box in own_boxes),
        sum(len(call.args[0].lanes) for call in survey.call_args_list),
        len(own) * len(study.values_along) - accepted,
    )
