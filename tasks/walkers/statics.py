"""The static conditions of section 5.1 of the paper, and the nearest walkers that meet
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.walkers.walker import Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Keys on which the conditions depend.
CONDITIONED = ("l_t", "w_t", "m_t", "c_t", "l_s", "w_s", "m_s", "c_s", "R", "eps_T")
#: A centre of mass lies on its line if it is off it by no more than this part of its
#: distance from the pivot. No double is the offset that puts it there: rounding leaves
#: up to 1.1e-16, and computing it in doubles as much again twice or so. What is farther
#: off is meant to be: such a walker has a smallest slope, with knees of the order of
#: its offset. The step map sets what is within to 0, and proofs take the exact offset
#: for it, so that all mean the same walker.
TUNED_TO = 4e-16
#: Steps of the search, the change after which it has ended, and the corrections of what
#: rounding has left.
_MAX_STEPS, _ENOUGH, _CORRECTIONS = 60, 1e-14, 6


def statics(walker: Walker) -> dict[str, float]:
    """Residuals of the two static conditions; both vanish for a tuned walker.

    Returns
    -------
    dict of float [the walker's unit of length]
        `leg_offset`, how far the extended leg's centre of mass lies behind the line
        from hip to foot centre, and, with knees, `shank_offset`, how far the shank's
        lies behind the parallel line through the knee.

    Notes
    -----
    Paper, section 5.1.
    """
    mass = walker.m_t + walker.m_s
    residuals = {"leg_offset": 0.0}
    if mass:
        residuals["leg_offset"] = -leg_moment(walker).real / mass
    if walker.knees:
        residuals["shank_offset"] = -walker.shank_centre.real
    return residuals


def leg_moment(walker: Walker) -> Any:
    """Return the first moment of the extended leg's mass about the hip, x forward + i y
    up, of one walker or many.
    """
    shank = walker.knee + walker.shank_centre
    return walker.m_t * walker.thigh_centre + walker.m_s * shank


def lies_on_line(off: ndarray, along: ndarray) -> ndarray:
    """Whether centres of mass lie on a line through their pivots, to within what
    doubles can say.

    Parameters
    ----------
    off, along : ndarray, shape (n,)
        Components across and along the line, or moments of these, of any type of
        number.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    distance = np.abs(along.astype(float))
    return np.asarray(np.abs(off.astype(float)) <= TUNED_TO * distance)


def is_tuned(walker: Walker) -> bool:
    """Whether a walker meets both static conditions to within what doubles can say: it
    may walk at any slope.
    """
    return bool(are_tuned(WalkerArray.of([walker]))[0])


def are_tuned(walkers: WalkerArray) -> ndarray:
    """Return which walkers meet the static conditions, as `is_tuned` does, shape (n,)."""
    keys = {
        key: np.asarray(getattr(walkers, key), np.longdouble) for key in CONDITIONED
    }
    return np.broadcast_to(_meet_conditions(keys, walkers.knees), len(walkers))


# A walker that cannot be is not tuned.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _meet_conditions(key: dict[str, ndarray], knees: bool) -> ndarray:
    """Whether walkers, by keys in long double, meet the static conditions.

    With knees these are conditions of the shank, and of the thigh with the shank's mass
    at the knee: together they are those of shank and leg.
    """
    sine, cosine = _lean(key)
    shank_off = key["w_s"] * cosine - key["c_s"] * sine
    shank_along = key["c_s"] * cosine + key["w_s"] * sine

    sine_T = np.sin(key["eps_T"])
    cosine_T = np.cos(key["eps_T"])
    thigh_off = key["w_t"] * cosine_T + key["c_t"] * sine_T
    thigh_along = key["c_t"] * cosine_T - key["w_t"] * sine_T
    off = key["m_t"] * thigh_off + key["m_s"] * key["l_t"] * sine_T
    along = key["m_t"] * thigh_along + key["m_s"] * key["l_t"] * cosine_T
    if knees:
        of_shank = lies_on_line(shank_off, shank_along)
        return of_shank & lies_on_line(off, along)

    of_leg = off + key["m_s"] * shank_off
    along_leg = along + key["m_s"] * shank_along
    return lies_on_line(of_leg, along_leg)


# A walker that cannot be leaves NaN.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def nearest(
    walker: Walker, free: Sequence[str]
) -> tuple[dict[str, ndarray], ndarray, ndarray]:
    """Change some keys of walkers by least, relatively, so that they meet the static
    conditions.

    Parameters
    ----------
    walker : Walker or WalkerArray
        One walker, or n.
    free : sequence of str
        The k keys that may change.

    Returns
    -------
    values : dict of ndarray, shape (n,)
        Of these keys; those of a walker that is tuned as it was, NaN where no change of
        them tunes it.
    change : ndarray, shape (k, n)
        How far they moved, relatively; over the leg where a key was zero.
    found : ndarray of bool, shape (n,)
        Whether they tune the walker.

    Notes
    -----
    The change of least norm is a combination of the conditions' gradients where they hold: Newton's method with steps
    of least norm from the walker itself. Residuals are those of long double, so that
    they end at doubles' rounding.
    """
    tuning = _Tuning(walker, free)
    change = np.zeros(tuning.scale.shape, np.longdouble)
    off = np.flatnonzero(~_meet_conditions(tuning.start, walker.knees))

    active = off
    for _ in range(_MAX_STEPS):
        if not len(active):
            break
        moved = tuning.step(change, active, searching=True)
        change[:, active] += moved
        active = active[np.abs(moved).max(axis=0) >= _ENOUGH]

    if len(off):
        for _ in range(_CORRECTIONS):
            change[:, off] += tuning.step(change, off, searching=False)

    values = {}
    rounded = {}
    for key, value in tuning.moved(change).items():
        values[key] = value.astype(float)
        rounded[key] = values[key].astype(np.longdouble)

    found = _meet_conditions(tuning.start | rounded, walker.knees)
    kept = {key: np.where(found, value, np.nan) for key, value in values.items()}
    return kept, np.asarray(change, float), found


