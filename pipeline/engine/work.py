"""The nodes of one study that are to be computed: which are ready, which wait for
others, what a worker is asked for them, and how its answer is recorded.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace

from gaitsweep.pipeline.engine.account import Account
from gaitsweep.pipeline.engine.listener import Finished, Listener
from gaitsweep.pipeline.engine.request import Answer, Request
from gaitsweep.pipeline.graph.graph import Node
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.graph.reads import study_inputs
from gaitsweep.pipeline.grid.grid import PLANE_POINTS, Chunk
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.outcomes import count
from gaitsweep.pipeline.statuses import STATUS_NAMES
from gaitsweep.pipeline.store.record import ChunkCodec
from gaitsweep.pipeline.store.store import Outcome


class Work:
    """What a study lacks, node by node.

    A node is drawn from the plan when it may be needed. From then on its key is to
    come, until its result is stored or it is dropped: the node waits for a key that is
    to come itself, or is ready, or is taken. Nodes over the study are drawn last.

    Parameters
    ----------
    plan : Plan
    listeners : sequence of Listener
    most : int, optional
        Points computed at a time; by default those of a chunk.

    Attributes
    ----------
    taken : int
        Nodes that are being computed, here or for another study.
    error : Exception or None
        What ended the study.
    """

    def __init__(
        self, plan: Plan, listeners: Sequence[Listener] = (), most: int | None = None
    ):
        self.plan, self.listeners, self.most = plan, listeners, most
        self.account = Account()
        self.taken = 0
        self.error: Exception | None = None
        self._source: Iterator[Node] = plan.nodes()
        self._is_last = False  # whether the source is of nodes over the study
        self._ready: deque[Node] = deque()
        self._waiting: dict[str, list[Node]] = {}  # by a key that is to come
        self._to_come: set[str] = set()
        # How keys that failed ended, and those of what needs them.
        self._failed: dict[str, str] = {}

    @property
    def is_over(self) -> bool:
        """Whether nothing is left to do."""
        return self.peek() is None and not self.taken

    def peek(self) -> Node | None:
        """The next node that is ready; None if there is none now."""
        try:
            while not self._ready and not self.error:
                node = self._drawn()
                if node is None:
                    return None
                self._offer(node)
        except Exception as error:
            self.fail(error)

        if not self._ready:
            return None

        return self._ready[0]

    def _drawn(self) -> Node | None:
        """The next node of the plan that nothing has been decided of."""
        for node in self._source:
            # Halves of planes may be there before the plan comes to them.
            if node.key not in self._to_come and node.key not in self._failed:
                self._to_come.update(self._results(node))
                return node

        if self._is_last or self._to_come:
            return None

        self._source, self._is_last = self.plan.over_study(), True
        return self._drawn()

    def _results(self, node: Node) -> Iterator[str]:
        """Keys of the results of a node."""
        yield node.key
        graph = self.plan.graph
        if node.chunk and node.lines and "atlas" in graph.line_tasks:
            for line in node.chunk.numbers.tolist():
                yield graph.line_keys(line)["atlas"]

    def _offer(self, node: Node) -> None:
        """Make a node ready, unless it waits for another, or is dropped as that failed."""
        failed = next((need for need in node.needs if need in self._failed), None)
        if failed:
            self._drop(node, self._failed[failed])
            return

        needs = [*node.needs, *self._charts_of(node)]
        awaited = next((need for need in needs if need in self._to_come), None)
        if awaited is None:
            self._ready.append(node)
        else:
            self._waiting.setdefault(awaited, []).append(node)

    def _drop(self, node: Node, status: str) -> None:
        """A node is not computed, since what it needs has ended so."""
        for listener in self.listeners:
            listener.dropped(node, status)
        self._release(node.key, status)

    def _charts_of(self, node: Node) -> list[str]:
        """Keys of the charts that a chunk of a plane reads, as far as they are known;
        those that are missing and were not drawn are offered.
        """
        if not node.lines or not node.chunk:
            return []

        known = []
        for charts in self.plan.charts_of(node.chunk):
            known.append(charts.key)
            is_known = charts.key in self._to_come or charts.key in self._failed
            if not is_known and self.plan.is_missing(charts.key):
                self._to_come.add(charts.key)
                self._offer(charts)

        return known

    def _release(self, key: str, status: str) -> None:
        """A result has come: what waited for it is offered, before what else is ready,
        so that results are seen early.
        """
        self._to_come.discard(key)
        if status != "ok":
            self._failed[key] = status
        later, self._ready = self._ready, deque()
        for node in self._waiting.pop(key, []):
            self._offer(node)
        self._ready += later

    def take(self) -> Node:
        """Take the next node, if there is one."""
        self.taken += 1
        return self._ready.popleft()

    def put_back(self, node: Node) -> None:
        """Return a node that was taken and has no result."""
        self.taken -= 1
        if not self.error:
            self._ready.appendleft(node)

    def fail(self, error: Exception) -> None:
        """End the study with an error; results of nodes that are taken are dropped."""
        self.error = error
        self._source = iter(())
        self._is_last = True
        for nodes in (self._ready, self._waiting, self._to_come):
            nodes.clear()

    def seconds(self, node: Node) -> float:
        """Estimated time of a node [s]."""
        graph = self.plan.graph
        seconds = graph.size(node) * graph.seconds(node.task)
        if node.lines:
            seconds += node.lines * graph.seconds("atlas")
        return seconds

    def seconds_of_chain(self, node: Node) -> float:
        """Estimated time of a node, and of what depends on it [s]."""
        return self.seconds(node) + self.plan.graph.seconds_after[node.task]

    def request(self, node: Node) -> Request:
        """What a worker is asked for a node that was taken."""
        graph = self.plan.graph
        limits = self.plan.study.limits
        codec = alone = None
        if node.chunk:
            codec = self._codec(node.chunk)
            alone = self._alone()

        most = self.most
        if graph.method in (Method.PLANE, Method.TARGETS):
            # Lines keep their charts or branches, and a few points take as long as
            # many.
            alone = None
            most = most and max(most, PLANE_POINTS[0])

        return Request(
            graph.function(node),
            graph.params(node),
            list(self._inputs(node)),
            seconds=limits.seconds,
            memory=limits.memory,
            codec=codec,
            alone=alone,
            most=most,
            together=self._together(node),
        )

    def _codec(self, chunk: Chunk) -> ChunkCodec:
        """By which a worker packs the points of a chunk."""
        graph = self.plan.graph
        return ChunkCodec(
            chunk.shape,
            graph.grid.multipliers,
            self.plan.study.gaits,
            is_packed=not graph.in_memory,
            keys=graph.grid.keys,
        )

    def _alone(self) -> tuple[str, str]:
        """Functions that compute the atlas of a line of a chunk, and its points, by
        themselves.
        """
        layers = self.plan.graph.layers
        return layers["atlas"].task.function, layers["points"].task.function

    def _together(self, node: Node) -> str:
        """Function that computes such an atlas beside others."""
        graph = self.plan.graph
        if node.task != "atlas" or graph.method is not Method.ALONE:
            return ""

        return graph.layers["atlas"].task.side_by_side

    def _inputs(self, node: Node) -> Iterator[bytes]:
        """Packed inputs of a node."""
        if node.is_of_study:
            yield from study_inputs(self.plan, node.task)
            return

        store = self.plan.store
        for need in (*node.needs, *self._charts_of(node)):
            outcome = store.outcome(need)
            if outcome and outcome.status == "ok":
                yield store.get(need).data

    def record(self, node: Node, answer: Answer) -> None:
        """Store the answer for a node that was taken."""
        self.account.add(answer)
        self._keep(node, answer)

    def copy(self, node: Node, answer: Answer) -> None:
        """Store the answer for a node that was taken, which another study has asked
        for.
        """
        self._keep(node, Answer(data=answer.data))

    def _keep(self, node: Node, answer: Answer) -> None:
        self.taken -= 1
        if self.error:
            return
        try:
            finished = self._put(node, answer)
            for listener in self.listeners:
                listener.finished(finished)
        except Exception as error:
            self.fail(error)

    def _put(self, node: Node, answer: Answer) -> Finished:
        store, graph = self.plan.store, self.plan.graph
        if not answer.record:
            outcome = Outcome(answer.status, answer.reason)
            store.put_result(node.key, outcome, answer.data)
            self._release(node.key, answer.status)
            size = graph.size(node)
            if node.task == "charts" and self.plan.boxes(node, "halves"):
                size = 0  # its halves are charted
            return _with_times(Finished(node, size, *outcome), answer)

        for atlas in answer.atlases:
            assert node.chunk
            line = int(node.chunk.numbers[atlas.place])
            key = graph.line_keys(line)["atlas"]
            store.put_result(key, Outcome(atlas.status, atlas.reason), atlas.data)
            self._release(key, atlas.status)

        store.put(node.key, answer.record)
        self._release(node.key, "ok")
        head = ChunkCodec.summary(answer.record.head)
        counts = count(head.rows(self.plan.columns), STATUS_NAMES)
        return _with_times(Finished(node, node.points, counts=counts), answer)


def _with_times(finished: Finished, answer: Answer) -> Finished:
    return replace(
        finished, seconds=answer.seconds, pid=answer.pid, worker=answer.worker
    )
