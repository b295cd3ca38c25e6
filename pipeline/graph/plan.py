"""The nodes that a study still needs, and why: `gaitsweep plan` prints them and a run
computes them.
"""

import functools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gaitsweep.pipeline.graph.graph import Graph, Node, boxes
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.grid import Chunk, golden_ratio_order
from gaitsweep.pipeline.statuses import ANSWERS
from gaitsweep.pipeline.store.record import Head
from gaitsweep.pipeline.store.store import Key, Outcome, Store
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.registry import GAITS


class Plan:
    """A study compared with its store.

    Parameters
    ----------
    study : Study
    store : Store
    retry : bool
        Run failed tasks and points again.
    check : callable
        Called for each line or chunk, and by who writes an archive of the plan; what it
        raises ends that.
    """

    def __init__(
        self,
        study: Study,
        store: Store,
        retry: bool = False,
        check: Callable[[], None] = lambda: None,
    ):
        self.study, self.store, self.retry, self.check, self.graph = (
            study,
            store,
            retry,
            check,
            Graph(study),
        )
        self.columns = [GAITS.index(gait) for gait in study.gaits]
        self._boxes: dict[
            str, dict[str, list[dict[str, Any]]]
        ] = {}  # by the keys of charts
        # Whether no node over chunks and lines is missing, as far as is known.
        self._is_complete = False

    def nodes(self) -> Iterator[Node]:
        """Missing nodes over chunks and lines, inputs first; any leading part of them
        samples the study evenly.
        """
        node = None
        for node in () if self._is_complete else self._missing():
            yield node
        self._is_complete = node is None

    def _missing(self) -> Iterator[Node]:
        graph, grid = self.graph, self.graph.grid
        if not graph.method.is_of_lines:
            for number in golden_ratio_order(self.study.batches):
                yield from self._of_line(number)
            return
        planned: set[str] = set()  # keys of charts
        for number in golden_ratio_order(grid.chunks):
            chunk = grid.chunk(number)
            node = self._of_chunk(chunk)
            for charts in self.charts_of(chunk) if node and node.lines else ():
                if charts.key.key not in planned:
                    planned.add(charts.key.key)
                    yield from filter(None, [self._why(charts)])
            if node:
                yield node
            if graph.line_tasks:
                computed = set(node.numbers.tolist()) if node else set()
                for line in chunk.numbers.tolist():
                    yield from (
                        n
                        for n in self._of_line(line)
                        if n.task != "atlas" or line not in computed
                    )

    def _of_line(self, number: int) -> Iterator[Node]:
        """Missing nodes over a line, its atlas first."""
        self.check()
        graph = self.graph
        keys, atlas = graph.line_keys(number), self.outcome_of_line(number)
        if atlas and atlas.status != "ok" and not self.retry:
            return
        rest = [
            self._why(graph.node(name, number))
            for name in graph.line_tasks
            if name != "atlas"
        ]
        if not graph.method.is_of_lines and graph.grid.chunks:
            chunks = graph.grid.chunks_of_line(number)
            rest += [
                self._of_chunk(graph.grid.chunk(chunks[k]))
                for k in golden_ratio_order(len(chunks))
            ]
        missing = [node for node in rest if node]
        # Tasks over the study read the atlas too.
        readers = {*(node.task for node in missing), *graph.study_tasks}
        if "atlas" in keys and any(
            "atlas" in graph.layers[name].needs for name in readers
        ):
            node = self._why(graph.node("atlas", number))
            if node:
                yield node
        # The result of one may have come from another study since.
        yield from (node for node in missing if node.chunk or self._why(node))

    def charts_of(self, chunk: Chunk) -> Iterator[Node]:
        """Nodes of the charts of a chunk over a plane; the halves of one that is
        missing are not known.
        """
        return self.graph.charts_of(chunk, lambda charts: self.boxes(charts, "halves"))

    def boxes(self, charts: Node, which: str) -> Sequence[Mapping[str, Any]]:
        """Parts of the box of charts, as `graph.boxes` has them; those that failed
        leave all of it alone.
        """
        key, plane = charts.key.key, self.study.plane
        if key not in self._boxes:
            arrays = self.store.result(key)
            if arrays is None:
                return (
                    [charts.box or plane.region]
                    if key in self.store and plane and which == "alone"
                    else []
                )
            self._boxes[key] = {
                name: boxes(arrays, name) for name in ("halves", "alone")
            }
        return self._boxes[key][which]

    def is_missing(self, key: str) -> bool:
        """Whether the result of a task is to be computed."""
        outcome = self.store.outcome(key)
        return outcome is None or (self.retry and outcome.status != "ok")

    def _why(self, node: Node) -> Node | None:
        """A node over a line with the reason why it runs; None if it does not."""
        key = node.key
        if not self.is_missing(key.key):
            return None
        return replace(
            node,
            why="retried" if self.store.outcome(key.key) else self._new_or_changed(key),
        )

    def _new_or_changed(self, key: Key) -> str:
        return "changed" if self.store.knows(key.kin) else "new"

    def _of_chunk(self, chunk: Chunk) -> Node | None:
        """Node of a chunk whose points are not all stored."""
        self.check()
        node = self.graph.chunk_node(chunk)
        head = self.store.chunk(node.key.key) if node.key.key in self.store else None
        if head and self._holds(head):
            return (
                self._retried(node, chunk)
                if self.retry and head.has_failed(self.columns)
                else None
            )
        node = replace(node, why="changed" if head else self._new_or_changed(node.key))
        if not self.graph.method.is_of_lines or not self._elsewhere[1].size:
            return node
        records, digests, rows = self._elsewhere
        own = self.graph.digests(chunk.numbers)[:, 0]
        place = np.minimum(np.searchsorted(digests, own), len(digests) - 1)
        is_there: np.ndarray = np.equal(digests[place], own).astype(bool)
        if not is_there.any():
            return node
        own, there = np.flatnonzero(is_there), place[is_there]
        of_each = {key: records[there] == key for key in dict.fromkeys(records[there])}
        copies = {
            key: (own[is_of_it], rows[there[is_of_it]])
            for key, is_of_it in of_each.items()
        }
        return replace(node, todo=np.flatnonzero(~is_there), copies=copies)

    def _retried(self, node: Node, chunk: Chunk) -> Node:
        """Node of a chunk with failures: of lines side by side, those that have any."""
        node = replace(node, why="retried")
        if not self.graph.method.is_of_lines:
            return node
        status = self.store.points(node.key.key).values["status"][:, self.columns]
        is_kept = np.asarray(
            np.isin(status, ANSWERS).reshape(len(chunk.numbers), -1).all(axis=1)
        )
        kept = np.flatnonzero(is_kept)
        return (
            replace(
                node, todo=np.flatnonzero(~is_kept), copies={node.key.key: (kept, kept)}
            )
            if len(kept)
            else node
        )

    def _holds(self, head: Head) -> bool:
        """Whether a record holds what this study asks for, as its archive does: with
        the multipliers of its walkers.
        """
        is_alike = head.multipliers == self.graph.grid.multipliers
        return is_alike and head.holds(self.graph.variables, self.study.gaits)

    @functools.cached_property
    def _elsewhere(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lines side by side in the store, by their sorted digests: keys of records,
        digests and places in them.

        They are in chunks of other grids, as a study has them after its axes were
        changed.
        """
        keys, digests, rows = list[str](), [np.empty(0, np.uint64)], [np.empty(0, int)]
        for key in self.store:
            head = self.store.chunk(key) if key.startswith("points-") else None
            if head and len(head.digests) and self._holds(head):
                keys += [key] * len(head.digests)
                digests.append(head.digests[:, 0])
                rows.append(np.arange(len(head.digests)))
        order = np.argsort(np.concatenate(digests), kind="stable")
        return (
            np.array(keys, object)[order],
            np.concatenate(digests)[order],
            np.concatenate(rows)[order],
        )

    def over_study(self) -> Iterator[Node]:
        """Nodes over the study that are missing, or older than what they read, inputs
        first.

        Asked once all other nodes are stored; before, they run if any of these does.
        """
        keys = self.graph.study_keys
        for name, key in keys.items():
            node, needs = self.graph.node(name), self.graph.layers[name].needs
            outcome = self.store.outcome(key.key)
            if outcome is None:
                yield replace(node, why=self._new_or_changed(key))
            elif self._latest(needs, keys) > self.store.number(key.key):
                yield replace(node, why="its inputs change")
            elif self.retry and outcome.status != "ok":
                yield replace(node, why="retried")

    def _latest(self, needs: tuple[str, ...], over_study: dict[str, Key]) -> int:
        """Number of the latest record of some tasks of the study."""
        graph, number, latest = self.graph, self.store.number, 0
        if "points" in needs:
            chunks = (
                graph.chunk_key(graph.grid.chunk(k)) for k in range(graph.grid.chunks)
            )
            latest = max(map(number, chunks), default=0)
        for need in set(needs) & set(graph.line_tasks):
            lines = (graph.line_keys(i)[need].key for i in range(self.study.batches))
            latest = max(latest, *map(number, lines))
        return max(
            latest,
            *(number(over_study[need].key) for need in needs if need in over_study),
            0,
        )

    def outcome_of_line(self, number: int) -> Outcome | None:
        """How the atlas of a line ended, for what needs it; None if it is not known, or
        no task of its own.
        """
        keys = self.graph.line_keys(number)
        return self.store.outcome(keys["atlas"].key) if "atlas" in keys else None


@dataclass
class Summary:
    """Counts of a plan: `todo[layer][why]`, `cached[layer]`, and the estimated work in
    core seconds.

    Points are counted, the lines that charts are for, and all other tasks.
    """

    todo: dict[str, Counter[str]]
    cached: dict[str, int]
    seconds: float = 0.0


def summary(plan: Plan) -> Summary:
    """Count the work of a plan without storing it."""
    study, layers = plan.study, plan.graph.layers
    totals = {
        name: study.points
        if name == "points"
        else study.batches
        if layer.per_line
        else 1
        for name, layer in layers.items()
    }
    todo: dict[str, Counter[str]] = {name: Counter() for name in layers}
    if not plan.store:
        for name, total in totals.items():
            todo[name]["new"] = total
    else:
        for node in plan.nodes():
            todo[node.task][node.why] += plan.graph.size(node)
            if node.lines:
                todo["atlas"][node.why] += node.lines
        for node in plan.over_study():
            todo[node.task][node.why] += 1
        for name in plan.graph.study_tasks:
            if not todo[name] and any(todo.get(need) for need in layers[name].needs):
                todo[name]["its inputs change"] = 1
    counts = {name: sum(why.values()) for name, why in todo.items()}
    work = sum(n * plan.graph.seconds(name) for name, n in counts.items() if n)
    seconds = work + costs.starting(study) if any(counts.values()) else 0.0
    return Summary(
        todo, {name: totals[name] - n for name, n in counts.items()}, seconds
    )
