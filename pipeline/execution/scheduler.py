"""The order in which the jobs of a plan run; executors differ only in where joblib sends a job.

Results are kept in the journal as they arrive, in any order.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline import serialize
from pipeline.errors import GaitsweepError, WorkerError
from pipeline.execution.estimates import Costs
from pipeline.execution.executors import NOOP_JOB, Engine
from pipeline.execution.worker_process import Request
from pipeline.plan import graph
from pipeline.plan.missing import LineWork, Plan, golden_ratio_order
from pipeline.store import lines
from pipeline.store.journal import Result, TaskKey
from tasks.registry import GAITS, READS, SECONDS_PER_PROOF, VARIABLES

_TARGET_SECONDS = 1.0  # work in a chunk [s]
_MAX_CHUNK = 32768  # points in a chunk: this bounds the memory of a worker
_CHUNKS_PER_WORKER = 4  # chunks for each worker at least, where there is enough work
_MIN_SECONDS = 0.25  # less work than this is not divided [s]
_FIRST_CHUNK = 256  # points in a chunk until costs are measured
_MAX_OPEN_LINES, _MAX_OPEN_POINTS = 32, 1_000_000  # limits on lines at work and their points
_PROBED_SECONDS = 10.0  # lines that take longer are probed [s]
_WHOLE_TASK_FACTOR = 60  # a task over a line or study may take this many times the limit of a point
_JOBS_PER_WORKER = 4  # jobs submitted or not yet read, for each worker
_IDLE_TIMEOUT = 2.0  # a process on a cluster ends after waiting this long [s]: it cannot see the end of a run
_MAX_SLOPES = 20_000  # slopes of a line that a task over the study reads, evenly spaced
_MIN_LINES, _MAX_LINES = 16, 64  # short lines in a block: enough to fill registers, few enough to show progress
_MAX_RETRIES = 3  # consecutive restarts of a broken engine
_Listener = Callable[[str, dict[str, Any]], None]


@dataclass
class Job:
    """A task over one line, over a chunk of its points (`indices` of slopes), or, without `work`, over the study.

    With `block` it is the atlas and all points of several short lines.
    """

    name: str
    keys: TaskKey
    params: Mapping[str, Any]
    work: LineWork | None = None
    block: tuple[LineWork, ...] = ()
    inputs: tuple[bytes, ...] = ()
    indices: np.ndarray | None = None
    probe: bool = False


class JobQueue:
    """Jobs that are ready, chunks of points before new lines. Any thread may take one."""

    def __init__(self, scheduler: Scheduler, lines: Iterator[LineWork]):
        self.scheduler, self.lines, self.exhausted = scheduler, lines, False
        self.ready: deque[Job] = deque()
        self.running: dict[int, Job] = {}
        self.numbers = itertools.count()
        self.lock = threading.Lock()

    def __bool__(self) -> bool:
        return bool(self.ready) or not self.exhausted

    def __iter__(self) -> Iterator[tuple[int, Request | None]]:
        return self

    def __next__(self) -> tuple[int, Request | None]:
        with self.lock:
            while not self.exhausted and (not self.ready or self._opens_line()):
                works = list(itertools.islice(self.lines, self.scheduler.lines_at_once))
                self.exhausted = not works
                self.ready.extend(self.scheduler.open_lines(works))
            if len(self.running) >= _JOBS_PER_WORKER * self.scheduler.engine.jobs:
                raise StopIteration  # joblib runs ahead of a slow reader, and its backlog takes memory
            if not self.ready and self.running:
                return NOOP_JOB, None  # an exhausted iterator is never asked again; a running job may add more
            if not self.ready:
                raise StopIteration
            job = self.ready.popleft()
            if job.indices is not None and len(job.indices) > (size := self.scheduler.chunk_size(job)):
                self.ready.appendleft(dataclasses.replace(job, indices=job.indices[size:]))
                job.indices = job.indices[:size]
            number = next(self.numbers)
            self.running[number] = job
            return number, self.scheduler.request(job)

    def _opens_line(self) -> bool:
        """Whether to open another line before those at work are done, to measure costs early."""
        costs = self.scheduler.costs
        return (
            len(self.ready) < _MAX_OPEN_LINES
            and len(costs.lines) < _MAX_OPEN_LINES
            and costs.open_points() < _MAX_OPEN_POINTS
        )

    def add(self, jobs: list[Job]) -> None:
        """Put jobs in front, except that of several chunks of points only the first goes in front."""
        with self.lock:
            points = [job for job in jobs if job.indices is not None]
            self.ready.extendleft(reversed([job for job in jobs if job.indices is None] + points[:1]))
            self.ready.extend(points[1:])

    def probe(self, work: LineWork) -> None:
        """Solve a few points of every region of a line first, so that its remaining cost can be estimated."""
        with self.lock:
            blocks = [job for job in self.ready if job.work is work and job.indices is not None]
            if blocks:
                indices = np.sort(np.concatenate([job.indices for job in blocks if job.indices is not None]))
                probes, remainder = self.scheduler.costs.probes(work.number, indices)
                self.ready = deque(job for job in self.ready if not any(job is block for block in blocks))
                self.ready.extend(
                    dataclasses.replace(blocks[0], indices=p)
                    for p in (remainder[k] for k in golden_ratio_order(len(remainder)))
                )
                self.ready.extendleft(dataclasses.replace(blocks[0], indices=p, probe=True) for p in probes)

    def requeue(self) -> None:
        """Return running jobs to the front after their engine broke."""
        with self.lock:
            self.ready.extendleft(self.running.values())
            self.running = {}


class Scheduler:
    """One run of one plan.

    Parameters
    ----------
    plan : Plan
    engine : Engine
    listen : callable
        Receives the name of each event and its details.
    points : int
        Number of points to solve.
    chunk : int, optional
        Points in a chunk; by default about a second of work.
    hold : context manager, optional
        Entered while a result is written to the journal.
    """

    def __init__(
        self,
        plan: Plan,
        engine: Engine,
        listen: _Listener,
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
        self.points_measured = 0
        #: Lines that are opened together; more than one where short lines are computed side by side.
        self.lines_at_once = 1
        if "points" in plan.layers and graph.is_short(self.study):
            share = math.ceil(self.study.lines / (engine.jobs * _CHUNKS_PER_WORKER))
            self.lines_at_once = min(_MAX_LINES, max(share, _MIN_LINES))
        # Atlases of short lines are kept only for those that read them.
        self.keeps_atlas = any("atlas" in layer.needs for name, layer in plan.layers.items() if name != "points")
        self.costs = Costs(len(self.study.slope), points, self.cost)

    def run(self) -> None:
        """Run everything the plan names.

        Raises
        ------
        WorkerError
            If workers or the cluster cannot be kept alive.
        """
        queue = JobQueue(self, self.plan.lines())
        self.queue = queue
        broken, done = 0, 0
        study_jobs: deque[Job] | None = None
        while True:
            try:
                with self.engine.parallel() as parallel:
                    while True:
                        while queue:
                            for number, result in parallel(queue):
                                if number == NOOP_JOB:
                                    continue
                                done, broken = done + 1, 0
                                queue.add(self._record(queue.running.pop(number), result))
                        if study_jobs is None:
                            study_jobs = deque(self._study_jobs(done > 0))
                        if not study_jobs:
                            return
                        queue.add([self._add_inputs(study_jobs.popleft())])
            except (GaitsweepError, KeyboardInterrupt):
                raise
            except Exception as error:
                if self.engine.address is None:
                    raise
                broken += 1
                if broken > _MAX_RETRIES:
                    raise WorkerError(f"Workers cannot be kept alive: {_one_line(error)}.") from error
                self.listen("engine", {"error": _one_line(error)})
                time.sleep(broken)
                queue.requeue()

    def open_lines(self, works: list[LineWork]) -> list[Job]:
        """First jobs of lines: one for all short lines of which nothing is solved, and those of each other line."""
        jobs: list[Job] = []
        together: list[LineWork] = []
        for work in works:
            if self.lines_at_once > 1 and "atlas" in work.why and len(work.missing) == len(self.study.slope):
                self.costs.open_line(work.number, work.missing)
                together.append(work)
            else:
                jobs += self.open_line(work)
        if together:
            task = self.plan.layers["atlas"].task
            params = {"lines": [work.line for work in together], **self.study.options}
            jobs.append(Job(task.name, together[0].keys["atlas"], params, block=tuple(together)))
        return jobs

    def open_line(self, work: LineWork) -> list[Job]:
        """First jobs of a line: its atlas, or the jobs that depend on it."""
        self.costs.open_line(work.number, work.missing)
        if "atlas" in work.why:
            return [self._line_job("atlas", work)]
        atlas = self.journal.result(work.keys["atlas"].key) if "atlas" in work.keys else None
        return self._dependent_jobs(work, (atlas.data,) if atlas else ())

    def _dependent_jobs(self, work: LineWork, inputs: tuple[bytes, ...]) -> list[Job]:
        """Jobs of a line that depend on its atlas; chunks of points come in an order that samples the line."""
        jobs = self._other_jobs(work, inputs)
        if not len(work.missing):
            return jobs
        parts = np.array_split(work.missing, math.ceil(len(work.missing) / self.chunk_size()))
        pieces = [parts[k] for k in golden_ratio_order(len(parts))]
        if len(work.missing) * self.cost > _TARGET_SECONDS:  # a probe of the line before the next ones are opened
            pieces[:1] = filter(len, (pieces[0][:_FIRST_CHUNK], pieces[0][_FIRST_CHUNK:]))
        points = self._line_job("points", work, inputs)
        return jobs + [dataclasses.replace(points, indices=piece) for piece in pieces]

    def _other_jobs(self, work: LineWork, inputs: tuple[bytes, ...]) -> list[Job]:
        """Jobs of a line beside its atlas and points."""
        return [self._line_job(name, work, inputs) for name in work.why if name not in ("atlas", "points")]

    def _line_job(self, name: str, work: LineWork, inputs: tuple[bytes, ...] = ()) -> Job:
        return Job(name, work.keys[name], graph.line_params(self.study, name, work.line), work, inputs=inputs)

    def chunk_size(self, job: Job | None = None) -> int:
        """Points in the next chunk: about a second of work, less where workers would otherwise be idle."""
        if self.chunk:
            return self.chunk
        cost = self.cost
        if job and job.work and job.indices is not None and job.work.number in self.costs.probed:
            cost = self.costs.cost_per_point(job.work.number)[self.costs.region(job.indices[0])] or cost
        if job and not self.points_measured:
            return _FIRST_CHUNK
        share = self.points * self.cost / (self.engine.jobs * _CHUNKS_PER_WORKER)
        seconds = min(_TARGET_SECONDS, max(_MIN_SECONDS, share), self.study.limits.seconds / 4)
        return max(1, min(_MAX_CHUNK, int(seconds / cost)))

    def request(self, job: Job) -> Request:
        """Request to a worker process for a job."""
        layer, limits = self.plan.layers[job.name], self.study.limits
        params = dict(job.params)
        divided = "lines" if job.block else "slope" if job.indices is not None else ""
        if divided:
            slopes = self.study.slope if job.indices is None else self.study.slope[job.indices]
            params |= {"slope": slopes, "want": self.plan.variables, "gaits": self.study.gaits}
        function = layer.task.side_by_side if job.block else layer.task.function
        seconds = limits.seconds * (1 if divided == "slope" else _WHOLE_TASK_FACTOR)
        idle = None if self.engine.address is None else _IDLE_TIMEOUT
        return Request(function, params, list(job.inputs), divided, seconds, limits.memory, idle)

    def _record(self, job: Job, result: dict[str, Any]) -> list[Job]:
        """Store a result and return the jobs that it makes ready."""
        if job.block:
            return self._record_lines(job, result)
        event = {
            "task": job.name,
            "line": job.work.number if job.work else None,
            "seconds": result["seconds"],
            "pid": result["pid"],
            "worker": result.get("worker"),
        }
        if job.work and job.indices is not None:
            counts = self._record_points(job, job.work, job.indices, result)
            self.listen("chunk", {**event, "points": len(job.indices), "counts": dict(counts)})
            return []
        outcome, reason, data = result["outcome"], result["reason"], result["data"]
        seen = self.plan.last_block() if job.work is None else 0
        with self.hold:
            self.journal.add_result(*job.keys, Result(outcome, reason, seen, data), result["seconds"])
        unsolved = 0
        if job.work and job.name == "atlas" and outcome != "ok":
            unsolved = len(job.work.missing)
            self.costs.abandon(job.work.number)
        self.listen("task", {**event, "outcome": outcome, "reason": reason, "lost": unsolved})
        return self._dependent_jobs(job.work, (data,)) if job.name == "atlas" and outcome == "ok" and job.work else []

    def _record_lines(self, job: Job, result: dict[str, Any]) -> list[Job]:
        """Store the atlases and points of a block of lines; a line that failed is tried again, step by step."""
        jobs: list[Job] = []
        seconds = result["seconds"] / len(job.block)
        for work, parts in zip(job.block, result["lines"], strict=True):
            if parts is None:
                jobs.append(self._line_job("atlas", work))
                continue
            shared = {key: result.get(key) for key in ("pid", "worker")} | {"line": work.number, "seconds": seconds}
            if self.keeps_atlas:
                with self.hold:
                    self.journal.add_result(*work.keys["atlas"], Result("ok", "", 0, parts[0]), 0.0)
            self.listen("task", {**shared, "task": "atlas", "seconds": 0.0, "outcome": "ok", "reason": "", "lost": 0})
            points = self._line_job("points", work)
            row = (self.study.slope[work.missing].tobytes(), *parts[1:])
            counts = self._record_points(points, work, work.missing, {"rows": [row], "seconds": seconds})
            self.listen("chunk", {**shared, "task": "points", "points": len(work.missing), "counts": dict(counts)})
            jobs += self._other_jobs(work, (parts[0],))
        return jobs

    def _record_points(self, job: Job, work: LineWork, indices: np.ndarray, result: dict[str, Any]) -> Counter[str]:
        """Store a chunk of points, update the costs and return the points by outcome."""
        n, cost = len(indices), result["seconds"] / len(indices)
        counts: Counter[str] = Counter()
        with self.hold:
            for row in result["rows"]:
                self.journal.add_points(*job.keys, self.tokens, row, cost * (len(row[0]) // 8))
                counts += lines.count(serialize.load(row[1])["status"][:, self.columns])
        weight = n / (n + min(self.points_measured, 20 * n))
        self.cost += weight * (cost - self.cost)
        self.points_measured += n
        self.costs.add(work.number, indices, result["seconds"], job.probe)
        if work.number not in self.costs.probed and self.costs.seconds_left(work.number) > _PROBED_SECONDS:
            self.queue.probe(work)
        return counts

    def _study_jobs(self, ran: bool) -> list[Job]:
        """Jobs over the whole study, inputs first."""
        return [
            Job(name, keys, graph.study_params(self.study, name))
            for name, (keys, _) in self.plan.over_study(ran).items()
        ]

    def _add_inputs(self, job: Job) -> Job:
        """A job over the study with its inputs: a dict of arrays for each line, then tables."""
        layer = self.plan.layers[job.name]
        reads = READS.get(job.name, self.plan.variables)
        names = [v for v in reads if v in VARIABLES and v not in ("status", "reason")]
        slopes = self.study.slope[:: math.ceil(len(self.study.slope) / _MAX_SLOPES)]
        inputs = []
        for i in range(self.study.lines):
            keys = graph.line_keys(self.study, self.plan.layers, self.study.line(i))
            columns: dict[str, Any] = {}
            if "points" in layer.needs:
                columns = lines.line(self.journal, keys, self.plan.want, self.study, names, slopes)
            for need in layer.needs:
                if need != "points" and self.plan.layers[need].per_line:
                    stored = self.journal.result(keys[need].key)
                    columns |= serialize.load(stored.data) if stored and stored.outcome == "ok" else {}
            inputs.append(serialize.dump(columns))
        return dataclasses.replace(job, inputs=(*inputs, *self._tables(layer)))

    def _tables(self, layer: graph.Layer) -> Iterator[bytes]:
        for need in layer.needs:
            if not self.plan.layers[need].per_line:
                stored = self.journal.result(self.plan.study_keys()[need].key)
                yield stored.data if stored and stored.outcome == "ok" else serialize.dump({})


def _one_line(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
