"""Points as tasks return them and archives hold them: an array for each variable.

A sentence is known by a number made from its text, until the archive numbers those that
it holds.
"""

import functools
import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.pipeline.statuses import ENDINGS
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES

#: Type of the numbers of sentences.
REASON = np.dtype("u8")


@functools.lru_cache(4096)
def sentence_number(sentence: str) -> int:
    """Number that stands for a sentence."""
    digest = hashlib.blake2b(sentence.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little")


def dtype_of(name: str) -> np.dtype:
    """Type of a variable in a record."""
    if name == "reason":
        return REASON
    return np.dtype(VARIABLES[name].dtype)


@dataclass
class Points:
    """Points, line by line.

    Attributes
    ----------
    values : dict of ndarray, shape (n, gaits[, multipliers])
        `status` and `reason`, of all gaits; the other variables perhaps without
        trailing gaits that do not exist.
    sentences : dict
        Sentences of `reason`, by their numbers.
    """

    values: dict[str, ndarray]
    sentences: dict[int, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.values["status"])

    @classmethod
    def of_task(cls, returned: Any, params: Mapping[str, Any]) -> "Points":
        """What a task with these parameters returns for a chunk of a line, or of lines
        side by side with their atlases; its arrays are handed on, not copied.

        Raises
        ------
        ValueError
            If a variable has not the shape of the points, or they are not those of the
            lines.
        """
        results = [returned]
        if "lines" in params:
            results = [result for _, result in returned]

        parts = [cls._of_result(result, params["want"]) for result in results]
        points = parts[0]
        if len(parts) > 1:
            points = joined(parts)

        lines = len(params.get("lines", [None]))
        count = lines * len(params["slope"])
        if len(points) != count:
            raise ValueError(f"{len(points)} points are returned of {count}")

        return points

    @classmethod
    def _of_result(cls, result: Mapping[str, Any], want: Iterable[str]) -> "Points":
        """What a task returns for points of a line."""
        others = [name for name in want if name not in ("status", "reason")]
        values: dict[str, ndarray] = {}
        for name in ("status", *others):
            array = np.asarray(result[name], VARIABLES[name].dtype)
            values[name] = array
            shape = values["status"].shape
            if array.shape[:2] != shape:
                raise ValueError(f"`{name}` has shape {array.shape}, `status` {shape}")

        sentences = [str(sentence) for sentence in result["reasons"]] or [""]
        numbers = [sentence_number(sentence) for sentence in sentences]
        reason = np.asarray(result["reason"])
        values["reason"] = np.array(numbers, REASON)[reason]

        occurrences = np.bincount(reason.ravel(), minlength=len(sentences))
        occurs = np.flatnonzero(occurrences).tolist()
        return cls(values, {numbers[k]: sentences[k] for k in occurs})

    @classmethod
    def of_ending(
        cls,
        points: int,
        ending: str,
        reason: str,
        want: Iterable[str],
    ) -> "Points":
        """Points whose worker ended so, a name of `statuses.ENDINGS`."""
        values = {}
        for name in want:
            inner = [0 for _ in inner_sizes(name, 0, 0)]
            values[name] = np.empty((points, 0, *inner), dtype_of(name))

        number = sentence_number(reason)
        shape = (points, len(GAITS))
        values["status"] = np.full(shape, ENDINGS[ending], np.int8)
        values["reason"] = np.full(shape, number, REASON)
        return cls(values, {number: reason})

    def copy(self) -> "Points":
        """The same in arrays of its own."""
        values = {name: array.copy() for name, array in self.values.items()}
        return Points(values, self.sentences)

    def take(self, rows: ndarray) -> "Points":
        """Some of the points, in that order."""
        if np.array_equal(rows, np.arange(len(self))):
            return self
        values = {name: array[rows] for name, array in self.values.items()}
        return Points(values, self.sentences)


def joined(parts: Sequence[Points], gaits: int = 0, multipliers: int = 0) -> Points:
    """Points one after the other; of a variable as many gaits and multipliers as any
    part has, and at least so many.
    """
    sentences: dict[int, str] = {}
    for part in parts:
        sentences.update(part.sentences)

    values = {}
    for name in parts[0].values:
        arrays = [part.values[name] for part in parts]
        inner = [array.shape[1:] for array in arrays]
        least = gaits, *inner_sizes(name, multipliers, 0)
        sizes = zip(least, *inner, strict=True)
        shape = tuple(map(max, sizes))
        wide = [widened(name, array, shape) for array in arrays]
        values[name] = wide[0]
        if len(wide) > 1:
            values[name] = np.concatenate(wide)

    return Points(values, sentences)


def widened(name: str, values: ndarray, shape: tuple[int, ...]) -> ndarray:
    """Values of points with so many gaits and multipliers, of which the last are
    absent.
    """
    if values.shape[1:] == shape:
        return values

    absent = VARIABLES[name].absent
    whole = np.full((len(values), *shape), absent, values.dtype)
    there = tuple(map(slice, values.shape))
    whole[there] = values
    return whole


def inner_sizes(name: str, multipliers: int, keys: int) -> tuple[int, ...]:
    """Sizes of the dimensions of a variable after the gait, of walkers with so many
    multipliers, differentiated by so many keys.
    """
    sizes = {"multiplier": multipliers, "key": keys}
    return tuple(sizes[dim] for dim in VARIABLES[name].dims[1:])


def has_multipliers(name: str) -> bool:
    """Whether a variable has a value for each multiplier."""
    return "multiplier" in VARIABLES[name].dims
