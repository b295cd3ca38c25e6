"""Places where jobs are computed: in this process, in worker processes, each guarded by
a thread, or by the same guards on the nodes of a cluster.
"""

import contextlib
import itertools
import queue
import threading
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np

from gaitsweep.pipeline import dispatch, serialize
from gaitsweep.pipeline.engine import division, worker_process
from gaitsweep.pipeline.engine.request import Answer, Request
from gaitsweep.pipeline.engine.worker_main import packed
from gaitsweep.pipeline.errors import described

MAX_JOBS = 1000  # worker processes on one computer
#: Requests that wait for a worker, so that none waits while the parent stores results.
_SPARE = 1
#: What takes longer does not wait in this way, since what becomes ready meanwhile may be
#: more urgent [s].
LONG = 1.0
Ticket = int
Say = Callable[[str], None]


class Place(Protocol):
    """Where requests are computed."""

    @property
    def slots(self) -> int:
        """Requests that are computed at a time."""

    def has_room(self, seconds: float = 0.0) -> bool:
        """Whether another request, which takes so long, should be submitted now."""

    def submit(self, request: Request) -> Ticket:
        """Submit a request; its answer comes with this ticket."""

    def completed(self, timeout: float) -> Iterator[tuple[Ticket, Answer]]:
        """Answers that have come; waits for the first, but not longer than so many
        seconds.

        Raises
        ------
        Exception
            If a request could not be computed: no result of its task.
        """


class Inline:
    """Computes in this thread, when answers are asked for; nothing guards it.

    Parameters
    ----------
    room : int
        Requests that are taken at a time; those that can be are computed together.
    """

    slots = 1

    def __init__(self, room: int = 1) -> None:
        self.room = room
        self._tickets = itertools.count()
        self._submitted: list[tuple[Ticket, Request]] = []

    def has_room(self, seconds: float = 0.0) -> bool:
        """Whether another request is taken."""
        return len(self._submitted) < self.room

    def submit(self, request: Request) -> Ticket:
        """Note a request."""
        ticket = next(self._tickets)
        self._submitted.append((ticket, request))
        return ticket

    def completed(self, timeout: float) -> Iterator[tuple[Ticket, Answer]]:
        """Compute what was submitted."""
        submitted, self._submitted = self._submitted, []
        alike: dict[bytes, list[tuple[Ticket, Request]]] = {}
        for ticket, request in submitted:
            if request.together:
                alike.setdefault(_shared(request), []).append((ticket, request))

        found: dict[Ticket, Answer] = {}
        for some in alike.values():
            answers = _computed_together([request for _, request in some])
            found |= zip((ticket for ticket, _ in some), answers, strict=False)
        for ticket, request in submitted:
            yield ticket, found.get(ticket) or division.answer(request, compute)


def compute(request: Request, *_: str) -> tuple[str, Any]:
    """Compute a request in this process: "ok" and the parts of its answer, or how it
    ended and a sentence.
    """
    inputs = [serialize.load(data) for data in request.inputs]
    try:
        returned = dispatch.resolve(request.function)(request.params, inputs)
        return "ok", packed(returned, request.params, request.codec)
    except Exception as error:
        return "raised", f"It raised {described(error)}."


def _shared(request: Request) -> bytes:
    """What atlases must share to be computed by one call: all but their lines."""
    others = {name: own for name, own in request.params.items() if name != "line"}
    return serialize.dump([request.together, sorted(others.items())])


def _computed_together(requests: list[Request]) -> list[Answer]:
    """Answers of atlases that are computed by one call, those of lines alone; none if it
    fails: each is tried by itself then.
    """
    if len(requests) < 2:
        return []

    lines = [request.params["line"] for request in requests]
    others = {**requests[0].params, "lines": lines}
    del others["line"]
    params = {**others, "slope": np.empty(0), "want": ()}
    try:
        results = dispatch.resolve(requests[0].together)(params, [])
    except Exception:
        return []

    return [Answer(data=serialize.dump(dict(atlas))) for atlas, _ in results]


class Workers:
    """Worker processes on this computer, each guarded by a thread of joblib's.

    The guards take requests from one queue, and put answers into another. Whatever
    happens to a worker, its guard answers, or raises what ends the run.

    Parameters
    ----------
    jobs : int
        Worker processes.
    say : callable
        Receives sentences for who waits.
    """

    def __init__(self, jobs: int, say: Say = lambda sentence: None):
        with warnings.catch_warnings():
            # It is said in the words of this package.
            warnings.filterwarnings(
                "ignore", ".*joblib will operate in serial mode", UserWarning
            )
            import joblib

            # Joblib has no threads where it cannot make semaphores, though they need
            # none.
            self.slots = int(joblib.effective_n_jobs(jobs))

        self._say, self._told = say, set[str]()
        if self.slots < jobs:
            say("One worker computes at a time: /dev/shm cannot be written.")
        self._tickets = itertools.count()
        self._in_flight = 0
        self._inbox: queue.SimpleQueue[tuple[Ticket, Request] | None] = (
            queue.SimpleQueue()
        )
        self._outbox: queue.SimpleQueue[tuple[Ticket, Answer] | BaseException] = (
            queue.SimpleQueue()
        )
        self._guards = threading.Thread(target=self._guard, daemon=True)

    def __enter__(self) -> "Workers":
        worker_process.said()  # what an earlier run was told too late
        self._guards.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            # What is in flight is of no use any more.
            worker_process.stop()
            with contextlib.suppress(queue.Empty):
                while True:
                    self._inbox.get_nowait()

        for _number in range(self.slots):
            self._inbox.put(None)
        self._guards.join()
        self._pass_on()

    def _guard(self) -> None:
        """Run the guards, until each has taken the end from the inbox."""
        import joblib

        guards = joblib.Parallel(
            self.slots, backend="threading", batch_size=1, pre_dispatch="all"
        )
        serve = joblib.delayed(_serve)(self._inbox, self._outbox)
        try:
            guards([serve] * self.slots)
        except BaseException as error:
            self._outbox.put(error)

    def has_room(self, seconds: float = 0.0) -> bool:
        """Whether a worker waits, or would wait for its next request, which takes so
        long.
        """
        spare = _SPARE if seconds < LONG else 0
        return self._in_flight < self.slots + spare

    def submit(self, request: Request) -> Ticket:
        """Put a request into the inbox."""
        ticket = next(self._tickets)
        self._in_flight += 1
        self._inbox.put((ticket, request))
        return ticket

    def completed(self, timeout: float) -> Iterator[tuple[Ticket, Answer]]:
        """Answers in the outbox; what the workers have said is passed on."""
        self._pass_on()
        with contextlib.suppress(queue.Empty):
            answer = self._outbox.get(timeout=timeout)
            while True:
                if isinstance(answer, BaseException):
                    raise answer
                self._in_flight -= 1
                yield answer
                answer = self._outbox.get_nowait()

    def _pass_on(self) -> None:
        """Say what workers have said, each sentence once."""
        for sentence in worker_process.said():
            if sentence not in self._told:
                self._told.add(sentence)
                self._say(sentence)


def _serve(
    inbox: "queue.SimpleQueue[tuple[Ticket, Request] | None]",
    outbox: "queue.SimpleQueue[tuple[Ticket, Answer] | BaseException]",
) -> None:
    """Answer requests by the worker process of this thread."""
    while job := inbox.get():
        ticket, request = job
        try:
            outbox.put((ticket, worker_process.run(request)))
        except BaseException as error:
            outbox.put(error)
