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

A spring, a damper and a motor between the thighs add the generalised force bias - k (b -
a) - c (b' - a') on the swing thigh, and its opposite on the stance leg.

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
        values = dict(zip(names, self.variables, strict=True))
        for name, unit in structure.units:
            values[name] = hy.expression(unit)

        def vector(name: str) -> Vector:
            return Vector(values[f"{name}_re"], values[f"{name}_im"])

        self.slope = values["slope"]
        self.scale = values["scale"]
        self.R = values["R"]
        self.l = values["l"]
        self.eps = values["eps"]
        self.S_a = vector("S_a")
        self.C_aa = values["C_aa"]
        self.S_b = vector("S_b")
        self.C_bb = values["C_bb"]
        if structure.kneed:
            self.S_c = vector("S_c")
            self.C_cc = values["C_cc"]
            self.H = vector("H")

        self._set_drive(structure, values)

    def _set_drive(self, structure: Structure, values: dict[str, Sym]) -> None:
        """Set the constants of what drives the walker beside gravity."""
        self.has_hip_torque = structure.has_hip_torque
        if structure.has_hip_torque:
            self.hip_stiffness = values["hip_stiffness"]
            self.hip_damping = values["hip_damping"]
            self.hip_bias = values["hip_bias"]

        self.pushes_off = structure.pushes_off
        if structure.pushes_off:
            self.push = values["push"]
        if "knee_re" in values:
            self.knee = Vector(values["knee_re"], values["knee_im"])

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
        x = self.hold(factor * constant.x)
        y = self.hold(factor * constant.y)
        return Vector(x, y).rotate(*trig)

    def locked(self) -> tuple[Vector, Sym]:
        """S and inertia of the whole swing leg with its knee locked."""
        if not hasattr(self, "S_c"):
            return self.S_b, self.C_bb
        return (self.S_b + self.S_c, self.C_bb + self.C_cc + 2.0 * self.H.x)


@dataclass(frozen=True)
class _Coupling:
    """How a swing link and the stance leg act on each other: Re K, the coupling k, and
    its derivatives p by the stance and n by the swing angle (`Motion`).
    """

    c: Sym
    k: Sym
    by_stance: Sym
    by_swing: Sym


