"""The nodes of one study as jobs: which are ready, what a worker is asked, and how its
answer is recorded.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from gaitsweep.pipeline.engine.account import Account
from gaitsweep.pipeline.engine.executors import Engine
from gaitsweep.pipeline.engine.request import Request
from gaitsweep.pipeline.graph.graph import Node
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.graph.reads import study_inputs
from gaitsweep.pipeline.grid.grid import PLANE_POINTS, Chunk, Shape
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.outcomes import count
from gaitsweep.pipeline.statuses import STATUS_NAMES
from gaitsweep.pipeline.store.record import (
    Head,
    Packing,
    Points,
    joined,
    pack,
    rows_of,
    unpacked,
)
from gaitsweep.pipeline.store.store import Outcome

# A process on a cluster ends after waiting this long [s]: it cannot see the end of a
# run.
_IDLE_TIMEOUT = 2.0
# Lines of a study whose results others may want: planes hardly have any in common.
_MAX_SHARED = 300
Listener = Callable[[str, dict[str, Any]], None]


class Jobs:
    """Jobs of one study: a node is ready when its needs are in the store; those over
    the study come last.

    Parameters
    ----------
    plan : Plan
    engine : Engine
    listen : callable
        Receives the name of each event and its details.
    most : int, optional
        Points computed at a time; by default those of a chunk.

    Attributes
    ----------
    has_knees : bool
        Whether any walker has.
    running : int
        Jobs taken, by the thread of an executor, and not recorded.
    error : Exception or None
        What ended the study.
    """

    def __init__(
        self, plan: Plan, engine: Engine, listen: Listener, most: int | None = None
    ):
        self.plan, self.engine, self.listen, self.most = plan, engine, listen, most
        self.study, self.store, self.graph = plan.study, plan.store, plan.graph
        self.has_knees = any(check["multipliers"] > 3 for check in self.study.checks)
        self.account, self.running = Account(), 0
        self.error: Exception | None = None
        self._after = _seconds_after(plan)
        self._source, self._is_last = self.plan.nodes(), False
        self._next: Node | None = None
        self._ready: deque[Node] = deque()
        self._pending: set[str] = set()  # keys of results that are to come
        self._waiting: dict[str, list[Node]] = {}  # nodes by a pending need
        self._failed: set[str] = (
            set()
        )  # keys of tasks that failed, and of nodes that need them

    @property
    def is_over(self) -> bool:
        """Whether no job is left."""
        return not self.running and self.peek() is None

    def wanted(self) -> Iterator[str]:
        """Keys of the tasks over lines that the study lacks, unless these are many."""
        if self.study.batches <= _MAX_SHARED:
            yield from (
                node.key.key for node in self.plan.nodes() if node.chunk is None
            )

    def peek(self) -> Node | None:
        """The next job that is ready."""
        try:
            if (
                self._next and self._next.key.key not in self._pending
            ):  # it has come from another study
                self._next = None
            while (
                self._next is None and not self.error and (node := self._from_source())
            ):
                self._offer(node)
        except Exception as error:
            self.fail(error)
        return self._next

    def _from_source(self) -> Node | None:
        if self._ready:
            return self._ready.popleft()
        # Halves of planes may be there before the source comes to them.
        known = self._pending, self._failed
        node = next(
            (
                node
                for node in self._source
                if not any(node.key.key in keys for keys in known)
            ),
            None,
        )
        if node is None and not (self._is_last or self.running or self._pending):
            self._source, self._is_last = self.plan.over_study(), True
            node = next(self._source, None)
        if node:
            self._pending.update(self._results(node))
        return node

    def _results(self, node: Node) -> Iterator[str]:
        """Keys of the results of a node."""
        yield node.key.key
        if node.lines and "atlas" in self.graph.line_tasks:
            yield from (
                self.graph.line_keys(line)["atlas"].key
                for line in node.numbers.tolist()
            )

    def _offer(self, node: Node) -> None:
        """Make a node the next one, unless it waits for others or its result has come
        meanwhile.
        """
        if node.key.key not in self._pending:
            return
        if node.lines:
            node = replace(node, needs=tuple(self._charts_of(node)))
        pending = next((need for need in node.needs if need in self._pending), None)
        if node.todo is None and (
            failed := next((need for need in node.needs if need in self._failed), None)
        ):
            lost, outcome = (
                self._arrived(node.key.key, False) + node.points,
                self.store.outcome(failed),
            )
            status = outcome.status if outcome else "not_attempted"
            self.listen(
                "task",
                {
                    "task": node.task,
                    "seconds": 0.0,
                    "points": 0,
                    "lost": lost,
                    "outcome": status,
                },
            )
        elif pending:
            self._waiting.setdefault(pending, []).append(node)
        elif node.copies and not node.lines:
            assert node.chunk
            self._record_chunk(node, node.chunk, None)
        else:
            self._next = node

    def _charts_of(self, node: Node) -> Iterator[str]:
        """Keys of the charts that a chunk needs; those after one that is still to come
        are not known.
        """
        assert node.chunk
        for made in self.plan.charts_of(node.chunk):
            key = made.key.key
            yield key
            if self.plan.is_missing(key) and key not in self._failed:
                if key not in self._pending:
                    self._pending.add(key)
                    self._ready.appendleft(made)
                return

    def take(self) -> tuple[Node, Request] | None:
        """Take the next job and its request; None if the study has ended, or this
        fails, which ends it.
        """
        node = self.peek()
        if node is None:
            return None
        try:
            request = self._request(node)
        except Exception as error:
            self.fail(error)
            return None
        self.running += 1
        self._next = None
        return node, request

    def awaits(self, node: Node) -> bool:
        """Whether others wait for the result of a node."""
        return node.key.key in self._waiting

    def put_back(self, node: Node) -> None:
        """Return a job that was taken and has no result."""
        self.running -= 1
        self._ready.appendleft(node)

    def fail(self, error: Exception) -> None:
        """End the study with an error; results of its running jobs are dropped."""
        self.error, self._next, self._source = error, None, iter(())
        self._ready.clear()
        self._pending.clear()

    def seconds(self, node: Node) -> float:
        """Estimated time of a job, and of what depends on it [s]."""
        if node.chunk is None:
            return (
                self.graph.size(node) * self.graph.seconds(node.task)
                + self._after[node.task]
            )
        lines = node.lines * self.graph.seconds("atlas")
        return (
            lines + node.points * self.graph.seconds("points") + self._after["points"]
        )

    def _request(self, node: Node) -> Request:
        limits, layers = self.study.limits, self.graph.layers
        idle = None if self.engine.address is None else _IDLE_TIMEOUT
        if node.line is None and node.chunk is None:
            inputs = list(study_inputs(self.plan, node.task))
        else:
            results = [(self.store.outcome(need), need) for need in node.needs]
            inputs = [
                self.store.get(need)[1]
                for outcome, need in results
                if outcome and outcome.status == "ok"
            ]
        packing, alone, most = None, None, self.most
        if node.chunk:
            shape = (
                Shape.of_rows(node.lines, node.chunk.per_line)
                if node.copies
                else node.chunk.shape
            )
            packing = self._packing(
                shape, node.chunk.numbers if node.lines and not node.copies else None
            )
            alone = layers["atlas"].task.function, layers["points"].task.function
        if self.graph.method is Method.PLANE:
            alone = None  # lines keep their charts
            most = most and max(
                most, PLANE_POINTS[0]
            )  # a few points take as long as many
        function, params = self.graph.function(node), self.graph.params(node)
        return Request(
            function,
            params,
            inputs,
            limits.seconds,
            limits.memory,
            idle,
            packing,
            alone,
            most,
        )

    def _packing(self, shape: Shape, lines: np.ndarray | None) -> Packing:
        digests = None if lines is None else self.graph.digests(lines)
        return Packing(shape, self.graph.grid.multipliers, self.study.gaits, digests)

    def record(self, node: Node, result: dict[str, Any]) -> None:
        """Store the result of a job."""
        self.running -= 1
        self.account.add(result)
        self.engine.account.add(result)
        try:
            if self.error:
                return
            if node.chunk:
                self._record_chunk(node, node.chunk, result)
            else:
                self._record_task(node, result)
        except Exception as error:
            self.fail(error)

    def _record_task(self, node: Node, result: dict[str, Any]) -> None:
        outcome = Outcome(result["outcome"], result["reason"])
        self.store.put_result(node.key, outcome, result["data"])
        lost = self._arrived(node.key.key, outcome.status == "ok")
        event = {
            **_event(node, result),
            "outcome": outcome.status,
            "reason": outcome.reason,
            "lost": lost,
        }
        self.listen("task", {**event, **self._charted(node)})

    def _charted(self, node: Node) -> dict[str, int]:
        """How many lines charts are for, those that were not halved, and how many of
        these they leave alone.
        """
        if node.task != "charts":
            return {}
        charted = 0 if self.plan.boxes(node, "halves") else self.graph.charted(node)
        return {"charted": charted, "alone": self._alone([node])}

    def _alone(self, charts: Iterable[Node], chunk: Chunk | None = None) -> int:
        """How many lines, or how many of a chunk, charts leave alone."""
        plane, spans = self.study.plane, chunk.spans if chunk else None
        boxes = (box for made in charts for box in self.plan.boxes(made, "alone"))
        return sum(plane.lines_in(box, spans) for box in boxes) if plane else 0

    def _record_chunk(
        self, node: Node, chunk: Chunk, result: dict[str, Any] | None
    ) -> None:
        """Store a chunk: what a job has computed of it, and lines that were in the
        store before.
        """
        record: Any = result["record"] if result else None
        if result and node.lines:
            lines = node.numbers.tolist()
            for place, status, reason, data in result["atlases"]:
                key = self.graph.line_keys(lines[place])["atlas"]
                self.store.put_result(key, Outcome(status, reason), data)
                self._arrived(key.key, status == "ok")
        whole = self._joined(node, chunk, record) if node.copies else record
        self.store.put(node.key, *whole)
        self._arrived(node.key.key, True)
        if not result:
            return
        counts, line = (
            count(Head(record[0]).rows(self.plan.columns), STATUS_NAMES),
            int(chunk.numbers[0]),
        )
        event = {
            "task": "points",
            "line": line,
            "lines": node.lines,
            "points": node.points,
            "counts": dict(counts),
        }
        event["place"] = chunk.slopes.start
        if node.lines and self.graph.method is Method.PLANE:
            event["alone"] = min(
                node.lines, self._alone(self.plan.charts_of(chunk), chunk)
            )
        self.listen("chunk", {**_event(node, result), **event})

    def _joined(
        self, node: Node, chunk: Chunk, record: tuple[bytes, bytes] | None
    ) -> tuple[bytes, bytes]:
        """A chunk of lines side by side, some just computed and some in records of the
        store.
        """
        parts, places = list[Points](), list[np.ndarray]()
        if record:
            assert node.todo is not None
            parts, places = [unpacked(*record)], [node.todo]
        for key, (own, there) in node.copies.items():
            parts.append(
                self.store.points(key, self.graph.variables).take(
                    rows_of(there, chunk.per_line)
                )
            )
            places.append(own)
        order = np.argsort(np.concatenate(places))
        return pack(
            joined(parts).take(rows_of(order, chunk.per_line)),
            self._packing(chunk.shape, chunk.numbers),
        )

    def copy(self, node: Node, data: bytes) -> None:
        """Store a result that another study has computed."""
        key = node.key.key
        try:
            if not (self.error or key in self.store or key in self._failed):
                self.store.put_result(node.key, Outcome("ok", ""), data)
                self._arrived(key, True)
                self.listen(
                    "task",
                    {
                        "task": node.task,
                        "seconds": 0.0,
                        "outcome": "ok",
                        **self._charted(node),
                    },
                )
        except Exception as error:
            self.fail(error)

    def _arrived(self, key: str, is_ok: bool) -> int:
        """Make nodes ready that waited for a result; if it failed they are dropped, and
        their points counted.
        """
        self._pending.discard(key)
        self._failed.update(() if is_ok else (key,))
        lost = 0
        for node in reversed(self._waiting.pop(key, [])):
            if is_ok or node.todo is not None:
                self._ready.appendleft(node)
            else:
                lost += node.points + self._arrived(node.key.key, False)
        if (
            self._next and self._ready
        ):  # what has become ready goes first: results are seen early
            self._ready.append(self._next)
            self._next = None
        return lost


def _event(node: Node, result: dict[str, Any]) -> dict[str, Any]:
    return {
        "task": node.task,
        "line": node.line,
        **{key: result.get(key) for key in ("seconds", "pid", "worker")},
    }


def _seconds_after(plan: Plan) -> dict[str, float]:
    """Estimated time of the longest chain of tasks that depend on a task of each layer
    [s].
    """
    layers = plan.graph.layers
    after = dict.fromkeys(layers, 0.0)
    for name, layer in reversed(layers.items()):
        for need in layer.needs:
            after[need] = max(after[need], plan.graph.seconds(name) + after[name])
    return after
