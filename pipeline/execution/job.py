"""A job: one call of a task by a worker."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.plan.missing import BlockWork, LineWork
from pipeline.store.rows import TaskKey


@dataclass
class Job:
    """A task over one line, over a chunk of its points (`indices` of slopes), or, without `work`, over the study.

    With `block` it is the atlas and all points of some of its lines. `study` are the `StudyJobs` that it belongs to,
    `missing` is how many points of the line are to be solved, which `work` does not hold, `seconds` the estimated time.
    """

    study: Any = field(repr=False)
    name: str
    keys: TaskKey
    params: Mapping[str, Any]
    work: LineWork | None = None
    block: BlockWork | None = None
    missing: int = 0
    inputs: tuple[bytes, ...] = ()
    indices: np.ndarray | None = None
    probe: bool = False
    seconds: float = 0.0
