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
_Jobs = Iterator[tuple[int, Request]]
_Results = Generator[tuple[int, dict[str, Any]], None, None]


@dataclass
class Engine:
    """Executor of jobs: `jobs` worker processes, or the cluster at `address` ("local:4" starts one)."""

    jobs: int = 2
    address: str | None = None

    @contextlib.contextmanager
    def parallel(self) -> Iterator[Callable[[_Jobs], _Results]]:
        """Provide a function that runs numbered requests and yields their numbered results as they arrive.

        They must be closed inside.
        """
        if self.address is None:
            import joblib

            options = {"backend": "threading", "return_as": "generator_unordered", "batch_size": 1}
            with (
                warnings.catch_warnings(),
                joblib.Parallel(self.jobs, pre_dispatch=2 * self.jobs, **options) as parallel,
            ):
                # A run that is stopped says so itself; joblib would report the tasks that end with it.
                warnings.filterwarnings("ignore", r"\d+ tasks (which were|have been) ", UserWarning, "joblib")
                yield lambda jobs: parallel(joblib.delayed(worker_process.run)(*job) for job in jobs)
        else:
            from gaitsweep.pipeline.engine import cluster

            with cluster.connect(self.address) as client:

                def run(jobs: _Jobs) -> _Results:
                    self.jobs = cluster.workers(client)
                    own = software()
                    return cluster.results(client, _run_elsewhere, ((own, *job) for job in jobs))

                self.jobs = cluster.workers(client)
                yield run


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
