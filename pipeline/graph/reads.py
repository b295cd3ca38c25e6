"""What a task over the whole study reads: stored results of every line, and tables."""

import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.store.record import Head, dtype_of, has_multipliers
from gaitsweep.tasks.registry import GAITS, READS, VARIABLES

_MAX_SLOPES = 20_000  # slopes of a line that a task over the study reads, evenly spaced
_MAX_CHUNKS = 64  # chunks in memory, where lines cross them


def study_inputs(plan: Plan, name: str) -> Iterator[bytes]:
    """Packed inputs of a task over the study: a dict of arrays for each line, then tables."""
    graph, store = plan.graph, plan.store
    needs = graph.layers[name].needs
    per_line = [need for need in needs if need != "points" and graph.layers[need].per_line]
    reads = [v for v in READS.get(name, graph.variables) if v in VARIABLES and v not in ("status", "reason")]
    lines = _Lines(plan, ["status", *reads])
    for number in range(plan.study.batches):
        columns = lines.line(number) if "points" in needs else {}
        for need in per_line:
            result = store.result(graph.line_keys(number)[need].key)
            columns |= serialize.load(result) if result else {}
        yield serialize.dump(columns)
    for need in needs:
        if not graph.layers[need].per_line:
            yield store.result(graph.study_keys[need].key) or serialize.dump({})


class _Lines:
    """Variables of the points of each line, of the wanted gaits: what else is stored is none of the study's."""

    def __init__(self, plan: Plan, names: list[str]):
        self.plan, self.names, self.graph = plan, names, plan.graph
        self.step = math.ceil(len(plan.study.slope) / _MAX_SLOPES)
        self.others = [k for k, gait in enumerate(GAITS) if gait not in plan.study.gaits]
        self._chunk = functools.lru_cache(_MAX_CHUNKS if self.graph.method.is_of_lines else 1)(self._read)

    def line(self, number: int) -> dict[str, Any]:
        """Slopes and variables, shape (n, gait[, multiplier]), of one line."""
        grid = self.graph.grid
        parts = []
        for k in grid.chunks_of_line(number):
            chunk = grid.chunk(k)
            n = chunk.slopes.stop - chunk.slopes.start
            place = int(np.flatnonzero(chunk.numbers == number)[0])
            rows = np.arange(n)[-chunk.slopes.start % self.step :: self.step] + place * n
            stored = self._chunk(k)
            parts.append({name: self._column(stored.get(name), name, rows) for name in self.names})
        values = {name: np.concatenate([part[name] for part in parts]) for name in self.names}
        return {"slope": self.plan.study.slope[:: self.step], **values}

    def _read(self, number: int) -> dict[str, np.ndarray]:
        key, store = self.graph.chunk_key(self.graph.grid.chunk(number)).key, self.plan.store
        if key not in store:
            return {}
        head, payload = store.get(key)
        with store.reading():
            contents = Head(head)
            return {name: contents.unpack(memoryview(payload), name) for name in self.names}

    def _column(self, stored: np.ndarray | None, name: str, rows: np.ndarray) -> np.ndarray:
        absent = ALL_STATUSES["not_attempted"] if name == "status" else VARIABLES[name].absent
        shape = (len(rows), len(GAITS), *([self.graph.grid.multipliers] if has_multipliers(name) else []))
        whole = np.full(shape, absent, dtype_of(name))
        if stored is not None:
            whole[:, : stored.shape[1]] = stored[rows]
        whole[:, self.others] = VARIABLES[name].absent
        return whole