class _Tuning:
    """Walkers of which some keys move, by changes relative to their scales.

    Attributes
    ----------
    start : dict of ndarray of long double, shape (n,)
        The keys of the conditions, and the free ones, before they move.
    scale : ndarray, shape (k, n)
        What a change of one moves a free key by.
    """

    def __init__(self, walker: Walker, free: Sequence[str]):
        names = dict.fromkeys((*CONDITIONED, *free))
        values = []
        for key in names:
            values.append(np.asarray(getattr(walker, key), np.longdouble))
        *given, shape = np.broadcast_arrays(*values, np.zeros(1))
        self.start = dict(zip(names, given, strict=True))
        self._free = free
        self._knees = walker.knees

        leg = np.asarray(walker.leg, float)
        mass = np.asarray(walker.m_t + walker.m_s)
        self._leg = np.broadcast_to(leg, shape.shape)
        self._mass = np.broadcast_to(mass.astype(float), shape.shape)
        # Offsets near zero have no relative size of their own: the leg is their scale.
        scales = []
        for key in free:
            size = np.abs(self.start[key])
            scales.append(np.where(size != 0, size, self._leg))

        self.scale = np.array(scales, float)

    def moved(self, change: ndarray, lanes: Any = ...) -> dict[str, ndarray]:
        """Free keys of some lanes after a change, shape (k, n)."""
        moves = self.scale[:, lanes] * change[:, lanes]
        return {
            key: self.start[key][lanes] + move
            for key, move in zip(self._free, moves, strict=True)
        }

    def step(
        self,
        change: ndarray,
        lanes: ndarray,
        searching: bool,
    ) -> ndarray:
        """Newton's step of some lanes (i,) from a change, shape (k, n); NaN where the
        walker cannot be; in the search to the least change that meets the conditions.

        Sums are written out: they round alike for one lane and for many.
        """
        residual, by = self._residuals(change, lanes)
        is_finite = np.isfinite(residual).all(axis=0)
        is_finite &= np.isfinite(by).all(axis=(0, 1))
        by = np.where(is_finite, by, 0.0)
        matrices = np.moveaxis(by, -1, 0).astype(float)
        inverses = np.linalg.pinv(matrices, rcond=1e-9)
        inverse = np.moveaxis(inverses, 0, -1)

        before = change[:, lanes] * float(searching)
        wanted = sum(by[:, k] * own for k, own in enumerate(before)) - residual
        moved = sum(inverse[:, c] * own for c, own in enumerate(wanted)) - before
        return np.where(is_finite, moved, np.nan)

    def _residuals(
        self,
        change: ndarray,
        lanes: ndarray,
    ) -> tuple[ndarray, ndarray]:
        """Residuals (c, i) and their derivatives (c, k, i) by the changes."""
        keys = {key: value[lanes] for key, value in self.start.items()}
        keys |= self.moved(change, lanes)
        residuals, by = _conditions(
            keys, self._knees, self._leg[lanes], self._mass[lanes]
        )
        zero = 0.0 * self._leg[lanes]
        rows = []
        for row in by:
            rows.append([row.get(key, zero) for key in self._free])
        return residuals, np.array(rows) * self.scale[:, lanes]


