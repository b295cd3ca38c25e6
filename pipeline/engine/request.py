"""What a worker process is asked."""

from dataclasses import dataclass
from typing import Any

from gaitsweep.pipeline.store.record import Packing

_WHOLE_TASK_FACTOR = (
    60  # a task, or lines side by side, may take this many times the limit of a point
)


@dataclass(frozen=True, slots=True)
class Request:
    """A task to run in a worker process.

    With `packing` it is a chunk of points, of one line or of `lines` side by side,
    which is divided if it fails; then `alone` names the functions of the atlas and the
    points of one line, unless the points of lines need no atlases, and `most` how many
    points are computed at a time. `seconds` and `memory` [byte] limit one point, or a
    whole task. The process ends after waiting `idle` seconds for another request.
    """

    function: str
    params: dict[str, Any]
    inputs: list[bytes]
    seconds: float
    memory: int
    idle: float | None = None
    packing: Packing | None = None
    alone: tuple[str, str] | None = None
    most: int | None = None

    @property
    def time_limit(self) -> float:
        """Time that the worker may take [s]."""
        return self.seconds * (
            1 if self.packing and "line" in self.params else _WHOLE_TASK_FACTOR
        )
