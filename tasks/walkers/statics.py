"""The static conditions of section 5.1 of the paper, and the nearest walkers that meet
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

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
    leg_offset = {"leg_offset": -leg_moment(walker).real / mass if mass else 0.0}
    return leg_offset | (
        {"shank_offset": -walker.shank_centre.real} if walker.knees else {}
    )


def leg_moment(walker: Walker) -> Any:
    """Return the first moment of the extended leg's mass about the hip, x forward + i y
    up, of one walker or many.
    """
    return walker.m_t * walker.thigh_centre + walker.m_s * (
        walker.knee + walker.shank_centre
    )


def lies_on_line(off: np.ndarray, along: np.ndarray) -> np.ndarray:
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
    return np.asarray(
        np.abs(off.astype(float)) <= TUNED_TO * np.abs(along.astype(float))
    )


def is_tuned(walker: Walker) -> bool:
    """Whether a walker meets both static conditions to within what doubles can say: it
    may walk at any slope.
    """
    return bool(are_tuned(WalkerArray.of([walker]))[0])


def are_tuned(walkers: WalkerArray) -> np.ndarray:
    """Return which walkers meet the static conditions, as `is_tuned` does, shape (n,)."""
    keys = {
        key: np.asarray(getattr(walkers, key), np.longdouble) for key in CONDITIONED
    }
    return np.broadcast_to(_meet_conditions(keys, walkers.knees), len(walkers))


# A walker that cannot be is not tuned.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def _meet_conditions(key: dict[str, np.ndarray], knees: bool) -> np.ndarray:
    """Whether walkers, by keys in long double, meet the static conditions.

    With knees these are conditions of the shank, and of the thigh with the shank's mass
    at the knee: together they are those of shank and leg.
    """
    sine, cosine = _lean(key)
    sine_T, cosine_T = np.sin(key["eps_T"]), np.cos(key["eps_T"])
    shank_off, shank_along = (
        key["w_s"] * cosine - key["c_s"] * sine,
        key["c_s"] * cosine + key["w_s"] * sine,
    )
    off = (
        key["m_t"] * (key["w_t"] * cosine_T + key["c_t"] * sine_T)
        + key["m_s"] * key["l_t"] * sine_T
    )
    along = (
        key["m_t"] * (key["c_t"] * cosine_T - key["w_t"] * sine_T)
        + key["m_s"] * key["l_t"] * cosine_T
    )
    if knees:
        return lies_on_line(shank_off, shank_along) & lies_on_line(off, along)
    return lies_on_line(off + key["m_s"] * shank_off, along + key["m_s"] * shank_along)


# A walker that cannot be leaves NaN.
@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def nearest(
    walker: Walker, free: Sequence[str]
) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray]:
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
    names = dict.fromkeys((*CONDITIONED, *free))
    given = np.broadcast_arrays(
        *(np.asarray(getattr(walker, key), np.longdouble) for key in names), np.zeros(1)
    )
    start = dict(zip(names, given, strict=False))
    leg, mass = (
        np.broadcast_to(np.asarray(x, float), given[-1].shape)
        for x in (walker.leg, walker.m_t + walker.m_s)
    )
    # Offsets near zero have no relative size of their own: the leg is their scale.
    scale = np.array(
        [np.where(start[key] != 0, np.abs(start[key]), leg) for key in free], float
    )

    def at(change: np.ndarray, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = {
            key: start[key][lanes] + scale[k, lanes] * change[k]
            for k, key in enumerate(free)
        }
        keys = {key: value[lanes] for key, value in start.items()} | moved
        values, by = _conditions(keys, walker.knees, leg[lanes], mass[lanes])
        return values, np.array(
            [[row.get(key, 0.0 * leg[lanes]) for key in free] for row in by]
        ) * scale[:, lanes]

    def step(lanes: np.ndarray, searching: bool) -> np.ndarray:
        """Newton's step, NaN where the walker cannot be; in the search to the least
        change that meets the conditions.

        Sums are written out: they round alike for one lane and for many.
        """
        residual, by = at(change[:, lanes], lanes)
        finite = np.isfinite(residual).all(axis=0) & np.isfinite(by).all(axis=(0, 1))
        by = np.where(finite, by, 0.0)
        inverse = np.moveaxis(
            np.linalg.pinv(np.moveaxis(by, -1, 0).astype(float), rcond=1e-9), 0, -1
        )
        before = change[:, lanes] * float(searching)
        wanted = sum(by[:, k] * before[k] for k in range(len(free))) - residual
        moved = sum(inverse[:, c] * wanted[c] for c in range(len(wanted))) - before
        return np.where(finite, moved, np.nan)

    change = np.zeros(scale.shape, np.longdouble)
    off = ~_meet_conditions(start, walker.knees)
    active = np.flatnonzero(off)
    for _ in range(_MAX_STEPS):
        if not len(active):
            break
        moved = step(active, searching=True)
        change[:, active] += moved
        active = active[np.abs(moved).max(axis=0) >= _ENOUGH]
    for _ in range(_CORRECTIONS if off.any() else 0):
        change[:, off] += step(np.flatnonzero(off), searching=False)
    values = {
        key: np.asarray(start[key] + scale[k] * change[k], float)
        for k, key in enumerate(free)
    }
    found = _meet_conditions(
        start | {key: value.astype(np.longdouble) for key, value in values.items()},
        walker.knees,
    )
    return (
        {key: np.where(found, value, np.nan) for key, value in values.items()},
        np.asarray(change, float),
        found,
    )


def _conditions(
    key: dict[str, np.ndarray], knees: bool, leg: np.ndarray, mass: np.ndarray
) -> tuple[np.ndarray, list[dict[str, np.ndarray]]]:
    """Residuals of the leg and, with knees, the shank, over given lengths and masses,
    (c, n), and their derivatives.
    """
    sine_T, cosine_T, d = (
        np.sin(key["eps_T"]),
        np.cos(key["eps_T"]),
        key["l_s"] - key["R"],
    )
    over = np.where(d == 0, 0.0, 1 / np.where(d == 0, 1, d))
    sine, cosine = _lean(key)
    sine_by = {
        "l_t": sine_T * over,
        "eps_T": key["l_t"] * cosine_T * over,
        "l_s": -sine * over,
        "R": sine * over,
    }
    thigh = key["w_t"] * cosine_T + key["c_t"] * sine_T
    knee, shank = key["l_t"] * sine_T, key["w_s"] * cosine - key["c_s"] * sine
    by_sine = -key["w_s"] * sine / cosine - key["c_s"]
    shank_by = {name: by_sine * value for name, value in sine_by.items()} | {
        "w_s": cosine,
        "c_s": -sine,
    }
    knee_by = {"l_t": sine_T, "eps_T": key["l_t"] * cosine_T}
    thigh_by = {
        "w_t": cosine_T,
        "c_t": sine_T,
        "eps_T": key["c_t"] * cosine_T - key["w_t"] * sine_T,
    }
    leg_by = {
        name: key["m_s"] * (knee_by.get(name, 0.0) + value)
        for name, value in shank_by.items()
    }
    for name, value in thigh_by.items():
        leg_by[name] = leg_by.get(name, 0.0) + key["m_t"] * value
    leg_by |= {"m_t": thigh, "m_s": knee + shank}
    size = leg * np.where(mass > 0, mass, 1.0)
    residuals = [(key["m_t"] * thigh + key["m_s"] * (knee + shank)) / size]
    by = [{name: value / size for name, value in leg_by.items()}]
    if knees:
        residuals.append(shank / leg)
        by.append({name: value / leg for name, value in shank_by.items()})
    return np.array(residuals), by


def _lean(key: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Sine and cosine of eps_S, by which the shank leans on the line from hip to foot
    centre.
    """
    d = key["l_s"] - key["R"]
    sine = key["l_t"] * np.sin(key["eps_T"]) / np.where(d == 0, 1, d)
    sine = np.where(d == 0, 0.0, sine)
    return sine, np.sqrt(1 - sine * sine)
