"""What a task over the whole study reads: stored results of every line, and tables."""

import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.statuses import NOT_ATTEMPTED
from gaitsweep.pipeline.store.points import Points, joined
from gaitsweep.tasks.contract.registry import GAITS, READS, VARIABLES

_MAX_SLOPES = 20_000  # slopes of a line that a task over the study reads, evenly spaced
_MAX_CHUNKS = 64  # chunks in memory, where lines cross them


def study_inputs(plan: Plan, name: str) -> Iterator[bytes]:
    """Packed inputs of a task over the study: a dict of arrays for each line, then
    tables.
    """
    graph, store = plan.graph, plan.store
    needs = graph.layers[name].needs
    if not needs:
        return

    per_line = [
        need for need in needs if need != "points" and graph.layers[need].per_line
    ]
    reads = [
        v
        for v in READS.get(name, graph.variables)
        if v in VARIABLES and v not in ("status", "reason")
    ]
    lines = _Lines(plan, ["status", *reads])
    for number in range(plan.study.batches):
        columns = lines.line(number) if "points" in needs else {}
        for need in per_line:
            columns |= store.result(graph.line_keys(number)[need]) or {}
        yield serialize.dump(columns)

    for need in needs:
        if not graph.layers[need].per_line:
            yield serialize.dump(store.result(graph.study_keys[need]) or {})


class _Lines:
    """Variables of the points of each line, of the wanted gaits: what else is stored is
    none of the study's.
    """

    def __init__(self, plan: Plan, names: list[str]):
        self.plan, self.names, self.graph = plan, names, plan.graph
        self.step = math.ceil(len(plan.study.values_along) / _MAX_SLOPES)
        self.others = [
            k for k, gait in enumerate(GAITS) if gait not in plan.study.gaits
        ]
        self._chunk = functools.lru_cache(
            _MAX_CHUNKS if self.graph.method.is_of_lines else 1
        )(self._read)

    def line(self, number: int) -> dict[str, Any]:
        """Slopes and variables, shape (n, gait[, multiplier]), of one line."""
        grid, parts = self.graph.grid, []
        for k in grid.chunks_of_line(number):
            chunk = grid.chunk(k)
            first = int(np.flatnonzero(chunk.numbers == number)[0]) * chunk.per_line
            rows = first + np.arange(
                -chunk.slopes.start % self.step, chunk.per_line, self.step
            )
            stored = self._chunk(k).values
            parts.append(Points({name: stored[name][rows] for name in self.names}))

        values = joined(parts, (len(GAITS), grid.multipliers)).values
        for name in self.names:
            values[name][:, self.others] = VARIABLES[name].absent
        return {"slope": self.plan.study.values_along[:: self.step], **values}

    def _read(self, number: int) -> Points:
        chunk, store = self.graph.grid.chunk(number), self.plan.store
        key = self.graph.chunk_key(chunk)
        if key not in store:
            return Points.of_ending(
                chunk.points, "not_attempted", NOT_ATTEMPTED, self.names
            )
        return store.points(key, self.names)
