"""Points of open lines, and the jobs that they are divided into."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable

import numpy as np

from pipeline.execution.archive_chunks import MAX_EXCESS, TARGET_SECONDS, ArchiveChunks
from pipeline.execution.estimates import Costs
from pipeline.execution.job import Job
from pipeline.plan.missing import LineWork, golden_ratio_order


class PointQueue:
    """Jobs of points of open lines.

    Parameters
    ----------
    costs : Costs
    chunks : ArchiveChunks
    size : callable
        Points in the next part of a job; without a job, of any.

    Attributes
    ----------
    jobs : deque of Job
        May be larger than a worker should take at once.
    """

    def __init__(self, costs: Costs, chunks: ArchiveChunks, size: Callable[[Job | None], int]):
        self.costs, self.chunks, self.size = costs, chunks, size
        self.jobs: deque[Job] = deque()

    def open(self, points: Job, missing: np.ndarray, first: int) -> None:
        """Divide the points of a line, in an order that samples it; only the first part goes in front.

        Parameters
        ----------
        points : Job
            Over the line.
        missing : ndarray of int, shape (n,)
            Indices of the slopes to solve.
        first : int
            Points in a first part, a probe of the line before others are opened; 0 if none is needed.
        """
        parts = self.chunks.divide(missing, self.size(None))
        pieces = [parts[k] for k in golden_ratio_order(len(parts))]
        if first:
            pieces[:1] = filter(len, (pieces[0][:first], pieces[0][first:]))
        self.jobs.appendleft(dataclasses.replace(points, indices=pieces[0]))
        self.jobs.extend(dataclasses.replace(points, indices=piece) for piece in pieces[1:])

    def take(self) -> tuple[Job, int]:
        """Take the next job, and its number of points."""
        job = self.jobs.popleft()
        if self._is_expensive(job):
            self._divide_expensive(job)
            job = self.jobs.popleft()
        assert job.indices is not None
        n = self.chunks.cut(job.indices, self.size(job))
        if len(job.indices) > n:
            self.jobs.appendleft(dataclasses.replace(job, indices=job.indices[n:]))
        return dataclasses.replace(job, indices=job.indices[:n]), n

    def _is_expensive(self, job: Job) -> bool:
        """Whether a chunk of the archive takes too long for a job, and its points may differ in cost."""
        if not self.chunks.extent or job.indices is None or not job.work or job.work.number not in self.costs.probed:
            return False
        regions = self.costs.region(job.indices[: self.chunks.extent])
        seconds = self.costs.cost_per_point(job.work.number)[regions].sum()
        return bool(regions[0] < regions[-1] and seconds > MAX_EXCESS * TARGET_SECONDS)

    def _divide_expensive(self, job: Job) -> None:
        """Divide the expensive chunks of a line by region, in an order that samples them."""
        expensive = [job, *(each for each in self.jobs if each.work is job.work and self._is_expensive(each))]
        self.jobs = deque(each for each in self.jobs if not any(each is other for other in expensive))
        pieces = self.costs.by_region(_joined(expensive), parts=2)
        _, *order = golden_ratio_order(len(pieces))
        self.jobs.extend(dataclasses.replace(job, indices=pieces[k]) for k in (*order, 0))

    def probe(self, work: LineWork) -> None:
        """Solve a few points of every region of a line first, so that its remaining cost can be estimated."""
        jobs = [job for job in self.jobs if job.work is work]
        if jobs:
            probes, remainder = self.costs.probes(work.number, _joined(jobs))
            if remainder and self.chunks.extent:
                remainder = self.chunks.divide(np.concatenate(remainder), self.size(None))
            self.jobs = deque(job for job in self.jobs if job.work is not work)
            order = golden_ratio_order(len(remainder))
            self.jobs.extend(dataclasses.replace(jobs[0], indices=remainder[k]) for k in order)
            self.jobs.extendleft(dataclasses.replace(jobs[0], indices=probe, probe=True) for probe in probes)


def _joined(jobs: list[Job]) -> np.ndarray:
    """Indices of all points of jobs of one line, in ascending order."""
    parts = [job.indices for job in jobs if job.indices is not None]
    return np.sort(np.concatenate(parts), kind="stable")  # a part may lie in a gap of another
