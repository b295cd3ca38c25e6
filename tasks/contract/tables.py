"""Tables of results: the columns "group/column", shape (n,), made of rows or of parts
of several rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Arrays = dict[str, np.ndarray]


def table(
    group: str,
    rows: Sequence[Mapping[str, Any] | Sequence[Any]],
    columns: Sequence[str] = (),
) -> Arrays:
    """Rows as the columns of one group.

    Parameters
    ----------
    group : str
    rows : sequence of mapping, or of sequence
        Values by column, or in the order of `columns`.
    columns : sequence of str, optional
        Names of the columns; by default those of the first row.

    Returns
    -------
    dict of ndarray, shape (rows,)
    """
    names = columns or (tuple(rows[0]) if rows else ())
    each = [
        [row[name] for name in names] if isinstance(row, Mapping) else row
        for row in rows
    ]
    values = zip(*each, strict=True) if each else [()] * len(names)

    return {
        f"{group}/{name}": np.array(column)
        for name, column in zip(names, values, strict=True)
    }


def nothing(why: str) -> Arrays:
    """The table by which a task says that a line has nothing for it: no gait to begin
    with.

    Returns
    -------
    dict of ndarray, shape (1,)
    """
    return {"nothing/reason": np.array([why])}


def lacking(sentences: Sequence[str], has_others: bool) -> Arrays:
    """The table by which a task says what it did not find on a line; none where that is
    nothing.

    Parameters
    ----------
    sentences : sequence of str
    has_others : bool
        Whether the line has other results, `partly` what is asked for.

    Returns
    -------
    dict of ndarray, shape (1,)
    """
    if not sentences:
        return {}
    why = " ".join(sentences)
    return {"partly/reason": np.array([why])} if has_others else nothing(why)


def stacked(
    group: str, parts: Sequence[Sequence[Any]], columns: Sequence[str]
) -> Arrays:
    """Parts of several rows, one after another, as the columns of one group.

    Parameters
    ----------
    group : str
    parts : sequence of sequence
        Of each part the columns, shape (rows,), or the value that all its rows have.
    columns : sequence of str
        Their names.

    Returns
    -------
    dict of ndarray, shape (rows of all parts,)
    """
    each = [np.broadcast_arrays(*part) for part in parts] or [
        (np.zeros(0),) * len(columns)
    ]
    return {
        f"{group}/{name}": np.concatenate(own)
        for name, own in zip(columns, zip(*each, strict=True), strict=True)
    }
