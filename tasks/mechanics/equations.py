"""Equations of motion with lumped constants, as symbols, for two links (knees locked) and three.

Frame and angles as PHYSICS settles them: x down the slope, y along the ground normal, angles counter-clockwise
from the normal; a vector of a leg is a complex number x + iy in the frame of that leg, rotated by exp(i angle).
Unit of length is the leg l + R, of mass the whole walker, and g = 1.

With A and B the arms of the stance leg and of the swing links, all a walker's masses enter through

    S_a = sum m A,  C_aa = sum m (R^2 + |A|^2) + I,  S_b, S_c = sum m B,  C_bb, C_cc, H = conj(knee) S_c,

and the kinetic and potential energies are

    T = 1/2 (C_aa + 2 R Im(e^{ia} S_a)) a'^2 + (R Im(e^{ib} S_b) - l Re(i S_b e^{i(b-a)})) a' b' + 1/2 C_bb b'^2 + ...
    V = R a sin(slope) + Im(e^{i(a-slope)} S_a) + Im(e^{i(b-slope)} S_b) + ...

Rows of the swing links are divided by the leg's inertia `eps`, so the limit of a vanishing foot mass is exact.
States are scaled, q = s x with s a power of two, so an absolute tolerance is a relative one on any slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import heyoka as hy
import numpy as np

from tasks.walkers.parameters import NUMBERS, Walker

ZERO = hy.expression(0.0)
Sym = hy.expression


@dataclass(frozen=True)
class Complex:
    """A complex number of symbols; multiplication by exp(i angle) is all the mechanics needs."""

    re: Sym
    im: Sym

    def turned(self, sine: Sym, cosine: Sym) -> Complex:
        return Complex(self.re * cosine - self.im * sine, self.re * sine + self.im * cosine)


def lump(walker: Walker, number: type = float) -> dict[str, Any]:
    """Lumped constants of a walker in units of its leg, its mass and g.

    Parameters
    ----------
    walker : Walker
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
    sin_S = key["l_t"] * sin_T / d if walker.eps_T else zero
    cos_S = (one - sin_S * sin_S) ** number(0.5)
    l = key["l_t"] * cos_T + d * cos_S
    length, mass = l + key["R"], two * (key["m_t"] + key["m_s"]) + key["m_h"]
    R, l = key["R"] / length, l / length
    knee = Vector(-key["l_t"] * sin_T, -key["l_t"] * cos_T) / length
    thigh = Vector(-key["c_t"] * sin_T - key["w_t"] * cos_T, -key["c_t"] * cos_T + key["w_t"] * sin_T) / length
    shank = Vector(key["c_s"] * sin_S - key["w_s"] * cos_S, -key["c_s"] * cos_S - key["w_s"] * sin_S) / length
    if walker.massless_leg:
        # Only ratios of the swing leg's constants remain: a unit point at the foot.
        eps, m_t, m_s = zero, zero, one
    else:
        eps, m_t, m_s = one, key["m_t"] / mass, key["m_s"] / mass
    S_b, S_c = thigh * m_t + knee * m_s, shank * m_s
    C_bb = m_t * (thigh.dot(thigh) + (key["r_t"] / length) ** two) + m_s * knee.dot(knee)
    C_cc = m_s * (shank.dot(shank) + (key["r_s"] / length) ** two)
    # H = conj(knee) S_c.
    H = Vector(knee.dot(S_c), knee.x * S_c.y - knee.y * S_c.x)
    inertia = C_bb + C_cc + two * H.x
    leg_S = (S_b + S_c) * eps
    found = {"R": R, "l": l, "eps": eps * inertia, **_pair("S_a", leg_S + Vector(zero, l))}
    # Stance leg m|il + p|^2 + I, hip and swing leg (the rest of the unit mass) at |il|.
    found["C_aa"] = R * R + l * l + two * l * leg_S.y + eps * inertia
    if walker.knees:
        found |= {**_pair("S_b", S_b / inertia), "C_bb": C_bb / inertia, **_pair("S_c", S_c / inertia),
                  "C_cc": C_cc / inertia, **_pair("H", H / inertia)}
    else:
        found |= {**_pair("S_b", (S_b + S_c) / inertia), "C_bb": one}
    return found


