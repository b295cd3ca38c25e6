"""The tasks a study still needs, and why: `plan` prints them and `run` executes them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.plan import costs, graph
from pipeline.store import lines
from pipeline.store.journal import Journal, TaskKey
from pipeline.study.model import Study
from tasks.registry import TASKS, VARIABLES


def golden_ratio_order(n: int) -> Iterator[int]:
    """Numbers from 0 to n - 1 in an order whose leading part, however long, samples them evenly."""
    step = next(k for k in range(max(1, round(0.618 * n)), 2 * n + 2) if math.gcd(k, n) == 1)
    return (i * step % n for i in range(n))


@dataclass(frozen=True)
class LineWork:
    """Work on one line: its keys, why each task over it would run, and the indices of slopes to solve."""

    number: int
    line: dict[str, Any]
    keys: dict[str, TaskKey]
    why: dict[str, str]
    missing: np.ndarray


@dataclass(frozen=True)
class Plan:
    """A study compared with its journal; with `retry`, failed tasks and points run again."""

    study: Study
    journal: Journal
    retry: bool = False
    layers: dict[str, graph.Layer] = field(init=False)
    variables: tuple[str, ...] = field(init=False)
    want: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", graph.layers(self.study))
        object.__setattr__(self, "variables", graph.variables(self.study))
        object.__setattr__(self, "want", lines.needed(self.variables, self.study.gaits))

    def line(self, number: int, fresh: bool = False) -> LineWork:
        """Work on the line of that number; `fresh` if the journal is empty."""
        study, line = self.study, self.study.line(number)
        keys = graph.line_keys(study, self.layers, line)
        why: dict[str, str] = {}
        missing = np.arange(0)
        has_failed = False
        if "atlas" in keys:
            has_failed = not fresh and self._has_failed(keys["atlas"].key)
        for name, (key, unversioned_key) in keys.items():
            if name == "points":
                missing = self._missing_points(key, fresh, has_failed)
                if len(missing):
                    why[name] = "new" if fresh else self._why_points(key, unversioned_key)
            elif name != "atlas" and not has_failed and (fresh or self._is_stale(key)):
                why[name] = "new" if fresh else self._why(unversioned_key)
        # Tasks over the study read the atlas too, so a lost row is computed again.
        readers = [*why, *(name for name, layer in self.layers.items() if not layer.per_line)]
        if "atlas" in keys and any("atlas" in self.layers[name].needs for name in readers):
            key, unversioned_key = keys["atlas"]
            if fresh or self._is_stale(key):
                why["atlas"] = "new" if fresh else self._why(unversioned_key)
        return LineWork(number, line, keys, why, missing)

    def _missing_points(self, key: str, fresh: bool, failed: bool) -> np.ndarray:
        slopes = self.study.slope
        if fresh:
            return np.arange(len(slopes))
        if failed:
            return np.arange(0)
        return lines.missing(self.journal, key, self.want, slopes, self.study.gaits, self.retry)

    def _has_failed(self, key: str) -> bool:
        """Whether the task failed before and is not to be retried."""
        outcome = self.journal.outcome(key)
        return outcome is not None and outcome.status != "ok" and not self.retry

    def _is_stale(self, key: str) -> bool:
        outcome = self.journal.outcome(key)
        return outcome is None or (self.retry and outcome.status != "ok")

    def _why(self, unversioned_key: str) -> str:
        return "changed" if self.journal.knows(unversioned_key) else "new"

    def _why_points(self, key: str, unversioned_key: str) -> str:
        if not self.journal.last_block(key):
            return self._why(unversioned_key)
        slopes = self.study.slope
        if not len(lines.missing(self.journal, key, frozenset(), slopes)):
            return "retried" if self.retry else "changed"
        return "new"

    def lines(self) -> Iterator[LineWork]:
        """Lines with work to do, in an order whose leading part samples the study evenly."""
        fresh, n = self.journal.empty(), self.study.lines
        for number in golden_ratio_order(n):
            work = self.line(number, fresh)
            if work.why:
                yield work

    def over_study(self, ran: bool) -> dict[str, tuple[TaskKey, str]]:
        """Keys of the tasks over the whole study that would run, and why; `ran` if any of their inputs run."""
        names = [name for name, layer in self.layers.items() if not layer.per_line]
        if not names:
            return {}
        keys, last = self.study_keys(), self.last_block()
        todo: dict[str, tuple[TaskKey, str]] = {}
        for name in names:
            outcome = self.journal.outcome(keys[name].key)
            if outcome is None:
                todo[name] = keys[name], self._why(keys[name].unversioned)
            elif ran or outcome.seen < last or any(need in todo for need in self.layers[name].needs):
                todo[name] = keys[name], "its inputs change"
            elif outcome.status != "ok" and self.retry:
                todo[name] = keys[name], "retried"
        return todo

    def line_keys(self, number: int) -> dict[str, TaskKey]:
        """Keys of every task over the line of that number."""
        return graph.line_keys(self.study, self.layers, self.study.line(number))

    def _line_keys(self) -> Iterator[dict[str, TaskKey]]:
        return map(self.line_keys, range(self.study.lines))

    def study_keys(self) -> dict[str, TaskKey]:
        """Keys of every task over the whole study."""
        lines = ("".join(key for key, _ in keys.values()) for keys in self._line_keys())
        return graph.study_keys(self.study, self.layers, lines)

    def last_block(self) -> int:
        """Number of the latest block of any line of the study."""
        keys = (line["points"].key for line in self._line_keys() if "points" in line)
        return max(map(self.journal.last_block, keys), default=0)

    def omissions(self) -> tuple[list[str], list[str]]:
        """Tasks and variables that the study does not request."""
        return [t for t in TASKS if t not in self.layers], [v for v in VARIABLES if v not in self.variables]


@dataclass
class Summary:
    """Counts of a plan: `todo[layer][why]`, `cached[layer]`, and the estimated work in core seconds."""

    todo: dict[str, Counter[str]]
    cached: dict[str, int]
    seconds: float = 0.0


def summary(plan: Plan) -> Summary:
    """Count the work of a plan without storing it."""
    study = plan.study
    todo: dict[str, Counter[str]] = {name: Counter() for name in plan.layers}
    ran = False
    if plan.journal.empty():
        for name, layer in plan.layers.items():
            if layer.per_line:
                todo[name]["new"] = study.points if name == "points" else study.lines
        ran = True
    else:
        for work in plan.lines():
            ran = True
            for name, why in work.why.items():
                todo[name][why] += len(work.missing) if name == "points" else 1
    for name, (_, why) in _over_study(plan, ran).items():
        todo[name][why] += 1
    totals = {
        name: study.points if name == "points" else study.lines if layer.per_line else 1
        for name, layer in plan.layers.items()
    }
    result = Summary(todo, {name: totals[name] - sum(todo[name].values()) for name in plan.layers})
    measured = plan.journal.seconds_per_point()
    for name in plan.layers:
        seconds_each = costs.seconds(study, name)
        if measured and name == "points":
            seconds_each = measured
        elif measured and name == "atlas" and graph.is_short(study):
            seconds_each = 0.0  # what is measured for a point of a short line includes its share of the atlas
        result.seconds += seconds_each * sum(todo[name].values())
    if result.seconds:
        result.seconds += costs.starting(study)
    return result


def _over_study(plan: Plan, ran: bool) -> dict[str, tuple[Any, str]]:
    if plan.journal.empty():
        return {name: ((), "new") for name, layer in plan.layers.items() if not layer.per_line}
    return plan.over_study(ran)
