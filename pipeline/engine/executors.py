"""Executors: worker processes on this computer, each guarded by a thread, or the same guards on cluster nodes."""

import contextlib
import platform
import warnings
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any

from gaitsweep.pipeline.archive.provenance import software
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.request import Request
from gaitsweep.pipeline.errors import WorkerError

MAX_JOBS = 1000  # worker processes on one computer
_Take = Callable[[], tuple[int, Request] | None]
_Results = Generator[tuple[int, dict[str, Any]], None, None]


@dataclass
class Engine:
    """Executor of jobs: `jobs` worker processes, or the cluster at `address` ("local:4" starts one)."""

    jobs: int = 2
    address: str | None = None

    @contextlib.contextmanager
    def parallel(self) -> Iterator[Callable[[Callable[[], bool], _Take], _Results]]:
        """Provide a function that runs numbered requests and yields their numbered results as they arrive.

        Its arguments tell whether there is a request, and take the most urgent. The results must be closed inside.
        """
        if self.address is None:
            import joblib

            options = {"backend": "threading", "return_as": "generator_unordered", "batch_size": 1}
            with warnings.catch_warnings(), joblib.Parallel(self.jobs, pre_dispatch=self.jobs, **options) as parallel:
                # A run that is stopped says so itself; joblib would report the tasks that end with it.
                warnings.filterwarnings("ignore", r"\d+ tasks (which were|have been) ", UserWarning, "joblib")

                def here(is_there: Callable[[], bool], take: _Take) -> _Results:
                    # Joblib looks ahead: a job is chosen when a worker begins it.
                    calls = (joblib.delayed(_run_next)(take) for _ in iter(is_there, False))
                    yield from filter(None, parallel(calls))

                yield here
        else:
            from gaitsweep.pipeline.engine import cluster

            with cluster.connect(self.address) as client:

                def elsewhere(_: Callable[[], bool], take: _Take) -> _Results:
                    self.jobs = cluster.workers(client)
                    return cluster.results(client, _run_elsewhere, ((software(), *job) for job in iter(take, None)))

                yield elsewhere


def _run_next(take: _Take) -> tuple[int, dict[str, Any]] | None:
    job = take()
    return worker_process.run(*job) if job else None


def _run_elsewhere(software_of_run: dict[str, str], number: int, request: Request) -> tuple[int, dict[str, Any]]:
    """Run a numbered request on a cluster node; numbers of other software must not be archived as the run's own.

    Raises
    ------
    WorkerError
        If the node has other versions than the run.
    """
    for name, version in software().items():
        if version != (wanted := software_of_run.get(name)):
            raise WorkerError(f"The cluster's worker on {platform.node()} has {name} {version}; the run has {wanted}.")
    return worker_process.run(number, request)
