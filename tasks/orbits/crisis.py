"""Crisis of an attractor: the slope beyond which orbits near its remains fall, or
converge to another attractor.

The last attractor of a cascade ends neither at a fold nor at a flip but in a crisis: it
touches the boundary of its basin (C. Grebogi, E. Ott, J. A. Yorke, Physica D 7 (1983)
181-200). That slope solves no equation here; it is bracketed by simulation, from many
initial states at many slopes side by side. Orbits that leave at once did not begin in
the basin and are ignored; of the others all persist at the bracket's lower slope, and
some do not at its upper slope. Just beyond the crisis few of them are lost within any
number of steps (C. Grebogi, E. Ott, F. Romeiras, J. A. Yorke, Phys. Rev. A 36 (1987)
5365-5380): the bracket that a few orbits give is kept where many more persist at its
lower slope, and else begun anew with all of these.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.arrays import Numbers
from gaitsweep.tasks.orbits.walk import Walk, change
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import STRUCK

#: An orbit whose last step changes it by less than this, relative, has converged to a
#: gait of period one.
_SETTLED = 1e-8
#: Steps within which an orbit may leave without its slope being rejected.
_TRANSIENT = 60
#: Orbits by which a loss is bracketed at first.
_FEW = 32
#: Rounds in which the bracket of a loss is divided, and by how many slopes, simulated
#: side by side.
_ROUNDS, _AT_ONCE = 3, 4


#: An attractor that may be lost: initial section coordinates on it (m, k) [rad,
#: rad/sqrt(leg/g)], and two slopes [rad] between which its loss is sought.
Attractor = tuple[ndarray, float, float]
#: Initial section coordinates (m, k), each of which is tried at some slopes (n,) [rad].
Trial = tuple[ndarray, ndarray]
#: A search, which asks of trials at which slopes (n,) orbits survive, and returns a
#: bracket [rad].
_Search = Generator[Trial, ndarray, tuple[float, float]]


def surviving_slopes(
    problem: Problem, trials: Sequence[Trial], strides: int
) -> list[ndarray]:
    """Find the slopes at which all orbits that outlast the transient persist and none
    converges to period one.

    Parameters
    ----------
    trials : sequence of (ndarray, ndarray)
        Which are walked side by side.
    strides : int
        Steps after the transient.

    Returns
    -------
    list of ndarray of bool, shape (n,)
        Of each trial; false too where no orbit outlasts the transient.
    """
    y = np.hstack([np.tile(starts, (1, len(slope))) for starts, slope in trials])
    orbits = [[starts.shape[1]] * len(slope) for starts, slope in trials]
    slope = np.concatenate([slope for _, slope in trials])
    number = np.repeat(np.arange(len(slope)), np.concatenate(orbits))
    survives = _survive(Walk(problem, y, slope[number]), number, strides)
    return np.split(survives, np.cumsum([len(each) for each in orbits])[:-1])


def _survive(walk: Walk, number: Numbers, strides: int) -> ndarray:
    """Whether orbits survive at each of several slopes, of which every lane of a walk
    has one by its number.
    """
    for _ in walk.steps(_TRANSIENT):
        pass
    lasting = walk.lanes
    survives = np.isin(np.arange(number.max() + 1), number[lasting])
    for taken in walk.steps(strides):
        # One orbit that leaves decides for its slope.
        survives[number[lasting[walk.outcome[lasting] != STRUCK]]] = False
        if taken == strides:
            settles = change(walk.before, walk.y[:, walk.lanes]) < _SETTLED
            survives[number[walk.lanes[settles]]] = False

        walk.lanes = walk.lanes[survives[number[walk.lanes]]]

    return survives


def lost(
    problem: Problem, attractors: Sequence[Attractor], strides: int
) -> list[tuple[float, float]]:
    """Bracket the slopes at which attractors are lost: at the upper one an orbit is lost
    within some steps, at the lower one none of all.

    Parameters
    ----------
    attractors : sequence of (ndarray, float, float)
        Which persist at the first of the two slopes, or are lost at once; they are
        searched for side by side.
    strides : int
        Steps after the transient.

    Returns
    -------
    list of (float, float) [rad]
        Neighbouring slopes of the last round. NaN for the first where the attractor
        does not persist there either, and for the second where it is not lost.
    """
    searches = [_search(*attractor) for attractor in attractors]
    found = [(np.nan, np.nan)] * len(searches)
    asked = {number: next(search) for number, search in enumerate(searches)}
    while asked:
        survive = surviving_slopes(problem, [*asked.values()], strides)
        for number, each in zip([*asked], survive, strict=True):
            try:
                asked[number] = searches[number].send(each)
            except StopIteration as end:
                found[number] = end.value
                del asked[number]

    return found


def _search(starts: ndarray, low: float, high: float) -> _Search:
    """Search for the loss of an attractor: by a few of its orbits, then by all."""
    found = yield from _bracketed(starts[:, :_FEW], low, high)
    last = found[0]
    others = starts[:, _FEW:]
    if np.isnan(last) or not others.size:
        return found

    survives = yield others, np.array([last])
    if survives[0]:
        return found
    of_all = yield from _bracketed(starts, low, last)
    # With the few, none is lost there if no other outlasts the transient.
    return found if np.isnan(of_all[1]) else of_all


def _bracketed(starts: ndarray, low: float, high: float) -> _Search:
    """The bracket of a loss by some orbits, with NaN as `lost` has it."""
    for number in range(_ROUNDS):
        slope = np.linspace(low, high, _AT_ONCE + 2)
        if number:
            inner = yield starts, slope[1:-1]
            survives = np.array([True, *inner, False])
        else:  # the ends with the others
            survives = yield starts, slope
            if not survives[0]:
                return np.nan, low
            if survives[-1]:
                return high, np.nan

        k = int(np.argmin(survives))
        low = float(slope[k - 1])
        high = float(slope[k])

    return low, high
