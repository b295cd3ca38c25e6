"""The nodes that a study still needs, and why: `gaitsweep plan` prints them and a run
computes them.
"""

import functools
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gaitsweep.pipeline.graph.graph import Graph, Node, boxes
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.grid import Chunk, golden_ratio_order
from gaitsweep.pipeline.store.store import Outcome, Store
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract.registry import GAITS


class Plan:
    """A study compared with its store.

    Parameters
    ----------
    study : Study
    store : Store
    retry : bool
        Run failed tasks, and chunks with failed points, again.
    check : callable
        Called for each line or chunk, and by who writes an archive of the plan; what it
        raises ends that.
    in_memory : bool
        Whether results are kept in memory.
    """

    def __init__(
        self,
        study: Study,
        store: Store,
        retry: bool = False,
        check: Callable[[], None] = lambda: None,
        in_memory: bool = False,
    ):
        self.study, self.store = study, store
        self.retry, self.check = retry, check
        self.graph = Graph(study, in_memory)
        self.columns = [GAITS.index(gait) for gait in study.gaits]
        # Boxes of charts, by the keys of these.
        self._boxes: dict[str, dict[str, list[dict[str, Any]]]] = {}
        # Whether no node over chunks and lines is missing, as far as is known.
        self._is_complete = False

    def nodes(self) -> Iterator[Node]:
        """Missing nodes over chunks and lines, inputs first; any leading part of them
        samples the study evenly.
        """
        if self._is_complete:
            return
        is_none_missing = True
        for node in self._missing():
            is_none_missing = False
            yield node
        self._is_complete = is_none_missing

    def _missing(self) -> Iterator[Node]:
        if self.graph.method.is_of_lines:
            yield from self._missing_side_by_side()
            return
        for number in golden_ratio_order(self.study.batches):
            yield from self._of_line(number)

    def _missing_side_by_side(self) -> Iterator[Node]:
        """Missing nodes of a study whose lines are computed side by side, chunk by
        chunk.
        """
        graph, grid = self.graph, self.graph.grid
        planned: set[str] = set()  # keys of charts
        for number in golden_ratio_order(grid.chunks):
            chunk = grid.chunk(number)
            node = self._of_chunk(chunk)
            if node:
                for charts in self.charts_of(chunk):
                    if charts.key not in planned:
                        planned.add(charts.key)
                        yield from self._if_missing(charts)
                yield node

            if graph.line_tasks:
                for line in chunk.numbers.tolist():
                    for of_line in self._of_line(line):
                        # A chunk that is computed brings the atlases of its lines.
                        if not node or of_line.task != "atlas":
                            yield of_line

    def _of_line(self, number: int) -> Iterator[Node]:
        """Missing nodes over a line, its atlas first."""
        self.check()
        graph = self.graph
        atlas = self.outcome_of_line(number)
        if atlas and atlas.status != "ok" and not self.retry:
            return

        missing: list[Node] = []
        for name in graph.line_tasks:
            if name != "atlas":
                missing += self._if_missing(graph.node(name, number))

        if not graph.method.is_of_lines and graph.grid.chunks:
            chunks = graph.grid.chunks_of_line(number)
            for k in golden_ratio_order(len(chunks)):
                node = self._of_chunk(graph.grid.chunk(chunks[k]))
                if node:
                    missing.append(node)

        # Tasks over the study read the atlas too.
        readers = {*(node.task for node in missing), *graph.study_tasks}
        is_read = any("atlas" in graph.layers[name].needs for name in readers)
        if "atlas" in graph.line_keys(number) and is_read:
            yield from self._if_missing(graph.node("atlas", number))
        for node in missing:
            if node.chunk:
                yield node
            else:  # which may have come from another study since
                yield from self._if_missing(node)

    def charts_of(self, chunk: Chunk) -> Iterator[Node]:
        """Nodes of the charts of a chunk over a plane; the halves of one that is
        missing are not known.
        """
        return self.graph.charts_of(chunk, lambda charts: self.boxes(charts, "halves"))

    def boxes(self, charts: Node, which: str) -> Sequence[Mapping[str, Any]]:
        """Parts of the box of charts, as `graph.boxes` has them; those that failed
        leave all of it alone.
        """
        key, plane = charts.key, self.study.plane
        if key not in self._boxes:
            arrays = self.store.result(key)
            if arrays is None:
                has_failed = key in self.store
                if has_failed and plane and which == "alone":
                    return [charts.box or plane.region]
                return []

            halves, alone = boxes(arrays, "halves"), boxes(arrays, "alone")
            self._boxes[key] = {"halves": halves, "alone": alone}

        return self._boxes[key][which]

    def is_missing(self, key: str) -> bool:
        """Whether the result of a task is to be computed."""
        outcome = self.store.outcome(key)
        return outcome is None or (self.retry and outcome.status != "ok")

    def _if_missing(self, node: Node) -> list[Node]:
        """A node over a line with the reason why it runs; none if it does not."""
        if not self.is_missing(node.key):
            return []

        why = self._why(node.task)
        if node.key in self.store:
            why = "retried"
        return [replace(node, why=why)]

    def _why(self, task: str) -> str:
        """Why a node of a task has no result."""
        if task in self._changed:
            return "changed"
        return "new"

    @functools.cached_property
    def _changed(self) -> set[str]:
        """Tasks of which the last run of this archive had other versions, or what they
        read.
        """
        changed: set[str] = set()
        with self.store.reading():
            before = dict(json.loads(self.store.note("versions") or "{}"))
        if self.store.note("accuracy") not in (None, repr(self.study.accuracy)):
            changed |= {"points", "charts"}
        for name, layer in self.graph.layers.items():
            version = layer.task.version
            if before.get(name, version) != version or changed & {*layer.needs}:
                changed.add(name)

        if "charts" in changed:
            changed.add("points")
        return changed

    def set_notes(self) -> None:
        """Note with what this study is run, for later plans."""
        self.store.set_note("versions", self.versions)
        self.store.set_note("accuracy", repr(self.study.accuracy))

    @property
    def versions(self) -> str:
        """Versions of the tasks."""
        layers = self.graph.layers.items()
        versions = {name: layer.task.version for name, layer in layers}
        return json.dumps(versions, sort_keys=True)

    def _of_chunk(self, chunk: Chunk) -> Node | None:
        """Node of a chunk whose points are not all stored, or some of which failed and
        are tried again.
        """
        self.check()
        node = self.graph.chunk_node(chunk)
        why = self._why_of_chunk(node.key)
        return replace(node, why=why) if why else None

    def _why_of_chunk(self, key: str) -> str:
        """Why a chunk is computed; empty if it is not."""
        head = self.store.chunk(key)
        if head is None:
            return self._why("points")
        if not head.holds(self.graph.variables, self.study.gaits):
            return "changed"
        if self.retry and head.has_failed(self.columns):
            return "retried"

        return ""

    def over_study(self) -> Iterator[Node]:
        """Nodes over the study that are missing, or older than what they read, inputs
        first.

        Asked once all other nodes are stored; before, they run if any of these does.
        """
        keys = self.graph.study_keys
        for name, key in keys.items():
            node = self.graph.node(name)
            outcome = self.store.outcome(key)
            if outcome is None:
                yield replace(node, why=self._why(name))
            elif self._latest(self.graph.layers[name].needs) > self.store.number(key):
                yield replace(node, why="its inputs change")
            elif self.retry and outcome.status != "ok":
                yield replace(node, why="retried")

    def _latest(self, needs: tuple[str, ...]) -> int:
        """Number of the latest record of some tasks of the study."""
        graph, number = self.graph, self.store.number
        latest = 0
        if "points" in needs:
            chunks = map(graph.grid.chunk, range(graph.grid.chunks))
            latest = max(
                (number(graph.chunk_key(chunk)) for chunk in chunks), default=0
            )

        for need in set(needs) & set(graph.line_tasks):
            keys = (graph.line_keys(i)[need] for i in range(self.study.batches))
            latest = max(latest, *map(number, keys))

        for need in set(needs) & graph.study_keys.keys():
            latest = max(latest, number(graph.study_keys[need]))
        return latest

    def outcome_of_line(self, number: int) -> Outcome | None:
        """How the atlas of a line ended, for what needs it; None if it is not known, or
        no task of its own.
        """
        keys = self.graph.line_keys(number)
        if "atlas" not in keys:
            return None

        return self.store.outcome(keys["atlas"])


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
    layers = plan.graph.layers
    totals = _totals(plan)
    todo: dict[str, Counter[str]] = {name: Counter() for name in layers}
    if plan.store:
        _count(plan, todo)
    else:
        for name, total in totals.items():
            todo[name]["new"] = total

    cached: dict[str, int] = {}
    seconds = 0.0
    for name, whys in todo.items():
        n = whys.total()
        cached[name] = totals[name] - n
        if n:
            seconds += n * plan.graph.seconds(name)

    if any(whys.total() for whys in todo.values()):
        seconds += costs.starting(plan.study)
    return Summary(todo, cached, seconds)


def _totals(plan: Plan) -> dict[str, int]:
    """What there is to each layer: points, lines or batches of designs, or one."""
    totals: dict[str, int] = {}
    for name, layer in plan.graph.layers.items():
        totals[name] = 1
        if name == "points":
            totals[name] = plan.study.points
        elif layer.per_line:
            totals[name] = plan.study.batches

    return totals


def _count(plan: Plan, todo: dict[str, Counter[str]]) -> None:
    """Count what is missing, by layer and reason."""
    for node in plan.nodes():
        todo[node.task][node.why] += plan.graph.size(node)
        if node.lines:
            todo["atlas"][node.why] += node.lines

    for node in plan.over_study():
        todo[node.task][node.why] += 1
    for name in plan.graph.study_tasks:
        needs = plan.graph.layers[name].needs
        if not todo[name] and any(todo.get(need) for need in needs):
            todo[name]["its inputs change"] = 1
