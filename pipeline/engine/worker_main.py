"""Program of a worker process, which answers requests.

Started as `python -m gaitsweep.pipeline.engine.worker_main PARENT CONNECTION` by
`worker_process`.
"""

from __future__ import annotations

import ctypes
import logging
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.pipeline.errors import described
from gaitsweep.tasks.contract.registry import CLOCK

if TYPE_CHECKING:  # a worker imports what its first request needs
    from gaitsweep.pipeline.engine.request import Request
    from gaitsweep.pipeline.store.record import ChunkCodec

_PR_SET_PDEATHSIG = 1
_SLACK = 256 << 20  # growth above the limit that the kernel allows [byte]


def serve(parent: int, number: int) -> None:
    """Answer requests of the process `parent` over a connection, until it closes that
    or ends.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if os.getppid() != parent:
        return

    os.set_inheritable(number, False)
    connection = Connection(number)
    messages = _Messages(connection)
    from gaitsweep.pipeline import serialize

    warm: set[str] = set()
    clock, idle = _Clock(), None
    while connection.poll(idle):
        try:
            request = connection.recv()
        except EOFError:
            return

        idle = request.idle
        try:  # what goes wrong here is no result of the task
            function = resolve(request.function)
            _limit_memory(request.memory)
        except Exception as error:
            messages.send("broken", described(error))
            continue

        inputs = [serialize.load(packed) for packed in request.inputs]
        _warm_up(function, request, inputs, warm)
        try:
            memory = _pages(1)
        except OSError as error:
            messages.send("broken", described(error))
            continue

        messages.send("started", memory)
        outcome, result = _answer(function, request.params, inputs, request.codec)
        messages.send(outcome, clock.lap(), result)


class _Messages(logging.Handler):
    """Messages to the parent: answers, and what is logged meanwhile, perhaps by another
    thread, which begin with "said".
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__(logging.INFO)
        self._connection, self._sending = connection, threading.Lock()
        logger = logging.getLogger("gaitsweep")
        logger.setLevel(logging.INFO)
        logger.addHandler(self)

    def send(self, *message: Any) -> None:
        """Send a message whole."""
        with self._sending:
            self._connection.send(message)

    def emit(self, record: logging.LogRecord) -> None:
        """Send what is logged; an error is none of who logs."""
        try:
            self.send("said", record.getMessage().removeprefix("gaitsweep: "))
        except Exception:
            self.handleError(record)


def _warm_up(
    function: Callable[..., Any], request: Request, inputs: list[Any], warm: set[str]
) -> None:
    """Load the compiled code of a chunk's line, unless it is among the warm ones: the
    time for that does not count for the first point.
    """
    params = request.params
    line = repr(params.get("line"))
    if "line" in params and request.codec and line not in warm:
        _answer(function, {**params, "slope": params["slope"][:0]}, inputs)
        warm.add(line)


class _Clock:
    """Processor time of this process, and that in its compiled integrators [s]."""

    def __init__(self) -> None:
        self._total, self._compiled = 0.0, 0.0

    def lap(self) -> tuple[float, float]:
        """Both since they were last asked for."""
        total, compiled = time.process_time(), _integrating()
        spent = total - self._total, compiled - self._compiled
        self._total, self._compiled = total, compiled
        return spent


def _integrating() -> float:
    """Processor time that this process has spent in compiled integrators [s]."""
    module, _, _ = CLOCK.partition(":")
    return float(resolve(CLOCK)()) if module in sys.modules else 0.0


def _limit_memory(growth: int) -> None:
    """Limit the growth of this process [byte]; the parent, which samples its memory,
    ends it well before.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = _pages(5) + growth + _SLACK
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def _pages(field: int) -> int:
    """Memory of this process [byte]: field 1 of `/proc/self/statm` is resident memory,
    5 is data.
    """
    with open("/proc/self/statm") as file:
        return int(file.read().split()[field]) * resource.getpagesize()


def _answer(
    function: Callable[..., Any],
    params: dict[str, Any],
    inputs: list[Any],
    codec: ChunkCodec | None = None,
) -> tuple[str, Any]:
    """How a task ended, and its result; of a chunk head and payload of its record, and
    the atlases of its lines.
    """
    try:
        return "ok", packed(function(params, inputs), params, codec)
    except MemoryError:
        return "out_of_memory", ""
    except BaseException as error:
        # sys.exit and KeyboardInterrupt too: no task ends the worker.
        return "raised", described(error)


def packed(
    returned: Any, params: dict[str, Any], codec: ChunkCodec | None
) -> list[Any]:
    """What a task with these parameters has returned, packed: one result, or head and
    payload of a chunk's record, then the atlases of its lines, if they are wanted.
    """
    from gaitsweep.pipeline import serialize

    if codec is None:
        return [serialize.dump(returned)]

    from gaitsweep.pipeline.store.points import Points

    record = codec.encode(Points.of_task(returned, params))
    atlases = [atlas for atlas, _ in returned] if params.get("atlases") else []
    return [*record, *map(serialize.dump, atlases)]


if __name__ == "__main__":
    serve(*map(int, sys.argv[1:]))
