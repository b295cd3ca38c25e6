"""Keys of results, made of all that decides them."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.registry import Task


def task_key(task: Task, params: Mapping[str, Any], inputs: Iterable[str] = ()) -> str:
    """Key of a task with these parameters and the keys of its inputs."""
    parts = [task.name, task.version, params, list(inputs)]
    return f"{task.name}-{digest_of(parts)}"


def digest_of(values: Any) -> str:
    """Hash of nested lists, tables, numbers, texts and arrays."""
    text = json.dumps(values, default=_of_array, sort_keys=True)
    return digest(text.encode())


def digest(data: bytes) -> str:
    """Hash of some bytes, for keys."""
    return hashlib.sha256(data).hexdigest()


def _of_array(x: np.ndarray) -> list[Any]:
    """What stands for an array in the text of a key."""
    return [x.dtype.str, list(x.shape), digest(x.tobytes())]
