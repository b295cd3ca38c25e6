"""Where jobs run: worker processes here, each guarded by a thread, or the same guards on the nodes of a cluster."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from pipeline.execution import worker_process

_NOOP_JOB, _IDLE = -1, 0.05  # number of a job of nothing, and how long it lasts [s]


@dataclass
class Engine:
    """Where jobs run: `jobs` worker processes here, or the cluster at `address` ("local:4" starts one)."""

    jobs: int = 2
    address: str | None = None

    @contextlib.contextmanager
    def parallel(self) -> Iterator[Callable[[Iterator[Any]], Iterator[Any]]]:
        """A function that does numbered jobs and yields what they give, as it comes."""
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
            yield lambda jobs: parallel(joblib.delayed(do)(number, job) for number, job in jobs)


def do(number: int, job: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    """What an engine executes: a numbered job, under guard."""
    if number == _NOOP_JOB:
        time.sleep(_IDLE)
        return number, {}
    return number, worker_process.run(job)
