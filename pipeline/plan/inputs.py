"""What a task over the whole study reads: stored results of every line, and tables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from pipeline import serialize
from pipeline.plan.missing import Plan
from tasks.registry import GAITS, READS, VARIABLES

_MAX_SLOPES = 20_000  # slopes of a line that a task over the study reads, evenly spaced


def study_inputs(plan: Plan, name: str) -> Iterator[bytes]:
    """Packed inputs of a task over the study: a dict of arrays for each line, then tables."""
    layer, study = plan.layers[name], plan.study
    reads = READS.get(name, plan.variables)
    variables = [v for v in reads if v in VARIABLES and v not in ("status", "reason")]
    slopes = study.slope[:: math.ceil(len(study.slope) / _MAX_SLOPES)]
    per_line = [need for need in layer.needs if need != "points" and plan.layers[need].per_line]
    points = _points(plan, variables, slopes) if "points" in layer.needs else ({} for _ in range(study.batches))
    for number, columns in enumerate(points):
        for need in per_line:
            stored = plan.journal.result(plan.line_keys(number)[need].key)
            columns |= serialize.load(stored.data) if stored and stored.outcome == "ok" else {}
        yield serialize.dump(columns)
    for need in layer.needs:
        if not plan.layers[need].per_line:
            stored = plan.journal.result(plan.study_keys()[need].key)
            yield stored.data if stored and stored.outcome == "ok" else serialize.dump({})


def _points(plan: Plan, names: list[str], slopes: np.ndarray) -> Iterator[dict[str, Any]]:
    """Points of each line, of the wanted gaits: what an earlier run has stored of others is none of the study's."""
    others = [k for k, gait in enumerate(GAITS) if gait not in plan.study.gaits]
    for indices, data in plan.read(np.arange(plan.study.lines), names, slopes):
        for name in data.keys() - {"slope", "reason", "reasons"}:
            data[name][:, :, others] = VARIABLES[name].absent
        shared = {name: data.pop(name) for name in ("slope", "reasons")}
        for k in range(len(indices)):
            yield {"slope": shared["slope"], **{name: v[k] for name, v in data.items()}, "reasons": shared["reasons"]}
