"""A walker's lumped constants, through which all its masses and lengths enter, and which of them it has.

With A and B the arms of the stance leg and of the swing links as complex numbers in the leg's frame (x + iy, the leg
along y), in units of the leg l + R and of the whole walker's mass,

    S_a = sum m A,  C_aa = sum m (R^2 + |A|^2) + I,  S_b, S_c = sum m B,  C_bb, C_cc, H = conj(knee) S_c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks.walkers.walker import NUMBERS, Walker
from tasks.walkers.walker_array import WalkerArray


def lump(walker: Walker, number: type = float) -> dict[str, Any]:
    """Lumped constants of a walker in units of its leg, its mass and g.

    Parameters
    ----------
    walker : Walker
        Its table of masses and lengths, in any units; or an array of walkers, whose constants are arrays.
    number : type
        `float`, or a wider type for constants to more digits: numpy's long double or heyoka's real128.

    Returns
    -------
    dict
        `R, l, eps, C_aa, S_a, S_b, C_bb` with complex constants split into `_re` and `_im`; kneed walkers
        also `S_c, C_cc, H`. Swing constants are divided by `eps`, the swing leg's inertia about the hip.
    """
    key = {k: number(getattr(walker, k)) for k in NUMBERS}
    zero, one, two = number(0.0), number(1.0), number(2.0)
    sin_T, cos_T = _sine(key["eps_T"]), _cosine(key["eps_T"])
    d = key["l_s"] - key["R"]
    # sin eps_S = l_t sin eps_T / d closes the leg.
    sin_S = key["l_t"] * sin_T / d if np.any(walker.eps_T) else zero
    cos_S = (one - sin_S * sin_S) ** number(0.5)
    l = key["l_t"] * cos_T + d * cos_S
    length, mass = l + key["R"], two * (key["m_t"] + key["m_s"]) + key["m_h"]
    R, l = key["R"] / length, l / length
    knee = _Vector(-key["l_t"] * sin_T, -key["l_t"] * cos_T) / length
    thigh = _Vector(-key["c_t"] * sin_T - key["w_t"] * cos_T, -key["c_t"] * cos_T + key["w_t"] * sin_T) / length
    shank = _Vector(key["c_s"] * sin_S - key["w_s"] * cos_S, -key["c_s"] * cos_S - key["w_s"] * sin_S) / length
    if walker.massless_leg:
        # Only ratios of the swing leg's constants remain: a unit mass where the shank's was.
        eps, m_t, m_s = zero, zero, one
    else:
        eps, m_t, m_s = one, key["m_t"] / mass, key["m_s"] / mass
    S_b, S_c = thigh * m_t + knee * m_s, shank * m_s
    C_bb = m_t * (thigh.dot(thigh) + (key["r_t"] / length) ** two) + m_s * knee.dot(knee)
    C_cc = m_s * (shank.dot(shank) + (key["r_s"] / length) ** two)
    # H = conj(knee) S_c.
    H = _Vector(knee.dot(S_c), knee.x * S_c.y - knee.y * S_c.x)
    inertia = C_bb + C_cc + two * H.x
    leg_S = (S_b + S_c) * eps
    constants = {"R": R, "l": l, "eps": eps * inertia, **_pair("S_a", leg_S + _Vector(zero, l))}
    # Stance leg m|il + p|^2 + I, hip and swing leg (the rest of the unit mass) at |il|.
    constants["C_aa"] = R * R + l * l + two * l * leg_S.y + eps * inertia
    if walker.knees:
        constants |= {
            **_pair("S_b", S_b / inertia),
            "C_bb": C_bb / inertia,
            **_pair("S_c", S_c / inertia),
            "C_cc": C_cc / inertia,
            **_pair("H", H / inertia),
        }
    else:
        constants |= {**_pair("S_b", (S_b + S_c) / inertia), "C_bb": one}
    return constants


@dataclass(frozen=True)
class _Vector:
    """A vector of a leg, in any type of number."""

    x: Any
    y: Any

    def __add__(self, other: _Vector) -> _Vector:
        return _Vector(self.x + other.x, self.y + other.y)

    def __mul__(self, factor: Any) -> _Vector:
        return _Vector(self.x * factor, self.y * factor)

    def __truediv__(self, divisor: Any) -> _Vector:
        return _Vector(self.x / divisor, self.y / divisor)

    def dot(self, other: _Vector) -> Any:
        """Scalar product."""
        return self.x * other.x + self.y * other.y


def _sine(x: Any) -> Any:
    """Sine in the argument's type of number."""
    if isinstance(x, np.ndarray):
        return np.sin(x)
    return math.sin(x) if isinstance(x, float) and type(x) is float else np.sin(np.array([x], dtype=type(x)))[0]


def _cosine(x: Any) -> Any:
    """Cosine in the argument's type of number."""
    if isinstance(x, np.ndarray):
        return np.cos(x)
    return math.cos(x) if isinstance(x, float) and type(x) is float else np.cos(np.array([x], dtype=type(x)))[0]


def _pair(name: str, v: _Vector) -> dict[str, Any]:
    """A complex constant as `_re` and `_im`; a part that is zero but for rounding becomes zero."""
    parts = {f"{name}_re": v.x, f"{name}_im": v.y}
    if any(isinstance(x, np.ndarray) for x in parts.values()):
        size = 4e-16 * np.maximum(np.abs(v.x), np.abs(v.y))
        return {key: np.where(np.abs(x) > size, x, 0.0) for key, x in parts.items()}
    size = 4e-16 * max(abs(float(v.x)), abs(float(v.y)))
    return {key: x if abs(float(x)) > size else type(x)(0.0) for key, x in parts.items()}


@dataclass(frozen=True)
class Structure:
    """Which constants a walker has; code is compiled once per structure, never per value."""

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


def structure_of(walker: Walker) -> Structure:
    """Return the structure of a walker, or of an array of walkers.

    A straight leg's constants that are 0 or +-1, for all walkers of an array, become code, all others parameters.
    """
    constants = lump(walker, np.float64 if isinstance(walker, WalkerArray) else float)
    # Three links compile slowly and gain little from a zero, so all kneed walkers share one structure.
    plain = () if walker.knees else (0.0, 1.0, -1.0)
    fixed = tuple((k, p) for k, v in constants.items() for p in plain if np.all(v == p))
    free = tuple(k for k in constants if k not in dict(fixed))
    return Structure(walker.knees, walker.point_foot, free, fixed)


def constants_of(walker: Walker, structure: Structure) -> np.ndarray:
    """Values of the structure's runtime constants, each rounded only once.

    Parameters
    ----------
    walker : Walker
        Of that structure; or an array of n such walkers.
    structure : Structure
        Names the constants and their order.

    Returns
    -------
    ndarray, shape (len(structure.constants),) or (len(structure.constants), n)
        In units of the walker's leg, its mass and g.
    """
    lumped = lump(walker, np.longdouble)
    shape = (len(walker),) if isinstance(walker, WalkerArray) else ()
    return np.array([np.broadcast_to(np.asarray(lumped[k], float), shape) for k in structure.constants])
