"""What has been written to an archive, and what several of its writers share."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pipeline.archive.attributes import put
from pipeline.study.model import Study


@dataclass
class Written:
    """Contents of an archive: points (or lines) by status, and failures by reason with an example of each."""

    counts: Counter[str] = field(default_factory=Counter)
    failures: Counter[str] = field(default_factory=Counter)
    examples: dict[str, str] = field(default_factory=dict)

    def add_failure(self, reason: str, n: int, example: str) -> None:
        """Count failures of one reason."""
        self.failures[reason] += n
        self.examples.setdefault(reason, example)


def write_strings(file: Any, name: str, dim: str, values: list[str], long_name: str) -> None:
    """Write a variable of strings."""
    variable = file.createVariable(name, str, (dim,))
    put(variable, {"long_name": long_name, "units": "1"})
    variable[:] = np.array(values, object)


def line_description(study: Study, number: int) -> str:
    """Name of a line in messages: its walker and parameters."""
    return " ".join([study.name_of(number), *(f"{key}={value!r}" for key, value in study.line(number)["set"].items())])
