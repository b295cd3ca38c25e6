"""A walker's lumped constants, through which all its masses and lengths enter, and
which of them it has.

With A and B the arms of the stance leg and of the swing links as complex numbers in the
leg's frame (x + iy, the leg along y), in units of the leg l + R and of the whole
walker's mass,

    S_a = sum m A,  C_aa = sum m (R^2 + |A|^2) + I,  S_b, S_c = sum m B,  C_bb, C_cc, H
    = conj(knee) S_c.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from heyoka import real128

from gaitsweep.tasks.mechanics.vector import Vector
from gaitsweep.tasks.walkers.statics import lies_on_line
from gaitsweep.tasks.walkers.walker import NUMBERS, Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

#: Lumped constants of every walker, and the further ones of those with knees, in the
#: order of `lump`.
_CONSTANTS = ("R", "l", "eps", "S_a_re", "S_a_im", "C_aa", "S_b_re", "S_b_im", "C_bb")
_OF_KNEES = ("S_c_re", "S_c_im", "C_cc", "H_re", "H_im")
#: Offset of a centre of mass, over its distance, below which it is computed in 128
#: bits.
_NEARLY_TUNED = 1e-2


def lump(walker: Walker, number: type = float) -> dict[str, Any]:
    """Lumped constants of a walker in units of its leg, its mass and g.

    Parameters
    ----------
    walker : Walker
        Its table of masses and lengths, in any units.
    number : type
        `float`, or a wider type for constants to more digits: numpy's long double or
        heyoka's real128.

    Returns
    -------
    dict
        `R, l, eps, C_aa, S_a, S_b, C_bb` with complex constants split into `_re` and
        `_im`; kneed walkers also `S_c, C_cc, H`. Swing constants are divided by `eps`,
        the swing leg's inertia about the hip.
    """
    return {
        name: value[0]
        for name, value in _lump_all(WalkerArray.of([walker]), number).items()
    }


# Constants of invalid walkers, which an array may hold, are NaN.
@np.errstate(divide="ignore", invalid="ignore")
def _lump_all(walkers: WalkerArray, number: type) -> dict[str, np.ndarray]:
    """Lumped constants of several walkers, all with or all without knees, as `lump` has
    them, in arrays (n,).
    """
    key: dict[str, Any] = {
        k: np.broadcast_to(np.asarray(getattr(walkers, k), number), len(walkers))
        for k in NUMBERS
    }
    massless = walkers.massless_legs
    zero, one, two, half = (
        np.full(len(walkers), number(x)) for x in (0.0, 1.0, 2.0, 0.5)
    )
    bent, knees = key["eps_T"] != 0, walkers.knees
    sin_T, cos_T = np.sin(key["eps_T"]), np.cos(key["eps_T"])
    d = key["l_s"] - key["R"]
    # sin eps_S = l_t sin eps_T / d closes the leg.
    sin_S = np.where(bent, key["l_t"] * sin_T / np.where(bent, d, one), zero)
    cos_S = _power(one - sin_S * sin_S, half)
    l = key["l_t"] * cos_T + d * cos_S
    length, mass = l + key["R"], two * (key["m_t"] + key["m_s"]) + key["m_h"]
    R, l = key["R"] / length, l / length
    knee = Vector(-key["l_t"] * sin_T, -key["l_t"] * cos_T) / length
    thigh = (
        Vector(
            -key["c_t"] * sin_T - key["w_t"] * cos_T,
            -key["c_t"] * cos_T + key["w_t"] * sin_T,
        )
        / length
    )
    shank = (
        Vector(
            key["c_s"] * sin_S - key["w_s"] * cos_S,
            -key["c_s"] * cos_S - key["w_s"] * sin_S,
        )
        / length
    )
    # For a massless leg only ratios of the swing leg's constants remain: a unit mass
    # where the shank's was.
    eps = np.where(massless, zero, one)
    m_t, m_s = (
        np.where(massless, zero, key["m_t"] / mass),
        np.where(massless, one, key["m_s"] / mass),
    )
    S_b, S_c = thigh * m_t + knee * m_s, shank * m_s
    if knees:
        S_b, S_c = _aligned(S_b), _aligned(S_c)
    S = _aligned(S_b + S_c)
    C_bb = m_t * (thigh.dot(thigh) + _power(key["r_t"] / length, two)) + m_s * knee.dot(
        knee
    )
    C_cc = m_s * (shank.dot(shank) + _power(key["r_s"] / length, two))
    # H = conj(knee) S_c.
    H = Vector(knee.dot(S_c), knee.x * S_c.y - knee.y * S_c.x)
    inertia = C_bb + C_cc + two * H.x
    constants = {
        "R": R,
        "l": l,
        "eps": eps * inertia,
        **_pair("S_a", S * eps + Vector(zero, l)),
    }
    # Stance leg m|il + p|^2 + I, hip and swing leg (the rest of the unit mass) at |il|.
    constants["C_aa"] = R * R + l * l + two * l * eps * S.y + eps * inertia
    if knees:
        constants |= {
            **_pair("S_b", S_b / inertia),
            "C_bb": C_bb / inertia,
            **_pair("S_c", S_c / inertia),
            "C_cc": C_cc / inertia,
            **_pair("H", _aligned(H) / inertia),
        }
    else:
        constants |= {**_pair("S_b", S / inertia), "C_bb": one}
    return constants


def _power(x: np.ndarray, exponent: np.ndarray) -> np.ndarray:
    """Powers; of doubles as C has them, which numpy's own may miss by a bit."""
    return (
        np.array(list(map(pow, x.tolist(), exponent.tolist())))
        if x.dtype == float
        else np.power(x, exponent)
    )


