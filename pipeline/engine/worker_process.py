"""A guarded worker process: a crash, hang or excess of memory fails only the point that caused it.

Engines execute `run` in a thread of this process or on a node of a cluster. Each thread has one worker process. A
chunk that fails is divided and tried again, down to the point responsible.
"""

from __future__ import annotations

import contextlib
import fcntl
import math
import os
import platform
import resource
import signal
import struct
import subprocess
import sys
import threading
import time
from dataclasses import astuple, dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from pipeline import serialize
from pipeline.engine import messages
from pipeline.errors import WorkerError
from pipeline.grid.grid import Shape
from pipeline.statuses import of_atlas
from pipeline.store.record import Points, joined, pack, unpacked
from pipeline.store.store import MAX_PAYLOAD

_POLL_INTERVAL, _MAX_CHARGED = 0.1, 0.5  # interval of checks of a worker, and largest time charged to it for one [s]
_LOAD_TIMEOUT = 300.0  # time a worker may take to load its task [s]
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "BLIS_NUM_THREADS")
_PIECES = 16  # parts of a chunk that failed
_WHOLE_TASK_FACTOR = 60  # a task, or lines side by side, may take this many times the limit of a point
#: Place of a line in its chunk, and outcome, reason and data of its atlas.
Atlas = tuple[int, str, str, bytes]
_local = threading.local()
_workers: set[WorkerProcess] = set()
_closing = threading.Event()


@dataclass(frozen=True, slots=True)
class Packing:
    """How the points of a chunk are packed: `digests` are those of its lines, if these are computed side by side."""

    shape: Shape
    multipliers: int
    digests: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class Request:
    """A task to run in a worker process.

    With `packing` it is a chunk of points, of one line or of `lines` side by side, which is divided if it fails; then
    `alone` names the functions of the atlas and the points of one line, and `most` how many points are computed at a
    time. `seconds` and `memory` [byte] limit one point, or a whole task. The process ends after waiting `idle` seconds
    for another request.
    """

    function: str
    params: dict[str, Any]
    inputs: list[bytes]
    seconds: float
    memory: int
    idle: float | None = None
    packing: Packing | None = None
    alone: tuple[str, str] = ("", "")
    most: int | None = None


class WorkerProcess:
    """A worker process and the pipes to it."""

    def __init__(self) -> None:
        if _closing.is_set():
            raise WorkerError("The run is being stopped.")
        environment = {**os.environ, **dict.fromkeys(_THREADS, "1"), "PYTHONHASHSEED": "0"}
        # Its own process group, so that Ctrl-C reaches only the parent. Unbuffered, so that `poll` sees every answer.
        command = [sys.executable, "-P", "-m", "pipeline.engine.worker_main", str(os.getpid())]
        self.process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            process_group=0,
            bufsize=0,
        )
        assert self.process.stdin and self.process.stdout
        self.pipes = self.process.stdin, self.process.stdout
        for pipe in self.pipes:
            with contextlib.suppress(OSError):
                fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, 1 << 20)
        self._requests = Connection(os.dup(self.pipes[0].fileno()), readable=False)
        self._answers = Connection(os.dup(self.pipes[1].fileno()), writable=False)
        self.threads, self.used = 1, (0.0, 0.0)  # processor time of the last request, and that in integrators [s]
        self.lock = threading.Lock()  # held during a request
        _workers.add(self)

    def close(self) -> int:
        """End the process and return its exit code."""
        _workers.discard(self)
        with contextlib.suppress(OSError):
            self.process.kill()
        for end in (self._requests, self._answers, *self.pipes):
            with contextlib.suppress(OSError):
                end.close()
        return self.process.wait()

    def ask(self, message: bytes, inputs: list[bytes], seconds: float, memory: int) -> tuple[str, Any]:
        """Send one request; returns "ok" or a name of `statuses.ENDINGS`, and the parts of the answer or a sentence."""
        try:
            messages.send(self._requests, message, *inputs)
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
        last_poll = time.monotonic()
        while not self._answers.poll(min(_POLL_INTERVAL, max(0.0, seconds))):
            if _closing.is_set():
                raise WorkerError("The run is being stopped.")
            # A late check means that this process was suspended, and the worker with it.
            clock = time.monotonic()
            seconds, last_poll = seconds - min(_MAX_CHARGED, clock - last_poll), clock
            if seconds <= 0:
                raise TimeoutError
            if memory is not None and self.resident() > memory:
                raise MemoryError
        return messages.receive(self._answers)

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


def _ask(request: Request, **changes: Any) -> tuple[str, Any]:
    """Ask the worker process of this thread; changes are of the request."""
    request = replace(request, **changes)
    packing = request.packing
    head: dict[str, Any] = {"function": request.function, "memory": request.memory, "params": request.params}
    head["packing"] = packing and {
        "shape": astuple(packing.shape),
        "multipliers": packing.multipliers,
        **({} if packing.digests is None else {"digests": packing.digests}),
    }
    seconds = request.seconds * (1 if packing and "line" in request.params else _WHOLE_TASK_FACTOR)
    message = serialize.dump(head)
    while True:
        worker = getattr(_local, "worker", None)
        if worker is None or worker not in _workers:
            worker = _local.worker = WorkerProcess()
        with worker.lock:
            if worker in _workers:  # it may have ended meanwhile
                worker.used = 0.0, 0.0
                answer = worker.ask(message, request.inputs, seconds, request.memory)
                _local.used = [a + b for a, b in zip(_local.used, worker.used, strict=True)]
                return answer


