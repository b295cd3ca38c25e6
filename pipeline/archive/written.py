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
        places = {text: place for place, text in enumerate(self.texts)}
        self.dtype = np.dtype("i4" if len(places) > np.iinfo(np.int16).max else "i2")
        self._known = np.array(sorted(texts), np.uint64)
        self._places = np.array(
            [places[texts[number]] for number in self._known.tolist()], self.dtype
        )

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
    variable = group.createVariable(
        name, values.dtype.newbyteorder("="), dims, **{"fill_value": False, **options}
    )
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
    dims = dim, f"{layout.STRING}{length}"
    if dims[1] not in group.dimensions:
        group.createDimension(dims[1], length)
    variable = group.createVariable(name, "S1", dims, **layout.filters(len(encoded)))
    put(variable, {**attributes, "_Encoding": "utf-8"})
    variable.set_auto_chartostring(False)
    variable[:] = np.array(encoded, f"S{length}").view("S1").reshape(-1, length)
    variable.set_auto_chartostring(True)


def line_description(study: Study, number: int) -> str:
    """Name of a line in messages: its walker and parameters."""
    return " ".join(
        [
            study.name_of(number),
            *(f"{key}={value!r}" for key, value in study.line(number)["set"].items()),
        ]
    )
