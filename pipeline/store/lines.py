"""Points of one line, put together from the journal's blocks in the order of the slopes asked for."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable

import numpy as np

from pipeline.statuses import ALL_STATUSES, ANSWERS
from pipeline.store.journal import Block, Journal
from pipeline.study.model import Study
from tasks.registry import GAITS, VARIABLES

NOT_ATTEMPTED = "The run has not come to it."
_NAMES = {code: name for name, code in ALL_STATUSES.items()}
_BEST = tuple(ALL_STATUSES[name] for name in ("converged", "fell", "no_gait"))
_BASE = 1 + max(_NAMES)
#: Places in an array.
Places = np.ndarray | slice
#: A block's number, places in it, and their places among the slopes asked for.
Source = tuple[int, Places, Places]


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


def missing(
    journal: Journal,
    line: str,
    want: frozenset[str],
    slopes: np.ndarray,
    gaits: Collection[str] = (),
    retry: bool = False,
) -> np.ndarray:
    """Positions of the slopes no block of that line holds; with `retry` also of those that failed."""
    order, there = Order(slopes), np.zeros(len(slopes), bool)
    for block in journal.blocks(line):  # all of them: where a row is damaged so may be the range it tells
        if want <= block.variables:
            inside, place = order.find(block.slopes)
            there[place] = ~bad(block.states, gaits)[inside] if retry else True
    return np.flatnonzero(~there)


def states(
    journal: Journal, line: str, want: frozenset[str], slopes: np.ndarray
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
        indices, places = order.find(block.slopes)
        if len(indices):
            inside, place = _run(indices), _run(places)
            status[place] = block.states["status"][inside]
            reason[place] = _numbers(block, sentences)[inside]
            sources.append((block.id, inside, place))
    return status, reason, list(sentences), sources


def line(
    journal: Journal,
    keys: dict[str, tuple[str, str]],
    want: frozenset[str],
    study: Study,
    names: Iterable[str],
    slopes: np.ndarray | None = None,
    gaits: int = len(GAITS),
) -> dict[str, np.ndarray]:
    """Everything about one line's points: `slope`, `status`, `reason`, `reasons` and the variables named.

    Of so many gaits, from the first. Where the line's atlas failed every point shares its fate.
    """
    slopes = study.slope if slopes is None else slopes
    status, reason, sentences, sources = states(journal, keys["points"][0], want, slopes)
    atlas = journal.outcome(keys["atlas"][0]) if "atlas" in keys else None
    if atlas and atlas[0] != "ok":
        lost = status == ALL_STATUSES["not_attempted"]
        status[lost], reason[lost] = ALL_STATUSES[atlas[0]], len(sentences)
        sentences.append(f"The atlas of the line: {atlas[1][:1].lower()}{atlas[1][1:]}")
    multipliers = max(check["multipliers"] for check in study.checks)
    found = fill(journal, names, sources, len(slopes), multipliers, gaits)
    return {
        "slope": slopes,
        **found,
        "status": status[:, :gaits],
        "reason": reason[:, :gaits],
        "reasons": np.array(sentences),
    }


def _run(places: np.ndarray) -> Places:
    """Those places as a slice if they are one run: copied at once, not one by one."""
    first, n = int(places[0]), len(places)
    return slice(first, first + n) if np.array_equal(places, np.arange(first, first + n)) else places


def _numbers(block: Block, sentences: dict[str, int]) -> np.ndarray:
    names = [str(s) for s in block.states["reasons"]]
    table = np.array([sentences.setdefault(s, len(sentences)) for s in names] or [0], np.int32)
    return table[block.states["reason"]]


def fill(
    journal: Journal, names: Iterable[str], sources: Iterable[Source], n: int, multipliers: int, gaits: int = len(GAITS)
) -> dict[str, np.ndarray]:
    """Variables over `n` slopes of one line; where there is no gait as the registry says."""
    empty = {name: VARIABLES[name].absent for name in names}
    extra = {name: (multipliers,) if "multiplier" in VARIABLES[name].dims else () for name in empty}
    values = {name: np.full((n, gaits, *extra[name]), empty[name], VARIABLES[name].dtype) for name in empty}
    for block, inside, place in sources:
        data = journal.variables(block)
        for name, whole in values.items():
            found = data.get(name)
            if found is None or found.shape[1:] != whole.shape[1:]:
                whole[place] = empty[name]  # what an earlier block may have left there
            if found is not None:
                part = tuple(slice(min(a, b)) for a, b in zip(found.shape[1:], whole.shape[1:], strict=True))
                whole[:, *part][place] = found[:, *part][inside]
    return values


def rows(status: np.ndarray) -> dict[tuple[int, ...], int]:
    """The different rows of an array of statuses, shape (n, gait), and how often each occurs."""
    code = np.zeros(len(status), np.intp)
    for column in status.T:
        code = code * _BASE + column
    often = np.bincount(code)
    place = _BASE ** np.arange(status.shape[1])[::-1]
    return {tuple((c // place % _BASE).tolist()): int(often[c]) for c in np.flatnonzero(often)}


def count(status: np.ndarray) -> Counter[str]:
    """Points by what became of them, shape (n, gait): a failure of any gait, else the best answer of any."""
    found: Counter[str] = Counter()
    for row, n in rows(status).items():
        failed = [code for code in row if code not in ANSWERS]
        best = next((code for code in _BEST if code in row), row[0])
        found[_NAMES[max(failed, default=best)]] += n
    return found
