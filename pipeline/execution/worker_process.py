"""A guarded worker process: a crash, hang or excess of memory fails only the point that caused it.

Engines execute `run` in a thread of this process or on a node of a cluster. Each thread has one worker process. A
block of points or of lines that fails is divided and tried again, down to the point or line responsible.
"""

from __future__ import annotations

import contextlib
import fcntl
import io
import os
import platform
import resource
import select
import signal
import struct
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from pipeline import serialize, statuses
from pipeline.errors import WorkerError
from pipeline.execution import wire
from pipeline.store import rows
from tasks.registry import GAITS

_POLL_INTERVAL, _MAX_CHARGED = 0.1, 0.5  # interval of checks of a worker, and largest time charged to it for one [s]
_LOAD_TIMEOUT = 300.0  # time a worker may take to load its task [s]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "BLIS_NUM_THREADS")
_PIECES = 16  # parts of a failed block
_local = threading.local()
_workers: set[WorkerProcess] = set()
_closing = threading.Event()


@dataclass(frozen=True, slots=True)
class Request:
    """A task to run in a worker process.

    `divided` names the parameter by which a block may be divided: "slope" of points, shape (n,) [rad], or "lines".
    `seconds` and `memory` [byte] limit one point, or the whole task if it is no block of points. The process ends
    after waiting `idle` seconds for another request. `chunk` holds the number of points in a chunk of the archive and
    of multipliers, if the points are whole chunks, which the worker then finishes.
    """

    function: str
    params: dict[str, Any]
    inputs: list[bytes]
    divided: str
    seconds: float
    memory: int
    idle: float | None = None
    chunk: tuple[int, int] | None = None


