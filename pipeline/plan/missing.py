"""The tasks a study still needs, and why: `plan` prints them and `run` executes them."""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.plan import costs, graph
from pipeline.plan.blocks import Blocks, StoredLines, stored_blocks
from pipeline.statuses import ALL_STATUSES
from pipeline.store import lines
from pipeline.store.journal import Journal
from pipeline.store.rows import Block, TaskKey
from pipeline.study.model import Study
from tasks.registry import GAITS, TASKS, VARIABLES


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
class BlockWork:
    """Work on a block of short lines: its key, the numbers of lines to solve, all at every slope, and why."""

    number: int
    key: TaskKey
    lines: np.ndarray
    why: str


@dataclass(frozen=True)
class Plan:
    """A study compared with its journal; with `retry`, failed tasks and points run again."""

    study: Study
    journal: Journal
    retry: bool = False
    layers: dict[str, graph.Layer] = field(init=False)
    variables: tuple[str, ...] = field(init=False)
    want: frozenset[str] = field(init=False)
    blocks: Blocks | None = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", graph.layers(self.study))
        object.__setattr__(self, "variables", graph.variables(self.study))
        object.__setattr__(self, "want", lines.needed(self.variables, self.study.gaits))
        object.__setattr__(self, "blocks", Blocks(self.study, self.layers) if graph.is_short(self.study) else None)

    @property
    def line_tasks(self) -> list[str]:
        """Tasks over each line that blocks of lines do not include."""
        per_line = [name for name, layer in self.layers.items() if layer.per_line]
        if not self.blocks:
            return per_line
        # Atlases of short lines are kept only for those that read them.
        omitted = ("points",) if self.atlas_readers else ("atlas", "points")
        return [name for name in per_line if name not in omitted]

    @property
    def atlas_readers(self) -> list[str]:
        """Tasks that read atlases, besides points or the task of the study's kind, whose statuses report failures."""
        own = ("points", self.study.kind)
        return [name for name, layer in self.layers.items() if "atlas" in layer.needs and name not in own]

    def line(self, number: int, fresh: bool = False, with_points: bool = True) -> LineWork:
        """Work on the line of that number, by itself; `fresh` if the journal is empty."""
        study, line = self.study, self.study.batch_line(number)
        keys = graph.line_keys(study, self.layers, line)
        why: dict[str, str] = {}
        missing = np.arange(0)
        has_failed = False
        if "atlas" in keys:
            has_failed = not fresh and self._has_failed(keys["atlas"].key)
        for name, (key, unversioned_key) in keys.items():
            if name == "points":
                missing = self._missing_points(key, fresh, has_failed) if with_points else missing
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
            return np.arange(len(slopes), dtype=np.int32)
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

    def works(self) -> Iterator[LineWork | BlockWork]:
        """Lines and blocks with work to do, in an order whose leading part samples the study evenly."""
        fresh = self.journal.empty()
        if not self.blocks:
            for number in golden_ratio_order(self.study.batches):
                work = self.line(number, fresh)
                if work.why:
                    yield work
            return
        for block in golden_ratio_order(self.blocks.count):
            yield from self._block_works(self.blocks, block, fresh)

    def _block_works(self, blocks: Blocks, block: int, fresh: bool) -> Iterator[LineWork | BlockWork]:
        numbers = blocks.numbers(block)
        if fresh:
            yield BlockWork(block, blocks.keys(block), numbers, "new")
            return
        stored, places = list(self._stored_blocks(numbers)), lines.Places(self.study.slope, blocks.digests(numbers))
        status, _, _, sources = lines.read_states(stored, self.want, places)
        new, alone = _unsolved_lines(status, sources, len(numbers))
        unsolved = new
        if self.retry:
            unsolved = new | (lines.has_failed({"status": status}, self.study.gaits).reshape(len(numbers), -1).any(1))
            unsolved &= ~alone
        if unsolved.any():
            keys, why = blocks.keys(block), "retried"
            if new.any():
                has_all = stored and not len(lines.unsolved(stored, frozenset(), places))
                has_slopes = (status.reshape(len(numbers), -1)[new] != ALL_STATUSES["not_attempted"]).any()
                why = "changed" if has_all or has_slopes else "new" if stored else self._why(keys.unversioned)
            yield BlockWork(block, keys, numbers[unsolved], why)
        for k in np.flatnonzero(~unsolved if self.line_tasks else alone).tolist():
            work = self.line(int(numbers[k]), with_points=bool(alone[k]))
            if work.why:
                yield work

    def _stored_blocks(self, numbers: np.ndarray) -> Iterator[Block]:
        """Blocks of the journal that hold lines of one block of the study, by their numbers."""
        assert self.blocks
        key = self.blocks.key(int(self.blocks.of(numbers[:1])[0]))
        return stored_blocks(self.journal, key, self._stored_lines, self.blocks.digests(numbers))

    @functools.cached_property
    def _stored_lines(self) -> StoredLines | None:
        return StoredLines(self.journal, self.blocks) if self.blocks else None

    def over_study(self, ran: bool) -> dict[str, tuple[TaskKey, str]]:
        """Keys of the tasks over the whole study that would run, and why; `ran` if any of their inputs run."""
        names = [name for name, layer in self.layers.items() if not layer.per_line]
        if not names:
            return {}
        keys, last = self.study_keys(), self.journal.last_block()
        todo: dict[str, tuple[TaskKey, str]] = {}
        for name in names:
            key, needs = keys[name].key, self.layers[name].needs
            outcome = self.journal.outcome(key)
            if outcome is None:
                todo[name] = keys[name], self._why(keys[name].unversioned)
            elif (
                ran
                or any(need in todo or (need == "points" and outcome.seen < last) for need in needs)
                or self.journal.is_outdated(key, needs)  # by a run that was killed before it reached this task
            ):
                todo[name] = keys[name], "its inputs change"
            elif outcome.status != "ok" and self.retry:
                todo[name] = keys[name], "retried"
        return todo

    def line_keys(self, number: int) -> dict[str, TaskKey]:
        """Keys of every task over the line, or the designs, of the job of that number."""
        return graph.line_keys(self.study, self.layers, self.study.batch_line(number))

    def study_keys(self) -> dict[str, TaskKey]:
        """Keys of every task over the whole study."""
        if self.blocks:
            parts = (self.blocks.key(block) for block in range(self.blocks.count))
        else:
            parts = ("".join(key for key, _ in self.line_keys(i).values()) for i in range(self.study.batches))
        return graph.study_keys(self.study, self.layers, parts)

    def read(
        self, numbers: np.ndarray, names: Iterable[str], slopes: np.ndarray | None = None, gaits: int = len(GAITS)
    ) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
        """Read states and variables of the points of lines, as many lines at a time as are stored together.

        Parameters
        ----------
        numbers : ndarray of int, shape (n,)
            Of the lines, ascending.
        names : iterable of str
            Variables to read.
        slopes : ndarray, shape (s,) [rad], optional
            By default those of the study.
        gaits : int
            Number of gaits, from the first.

        Yields
        ------
        indices : ndarray of int, shape (k,)
            Indices into `numbers`.
        data : dict
            As `store.lines.line` returns it, with the lines as first axis of `status`, `reason` and each variable.
        """
        slopes, names = self.study.slope if slopes is None else slopes, list(names)
        blocks = self.blocks.of(numbers) if self.blocks else numbers
        order = np.argsort(blocks, kind="stable")
        starts = np.flatnonzero(np.diff(blocks[order], prepend=-1))
        for start, end in itertools.pairwise([*starts.tolist(), len(numbers)]):
            group = numbers[order[start:end]]
            yield (
                order[start:end],
                self._read_block(group, names, slopes, gaits)
                if self.blocks
                else {
                    name: values if name in ("slope", "reasons") else values[None]
                    for name, values in self._read_line(int(group[0]), names, slopes, gaits).items()
                },
            )

    def _read_line(self, number: int, names: list[str], slopes: np.ndarray, gaits: int) -> dict[str, np.ndarray]:
        return lines.line(self.journal, self.line_keys(number), self.want, self.study, names, slopes, gaits)

    def _read_block(
        self, numbers: np.ndarray, names: list[str], slopes: np.ndarray, gaits: int
    ) -> dict[str, np.ndarray]:
        assert self.blocks
        places = lines.Places(slopes, self.blocks.digests(numbers))
        status, reason, sentences, sources = lines.read_states(self._stored_blocks(numbers), self.want, places)
        _, alone = _unsolved_lines(status, sources, len(numbers))
        multipliers = max(check["multipliers"] for check in self.study.checks)
        values = lines.fill(self.journal, names, sources, places.size, multipliers, gaits)
        values |= {"status": status[:, :gaits], "reason": reason[:, :gaits]}
        values = {name: v.reshape(len(numbers), len(slopes), *v.shape[1:]) for name, v in values.items()}
        for k in np.flatnonzero(alone).tolist():
            line = self._read_line(int(numbers[k]), names, slopes, gaits)
            line["reason"] = line["reason"] + len(sentences)
            sentences += line["reasons"].tolist()
            for name, v in values.items():
                v[k] = line[name]
        return {"slope": slopes, **values, "reasons": np.array(sentences)}

    def omissions(self) -> tuple[list[str], list[str]]:
        """Tasks and variables that the study does not request."""
        return [t for t in TASKS if t not in self.layers], [v for v in VARIABLES if v not in self.variables]


