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

    names = ["status"]
    for variable in READS.get(name, graph.variables):
        if variable in VARIABLES and variable not in ("status", "reason"):
            names.append(variable)

    per_line = [need for need in needs if graph.layers[need].per_line]
    lines = _Lines(plan, names)
    for number in range(plan.study.batches):
        columns: dict[str, Any] = {}
        if "points" in per_line:
            columns |= lines.line(number)
        for need in per_line:
            if need != "points":
                columns |= store.result(graph.line_keys(number)[need]) or {}
        yield serialize.dump(columns)

    for need in needs:
        if need not in per_line:
            yield serialize.dump(store.result(graph.study_keys[need]) or {})


class _Lines:
    """Variables of the points of each line, of the wanted gaits: what else is stored is
    none of the study's.
    """

    def __init__(self, plan: Plan, names: list[str]):
        self.plan, self.names, self.graph = plan, names, plan.graph
        self.step = math.ceil(len(plan.study.values_along) / _MAX_SLOPES)
        wanted = plan.study.gaits
        self.others = [k for k, gait in enumerate(GAITS) if gait not in wanted]
        remembered = 1
        if self.graph.method.is_of_lines:
            remembered = _MAX_CHUNKS
        self._chunk = functools.lru_cache(remembered)(self._read)

    def line(self, number: int) -> dict[str, Any]:
        """Slopes and variables, shape (n, gait[, multiplier]), of one line."""
        grid, parts = self.graph.grid, []
        for k in grid.chunks_of_line(number):
            chunk = grid.chunk(k)
            (place,) = np.flatnonzero(chunk.numbers == number)
            of_step = np.arange(
                -chunk.slopes.start % self.step, chunk.per_line, self.step
            )
            rows = place * chunk.per_line + of_step
            stored = self._chunk(k).values
            parts.append(Points({name: stored[name][rows] for name in self.names}))

        values = joined(parts, len(GAITS), grid.multipliers).values
        for name in self.names:
            values[name][:, self.others] = VARIABLES[name].absent
        return {"slope": self.plan.study.values_along[:: self.step], **values}

    def _read(self, number: int) -> Points:
        chunk, store = self.graph.grid.chunk(number), self.plan.store
        key = self.graph.chunk_key(chunk)
        if key in store:
            return store.points(key, self.names)

        count = chunk.points
        return Points.of_ending(count, "not_attempted", NOT_ATTEMPTED, self.names)
