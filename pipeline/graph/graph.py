"""The graph of a study: nodes, each a task with its parameters, its key and the keys
that it needs.

Nodes are made when they are asked for: a grid of a million points needs no object per
point.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gaitsweep.pipeline.graph import layers
from gaitsweep.pipeline.graph.keys import digest, mixed, task_key, words
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.grid import Chunk, Grid
from gaitsweep.pipeline.grid.method import Method, variables
from gaitsweep.pipeline.store.store import Key
from gaitsweep.pipeline.study.model import Study


def boxes(charts: Mapping[str, np.ndarray], which: str) -> list[dict[str, Any]]:
    """Parts of a box, as the task `charts` returns them: its two `halves`, or those
    whose lines are left `alone`.
    """
    own = {
        name.removeprefix(f"{which}/"): value.tolist()
        for name, value in charts.items()
        if name.startswith(f"{which}/")
    }
    return [
        dict(zip(own, values, strict=True))
        for values in zip(*own.values(), strict=True)
    ]


@dataclass(frozen=True)
class Node:
    """A task over a line (`line` is its number, or that of a batch of designs), a
    chunk, or, without both, the study.

    Charts are those of the plane of a line, or of a `box` that is part of it. `needs`
    are keys of results that it reads, `why` it would run. A chunk over a plane learns
    from `Graph.charts_of` which it needs, and can do without those that failed. Of a
    chunk of lines side by side, `todo` are the places of those to compute, and `copies`
    the others, if there are any: by the key of the record that holds them, their places
    in the chunk and there.
    """

    task: str
    key: Key
    needs: tuple[str, ...] = ()
    line: int | None = None
    box: Mapping[str, Any] | None = None
    chunk: Chunk | None = None
    why: str = ""
    todo: np.ndarray | None = None
    copies: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @property
    def lines(self) -> int:
        """Number of lines that it computes with all their points."""
        return 0 if self.todo is None else len(self.todo)

    @property
    def numbers(self) -> np.ndarray:
        """Numbers of these lines."""
        assert self.chunk is not None and self.todo is not None
        return self.chunk.numbers[self.todo]

    @property
    def points(self) -> int:
        """Number of points that it computes."""
        if self.chunk is None:
            return 0
        return (
            self.chunk.points if self.todo is None else self.lines * self.chunk.per_line
        )


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
        self.study, self.grid, self.variables = (
            study,
            Grid(study, in_memory),
            variables(study),
        )
        self.method = self.grid.method
        self.layers = layers.layers(study, self.method)
        #: Key of every task over a line, or a batch of designs; of its points, what the
        #: keys of their chunks share. In the order of the grid, chunks of a line may
        #: come after those of all others.
        self.line_keys = functools.lru_cache(1024)(self._line_keys)
        # All lines are cut at the same slopes.
        self._slopes_digest = functools.cache(
            lambda *ends: digest(study.slope[slice(*ends)].tobytes())
        )

    @property
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

    @property
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

    @property
    def study_tasks(self) -> list[str]:
        """Tasks over the whole study."""
        return [name for name, layer in self.layers.items() if not layer.per_line]

    def _line_keys(self, number: int) -> dict[str, Key]:
        line, keys = self.study.batch_line(number), dict[str, Key]()
        for name, layer in self.layers.items():
            if layer.per_line:
                params = layers.line_params(self.study, self.method, name, line)
                keys[name] = task_key(
                    layer.task, params, [keys[need].key for need in layer.needs]
                )
        return keys

    def digests(self, numbers: np.ndarray, versioned: bool = True) -> np.ndarray:
        """Digests of lines that are computed side by side; unless `versioned`, those of
        all versions of the tasks.

        Parameters
        ----------
        numbers : ndarray of int, shape (n,)
        versioned : bool

        Returns
        -------
        ndarray of uint64, shape (n, 2)
        """
        walkers, *indices = np.unravel_index(numbers, self.study.line_shape)
        axes = sorted(
            zip(self.study.line_axes, indices, strict=True),
            key=lambda pair: pair[0].name,
        )
        values = [axis.values[index].astype(float) for axis, index in axes]
        values += [np.full(len(numbers), mark).view(float) for mark in self._marks]
        return mixed(self._walker_digests[walkers, 0 if versioned else 1], values)

    @functools.cached_property
    def _marks(self) -> list[np.ndarray]:
        """Marks of what lines share: the charts of a plane, and the slopes, computed
        together and in their order.
        """
        shared = [self.study.slope.astype(float)]
        if self.method is Method.PLANE and self.study.plane:
            region = self.study.plane.region
            shared.insert(
                0,
                np.array(
                    [*region["low"], *region["high"], *region["log"], region["lines"]]
                ),
            )
        return [words(values.tobytes(), 1) for values in shared]

    @functools.cached_property
    def _walker_digests(self) -> np.ndarray:
        """Digests of each walker with all that its lines share, for this version of the
        tasks and for all.
        """
        names = (
            "points",
            "atlas",
            *(("charts",) if self.method is Method.PLANE else ()),
        )
        points, *others = (self.layers[name].task for name in names)
        shared = {
            "options": layers.point_params(self.study, self.method),
            "keys": sorted(axis.name for axis in self.study.line_axes),
        }
        versions = [f"{task.name} {task.version}" for task in others]
        keys = [
            task_key(points, {**shared, "walker": walker}, versions)
            for walker in self.study.walkers
        ]
        return np.array([[words(text.encode(), 2) for text in key] for key in keys])

    def chunk_key(self, chunk: Chunk, versioned: bool = True) -> str:
        """Key of a chunk: of its points, and of how they are packed; unless
        `versioned`, that of all versions.
        """
        if self.method.is_of_lines:
            own = digest(self.digests(chunk.numbers, versioned).tobytes())
        else:
            own = self.line_keys(int(chunk.numbers[0]))["points"][0 if versioned else 1]
        slopes = self._slopes_digest(chunk.slopes.start, chunk.slopes.stop)
        packed = f" {chunk.shape.order} {self.grid.multipliers}" if versioned else ""
        return f"points-{digest(f'{own} {slopes}{packed}'.encode())}"

    @functools.cached_property
    def study_keys(self) -> dict[str, Key]:
        """Key of every task over the study."""
        if not self.study_tasks:
            return {}
        chunks = (self.chunk_key(self.grid.chunk(k)) for k in range(self.grid.chunks))
        lines = (
            self.line_keys(i)[name].key
            for i in range(self.study.batches)
            for name in self.line_tasks
        )
        shared = [
            digest("".join(itertools.chain(chunks, lines)).encode()),
            *self.study.gaits,
        ]
        keys: dict[str, Key] = {}
        for name in self.study_tasks:
            layer = self.layers[name]
            inputs = [keys[need].key for need in layer.needs if need in keys]
            keys[name] = task_key(
                layer.task, layers.study_params(self.study, name), [*shared, *inputs]
            )
        return keys

    def node(self, name: str, line: int | None = None) -> Node:
        """Node of a task over a line, or over the study."""
        keys = self.study_keys if line is None else self.line_keys(line)
        return Node(
            name,
            keys[name],
            tuple(keys[need].key for need in self.layers[name].needs if need in keys),
            line,
        )

    def charted(self, charts: Node) -> int:
        """Number of lines that charts are for."""
        plane = self.study.plane
        return plane.lines_in(charts.box or plane.region) if plane else 0

    def seconds(self, name: str) -> float:
        """Expected processor time of a task over one line, or over the study; of
        `points`, of one [s].
        """
        return costs.seconds(self.study, name, self.method)

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
        number, plane = int(chunk.numbers[0]), self.study.plane
        left = [self.node("charts", number)]
        for node in left:  # which grows
            yield node
            for half in halves(node):
                box = {**(node.box or plane.region), **half}
                if plane.lines_in(box, chunk.spans):
                    params = layers.line_params(
                        self.study, self.method, "charts", self.study.line(number), box
                    )
                    key = task_key(self.layers["charts"].task, params)
                    left.append(Node("charts", key, line=number, box=box))

    def chunk_node(self, chunk: Chunk) -> Node:
        """Node of a chunk."""
        key = Key(self.chunk_key(chunk), self.chunk_key(chunk, versioned=False))
        if self.method.is_of_lines:
            return Node("points", key, chunk=chunk, todo=np.arange(len(chunk.numbers)))
        return replace(self.node("points", int(chunk.numbers[0])), key=key, chunk=chunk)

    def function(self, node: Node) -> str:
        """Function of the task of a node; of lines side by side, that of their atlases
        and points.
        """
        if not node.lines:
            return self.layers[node.task].task.function
        atlas = self.layers["atlas"].task
        return atlas.over_plane if self.method is Method.PLANE else atlas.side_by_side

    def params(self, node: Node) -> dict[str, Any]:
        """Parameters of the task of a node; of lines side by side, those of each are in
        a list.
        """
        study, chunk = self.study, node.chunk
        if chunk is None:
            if node.line is None:
                return layers.study_params(study, node.task)
            return layers.line_params(
                study, self.method, node.task, study.batch_line(node.line), node.box
            )
        shared = {
            "slope": study.slope[chunk.slopes],
            "want": self.variables,
            "gaits": study.gaits,
        }
        if node.line is not None:
            return {
                **layers.line_params(
                    study, self.method, "points", study.line(node.line)
                ),
                **shared,
            }
        own: dict[str, Any] = {
            "lines": study.lines_at(node.numbers),
            "atlases": "atlas" in self.line_tasks,
        }
        if self.method is Method.PLANE and study.plane:
            own["plane"] = study.plane.region
        return {**own, **layers.point_params(study, self.method), **shared}
