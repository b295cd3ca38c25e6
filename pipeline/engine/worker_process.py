"""A guarded worker process: a crash, hang or excess of memory fails only the point that
caused it.

Engines execute `run` in a thread of this process or on a node of a cluster. Each thread
has one worker process. A chunk that fails is divided and tried again, down to the point
responsible.
"""

import contextlib
import itertools
import math
import os
import platform
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from multiprocessing import Pipe
from typing import Any

import numpy as np

from gaitsweep.pipeline.engine.request import Answer, AtlasAnswer, Request
from gaitsweep.pipeline.errors import WorkerError
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.statuses import of_atlas
from gaitsweep.pipeline.store.record import (
    Points,
    Record,
    decode,
    joined,
)
from gaitsweep.pipeline.store.store import MAX_PAYLOAD

_POLL_INTERVAL, _MAX_CHARGED = (
    0.1,
    0.5,
)  # interval of checks of a worker, and largest time charged to it for one [s]
_LOAD_TIMEOUT = 300.0  # time a worker may take to load its task [s]
_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "BLIS_NUM_THREADS",
)
_PROGRAM = "gaitsweep.pipeline.engine.worker_main"
_PIECES = 16  # parts of a chunk that failed
_EXTERNAL = (
    "worker_died",
    "out_of_memory",
)  # what may have a cause outside; a second time it has none
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
        self.used = (
            0.0,
            0.0,
        )  # processor time of the last request, and that in integrators [s]
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
            f"It needed more than {_size(request.memory)} of memory.",
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
        while not self._connection.poll(min(_POLL_INTERVAL, max(0.0, seconds))):
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
        return self._connection.recv()

    def _death(self) -> str:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(
                5
            )  # wait for its own exit code instead of that of our signal
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


def _size(memory: int) -> str:
    for unit, name in ((1 << 30, "GiB"), (1 << 20, "MiB")):
        if memory >= unit:
            return f"{memory / unit:.4g} {name}"
    return f"{memory} B"


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
    if request.codec:
        lines = request.params.get("lines")
        places = None if lines is None else np.arange(len(lines))
        record, atlases = _run_part(request, places)
        answer = Answer(record=record, atlases=atlases)
    else:
        answer = _run_task(request)

    if worker := getattr(_local, "worker", None):
        answer.worker = _member(worker)
    answer.cpu, answer.integrating = _local.used
    answer.seconds = time.perf_counter() - start
    answer.pid = os.getpid()
    return answer


def _run_task(request: Request) -> Answer:
    """Run a task that is no chunk."""
    status, result = _ask(request, *_EXTERNAL)
    if status != "ok":
        return Answer(status, result)
    (data,) = result
    if len(data) > MAX_PAYLOAD:
        size = f"Its result of {_size(len(data))}"
        return Answer("raised", f"{size} is larger than a journal can hold.")
    return Answer(data=data)


def _run_part(
    request: Request, places: np.ndarray | None
) -> tuple[Record, list[AtlasAnswer]]:
    """Record of the points of a part of a chunk: of its line, or of the lines side by
    side at some `places` in it.

    If they fail together, they are run in smaller parts, down to the point responsible.
    """
    params, slopes, codec = request.params, request.params["slope"], request.codec
    assert codec
    lines = 1 if places is None else len(places)
    has_atlases = places is not None and request.alone is not None
    is_point = lines * len(slopes) == 1 and not has_atlases

    outcome, parts = "", list[bytes]()
    if lines * len(slopes) <= (request.most or math.inf):
        again = ("timed_out", *_EXTERNAL) if is_point else ()
        outcome, parts = _ask(request, *again)
    if outcome == "ok":
        head, payload, *atlases = parts
        of_lines = [] if places is None else places.tolist()
        pairs = zip(of_lines, atlases, strict=False)
        return Record(head, payload), [AtlasAnswer(k, "ok", "", a) for k, a in pairs]

    if is_point:
        reason = str(parts)
        return codec.encode(Points.of_ending(1, outcome, reason, params["want"])), []
    if places is not None and lines == 1 and has_atlases:
        return _run_alone(request, int(places[0]))
    if outcome:
        sizes = _fewer(lines, len(slopes))
    else:
        assert request.most
        sizes = _at_most(request.most, lines, len(slopes), has_atlases)
    return _run_divided(request, places, sizes)


def _run_divided(
    request: Request, places: np.ndarray | None, sizes: tuple[int, int]
) -> tuple[Record, list[AtlasAnswer]]:
    """Record of a part of a chunk that is computed in parts of so many lines and
    slopes.
    """
    params, slopes, codec = request.params, request.params["slope"], request.codec
    assert codec
    lines = 1 if places is None else len(places)
    found, rows = list[Points](), list[np.ndarray]()
    atlases: list[AtlasAnswer] = []
    for some, at in itertools.product(
        _ranges(lines, sizes[0]), _ranges(len(slopes), sizes[1])
    ):
        part = {**params, "slope": slopes[at]}
        if places is not None:
            part["lines"] = [params["lines"][k] for k in some.tolist()]
        smaller = replace(codec, shape=Shape.of_rows(len(some), len(at)))
        record, atlases_of_part = _run_part(
            replace(request, params=part, codec=smaller),
            None if places is None else places[some],
        )
        found.append(decode(record))
        rows.append((some[:, None] * len(slopes) + at).ravel())
        atlases += atlases_of_part
    order = np.argsort(np.concatenate(rows))
    return codec.encode(joined(found).take(order)), atlases


def _fewer(lines: int, slopes: int) -> tuple[int, int]:
    """Lines and slopes of each smaller part of one that failed: the lines are divided,
    or the slopes of one.
    """
    return (
        (math.ceil(lines / _PIECES), slopes)
        if lines > 1
        else (1, math.ceil(slopes / _PIECES))
    )


def _at_most(most: int, lines: int, slopes: int, has_atlases: bool) -> tuple[int, int]:
    """Lines and slopes of parts with so many points, or of single lines that have
    atlases.

    A plane's lines remain side by side, if only at a few slopes: those without charts
    are followed together, by a worker that remembers their branches for the next
    slopes.
    """
    if most >= slopes or has_atlases:
        return max(1, most // slopes), slopes
    together = min(lines, most)
    return together, most // together


def _ranges(n: int, size: int) -> list[np.ndarray]:
    """Places of n things in parts of a size, the last perhaps smaller."""
    return [np.arange(k, min(k + size, n)) for k in range(0, n, size)]


def _run_alone(request: Request, place: int) -> tuple[Record, list[AtlasAnswer]]:
    """A line that failed beside others, or whose points are wanted a few at a time: its
    atlas, then its points.
    """
    shared = ("lines", "atlases")
    params = {k: value for k, value in request.params.items() if k not in shared}
    (line,) = request.params["lines"]
    assert request.alone and request.codec
    atlas, points = request.alone
    alone = replace(
        request, function=atlas, params={"line": line, "coarse": True}, codec=None
    )
    outcome, result = _ask(alone, *_EXTERNAL)
    if outcome != "ok":
        ending = Points.of_ending(
            len(params["slope"]), outcome, of_atlas(result), params["want"]
        )
        return request.codec.encode(ending), [AtlasAnswer(place, outcome, result, b"")]
    of_points = replace(
        request, function=points, params={**params, "line": line}, inputs=result
    )
    record, _ = _run_part(of_points, None)
    return record, [AtlasAnswer(place, "ok", "", result[0])]
