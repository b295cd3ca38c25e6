"""Keys of results, of all that decides them: of a task, and of the lines of a chunk
that are computed side by side.

Digests of such lines, of sixteen bytes each, are not made line by line in Python, so
that a plane of a million lines is planned in seconds. A line has its digest whatever
chunk of whatever grid it is computed in.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gaitsweep.pipeline.store.store import Key
from gaitsweep.tasks.registry import Task

#: Constants of the finalizer of splitmix64 (Steele, Lea and Flood 2014,
#: doi:10.1145/2660193.2660195).
_INCREMENT, _FIRST, _SECOND = (
    np.uint64(c) for c in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB)
)


def task_key(task: Task, params: Mapping[str, Any], inputs: Iterable[str] = ()) -> Key:
    """Key of a task with these parameters and the keys of its inputs."""
    # Results to another accuracy are those of a changed study, as of another version.
    kept = {name: value for name, value in params.items() if name != "accuracy"}
    parts = [task.name, task.version, params, list(inputs)], [task.name, kept]
    texts = (json.dumps(part, default=_of_array, sort_keys=True) for part in parts)
    return Key(*(f"{task.name}-{digest(text.encode())}" for text in texts))


def digest(data: bytes) -> str:
    """Hash of some bytes, for keys."""
    return hashlib.sha256(data).hexdigest()


def _of_array(x: np.ndarray) -> list[Any]:
    """What stands for an array in the text of a key."""
    return [x.dtype.str, list(x.shape), digest(x.tobytes())]


def words(data: bytes, n: int) -> np.ndarray:
    """The first words of a hash of some bytes, shape (n,)."""
    return np.frombuffer(hashlib.sha256(data).digest(), np.uint64, n)


def mixed(digests: np.ndarray, values: Iterable[np.ndarray]) -> np.ndarray:
    """Digests, shape (n, 2), each with some more numbers: of each array of `values` its
    own.
    """
    for value in values:
        z = (digests ^ value.view(np.uint64)[:, None]) + _INCREMENT
        z = (z ^ z >> np.uint64(30)) * _FIRST
        z = (z ^ z >> np.uint64(27)) * _SECOND
        digests = z ^ z >> np.uint64(31)
    return digests
