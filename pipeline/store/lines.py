"""Points of one line, assembled from the blocks of the journal in the order of the given slopes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping

import numpy as np

from pipeline.statuses import ALL_STATUSES, ANSWERS
from pipeline.store.finished import Head, digest
from pipeline.store.journal import Journal
from pipeline.store.rows import Block, TaskKey
from pipeline.study.model import Study
from tasks.registry import GAITS, VARIABLES

NOT_ATTEMPTED = "The run has not reached it."
_NAMES = {code: name for name, code in ALL_STATUSES.items()}
_BEST = tuple(ALL_STATUSES[name] for name in ("converged", "less_accurate", "fell", "no_gait"))
#: Indices into an array.
Indices = np.ndarray | slice
#: Number of a block, indices in it, and the corresponding indices among the given slopes.
Source = tuple[int, Indices, Indices]


class Places:
    """Points of a line, or of several lines, looked up in blocks of the journal.

    Parameters
    ----------
    slopes : ndarray, shape (n,) [rad]
        The same on all lines.
    lines : ndarray of uint64, shape (m, 2), optional
        Digests of several lines.
    """

    def __init__(self, slopes: np.ndarray, lines: np.ndarray | None = None):
        self.slopes, self.lines = slopes, lines
        self.order: np.ndarray
        if np.all(slopes[1:] > slopes[:-1]):  # usually: no copies as long as a line
            self.order, self.sorted = np.arange(len(slopes), dtype=np.int32), slopes
        else:
            self.order = np.argsort(slopes, kind="stable")
            self.sorted = slopes[self.order]
        self.size = len(slopes) * (1 if lines is None else len(lines))

    def find(self, block: Block) -> tuple[np.ndarray, np.ndarray]:
        """Look up the points of a block.

        Parameters
        ----------
        block : Block

        Returns
        -------
        inside, indices : ndarray, shape (k,)
            Indices into the block of the points that match, and into the points of this object, line by line.
        """
        if block.finished and (indices := self._find_chunk(block.finished.head)) is not None:
            return np.arange(len(indices)), indices
        if self.lines is None:
            return self._find_slopes(block.slopes)
        lines = block.states["lines"]
        n = len(block.slopes) // max(1, len(lines))
        inside, indices = self._find_slopes(block.slopes[:n])
        if np.array_equal(lines, self.lines):  # nearly always
            rows = numbers = np.arange(len(lines))
        else:
            own, others = (np.ascontiguousarray(each).view("V16").ravel() for each in (self.lines, lines))
            _, rows, numbers = np.intersect1d(others, own, return_indices=True)
        return (rows[:, None] * n + inside).ravel(), (numbers[:, None] * len(self.slopes) + indices).ravel()

    def _find_chunk(self, head: Head) -> np.ndarray | None:
        """Indices of the points of a finished chunk, if they follow one another: it need not be read."""
        start = np.searchsorted(self.sorted, head.low)
        indices = self.order[start : start + head.points]
        return indices if digest(self.slopes[indices]) == head.digest else None

    def _find_slopes(self, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position = np.searchsorted(self.sorted, slopes)
        position[position == len(self.sorted)] = 0
        inside = np.flatnonzero(self.sorted[position] == slopes)
        return inside, self.order[position[inside]]


def needed(variables: Iterable[str], gaits: Iterable[str]) -> frozenset[str]:
    """Contents a block must hold to count: variables, and gaits as `@long`."""
    return frozenset([*variables, *(f"@{gait}" for gait in gaits)])


def has_failed(states: dict[str, np.ndarray], gaits: Collection[str]) -> np.ndarray:
    """Points of a block that failed in any of the given gaits.

    Parameters
    ----------
    states : dict
        `status`, shape (n, gait).
    gaits : collection of str

    Returns
    -------
    ndarray of bool, shape (n,)
    """
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
    """Find the slopes that no block of a line holds.

    Parameters
    ----------
    journal : Journal
    line : str
        Key of the line's points.
    want : frozenset of str
        Contents a block must hold to count, as `needed` gives them.
    slopes : ndarray, shape (n,) [rad]
    gaits : collection of str
    retry : bool
        Count points that failed in any of these gaits as missing.

    Returns
    -------
    ndarray of int, shape (m,)
        Indices into `slopes`.
    """
    # All blocks: the slope range of a damaged row is not reliable.
    return unsolved(journal.blocks(line), want, Places(slopes), gaits, retry)


def unsolved(
    blocks: Iterable[Block], want: frozenset[str], places: Places, gaits: Collection[str] = (), retry: bool = False
) -> np.ndarray:
    """Find the points that no block holds, as `missing` does.

    Returns
    -------
    ndarray of int, shape (m,)
        Indices of points.
    """
    present = np.zeros(places.size, bool)
    for block in blocks:
        if want <= block.variables:
            inside, positions = places.find(block)
            present[positions] = ~has_failed(block.states, gaits)[inside] if retry else True
    return np.arange(places.size, dtype=np.int32)[~present]


def states(
    journal: Journal, line: str, want: frozenset[str], slopes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, list[str], list[Source]]:
    """Read the states of the points of one line, as `read_states` does.

    Parameters
    ----------
    journal : Journal
    line : str
        Key of the line's points.
    want : frozenset of str
        Contents a block must hold to count.
    slopes : ndarray, shape (n,) [rad]
    """
    return read_states(journal.blocks(line, slopes.min(), slopes.max()), want, Places(slopes))


def read_states(
    blocks: Iterable[Block], want: frozenset[str], places: Places
) -> tuple[np.ndarray, np.ndarray, list[str], list[Source]]:
    """Read the states of points.

    Parameters
    ----------
    blocks : iterable of Block
        Earliest first.
    want : frozenset of str
        Contents a block must hold to count.
    places : Places
        The points, n in all.

    Returns
    -------
    status, reason : ndarray, shape (n, gait)
        `reason` indexes the sentences.
    sentences : list of str
    sources : list of Source
        Locations of the variables; later ones overwrite earlier ones.
    """
    status = np.full((places.size, len(GAITS)), ALL_STATUSES["not_attempted"], np.int8)
    reason = np.zeros(status.shape, np.int32)
    sentences: dict[str, int] = {NOT_ATTEMPTED: 0}
    sources: list[Source] = []
    for block in blocks:
        if not want <= block.variables:
            continue
        inside, positions = places.find(block)
        if len(inside):
            source, target = _as_slice(inside), _as_slice(positions)
            status[target] = block.states["status"][source]
            reason[target] = renumber_reasons(block.states, sentences)[source]
            sources.append((block.id, source, target))
    return status, reason, list(sentences), sources


def of_atlas(reason: str) -> str:
    """Reason of a failed atlas, for results that need it."""
    return f"The atlas of the line: {reason[:1].lower()}{reason[1:]}"


def line(
    journal: Journal,
    keys: dict[str, TaskKey],
    want: frozenset[str],
    study: Study,
    names: Iterable[str],
    slopes: np.ndarray | None = None,
    gaits: int = len(GAITS),
) -> dict[str, np.ndarray]:
    """Read states and variables of the points of one line. If its atlas failed, every point failed with it.

    Parameters
    ----------
    journal : Journal
    keys : dict
        Keys of the tasks over the line.
    want : frozenset of str
        Contents a block must hold to count.
    study : Study
    names : iterable of str
        Variables to read.
    slopes : ndarray, shape (n,) [rad], optional
        By default those of the study.
    gaits : int
        Number of gaits, from the first.

    Returns
    -------
    dict
        `slope`, shape (n,) [rad]; `status` and `reason`, shape (n, gaits); `reasons`, the sentences; each variable,
        shape (n, gaits) or (n, gaits, multipliers), in its units.
    """
    slopes = study.slope if slopes is None else slopes
    status, reason, sentences, sources = states(journal, keys["points"].key, want, slopes)
    atlas = journal.outcome(keys["atlas"].key) if "atlas" in keys else None
    if atlas and atlas.status != "ok":
        unsolved = status == ALL_STATUSES["not_attempted"]
        status[unsolved], reason[unsolved] = ALL_STATUSES[atlas.status], len(sentences)
        sentences.append(of_atlas(atlas.reason))
    multipliers = max(check["multipliers"] for check in study.checks)
    values = fill(journal, names, sources, len(slopes), multipliers, gaits)
    return {
        "slope": slopes,
        **values,
        "status": status[:, :gaits],
        "reason": reason[:, :gaits],
        "reasons": np.array(sentences),
    }


def _as_slice(indices: np.ndarray) -> Indices:
    """Consecutive indices as a slice, which copies faster."""
    first, n = int(indices[0]), len(indices)
    return slice(first, first + n) if np.array_equal(indices, np.arange(first, first + n)) else indices


def renumber_reasons(states: dict[str, np.ndarray], sentences: dict[str, int]) -> np.ndarray:
    """Count the reasons of a block over the sentences of several.

    Parameters
    ----------
    states : dict
        `reason`, shape (n, gait), and the sentences `reasons` that it indexes.
    sentences : dict
        Numbers of the sentences so far; changed in place.

    Returns
    -------
    ndarray of int32, shape (n, gait)
    """
    names = [str(s) for s in states["reasons"]]
    table = np.array([sentences.setdefault(s, len(sentences)) for s in names] or [0], np.int32)
    return np.asarray(table[states["reason"]])


def fill(
    journal: Journal, names: Iterable[str], sources: Iterable[Source], n: int, multipliers: int, gaits: int = len(GAITS)
) -> dict[str, np.ndarray]:
    """Read variables of one line.

    Parameters
    ----------
    journal : Journal
    names : iterable of str
    sources : iterable of Source
        As `states` returns them.
    n, multipliers, gaits : int
        Number of slopes, multipliers and gaits.

    Returns
    -------
    dict
        Each variable, shape (n, gaits) or (n, gaits, multipliers); the registry's `absent` where there is no gait.
    """
    empty = {name: VARIABLES[name].absent for name in names}
    extents = {name: (multipliers,) if "multiplier" in VARIABLES[name].dims else () for name in empty}
    values = {name: np.full((n, gaits, *extents[name]), empty[name], VARIABLES[name].dtype) for name in empty}
    for block, inside, target in sources:
        data = journal.variables(block)
        for name, column in values.items():
            stored = data.get(name)
            if stored is None or stored.shape[1:] != column.shape[1:]:
                column[target] = empty[name]  # clears values of an earlier block
            if stored is not None:
                part = tuple(slice(min(a, b)) for a, b in zip(stored.shape[1:], column.shape[1:], strict=True))
                column[:, *part][target] = stored[:, *part][inside]
    return values


def count(status_rows: Mapping[tuple[int, ...], int], columns: Iterable[int] | None = None) -> Counter[str]:
    """Count points by outcome: a failure of any gait, else the best answer of any gait.

    Parameters
    ----------
    status_rows : mapping
        Points by their row of `status`, as `rows` returns them.
    columns : iterable of int, optional
        Gaits that count; by default all.

    Returns
    -------
    Counter
        Points by the name of their status.
    """
    counts, chosen = Counter[str](), None if columns is None else list(columns)
    for row, n in status_rows.items():
        row = row if chosen is None else tuple(row[c] for c in chosen)
        failed = [code for code in row if code not in ANSWERS]
        best = next((code for code in _BEST if code in row), row[0])
        counts[_NAMES[max(failed, default=best)]] += n
    return counts
