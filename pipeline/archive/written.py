"""What has been written to an archive, and what several of its writers share."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.archive.attributes import put
from gaitsweep.pipeline.study.model import Study


@dataclass
class Written:
    """Contents of an archive: points (or lines) by status, and failures by reason with
    an example of each.
    """

    counts: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    examples: dict[str, str] = field(default_factory=dict)

    def add_failure(self, reason: str, n: int, example: str) -> None:
        """Count failures of one reason."""
        self.failures[reason] += n
        self.examples.setdefault(reason, example)


class Sentences:
    """The sentences of an archive, in their order, of which `reason` holds the numbers.

    Parameters
    ----------
    texts : mapping
        Sentences by their numbers in records.
    """

    def __init__(self, texts: Mapping[int, str]):
        self.texts = sorted(set(texts.values()))
        self.dtype: np.dtype = np.dtype("i2")
        if len(self.texts) > np.iinfo(np.int16).max:
            self.dtype = np.dtype("i4")

        known = sorted(texts)
        place_of = {text: place for place, text in enumerate(self.texts)}
        places = [place_of[texts[number]] for number in known]
        self._known = np.array(known, np.uint64)
        self._places = np.array(places, self.dtype)

    def renumbered(self, reason: np.ndarray) -> np.ndarray:
        """Numbers in the archive of those in records; of a number that is not known,
        any.
        """
        place = np.searchsorted(self._known, reason)
        return self._places[np.minimum(place, len(self._known) - 1)]


def write_variable(
    group: Any,
    name: str,
    dims: tuple[str, ...],
    values: np.ndarray,
    attributes: dict[str, Any],
    **options: Any,
) -> None:
    """Write a small variable with its attributes; the options are those of netCDF4,
    without a fill value if none.
    """
    options = {"fill_value": False, **options}
    dtype = values.dtype.newbyteorder("=")
    variable = group.createVariable(name, dtype, dims, **options)
    put(variable, attributes)
    variable[...] = values


def write_strings(
    group: Any, name: str, dim: str, values: Iterable[str], attributes: dict[str, str]
) -> None:
    """Write a variable of strings as characters, which netCDF4 and xarray read as
    strings.

    HDF5 crashes where strings of varying length are read of a file that the same
    process has opened several times.
    """
    encoded = [value.encode() for value in values]
    length = max(map(len, encoded), default=0) or 1
    of_characters = f"{layout.STRING}{length}"
    if of_characters not in group.dimensions:
        group.createDimension(of_characters, length)

    filters = layout.filters(len(encoded))
    variable = group.createVariable(name, "S1", (dim, of_characters), **filters)
    put(variable, {**attributes, "_Encoding": "utf-8"})
    characters = np.array(encoded, f"S{length}").view("S1")
    variable.set_auto_chartostring(False)
    variable[:] = characters.reshape(-1, length)
    variable.set_auto_chartostring(True)


def line_description(study: Study, number: int) -> str:
    """Name of a line in messages: its walker and parameters."""
    words = [study.name_of(number)]
    for key, value in study.line(number)["set"].items():
        words.append(f"{key}={value!r}")
    return " ".join(words)
