"""A guarded worker process: a crash, hang or excess of memory fails only the point that
caused it.

Engines execute `run` in a thread of this process or on a node of a cluster. Each thread
has one worker process. A chunk that fails is divided and tried again, down to the point
responsible.
"""

import collections
import contextlib
import os
import platform
import resource
import signal
import subprocess
import sys
import threading
import time
from multiprocessing import Pipe
from typing import Any

from gaitsweep.pipeline.engine import division
from gaitsweep.pipeline.engine.division import size_of
from gaitsweep.pipeline.engine.request import Answer, Request
from gaitsweep.pipeline.errors import WorkerError

_POLL_INTERVAL = 0.1  # of checks of a worker [s]
_MAX_CHARGED = 0.5  # largest time charged to a worker for one check [s]
_LOAD_TIMEOUT = 300.0  # time a worker may take to load its task [s]
_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "BLIS_NUM_THREADS",
)
_PROGRAM = "gaitsweep.pipeline.engine.worker_main"
#: What workers have said last, for who waits; on the nodes of a cluster nobody asks.
_said: collections.deque[str] = collections.deque(maxlen=100)
_local = threading.local()
_workers: set["WorkerProcess"] = set()
# An event has a lock, which a signal handler may find taken by its own thread.
_is_closing = False


class WorkerProcess:
    """A worker process and the connection to it."""

    def __init__(self) -> None:
        if _is_closing:
            raise WorkerError("The run is being stopped.")

        environment = {
            **os.environ,
            **dict.fromkeys(_THREADS, "1"),
            "PYTHONHASHSEED": "0",
        }
        self._connection, end = Pipe()
        command = [
            sys.executable,
            "-P",
            "-m",
            _PROGRAM,
            str(os.getpid()),
            str(end.fileno()),
        ]
        null = subprocess.DEVNULL
        try:  # in its own process group, so that Ctrl-C reaches only the parent
            self.process = subprocess.Popen(
                command,
                env=environment,
                pass_fds=[end.fileno()],
                stdin=null,
                stdout=null,
                stderr=null,
                process_group=0,
            )
        finally:
            end.close()

        # Processor time of the last request, and that in integrators [s].
        self.used = (0.0, 0.0)
        _workers.add(self)

    def close(self) -> int:
        """End the process and return its exit code."""
        _workers.discard(self)
        with contextlib.suppress(OSError):
            self.process.kill()
        with contextlib.suppress(OSError):
            self._connection.close()
        return self.process.wait()

    def ask(self, request: Request) -> tuple[str, Any]:
        """Send one request; returns "ok" or a name of `statuses.ENDINGS`, and the parts
        of the answer or a sentence.
        """
        self.used = 0.0, 0.0
        too_much = (
            "out_of_memory",
            f"It needed more than {size_of(request.memory)} of memory.",
        )
        try:
            self._connection.send(request)
            kind, *parts = self._answer(_LOAD_TIMEOUT)
            if kind == "broken":
                raise WorkerError(f"A worker cannot begin its task: {parts[0]}.")
            outcome, self.used, parts = self._answer(
                request.time_limit, parts[0] + request.memory
            )
        except TimeoutError:
            self.close()
            return "timed_out", f"It took longer than {request.time_limit:g} s."
        except MemoryError:
            self.close()
            return too_much
        except (EOFError, OSError, ValueError):  # ValueError: `close_all` closed it
            if _is_closing:
                raise WorkerError("The run is being stopped.") from None
            return "worker_died", self._death()

        if outcome == "out_of_memory":
            return too_much

        return outcome, parts if outcome == "ok" else f"It raised {parts}."

    def _answer(self, seconds: float, memory: int | None = None) -> Any:
        last_poll = time.monotonic()
        while True:
            if self._connection.poll(min(_POLL_INTERVAL, max(0.0, seconds))):
                answer = self._connection.recv()
                if answer[0] != "said":
                    return answer
                _said.append(answer[1])

            if _is_closing:
                raise WorkerError("The run is being stopped.")

            # A late check means that this process was suspended, and the worker with
            # it.
            clock = time.monotonic()
            seconds, last_poll = seconds - min(_MAX_CHARGED, clock - last_poll), clock
            if seconds <= 0:
                raise TimeoutError
            if memory is not None and resident(self.process.pid) > memory:
                raise MemoryError

    def _death(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            # Wait for its own exit code instead of that of our signal.
            self.process.wait(5)

        code = self.close()
        cause = (
            f"of {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        )
        return f"The worker died {cause}."


def resident(process: int | str) -> int:
    """Resident memory of a process, by its number or "self" [byte]; 0 after its end."""
    try:
        with open(f"/proc/{process}/statm") as file:
            return int(file.read().split()[1]) * resource.getpagesize()
    except (OSError, IndexError):
        return 0


def said() -> list[str]:
    """What workers have said since this was asked last."""
    sentences = []
    while _said:
        sentences.append(_said.popleft())
    return sentences


def stop() -> None:
    """Kill every worker process and end all waits; may be called from a signal handler."""
    global _is_closing
    _is_closing = True
    for worker in list(_workers):
        with contextlib.suppress(OSError):
            worker.process.kill()


def close_all() -> None:
    """End every worker process and allow new ones."""
    global _is_closing
    stop()
    for worker in list(_workers):
        worker.close()
    _is_closing = False


def members() -> list[dict[str, Any]]:
    """Host, process id and resident memory [byte] of every worker process of this
    process.
    """
    return [_member(c) for c in list(_workers)]


def _member(worker: WorkerProcess) -> dict[str, Any]:
    return {
        "host": platform.node(),
        "pid": worker.process.pid,
        "memory": resident(worker.process.pid),
    }


def _ask(request: Request, *again: str) -> tuple[str, Any]:
    """Ask the worker process of this thread; once more if it fails by one of `again`,
    whose cause may be external.
    """
    for attempt in (again, ()):
        worker = getattr(_local, "worker", None)
        if worker and worker.process.poll() is not None:  # killed, or tired of waiting
            worker.close()
        if worker is None or worker not in _workers:
            worker = _local.worker = WorkerProcess()
        outcome, parts = worker.ask(request)
        _local.used = [a + b for a, b in zip(_local.used, worker.used, strict=True)]
        if outcome not in attempt:
            break

    return outcome, parts


def run(request: Request) -> Answer:
    """Run a request in the worker process of this thread; errors of the task are
    returned, not raised.

    Raises
    ------
    WorkerError
        If the worker cannot load the task, or the run is being stopped.
    """
    start = time.perf_counter()
    _local.used = [0.0, 0.0]
    answer = division.answer(request, _ask)
    if worker := getattr(_local, "worker", None):
        answer.worker = _member(worker)
    answer.cpu, answer.integrating = _local.used
    answer.seconds = time.perf_counter() - start
    answer.pid = os.getpid()
    return answer
