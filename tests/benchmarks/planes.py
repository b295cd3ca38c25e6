"""Processor time of planes of keys: the cost of making charts, and of every further walker."""

import functools
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import what_more_take
from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.study.parse import parse
from gaitsweep.tasks.families.cell import parts

#: Walkers, a slope, and the two keys with their ranges.
PLANES: dict[str, tuple[float, dict[str, tuple[float, float]]]] = {
    "B": (0.01, {"m_s": (0.05, 0.15), "R": (0.0, 0.25)}),
    "C": (0.04, {"detuning": (0.0, 1.0), "m_h": (0.0, 1.5)}),
}
#: Walkers along each key in the smaller and in the larger study of a full and of a quick run.
_ACROSS = {False: (40, 120), True: (32, 48)}


def table(quick: bool) -> list[dict[str, float | str]]:
    """Measure planes of walkers at one slope.

    Two studies have the same charts and differ in their number of walkers; the difference is what further gaits take,
    with multipliers, error bounds, journal and archive.
    """
    rows: list[dict[str, float | str]] = []
    for name, (slope, keys) in list(PLANES.items())[: 1 if quick else None]:
        study = functools.partial(_study, name, slope, keys)
        further = what_more_take(study, *_ACROSS[quick])
        seconds, boxes, charts = made(study(_ACROSS[quick][0]))
        rows.append(
            {
                "walker": name,
                "keys": " × ".join(keys),
                "gaits": float(further.gaits + further.gaits_of_fewer),
                "s a further gait": further.seconds / further.gaits,
                "s of charts": seconds,
                "boxes": float(boxes),
                "charts": float(charts),
            }
        )
    return rows


def _study(walker: str, slope: float, keys: dict[str, tuple[float, float]], n: int) -> dict[str, Any]:
    axes = {key: np.linspace(low, high, n).tolist() for key, (low, high) in keys.items()}
    return {"name": "plane", "walker": walker, "axes": {"slope": [slope], **axes}}


def made(table: dict[str, Any]) -> tuple[float, int, int]:
    """Processor time of making the charts of a study's first plane [s], the boxes of keys, the charts; 0 without."""
    graph = Graph(parse(table, "", Path("plane.toml")), in_memory=True)
    if graph.method is not Method.PLANE:
        return 0.0, 0, 0
    node = graph.line_node(0, "charts")
    make, params = resolve(graph.function(node)), graph.params(node)
    make(params, [])  # loads code
    begin = time.process_time()
    arrays = make(params, [])
    seconds, boxes = time.process_time() - begin, parts(arrays)
    return seconds, len(boxes), sum(len(parts(box)) for box in boxes)
