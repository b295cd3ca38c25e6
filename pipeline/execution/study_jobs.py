"""Jobs of one study: which are ready, what a worker is asked, and how its answer is recorded."""

from __future__ import annotations

import contextlib
import dataclasses
import heapq
import math
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from pipeline.archive import layout
from pipeline.errors import StoppedError
from pipeline.execution.account import Account
from pipeline.execution.archive_chunks import CHUNKS_PER_WORKER, TARGET_SECONDS, ArchiveChunks, seconds_of_chunk
from pipeline.execution.estimates import Costs
from pipeline.execution.executors import Engine
from pipeline.execution.job import Job
from pipeline.execution.point_queue import PointQueue
from pipeline.execution.recording import store_points
from pipeline.execution.worker_process import Request
from pipeline.plan import graph
from pipeline.plan.costs import seconds as seconds_of
from pipeline.plan.costs import seconds_after
from pipeline.plan.inputs import study_inputs
from pipeline.plan.missing import BlockWork, LineWork, Plan
from pipeline.store import lines
from pipeline.store.finished import status_rows
from pipeline.store.rows import Result
from tasks.registry import GAITS, SECONDS_PER_PROOF

_MAX_CHUNK = 32768  # points in a chunk: this bounds the memory of a worker
_FIRST_CHUNK = 256  # points in a chunk until costs are measured
_MAX_OPEN_LINES, _MAX_OPEN_POINTS = 32, 1_000_000  # limits on lines at work and their points
_PROBED_SECONDS = 10.0  # lines that take longer are probed [s]
_WHOLE_TASK_FACTOR = 60  # a task over a line or study may take this many times the limit of a point
_IDLE_TIMEOUT = 2.0  # a process on a cluster ends after waiting this long [s]: it cannot see the end of a run
_MIN_LINES = 16  # short lines in a job: enough to fill registers
Listener = Callable[[str, dict[str, Any]], None]


