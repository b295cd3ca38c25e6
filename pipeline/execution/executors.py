"""Executors: worker processes on this computer, each guarded by a thread, or the same guards on cluster nodes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from pipeline.execution import worker_process
from pipeline.execution.worker_process import Request

NOOP_JOB, _NOOP_SECONDS = -1, 0.05  # number of a job that does nothing, and its duration [s]


@dataclass
class Engine:
    """Executor of jobs: `jobs` worker processes, or the cluster at `address` ("local:4" starts one)."""

    jobs: int = 2
    address: str | None = None

    @contextlib.contextmanager
    def parallel(self) -> Iterator[Callable[[Iterator[Any]], Iterator[Any]]]:
        """Provide a function that runs numbered jobs and yields their results as they arrive."""
        import joblib

        options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1}
        with contextlib.ExitStack() as stack:
            if self.address is None:
                options["backend"] = "threading"
            else:
                from pipeline.execution import cluster

                client = stack.enter_context(cluster.connect(self.address))
                stack.enter_context(joblib.parallel_config(cluster.backend(client)))
                self.jobs = cluster.workers(client)
            parallel = stack.enter_context(joblib.Parallel(self.jobs, pre_dispatch=2 * self.jobs, **options))
            yield lambda jobs: parallel(joblib.delayed(_run_job)(number, job) for number, job in jobs)


def _run_job(number: int, request: Request | None) -> tuple[int, dict[str, Any]]:
    """Run a numbered job in a guarded worker process."""
    if request is None:
        time.sleep(_NOOP_SECONDS)
        return number, {}
    return number, worker_process.run(request)
