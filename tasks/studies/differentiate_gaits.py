"""Gaits of a walker at some slopes, with the derivatives of their measures by slope and
keys, for `gaitsweep.sensitivities`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.measures.levels import measures_at
from gaitsweep.tasks.measures.names import check_measure, measures
from gaitsweep.tasks.measures.sensitivities import (
    SLOPE,
    KeyOfWalker,
    Measured,
    at_gaits,
)
from gaitsweep.tasks.step.drive import over_slopes
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.solve_driven import branches_of, driven
from gaitsweep.tasks.walkers.resolve import (
    is_one_link,
    value_of_key,
    walker_of_line,
    walkers_over,
)
from gaitsweep.tasks.walkers.walker import (
    KEYS,
    OF_PASSIVE,
    ONE_LINK,
    Walker,
    WalkerError,
)

#: Keys that legs of one and of two links share; keys that move several others.
_COMMON = ("R", "m_h", "g")
_DERIVED = ("detuning", "foot_mass_ratio")
#: Slope and label of gaits.
_Place = tuple[np.ndarray, np.ndarray]


def differentiate(params: Mapping[str, Any]) -> dict[str, Any]:
    """Differentiate the measures of a walker's gaits.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `set` (keys to change), `slope`, ndarray, shape (n,)
        [rad]; `measures`, names of variables, all if omitted; `keys`, those of the
        walker, all that hold a number if omitted.

    Returns
    -------
    dict
        `keys`, "slope" first; `values` and `derivatives`, of each measure ndarray,
        shape (n, gaits) and (n, gaits, keys), NaN where there is no gait, or where the
        gait is at a fold; `units` of measures; `si`, whether the walker is in SI; and
        `absent`, why there are no derivatives by some keys.

    Raises
    ------
    WalkerError
        If the walker, a measure or a key is invalid.
    """
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    walker = walker_of_line(line)
    names = _names(params.get("measures"), walker)
    keys = [_key(line, key) for key in _keys(params.get("keys"), line)]
    slope = np.asarray(params["slope"], float)

    by = [SLOPE, *(key.name for key in keys)]
    found = _ByLabels.none(len(slope), names, by)
    for problem, Z, place in _grounds(walker, slope):
        values = measures_at(names, Equations(problem).evaluate(Z))
        derivatives, absent = at_gaits(problem, Z, keys, names)
        found.put(place, values, derivatives)
        found.absent.update(absent)

    return {
        **vars(found),
        "units": {name: VARIABLES[name].units(walker.si) for name in names},
        "si": walker.si,
    }


@dataclass(frozen=True)
class _ByLabels:
    """Measures and their derivatives, laid out by slope and label, and by the names of
    keys; and why there are none by some.
    """

    keys: list[str]
    values: dict[str, np.ndarray]
    derivatives: dict[str, np.ndarray]
    absent: dict[str, str]

    @classmethod
    def none(cls, slopes: int, names: Sequence[str], keys: list[str]) -> _ByLabels:
        """Return so many slopes without a gait."""
        shape = slopes, len(GAITS)
        values = {name: np.full(shape, np.nan) for name in names}
        by = {name: np.full((*shape, len(keys)), np.nan) for name in names}
        return cls(keys, values, by, {})

    def put(
        self, place: _Place, values: Measured, derivatives: Mapping[str, Measured]
    ) -> None:
        """Lay out those of gaits, of which the slope and the label are given."""
        for name, laid in self.values.items():
            laid[place] = values[name]
        for column, key in enumerate(self.keys):
            for name, of_key in derivatives.get(key, {}).items():
                self.derivatives[name][(*place, column)] = of_key


def _names(wanted: Sequence[str] | None, walker: Walker) -> list[str]:
    """The measures wanted, checked."""
    for name in wanted or ():
        check_measure(name, walker, "variables")
    return list(wanted) if wanted else measures(walker)


def _keys(wanted: Sequence[str] | None, line: Mapping[str, Any]) -> list[str]:
    """The keys wanted: all that hold numbers, of one link its own, and those of what
    drives the walker.
    """
    of_links = list(OF_PASSIVE[1:])
    if is_one_link(line["walker"]):
        of_links = [*ONE_LINK, *_COMMON]
    if wanted is None:
        return [*of_links, *walker_of_line(line).driving_keys]

    known = (*KEYS, *ONE_LINK, *_DERIVED)
    for key in wanted:
        if key not in known:
            raise WalkerError("keys", key, f"must be of {', '.join(known)}")

    return list(wanted)


def _key(line: Mapping[str, Any], name: str) -> KeyOfWalker:
    """A key of a line's walker."""
    return KeyOfWalker(name, value_of_key(line, name), walkers_over(line, name))


def _grounds(
    walker: Walker, slope: np.ndarray
) -> Iterator[tuple[Problem, np.ndarray, _Place]]:
    """Yield the gaits Z (c, g) of a walker at slopes (n,), with their problem over
    slopes, and the slope and label of each: those of all that lead down, then those of
    each other slope.
    """
    down = np.flatnonzero(slope > 0)
    if len(down):
        problem = Problem(walker)
        branches = atlases.survey(problem, COARSE)
        Z, (row, label) = _gaits(problem, branches, slope[down])
        yield problem, Z, (down[row], label)

    for level in np.unique(slope[slope <= 0]).tolist():
        at = np.flatnonzero(slope == level)
        problem, drive = driven(walker, level)
        if not drive:
            continue

        there = np.full(len(at), drive)
        Z, (row, label) = _gaits(problem, branches_of(problem), there)
        over, counted = over_slopes(level)
        Z[-1] = np.log(counted)
        yield Problem(walker, drive=over), Z, (at[row], label)


def _gaits(
    problem: Problem, branches: Sequence[Branch], drive: np.ndarray
) -> tuple[np.ndarray, _Place]:
    """Gaits Z (c, g) on branches at values of the drive (n,), and the number of that and
    the label of each.
    """
    pieces = list(_of_pieces(problem, branches, drive))
    if not pieces:
        none = np.empty(0, int)
        return np.empty((problem.m + problem.phases + 1, 0)), (none, none)

    angle, ratio = np.full((2, len(pieces), len(drive)), np.nan)
    for number, (Z, row, of_rates) in enumerate(pieces):
        angle[number, row] = Z[0]
        ratio[number, row] = of_rates

    label = places(angle, ratio)
    labels = [label[number, row] for number, (_, row, _) in enumerate(pieces)]

    every = np.concatenate(labels)
    has_label = every < len(GAITS)
    Z = np.hstack([Z for Z, _, _ in pieces])[:, has_label]
    rows = np.concatenate([row for _, row, _ in pieces])[has_label]
    return Z, (rows, every[has_label])


def _of_pieces(
    problem: Problem, branches: Sequence[Branch], drive: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each piece of a branch the gaits Z (c, g), the numbers of their values of the
    drive (n,), and rate ratios.
    """
    q = np.log(drive)
    for branch in branches:
        for index, guess, _ in branch.guesses(q):
            settled = settle(problem, unmeasured(problem, guess[:-1], drive[index]))
            is_gait = settled.converged & settled.step & (settled.leg_passes == 1)
            Z = np.vstack([settled.w, q[index]])
            ratio = gait_ratio(settled.stride)
            yield Z[:, is_gait], index[is_gait], ratio[is_gait]
