"""What the processes of a run did with their time and memory, for its record."""

import resource
import time
from dataclasses import dataclass, field

from gaitsweep.pipeline.engine.request import Answer


@dataclass
class Account:
    """Use of workers by one study, or by all of a command.

    Attributes
    ----------
    start : float [s]
        Monotonic time.
    occupied, cpu, integrating : float [s]
        Time of jobs; of it processor time of the workers, and that in compiled
        integrators.
    memory : int [byte]
        Largest resident memory of a worker after a job.
    """

    start: float = field(default_factory=time.monotonic)
    occupied: float = 0.0
    cpu: float = 0.0
    integrating: float = 0.0
    memory: int = 0

    def add(self, answer: Answer) -> None:
        """Add the answer for a job."""
        self.occupied += answer.seconds
        self.cpu += answer.cpu
        self.integrating += answer.integrating
        self.memory = max(self.memory, answer.worker.get("memory", 0))

    def record(self, whole: "Account", jobs: int) -> dict[str, float]:
        """Account of a study, and of the command until now.

        Parameters
        ----------
        whole : Account
            Of all studies of the command.
        jobs : int
            Number of workers.

        Returns
        -------
        dict
            `workers_cpu`, `integrators`, `python`: processor time of the workers for
            this study, in compiled integrators and functions of a step, and outside
            [s]; `parent_cpu` [s], `workers_idle` (share of their time) and peaks of
            memory [byte], of all studies of the command until this one was finished.
        """
        elapsed = time.monotonic() - whole.start
        return {
            "workers_cpu": round(self.cpu, 3),
            "integrators": round(self.integrating, 3),
            "python": round(max(0.0, self.cpu - self.integrating), 3),
            "parent_cpu": round(time.process_time(), 3),
            "workers_idle": round(
                max(0.0, 1 - whole.occupied / max(jobs * elapsed, 1e-9)), 4
            ),
            "parent_memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
            "worker_memory": whole.memory,
        }
