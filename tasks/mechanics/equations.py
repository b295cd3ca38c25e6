"""Equations of motion with lumped constants, as symbols, for two links (knees locked)
and three.

Frame and angles are those of docs/physics.md: x down the slope, y along the ground
normal, angles counter-clockwise from the normal; a vector of a leg is a complex number
x + iy in the frame of that leg, rotated by exp(i angle). Unit of length is the leg l +
R, of mass the whole walker, and g = 1.

With the lumped constants of `tasks.mechanics.lumped` the kinetic and potential energies
are

    T = 1/2 (C_aa + 2 R Im(e^{ia} S_a)) a'^2 + (R Im(e^{ib} S_b) - l Re(i S_b
    e^{i(b-a)})) a' b' + 1/2 C_bb b'^2 + ... V = R a sin(slope) + Im(e^{i(a-slope)} S_a)
    + Im(e^{i(b-slope)} S_b) + ...

Rows of the swing links are divided by the leg's inertia `eps`, so the limit of a
vanishing foot mass is exact. States are scaled, q = s x with s a power of two, so an
absolute tolerance is a relative one on any slope. Expressions of parameters alone are
held: computed once an integration, not at each of its Taylor steps. So the equations
rotate constants that are already multiplied out, and angles are taken from the
vertical, where gravity needs one term.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import heyoka as hy

from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.mechanics.vector import Vector

#: A symbolic expression; heyoka's are compiled types without annotations.
Sym: TypeAlias = Any
ZERO, ONE = hy.expression(0.0), hy.expression(1.0)


class Symbols:
    """The runtime parameters of a structure as symbols, in compiled functions and in
    flows.

    A flow uses them only through `hold`, which makes any expression of them one of the
    flow's own parameters; `held_values` are these expressions in their order.
    """

    def __init__(self, structure: Structure, flow: bool = False):
        names = structure.parameters
        self.variables = list(hy.make_vars(*(f"p_{n}" for n in names)))
        self.held_values: list[Sym] | None = [] if flow else None
        values = dict(zip(names, self.variables, strict=True)) | {
            k: hy.expression(v) for k, v in structure.units
        }
        self.slope, self.scale = values["slope"], values["scale"]
        self.R, self.l, self.eps, self.C_aa = (
            values["R"],
            values["l"],
            values["eps"],
            values["C_aa"],
        )
        self.S_a = Vector(values["S_a_re"], values["S_a_im"])
        self.S_b = Vector(values["S_b_re"], values["S_b_im"])
        self.C_bb = values["C_bb"]
        if structure.kneed:
            self.S_c = Vector(values["S_c_re"], values["S_c_im"])
            self.C_cc, self.H = values["C_cc"], Vector(values["H_re"], values["H_im"])

    def hold(self, value: Sym) -> Sym:
        """An expression of parameters alone, as the flow's own parameter where this is
        a flow.
        """
        if self.held_values is None or not hy.get_variables(value):
            return value
        if value not in self.held_values:
            self.held_values.append(value)
        return hy.par[self.held_values.index(value)]

    def rotate(self, constant: Vector, factor: Sym, trig: tuple[Sym, Sym]) -> Vector:
        """Product of a factor, a constant and e^{i angle}, the angle given by its sine
        and cosine.
        """
        return Vector(
            self.hold(factor * constant.x), self.hold(factor * constant.y)
        ).rotate(*trig)

    def locked(self) -> tuple[Vector, Sym]:
        """S and inertia of the whole swing leg with its knee locked."""
        if not hasattr(self, "S_c"):
            return self.S_b, self.C_bb
        return (self.S_b + self.S_c, self.C_bb + self.C_cc + 2.0 * self.H.x)


class Motion:
    """Equations of motion M q'' = f in scaled coordinates, and their first variations.

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
    Lagrange's equations of the energies in the module's docstring; the swing rows are divided by `eps`. With
    K = -i l S e^{i(b-a)}, the coupling of stance and swing link is k = R Im(S e^{ib}) +
    Re K, and by the stance and the swing angle its derivatives are p = s Im K and n = s
    R Re(S e^{ib}) - p, which makes the residual M q'' - f

        stance   (C_aa + 2 y) a'' + m a'^2 + g_0/s + eps sum(k b'' + n b'^2),   y + i m/s = R (Im + i Re)(S_a e^{ia})
        swing    C b'' + k a'' + p a'^2 + g/s [+- knee],                         g = Re(S e^{i(b - slope)}).
    """

    def __init__(self, p: Symbols, q: list[Sym], rate: list[Sym], free_knee: bool):
        self.p, self.rate, self.square = p, rate, [x**2.0 for x in rate]
        s, hold = p.scale, p.hold
        scale = hold(s)
        angle = [scale * x for x in q]
        tilt = [(hy.sin(x), hy.cos(x)) for x in (x - hold(p.slope) for x in angle)]
        # These rotate constants of angles measured from the ground's normal.
        sine, cosine = hy.sin(p.slope), hy.cos(p.slope)
        swing = [(p.S_b, p.C_bb), (p.S_c, p.C_cc)] if free_knee else [p.locked()]
        n = 1 + len(swing)
        self.M = [[ZERO] * n for _ in range(n)]
        self.f = [ZERO] * n
        square, eps = self.square, hold(p.eps)
        self.weighted = list(zip([p.S_a, *(S for S, _ in swing)], tilt, strict=True))

        def rolling(S: Vector, j: int) -> tuple[Sym, Sym]:
            """R Im(S e^{iq}) and s R Re(S e^{iq}), with q from the ground's normal."""
            normal = S.rotate(sine, cosine)
            return p.rotate(normal, p.R, tilt[j]).y, p.rotate(
                normal, s * p.R, tilt[j]
            ).x

        def between(i: int, j: int) -> tuple[Sym, Sym]:
            """Sine and cosine of the angle from one link to another; a flow has them
            cheaper than their products.
            """
            if p.held_values is not None:
                angle = scale * (q[j] - q[i])
                return hy.sin(angle), hy.cos(angle)
            (si, ci), (sj, cj) = tilt[i], tilt[j]
            return sj * ci - cj * si, cj * ci + sj * si

        self.y, self.m = rolling(p.S_a, 0)
        self.M[0][0] = hold(p.C_aa) + 2.0 * self.y
        self.f[0] = (
            -(self.m * square[0])
            - p.rotate(p.S_a, ONE / s, tilt[0]).x
            - hold(p.R * sine / s)
        )
        #: An entry for each swing link, from 1.
        self.c, self.k, self.by_stance, self.by_swing = [ZERO], [ZERO], [ZERO], [ZERO]
        for j, (S, C) in enumerate(swing, start=1):
            trig = between(0, j)
            K = Vector(p.l * S.y, -p.l * S.x)
            roll, roll_by = rolling(S, j)
            c, by_stance = p.rotate(K, ONE, trig).x, p.rotate(K, s, trig).y
            k, by_swing = c + roll, roll_by - by_stance
            self.c.append(c)
            self.k.append(k)
            self.by_stance.append(by_stance)
            self.by_swing.append(by_swing)
            self.M[0][j], self.M[j][0], self.M[j][j] = eps * k, k, hold(C)
            self.f[0] = self.f[0] - eps * (by_swing * square[j])
            self.f[j] = -(by_stance * square[0]) - p.rotate(S, ONE / s, tilt[j]).x
        if free_knee:
            trig = between(1, 2)
            self.h, self.h_by = p.rotate(p.H, ONE, trig).x, p.rotate(p.H, s, trig).y
            self.M[1][2] = self.M[2][1] = self.h
            self.f[1] = self.f[1] + self.h_by * square[2]
            self.f[2] = self.f[2] - self.h_by * square[1]
        self.last_pivot = hold(ONE / swing[-1][1])

    def differentiate(self, u: list[Sym]) -> tuple[list[list[Sym]], list[list[Sym]]]:
        """Derivatives of the residual M u - f at the accelerations u, by the angles and
        by the rates.
        """
        p, s, n = self.p, self.p.scale, len(u)
        eps, s2, eps_s2 = (p.hold(x) for x in (p.eps, s * s, p.eps * s * s))
        twice = [2.0 * x for x in self.rate]
        falling = [p.rotate(S, ONE, trig).y for S, trig in self.weighted]
        by_q = [[ZERO] * n for _ in range(n)]
        by_rate = [[ZERO] * n for _ in range(n)]
        by_q[0][0] = 2.0 * (self.m * u[0]) - s2 * (self.y * self.square[0]) - falling[0]
        by_rate[0][0] = self.m * twice[0]
        for j in range(1, n):
            lag = s2 * (self.c[j] * self.square[0])
            by_q[0][0] = (
                by_q[0][0]
                + eps * (self.by_stance[j] * u[j])
                + eps_s2 * (self.c[j] * self.square[j])
            )
            by_q[0][j] = eps * (self.by_swing[j] * u[j]) - eps_s2 * (
                self.k[j] * self.square[j]
            )
            by_rate[0][j] = eps * (self.by_swing[j] * twice[j])
            by_q[j][0] = self.by_stance[j] * u[0] - lag
            by_q[j][j] = self.by_swing[j] * u[0] + lag - falling[j]
            by_rate[j][0] = self.by_stance[j] * twice[0]
        if n == 3:
            for j, other, sign in ((1, 2, 1.0), (2, 1, -1.0)):
                bend = self.h_by * u[other] + sign * (
                    p.hold(s * s) * (self.h * self.square[other])
                )
                by_q[j][1], by_q[j][2] = by_q[j][1] + bend, by_q[j][2] - bend
                by_rate[j][other] = -sign * (self.h_by * twice[other])
        return by_q, by_rate

    def by_slope(self) -> list[Sym]:
        """Derivatives of the residual by the slope."""
        p = self.p
        stance, *swing = (
            p.rotate(S, ONE / p.scale, trig).y for S, trig in self.weighted
        )
        return [stance + p.hold(p.R * hy.cos(p.slope) / p.scale), *swing]


