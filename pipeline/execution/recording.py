"""Points of a job, written to the journal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from pipeline import serialize
from pipeline.store import lines
from pipeline.store.finished import status_rows
from pipeline.store.journal import Journal
from pipeline.store.rows import TaskKey


def store_points(
    journal: Journal, keys: TaskKey, tokens: Iterable[str], columns: Iterable[int], result: dict[str, Any], cost: float
) -> Counter[str]:
    """Store the points of a job, as rows or finished chunks.

    Parameters
    ----------
    journal : Journal
    keys : TaskKey
    tokens : iterable of str
        What they hold, as `lines.needed` gives it.
    columns : iterable of int
        Gaits that count.
    result : dict
        Of the worker.
    cost : float [s]
        Time that each point took.

    Returns
    -------
    Counter
        Points by outcome, without lines that are yet to be computed by themselves.
    """
    status: Counter[tuple[int, ...]] = Counter()
    for row in result["rows"]:
        journal.add_points(*keys, tokens, row, cost * (len(row[0]) // 8))
        status.update(status_rows(serialize.load(row[1])["status"]))
    for chunk in result.get("chunks", ()):
        status.update(journal.add_chunk(*keys, tokens, chunk, cost).rows())
    counts = lines.count(status, columns)
    del counts["not_attempted"]
    return counts
