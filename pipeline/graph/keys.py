"""Keys of results, of all that decides them: of a task, and of the lines of a chunk that are computed side by side.

Digests of such lines, of sixteen bytes each, are not made line by line in Python, so that a plane of a million lines is
planned in seconds. A line has its digest whatever chunk of whatever grid it is computed in.
"""

import functools
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.pipeline.graph import layers
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.store.store import Key
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.registry import Task

#: Constants of the finalizer of splitmix64 (Steele, Lea and Flood 2014, doi:10.1145/2660193.2660195).
_INCREMENT, _FIRST, _SECOND = (np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))


def task_key(task: Task, params: Mapping[str, Any], inputs: Iterable[str] = ()) -> Key:
    """Key of a task with these parameters and the keys of its inputs."""
    plain = _canonical(params)
    versioned = json.dumps([task.name, task.version, plain, list(inputs)], separators=(",", ":"))
    # Results to another accuracy are those of a changed study, as of another version.
    kept = {name: value for name, value in plain.items() if name != "accuracy"}
    unversioned = json.dumps([task.name, kept], separators=(",", ":"))
    return Key(*(f"{task.name}-{digest(text.encode())}" for text in (versioned, unversioned)))


def digest(data: bytes) -> str:
    """Hash of some bytes, for keys."""
    return hashlib.sha256(data).hexdigest()


def _canonical(x: Any) -> Any:
    if isinstance(x, float):
        return x.hex()
    if isinstance(x, Mapping):
        return {k: _canonical(x[k]) for k in sorted(x)}
    if isinstance(x, list | tuple):
        return [_canonical(v) for v in x]
    if isinstance(x, np.ndarray):
        return [x.dtype.str, list(x.shape), digest(x.tobytes())]
    return x


@dataclass(frozen=True)
class Digests:
    """Digests of the lines of a study, which has these layers and this method."""

    study: Study
    layers: Mapping[str, layers.Layer]
    method: Method

    def __call__(self, numbers: np.ndarray, versioned: bool = True) -> np.ndarray:
        """Digests of lines; unless `versioned`, those of all versions of the tasks.

        Parameters
        ----------
        numbers : ndarray of int, shape (n,)
        versioned : bool

        Returns
        -------
        ndarray of uint64, shape (n, 2)
        """
        walkers, *indices = np.unravel_index(numbers, self.study.line_shape)
        digest = self._walkers[versioned][walkers]
        axes = sorted(zip(self.study.line_axes, indices, strict=True), key=lambda pair: pair[0].name)
        values = [axis.values[index].astype(float) for axis, index in axes]
        values += [np.full(len(numbers), mark).view(float) for mark in self._shared]
        for value in values:
            z = (digest ^ value.view(np.uint64)[:, None]) + _INCREMENT
            z = (z ^ z >> np.uint64(30)) * _FIRST
            z = (z ^ z >> np.uint64(27)) * _SECOND
            digest = z ^ z >> np.uint64(31)
        return digest

    @functools.cached_property
    def _shared(self) -> list[np.uint64]:
        """Marks of what lines share: the charts of a plane, and the slopes, computed together and in their order."""
        shared = [self.study.slope]
        if self.method is Method.PLANE and self.study.plane:
            region = self.study.plane.region
            shared.insert(0, np.array([*region["low"], *region["high"], *region["log"], region["lines"]]))
        return [_mark(values) for values in shared]

    @functools.cached_property
    def _walkers(self) -> dict[bool, np.ndarray]:
        """Digest of each walker with all that its lines share, for this version of the tasks and for all."""
        names = ("atlas", "points", *(("charts",) if self.method is Method.PLANE else ()))
        tasks = [self.layers[name].task for name in names]
        shared = {
            "options": layers.point_params(self.study, self.method),
            "keys": sorted(axis.name for axis in self.study.line_axes),
        }
        keys = [
            task_key(
                tasks[1],
                {**shared, "walker": walker},
                [f"{task.name} {task.version}" for task in (tasks[0], *tasks[2:])],
            )
            for walker in self.study.walkers
        ]
        texts = {True: [key.key for key in keys], False: [key.kin for key in keys]}
        return {
            versioned: np.array([np.frombuffer(hashlib.sha256(t.encode()).digest()[:16], np.uint64) for t in each])
            for versioned, each in texts.items()
        }


def _mark(values: np.ndarray) -> np.uint64:
    """A number that stands for some values."""
    return np.uint64(np.frombuffer(hashlib.sha256(values.astype(float).tobytes()).digest()[:8], np.uint64)[0])
