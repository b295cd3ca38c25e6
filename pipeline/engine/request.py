"""What a worker is asked, and what it answers."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

from gaitsweep.pipeline.store.record import ChunkCodec, Record

#: A task, or lines side by side, may take this many times the limit of a point.
_WHOLE_TASK_FACTOR = 60


@dataclass(frozen=True, slots=True)
class Request:
    """A task to run in a worker process.

    With a `codec` it is a chunk of points, of one line or of `lines` side by side,
    which is divided if it fails; then `alone` names the functions of the atlas and the
    points of one line, unless the points of lines need no atlases, and `most` how many
    points are computed at a time. `seconds` and `memory` [byte] limit one point, or a
    whole task. The process ends after waiting `idle` seconds for another request.
    `together` names a function that computes such atlases of several lines at once.
    """

    function: str
    params: dict[str, Any]
    inputs: list[bytes]
    seconds: float
    memory: int
    idle: float | None = None
    codec: ChunkCodec | None = None
    alone: tuple[str, str] | None = None
    most: int | None = None
    together: str = ""

    @property
    def time_limit(self) -> float:
        """Time that the worker may take [s]."""
        is_of_one_line = self.codec and "line" in self.params
        return self.seconds * (1 if is_of_one_line else _WHOLE_TASK_FACTOR)


class AtlasAnswer(NamedTuple):
    """The atlas of a line that was computed beside others: the line's place in its
    chunk, how the task ended, and its packed result.
    """

    place: int
    status: str
    reason: str
    data: bytes


@dataclass(slots=True)
class Answer:
    """What a worker has found.

    Attributes
    ----------
    status : str
        "ok" or a name of `statuses.ENDINGS`; of a chunk always "ok": its points say how
        each of them ended.
    reason : str
    data : bytes
        Packed result of a task that is no chunk.
    record : Record, optional
        Of a chunk.
    atlases : list of AtlasAnswer
        Of the lines of a chunk that were computed side by side, if they are wanted.
    seconds, cpu, integrating : float [s]
        Time taken; of it processor time, and that in compiled integrators.
    pid : int
        Process that supervised the worker.
    worker : dict
        Host, process id and resident memory [byte] of the worker.
    """

    status: str = "ok"
    reason: str = ""
    data: bytes = b""
    record: Record | None = None
    atlases: list[AtlasAnswer] = field(default_factory=list)
    seconds: float = 0.0
    cpu: float = 0.0
    integrating: float = 0.0
    pid: int = 0
    worker: dict[str, Any] = field(default_factory=dict)