def _unsolved_lines(status: np.ndarray, sources: list[lines.Source], n: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines of a block that are not stored, and those that failed in it and are computed by themselves.

    Of the latter a block holds the status `not_attempted`.
    """
    is_stored = np.zeros(len(status), bool)
    for _, _, target in sources:
        is_stored[target] = True
    new: np.ndarray = ~np.all(is_stored.reshape(n, -1), axis=1)
    return new, ~new & np.any(status.reshape(n, -1) == ALL_STATUSES["not_attempted"], axis=1)


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
                todo[name]["new"] = study.points if name == "points" else study.batches
        ran = True
    else:
        for work in plan.works():
            ran = True
            if isinstance(work, BlockWork):
                todo["points"][work.why] += len(work.lines) * len(study.slope)
                todo["atlas"][work.why] += len(work.lines)
                works = (
                    plan.line(n, with_points=False) for n in work.lines.tolist() if set(plan.line_tasks) - {"atlas"}
                )
                for name, why in ((n, w) for line in works for n, w in line.why.items() if n != "atlas"):
                    todo[name][why] += 1
                continue
            for name, why in work.why.items():
                todo[name][why] += len(work.missing) if name == "points" else 1
    for name, (_, why) in _over_study(plan, ran).items():
        todo[name][why] += 1
    totals = {
        name: study.points if name == "points" else study.batches if layer.per_line else 1
        for name, layer in plan.layers.items()
    }
    result = Summary(todo, {name: totals[name] - sum(todo[name].values()) for name in plan.layers})
    result.seconds = _seconds(plan, {name: sum(counts.values()) for name, counts in todo.items()})
    return result


def _seconds(plan: Plan, todo: dict[str, int]) -> float:
    """Estimated processor time of some tasks of each layer [s]."""
    # Points of short lines are not timed: their time is that of their blocks, atlases included.
    measured = None if graph.is_short(plan.study) else plan.journal.seconds_per_point()
    seconds = 0.0
    for name, count in todo.items():
        seconds += count * (measured if measured and name == "points" else costs.seconds(plan.study, name))
    return seconds + costs.starting(plan.study) if seconds else 0.0


def _over_study(plan: Plan, ran: bool) -> dict[str, tuple[Any, str]]:
    if plan.journal.empty():
        return {name: ((), "new") for name, layer in plan.layers.items() if not layer.per_line}
    return plan.over_study(ran)