@dataclass(frozen=True)
class _Factors:
    """What derivatives are multiplied by: eps, and the square of the scale, once by each
    angle.
    """

    eps: Sym
    square: Sym
    eps_square: Sym


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
        self.p = p
        self.q = q
        self.rate = rate
        self.square = [x**2.0 for x in rate]
        self.scale = p.hold(p.scale)
        self.tilt = [self._tilt(x) for x in q]
        # These rotate constants of angles measured from the ground's normal.
        self.slope_trig = hy.sin(p.slope), hy.cos(p.slope)

        swing = [p.locked()]
        if free_knee:
            swing = [(p.S_b, p.C_bb), (p.S_c, p.C_cc)]
        self.moments = [p.S_a]
        self.M = _zeros(len(q))
        self.f = [ZERO] * len(q)

        self._add_stance()
        self.couplings: list[_Coupling] = []
        for moment, inertia in swing:
            self._add_swing(moment, inertia)
        self._add_joints()
        self.last_pivot = p.hold(ONE / inertia)

    def _tilt(self, x: Sym) -> tuple[Sym, Sym]:
        """Sine and cosine of a scaled angle, taken from the vertical."""
        angle = self.scale * x - self.p.hold(self.p.slope)
        return hy.sin(angle), hy.cos(angle)

    def _add_joints(self) -> None:
        """Add the coupling of thigh and shank, and what acts between the thighs."""
        if len(self.q) == 3:
            self._add_knee()
        if self.p.has_hip_torque:
            self._add_hip_torque()

    def _add_stance(self) -> None:
        """The stance leg's own row."""
        p = self.p
        sine, _ = self.slope_trig
        # `hold` numbers what it is given: as the equations have been compiled before.
        self.eps = p.hold(p.eps)
        self.y, self.m = self._rolling(p.S_a, 0)
        self.M[0][0] = p.hold(p.C_aa) + 2.0 * self.y
        weight = p.rotate(p.S_a, ONE / p.scale, self.tilt[0]).x
        rolling_down = p.hold(p.R * sine / p.scale)
        centrifugal = self.m * self.square[0]
        self.f[0] = -centrifugal - weight - rolling_down

    def _add_swing(self, S: Vector, C: Sym) -> None:
        """The row of the next swing link, of first moment S and inertia C, and its
        coupling to the stance leg.
        """
        p = self.p
        self.moments.append(S)
        j = len(self.couplings) + 1
        link = self._coupling(S, j)
        self.couplings.append(link)

        self.M[0][j] = self.eps * link.k
        self.M[j][0] = link.k
        self.M[j][j] = p.hold(C)

        on_stance = link.by_swing * self.square[j]
        on_swing = link.by_stance * self.square[0]
        weight = p.rotate(S, ONE / p.scale, self.tilt[j]).x
        self.f[0] = self.f[0] - self.eps * on_stance
        self.f[j] = -on_swing - weight

    def _coupling(self, S: Vector, j: int) -> _Coupling:
        """The coupling of the stance leg and swing link j, of first moment S."""
        p = self.p
        trig = self._between(0, j)
        K = Vector(p.l * S.y, -p.l * S.x)
        roll, roll_by_swing = self._rolling(S, j)
        c = p.rotate(K, ONE, trig).x
        by_stance = p.rotate(K, p.scale, trig).y
        return _Coupling(
            c=c,
            k=c + roll,
            by_stance=by_stance,
            by_swing=roll_by_swing - by_stance,
        )

    def _add_knee(self) -> None:
        """The coupling of thigh and shank."""
        p = self.p
        trig = self._between(1, 2)
        self.h = p.rotate(p.H, ONE, trig).x
        self.h_by = p.rotate(p.H, p.scale, trig).y
        self.M[1][2] = self.h
        self.M[2][1] = self.h
        on_thigh = self.h_by * self.square[2]
        on_shank = self.h_by * self.square[1]
        self.f[1] = self.f[1] + on_thigh
        self.f[2] = self.f[2] - on_shank

    def _add_hip_torque(self) -> None:
        """The torque of spring, damper and motor on the swing thigh, and against it on
        the stance leg.
        """
        p = self.p
        self.stiffness = p.hold(p.hip_stiffness)
        self.damping = p.hold(p.hip_damping)
        bias = p.hold(p.hip_bias / p.scale)
        opening = self.q[1] - self.q[0]
        opening_rate = self.rate[1] - self.rate[0]
        of_spring = self.stiffness * opening
        of_damper = self.damping * opening_rate
        torque = bias - of_spring - of_damper
        self.f[0] = self.f[0] - self.eps * torque
        self.f[1] = self.f[1] + torque

    def _rolling(self, S: Vector, j: int) -> tuple[Sym, Sym]:
        """R Im(S e^{iq}) and s R Re(S e^{iq}), with q from the ground's normal."""
        p = self.p
        normal = S.rotate(*self.slope_trig)
        y = p.rotate(normal, p.R, self.tilt[j]).y
        x = p.rotate(normal, p.scale * p.R, self.tilt[j]).x
        return y, x

    def _between(self, i: int, j: int) -> tuple[Sym, Sym]:
        """Sine and cosine of the angle from one link to another; a flow has them
        cheaper than their products.
        """
        if self.p.held_values is not None:
            angle = self.scale * (self.q[j] - self.q[i])
            return hy.sin(angle), hy.cos(angle)

        sine_i, cosine_i = self.tilt[i]
        sine_j, cosine_j = self.tilt[j]
        sine = sine_j * cosine_i - cosine_j * sine_i
        cosine = cosine_j * cosine_i + sine_j * sine_i
        return sine, cosine

    def differentiate(self, u: list[Sym]) -> tuple[list[list[Sym]], list[list[Sym]]]:
        """Derivatives of the residual M u - f at the accelerations u, by the angles and
        by the rates.
        """
        p = self.p
        factors = _Factors(
            eps=p.hold(p.eps),
            square=p.hold(p.scale * p.scale),
            eps_square=p.hold(p.eps * p.scale * p.scale),
        )
        weights = self._weights(ONE)
        by_q = _zeros(len(u))
        by_rate = _zeros(len(u))

        self._differentiate_stance(factors, weights[0], u, by_q[0], by_rate[0])
        for j in range(1, len(u)):
            self._differentiate_swing(j, factors, weights[j], u[0], by_q[j], by_rate[j])
        self._differentiate_joints(u, by_q, by_rate)
        return by_q, by_rate

    def _differentiate_stance(
        self,
        factors: _Factors,
        weight: Sym,
        u: list[Sym],
        by_q: list[Sym],
        by_rate: list[Sym],
    ) -> None:
        """Set the derivatives of the stance leg's own row."""
        leaning = 2.0 * (self.m * u[0])
        lifted = self.y * self.square[0]
        by_q[0] = leaning - factors.square * lifted - weight
        by_rate[0] = self.m * (2.0 * self.rate[0])

        for j, link in enumerate(self.couplings, start=1):
            by_stance = link.by_stance * u[j]
            by_swing = link.by_swing * u[j]
            turned_by_stance = link.c * self.square[j]
            turned_by_swing = link.k * self.square[j]
            faster = link.by_swing * (2.0 * self.rate[j])

            by_q[0] = by_q[0] + factors.eps * by_stance
            by_q[0] = by_q[0] + factors.eps_square * turned_by_stance
            by_q[j] = factors.eps * by_swing - factors.eps_square * turned_by_swing
            by_rate[j] = factors.eps * faster

    def _differentiate_swing(
        self,
        j: int,
        factors: _Factors,
        weight: Sym,
        stance: Sym,
        by_q: list[Sym],
        by_rate: list[Sym],
    ) -> None:
        """Set the derivatives of the row of swing link j, at an acceleration of the stance
        leg.
        """
        link = self.couplings[j - 1]
        lag = factors.square * (link.c * self.square[0])
        by_q[0] = link.by_stance * stance - lag
        by_q[j] = link.by_swing * stance + lag - weight
        by_rate[0] = link.by_stance * (2.0 * self.rate[0])

    def _differentiate_joints(
        self, u: list[Sym], by_q: list[list[Sym]], by_rate: list[list[Sym]]
    ) -> None:
        """Add the derivatives of the knee's coupling and of the hip's torque."""
        if len(u) == 3:
            self._differentiate_knee(u, by_q, by_rate)
        if self.p.has_hip_torque:
            self._differentiate_hip_torque(by_q, by_rate)

    def _weights(self, factor: Sym) -> list[Sym]:
        """Im(S e^{i(q - slope)}) of every link, times a factor."""
        links = zip(self.moments, self.tilt, strict=True)
        return [self.p.rotate(S, factor, tilt).y for S, tilt in links]

    def _differentiate_knee(
        self, u: list[Sym], by_q: list[list[Sym]], by_rate: list[list[Sym]]
    ) -> None:
        """Add the derivatives of the coupling of thigh and shank."""
        s2 = self.p.hold(self.p.scale * self.p.scale)
        for j, other, sign in ((1, 2, 1.0), (2, 1, -1.0)):
            turned = s2 * (self.h * self.square[other])
            bend = self.h_by * u[other] + sign * turned
            faster = self.h_by * (2.0 * self.rate[other])

            by_q[j][1] = by_q[j][1] + bend
            by_q[j][2] = by_q[j][2] - bend
            by_rate[j][other] = -sign * faster

    def _differentiate_hip_torque(
        self, by_q: list[list[Sym]], by_rate: list[list[Sym]]
    ) -> None:
        """Add the derivatives of the torque between the thighs."""
        for matrix, factor in ((by_q, self.stiffness), (by_rate, self.damping)):
            on_stance = self.eps * factor
            matrix[0][0] = matrix[0][0] + on_stance
            matrix[0][1] = matrix[0][1] - on_stance
            matrix[1][0] = matrix[1][0] - factor
            matrix[1][1] = matrix[1][1] + factor

    def by_drive(self, drive: str) -> list[Sym]:
        """Derivatives of the residual by what drives the motion."""
        if drive == "hip_torque":
            return self.by_hip_torque()
        return self.by_slope()

    def by_hip_torque(self) -> list[Sym]:
        """Derivatives of the residual by the constant torque between the thighs."""
        p = self.p
        on_swing = p.hold(-ONE / p.scale)
        on_stance = p.hold(p.eps / p.scale)
        return [on_stance, on_swing, *[ZERO] * (len(self.q) - 2)]

    def by_slope(self) -> list[Sym]:
        """Derivatives of the residual by the slope."""
        p = self.p
        stance, *swing = self._weights(ONE / p.scale)
        rolling = p.hold(p.R * hy.cos(p.slope) / p.scale)
        return [stance + rolling, *swing]