def _conditions(
    key: dict[str, ndarray],
    knees: bool,
    leg: ndarray,
    mass: ndarray,
) -> tuple[ndarray, list[dict[str, ndarray]]]:
    """Residuals of the leg and, with knees, the shank, over given lengths and masses,
    (c, n), and their derivatives.
    """
    shank, shank_by = _shank(key)
    moment, moment_by = _leg_moment(key, shank, shank_by)

    size = leg * np.where(mass > 0, mass, 1.0)
    residuals = [moment / size]
    by = [{name: value / size for name, value in moment_by.items()}]
    if knees:
        residuals.append(shank / leg)
        by.append({name: value / leg for name, value in shank_by.items()})

    return np.array(residuals), by


def _shank(
    key: dict[str, ndarray],
) -> tuple[ndarray, dict[str, ndarray]]:
    """How far the shank's centre of mass lies off the line from the knee, and its
    derivatives.
    """
    d = key["l_s"] - key["R"]
    divisor = np.where(d == 0, 1, d)
    over = np.where(d == 0, 0.0, 1 / divisor)
    sine, cosine = _lean(key)
    sine_by = {
        "l_t": np.sin(key["eps_T"]) * over,
        "eps_T": key["l_t"] * np.cos(key["eps_T"]) * over,
        "l_s": -sine * over,
        "R": sine * over,
    }

    off = key["w_s"] * cosine - key["c_s"] * sine
    by_sine = -key["w_s"] * sine / cosine - key["c_s"]
    by = {name: by_sine * value for name, value in sine_by.items()}
    return off, by | {"w_s": cosine, "c_s": -sine}


def _leg_moment(
    key: dict[str, ndarray],
    shank: ndarray,
    shank_by: dict[str, ndarray],
) -> tuple[ndarray, dict[str, ndarray]]:
    """First moment of the leg across the line from hip to foot centre, and its
    derivatives, by those of its shank's offset from that line's parallel.
    """
    sine = np.sin(key["eps_T"])
    cosine = np.cos(key["eps_T"])
    knee = key["l_t"] * sine
    knee_by = {"l_t": sine, "eps_T": key["l_t"] * cosine}
    thigh = key["w_t"] * cosine + key["c_t"] * sine
    thigh_by = {
        "w_t": cosine,
        "c_t": sine,
        "eps_T": key["c_t"] * cosine - key["w_t"] * sine,
    }

    by = {}
    for name, value in shank_by.items():
        by[name] = key["m_s"] * (knee_by.get(name, 0.0) + value)
    for name, value in thigh_by.items():
        by[name] = by.get(name, 0.0) + key["m_t"] * value
    by |= {"m_t": thigh, "m_s": knee + shank}
    moment = key["m_t"] * thigh + key["m_s"] * (knee + shank)
    return moment, by


def _lean(key: dict[str, ndarray]) -> tuple[ndarray, ndarray]:
    """Sine and cosine of eps_S, by which the shank leans on the line from hip to foot
    centre.
    """
    d = key["l_s"] - key["R"]
    divisor = np.where(d == 0, 1, d)
    sine = key["l_t"] * np.sin(key["eps_T"]) / divisor
    sine = np.where(d == 0, 0.0, sine)
    return sine, np.sqrt(1 - sine * sine)
