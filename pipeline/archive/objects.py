"""Objects of an HDF5 file that may be foreign or damaged, looked at before the netCDF
library opens it.

That library follows every link, and reads whatever a variable names: other files, data
put together from others, types and filters of libraries that are loaded for them. It
cannot say that it does, so h5py is asked, which follows nothing.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5t

_MOST_OBJECTS = 1 << 12  # of a file
_MOST_ATTRIBUTES = 1 << 10  # of an object
_MOST_LEVELS = 8  # of groups in groups
_MOST_TEXTS = 16  # of varying length, in an attribute
_LARGEST_CHUNK = 1 << 26  # [byte]
_FILTERS = {1, 2, 3}  # deflate, shuffle, fletcher32
# Attributes by which variables and their dimensions find each other.
_REFERENCES = ("DIMENSION_LIST", "REFERENCE_LIST")


def fault(path: Path) -> str:
    """What an archive never holds, if the file holds it: a sentence without a full
    stop, else empty.

    Raises
    ------
    OSError
        If it is no HDF5 file.
    """
    with h5py.File(path, "r") as file:
        try:
            # The first is the last: what lies behind it is not opened.
            return next(_Inspection(path.stat().st_size).of_group(file.id, ""), "")
        except MemoryError:
            raise
        except Exception as error:
            return f"its objects cannot be listed ({type(error).__name__})"


@dataclass
class _Inspection:
    """An inspection of a file of so many bytes: where the objects lie that it has met,
    and the length of texts.
    """

    size: int
    met: set[int] = field(default_factory=set)
    texts: int = 0

    def of_group(self, group: Any, place: str) -> Iterator[str]:
        """Faults of a group and of what it holds."""
        yield from self.of_attributes(group, place or "/")
        if place.count("/") > _MOST_LEVELS:
            yield f"`{place}` lies in more than {_MOST_LEVELS} groups"
        if len(self.met) + group.get_num_objs() > _MOST_OBJECTS:
            yield f"`{place or '/'}` holds more objects than the {_MOST_OBJECTS:,} that an archive may have"

        self.met.add(h5o.get_info(group).addr)
        for name in group:
            at = f"{place}/{name.decode(errors='replace')}"
            link = group.links.get_info(name).type
            if link == h5l.TYPE_EXTERNAL:
                yield f"`{at}` is a link to another file"
            elif link != h5l.TYPE_HARD:
                yield f"`{at}` is a link"

            about = h5o.get_info(group, name)
            if about.addr in self.met:
                yield f"`{at}` is a second name of another object"
            if about.type == h5o.TYPE_NAMED_DATATYPE:
                yield f"`{at}` is a type of its own"

            found = h5o.open(group, name)
            if isinstance(found, h5g.GroupID):
                yield from self.of_group(found, at)
            else:
                self.met.add(about.addr)
                yield from self.of_attributes(found, at)
                yield from _of_variable(found, at)

    def of_attributes(self, owner: Any, at: str) -> Iterator[str]:
        """Faults of the attributes of an object."""
        if h5a.get_num_attrs(owner) > _MOST_ATTRIBUTES:
            yield f"`{at}` has more than {_MOST_ATTRIBUTES:,} attributes"
        names = list[bytes]()
        h5a.iterate(owner, lambda name, *_: names.append(name))
        for name in names:
            attribute, called = (
                h5a.open(owner, name),
                f"the attribute `{name.decode(errors='replace')}` of `{at}`",
            )
            kind, n = (
                attribute.get_type(),
                attribute.get_space().get_simple_extent_npoints(),
            )
            if n * kind.get_size() > self.size:
                yield f"{called} is declared larger than the file"
            if name.decode(errors="replace") in _REFERENCES:
                continue
            if not _is_plain(kind):
                yield f"{called} has a type that no archive has"
            if _is_varying(kind):
                if n > _MOST_TEXTS:
                    yield f"{called} lists more than {_MOST_TEXTS} texts"
                self.texts += _length(attribute)
                if self.texts > self.size:
                    yield f"{called} repeats a text: those of all attributes are longer than the file"


def _of_variable(variable: Any, at: str) -> Iterator[str]:
    """Faults of a variable: whence its values come, their type, and how they are
    packed.
    """
    made = variable.get_create_plist()
    layout = made.get_layout()
    if made.get_external_count():
        yield f"`{at}` has its values in another file"
    if layout == h5d.VIRTUAL:
        yield f"`{at}` has its values in other variables"

    kind = variable.get_type()
    if not _is_plain(kind) or _is_varying(kind):
        yield f"`{at}` has a type that no archive has"
    if not {made.get_filter(i)[0] for i in range(made.get_nfilters())} <= _FILTERS:
        yield f"`{at}` is packed by a filter that no archive has"
    if (
        layout == h5d.CHUNKED
        and math.prod(made.get_chunk()) * kind.get_size() > _LARGEST_CHUNK
    ):
        yield f"`{at}` has chunks larger than {_LARGEST_CHUNK >> 20} MiB"

    # HDF5 reads as many entries into memory for as many dimensions.
    if h5a.exists(variable, b"DIMENSION_LIST"):
        entries = (
            h5a.open(variable, b"DIMENSION_LIST")
            .get_space()
            .get_simple_extent_npoints()
        )
        if entries != variable.rank:
            yield f"the attribute `DIMENSION_LIST` of `{at}` has another number of dimensions"


def _is_plain(kind: Any) -> bool:
    """Whether a type is one of numbers or of text, defined nowhere else."""
    return not kind.committed() and kind.get_class() in (
        h5t.INTEGER,
        h5t.FLOAT,
        h5t.STRING,
    )


def _is_varying(kind: Any) -> bool:
    """Whether a type is text of varying length, of which many values may be one text in
    the file.
    """
    return kind.get_class() == h5t.STRING and kind.is_variable_str()


def _length(attribute: Any) -> int:
    """Length of the texts of an attribute [byte]."""
    texts = np.empty(attribute.shape, attribute.dtype)
    attribute.read(texts)
    return sum(len(text) for text in texts.ravel().tolist())
