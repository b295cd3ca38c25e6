"""Taylor coefficients of the motion between strikes, and of its derivatives by the
start, in balls.

With q the angles of stance leg and swing links, w their rates and a their
accelerations, Lagrange's equations read r(q, w, a) = M(q) a - f(q, w) = 0. Every
coefficient follows from those before it; a itself is a further unknown series, so that
only M's leading coefficient is inverted. Coefficients of balls hold those of every
motion starting in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import mul
from typing import TypeVar

from flint import arb, arb_mat

from gaitsweep.tasks.proofs.body import Body, Vector

Series = list[arb]


def product(u: Series, v: Series, k: int) -> arb:
    """Coefficient k of the product of two series.

    Parameters
    ----------
    u, v : list of arb
        At least k + 1 coefficients.
    k : int

    Returns
    -------
    arb
    """
    return sum(map(mul, u[: k + 1], v[k::-1]), _ZERO)


_ZERO = arb(0)


class _Turning:
    """cos and sin of an angle, grown from the series of the angle's rate."""

    def __init__(self, angle: arb, rate: Series):
        sin, cos = angle.sin_cos()
        self.cos, self.sin, self.rate = [cos], [sin], rate

    def grow(self, k: int) -> None:
        """Append coefficient k."""
        cos, sin = self.cos, self.sin
        cos.append(-product(self.rate, sin, k - 1) / k)
        sin.append(product(self.rate, cos, k - 1) / k)

    def turned(self, v: Vector, k: int) -> tuple[arb, arb]:
        """Coefficient k of a turned vector."""
        cos, sin = self.cos[k], self.sin[k]
        return v.x * cos - v.y * sin, v.x * sin + v.y * cos