@dataclass(frozen=True)
class Vector:
    """A vector of a leg, in any type of number."""

    x: Any
    y: Any

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y)

    def __mul__(self, factor: Any) -> Vector:
        return Vector(self.x * factor, self.y * factor)

    def __truediv__(self, divisor: Any) -> Vector:
        return Vector(self.x / divisor, self.y / divisor)

    def dot(self, other: Vector) -> Any:
        return self.x * other.x + self.y * other.y


def _sine(x: Any) -> Any:
    return math.sin(x) if isinstance(x, float) and type(x) is float else np.sin(np.array([x], dtype=type(x)))[0]


def _cosine(x: Any) -> Any:
    return math.cos(x) if isinstance(x, float) and type(x) is float else np.cos(np.array([x], dtype=type(x)))[0]


def _pair(name: str, v: Vector) -> dict[str, Any]:
    """A complex constant as `_re` and `_im`; a part that is rounding of zero becomes zero."""
    size = 4e-16 * max(abs(float(v.x)), abs(float(v.y)))
    return {f"{name}_{part}": x if abs(float(x)) > size else type(x)(0.0) for part, x in (("re", v.x), ("im", v.y))}


@dataclass(frozen=True)
class Structure:
    """Which constants a walker has at all; code is compiled once per structure, never per value."""

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
    """A walker's structure: constants that are 0 or 1 are part of a straight leg's code, all others are parameters."""
    constants = lump(walker)
    # Three links compile slowly and gain little from a zero: all kneed walkers share one structure.
    plain = () if walker.knees else (0.0, 1.0, -1.0)
    fixed = tuple((k, v) for k, v in constants.items() if v in plain)
    free = tuple(k for k, v in constants.items() if v not in plain)
    return Structure(walker.knees, walker.point_foot, free, fixed)


def constants_of(walker: Walker, structure: Structure) -> np.ndarray:
    """Values of the structure's runtime constants, shape (len(structure.constants),)."""
    lumped = lump(walker)
    return np.array([lumped[k] for k in structure.constants])


class Symbols:
    """The runtime parameters of a structure as heyoka symbols: `par[i]` for flows, variables for functions."""

    def __init__(self, structure: Structure, variables: bool = False):
        names = structure.parameters
        held = hy.make_vars(*(f"p_{n}" for n in names)) if variables else [hy.par[i] for i in range(len(names))]
        self.variables = list(held)
        values = dict(zip(names, held)) | {k: hy.expression(v) for k, v in structure.units}
        self.slope, self.scale = values["slope"], values["scale"]
        self.R, self.l, self.eps, self.C_aa = values["R"], values["l"], values["eps"], values["C_aa"]
        self.S_a = Complex(values["S_a_re"], values["S_a_im"])
        self.S_b = Complex(values["S_b_re"], values["S_b_im"])
        self.C_bb = values["C_bb"]
        if structure.kneed:
            self.S_c = Complex(values["S_c_re"], values["S_c_im"])
            self.C_cc, self.H = values["C_cc"], Complex(values["H_re"], values["H_im"])

    def locked(self) -> tuple[Complex, Sym]:
        """S and inertia of the whole swing leg with its knee locked."""
        if not hasattr(self, "S_c"):
            return self.S_b, self.C_bb
        return (Complex(self.S_b.re + self.S_c.re, self.S_b.im + self.S_c.im),
                self.C_bb + self.C_cc + 2.0 * self.H.re)


