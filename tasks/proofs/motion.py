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

from gaitsweep.tasks.proofs.body import Body, Drive, Vector

Series = list[arb]
#: Cosine and sine parts.
Pair = tuple[Series, Series]


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
    rising = u[: k + 1]
    falling = v[k::-1]
    return sum(map(mul, rising, falling), _ZERO)


_ZERO = arb(0)


class _Turning:
    """cos and sin of an angle, grown from the series of the angle's rate."""

    def __init__(self, angle: arb, rate: Series):
        sin, cos = angle.sin_cos()
        self.cos = [cos]
        self.sin = [sin]
        self.rate = rate

    def grow(self, k: int) -> None:
        """Append coefficient k."""
        by_cos = product(self.rate, self.sin, k - 1)
        by_sin = product(self.rate, self.cos, k - 1)
        self.cos.append(-by_cos / k)
        self.sin.append(by_sin / k)

    def turned(self, v: Vector, k: int) -> tuple[arb, arb]:
        """Coefficient k of a turned vector."""
        cos = self.cos[k]
        sin = self.sin[k]
        x = v.x * cos - v.y * sin
        y = v.x * sin + v.y * cos
        return x, y


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
        self.body = body
        self.n = len(state) // 2
        self.slope = slope
        self.state = list(state)
        self.links = [body.leg]
        if self.n == 3:
            self.links = [body.thigh, body.shank]

        q = state[: self.n]
        w = state[self.n :]
        self.q: list[Series] = [[x] for x in q]
        self.w: list[Series] = [[x] for x in w]
        self.a: list[Series] = [[] for _ in q]
        self._weigh()
        self._relate(q, w)
        self._begin_moments()
        for _ in range(order):
            self.grow()

    def _begin_moments(self) -> None:
        """Set the series, empty yet, of what the equations of motion are made of."""
        self.squares: list[Series] = [[] for _ in self.q]
        # R times the stance leg's turned first moment.
        self.stance: Pair = ([], [])
        # Of each link the moment of its weight, (cos, sin) parts.
        self.weight: list[list[tuple[arb, arb]]] = []
        # Rows over the links: l e^(i (q_j - q_0)) S_j, and the same plus R e^(i q_j)
        # S_j.
        self.hinge: list[Pair] = [([], []) for _ in self.links]
        self.whole: list[Pair] = [([], []) for _ in self.links]
        self.joint: Pair = ([], [])
        self.mass_00: Series = []
        self.inverse = arb_mat(0, 0)

    def _weigh(self) -> None:
        """Set the moments of weights, and of the pull along the slope."""
        body = self.body
        sin, cos = self.slope.sin_cos()
        # Turns a first moment into its weight's moment.
        pull = Vector(cos, -sin) * body.g
        moments = [body.stance_first]
        moments += [first for first, _ in self.links]
        self.weights = [first.turned(pull.x, pull.y) for first in moments]

        of_foot = body.g * body.mass * body.R
        self.rolling = of_foot * sin
        self.sinking = of_foot * cos

    def _relate(self, q: Sequence[arb], w: Sequence[arb]) -> None:
        """Set the angles of links, and those between them, with their rates."""
        swing = range(1, self.n)
        self.turning = list(map(_Turning, q, self.w))
        self.lag = [[w[i] - w[0]] for i in swing]
        apart = [q[i] - q[0] for i in swing]
        self.relative = list(map(_Turning, apart, self.lag))
        self.turnings = [*self.turning, *self.relative]

        if self.n == 3:
            self.flexing = [w[2] - w[1]]
            self.bent = _Turning(q[2] - q[1], self.flexing)
            self.turnings.append(self.bent)

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
            for turning in self.turnings:
                turning.grow(k)
        for square, w in zip(self.squares, self.w, strict=True):
            square.append(product(w, w, k))

        self._geometry(k)
        force = self._force(k)
        if k:
            self._subtract_inertia(force, k)
        else:
            self.inverse = self._leading_masses().inv()

        column = arb_mat(self.n, 1, force)
        accelerations = self.inverse * column
        self._append_accelerations(k, accelerations.entries())

    def _append_accelerations(self, k: int, accelerations: list[arb]) -> None:
        """Append coefficient k of the accelerations, and the next one of angles, rates
        and differences of rates.
        """
        links = zip(self.q, self.w, self.a, accelerations, strict=True)
        for q, w, a, acceleration in links:
            a.append(acceleration)
            q.append(w[k] / (k + 1))
            w.append(acceleration / (k + 1))

        stance, *swing = (w[k + 1] for w in self.w)
        for lag, rate in zip(self.lag, swing, strict=True):
            lag.append(rate - stance)
        if self.n == 3:
            thigh, shank = swing
            self.flexing.append(shank - thigh)

    def _subtract_inertia(self, force: list[arb], k: int) -> None:
        """Subtract from forces the accelerations before the k-th, times the coefficients
        of the masses.
        """
        for i in range(self.n):
            for j, a in enumerate(self.a):
                mass = self.mass(i, j)
                if mass is not None:
                    before = product(mass[1:], a, k - 1)
                    force[i] -= before

    def _leading_masses(self) -> arb_mat:
        """The mass matrix at the start."""
        links = range(self.n)
        rows = []
        for i in links:
            row = [self._leading(i, j) for j in links]
            rows.append(row)
        return arb_mat(rows)

    def _geometry(self, k: int) -> None:
        """Append coefficient k of the turned first moments."""
        body = self.body
        x, y = self.turning[0].turned(body.stance_first, k)
        _append(self.stance, body.R * x, body.R * y)
        self.mass_00.append(2 * body.R * y)
        if k == 0:
            self.mass_00[0] += body.stance_second

        for j, (first, _) in enumerate(self.links):
            self._turn_link(j, first, k)
        if self.n == 3:
            x, y = self.bent.turned(body.coupling, k)
            _append(self.joint, x, y)

    def _turn_link(self, j: int, first: Vector, k: int) -> None:
        """Append coefficient k of the first moment of swing link j, turned."""
        body = self.body
        x, y = self.relative[j].turned(first, k)
        hinge_x = body.l * x
        hinge_y = body.l * y
        _append(self.hinge[j], hinge_x, hinge_y)

        x, y = self.turning[j + 1].turned(first, k)
        whole_x = hinge_x + body.R * x
        whole_y = hinge_y + body.R * y
        _append(self.whole[j], whole_x, whole_y)

    def _force(self, k: int) -> list[arb]:
        """Coefficient k of f, the forces at vanishing acceleration."""
        links = zip(self.turning, self.weights, strict=True)
        weight = [turning.turned(moment, k) for turning, moment in links]
        self.weight.append(weight)
        stance_square, *swing_squares = self.squares
        stance_weight, *swing_weights = (across for across, _ in weight)

        force = [-stance_weight]
        if k == 0:
            force[0] -= self.rolling
        if self._rolls:
            force[0] -= product(self.stance[0], stance_square, k)

        for j, square in enumerate(swing_squares):
            whole_x, _ = self.whole[j]
            hinge_x, _ = self.hinge[j]
            if self.body.heavy:
                force[0] -= product(whole_x, square, k)
            turning = product(hinge_x, stance_square, k)
            force.append(turning - swing_weights[j])

        if self.n == 3:
            self._add_coupling(force, k)
        if self.body.drive is not None:
            self._add_hip_torque(self.body.drive, force, k)
        return force

    def _add_coupling(self, force: list[arb], k: int) -> None:
        """Add coefficient k of what thigh and shank do to each other as they turn."""
        _, y = self.joint
        _, thigh_square, shank_square = self.squares
        force[1] += product(y, shank_square, k)
        force[2] -= product(y, thigh_square, k)

    def _add_hip_torque(self, drive: Drive, force: list[arb], k: int) -> None:
        """Add coefficient k of the torque between the thighs."""
        between = self.q[1][k] - self.q[0][k]
        opening = self.w[1][k] - self.w[0][k]
        torque = -drive.stiffness * between - drive.damping * opening

        if k == 0:
            torque += drive.bias
        force[1] += torque
        if self.body.heavy:
            force[0] -= torque

    @property
    def _rolls(self) -> bool:
        return self.body.R != 0

    def mass(self, i: int, j: int) -> Series | None:
        """Series of an entry of the mass matrix; None where it is constant."""
        if i == j:
            is_stance = i == 0
            return self.mass_00 if is_stance and self._rolls else None
        if i and j:
            return self.joint[0]
        if i == 0 and not self.body.heavy:
            return None

        link = max(i, j) - 1
        _, y = self.whole[link]
        return y

    def masses(self, k: int) -> arb_mat:
        """Coefficient k of the mass matrix, but for entries that are constant."""
        entries = []
        for i in range(self.n):
            for j in range(self.n):
                series = self.mass(i, j)
                entries.append(_ZERO if series is None else series[k])
        return arb_mat(self.n, self.n, entries)

    def _leading(self, i: int, j: int) -> arb:
        series = self.mass(i, j)
        if series is not None:
            return series[0]
        if i != j:
            return _ZERO
        if i == 0:
            return self.mass_00[0]

        _, inertia = self.links[i - 1]
        return inertia

    def partials(self, k: int, slope: bool) -> list[list[arb]]:
        """Coefficient k of the derivatives of r by (q, w[, slope]); rows are the
        equations.
        """
        n = self.n
        by_q = [[_ZERO] * n for _ in range(n)]
        by_w = [[_ZERO] * n for _ in range(n)]
        self._of_stance(k, by_q[0], by_w[0])
        for j in range(1, n):
            if self.body.heavy:
                self._by_swing(j, k, by_q[0], by_w[0])
            self._of_swing(j, k, by_q[j], by_w[j])

        if n == 3:
            self._of_knee(k, by_q, by_w)
        if self.body.drive is not None and k == 0:
            self._of_hip(self.body.drive, by_q, by_w)

        rows = [[*q, *w] for q, w in zip(by_q, by_w, strict=True)]
        if slope:
            self._append_by_slope(k, rows)
        return rows

    def _of_stance(self, k: int, by_q: Series, by_w: Series) -> None:
        """Set the derivatives of the stance leg's equation by its own angle and rate."""
        _, lifted = self.weight[k][0]
        by_q[0] = -lifted
        if self._rolls:
            x, y = self.stance
            squared = product(y, self.squares[0], k)
            leaning = product(x, self.a[0], k)
            by_q[0] += 2 * leaning - squared
            by_w[0] = 2 * product(x, self.w[0], k)

    def _append_by_slope(self, k: int, rows: list[list[arb]]) -> None:
        """Append the derivatives by the slope to those by (q, w)."""
        for row, (_, lifted) in zip(rows, self.weight[k], strict=True):
            row.append(lifted)
        if k == 0:
            rows[0][-1] += self.sinking

    def _of_hip(self, drive: Drive, by_q: list[Series], by_w: list[Series]) -> None:
        """Add the derivatives of the torque between the thighs."""
        for rows, factor in ((by_q, drive.stiffness), (by_w, drive.damping)):
            rows[1][0] -= factor
            rows[1][1] += factor
            if self.body.heavy:
                rows[0][0] += factor
                rows[0][1] -= factor

    def _by_swing(self, j: int, k: int, by_q: Series, by_w: Series) -> None:
        """Add to the derivatives of the stance leg's equation those by swing link j."""
        a = self.a[j]
        square = self.squares[j]
        hinge_x, hinge_y = self.hinge[j - 1]
        whole_x, whole_y = self.whole[j - 1]
        turned = product(hinge_y, square, k)
        by_q[0] += turned - product(hinge_x, a, k)
        turned = product(whole_y, square, k)
        by_q[j] = product(whole_x, a, k) - turned
        by_w[j] = 2 * product(whole_x, self.w[j], k)

    def _of_swing(self, j: int, k: int, by_q: Series, by_w: Series) -> None:
        """Set the derivatives of the equation of swing link j."""
        a = self.a[0]
        hinge_x, hinge_y = self.hinge[j - 1]
        whole_x, _ = self.whole[j - 1]
        _, lifted = self.weight[k][j]
        turned = product(hinge_y, self.squares[0], k)
        by_q[0] = -product(hinge_x, a, k) - turned
        by_q[j] = product(whole_x, a, k) - lifted + turned
        by_w[0] = -2 * product(hinge_x, self.w[0], k)

    def _of_knee(self, k: int, by_q: list[Series], by_w: list[Series]) -> None:
        """Add the derivatives of the coupling of thigh and shank."""
        x, y = self.joint
        _, thigh_a, shank_a = self.a
        _, thigh_square, shank_square = self.squares
        thigh = product(y, shank_a, k) + product(x, shank_square, k)
        shank = product(y, thigh_a, k) - product(x, thigh_square, k)
        by_q[1][1] += thigh
        by_q[1][2] -= thigh
        by_q[2][1] += shank
        by_q[2][2] -= shank
        by_w[1][2] = -2 * product(y, self.w[2], k)
        by_w[2][1] = 2 * product(y, self.w[1], k)


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
        self.motion = motion
        self.terms = [start]
        self.by_slope = by_slope
        self.rows: list[arb_mat] = []
        self.masses: list[arb_mat] = []
        self.accelerations: list[arb_mat] = []
        self.columns = start.ncols()

        for _ in range(order):
            self.grow()

    def grow(self) -> None:
        """Append one coefficient; the motion must be at least as long."""
        motion = self.motion
        k = len(self.terms) - 1
        size = 2 * motion.n
        partials = motion.partials(k, self.by_slope is not None)
        by_state = [row[:size] for row in partials]
        self.rows.append(arb_mat(by_state))
        self.masses.append(motion.masses(k))

        residual = self.rows[0] * self.terms[k]
        for j in range(1, k + 1):
            residual += self.rows[j] * self.terms[k - j]
        if self.by_slope is not None:
            by_slope = [[row[size]] for row in partials]
            residual += arb_mat(by_slope) * self.by_slope
        acceleration = self._solved(residual, k)
        self.accelerations.append(acceleration)

        rates = self.terms[k].entries()[motion.n * self.columns :]
        change = arb_mat(size, self.columns, [*rates, *acceleration.entries()])
        self.terms.append(change * (arb(1) / (k + 1)))

    def _solved(self, residual: arb_mat, k: int) -> arb_mat:
        """Coefficient k of the accelerations' derivatives, by that of what they balance.

        Those before it are known, and only the leading mass matrix is inverted.
        """
        for j in range(1, k + 1):
            residual += self.masses[j] * self.accelerations[k - j]
        return self.motion.inverse * residual * arb(-1)

    def stacked(self, states: arb_mat) -> arb_mat:
        """Derivatives of the states, and below them those of the slope if it varies."""
        if self.by_slope is None:
            return states
        return arb_mat([*states.tolist(), *self.by_slope.tolist()])

    def growth(self, h: arb) -> arb_mat:
        """exp(h |A|), where A is the matrix of the derivatives' equation at the leading
        coefficients.
        """
        n = self.motion.n
        has_slope = self.by_slope is not None
        partials = arb_mat(self.motion.partials(0, has_slope))
        accelerations = self.motion.inverse * partials
        size = 2 * n + has_slope
        matrix = arb_mat(size, size)
        for i in range(n):
            matrix[i, n + i] = 1
            for j in range(size):
                largest = accelerations[i, j].abs_upper()
                matrix[n + i, j] = arb(largest)

        return (matrix * h).exp()


def _append(pair: Pair, x: arb, y: arb) -> None:
    pair[0].append(x)
    pair[1].append(y)


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
    rates = state[motion.n :]
    accelerations = [a[0] for a in motion.a]
    return [*rates, *accelerations]


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
