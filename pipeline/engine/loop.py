"""The loop that computes what the studies of a command lack: one thread, one state.

Nodes that are ready are submitted while their place has room, and answers are recorded
as they come; a signal is looked for between them.
"""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from gaitsweep.pipeline.engine.engine import Engine
from gaitsweep.pipeline.engine.places import Place, Ticket
from gaitsweep.pipeline.engine.request import Answer
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.errors import GaitsweepError, WorkerError, described
from gaitsweep.pipeline.graph.graph import Node
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.record import Record

#: Studies whose files are open at a time, five each.
MOST_OPEN = 32
_WAIT = 0.2  # longest wait for an answer before a signal is looked for [s]
_MAX_RETRIES = 3  # consecutive losses of a cluster before it is given up
_SHARED = 64 << 20  # results kept for other studies of the command [byte]


@dataclass
class Job:
    """A node that is being computed, for one study or several that want it."""

    owners: list[tuple[Work, Node]] = field(default_factory=list)


class Loop:
    """Computes the nodes of several studies.

    What a task over a line has found is shared with the other studies of the command
    whose nodes have the same key: with those that take it while it is computed, and by
    a bounded memory with those that come to it later.

    Parameters
    ----------
    engine : Engine
    check : callable
        Called between answers; what it raises ends the loop.
    begin : callable
        Called while there may be another study open; returns its work, None if none is
        left.
    finish : callable
        Called with the work of a study when nothing of it is left.
    most_open : int
        Studies that may be open at a time.
    """

    def __init__(
        self,
        engine: Engine,
        check: Callable[[], None],
        begin: Callable[[], Work | None],
        finish: Callable[[Work], None] = lambda work: None,
        most_open: int = MOST_OPEN,
    ):
        self.engine, self.check = engine, check
        self.begin, self.finish = begin, finish
        self.most_open = most_open
        self.works: list[Work] = []
        self._running: dict[Ticket, Job] = {}
        self._by_key: dict[str, Job] = {}  # jobs over lines
        self._found = Memory(_SHARED)
        self._are_several = False

    def run(self) -> None:
        """Compute everything that the studies lack.

        Raises
        ------
        StoppedError
            At a signal.
        WorkerError
            If workers or the cluster cannot be kept alive.
        """
        losses = 0
        self._open_and_close()
        while self.works:
            recorded = 0
            try:
                with self.engine.open(self._note) as place:
                    while self.works:
                        self.engine.jobs = place.slots
                        recorded += self._turn(place)
            except Exception as error:
                self.check()
                if self.engine.address is None or isinstance(error, GaitsweepError):
                    raise
                losses = 1 if recorded else losses + 1
                self._lose(error, losses)

    def _turn(self, place: Place) -> int:
        """Submit what there is room for, and record what has come; returns how much."""
        self.check()
        while self._submit_most_urgent(place):
            pass

        recorded = 0
        if self._running:
            for ticket, answer in place.completed(_WAIT):
                self._record(ticket, answer)
                recorded += 1
                self.check()

        self._open_and_close()
        return recorded

    def _submit_most_urgent(self, place: Place) -> int:
        """Submit a node of each study while there is room, the most urgent first, which
        nothing less urgent overtakes; returns how many.
        """
        submitted = 0
        for work, node in self._ready():
            if not place.has_room(work.seconds(node)):
                break
            self._submit(place, work)
            submitted += 1

        return submitted

    def _ready(self) -> list[tuple[Work, Node]]:
        """Studies with a node that is ready, and it; the first is that whose node, with
        the longest chain of others that wait for it, takes longest.
        """
        ready = [(work, node) for work in self.works if (node := work.peek())]
        ready.sort(key=lambda pair: -pair[0].seconds_of_chain(pair[1]))
        return ready

    def _submit(self, place: Place, work: Work) -> None:
        """Submit the next node of a study, unless its result is there, or to come."""
        node = work.take()
        if job := self._by_key.get(node.key):
            job.owners.append((work, node))
        elif node.key in self._found:
            work.copy(node, Answer(data=self._found.get(node.key).data))
        else:
            self._ask(place, work, node)

    def _ask(self, place: Place, work: Work, node: Node) -> None:
        try:
            request = work.request(node)
        except Exception as error:
            work.fail(error)
            work.put_back(node)
            return

        job = Job([(work, node)])
        self._running[place.submit(request)] = job
        if node.is_of_line:
            self._by_key[node.key] = job

    def _record(self, ticket: Ticket, answer: Answer) -> None:
        job = self._running.pop(ticket)
        (first, node), *others = job.owners
        self._by_key.pop(node.key, None)
        self.engine.account.add(answer)
        first.record(node, answer)
        for work, of_other in others:
            # Limits of studies differ: what has failed for one the others try again.
            if answer.status == "ok":
                work.copy(of_other, answer)
            else:
                work.put_back(of_other)

        if self._are_several and node.is_of_line and answer.status == "ok":
            self._found.put(node.key, Record(b"", answer.data))
            self._found.trim()

    def _open_and_close(self) -> None:
        """Finish studies of which nothing is left, and begin others in their place."""
        self._close()
        while len(self.works) < self.most_open and (work := self.begin()):
            self._are_several |= bool(self.works)
            self.works.append(work)
            self._close()

    def _close(self) -> None:
        over = [work for work in self.works if work.is_over]
        for work in over:
            self.works.remove(work)
            self.finish(work)

    def _note(self, sentence: str) -> None:
        self._say("note", sentence)

    def _say(self, kind: str, sentence: str) -> None:
        """Tell of what concerns all studies, once."""
        for work in self.works[:1]:
            for listener in work.listeners:
                listener.said(kind, sentence)

    def _lose(self, error: Exception, losses: int) -> None:
        """A cluster is lost: what it was computing is computed again."""
        message = described(error)
        if losses > _MAX_RETRIES:
            raise WorkerError(f"Workers cannot be kept alive: {message}.") from error

        self._say("error", message)
        time.sleep(losses)
        for job in self._running.values():
            for work, node in job.owners:
                work.put_back(node)

        self._running.clear()
        self._by_key.clear()


def run_all(works: Sequence[Work], engine: Engine) -> None:
    """Compute what some studies lack, all open at once; their stores stay open."""
    waiting = deque(works)
    loop = Loop(
        engine,
        check=lambda: None,
        begin=lambda: waiting.popleft() if waiting else None,
        most_open=len(works),
    )
    loop.run()
