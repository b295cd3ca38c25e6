"""Do what a plan asks: one loop; executors differ only in where joblib sends a job.

Results are kept in the journal as they come, in any order.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline import serialize
from pipeline.errors import GaitsweepError, WorkerError
from pipeline.execution.estimates import Costs
from pipeline.execution.executors import _NOOP_JOB, Engine
from pipeline.plan import graph
from pipeline.plan.missing import LineWork, Plan
from pipeline.store import lines
from pipeline.store.journal import Result
from tasks.registry import GAITS, READS, SECONDS_PER_PROOF, VARIABLES

_TARGET = 1.0  # s of work in a chunk
_MAX = 32768  # points in a chunk: what bounds the memory of a worker
_PIECES = 4  # chunks a worker gets at least, where there is work for it
_MIN = 0.25  # s of work not worth cutting
_FIRST = 256  # points in a chunk before anything is measured
_MAX_OPEN_LINES, _MAX_OPEN_POINTS = 32, 1_000_000  # lines at work at a time, and points on them
_LONG = 10.0  # s of a line from which it is probed
_WHOLE = 60  # a task over a whole line or study may take as many times a point's seconds
_OUT = 4  # jobs out or not yet read, for each worker
_IDLE_TIMEOUT = 2.0  # s a process on a cluster waits for more: nobody there knows when the run is over, or gone
_READ = 20_000  # slopes of a line that a task over the study is given, evenly taken
_TRIES = 3  # times in a row that a broken engine is built anew
Listen = Callable[[str, dict[str, Any]], None]


@dataclass
class Task:
    """A task over one line, or one chunk of its points, or (without `work`) a task over the study."""

    name: str
    keys: tuple[str, str]
    work: LineWork | None = None
    places: np.ndarray | None = None
    inputs: tuple[bytes, ...] = ()
    params: dict[str, Any] | None = None
    probe: bool = False


def golden_ratio_order(pieces: list[Any]) -> list[Any]:
    """The same in an order in which a part of them is a sample of the whole."""
    n = len(pieces)
    step = next(k for k in range(max(1, round(0.618 * n)), 2 * n + 2) if math.gcd(k, n) == 1)
    return [pieces[i * step % n] for i in range(n)]


class Queue:
    """Tasks ready to go, in an order where chunks of points come before new lines. Any thread may take one."""

    def __init__(self, loop: Loop, lines: Iterator[LineWork]):
        self.loop, self.lines, self.exhausted = loop, lines, False
        self.ready: deque[Task] = deque()
        self.out: dict[int, Task] = {}
        self.numbers = itertools.count()
        self.lock = threading.Lock()

    def __bool__(self) -> bool:
        return bool(self.ready) or not self.exhausted

    def __iter__(self) -> Iterator[tuple[int, dict[str, Any]]]:
        return self

    def __next__(self) -> tuple[int, dict[str, Any]]:
        with self.lock:
            while not self.exhausted and (not self.ready or self.ahead()):
                work = next(self.lines, None)
                if work is None:
                    self.exhausted = True
                else:
                    self.ready.extend(self.loop.begin(work))
            if len(self.out) >= _OUT * self.loop.engine.jobs:
                raise StopIteration  # joblib runs ahead of a slow reader; what it holds is memory
            if not self.ready and self.out:
                return _NOOP_JOB, {}  # joblib never asks again whom nothing was given; what is out may lead to more
            if not self.ready:
                raise StopIteration
            task = self.ready.popleft()
            if task.places is not None and len(task.places) > (size := self.loop.chunk_size(task)):
                self.ready.appendleft(dataclasses.replace(task, places=task.places[size:]))
                task.places = task.places[:size]
            number = next(self.numbers)
            self.out[number] = task
            return number, self.loop.job(task)

    def ahead(self) -> bool:
        """Whether to begin another line before those at work are done: what lines cost is then known early."""
        costs = self.loop.costs
        return (
            len(self.ready) < _MAX_OPEN_LINES
            and len(costs.lines) < _MAX_OPEN_LINES
            and costs.begun() < _MAX_OPEN_POINTS
        )

    def add(self, tasks: list[Task]) -> None:
        """Put tasks in front, but the points of a line, after the first of them, at the end."""
        with self.lock:
            points = [task for task in tasks if task.places is not None]
            self.ready.extendleft(reversed([task for task in tasks if task.places is None] + points[:1]))
            self.ready.extend(points[1:])

    def probe(self, work: LineWork) -> None:
        """Let a few points of every region of a line come first: what is left of it can then be told."""
        with self.lock:
            mine = [task for task in self.ready if task.work is work and task.places is not None]
            if mine:
                places = np.sort(np.concatenate([task.places for task in mine]))  # type: ignore[misc]
                few, rest = self.loop.costs.probes(work.number, places)
                self.ready = deque(task for task in self.ready if not any(task is t for t in mine))
                self.ready.extend(dataclasses.replace(mine[0], places=p) for p in golden_ratio_order(rest))
                self.ready.extendleft(dataclasses.replace(mine[0], places=p, probe=True) for p in few)

    def requeue(self) -> None:
        """Put everything that is out back in front: its engine broke."""
        with self.lock:
            self.ready.extendleft(self.out.values())
            self.out = {}


class Loop:
    """One run of one plan; `points` of it are to be solved."""

    def __init__(
        self,
        plan: Plan,
        engine: Engine,
        listen: Listen,
        points: int,
        chunk: int | None = None,
        hold: contextlib.AbstractContextManager[Any] | None = None,
    ):
        self.hold = hold or contextlib.nullcontext()
        self.plan, self.engine, self.listen, self.points, self.chunk = plan, engine, listen, points, chunk
        self.study, self.journal = plan.study, plan.journal
        self.tokens = lines.needed((*plan.variables,), self.study.gaits)
        self.columns = [GAITS.index(g) for g in self.study.gaits]
        layer = plan.layers.get("points")
        self.cost = self.journal.seconds_per_point() or (layer.task.seconds_per_point if layer else 0.0) or 1e-3
        if {"proved", "proved_radius"} & set(plan.variables):
            self.cost = max(self.cost, SECONDS_PER_PROOF)
        self.measured = 0
        self.costs = Costs(len(self.study.slope), points, self.cost)

    def run(self) -> None:
        """Run everything the plan names.

        Raises
        ------
        WorkerError
            If workers or the cluster cannot be kept alive.
        """
        queue = Queue(self, self.plan.lines())
        self.queue = queue
        broken, done = 0, 0
        over: deque[Task] | None = None
        while True:
            try:
                with self.engine.parallel() as parallel:
                    while True:
                        while queue:
                            for number, result in parallel(queue):
                                if number == _NOOP_JOB:
                                    continue
                                done, broken = done + 1, 0
                                queue.add(self.record(queue.out.pop(number), result))
                        if over is None:
                            over = deque(self.over_study(done > 0))
                        if not over:
                            return
                        queue.add([self.with_inputs(over.popleft())])
            except (GaitsweepError, KeyboardInterrupt):
                raise
            except Exception as error:
                if self.engine.address is None:
                    raise
                broken += 1
                if broken > _TRIES:
                    raise WorkerError(f"Workers cannot be kept alive: {_line(error)}.") from error
                self.listen("engine", {"error": _line(error)})
                time.sleep(broken)
                queue.requeue()

    def begin(self, work: LineWork) -> list[Task]:
        """First tasks of a line: its atlas, or what leans on it."""
        self.costs.begin(work.number, work.missing)
        if "atlas" in work.why:
            return [Task("atlas", work.keys["atlas"], work)]
        atlas = self.journal.result(work.keys["atlas"][0]) if "atlas" in work.keys else None
        return self.lean(work, (atlas.data,) if atlas else ())

    def lean(self, work: LineWork, inputs: tuple[bytes, ...]) -> list[Task]:
        """Tasks of a line that lean on its atlas; its points in pieces far apart first."""
        others = [name for name in work.why if name not in ("atlas", "points")]
        tasks = [Task(name, work.keys[name], work, None, inputs) for name in others]
        if not len(work.missing):
            return tasks
        pieces = golden_ratio_order(np.array_split(work.missing, math.ceil(len(work.missing) / self.chunk_size())))
        if len(work.missing) * self.cost > _TARGET:  # a taste of the line, before those that follow are begun
            pieces[:1] = filter(len, (pieces[0][:_FIRST], pieces[0][_FIRST:]))
        return tasks + [Task("points", work.keys["points"], work, piece, inputs) for piece in pieces]

    def chunk_size(self, task: Task | None = None) -> int:
        """Points in the next chunk: about a second of work, less where every worker would not get its share."""
        if self.chunk:
            return self.chunk
        cost = self.cost
        if task and task.work and task.places is not None and task.work.number in self.costs.probed:
            cost = self.costs.each(task.work.number)[self.costs.region(task.places[0])] or cost
        if task and not self.measured:
            return _FIRST
        share = self.points * self.cost / (self.engine.jobs * _PIECES)
        seconds = min(_TARGET, max(_MIN, share), self.study.limits.seconds / 4)
        return max(1, min(_MAX, int(seconds / cost)))

    def job(self, task: Task) -> dict[str, Any]:
        """A task as `worker_process.run` takes it."""
        layer, limits = self.plan.layers[task.name], self.study.limits
        params = task.params or graph.line_params(self.study, task.name, task.work.line)  # type: ignore[union-attr]
        if task.places is not None:
            params |= {"slope": self.study.slope[task.places], "want": self.plan.variables, "gaits": self.study.gaits}
        return {
            "function": layer.task.function,
            "params": params,
            "inputs": list(task.inputs),
            "points": task.places is not None,
            "memory": limits.memory,
            "idle": None if self.engine.address is None else _IDLE_TIMEOUT,
            "seconds": limits.seconds * (_WHOLE if task.places is None else 1),
        }

    def record(self, task: Task, result: dict[str, Any]) -> list[Task]:
        """Keep a result; the tasks that it makes ready."""
        event = {
            "task": task.name,
            "line": task.work.number if task.work else None,
            "seconds": result["seconds"],
            "pid": result["pid"],
            "worker": result.get("worker"),
        }
        if task.places is not None:
            n, each = len(task.places), result["seconds"] / len(task.places)
            counts: Counter[str] = Counter()
            with self.hold:
                for row in result["rows"]:
                    self.journal.add_points(*task.keys, self.tokens, row, each * (len(row[0]) // 8))
                    counts += lines.count(serialize.load(row[1])["status"][:, self.columns])
            weight = n / (n + min(self.measured, 20 * n))
            self.cost += weight * (each - self.cost)
            self.measured += n
            assert task.work is not None
            self.costs.add(task.work.number, task.places, result["seconds"], task.probe)
            if task.work.number not in self.costs.probed and self.costs.left(task.work.number) > _LONG:
                self.queue.probe(task.work)
            self.listen("chunk", {**event, "points": n, "counts": dict(counts)})
            return []
        outcome, reason, data = result["outcome"], result["reason"], result["data"]
        seen = self.plan.last_block() if task.work is None else 0
        with self.hold:
            self.journal.add_result(*task.keys, Result(outcome, reason, seen, data), result["seconds"])
        lost = len(task.work.missing) if task.name == "atlas" and outcome != "ok" and task.work else 0
        if lost and task.work:
            self.costs.give_up(task.work.number)
        self.listen("task", {**event, "outcome": outcome, "reason": reason, "lost": lost})
        return self.lean(task.work, (data,)) if task.name == "atlas" and outcome == "ok" and task.work else []

    def over_study(self, ran: bool) -> list[Task]:
        """Tasks over the whole study, inputs first."""
        return [
            Task(name, keys, params=graph.study_params(self.study, name))
            for name, (keys, _) in self.plan.over_study(ran).items()
        ]

    def with_inputs(self, task: Task) -> Task:
        """A task over the study with everything it reads: a dict of arrays per line, then tables."""
        layer = self.plan.layers[task.name]
        reads = READS.get(task.name, self.plan.variables)
        names = [v for v in reads if v in VARIABLES and v not in ("status", "reason")]
        slopes = self.study.slope[:: math.ceil(len(self.study.slope) / _READ)]
        inputs = []
        for i in range(self.study.lines):
            keys = graph.line_keys(self.study, self.plan.layers, self.study.line(i))
            found: dict[str, Any] = {}
            if "points" in layer.needs:
                found = lines.line(self.journal, keys, self.plan.want, self.study, names, slopes)
            for need in layer.needs:
                if need != "points" and self.plan.layers[need].per_line:
                    stored = self.journal.result(keys[need][0])
                    found |= serialize.load(stored.data) if stored and stored.outcome == "ok" else {}
            inputs.append(serialize.dump(found))
        return Task(task.name, task.keys, None, None, (*inputs, *self._tables(layer)), task.params)

    def _tables(self, layer: graph.Layer) -> Iterator[bytes]:
        for need in layer.needs:
            if not self.plan.layers[need].per_line:
                stored = self.journal.result(self.plan.study_keys()[need][0])
                yield stored.data if stored and stored.outcome == "ok" else serialize.dump({})


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
