"""A store in memory."""

import itertools
from collections import OrderedDict
from collections.abc import Iterator

from gaitsweep.pipeline.errors import ArchiveError
from gaitsweep.pipeline.store.record import Record
from gaitsweep.pipeline.store.store import Store


class Memory(Store):
    """Records in a dictionary.

    Parameters
    ----------
    bound : int, optional
        Bytes down to which `trim` drops records.

    Attributes
    ----------
    size : int
        Bytes of all records.
    """

    def __init__(self, bound: float = float("inf")):
        self.bound = bound
        self.size = 0
        self._records: OrderedDict[str, tuple[int, Record]] = OrderedDict()
        self._notes: dict[str, str] = {}
        self._numbers = itertools.count(1)
        self._last = 0

    @property
    def last(self) -> int:
        """Number of the latest record."""
        return self._last

    def damage(self) -> ArchiveError:
        """Error that says that a record is not there."""
        return ArchiveError("A result is not in memory any more.")

    def __contains__(self, key: object) -> bool:
        return key in self._records

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._records, key=self.number))

    def number(self, key: str) -> int:
        """Number of the record with that key; 0 if there is none."""
        return self._records[key][0] if key in self._records else 0

    def put(self, key: str, record: Record) -> None:
        """Store a record, instead of an earlier one with its key."""
        if key in self._records:
            self.drop(key)
        self._last = next(self._numbers)
        self._records[key] = self._last, record
        self.size += record.size

    def trim(self) -> None:
        """Drop records beyond the bound, those that were not used longest first."""
        while self.size > self.bound:
            self.drop(next(iter(self._records)))

    def drop(self, key: str) -> None:
        """Drop a record."""
        _, record = self._records.pop(key)
        self.size -= record.size

    def get(self, key: str) -> Record:
        """A record, which counts as used."""
        if key not in self._records:
            raise self.damage()
        self._records.move_to_end(key)
        return self._records[key][1]

    def head(self, key: str) -> bytes | None:
        """Head of a record, which counts as used; None if there is none."""
        return self.get(key).head if key in self else None

    def note(self, name: str) -> str | None:
        """A note beside the records; None if there is none."""
        return self._notes.get(name)

    def set_note(self, name: str, text: str) -> None:
        """Keep a note beside the records."""
        self._notes[name] = text
