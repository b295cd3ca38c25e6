"""Tables of results: the columns "group/column", shape (n,), made of rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Arrays = dict[str, np.ndarray]


def table(group: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = ()) -> Arrays:
    """Rows as the columns of one group, named as in the first row.

    Parameters
    ----------
    group : str
    rows : sequence of mapping
        Values by column.
    columns : sequence of str, optional
        Names of columns that are there, empty, if there are no rows.

    Returns
    -------
    dict of ndarray, shape (rows,)
    """
    return {f"{group}/{name}": np.array([row[name] for row in rows]) for name in (rows[0] if rows else columns)}
