"""Steps of straight legs to first order in the angles: what a search for gaits begins with."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.walkers.walker import Walker

#: Periods searched for those in which both legs exchange places [sqrt(leg/g)].
_PERIODS = np.linspace(1.0, 6.0, 51)


def exchange_rates(walker: Walker, angle: np.ndarray, period: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Rates just after heelstrike with which straight legs exchange places in a given time.

    Parameters
    ----------
    walker : Walker
        Without knees.
    angle, period, slope : ndarray, shape (n,) [rad], [sqrt(leg/g)] and [rad]

    Returns
    -------
    ndarray, shape (2, n) [rad/sqrt(leg/g)]
        Of the stance and of the swing leg. A leg whose mass is all at the foot starts with the rate that heelstrike
        gives it; then only the stance leg reaches the other's place.
    """
    by_angles, by_rates, start, rest = _exchange(walker, angle, period, slope)
    lack = -start - rest - matvec(by_angles, start - rest)
    if walker.point_foot:
        along = _rates_along(angle)
        return along * lack[0] / total(by_rates[0] * along)
    return np.linalg.solve(by_rates.transpose(2, 0, 1), lack.T[:, :, None])[:, :, 0].T


def exchange_periods(walker: Walker, angle: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Periods in which both legs exchange places, where their masses are at the feet.

    Parameters
    ----------
    walker : Walker
        With point feet.
    angle, slope : ndarray, shape (n,) [rad]

    Returns
    -------
    ndarray, shape (2, n) [sqrt(leg/g)]
        The two shortest, by linear interpolation between periods 0.1 apart; NaN where there are fewer.
    """
    by_angles, by_rates, start, rest = _exchange(walker, angle, _PERIODS, slope)
    # Of both legs, (2, periods, n): what they lack, and what a rate of the stance leg adds.
    lack = (-start - rest)[:, None] - matvec(by_angles[..., None], (start - rest)[:, None])
    by_rate = matvec(by_rates[..., None], _rates_along(angle)[:, None])
    off = lack[1] * by_rate[0] - lack[0] * by_rate[1]
    crosses = np.diff(np.sign(off), axis=0) != 0
    with np.errstate(invalid="ignore", divide="ignore"):
        roots = _PERIODS[:-1, None] - off[:-1] * np.diff(_PERIODS)[:, None] / np.diff(off, axis=0)
    return np.sort(np.where(crosses, roots, np.nan), axis=0)[:2]


def _rates_along(angle: np.ndarray) -> np.ndarray:
    """Rates just after heelstrike over the stance leg's, where the masses are at the feet, shape (2, n)."""
    return np.array([np.ones_like(angle), np.cos(2 * angle)])


def _exchange(
    walker: Walker, angle: np.ndarray, period: np.ndarray, slope: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Linear motion in certain periods, (2, 2, n), by angles and by rates; the first angles, and those at rest, (2, n).

    Notes
    -----
    Near q = (stance, swing angle) = 0 the equations of motion (tasks.mechanics.equations) are
    M q'' = G q - c, with G = diag(Im S_a, Im S_b) and c = (Re S_a + (Im S_a - R) slope, Re S_b + Im S_b slope).
    With q0 = (angle, -angle), q(T) = -q0 is linear in the rates.
    """
    k = lump(walker)
    S_a, S_b = complex(k["S_a_re"], k["S_a_im"]), complex(k["S_b_re"], k["S_b_im"])
    M = np.array([[k["C_aa"] + 2 * k["R"] * S_a.imag, k["eps"] * S_b.imag], [S_b.imag, k["C_bb"]]])
    G = np.array([S_a.imag, S_b.imag])
    rest = np.array([S_a.real + (S_a.imag - k["R"]) * slope, S_b.real + S_b.imag * slope])
    rest /= np.where(G == 0, np.nan, G)[:, None]  # a balanced leg has no angle of rest of its own
    squares, modes = np.linalg.eig((np.linalg.inv(M) * G).astype(complex))
    growth = np.sqrt(squares)[:, None]
    inverse = np.linalg.inv(modes)

    def propagator(by_mode: np.ndarray) -> np.ndarray:
        return matvec((modes[:, :, None] * inverse)[..., None], by_mode).real

    free = growth == 0
    by_rates = np.where(free, period, np.sinh(growth * period) / np.where(free, 1, growth))
    return propagator(np.cosh(growth * period)), propagator(by_rates), np.array([angle, -angle]), rest
