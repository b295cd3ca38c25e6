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

import numpy as np
from numpy import ndarray

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


def surviving_slopes(
    problem: Problem,
    starts: ndarray,
    slope: ndarray,
    strides: int,
) -> ndarray:
    """Find the slopes at which all orbits that outlast the transient persist and none
    converges to period one.

    Parameters
    ----------
    starts : ndarray, shape (m, k) [rad, rad/sqrt(leg/g)]
        Initial section coordinates, the same at every slope.
    slope : ndarray, shape (n,) [rad]
    strides : int
        Steps after the transient.

    Returns
    -------
    ndarray of bool, shape (n,)
        False too where no orbit outlasts the transient.
    """
    number = np.repeat(np.arange(len(slope)), starts.shape[1])
    walk = Walk(problem, np.tile(starts, (1, len(slope))), slope[number])
    for _ in walk.steps(_TRANSIENT):
        pass
    lasting = walk.lanes
    survives = np.isin(np.arange(len(slope)), number[lasting])
    for taken in walk.steps(strides):
        # One orbit that leaves decides for its slope.
        survives[number[lasting[walk.outcome[lasting] != STRUCK]]] = False
        if taken == strides:
            survives[
                number[
                    walk.lanes[change(walk.before, walk.y[:, walk.lanes]) < _SETTLED]
                ]
            ] = False

        walk.lanes = walk.lanes[survives[number[walk.lanes]]]

    return survives


def lost(
    problem: Problem,
    starts: ndarray,
    low: float,
    high: float,
    strides: int,
) -> tuple[float, float]:
    """Bracket the slope at which an attractor is lost: at the upper one an orbit is lost
    within some steps, at the lower one none of all.

    Parameters
    ----------
    starts : ndarray, shape (m, k) [rad, rad/sqrt(leg/g)]
        Initial states on the attractor at `low`.
    low, high : float [rad]
        The bracket to begin with.
    strides : int
        Steps after the transient.

    Returns
    -------
    low, high : float [rad]
        Neighbouring slopes of the last round. NaN for `low` where the attractor does
        not persist there either, and for `high` where it is not lost.
    """
    found = _bracketed(problem, starts[:, :_FEW], low, high, strides)
    last = found[0]
    if np.isnan(last):
        return found
    if surviving_slopes(problem, starts, np.array([last]), strides)[0]:
        return found
    return _bracketed(problem, starts, low, last, strides)


def _bracketed(
    problem: Problem, starts: ndarray, low: float, high: float, strides: int
) -> tuple[float, float]:
    """The bracket of a loss within some steps, with NaN as `lost` has it."""
    for number in range(_ROUNDS):
        slope = np.linspace(low, high, _AT_ONCE + 2)
        if number:
            survives = np.array(
                [True, *surviving_slopes(problem, starts, slope[1:-1], strides), False]
            )
        else:  # the ends with the others
            survives = surviving_slopes(problem, starts, slope, strides)
            if not survives[0]:
                return np.nan, low
            if survives[-1]:
                return high, np.nan

        k = int(np.argmin(survives))
        low = float(slope[k - 1])
        high = float(slope[k])

    return low, high