def _zeros(n: int) -> list[list[Sym]]:
    return [[ZERO] * n for _ in range(n)]


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
            pivot_row = self.U[k]
            pivot = ONE / pivot_row[k]
            if last is not None and k == n - 1:
                pivot = last
            self.pivots[k] = pivot

            for i in reversed(range(k)):
                row = self.U[i]
                factor = row[k] * pivot
                self.factors.append((i, k, factor))
                for j in range(k):
                    row[j] = row[j] - factor * pivot_row[j]

    def __call__(self, f: list[Sym]) -> list[Sym]:
        """Solution x of M x = f."""
        f = list(f)
        for i, k, factor in self.factors:
            f[i] = f[i] - factor * f[k]

        x: list[Sym] = []
        for row, pivot, value in zip(self.U, self.pivots, f, strict=True):
            others = ZERO
            for coefficient, known in zip(row, x, strict=False):
                others = others + coefficient * known
            x.append((value - others) * pivot)

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
    structure: Structure,
    free_knee: bool,
    directions: int,
    with_slope: bool,
    dissipates: bool = False,
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
        True where the last of them is the derivative by the slope, or by the torque
        between the thighs where that is the structure's drive.
    dissipates : bool
        Also integrate the square of the rate at which the thighs open, to which the
        power of a damper between them is proportional.

    Returns
    -------
    System
        States are angles, then rates, then the same of each variation; what dissipates
        comes last.

    Notes
    -----
    The variations are implicit: with r = M q'' - f, M dq'' = -(r_q dq + r_q' dq' + r_slope dslope), so the matrix is
    eliminated once for all directions.
    """
    p = Symbols(structure, flow=True)
    n = 3 if free_knee else 2
    q = _variables("q{}", n)
    rate = _variables("v{}", n)
    motion = Motion(p, q, rate, free_knee)
    solve = Solver(motion.M, motion.last_pivot)
    acceleration = solve(motion.f)
    equations = list(zip(q, rate, strict=True))
    equations += zip(rate, acceleration, strict=True)

    if directions:
        by_q, by_rate = motion.differentiate(acceleration)
    for d in range(directions):
        dq = _variables(f"dq{{}}_{d}", n)
        dv = _variables(f"dv{{}}_{d}", n)
        change = _product(by_q, dq, by_rate, dv)
        if with_slope and d == directions - 1:
            by_drive = motion.by_drive(structure.drive)
            change = [a + b for a, b in zip(change, by_drive, strict=True)]

        variation = solve([-x for x in change])
        equations += zip(dq, dv, strict=True)
        equations += zip(dv, variation, strict=True)

    if dissipates:
        equations.append(_dissipated(rate))
    return System(equations, p.held_values or [], p.variables)


def _dissipated(rate: list[Sym]) -> tuple[Sym, Sym]:
    """The equation of what a damper of unit damping between the thighs dissipates."""
    opening_rate = rate[1] - rate[0]
    return hy.make_vars("w"), opening_rate**2.0


def _variables(name: str, n: int) -> list[Sym]:
    """Variables of so many links, whose numbers their name takes."""
    return list(hy.make_vars(*(name.format(i) for i in range(n))))


def _product(
    A: list[list[Sym]], x: list[Sym], B: list[list[Sym]], y: list[Sym]
) -> list[Sym]:
    """A x + B y."""
    both = []
    for a, b in zip(A, B, strict=True):
        value = ZERO
        for j, (of_x, of_y) in enumerate(zip(a, b, strict=True)):
            value = value + (of_x * x[j] + of_y * y[j])
        both.append(value)

    return both
