"""Gaits of a walker at some slopes, with the derivatives of their measures by slope and
keys, for `gaitsweep.sensitivities`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.branches import atlas as atlases
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.measures.levels import measures_at
from gaitsweep.tasks.measures.names import check_measure, measures
from gaitsweep.tasks.measures.sensitivities import SLOPE, KeyOfWalker, at_gaits
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import (
    is_one_link,
    value_of_key,
    walker_of_line,
    walkers_over,
)
from gaitsweep.tasks.walkers.walker import (
    DIFFERENTIATED,
    KEYS,
    OF_DRIVE,
    ONE_LINK,
    Walker,
    WalkerError,
)

#: Keys that legs of one and of two links share; keys that move several others.
_COMMON = ("R", "m_h", "g")
_DERIVED = ("detuning", "foot_mass_ratio")


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

    problem = Problem(walker)
    Z, place = _gaits(problem, slope)
    values = measures_at(names, Equations(problem).evaluate(Z))
    derivatives, absent = at_gaits(problem, Z, keys, names)

    by = [SLOPE, *(key.name for key in keys)]
    by_labels = _By(len(slope), place, by)
    return {
        "keys": by,
        "absent": absent,
        "values": {name: by_labels.values(values[name]) for name in names},
        "derivatives": {
            name: by_labels.derivatives(name, derivatives) for name in names
        },
        "units": {name: VARIABLES[name].units(walker.si) for name in names},
        "si": walker.si,
    }


@dataclass(frozen=True)
class _By:
    """Lays gaits out by slope and label, and their derivatives by key.

    Attributes
    ----------
    slopes : int
    place : pair of ndarray of int, shape (g,)
        Slope and label of each gait.
    keys : list of str
    """

    slopes: int
    place: tuple[np.ndarray, np.ndarray]
    keys: list[str]

    def values(self, of_gaits: np.ndarray) -> np.ndarray:
        """Values, shape (slopes, gaits), of all gaits (g,)."""
        laid = np.full((self.slopes, len(GAITS)), np.nan)
        laid[self.place] = of_gaits
        return laid

    def derivatives(
        self, name: str, by_keys: Mapping[str, Mapping[str, np.ndarray]]
    ) -> np.ndarray:
        """Derivatives of a measure, shape (slopes, gaits, keys)."""
        laid = np.full((self.slopes, len(GAITS), len(self.keys)), np.nan)
        for column, key in enumerate(self.keys):
            if key in by_keys:
                laid[..., column] = self.values(by_keys[key][name])
        return laid


def _names(wanted: Sequence[str] | None, walker: Walker) -> list[str]:
    """The measures wanted, checked."""
    for name in wanted or ():
        check_measure(name, walker, "variables")
    return list(wanted) if wanted else measures(walker)


def _keys(wanted: Sequence[str] | None, line: Mapping[str, Any]) -> list[str]:
    """The keys wanted: all that hold numbers, of one link its own."""
    of_links = list(DIFFERENTIATED[1:])
    if is_one_link(line["walker"]):
        of_links = [*ONE_LINK, *_COMMON]
    if wanted is None:
        return of_links
    own = [key for key in KEYS if key not in OF_DRIVE]
    known = (*own, *ONE_LINK, *_DERIVED)
    for key in wanted:
        if key not in known:
            raise WalkerError("keys", key, f"must be of {', '.join(known)}")
    return list(wanted)


def _key(line: Mapping[str, Any], name: str) -> KeyOfWalker:
    """A key of a line's walker."""
    return KeyOfWalker(name, value_of_key(line, name), walkers_over(line, name))


def _gaits(
    problem: Problem, slope: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Gaits Z (c, g) of a walker at slopes (n,), and the slope and label of each."""
    pieces = list(_of_pieces(problem, slope))
    if not pieces:
        none = np.empty(0, int)
        return np.empty((problem.m + problem.phases + 1, 0)), (none, none)

    angle, ratio = np.full((2, len(pieces), len(slope)), np.nan)
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
    problem: Problem, slope: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of each piece of a branch the gaits Z (c, g), their slopes and rate ratios."""
    log_slope = np.log(slope)
    for branch in atlases.survey(problem, COARSE):
        for index, guess, _ in branch.guesses(log_slope):
            settled = settle(problem, unmeasured(problem, guess[:-1], slope[index]))
            is_gait = settled.converged & settled.step & (settled.leg_passes == 1)
            Z = np.vstack([settled.w, log_slope[index]])
            ratio = gait_ratio(settled.stride)
            yield Z[:, is_gait], index[is_gait], ratio[is_gait]
