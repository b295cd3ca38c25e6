"""Who is told what becomes of a study's nodes."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from gaitsweep.pipeline.graph.graph import Node


@dataclass(frozen=True)
class Finished:
    """A node whose result is stored.

    Attributes
    ----------
    node : Node
    size : int
        What plans and progress count of it.
    status : str
        "ok" or a name of `statuses.ENDINGS`; of a chunk always "ok".
    reason : str
    counts : Counter
        Points of a chunk by outcome.
    seconds : float [s]
        Time that it took; 0 if another study has computed it.
    pid : int
    worker : mapping
        Host, process id and memory [byte] of the worker.
    """

    node: Node
    size: int
    status: str = "ok"
    reason: str = ""
    counts: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0
    pid: int = 0
    worker: Mapping[str, Any] = field(default_factory=dict)


class Listener:
    """Is told of the nodes of one study, and does nothing.

    The loop waits for it, so what takes long delays all studies; an error of its own
    fails this one.
    """

    def finished(self, done: Finished) -> None:
        """A node's result is stored."""

    def dropped(self, node: Node, status: str) -> None:
        """A node is not computed, since what it needs has ended so."""

    def said(self, kind: str, sentence: str) -> None:
        """What concerns the workers of all studies: a note, or an error."""
