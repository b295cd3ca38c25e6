"""Contact and knee forces of a walker whose stance knee is open: an open chain of four
links over a rolling foot.

Stance shank, stance thigh, swing thigh and swing shank have the angles q; every point
is

    x + iy = -R q_0 + iR + sum_j A_j exp(i q_j)

with constant arms A_j. The torque that holds the stance knee is the residual of the
thigh's own equation of motion when both stance links move as one. Plain arrays,
elementwise operations only: this measures motions that are already known.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.walkers.walker import Walker

#: Rows of the stance thigh and of the swing shank among the links.
THIGH, SWING_SHANK = 1, 3


class Chain:
    """A walker whose stance knee is open, in units of its leg, its mass and g.

    Arrays have the link first where they have one, then any shape, here (4, ...):
    stance shank, stance thigh, swing thigh, swing shank. A complex number x + iy is a
    vector along the slope and the ground's normal. Of an array of walkers the constants
    are arrays too, shape (n,), as are the motions.
    """

    def __init__(self, walker: Walker):
        self.kneed = walker.knees
        self.massless = walker.massless_leg
        self.locks_trailing_knee = walker.locks_trailing_knee
        self.frees_trailing_knee = walker.frees_trailing_knee

        self.R = walker.R / walker.leg
        self.l = walker.l / walker.leg
        knee = walker.knee / walker.leg
        #: Foot centre from the knee, in the frame of the extended leg.
        self.foot = -1j * self.l - knee
        #: From foot centre to foot centre, link by link.
        self.to_foot = (-self.foot, -knee, knee, self.foot)

        self._weigh(walker, knee)
        self._drive(walker)

    def _weigh(self, walker: Walker, knee: complex | ndarray) -> None:
        """Set first moments and products of the arms of the centres of mass."""
        leg = walker.leg
        m_t, m_s, m_h = _masses(walker)
        I_t = m_t * (walker.r_t / leg) ** 2
        I_s = m_s * (walker.r_s / leg) ** 2
        rows = _arms(walker, self.foot, knee)

        # Of an array of walkers those constants that all share are numbers.
        used = [m_t, m_s, m_h, I_t, I_s, *rows[1], *rows[4]]
        shape = np.broadcast_shapes(*map(np.shape, used))
        arms = np.stack([_of_shape(shape, row) for row in rows])
        masses = _of_shape(shape, [m_s, m_t, m_h, m_t, m_s])
        self.S = total(masses[:, None] * arms)
        self.K = total(
            arm.conj()[:, None] * mass * arm
            for arm, mass in zip(arms, masses, strict=True)
        )
        for i, inertia in enumerate((I_s, I_t, I_t, I_s)):
            self.K[i, i] += inertia

        #: First moments in the links' own equations of motion: a massless leg's rows are
        #: those of a shank of unit mass.
        self.S_rows = self.S.copy()
        if self.massless:
            self._take_shank_of_unit_mass(arms[4], walker.r_s / leg)

    def _drive(self, walker: Walker) -> None:
        """Set what acts between the thighs."""
        self.acts = walker.has_hip_torque
        weight_leg = walker.total_mass * walker.g * walker.leg
        #: Of legs without mass over their inertia, which is that of `K`.
        unit: Any = 1.0 / weight_leg
        unit_of_damping = unit / walker.time_unit
        if self.massless:
            of_leg = self.K[2:, 2:].reshape(4, *self.K.shape[2:])
            unit = unit_of_damping = total(of_leg).real

        self.hip_stiffness = walker.hip_stiffness * unit
        self.hip_damping = walker.hip_damping * unit_of_damping
        at_rest = walker.hip_stiffness * walker.hip_rest
        self.hip_bias = (at_rest + walker.hip_torque) * unit

    def hip_torque(self, q: ndarray, rate: ndarray) -> ndarray:
        """Torque between the thighs, on the swing leg; of a massless one over its
        inertia.
        """
        between = q[2] - q[THIGH]
        opening = rate[2] - rate[THIGH]
        of_spring = self.hip_stiffness * between
        return self.hip_bias - of_spring - self.hip_damping * opening

    def _take_shank_of_unit_mass(
        self,
        arms: ndarray,
        radius: float | ndarray,
    ) -> None:
        """Set the rows of the swing leg to those of a shank of unit mass, by the arms of
        its centre, (4, ...), and its radius of gyration.
        """
        self.K[2:] = arms[2:].conj()[:, None] * arms
        self.K[3, 3] += radius**2
        self.S_rows[2:] = arms[2:]

    def groups(self, free_knee: bool) -> list[list[int]]:
        """Links that move as one, by their indices."""
        return [[0, 1], [2], [3]] if free_knee else [[0, 1], [2, 3]]

    def matrix(self, q: ndarray) -> list[list[ndarray]]:
        """Mass matrix of the four links.

        Parameters
        ----------
        q : ndarray, shape (4, ...) [rad]

        Returns
        -------
        list of list of ndarray, shape (...)
        """
        e = np.exp(1j * q)
        M = []
        for i in range(4):
            M.append([(self.K[i, j] * e[i].conj() * e[j]).real for j in range(4)])

        # As the stance shank turns, its foot rolls and moves every link along the slope.
        for j in range(4):
            M[0][j] = M[0][j] + self.R * (self.S[j] * e[j]).imag
            M[j][0] = M[j][0] + self.R * (self.S_rows[j] * e[j]).imag

        M[0][0] = M[0][0] + self.R**2
        return M

    def force(
        self,
        q: ndarray,
        rate: ndarray,
        slope: ndarray,
    ) -> list[ndarray]:
        """Right-hand side f of M q'' = f.

        Parameters
        ----------
        q, rate : ndarray, shape (4, ...) [rad, rad/sqrt(leg/g)]
        slope : ndarray, shape (...) [rad]

        Returns
        -------
        list of ndarray, shape (...)
            Generalised forces over mass, leg and g.
        """
        e = np.exp(1j * q)
        gravity = np.sin(slope) - 1j * np.cos(slope)
        f = []
        for i in range(4):
            turning = total(
                rate[j] ** 2 * (self.K[i, j] * e[i].conj() * e[j]).imag
                for j in range(4)
            )
            weight = ((1j * self.S_rows[i] * e[i]).conj() * gravity).real
            f.append(weight + turning)

        pull = gravity + total(rate[j] ** 2 * self.S[j] * e[j] for j in range(4))
        f[0] = f[0] - self.R * pull.real

        if self.acts:
            torque = self.hip_torque(q, rate)
            f[2] = f[2] + torque
            if not self.massless:
                f[THIGH] = f[THIGH] - torque

        return f

    def accelerations(
        self,
        q: ndarray,
        rate: ndarray,
        slope: ndarray,
        free_knee: bool,
    ) -> ndarray:
        """Angular accelerations of the four links with the stance knee locked.

        Parameters
        ----------
        q, rate : ndarray, shape (4, ...) [rad, rad/sqrt(leg/g)]
        slope : ndarray, shape (...) [rad]
        free_knee : bool
            True where the swing knee is free.

        Returns
        -------
        ndarray, shape (4, ...) [rad g/leg]
        """
        f = self.force(q, rate, slope)
        groups = self.groups(free_knee)
        x = solve(_group(self.matrix(q), groups), _of_groups(f, groups))
        sizes = [len(group) for group in groups]
        return np.repeat(np.stack(x), sizes, axis=0)

    def momentum(self, q: ndarray, rate: ndarray) -> ndarray:
        """Linear momentum, complex, over mass and sqrt(leg g).

        Parameters
        ----------
        q, rate : ndarray, shape (4, ...) [rad, rad/sqrt(leg/g)]

        Returns
        -------
        ndarray of complex, shape (...)
        """
        return total(rate * self.levers(q))

    def levers(self, q: ndarray) -> ndarray:
        """Linear momentum, complex, that a unit rate of each link gives.

        Parameters
        ----------
        q : ndarray, shape (4, ...) [rad]

        Returns
        -------
        ndarray of complex, shape (4, ...)
        """
        e = np.exp(1j * q)
        levers = [1j * S * own for S, own in zip(self.S, e, strict=True)]
        levers[0] = levers[0] - self.R
        return np.stack(levers)

    def ground_force(
        self,
        q: ndarray,
        rate: ndarray,
        acceleration: ndarray,
        slope: ndarray,
    ) -> ndarray:
        """Force of the ground on the stance foot, complex, over weight.

        Parameters
        ----------
        q, rate, acceleration : ndarray, shape (4, ...) [rad, rad/sqrt(leg/g), rad g/leg]
        slope : ndarray, shape (...) [rad]

        Returns
        -------
        ndarray of complex, shape (...)
        """
        e = np.exp(1j * q)
        inertial = total(
            (1j * acceleration[j] - rate[j] ** 2) * self.S[j] * e[j] for j in range(4)
        )
        return inertial - self.R * acceleration[0] - np.sin(slope) + 1j * np.cos(slope)

    def holding(
        self,
        q: ndarray,
        rate: ndarray,
        acceleration: ndarray,
        slope: ndarray,
    ) -> ndarray:
        """Torque of the stance knee's lock on the thigh; negative where no stop could
        give it.

        Parameters
        ----------
        q, rate, acceleration : ndarray, shape (4, ...) [rad, rad/sqrt(leg/g), rad g/leg]
        slope : ndarray, shape (...) [rad]

        Returns
        -------
        ndarray, shape (...) [weight leg]
        """
        M = self.matrix(q)
        f = self.force(q, rate, slope)
        return total(M[THIGH][j] * acceleration[j] for j in range(4)) - f[THIGH]

    def compliance(
        self,
        q: ndarray,
        rows: list[ndarray],
        free_knee: bool,
    ) -> list[list[ndarray]]:
        """Rates along some rows for a unit impulse along each, stance knee locked: r
        M^-1 r^T.

        Parameters
        ----------
        q : ndarray, shape (4, ...) [rad]
        rows : list of ndarray, shape (4, ...)
            Directions of the generalised impulses.
        free_knee : bool
            True where the swing knee is free.

        Returns
        -------
        list of list of ndarray, shape (...)
            The symmetric matrix over the rows.
        """
        groups = self.groups(free_knee)
        M = _group(self.matrix(q), groups)
        impulses = [_of_groups(row, groups) for row in rows]
        responses = [np.stack(solve(M, impulse)) for impulse in impulses]
        compliance = []
        for impulse in impulses:
            compliance.append([total(np.stack(impulse) * x) for x in responses])
        return compliance

    def height(self, q: ndarray) -> ndarray:
        """Height of the swing foot's lowest point over leg, without cancellation for
        short steps.

        Parameters
        ----------
        q : ndarray, shape (4, ...) [rad]

        Returns
        -------
        ndarray, shape (...)
        """
        a = q[0]
        b = q[2]
        c = q[3]
        bent = 2 * np.sin((c - b) / 2) * (self.foot * np.exp(0.5j * (b + c))).real
        return -2 * self.l * np.sin((a + b) / 2) * np.sin((a - b) / 2) + bent

    def rise(self, q: ndarray) -> ndarray:
        """Derivative of the swing foot's height by the four angles.

        Parameters
        ----------
        q : ndarray, shape (4, ...) [rad]

        Returns
        -------
        ndarray, shape (4, ...)
        """
        e = np.exp(1j * q)
        return np.stack([(arm * e[j]).real for j, arm in enumerate(self.to_foot)])

    def lift(
        self,
        q: ndarray,
        rate: ndarray,
        acceleration: ndarray,
    ) -> ndarray:
        """Second derivative of the swing foot's height by time, over g.

        Parameters
        ----------
        q, rate, acceleration : ndarray, shape (4, ...) [rad, rad/sqrt(leg/g), rad g/leg]

        Returns
        -------
        ndarray, shape (...)
        """
        e = np.exp(1j * q)
        turning = total(
            rate[j] ** 2 * (arm * e[j]).imag for j, arm in enumerate(self.to_foot)
        )
        return total(self.rise(q) * acceleration) - turning


def _masses(walker: Walker) -> tuple[Any, Any, Any]:
    """Masses of thigh, shank and hip, over the walker's."""
    mass = walker.total_mass
    return walker.m_t / mass, walker.m_s / mass, walker.m_h / mass