class WorkerProcess:
    """A worker process and the pipes to it."""

    def __init__(self) -> None:
        if _closing.is_set():
            raise WorkerError("The run is being stopped.")
        environment = {**os.environ, **dict.fromkeys(_THREADS, "1"), "PYTHONHASHSEED": "0"}
        # Its own process group, so that Ctrl-C reaches only the parent. Unbuffered, so that `poll` sees every answer.
        command = [sys.executable, "-P", "-m", "pipeline.execution.worker_main", str(os.getpid())]
        self.process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            process_group=0,
            bufsize=0,
        )
        self.pipes = cast(io.FileIO, self.process.stdin), cast(io.FileIO, self.process.stdout)
        for pipe in self.pipes:
            with contextlib.suppress(OSError):
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, 1 << 20)
        self.threads, self.used = 1, (0.0, 0.0)  # processor time of the last request, and that in integrators [s]
        self.lock = threading.Lock()  # held during a request
        _workers.add(self)

    def close(self) -> int:
        """End the process and return its exit code."""
        _workers.discard(self)
        with contextlib.suppress(OSError):
            self.process.kill()
        for pipe in self.pipes:
            with contextlib.suppress(OSError):
                pipe.close()
        return self.process.wait()

    def ask(self, message: bytes, inputs: list[bytes], seconds: float, memory: int) -> tuple[str, Any]:
        """Send one request; returns "ok" or a name of `statuses.ENDINGS`, and the parts of the answer or a sentence."""
        try:
            wire.send(self.pipes[0], message, *inputs)
            kind, *parts = self._answer(_LOAD_TIMEOUT)
            if kind == b"broken":
                raise WorkerError(f"A worker cannot load its task: {parts[0].decode()}.")
            resident, self.threads = struct.unpack("<QQ", parts[0])
            outcome, *parts = self._answer(seconds, resident + memory)
            self.used = struct.unpack("<2d", parts[0])
        except TimeoutError:
            self.close()
            return "timed_out", f"It took longer than {seconds:g} s."
        except MemoryError:
            self.close()
            return "out_of_memory", f"It needed more than {_size(memory)} of memory."
        except (EOFError, OSError, ValueError):  # ValueError: `stop` closed its pipes
            if _closing.is_set():
                raise WorkerError("The run is being stopped.") from None
            return "worker_died", self._death()
        if outcome == b"ok":
            return "ok", parts
        if outcome == b"out_of_memory":
            return "out_of_memory", f"It needed more than {_size(memory)} of memory."
        return outcome.decode(), f"It raised {parts[1].decode()}."

    def leave(self) -> None:
        """End the process if no request is pending."""
        if self.lock.acquire(blocking=False):
            self.close()
            self.lock.release()

    def _answer(self, seconds: float, memory: int | None = None) -> list[bytes]:
        stream, last_poll = self.pipes[1], time.monotonic()
        poll = select.poll()
        poll.register(stream, select.POLLIN)
        while not poll.poll(1000 * min(_POLL_INTERVAL, max(0.0, seconds))):
            if _closing.is_set():
                raise WorkerError("The run is being stopped.")
            # A late check means that this process was suspended, and the worker with it.
            clock = time.monotonic()
            seconds, last_poll = seconds - min(_MAX_CHARGED, clock - last_poll), clock
            if seconds <= 0:
                raise TimeoutError
            if memory is not None and self.resident() > memory:
                raise MemoryError
        return wire.receive(stream)

    def resident(self) -> int:
        """Resident memory of the process [byte]; 0 after its end."""
        try:
            with open(f"/proc/{self.process.pid}/statm") as file:
                return int(file.read().split()[1]) * resource.getpagesize()
        except (OSError, IndexError):
            return 0

    def _death(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(5)  # wait for its own exit code instead of that of our signal
        code = self.close()
        cause = f"of {signal.Signals(-code).name}" if code < 0 else f"with exit code {code}"
        return f"The worker died {cause}."


def _size(memory: int) -> str:
    for unit, name in ((1 << 30, "GiB"), (1 << 20, "MiB")):
        if memory >= unit:
            return f"{memory / unit:.4g} {name}"
    return f"{memory} B"


def stop() -> None:
    """Kill every worker process and end all waits; may be called from a signal handler."""
    _closing.set()
    for worker in list(_workers):
        with contextlib.suppress(OSError):
            worker.process.kill()


def close_all() -> None:
    """End every worker process and allow new ones."""
    stop()
    for worker in list(_workers):
        worker.close()
    _closing.clear()


def members() -> list[dict[str, Any]]:
    """Host, process id, resident memory [byte] and threads of every worker process of this process."""
    return [_member(c) for c in list(_workers)]


def _member(worker: WorkerProcess) -> dict[str, Any]:
    return {"host": platform.node(), "pid": worker.process.pid, "memory": worker.resident(), "threads": worker.threads}


def _ask(request: Request, params: dict[str, Any], chunk: tuple[int, int] | None = None) -> tuple[str, Any]:
    head = {"function": request.function, "divided": request.divided, "memory": request.memory, "params": params}
    head["chunk"] = chunk
    message = serialize.dump(head)
    while True:
        worker = getattr(_local, "worker", None)
        if worker is None or worker not in _workers:
            worker = _local.worker = WorkerProcess()
        with worker.lock:
            if worker in _workers:  # it may have ended meanwhile
                worker.used = 0.0, 0.0
                answer = worker.ask(message, request.inputs, request.seconds, request.memory)
                _local.used = [a + b for a, b in zip(_local.used, worker.used, strict=True)]
                return answer


def run(request: Request) -> dict[str, Any]:
    """Run a request in the worker process of this thread; errors of the task are returned, not raised.

    Parameters
    ----------
    request : Request

    Returns
    -------
    dict
        `seconds` [s] taken, of them `cpu` of processor time and `integrating` in compiled integrators; `rows` of a
        block of points or lines, each (slopes, packed states, packed variables), and `chunks` of points, each (head,
        payload) of a finished chunk; of a block of lines also `atlases`,
        each with its position, and the positions of the `failed` lines, whose status is `not_attempted`; or `outcome`
        and `data` (packed result) or `reason` of another task; `worker`, the process that ran it.

    Raises
    ------
    WorkerError
        If the worker cannot load the task, or the run is being stopped.
    """
    start = time.perf_counter()
    if timer := getattr(_local, "timer", None):
        timer.cancel()
    answer: dict[str, Any]
    _local.used = [0.0, 0.0]
    if request.divided == "slope":
        answer = _run_points(request)
    elif request.divided == "lines":
        answer = dict(_run_lines(request, 0, len(request.params["lines"])))
    else:
        outcome, parts = _ask(request, request.params)
        if outcome in ("worker_died", "out_of_memory"):  # the cause may be external; a second time it is not
            outcome, parts = _ask(request, request.params)
        is_ok = outcome == "ok" and len(parts[1]) <= rows.MAX_DATA
        if outcome == "ok" and not is_ok:
            outcome, parts = "raised", f"Its result of {_size(len(parts[1]))} is larger than a journal can hold."
        answer = {"outcome": outcome, "data": parts[1] if is_ok else b"", "reason": "" if is_ok else parts}
    worker = getattr(_local, "worker", None)
    if worker:
        answer["worker"] = _member(worker)
    if worker and request.idle is not None:
        timer = _local.timer = threading.Timer(request.idle, worker.leave)
        timer.daemon = True
        timer.start()
    used = dict(zip(("cpu", "integrating"), _local.used, strict=True))
    return {**answer, **used, "seconds": time.perf_counter() - start, "pid": os.getpid()}


def _run_points(request: Request) -> dict[str, Any]:
    """Run a block of points: finished chunks, if it is whole chunks and nothing fails; else rows."""
    outcome, parts = _ask(request, request.params, request.chunk)
    if request.chunk and outcome == "ok":
        return {"rows": [], "chunks": list(zip(parts[1::2], parts[2::2], strict=True))}
    return {"rows": _divide(request, np.asarray(request.params["slope"]), outcome, parts)}


def _run_block(request: Request, slopes: np.ndarray) -> list[tuple[bytes, bytes, bytes]]:
    return _divide(request, slopes, *_ask(request, {**request.params, "slope": slopes}))


def _divide(request: Request, slopes: np.ndarray, outcome: str, parts: Any) -> list[tuple[bytes, bytes, bytes]]:
    """Rows of a block of points, which is divided and run again if it has failed."""
    if outcome == "ok":
        return [(slopes.tobytes(), parts[1], parts[2])]
    if len(slopes) > 1:
        pieces = np.array_split(slopes, min(_PIECES, len(slopes)))
        return [row for piece in pieces for row in _run_block(request, piece)]
    if outcome in ("worker_died", "timed_out", "out_of_memory"):  # the cause may be external
        outcome, parts = _ask(request, {**request.params, "slope": slopes})
        if outcome == "ok":
            return [(slopes.tobytes(), parts[1], parts[2])]
    return [(slopes.tobytes(), serialize.dump(_failed_states(1, outcome, parts)), serialize.dump({}))]


def _run_lines(request: Request, first: int, n: int) -> dict[str, list[Any]]:
    """Run `n` lines of a block, from the `first` on."""
    lines, digests = request.params["lines"][first : first + n], request.params["digests"][first : first + n]
    outcome, parts = _ask(request, {**request.params, "lines": lines, "digests": digests})
    slopes = np.tile(request.params["slope"], n)
    if outcome == "ok":
        row, atlases = (slopes.tobytes(), parts[1], parts[2]), list(enumerate(parts[3:], first))
        return {"rows": [row], "atlases": atlases, "failed": []}
    if n == 1:
        states = {**_failed_states(len(slopes), "not_attempted", ""), "lines": digests}
        row = slopes.tobytes(), serialize.dump(states), serialize.dump({})
        return {"rows": [row], "atlases": [], "failed": [first]}
    answer: dict[str, list[Any]] = {"rows": [], "atlases": [], "failed": []}
    for piece in np.array_split(np.arange(first, first + n), min(_PIECES, n)):
        for name, values in _run_lines(request, int(piece[0]), len(piece)).items():
            answer[name] += values
    return answer


def _failed_states(n: int, outcome: str, reason: str) -> dict[str, np.ndarray]:
    """States of `n` points whose worker ended the same way.

    Parameters
    ----------
    n : int
    outcome : str
        A name of `statuses.ENDINGS`.
    reason : str

    Returns
    -------
    dict
        `status` and `reason`, shape (n, gait), and the sentences `reasons`.
    """
    return {
        "status": np.full((n, len(GAITS)), statuses.ENDINGS[outcome], np.int8),
        "reason": np.zeros((n, len(GAITS)), np.int16),
        "reasons": np.array([reason]),
    }
