"""The graph of a study: nodes, each a task with its parameters, its key and the keys
that it needs.

It is data, known before anything runs, but for one thing: the charts of a plane may be
two halves, whose charts are nodes too. Nodes are made when they are asked for: a grid
of a million points needs no object per point.
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.pipeline.graph import layers
from gaitsweep.pipeline.graph.keys import digest, digest_of, task_key
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.grid import Chunk, Grid, Shape
from gaitsweep.pipeline.grid.method import Method, scaling_axes, variables
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract.registry import TASKS


def boxes(charts: Mapping[str, np.ndarray], which: str) -> list[dict[str, Any]]:
    """Parts of a box, as the task `charts` returns them: its two `halves`, or those
    whose lines are left `alone`.
    """
    columns = {
        name.removeprefix(f"{which}/"): value.tolist()
        for name, value in charts.items()
        if name.startswith(f"{which}/")
    }
    rows = zip(*columns.values(), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


@dataclass(frozen=True)
class Node:
    """A task over a line (`line` is its number, or that of a batch of designs), a
    chunk, or, without both, the study.

    Charts are those of the plane of a line, or of a `box` that is part of it. `needs`
    are keys of results that it reads, `why` it would run. A chunk over a plane learns
    from `Graph.charts_of` which it needs, and can do without those that failed.
    """

    task: str
    key: str
    needs: tuple[str, ...] = ()
    line: int | None = None
    box: Mapping[str, Any] | None = None
    chunk: Chunk | None = None
    why: str = ""

    @property
    def lines(self) -> int:
        """Number of lines that it computes side by side, with all their points."""
        if self.chunk is None or self.line is not None:
            return 0
        return self.chunk.lines

    @property
    def is_of_line(self) -> bool:
        """Whether it is a task over one line, or one batch of designs."""
        return self.line is not None and self.chunk is None

    @property
    def is_of_study(self) -> bool:
        """Whether it is a task over the whole study."""
        return self.line is None and self.chunk is None

    @property
    def points(self) -> int:
        """Number of points that it computes."""
        return self.chunk.points if self.chunk else 0


class Graph:
    """The graph of a study whose results are kept in a file, or in memory.

    Attributes
    ----------
    layers : dict
        Layers by name, inputs first.
    grid : Grid
    variables : tuple of str
        Variables of points.
    """

    def __init__(self, study: Study, in_memory: bool = False):
        self.study, self.in_memory = study, in_memory
        self.grid = Grid(study, in_memory)
        self.variables = variables(study)
        self.method = self.grid.method
        self.layers = layers.layers(study, self.method)
        #: Key of every task over a line, or a batch of designs; of its points, what the
        #: keys of their chunks share. In the order of the grid, chunks of a line may
        #: come after those of all others.
        self.line_keys = functools.lru_cache(1024)(self._line_keys)
        #: Expected processor time of a task over one line, or over the study; of
        #: `points`, of one [s].
        self.seconds = functools.cache(
            lambda name: costs.seconds(study, name, self.method, self.grid.alike)
        )
        # All lines are cut at the same slopes, and their chunks packed alike; many share
        # a walker, or values of an axis.
        self._packing = functools.cache(self._packing_of)
        self._part = functools.lru_cache(1024)(self._digest_of_part)

    @functools.cached_property
    def atlas_readers(self) -> list[str]:
        """Tasks that read atlases, besides points or the task of the study's kind,
        whose statuses report failures.
        """
        own = ("points", self.study.kind)
        return [
            name
            for name, layer in self.layers.items()
            if "atlas" in layer.needs and name not in own
        ]

    @functools.cached_property
    def line_tasks(self) -> list[str]:
        """Tasks over each line, besides its points; atlases of lines side by side are
        kept for those that read them.
        """
        is_internal = self.method.is_of_lines and not self.atlas_readers
        per_line = (
            name
            for name, layer in self.layers.items()
            if layer.per_line and name not in ("points", "charts")
        )
        return [name for name in per_line if name != "atlas" or not is_internal]

    @functools.cached_property
    def study_tasks(self) -> list[str]:
        """Tasks over the whole study."""
        return [name for name, layer in self.layers.items() if not layer.per_line]

    @functools.cached_property
    def seconds_after(self) -> dict[str, float]:
        """Expected time of the longest chain of tasks that depend on a task of each
        layer [s].
        """
        after = dict.fromkeys(self.layers, 0.0)
        for name, layer in reversed(self.layers.items()):
            chain = self.seconds(name) + after[name]
            for need in layer.needs:
                after[need] = max(after[need], chain)

        return after

    def _line_keys(self, number: int) -> dict[str, str]:
        line = self.study.batch_line(number)
        keys: dict[str, str] = {}
        for name, layer in self.layers.items():
            if layer.per_line:
                params = layers.line_params(self.study, self.method, name, line)
                inputs = [keys[need] for need in layer.needs]
                keys[name] = task_key(layer.task, params, inputs)

        return keys

    def chunk_key(self, chunk: Chunk) -> str:
        """Key of a chunk: of its points, and of how they are packed."""
        if self.method.is_of_lines:
            own = self._key_of_lines(chunk)
        else:
            own = self.line_keys(chunk.line)["points"]
        packing = self._packing(chunk.slopes.start, chunk.slopes.stop, chunk.shape)
        return f"points-{digest(f'{own} {packing}'.encode())}"

    def _packing_of(self, start: int, stop: int, shape: Shape) -> str:
        """What the keys of chunks of that shape at the same slopes share."""
        slopes = digest(self.study.values_along[start:stop].tobytes())
        return f"{slopes} {shape.order} {self.grid.multipliers} {self.grid.keys}"

    def _key_of_lines(self, chunk: Chunk) -> str:
        """Key of all lines of a chunk that are computed side by side: of what all lines
        of the study share, and of their walkers and the values of their axes, in the
        order of the lines.
        """
        spans = {"walker": slice(0, 1), **chunk.spans}
        names = ["walker", *(axis.name for axis in self.study.line_axes)]
        parts = [
            self._part(name, spans[name].start, spans[name].stop) for name in names
        ]
        return " ".join([self._shared_by_lines, *parts])

    @functools.cached_property
    def _shared_by_lines(self) -> str:
        """Key of what all lines of the study share that are computed side by side."""
        study = self.study
        params = {"options": layers.point_params(study, self.method)}
        inputs = ["atlas"]
        if self.method is Method.PLANE and study.plane:
            params["plane"] = study.plane.region
            inputs.append("charts")

        tasks = [self.layers[name].task for name in inputs]
        if self.method is Method.TARGETS:
            tasks.append(TASKS["targets"])
        versions = [f"{task.name} {task.version}" for task in tasks]
        return task_key(self.layers["points"].task, params, versions)

    def _digest_of_part(self, name: str, start: int, stop: int) -> str:
        """Hash of some walkers, or values of an axis of the lines."""
        if name == "walker":
            return digest_of(self.study.walkers[start:stop])
        (axis,) = (axis for axis in self.study.line_axes if axis.name == name)
        return digest(name.encode() + axis.values[start:stop].tobytes())

    @functools.cached_property
    def study_keys(self) -> dict[str, str]:
        """Key of every task over the study."""
        if not self.study_tasks:
            return {}

        chunks = (self.chunk_key(self.grid.chunk(k)) for k in range(self.grid.chunks))
        lines = (
            self.line_keys(i)[name]
            for i in range(self.study.batches)
            for name in self.line_tasks
        )
        below = digest("".join(itertools.chain(chunks, lines)).encode())
        keys: dict[str, str] = {}
        for name in self.study_tasks:
            layer = self.layers[name]
            params = layers.study_params(self.study, name)
            read: list[str] = []
            if layer.needs:
                inputs = [keys[need] for need in layer.needs if need in keys]
                read = [below, *self.study.gaits, *inputs]
            keys[name] = task_key(layer.task, params, read)

        return keys

    def node(self, name: str, line: int | None = None) -> Node:
        """Node of a task over a line, or over the study."""
        keys = self.study_keys if line is None else self.line_keys(line)
        needs = tuple(keys[need] for need in self.layers[name].needs if need in keys)
        return Node(name, keys[name], needs, line)

    def charted(self, charts: Node) -> int:
        """Number of lines that charts are for, with those that differ only in units."""
        plane = self.study.plane
        if not plane:
            return 0
        of_units = math.prod(map(len, scaling_axes(self.study)))
        return of_units * plane.lines_in(charts.box or plane.region)

    def size(self, node: Node) -> int:
        """What plans and progress count of a node: points of a chunk, lines that charts
        are for, else the task.
        """
        if node.chunk:
            return node.points
        return self.charted(node) if node.task == "charts" else 1

    def charts_of(
        self, chunk: Chunk, halves: Callable[[Node], Sequence[Mapping[str, Any]]]
    ) -> Iterator[Node]:
        """Nodes of the charts that predict the gaits of a chunk, those of its plane
        first.

        A plane may have been halved, and so its halves: those of each node are asked
        for when the next is taken.
        """
        if self.method is not Method.PLANE or not self.study.plane:
            return

        number, plane = chunk.line, self.study.plane
        left = [self.node("charts", number)]
        for node in left:  # which grows
            yield node
            for half in halves(node):
                box = {**(node.box or plane.region), **half}
                if plane.lines_in(box, chunk.spans):
                    left.append(self._charts_of_box(number, box))

    def _charts_of_box(self, line: int, box: Mapping[str, Any]) -> Node:
        params = layers.line_params(
            self.study, self.method, "charts", self.study.line(line), box
        )
        key = task_key(self.layers["charts"].task, params)
        return Node("charts", key, line=line, box=box)

    def chunk_node(self, chunk: Chunk) -> Node:
        """Node of a chunk."""
        key = self.chunk_key(chunk)
        if self.method.is_of_lines:
            return Node("points", key, chunk=chunk)
        line = chunk.line
        keys = self.line_keys(line)
        needs = tuple(keys[need] for need in self.layers["points"].needs)
        return Node("points", key, needs, line, chunk=chunk)

    def function(self, node: Node) -> str:
        """Function of the task of a node; of lines side by side, that of their atlases
        and points.
        """
        if not node.lines:
            return self.layers[node.task].task.function
        if self.method is Method.TARGETS:
            return TASKS["targets"].function
        atlas = self.layers["atlas"].task
        return atlas.over_plane if self.method is Method.PLANE else atlas.side_by_side

    def params(self, node: Node) -> dict[str, Any]:
        """Parameters of the task of a node; of lines side by side, those of each are in
        a list.
        """
        study, method = self.study, self.method
        if node.chunk is not None:
            return self._chunk_params(node, node.chunk)
        if node.line is None:
            return layers.study_params(study, node.task)
        line = study.batch_line(node.line)
        return layers.line_params(study, method, node.task, line, node.box)

    def _chunk_params(self, node: Node, chunk: Chunk) -> dict[str, Any]:
        study, method = self.study, self.method
        shared = {
            "slope": study.values_along[chunk.slopes],
            "want": self.variables,
            "gaits": study.gaits,
        }
        if node.line is not None:
            line = study.line(node.line)
            return {**layers.line_params(study, method, "points", line), **shared}

        params: dict[str, Any] = {
            "lines": study.lines_at(chunk.numbers),
            "atlases": "atlas" in self.line_tasks,
        }
        if method is Method.PLANE and study.plane:
            params["plane"] = study.plane.region
        return {**params, **layers.point_params(study, method), **shared}