class StudyJobs:
    """Jobs of one study, in waves: those of a wave depend only on earlier ones.

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

    Attributes
    ----------
    next : Job or None
        The next job of the present wave.
    has_knees : bool
        Whether any walker has.
    taken, recorded : int
        Jobs taken, by the thread of an executor, and recorded or put back.
    error : Exception or None
        What ended the study.
    """

    def __init__(
        self,
        plan: Plan,
        engine: Engine,
        listen: Listener,
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
        self.has_knees = any(check["multipliers"] > 3 for check in self.study.checks)
        self.points_measured = 0
        can_finish = layer and not plan.blocks
        extent = layout.line_extent(layout.Grid(self.study).sizes) if can_finish else 0
        self.chunks = ArchiveChunks(len(self.study.slope), extent)
        self.plane = self.study.plane if graph.over_plane(self.study) else None
        #: Lines of a block in one job: fewer than it has where workers would otherwise be idle.
        self.lines_at_once = max(_MIN_LINES, math.ceil(self.study.lines / (engine.jobs * CHUNKS_PER_WORKER)))
        self.costs = Costs(len(self.study.slope), points, self.cost)
        #: Whether points cost the same at every slope, and so little that measuring them first would cost more.
        self._is_even = graph.is_interpolated(self.study)
        self._seconds_after = seconds_after(self.study, plan.layers)
        self.account = Account()
        self.next: Job | None = None
        self.taken = self.recorded = 0
        self.error: Exception | None = None
        self._waves = self._all_waves()
        self._wave: Iterator[Job] = iter(())
        self._returned: deque[Job] = deque()
        self._lock = threading.RLock()  # held while a job is taken, by the thread of an executor, or returns
        self._ran = False
        self._failed: list[int] = []  # numbers of lines that failed in their blocks
        self._alone: set[int] = set()  # numbers of lines of blocks that are computed by themselves
        self._open: deque[int] = deque()  # numbers of lines whose jobs besides the atlas are due
        self._queue = PointQueue(self.costs, self.chunks, self.chunk_size)  # points of open lines
        self._to_probe: dict[int, LineWork] = {}

    @property
    def is_over(self) -> bool:
        """Whether no job is left."""
        return self.next is None and self.taken == self.recorded

    @property
    def urgency(self) -> float:
        """Estimated time [s] of the next job and of what depends on it."""
        job = self.next  # which may be None a moment later, if a study ends
        return job.seconds + self._seconds_after[job.name] if job else -math.inf

    def advance(self) -> None:
        """Begin the next wave that has a job, once all jobs of the present one are recorded."""
        try:
            while self.is_over and not self.error:
                self._wave = next(self._waves)
                self.next = next(self._wave, None)
        except StopIteration:
            pass
        except StoppedError:
            raise
        except Exception as error:
            self.fail(error)

    def take(self) -> tuple[Job, Request] | None:
        """Take the next job and its request; None if the study has ended, or this fails, which ends it."""
        with self._lock:
            job = self.next
            if job is None:  # what was recorded meanwhile has ended the study
                return None
            try:
                request = self.request(job)
                following = self._returned.popleft() if self._returned else next(self._wave, None)
            except StoppedError:
                raise
            except Exception as error:
                self.fail(error)
                return None
            self.taken += 1
            self.next = following
            return job, request

    def put_back(self, job: Job) -> None:
        """Return a job that was taken and lost."""
        with self._lock:
            self.recorded += 1
            if self.error:
                return
            if self.next:
                self._returned.append(self.next)
            self.next = job

    def fail(self, error: Exception) -> None:
        """End the study with an error; results of its running jobs are dropped."""
        with self._lock:
            self.error, self.next, self._wave, self._waves = error, None, iter(()), iter(())
            self._returned.clear()

    def _all_waves(self) -> Iterator[Iterator[Job]]:
        """Waves in order; each is laid out when those before it are recorded."""
        yield self._first_jobs()
        while self._failed:
            failed, self._failed = self._failed, []
            yield (self._line_job("atlas", self.plan.line(number)) for number in failed)
        depths, over_study = graph.depths(self.plan.layers), self.plan.over_study(self._ran)
        for depth in range(1, 1 + max(1, *depths.values())):
            study_jobs = (
                Job(self, name, keys, graph.study_params(self.study, name), seconds=seconds_of(self.study, name))
                for name, (keys, _) in over_study.items()
                if max(1, depths[name]) == depth
            )
            dependent = self._dependent_jobs() if depth == 1 else iter(())
            yield heapq.merge(study_jobs, dependent, key=lambda job: -job.seconds)

    def _first_jobs(self) -> Iterator[Job]:
        """Blocks of short lines, and atlases of lines that are computed by themselves."""
        for work in self.plan.works():
            self._ran = True
            if isinstance(work, BlockWork):
                # Dividing the lines of a cell would make its patches twice.
                parts = np.array_split(work.lines, 1 if self.plane else math.ceil(len(work.lines) / self.lines_at_once))
                yield from (self._block_job(dataclasses.replace(work, lines=part)) for part in parts)
                continue
            if self.plan.blocks and len(work.missing):
                self._alone.add(work.number)
            if "atlas" in work.why:
                yield self._line_job("atlas", work)
            else:
                self._open.append(work.number)

    def _block_job(self, work: BlockWork) -> Job:
        assert self.plan.blocks
        self.costs.open_line(int(work.lines[0]), self._indices(work))
        task = self.plan.layers["atlas"].task
        params: dict[str, Any] = {
            "lines": [self.study.line(number) for number in work.lines.tolist()],
            "digests": self.plan.blocks.digests(work.lines),
            "atlases": "atlas" in self.plan.line_tasks,
            **graph.point_params(self.study),
        }
        if self.plane:
            params["cell"] = self.plane.cell(params["lines"][0]["set"])
        seconds = len(work.lines) * (seconds_of(self.study, "atlas") + len(self.study.slope) * self.cost)
        return Job(self, task.name, work.key, params, block=work, seconds=seconds)

    def _indices(self, work: BlockWork) -> np.ndarray:
        return np.tile(np.arange(len(self.study.slope)), len(work.lines))

    def _dependent_jobs(self) -> Iterator[Job]:
        """Jobs of open lines; lines are opened before those at work are done, to measure costs early."""
        while self._open or self._queue.jobs:
            while self._open and (not self._queue.jobs or self._opens_line()):
                number = self._open.popleft()
                work = self.plan.line(number, with_points=not self.plan.blocks or number in self._alone)
                atlas = self.journal.result(work.keys["atlas"].key) if "atlas" in work.keys else None
                inputs = (atlas.data,) if atlas else ()
                yield from (self._line_job(name, work, inputs) for name in work.why if name not in ("atlas", "points"))
                if len(work.missing):
                    self._open_line(work, inputs)
            while self._to_probe:
                number, work = self._to_probe.popitem()
                if number not in self.costs.probed:  # a result may ask for it again while it is being done
                    self._queue.probe(work)
            if self._queue.jobs:
                job, n = self._queue.take()
                yield dataclasses.replace(job, seconds=n * self.cost)

    def _opens_line(self) -> bool:
        costs = self.costs
        return (
            len(self._queue.jobs) < _MAX_OPEN_LINES
            and len(costs.lines) < _MAX_OPEN_LINES
            and costs.open_points() < _MAX_OPEN_POINTS
        )

    def _open_line(self, work: LineWork, inputs: tuple[bytes, ...]) -> None:
        self.costs.open_line(work.number, work.missing)
        is_long = not self._is_even and len(work.missing) * self.cost > TARGET_SECONDS
        points = self._line_job("points", work, inputs)
        self._queue.open(points, work.missing, _FIRST_CHUNK if is_long else 0)

    def _line_job(self, name: str, work: LineWork, inputs: tuple[bytes, ...] = ()) -> Job:
        params, seconds = graph.line_params(self.study, name, work.line), seconds_of(self.study, name)
        missing, work = len(work.missing), dataclasses.replace(work, missing=np.arange(0))  # many jobs may wait
        return Job(self, name, work.keys[name], params, work, missing=missing, inputs=inputs, seconds=seconds)

    def chunk_size(self, job: Job | None = None) -> int:
        """Points in the next chunk: about a second of work, less where workers would otherwise be idle."""
        if self.chunk:
            return self.chunk
        if job and not (self.points_measured or self._is_even):
            return _FIRST_CHUNK
        seconds = seconds_of_chunk(self.points * self.cost / self.engine.jobs, self.study.limits.seconds)
        size = seconds / self.cost
        if job and job.work and job.indices is not None and job.work.number in self.costs.probed:
            regions = self.costs.region(job.indices[: self.chunks.extent or 1])
            size = seconds / (self.costs.cost_per_point(job.work.number)[regions].mean() or self.cost)
        return max(1, min(_MAX_CHUNK, int(size)))

    def request(self, job: Job) -> Request:
        """Request to a worker process for a job."""
        layer, limits = self.plan.layers[job.name], self.study.limits
        params = dict(job.params)
        divided = "lines" if job.block else "slope" if job.indices is not None else ""
        whole = None if job.indices is None else self.chunks.whole(job.indices)
        if divided:
            part = job.indices if whole is None else whole
            slopes = self.study.slope if part is None else self.study.slope[part]
            params |= {"slope": slopes, "want": self.plan.variables, "gaits": self.study.gaits}
        together = layer.task.over_plane if self.plane else layer.task.side_by_side
        function = together if job.block else layer.task.function
        seconds = limits.seconds * (1 if divided == "slope" else _WHOLE_TASK_FACTOR)
        idle = None if self.engine.address is None else _IDLE_TIMEOUT
        inputs = job.inputs if job.work or job.block else study_inputs(self.plan, job.name)
        multipliers = max(check["multipliers"] for check in self.study.checks)
        chunk = None if whole is None else (self.chunks.extent, multipliers)
        return Request(function, params, list(inputs), divided, seconds, limits.memory, idle, chunk)

    def record(self, job: Job, result: dict[str, Any]) -> None:
        """Store the result of a job."""
        self.recorded += 1
        self.account.add(result)
        try:
            if self.error:
                return
            if job.block:
                self._record_block(job, job.block, result)
            elif job.work and job.indices is not None:
                self._record_points(job, job.work, job.indices, result)
            else:
                self._record_task(job, result)
        except StoppedError:
            raise
        except Exception as error:
            self.fail(error)

    def _record_task(self, job: Job, result: dict[str, Any]) -> None:
        outcome, reason = result["outcome"], result["reason"]
        seen = self.journal.last_block() if job.work is None else 0
        with self.hold:
            self.journal.add_result(*job.keys, Result(outcome, reason, seen, result["data"]), result["seconds"])
        lost = 0
        if job.work and job.name == "atlas":
            if outcome == "ok":
                self._open.append(job.work.number)
            else:
                lost = job.missing
                with self._lock:
                    self.costs.points -= lost
        self.listen("task", {**_event(job, result), "outcome": outcome, "reason": reason, "lost": lost})

    def _record_block(self, job: Job, block: BlockWork, result: dict[str, Any]) -> None:
        """Store the points and atlases of lines of a block; a line that failed is tried again, step by step."""
        failed = np.isin(np.arange(len(block.lines)), result["failed"])
        indices, n = self._indices(block), len(self.study.slope)
        solved = len(block.lines) - int(failed.sum())
        with self.hold:
            for k, atlas in result["atlases"]:
                keys = self.plan.line_keys(int(block.lines[k]))["atlas"]
                self.journal.add_result(*keys, Result("ok", "", 0, atlas), 0.0)
            counts = self._store(job, result, len(indices))
        if solved:
            self._measure(int(block.lines[0]), indices[: solved * n], result["seconds"])
        if failed.any():
            with self._lock:
                self.costs.reopen(int(block.lines[0]), indices[solved * n :])
            self._failed += block.lines[failed].tolist()
            self._alone.update(self._failed)
        if set(self.plan.line_tasks) - {"atlas"}:
            self._open.extend(block.lines[~failed].tolist())
        shared = {key: result.get(key) for key in ("seconds", "pid", "worker")}
        line, points = int(block.lines[0]), solved * n
        event = {"task": "points", "line": line, "lines": solved, "points": points, "counts": dict(counts)}
        self.listen("chunk", {**shared, **event})

    def _store(self, job: Job, result: dict[str, Any], n: int) -> Counter[str]:
        cost = result["seconds"] / n
        return store_points(self.journal, job.keys, self.tokens, self.columns, result, cost)

    def _measure(self, line: int, indices: np.ndarray, seconds: float, probe: bool = False) -> None:
        n, cost = len(indices), seconds / len(indices)
        weight = n / (n + min(self.points_measured, 20 * n))
        self.cost += weight * (cost - self.cost)
        self.points_measured += n
        self.costs.add(line, indices, seconds, probe)

    def _solved_before(self, job: Job, indices: np.ndarray) -> Counter[str]:
        """Points by outcome that a job solves again, to finish their chunk."""
        whole = self.chunks.whole(indices)
        if whole is None or whole.stop - whole.start == len(indices):
            return Counter()
        again = np.setdiff1d(np.arange(whole.start, whole.stop), indices, assume_unique=True)
        status, *_ = lines.states(self.journal, job.keys.key, self.tokens, self.study.slope[again])
        return lines.count(status_rows(status), self.columns)

    def _record_points(self, job: Job, work: LineWork, indices: np.ndarray, result: dict[str, Any]) -> None:
        """Store a chunk of points and update the costs."""
        before = self._solved_before(job, indices)
        with self.hold:
            counts = self._store(job, result, len(indices)) - before
        self._measure(work.number, indices, result["seconds"], job.probe)
        is_long = not self._is_even and self.costs.seconds_left(work.number) > _PROBED_SECONDS
        if is_long and work.number not in self.costs.probed:
            self._to_probe[work.number] = work  # workers may return several of its jobs before that is done
        self.listen("chunk", {**_event(job, result), "points": len(indices), "counts": dict(counts)})


def _event(job: Job, result: dict[str, Any]) -> dict[str, Any]:
    line = job.work.number if job.work else None
    return {"task": job.name, "line": line, **{key: result.get(key) for key in ("seconds", "pid", "worker")}}