def _ask_again(request: Request, **changes: Any) -> tuple[str, Any]:
    """Ask, and once more where the cause of a failure may be external; a second time it is not."""
    outcome, parts = _ask(request, **changes)
    return _ask(request, **changes) if outcome in ("worker_died", "out_of_memory") else (outcome, parts)


def run(request: Request) -> dict[str, Any]:
    """Run a request in the worker process of this thread; errors of the task are returned, not raised.

    Parameters
    ----------
    request : Request

    Returns
    -------
    dict
        `seconds` [s] taken, of them `cpu` of processor time and `integrating` in compiled integrators; of a chunk its
        `head` and `payload`, and the `atlases` of lines side by side, each its place, outcome, reason and data; of
        another task `outcome`, and `data` (packed result) or `reason`; `worker`, the process that ran it.

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
    if request.packing:
        answer = _run_chunk(request, request.packing)
    else:
        outcome, parts = _ask_again(request)
        is_ok = outcome == "ok" and len(parts[1]) <= MAX_PAYLOAD
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


def _run_chunk(request: Request, packing: Packing) -> dict[str, Any]:
    """Run a chunk of points, as a whole if that does."""
    lines, n = request.params.get("lines"), len(request.params["slope"])
    points = n * (1 if lines is None else len(lines))
    if request.most is None or points <= request.most:
        outcome, parts = _ask(request)
        if outcome == "ok":
            atlases = [(k, "ok", "", atlas) for k, atlas in enumerate(parts[3:])]
            return {"head": parts[1], "payload": parts[2], "atlases": atlases}
        failed = outcome, parts
    else:
        failed = "", ""  # by its size
    if lines is None:
        found, atlases = _run_slopes(request, request.params["slope"], failed), []
    else:
        found, atlases = _run_lines(request, np.arange(len(lines)), failed)
    head, payload = pack(joined(found), packing.shape, packing.multipliers, request.params["gaits"], packing.digests)
    return {"head": head, "payload": payload, "atlases": atlases}


def _run_slopes(request: Request, slopes: np.ndarray, failed: tuple[str, Any] | None = None) -> list[Points]:
    """Points of one line; if they fail together, or have `failed` so, in parts, down to the point responsible."""
    assert request.packing
    packing = replace(request.packing, shape=Shape.of_rows(1, len(slopes)), digests=None)

    def ask() -> tuple[str, Any]:
        return _ask(request, params={**request.params, "slope": slopes}, packing=packing)

    outcome, parts = failed or (ask() if len(slopes) <= (request.most or len(slopes)) else ("", ""))
    if len(slopes) == 1 and outcome in ("worker_died", "timed_out", "out_of_memory"):  # the cause may be external
        outcome, parts = ask()
    if outcome == "ok":
        return [unpacked(*parts[1:3])]
    if len(slopes) == 1:
        return [Points.of_ending(1, outcome, parts, request.params["want"])]
    pieces = np.array_split(slopes, _pieces(len(slopes), request.most))
    return [points for piece in pieces for points in _run_slopes(request, piece)]


def _pieces(n: int, most: int | None) -> int:
    """Into how many parts so many points are divided."""
    return min(n, max(_PIECES, math.ceil(n / most) if most else 0))


def _run_lines(
    request: Request, places: np.ndarray, failed: tuple[str, Any] | None = None
) -> tuple[list[Points], list[Atlas]]:
    """Lines side by side; if they fail together, or have `failed` so, in parts, down to the line responsible."""
    assert request.packing
    lines, slopes = [request.params["lines"][k] for k in places.tolist()], request.params["slope"]
    packing = replace(request.packing, shape=Shape.of_rows(len(lines), len(slopes)), digests=None)
    if not failed and len(lines) * len(slopes) <= (request.most or math.inf):
        outcome, parts = _ask(request, params={**request.params, "lines": lines}, packing=packing)
        if outcome == "ok":
            return [unpacked(*parts[1:3])], [(int(k), "ok", "", a) for k, a in zip(places, parts[3:], strict=False)]
    if len(lines) == 1:
        return _run_alone(request, int(places[0]))
    found, atlases = list[Points](), list[Atlas]()
    most = request.most and max(1, request.most // len(slopes))
    for piece in np.array_split(places, _pieces(len(places), most)):
        points, own = _run_lines(request, piece)
        found += points
        atlases += own
    return found, atlases


def _run_alone(request: Request, place: int) -> tuple[list[Points], list[Atlas]]:
    """A line that failed beside others, or whose points are wanted a few at a time: its atlas, then its points."""
    params = {key: value for key, value in request.params.items() if key not in ("lines", "atlases")}
    line = {key: value for key, value in request.params["lines"][place].items() if key != "cell"}
    atlas, points = request.alone
    outcome, parts = _ask_again(request, function=atlas, params={"line": line, "coarse": True}, packing=None)
    slopes = params["slope"]
    if outcome != "ok":
        ending = Points.of_ending(len(slopes), outcome, of_atlas(parts), params["want"])
        return [ending], [(place, outcome, parts, b"")]
    alone = replace(request, function=points, params={**params, "line": line}, inputs=[parts[1]])
    return _run_slopes(alone, slopes), [(place, "ok", "", parts[1])]
