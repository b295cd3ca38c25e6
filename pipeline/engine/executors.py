"""Executors: worker processes on this computer, each guarded by a thread, or the same
guards on cluster nodes.
"""

import contextlib
import platform
import warnings
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field
from typing import Any

from gaitsweep.pipeline.archive.provenance import software
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.account import Account
from gaitsweep.pipeline.engine.request import Request
from gaitsweep.pipeline.errors import WorkerError

MAX_JOBS = 1000  # worker processes on one computer
_Take = Callable[[], tuple[int, Request] | None]
_Results = Generator[tuple[int, dict[str, Any]] | str, None, None]


@dataclass
class Engine:
    """Executor of jobs: `jobs` worker processes, or the cluster at `address` ("local:4"
    starts one).

    `check` is called while nothing comes from a cluster; what it raises ends the wait.
    `account` is of all studies.
    """

    jobs: int = 2
    address: str | None = None
    check: Callable[[], None] = lambda: None
    account: Account = field(default_factory=Account)

    @contextlib.contextmanager
    def parallel(self) -> Iterator[Callable[[Callable[[], bool], _Take], _Results]]:
        """Provide a function that runs numbered requests and yields their numbered
        results as they arrive.

        Between them come sentences on what it waits for. Its arguments tell whether
        there is a request, and take the most urgent. The results must be closed inside.
        """
        if self.address is None:
            options = {
                "backend": "threading",
                "return_as": "generator_unordered",
                "batch_size": 1,
            }
            with warnings.catch_warnings():
                # It is said in the words of this package.
                warnings.filterwarnings(
                    "ignore", ".*joblib will operate in serial mode", UserWarning
                )
                # A run that is stopped says so itself; joblib would report the tasks
                # that end with it.
                warnings.filterwarnings(
                    "ignore",
                    r"\d+ tasks (which were|have been) ",
                    UserWarning,
                    "joblib",
                )
                import joblib

                # Joblib has no threads where it cannot make semaphores, though they
                # need none.
                is_serial = self.jobs > 1 and joblib.effective_n_jobs(self.jobs) == 1
                self.jobs = 1 if is_serial else self.jobs
                with joblib.Parallel(
                    self.jobs, pre_dispatch=self.jobs, **options
                ) as parallel:

                    def here(is_there: Callable[[], bool], take: _Take) -> _Results:
                        nonlocal is_serial
                        if is_serial:
                            yield "One worker computes at a time: /dev/shm cannot be written."
                            is_serial = False
                        # Joblib looks ahead: a job is chosen when a worker begins it.
                        calls = (
                            joblib.delayed(_run_next)(take)
                            for _ in iter(is_there, False)
                        )
                        yield from filter(None, parallel(calls))

                    yield here
        else:
            from gaitsweep.pipeline.engine import cluster

            with cluster.connect(self.address, self.check) as client:
                team = cluster.Team(client, self.check)

                def elsewhere(_: Callable[[], bool], take: _Take) -> _Results:
                    def job() -> tuple[Any, ...] | None:
                        self.jobs = team.slots
                        taken = take()
                        return (software(), *taken) if taken else None

                    return cluster.results(team, _run_elsewhere, job)

                yield elsewhere


def _run_next(take: _Take) -> tuple[int, dict[str, Any]] | None:
    job = take()
    return worker_process.run(*job) if job else None


def _run_elsewhere(
    software_of_run: dict[str, str], number: int, request: Request
) -> tuple[int, dict[str, Any]]:
    """Run a numbered request on a cluster node; numbers of other software must not be
    archived as the run's own.

    Raises
    ------
    WorkerError
        If the node has other versions than the run.
    """
    for name, version in software().items():
        if version != (wanted := software_of_run.get(name)):
            raise WorkerError(
                f"The cluster's worker on {platform.node()} has {name} {version}; the run has {wanted}."
            )
    return worker_process.run(number, request)
