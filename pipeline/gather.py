"""Points of one line, put together from the journal's blocks in the order of the slopes asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable

import numpy as np

from pipeline.journal import Block, Journal
from pipeline.study import Study
from pipeline.worker import ALL_STATUSES, ANSWERS
from tasks.registry import GAITS, VARIABLES

NOT_ATTEMPTED = "The run has not come to it."
#: A block's number, positions in it, and their positions among the slopes asked for.
Source = tuple[int, np.ndarray, np.ndarray]


class Order:
    """Slopes sorted once, to find blocks' points among them."""

    def __init__(self, slopes: np.ndarray):
        self.slopes = slopes
        self.order = np.argsort(slopes, kind="stable")
        self.sorted = slopes[self.order]

    def find(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions in a block of the slopes asked for, and their positions among those."""
        place = np.searchsorted(self.sorted, slopes)
        place[place == len(self.sorted)] = 0
        there = np.flatnonzero(self.sorted[place] == slopes)
        return there, self.order[place[there]]


def needed(variables: Iterable[str], gaits: Iterable[str]) -> frozenset[str]:
    """What a block must hold to count: variables, and gaits as `@long`."""
    return frozenset([*variables, *(f"@{gait}" for gait in gaits)])


def bad(states: dict[str, np.ndarray], gaits: Collection[str]) -> np.ndarray:
    """Which points of a block failed in any of those gaits."""
    columns = [GAITS.index(g) for g in gaits]
    return np.any(~np.isin(states["status"][:, columns], ANSWERS), axis=1)


def missing(journal: Journal, line: str, want: frozenset[str], slopes: np.ndarray, gaits: Collection[str] = (),
            retry: bool = False) -> np.ndarray:
    """Positions of the slopes no block of that line holds; with `retry` also of those that failed."""
    order, there = Order(slopes), np.zeros(len(slopes), bool)
    for block in journal.blocks(line, order.sorted[0], order.sorted[-1]):
        if want <= block.variables:
            inside, place = order.find(block.slopes)
            there[place] = ~bad(block.states, gaits)[inside] if retry else True
    return np.flatnonzero(~there)


def states(journal: Journal, line: str, want: frozenset[str], slopes: np.ndarray
           ) -> tuple[np.ndarray, np.ndarray, list[str], list[Source]]:
    """States of a line's points.

    Returns
    -------
    status, reason : ndarray, shape (n, gait)
        `reason` indexes the sentences.
    sentences : list of str
    sources : list of Source
        Where the variables are; a later one overwrites an earlier one.
    """
    order = Order(slopes)
    status = np.full((len(slopes), len(GAITS)), ALL_STATUSES["not_attempted"], np.int8)
    reason = np.zeros(status.shape, np.int32)
    sentences: dict[str, int] = {NOT_ATTEMPTED: 0}
    sources: list[Source] = []
    for block in journal.blocks(line, order.sorted[0], order.sorted[-1]):
        if not want <= block.variables:
            continue
        inside, place = order.find(block.slopes)
        if len(inside):
            status[place] = block.states["status"][inside]
            reason[place] = _numbers(block, sentences)[inside]
            sources.append((block.id, inside, place))
    return status, reason, list(sentences), sources


def line(journal: Journal, keys: dict[str, tuple[str, str]], want: frozenset[str], study: Study,
         names: Iterable[str], slopes: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Everything about one line's points: `slope`, `status`, `reason`, `reasons` and the variables named.

    Where the line's atlas failed every point shares its fate.
    """
    slopes = study.slope if slopes is None else slopes
    status, reason, sentences, sources = states(journal, keys["points"][0], want, slopes)
    atlas = journal.outcome(keys["atlas"][0]) if "atlas" in keys else None
    if atlas and atlas[0] != "ok":
        lost = status == ALL_STATUSES["not_attempted"]
        status[lost], reason[lost] = ALL_STATUSES[atlas[0]], len(sentences)
        sentences.append(f"The atlas of the line: {atlas[1][:1].lower()}{atlas[1][1:]}")
    multipliers = max(check["multipliers"] for check in study.checks)
    found = fill(journal, names, sources, len(slopes), multipliers)
    return {"slope": slopes, **found, "status": status, "reason": reason, "reasons": np.array(sentences)}


def _numbers(block: Block, sentences: dict[str, int]) -> np.ndarray:
    names = [str(s) for s in block.states["reasons"]]
    table = np.array([sentences.setdefault(s, len(sentences)) for s in names] or [0], np.int32)
    return table[block.states["reason"]]


def shape(name: str, n: int, multipliers: int) -> tuple[int, ...]:
    """Shape of a variable over `n` slopes of one line, every gait in it."""
    dims = VARIABLES[name].dims
    return (n, len(GAITS), multipliers) if "multiplier" in dims else (n, len(GAITS))


def fill(journal: Journal, names: Iterable[str], sources: Iterable[Source], n: int, multipliers: int
         ) -> dict[str, np.ndarray]:
    """Variables over `n` slopes of one line; NaN, or 0 for whole numbers, where there is none."""
    empty = {name: np.nan if VARIABLES[name].dtype == "f8" else 0 for name in names}
    values = {name: np.full(shape(name, n, multipliers), empty[name], VARIABLES[name].dtype) for name in empty}
    for block, inside, place in sources:
        data = journal.variables(block)
        for name, whole in values.items():
            found = data.get(name)
            whole[place] = empty[name]
            if found is not None:
                part = whole[:, :found.shape[1]] if found.ndim == 2 else whole[:, :found.shape[1], :found.shape[2]]
                part[place] = found[inside]
    return values


def count(status: np.ndarray) -> Counter[str]:
    """Points by what became of them, shape (n, gait): a failure of any gait, else the best answer of any."""
    names = {code: name for name, code in ALL_STATUSES.items()}
    answered = np.where(np.isin(status, ANSWERS), -1, status).max(axis=1)
    best = np.full(len(status), ALL_STATUSES["no_gait"])
    for name in ("fell", "converged"):
        best[np.any(status == ALL_STATUSES[name], axis=1)] = ALL_STATUSES[name]
    codes, counts = np.unique(np.where(answered >= 0, answered, best), return_counts=True)
    return Counter({names[int(c)]: int(n) for c, n in zip(codes, counts, strict=True)})