def _arms(
    walker: Walker,
    foot: complex | ndarray,
    knee: complex | ndarray,
) -> list[list[Any]]:
    """Arms, link by link, of the centres of mass of stance shank, stance thigh, hip,
    swing thigh and swing shank, from the centre of the stance foot.
    """
    thigh = walker.thigh_centre / walker.leg
    shank = walker.shank_centre / walker.leg
    return [
        [shank - foot, 0, 0, 0],
        [-foot, thigh - knee, 0, 0],
        [-foot, -knee, 0, 0],
        [-foot, -knee, thigh, 0],
        [-foot, -knee, knee, shank],
    ]


def _of_shape(shape: tuple[int, ...], values: Sequence[Any]) -> ndarray:
    """Numbers and arrays as one array, (n, *shape)."""
    return np.stack([np.broadcast_to(value, shape) for value in values])


def _group(
    M: list[list[ndarray]],
    groups: list[list[int]],
) -> list[list[ndarray]]:
    """Matrix of groups of links that move as one."""
    grouped = []
    for g in groups:
        row = []
        for h in groups:
            row.append(total(M[i][j] for i, j in itertools.product(g, h)))
        grouped.append(row)
    return grouped


def _of_groups(
    values: list[ndarray] | ndarray,
    groups: list[list[int]],
) -> list[ndarray]:
    """Sums of the links' values over groups that move as one."""
    return [total(values[i] for i in g) for g in groups]


def solve(A: list[list[ndarray]], b: list[ndarray]) -> list[ndarray]:
    """Solve A x = b elementwise, the first row eliminated last: in a chain that of the
    stance leg, whose coupling to a massless leg is zero.

    Parameters
    ----------
    A : list of list of ndarray, shape (...)
    b : list of ndarray, shape (...)

    Returns
    -------
    list of ndarray, shape (...)
    """
    A = [list(row) for row in A]
    b = list(b)
    n = len(b)
    for k in reversed(range(1, n)):
        for i in range(k):
            factor = A[i][k] / A[k][k]
            b[i] = b[i] - factor * b[k]
            for j in range(k):
                A[i][j] = A[i][j] - factor * A[k][j]

    x: list[ndarray] = []
    for i in range(n):
        for j in range(i):
            b[i] = b[i] - A[i][j] * x[j]
        x.append(b[i] / A[i][i])

    return x
