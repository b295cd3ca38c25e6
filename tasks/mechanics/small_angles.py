"""Steps of straight legs to first order in the angles: what a search for gaits begins with."""

from __future__ import annotations

import numpy as np

from tasks.mechanics.lumped import lump
from tasks.walkers.walker import Walker


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
    rest = np.array([S_a.real + (S_a.imag - k["R"]) * slope, S_b.real + S_b.imag * slope]) / G[:, None]
    squares, modes = np.linalg.eig((np.linalg.inv(M) * G).astype(complex))
    growth = np.sqrt(squares)[:, None]
    inverse = np.linalg.inv(modes)

    def propagator(by_mode: np.ndarray) -> np.ndarray:
        return np.einsum("ik,kn,kj->nij", modes, by_mode, inverse).real

    by_angles, by_rates = propagator(np.cosh(growth * period)), propagator(np.sinh(growth * period) / growth)
    start = np.array([angle, -angle])
    lack = -start - rest - np.einsum("nij,jn->in", by_angles, start - rest)
    if walker.point_foot:
        along = np.array([np.ones_like(angle), np.cos(2 * angle)])
        return along * lack[0] / np.einsum("nj,jn->n", by_rates[:, 0], along)
    return np.linalg.solve(by_rates, lack.T[:, :, None])[:, :, 0].T