class Motion:
    """Series of one motion with the knee free (three angles) or locked (two).

    Parameters
    ----------
    body : Body
    slope : arb [rad]
    state : sequence of arb
        Angles, then rates at the start.
    order : int
        Coefficients of the accelerations to begin with.

    Attributes
    ----------
    q, w, a : list of series
        Angles, rates and accelerations; `grow` appends to them.
    """

    def __init__(self, body: Body, slope: arb, state: Sequence[arb], order: int = 0):
        self.body, self.n = body, len(state) // 2
        self.slope, self.state = slope, list(state)
        q, w = state[: self.n], state[self.n :]
        self.q: list[Series] = [[x] for x in q]
        self.w: list[Series] = [[x] for x in w]
        self.a: list[Series] = [[] for _ in q]
        self.links = [body.leg] if self.n == 2 else [body.thigh, body.shank]
        sin, cos = slope.sin_cos()
        pull = (
            Vector(cos, -sin) * body.g
        )  # turns a first moment into its weight's moment
        self.stance_weight = body.stance_first.turned(pull.x, pull.y)
        self.weights = [first.turned(pull.x, pull.y) for first, _ in self.links]
        self.rolling, self.sinking = (
            body.g * body.mass * body.R * sin,
            body.g * body.mass * body.R * cos,
        )
        self.turning = [_Turning(q[i], self.w[i]) for i in range(self.n)]
        self.lag = [[w[i] - w[0]] for i in range(1, self.n)]
        self.relative = [
            _Turning(q[i] - q[0], self.lag[i - 1]) for i in range(1, self.n)
        ]
        if self.n == 3:
            self.flexing = [w[2] - w[1]]
            self.bent = _Turning(q[2] - q[1], self.flexing)
        self.squares: list[Series] = [[] for _ in q]
        self.stance: list[
            tuple[arb, arb]
        ] = []  # R times the stance leg's turned first moment
        self.weight: list[
            list[tuple[arb, arb]]
        ] = []  # of each link: moment of its weight, (cos, sin) parts
        # Rows over the links: l e^(i (q_j - q_0)) S_j, and the same plus R e^(i q_j)
        # S_j.
        self.hinge: list[tuple[Series, Series]] = [([], []) for _ in self.links]
        self.whole: list[tuple[Series, Series]] = [([], []) for _ in self.links]
        self.joint: tuple[Series, Series] = ([], [])
        self.mass_00: Series = []
        self.inverse = arb_mat(0, 0)
        for _ in range(order):
            self.grow()

    @property
    def series(self) -> list[Series]:
        """Series of the state."""
        return [*self.q, *self.w]

    def grow(self) -> None:
        """Append one coefficient of the accelerations, and of rates and angles after
        them.
        """
        k = len(self.a[0])
        if k:
            for t in (
                *self.turning,
                *self.relative,
                *([self.bent] if self.n == 3 else []),
            ):
                t.grow(k)
        for i, w in enumerate(self.w):
            self.squares[i].append(product(w, w, k))
        self._geometry(k)
        force = self._force(k)
        for i in range(self.n):
            for j in range(self.n):
                M = self.mass(i, j)
                if M is not None and k:
                    force[i] -= sum(
                        map(mul, M[1 : k + 1], self.a[j][k - 1 :: -1]), _ZERO
                    )
        if not k:
            self.inverse = arb_mat(
                [[self._leading(i, j) for j in range(self.n)] for i in range(self.n)]
            ).inv()
        a = (self.inverse * arb_mat(self.n, 1, force)).entries()
        for i in range(self.n):
            self.a[i].append(a[i])
            self.q[i].append(self.w[i][k] / (k + 1))
            self.w[i].append(a[i] / (k + 1))
        for i in range(1, self.n):
            self.lag[i - 1].append(self.w[i][k + 1] - self.w[0][k + 1])
        if self.n == 3:
            self.flexing.append(self.w[2][k + 1] - self.w[1][k + 1])

    def _geometry(self, k: int) -> None:
        body = self.body
        x, y = self.turning[0].turned(body.stance_first, k)
        self.stance.append((body.R * x, body.R * y))
        self.mass_00.append(2 * body.R * y + (body.stance_second if k == 0 else 0))
        for j, (first, _) in enumerate(self.links):
            x, y = self.relative[j].turned(first, k)
            hinge_x, hinge_y = body.l * x, body.l * y
            x, y = self.turning[j + 1].turned(first, k)
            for series, value in zip(
                (*self.hinge[j], *self.whole[j]),
                (hinge_x, hinge_y, hinge_x + body.R * x, hinge_y + body.R * y),
                strict=True,
            ):
                series.append(value)
        if self.n == 3:
            for series, value in zip(
                self.joint, self.bent.turned(body.coupling, k), strict=True
            ):
                series.append(value)

    def _force(self, k: int) -> list[arb]:
        """Coefficient k of f, the forces at vanishing acceleration."""
        squares = self.squares
        self.weight.append(
            [
                t.turned(s, k)
                for t, s in zip(
                    self.turning, (self.stance_weight, *self.weights), strict=True
                )
            ]
        )
        weight = self.weight[k]
        stance = -weight[0][0] - (self.rolling if k == 0 else 0)
        if self._rolls:
            stance -= product([x for x, _ in self.stance], squares[0], k)
        force = [stance]
        for j in range(self.n - 1):
            if self.body.heavy:
                force[0] -= product(self.whole[j][0], squares[j + 1], k)
            force.append(product(self.hinge[j][0], squares[0], k) - weight[j + 1][0])
        if self.n == 3:
            force[1] += product(self.joint[1], squares[2], k)
            force[2] -= product(self.joint[1], squares[1], k)
        return force

    @property
    def _rolls(self) -> bool:
        return self.body.R != 0

    def mass(self, i: int, j: int) -> Series | None:
        """Series of an entry of the mass matrix; None where it is constant."""
        if i == j:
            return self.mass_00 if i == 0 and self._rolls else None
        if i and j:
            return self.joint[0]
        return None if i == 0 and not self.body.heavy else self.whole[max(i, j) - 1][1]

    def _leading(self, i: int, j: int) -> arb:
        M = self.mass(i, j)
        if M is not None:
            return M[0]
        if i != j:
            return _ZERO
        return self.mass_00[0] if i == 0 else self.links[i - 1][1]

    def partials(self, k: int, slope: bool) -> list[list[arb]]:
        """Coefficient k of the derivatives of r by (q, w[, slope]); rows are the
        equations.
        """
        n, body, squares, a = self.n, self.body, self.squares, self.a
        by_q = [[_ZERO] * n for _ in range(n)]
        by_w = [[_ZERO] * n for _ in range(n)]
        weight = self.weight[k]
        by_q[0][0] = -weight[0][1]
        if self._rolls:
            x, y = [s[0] for s in self.stance], [s[1] for s in self.stance]
            by_q[0][0] += 2 * product(x, a[0], k) - product(y, squares[0], k)
            by_w[0][0] = 2 * product(x, self.w[0], k)
        for j in range(1, n):
            hinge_x, hinge_y = self.hinge[j - 1]
            whole_x, whole_y = self.whole[j - 1]
            if body.heavy:
                by_q[0][0] += product(hinge_y, squares[j], k) - product(
                    hinge_x, a[j], k
                )
                by_q[0][j] = product(whole_x, a[j], k) - product(whole_y, squares[j], k)
                by_w[0][j] = 2 * product(whole_x, self.w[j], k)
            turn = product(hinge_y, squares[0], k)
            by_q[j][0] = -product(hinge_x, a[0], k) - turn
            by_q[j][j] = product(whole_x, a[0], k) - weight[j][1] + turn
            by_w[j][0] = -2 * product(hinge_x, self.w[0], k)
        if n == 3:
            x, y = self.joint
            thigh = product(y, a[2], k) + product(x, squares[2], k)
            shank = product(y, a[1], k) - product(x, squares[1], k)
            by_q[1][1] += thigh
            by_q[1][2] -= thigh
            by_q[2][1] += shank
            by_q[2][2] -= shank
            by_w[1][2] = -2 * product(y, self.w[2], k)
            by_w[2][1] = 2 * product(y, self.w[1], k)
        rows = [[*q, *w] for q, w in zip(by_q, by_w, strict=True)]
        if slope:
            for i, row in enumerate(rows):
                row.append(weight[i][1] + (self.sinking if i == 0 and k == 0 else 0))
        return rows