def rows(
    p: Symbols, q: list[Sym], rate: list[Sym], free_knee: bool
) -> tuple[list[list[Sym]], list[Sym]]:
    """Mass matrix M and force f of the equations of motion M q'' = f, as `Motion` has
    them.
    """
    motion = Motion(p, q, rate, free_knee)
    return motion.M, motion.f


class Solver:
    """Gaussian elimination of M x = f in symbols, shared by all right-hand sides;
    `last` is 1/M[-1][-1] if known.
    """

    def __init__(self, M: list[list[Sym]], last: Sym | None = None):
        n = len(M)
        self.U = [list(row) for row in M]
        self.factors: list[tuple[int, int, Sym]] = []
        self.pivots = [ZERO] * n
        # The stance row is eliminated last: without a foot mass its coupling vanishes,
        # and the elimination with it.
        for k in reversed(range(n)):
            self.pivots[k] = (
                last if last is not None and k == n - 1 else ONE / self.U[k][k]
            )
            for i in reversed(range(k)):
                factor = self.U[i][k] * self.pivots[k]
                self.factors.append((i, k, factor))
                for j in range(k):
                    self.U[i][j] = self.U[i][j] - factor * self.U[k][j]

    def __call__(self, f: list[Sym]) -> list[Sym]:
        """Solution x of M x = f."""
        f = list(f)
        for i, k, factor in self.factors:
            f[i] = f[i] - factor * f[k]
        x: list[Sym] = []
        for i in range(len(f)):
            x.append(
                (f[i] - sum((self.U[i][j] * x[j] for j in range(i)), ZERO))
                * self.pivots[i]
            )
        return x