def _aligned(v: Vector) -> Vector:
    """Vector with parts that are only rounding set to zero: tuned to within doubles is
    tuned.
    """
    return Vector(
        np.where(lies_on_line(v.x, v.y), v.x - v.x, v.x),
        np.where(lies_on_line(v.y, v.x), v.y - v.y, v.y),
    )


def _pair(name: str, v: Vector) -> dict[str, Any]:
    """A complex constant as `_re` and `_im`."""
    return {f"{name}_re": v.x, f"{name}_im": v.y}


@dataclass(frozen=True)
class Structure:
    """Which constants a walker has as parameters; code is compiled once per structure,
    never per value.
    """

    kneed: bool
    point_foot: bool
    constants: tuple[str, ...]
    units: tuple[tuple[str, float], ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Order of the runtime parameters: slope, scale, then the constants."""
        return ("slope", "scale", *self.constants)

    @property
    def dimension(self) -> int:
        """Dimension of the stride map."""
        return 2 if self.point_foot else 3

    @property
    def phases(self) -> tuple[bool, ...]:
        """Whether the swing knee is free in each phase of a step: to kneestrike, then
        to heelstrike.
        """
        return (True, False) if self.kneed else (False,)


def general_structure(kneed: bool) -> Structure:
    """Return the structure of all walkers with or without knees: every constant is a
    parameter.
    """
    return Structure(kneed, False, _CONSTANTS + (_OF_KNEES if kneed else ()), ())


def locked(parameters: np.ndarray) -> np.ndarray:
    """Parameters of the general structure of straight legs, for walkers with knees
    while these are locked.

    Parameters
    ----------
    parameters : ndarray, shape (n_parameters, ...)
        Slope, scale and constants of the general structure of knees.

    Returns
    -------
    ndarray, shape (slope, scale and the constants of straight legs, ...)
    """
    common, (S_b_re, S_b_im, C_bb, S_c_re, S_c_im, C_cc, H_re, _) = (
        parameters[:8],
        parameters[8:],
    )
    return np.concatenate(
        [common, [S_b_re + S_c_re, S_b_im + S_c_im, C_bb + C_cc + 2 * H_re]]
    )


def structure_of(walker: Walker) -> Structure:
    """Return a walker's structure, the general one except for point feet and massless
    straight legs.

    With these the motion loses whole terms, as the constants that are 0 or +-1 become
    code. Other walkers gain little from a zero, less than another structure takes to
    compile.
    """
    return structures_of([walker])[0]


def structures_of(walkers: Sequence[Walker]) -> list[Structure]:
    """Return the structures of several walkers, as `structure_of` does."""
    structures = [general_structure(walker.knees) for walker in walkers]
    special = [i for i, walker in enumerate(walkers) if _is_special(walker)]
    if special:
        constants = _lump_all(WalkerArray.of([walkers[i] for i in special]), float)
        for i, row in zip(
            special, np.array(list(constants.values())).T.tolist(), strict=True
        ):
            structures[i] = _structure(
                walkers[i], dict(zip(constants, row, strict=True))
            )
    return structures


def alike(walkers: Sequence[Walker]) -> dict[Structure, list[int]]:
    """Return the numbers of the walkers of each structure."""
    numbers: dict[Structure, list[int]] = {}
    for i, structure in enumerate(structures_of(walkers)):
        numbers.setdefault(structure, []).append(i)
    return numbers


def common_structure(walkers: WalkerArray) -> Structure:
    """Return a structure for all of an array of walkers: only what is 0 or +-1 for each
    of them becomes code.
    """
    if not _is_special(walkers):
        return general_structure(walkers.knees)
    constants = _lump_all(walkers, float)
    return _structure(
        walkers,
        {k: v[0] if (v == v[0]).all() else np.nan for k, v in constants.items()},
    )


def _is_special(walker: Walker | WalkerArray) -> bool:
    """Whether constants that are 0 or +-1 become code."""
    return not walker.knees and (walker.point_foot or walker.massless_leg)


def _structure(walker: Walker | WalkerArray, constants: dict[str, float]) -> Structure:
    """Structure in which constants that are 0 or +-1 are code, all others parameters."""
    units = tuple((k, float(v)) for k, v in constants.items() if v in (0.0, 1.0, -1.0))
    return Structure(
        False,
        walker.point_foot,
        tuple(k for k in constants if k not in dict(units)),
        units,
    )


def constants_of(walkers: WalkerArray, structure: Structure) -> np.ndarray:
    """Values of the structure's runtime constants, each rounded only once.

    Parameters
    ----------
    walkers : WalkerArray
        Of that structure.
    structure : Structure
        Names the constants and their order.

    Returns
    -------
    ndarray, shape (len(structure.constants), n)
        In units of each walker's leg, its mass and g.
    """
    constants = _lump_all(walkers, np.longdouble)
    values = np.array([constants[k] for k in structure.constants], float).reshape(
        -1, len(walkers)
    )
    # Offsets of nearly tuned legs are differences, of which long double leaves too few
    # digits.
    near = np.zeros(len(walkers), bool)
    for name in ("S_a", "S_b", "S_c", "H") if walkers.knees else ("S_a", "S_b"):
        small, large = np.sort(
            np.abs([constants[f"{name}_re"], constants[f"{name}_im"]]), axis=0
        )
        near |= (small > 0) & (small < _NEARLY_TUNED * large)
    lanes = np.flatnonzero(near).tolist()
    if lanes:
        constants = _lump_all(walkers.some(np.array(lanes)), real128)
        values[:, lanes] = np.array(
            [constants[k] for k in structure.constants], real128
        ).astype(float)
    return values