class Variation:
    """Derivatives of a motion by parameters of its start, grown beside it.

    Parameters
    ----------
    motion : Motion
    start : arb_mat, shape (2 n, d)
        Derivatives of (q, w) at the start.
    by_slope : arb_mat, shape (1, d), optional
        Derivatives of the slope itself.
    order : int
        Coefficients beyond the first to begin with, no more than those of the motion.

    Attributes
    ----------
    terms : list of arb_mat, shape (2 n, d)
    """

    def __init__(
        self,
        motion: Motion,
        start: arb_mat,
        by_slope: arb_mat | None = None,
        order: int = 0,
    ):
        self.motion, self.terms, self.by_slope = motion, [start], by_slope
        self.rows: list[arb_mat] = []
        self.masses: list[arb_mat] = []
        self.accelerations: list[arb_mat] = []
        self.columns = start.ncols()
        for _ in range(order):
            self.grow()

    def grow(self) -> None:
        """Append one coefficient; the motion must be at least as long."""
        motion, k, n = self.motion, len(self.terms) - 1, self.motion.n
        partials = motion.partials(k, self.by_slope is not None)
        self.rows.append(arb_mat([row[: 2 * n] for row in partials]))
        total = self.rows[0] * self.terms[k]
        for j in range(1, k + 1):
            total += self.rows[j] * self.terms[k - j]
        if self.by_slope is not None:
            total += arb_mat([[row[2 * n]] for row in partials]) * self.by_slope
        self.masses.append(
            arb_mat([[_at(motion.mass(i, j), k) for j in range(n)] for i in range(n)])
        )
        for j in range(1, k + 1):  # the leading one is inverted
            total += self.masses[j] * self.accelerations[k - j]
        acceleration = motion.inverse * total * arb(-1)
        self.accelerations.append(acceleration)
        previous, new = self.terms[k].entries(), acceleration.entries()
        self.terms.append(
            arb_mat(2 * n, self.columns, [*previous[n * self.columns :], *new])
            * (arb(1) / (k + 1))
        )

    def stacked(self, states: arb_mat) -> arb_mat:
        """Derivatives of the states, and below them those of the slope if it varies."""
        return (
            states
            if self.by_slope is None
            else arb_mat([*states.tolist(), *self.by_slope.tolist()])
        )

    def growth(self, h: arb) -> arb_mat:
        """exp(h |A|), where A is the matrix of the derivatives' equation at the leading
        coefficients.
        """
        n, slope = self.motion.n, int(self.by_slope is not None)
        low = (
            self.motion.inverse * arb_mat(self.motion.partials(0, bool(slope)))
        ).tolist()
        size = 2 * n + slope
        top = [[arb(int(j == n + i)) for j in range(size)] for i in range(n)]
        rows = [*top, *low, *[[arb(0)] * size] * slope]
        return (arb_mat([[arb(x.abs_upper()) for x in row] for row in rows]) * h).exp()


def _at(series: Series | None, k: int) -> arb:
    return _ZERO if series is None else series[k]


def velocity(body: Body, slope: arb, state: Sequence[arb]) -> list[arb]:
    """Rates and accelerations at one state.

    Parameters
    ----------
    body : Body
    slope : arb [rad]
    state : sequence of arb
        Angles [rad], then rates, of two links or three.

    Returns
    -------
    list of arb
    """
    motion = Motion(body, slope, state, 1)
    return [*state[motion.n :], *(a[0] for a in motion.a)]


Coefficient = TypeVar("Coefficient", arb, arb_mat)


def evaluate(series: Sequence[Coefficient], t: arb) -> Coefficient:
    """Value of a polynomial, by Horner's rule.

    Parameters
    ----------
    series : sequence of arb or of arb_mat
        Coefficients, the constant one first.
    t : arb

    Returns
    -------
    arb or arb_mat
    """
    total = series[-1]
    for c in series[-2::-1]:
        total = total * t + c
    return total