@dataclass(frozen=True)
class System:
    """A flow's differential equations, and its parameters as expressions `held` of the
    structure's (`variables`).
    """

    equations: list[tuple[Sym, Sym]]
    held: list[Sym]
    variables: list[Sym]

    def parameters(self, **options: Any) -> Any:
        """The compiled function from the structure's parameters to the flow's."""
        return hy.cfunc(self.held, vars=self.variables, **options)


def system(
    structure: Structure, free_knee: bool, directions: int, with_slope: bool
) -> System:
    """The flow's right-hand side: the motion and, beside it, its first-order
    variations.

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

    Returns
    -------
    System
        States are angles, then rates, then the same of each variation.

    Notes
    -----
    The variations are implicit: with r = M q'' - f, M dq'' = -(r_q dq + r_q' dq' + r_slope dslope), so the matrix is
    eliminated once for all directions.
    """
    p = Symbols(structure, flow=True)
    n = 3 if free_knee else 2
    q = list(hy.make_vars(*(f"q{i}" for i in range(n))))
    rate = list(hy.make_vars(*(f"v{i}" for i in range(n))))
    motion = Motion(p, q, rate, free_knee)
    solve = Solver(motion.M, motion.last_pivot)
    acceleration = solve(motion.f)
    equations = [*zip(q, rate, strict=True), *zip(rate, acceleration, strict=True)]
    if directions:
        by_q, by_rate = motion.differentiate(acceleration)
    for d in range(directions):
        dq = list(hy.make_vars(*(f"dq{i}_{d}" for i in range(n))))
        dv = list(hy.make_vars(*(f"dv{i}_{d}" for i in range(n))))
        forces = []
        for i in range(n):
            total = sum(
                (by_q[i][j] * dq[j] + by_rate[i][j] * dv[j] for j in range(n)), ZERO
            )
            if with_slope and d == directions - 1:
                total = total + motion.by_slope()[i]
            forces.append(-total)
        equations += [*zip(dq, dv, strict=True), *zip(dv, solve(forces), strict=True)]
    return System(equations, p.held_values or [], p.variables)
