"""Join small blocks of the journal: a line in ten thousand blocks is large and slow to read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pipeline import serialize
from pipeline.store.journal import Journal
from pipeline.store.lines import renumber_reasons
from pipeline.store.rows import Block
from tasks.registry import VARIABLES

_MAX = 32768  # points in a block


def compact(journal: Journal) -> None:
    """Join consecutive blocks of lines that were computed in small chunks; later points replace earlier ones."""
    for line in journal.small_lines():
        for group in list(_groups(journal, line)):
            if len(group) > 1:
                journal.replace_points([b.id for b in group], line, group[0].variables, _join(journal, group))
    journal.shrink()


def _groups(journal: Journal, line: str) -> Iterator[list[Block]]:
    """Runs of blocks with the same variables and at most `_MAX` points altogether; none is a finished chunk."""
    group: list[Block] = []
    points = 0
    for block in journal.blocks(line):
        if group and (block.finished or block.variables != group[0].variables or points + len(block.slopes) > _MAX):
            yield group
            group, points = [], 0
        if not block.finished:
            group.append(block)
            points += len(block.slopes)
    if group:
        yield group


def _join(journal: Journal, group: list[Block]) -> tuple[bytes, bytes, bytes]:
    slopes = np.concatenate([b.slopes for b in group])
    # Of equal slopes the last counts.
    _, last = np.unique(slopes[::-1], return_index=True)
    keep = len(slopes) - 1 - last
    sentences: dict[str, int] = {}
    reason = np.concatenate([renumber_reasons(b.states, sentences) for b in group])
    states = {
        "status": np.concatenate([b.states["status"] for b in group])[keep],
        "reason": reason[keep],
        "reasons": np.array(list(sentences) or [""]),
    }
    parts = [journal.variables(b.id) for b in group]
    names = sorted({name for part in parts for name in part})
    data = {
        name: _stack(
            [(part.get(name), len(b.slopes)) for part, b in zip(parts, group, strict=True)], VARIABLES[name].absent
        )[keep]
        for name in names
    }
    return slopes[keep].tobytes(), serialize.dump(states), serialize.dump(data)


def _stack(parts: list[tuple[np.ndarray | None, int]], absent: float) -> np.ndarray:
    """Concatenate blocks of one variable, as wide as the widest; `absent` where a block has no such gait."""
    present = [p for p, _ in parts if p is not None]
    shape = tuple(max(p.shape[k] for p in present) for k in range(1, present[0].ndim))
    values = np.full((sum(n for _, n in parts), *shape), absent, present[0].dtype)
    start = 0
    for part, n in parts:
        if part is not None:
            values[(slice(start, start + n), *map(slice, part.shape[1:]))] = part
        start += n
    return values
