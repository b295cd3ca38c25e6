"""The order in which the jobs of all studies of a command run.

Each study lays out its jobs in waves, of which each depends only on earlier ones: blocks of short lines and atlases of
long ones; chunks of points and other tasks over a line; tasks over the study. The ready jobs of all studies are one
finite generator, which joblib runs; it is made anew while there are ready jobs. Results are recorded as they arrive.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pipeline.errors import GaitsweepError, WorkerError
from pipeline.execution.account import Account
from pipeline.execution.executors import Engine
from pipeline.execution.job import Job
from pipeline.execution.study_jobs import StudyJobs
from pipeline.execution.worker_process import Request

_JOBS_PER_WORKER = 16  # jobs submitted or not yet read, for each worker
_MAX_RETRIES = 3  # consecutive restarts of a broken engine
_MAX_SHARED = 300  # lines of a study that are looked for in others: planes hardly have any in common


class Scheduler:
    """Runs the jobs of several studies.

    Parameters
    ----------
    studies : sequence of StudyJobs
    engine : Engine
    finish : callable, optional
        Called with each study when no job of it is left, while the others go on.
    """

    def __init__(
        self, studies: Sequence[StudyJobs], engine: Engine, finish: Callable[[StudyJobs], None] = lambda study: None
    ):
        self.studies, self.engine, self.finish = list(studies), engine, finish
        self.account = Account()
        self.running: dict[int, Job] = {}
        self._numbers = itertools.count()
        keys = itertools.chain.from_iterable(_keys(study) for study in studies)
        self._uses = {key: n for key, n in Counter(keys).items() if n > 1}  # studies that want each result still
        self._results: dict[str, dict[str, Any] | None] = {}  # of these, None while one is computed
        self._copies: deque[Job] = deque()  # jobs that run for another study
        self._compiling: int | None = None  # number of the first job with knees

    def run(self) -> None:
        """Run everything the studies request.

        Raises
        ------
        WorkerError
            If workers or the cluster cannot be kept alive.
        """
        for study in self.studies:
            study.advance()
        broken = 0
        while self.studies:
            if not any(study.next for study in self.studies):
                self._finish()
                continue
            try:
                with self.engine.parallel() as parallel:
                    while self.studies:
                        with contextlib.closing(parallel(self._ready())) as results:
                            self._finish()
                            for number, result in results:
                                broken = 0
                                self._record(self.running.pop(number), result)
                        self._record_copies()
                        self._finish()
            except (GaitsweepError, KeyboardInterrupt):
                raise
            except Exception as error:
                if self.engine.address is None:
                    raise
                broken += 1
                message = f"{type(error).__name__}: {' '.join(str(error).split())[:200].rstrip('.')}"
                if broken > _MAX_RETRIES:
                    raise WorkerError(f"Workers cannot be kept alive: {message}.") from error
                for study in self.studies:
                    study.listen("engine", {"error": message})
                time.sleep(broken)
                for job in (*self.running.values(), *self._copies):
                    job.study.put_back(job)
                self.running, self._copies = {}, deque()
                self._results = {key: result for key, result in self._results.items() if result}

    def _ready(self) -> Iterator[tuple[int, Request]]:
        """Numbered requests of ready jobs, the most urgent first; joblib asks from its own thread, one at a time.

        They end when none is ready, or when results are read more slowly than they arrive: joblib would keep them all.
        """
        while len(self.running) < _JOBS_PER_WORKER * self.engine.jobs:
            ready = [study for study in list(self.studies) if study.next]  # one may be finished meanwhile
            if not ready:
                return
            study = max(ready, key=lambda study: (not self._waits(study), study.urgency))
            taken = study.take()
            if taken and not self._is_shared(taken[0]):
                number = next(self._numbers)
                self.running[number] = taken[0]
                if study.has_knees and self._compiling is None:
                    self._compiling = number
                yield number, taken[1]

    def _waits(self, study: StudyJobs) -> bool:
        """Whether other studies go first, until one worker has compiled the equations of knees, and all may load them.

        Where there is no cached code it takes a quarter of a minute; other equations take a few seconds.
        """
        return study.has_knees and self._compiling in self.running

    def _is_shared(self, job: Job) -> bool:
        """Whether another study has or gets the same result, which is then copied."""
        if job.keys.key not in self._uses or job.block or job.indices is not None:
            return False
        if job.keys.key in self._results:
            self._copies.append(job)
            return True
        self._results[job.keys.key] = None
        return False

    def _record(self, job: Job, result: dict[str, Any]) -> None:
        self.account.add(result)
        job.study.record(job, result)
        if job.keys.key in self._results and job.indices is None:
            if result["outcome"] == "ok":
                self._results[job.keys.key] = result
                self._count_use(job)
            else:  # limits of studies differ
                del self._results[job.keys.key]
            self._record_copies()
        self._finish()

    def _record_copies(self) -> None:
        for _ in range(len(self._copies)):
            job = self._copies.popleft()
            if job.keys.key not in self._results:
                job.study.put_back(job)
            elif result := self._results[job.keys.key]:
                job.study.record(job, {**result, "seconds": 0.0, "cpu": 0.0, "integrating": 0.0})
                self._count_use(job)
            else:
                self._copies.append(job)

    def _count_use(self, job: Job) -> None:
        """Forget a result once every study has it."""
        key = job.keys.key
        self._uses[key] -= 1
        if not self._uses[key]:
            del self._uses[key], self._results[key]

    def _finish(self) -> None:
        """Begin the next wave of studies whose current one is recorded; finish those without one."""
        for study in list(self.studies):
            if study.is_over:
                study.advance()
                if study.is_over:
                    self.studies.remove(study)
                    self.finish(study)


def _keys(study: StudyJobs) -> Iterator[str]:
    """Keys of the tasks over the lines of a study, unless these are many."""
    for number in range(study.study.batches if study.study.batches <= _MAX_SHARED else 0):
        yield from (keys.key for keys in study.plan.line_keys(number).values())
