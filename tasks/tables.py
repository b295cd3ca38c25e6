"""Tables of results: the columns "group/column", shape (n,), made of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Arrays = dict[str, np.ndarray]


def table(group: str, rows: Sequence[Mapping[str, Any]]) -> Arrays:
    """Rows as the columns of one group, named as in the first row; of no rows there are no columns.

    Parameters
    ----------
    group : str
    rows : sequence of mapping
        Values by column.

    Returns
    -------
    dict of ndarray, shape (rows,)
    """
    return {f"{group}/{name}": np.array([row[name] for row in rows]) for name in (rows[0] if rows else ())}
