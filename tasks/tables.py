"""Tables that tasks return."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


def table(group: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> dict[str, np.ndarray]:
    """Return the columns of a table by "group/column".

    Parameters
    ----------
    group : str
    columns : sequence of str
    rows : sequence of sequence
        Each with a value for every column.
    """
    values = zip(*rows, strict=True) if rows else [()] * len(columns)
    return {f"{group}/{name}": np.array(column) for name, column in zip(columns, values, strict=True)}
