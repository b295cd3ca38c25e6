"""What is kept in memory, within a bound: records, or results as they are."""

import itertools
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from typing import Any

from gaitsweep.pipeline.errors import ArchiveError
from gaitsweep.pipeline.store.record import Record
from gaitsweep.pipeline.store.store import Store


class Memory(Store):
    """Records in a dictionary; beyond a bound of bytes those least recently used are
    dropped.

    Parameters
    ----------
    bound : int, optional
        Without it nothing is dropped.
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
            self._drop(key)
        self._last = next(self._numbers)
        self._records[key] = self._last, record
        self.size += sum(map(len, record))
        while self.size > self.bound:
            self._drop(next(iter(self._records)))

    def _drop(self, key: str) -> None:
        _, record = self._records.pop(key)
        self.size -= sum(map(len, record))

    def get(self, key: str) -> Record:
        """A record, which counts as used."""
        if key not in self._records:
            raise self.damage()
        self._records.move_to_end(key)
        return self._records[key][1]

    def head(self, key: str) -> bytes:
        """Head of a record."""
        return self.get(key).head

    def note(self, name: str) -> str | None:
        """A note beside the records; None if there is none."""
        return self._notes.get(name)

    def set_note(self, name: str, text: str) -> None:
        """Keep a note beside the records."""
        self._notes[name] = text


class Results:
    """Results as they are, by their keys, the least recently used dropped beyond a
    bound of bytes.
    """

    def __init__(self, bound: int):
        self.bound = bound
        self.size = 0
        self._results: OrderedDict[Hashable, tuple[int, Any]] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._results

    def get(self, key: Hashable) -> Any:
        """A result; None if it is not remembered."""
        if key not in self._results:
            return None
        self._results.move_to_end(key)
        return self._results[key][1]

    def put(self, key: Hashable, result: Any, size: int) -> None:
        """Remember a result that is not, of so many bytes."""
        self._results[key] = size, result
        self.size += size
        while self.size > self.bound:
            self.size -= self._results.popitem(last=False)[1][0]