def rows(p: Symbols, q: list[Sym], rate: list[Sym], free_knee: bool) -> tuple[list[list[Sym]], list[Sym]]:
    """Mass matrix and force of the equations of motion, M q'' = f, in scaled coordinates.

    Parameters
    ----------
    p : Symbols
        The structure's parameters.
    q, rate : list of expression
        Scaled angles (stance, swing thigh[, swing shank]) and their rates.
    free_knee : bool
        Three links, or two with the knee locked.

    Notes
    -----
    Lagrange's equations of the energies in the module's docstring; the swing rows are divided by `eps`.
    """
    s = p.scale
    angle = [s * x for x in q]
    trig = [(hy.sin(x), hy.cos(x)) for x in angle]
    tilt = [(hy.sin(x - p.slope), hy.cos(x - p.slope)) for x in angle]

    def between(j: int, i: int) -> tuple[Sym, Sym]:
        return hy.sin(angle[j] - angle[i]), hy.cos(angle[j] - angle[i])

    swing = [(p.S_b, p.C_bb), (p.S_c, p.C_cc)] if free_knee else [p.locked()]
    n = 1 + len(swing)
    M = [[ZERO] * n for _ in range(n)]
    f = [ZERO] * n
    stance = p.S_a.turned(*trig[0])
    M[0][0] = p.C_aa + 2.0 * p.R * stance.im
    f[0] = -(s * p.R * stance.re) * rate[0] ** 2.0 - (p.R * hy.sin(p.slope) + p.S_a.turned(*tilt[0]).re) / s
    for j, (S, C) in enumerate(swing, start=1):
        # K e^{i(b-a)} with K = -i l S: its real part couples the rows, its imaginary part turns them.
        K = Complex(p.l * S.im, -p.l * S.re).turned(*between(j, 0))
        own = S.turned(*trig[j])
        couple = p.R * own.im + K.re
        M[0][j], M[j][0], M[j][j] = p.eps * couple, couple, C
        f[0] = f[0] - s * p.eps * (p.R * own.re - K.im) * rate[j] ** 2.0
        f[j] = -s * K.im * rate[0] ** 2.0 - S.turned(*tilt[j]).re / s
    if free_knee:
        knee = p.H.turned(*between(2, 1))
        M[1][2] = M[2][1] = knee.re
        f[1] = f[1] + s * knee.im * rate[2] ** 2.0
        f[2] = f[2] - s * knee.im * rate[1] ** 2.0
    return M, f


class Solver:
    """Solves M x = f in symbols for many right-hand sides, sharing the elimination."""

    def __init__(self, M: list[list[Sym]]):
        n = len(M)
        self.U = [list(row) for row in M]
        self.factors: list[tuple[int, int, Sym]] = []
        # The stance row goes last: with no foot mass its coupling vanishes and the elimination with it.
        for k in reversed(range(1, n)):
            for i in reversed(range(k)):
                factor = self.U[i][k] / self.U[k][k]
                self.factors.append((i, k, factor))
                for j in range(k):
                    self.U[i][j] = self.U[i][j] - factor * self.U[k][j]

    def __call__(self, f: list[Sym]) -> list[Sym]:
        f = list(f)
        for i, k, factor in self.factors:
            f[i] = f[i] - factor * f[k]
        x: list[Sym] = []
        for i in range(len(f)):
            x.append((f[i] - sum((self.U[i][j] * x[j] for j in range(i)), ZERO)) / self.U[i][i])
        return x


def system(structure: Structure, free_knee: bool, directions: int, with_slope: bool) -> list[tuple[Sym, Sym]]:
    """The flow's right-hand side: the motion and, beside it, its first-order variations.

    Parameters
    ----------
    structure : Structure
        Which constants exist.
    free_knee : bool
        Three links, or two.
    directions : int
        Number of variations of the initial state carried along.
    with_slope : bool
        True where the last of them is the derivative by the slope.

    Notes
    -----
    The variations are implicit: with r = M q'' - f, M dq'' = -(r_q dq + r_q' dq' + r_slope dslope), so the matrix is
    eliminated once for all directions.
    """
    p = Symbols(structure)
    n = 3 if free_knee else 2
    q = list(hy.make_vars(*(f"q{i}" for i in range(n))))
    rate = list(hy.make_vars(*(f"v{i}" for i in range(n))))
    held = list(hy.make_vars(*(f"w{i}" for i in range(n))))
    M, f = rows(p, q, rate, free_knee)
    solve = Solver(M)
    acceleration = solve(f)
    found = list(zip(q, rate)) + list(zip(rate, acceleration))
    if not directions:
        return found
    residual = [sum((M[i][j] * held[j] for j in range(n)), ZERO) - f[i] for i in range(n)]
    named = {f"w{i}": acceleration[i] for i in range(n)}

    def by(row: Sym, wrt: Sym) -> Sym:
        return hy.subs(hy.diff(row, wrt), named)

    by_q = [[by(r, x) for x in q] for r in residual]
    by_rate = [[by(r, x) for x in rate] for r in residual]
    for d in range(directions):
        dq = list(hy.make_vars(*(f"dq{i}_{d}" for i in range(n))))
        dv = list(hy.make_vars(*(f"dv{i}_{d}" for i in range(n))))
        forces = []
        for i in range(n):
            total = sum((by_q[i][j] * dq[j] + by_rate[i][j] * dv[j] for j in range(n)), ZERO)
            if with_slope and d == directions - 1:
                total = total + by(residual[i], p.slope)
            forces.append(-total)
        found += list(zip(dq, dv)) + list(zip(dv, solve(forces)))
    return found
