"""What every store of results is: records by their keys, in a file or in memory.

A record has a head, which is small, and a payload. Of a chunk of points they are what
`record.ChunkCodec` makes; of a task over a line or a study the head says how it ended,
and the payload is its packed result.
"""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.statuses import ENDINGS
from gaitsweep.pipeline.store.points import Points
from gaitsweep.pipeline.store.record import ChunkCodec, Head, Record


class Outcome(NamedTuple):
    """How a task ended: "ok" or a name of `statuses.ENDINGS`, and the reason."""

    status: str
    reason: str


class Store(ABC):
    """Records by their keys; the keys are iterated in the order of their records."""

    @abstractmethod
    def __contains__(self, key: object) -> bool:
        """Whether there is a record with that key."""

    @abstractmethod
    def __iter__(self) -> Iterator[str]:
        """Keys of all records, the latest record last."""

    @abstractmethod
    def put(self, key: str, record: Record) -> None:
        """Store a record, instead of an earlier one with its key."""

    @abstractmethod
    def get(self, key: str) -> Record:
        """A record.

        Raises
        ------
        ArchiveError
            If there is none, or it is not as it was written.
        """

    @abstractmethod
    def head(self, key: str) -> bytes | None:
        """Head of a record, without reading its payload; None if there is none.

        Raises
        ------
        ArchiveError
            If it is not as it was written.
        """

    @abstractmethod
    def number(self, key: str) -> int:
        """Number of the record with that key, which later ones have larger; 0 if there
        is none.
        """

    @property
    @abstractmethod
    def last(self) -> int:
        """Number of the latest record; 0 if there is none."""

    @abstractmethod
    def note(self, name: str) -> str | None:
        """A note beside the records; None if there is none."""

    @abstractmethod
    def set_note(self, name: str, text: str) -> None:
        """Store a note beside the records."""

    @abstractmethod
    def damage(self) -> Exception:
        """Error that says that a record does not hold what was written."""

    def __bool__(self) -> bool:
        return self.last > 0

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Treat bytes that were never packed as damage, whatever their checksum."""
        try:
            yield
        except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            raise self.damage() from error

    def chunk(self, key: str) -> Head | None:
        """Contents of the record of a chunk; None if there is none."""
        head = self.head(key)
        if head is None:
            return None
        with self.reading():
            return ChunkCodec.summary(head)

    def points(self, key: str, names: Iterable[str] | None = None) -> Points:
        """Points in the record of a chunk, with all its variables or some."""
        with self.reading():
            return ChunkCodec.decode(self.get(key), names)

    def put_result(self, key: str, outcome: Outcome, result: bytes) -> None:
        """Store the result of a task over a line or a study."""
        self.put(key, Record(serialize.dump(list(outcome)), result))

    def outcome(self, key: str) -> Outcome | None:
        """How the task of that key ended; None if it has no result."""
        head = self.head(key)
        if head is None:
            return None
        with self.reading():
            outcome = Outcome(*serialize.load(head))
            if outcome.status not in ("ok", *ENDINGS):
                raise ValueError(outcome.status)
            return outcome

    def result(self, key: str) -> Any:
        """Result of a task; None if it has none, or failed."""
        outcome = self.outcome(key)
        if outcome is None or outcome.status != "ok":
            return None
        with self.reading():
            return serialize.load(self.get(key).data)
