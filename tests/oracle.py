"""A second derivation of the walkers, slow and plain, for tests to compare with.

Every link is a free rigid body (x, y, angle). Pins, locked knees and the rolling foot
are constraints, and accelerations, ground forces and impacts all come from one
Karush-Kuhn-Tucker system. No lumped constants and no equations of motion are written
out.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

HIP, THIGH, SHANK = (
    0,
    (2, 8),
    (5, 11),
)  # first coordinate: hip; thighs and shanks of legs 0, 1
COORDINATES = 14


class StepFailed(RuntimeError):
    """The step does not end in a heelstrike."""


@dataclass(frozen=True)
class Step:
    """One step, from just after one heelstrike to just after the next.

    States are arrays ``[stance, thigh, shank angle, and their three rates]`` of shape
    (6,). Impulses and forces are those of the ground on the walker, (down the slope,
    normal).
    """

    theta: float  # stance angle after the closing heelstrike
    rates: np.ndarray  # stance, thigh and shank rates after it
    period: float
    kneestrike_time: float | None
    before_kneestrike: np.ndarray | None
    after_kneestrike: np.ndarray | None
    before_heelstrike: np.ndarray
    impulse_kneestrike: np.ndarray | None
    impulse_heelstrike: np.ndarray
    loss_kneestrike: float  # differences of kinetic energy, nothing else
    loss_heelstrike: float
    time: np.ndarray = None  # samples over the step, shape (n,)
    states: np.ndarray = None  # shape (n, 6)
    force: np.ndarray = None  # shape (n, 2)


def _along(angle):
    """Unit vector along a leg line from the hip downward."""
    return np.array([np.sin(angle), -np.cos(angle)])


def _behind(angle):
    """Unit vector a quarter turn behind a leg line, up the slope for an upright leg."""
    return np.array([-np.cos(angle), -np.sin(angle)])


def _turn(angle, vector):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


class Stepper:
    """Phase logic of a step, shared by both oracles: what ends a phase, and what
    follows.
    """

    knees = False
    time_unit = 1.0
    longest_step = (
        0.05  # in units of time; a guard that closes twice within one is not seen
    )

    def integrate(
        self, state, slope, locked, guard: Callable, direction, start, rtol, atol
    ):
        """Integrate to the next crossing of `guard`, polishing away the interpolant's
        error.
        """

        def rhs(_, y):
            return np.concatenate([y[3:], self.accelerations(y, slope, locked)])

        def event(_, y):
            return guard(y)

        def fall_margin(_, y):
            return abs(y[0]) - np.pi / 2

        event.terminal, event.direction, fall_margin.terminal = True, direction, True
        options = {"method": "DOP853", "rtol": rtol, "atol": atol}
        run = solve_ivp(
            rhs,
            (start, start + 20 * self.time_unit),
            state,
            events=(event, fall_margin),
            max_step=self.longest_step * self.time_unit,
            dense_output=True,
            **options,
        )
        if not run.t_events[0].size:
            raise StepFailed(f"No crossing before t = {run.t[-1]:.3g}.")
        time, end = run.t[-1], run.y[:, -1]
        for _ in range(3):  # the guard is nearly linear over this little way
            if time > run.t[-2]:
                end = solve_ivp(rhs, (run.t[-2], time), run.y[:, -2], **options).y[
                    :, -1
                ]
            rate = (
                guard(end + 1e-6 * rhs(0, end)) - guard(end - 1e-6 * rhs(0, end))
            ) / 2e-6
            time -= guard(end) / rate
        end = end - guard(end) / rate * rhs(0, end)
        return time, end, run.sol

    def step(self, theta, rates, slope, rtol=1e-13, atol=1e-15, samples=0):
        """Take one step.

        Parameters
        ----------
        theta : float [rad]
            Stance angle just after heelstrike; the swing leg starts at ``-theta``.
        rates : sequence of 2 or 3 floats [rad/time]
            Rates of stance leg, thigh and, with knees, shank.
        slope : float [rad]
        rtol, atol : float
            Tolerances of DOP853. Lower `atol` along with the step length.
        samples : int
            Points per phase at which states and ground force are returned; 0 for none.

        Returns
        -------
        Step

        Raises
        ------
        StepFailed
            If the walker falls, or the heel would strike before the knee.
        """
        rates = np.asarray(rates, float)
        rates = np.append(rates, rates[1]) if rates.size == 2 else rates
        state, time, pieces = np.array([theta, -theta, -theta, *rates]), 0.0, []

        def advance(guard, direction, locked):
            nonlocal state, time
            start = time
            time, state, sol = self.integrate(
                state, slope, locked, guard, direction, start, rtol, atol
            )
            pieces.append((start, time, locked, sol))

        def flexion(y):
            return y[1] - y[2]

        knee = (None, None, None, None, 0.0)
        if self.knees:
            if self._hyperextends(state, slope):  # wait until it flexes
                advance(flexion, 1, False)
            advance(flexion, -1, False)
            before = state
            state, impulse, loss = self.kneestrike(before)
            knee = (time, before, state, impulse, loss)
            # A step ends where the guard, once positive, falls to zero: one not yet
            # positive is no strike.
            angles = np.hstack(
                [sol(np.linspace(a, b, 2000))[:2] for a, b, _, sol in pieces]
            )
            guard = angles[0] + angles[1]
            if ((guard[1:] <= 0) & (guard[:-1] > 0) & (angles[0, 1:] < 0)).any():
                raise StepFailed(
                    "The knee strikes after the leg has passed the heelstrike angle."
                )
        if (
            state[0] >= 0
        ):  # crossings before the stance leg is upright are no heelstrikes
            advance(lambda y: y[0], -1, True)
        advance(lambda y: y[0] + y[1], -1, True)
        while (
            state[0] >= 0
        ):  # the stance leg has come back: that was no heelstrike, the next may be
            advance(lambda y: y[0] + y[1], 1, True)
            advance(lambda y: y[0] + y[1], -1, True)
        after, impulse, loss = self.heelstrike(state)
        return Step(
            after[0],
            after[3:],
            time,
            *knee[:3],
            state,
            knee[3],
            impulse,
            knee[4],
            loss,
            *self._sample(pieces, slope, samples),
        )

    def _hyperextends(self, state, slope):
        """Whether the released knee first moves against its stop; of a knee at rest its
        acceleration says so.
        """
        moves = state[3:]
        if moves[1] == moves[2]:
            moves = self.accelerations(state, slope, False)
        return moves[1] < moves[2]

    def _sample(self, pieces, slope, samples):
        if not samples:
            return None, None, None
        grids = [np.linspace(a, b, samples) for a, b, _, _ in pieces]
        states = [
            sol(grid).T for grid, (_, _, _, sol) in zip(grids, pieces, strict=False)
        ]
        force = [
            self.ground_force(y, slope, piece[2])
            for rows, piece in zip(states, pieces, strict=False)
            for y in rows
        ]
        return np.concatenate(grids), np.concatenate(states), np.array(force)

    def map(self, x, slope, **options):
        """Stride map on ``x = [theta, stance, thigh (, shank) rate]``."""
        step = self.step(x[0], x[1:], slope, **options)
        return np.array([step.theta, *step.rates])[: len(x)]

    def jacobian(self, x, slope, h=1e-4, **options):
        """Jacobian of the stride map by fourth-order central differences, relative step
        `h`.
        """
        columns = []
        for k in range(len(x)):
            e = np.zeros(len(x))
            e[k] = h * max(abs(x[0]), abs(x[k]))
            f = [self.map(x + i * e, slope, **options) for i in (-2, -1, 1, 2)]
            columns.append((f[0] - 8 * f[1] + 8 * f[2] - f[3]) / (12 * e[k]))
        return np.array(columns).T

    def fixed_point(self, x, slope, iterations=8, **options):
        """Newton's method on the stride map from the guess `x`."""
        x = np.array(x, float)
        for _ in range(iterations):
            defect = self.map(x, slope, **options) - x
            if np.abs(defect).max() < 1e-12 * abs(x[0]):
                break
            x = x - np.linalg.solve(
                self.jacobian(x, slope, **options) - np.eye(len(x)), defect
            )
        return x


class Oracle(Stepper):
    """A walker of rigid links in maximal coordinates.

    Parameters
    ----------
    walker : Mapping
        The paper's keys ``l_t w_t m_t r_t c_t l_s w_s m_s r_s c_s R eps_T`` and
        ``m_h``, ``g``, ``knees``, and those of what drives it: ``push_off``,
        ``hip_stiffness``, ``hip_damping``, ``hip_rest``, ``hip_torque``. Leg 0 stands
        and leg 1 swings until a heelstrike swaps them.
    """

    def __init__(self, walker: Mapping):
        self.keys = k = {"m_h": 0.0, "g": 1.0, "knees": False, **walker}
        self.knees, self.g, self.radius = k["knees"], k["g"], k["R"]
        d = k["l_s"] - self.radius
        eps_t, eps_s = k["eps_T"], np.arcsin(k["l_t"] * np.sin(k["eps_T"]) / d)
        # Body frames have angle zero when the extended leg's hip-foot-centre line is
        # upright.
        thigh = k["c_t"] * _along(-eps_t) + k["w_t"] * _behind(-eps_t)
        shank = k["c_s"] * _along(eps_s) + k["w_s"] * _behind(eps_s)
        self.hip_on_thigh, self.knee_on_thigh = (
            -thigh,
            k["l_t"] * _along(-eps_t) - thigh,
        )
        self.knee_on_shank, self.centre_on_shank = -shank, d * _along(eps_s) - shank
        m_t, m_s = k["m_t"], k["m_s"]
        leg = [m_t, m_t, m_t * k["r_t"] ** 2, m_s, m_s, m_s * k["r_s"] ** 2]
        self.mass = np.array([k["m_h"], k["m_h"], *leg, *leg])
        self.length = (
            np.linalg.norm(k["l_t"] * _along(-eps_t) + d * _along(eps_s)) + k["R"]
        )
        self.time_unit = np.sqrt(self.length / self.g)

    # Kinematics: angles of the four links, and constraint rows J v = 0, J a = bias.

    @staticmethod
    def _links(three):
        """Stance thigh, stance shank, swing thigh, swing shank from (stance, thigh,
        shank).
        """
        return np.array([three[0], three[0], three[1], three[2]])

    def _constraints(self, angles, rates, contact, locked):
        """Rows for pins, then the rolling foot of leg `contact`, if one is on the
        ground, then each leg in `locked`.
        """
        rows, bias = [], []

        def point(
            body, link, offset
        ):  # Jacobian of a point of a link, and its centripetal part
            arm, jac = _turn(angles[link], offset), np.zeros((2, COORDINATES))
            jac[:, body : body + 2] = np.eye(2)
            jac[:, body + 2] = -arm[1], arm[0]
            return jac, rates[link] ** 2 * arm

        hip = np.zeros((2, COORDINATES))
        hip[:, HIP : HIP + 2] = np.eye(2)
        for leg in (0, 1):
            top, a = point(THIGH[leg], 2 * leg, self.hip_on_thigh)
            low, b = point(THIGH[leg], 2 * leg, self.knee_on_thigh)
            knee, c = point(SHANK[leg], 2 * leg + 1, self.knee_on_shank)
            rows += [top - hip, low - knee]
            bias += [a, b - c]
        if contact is not None:
            foot, a = self._rolling(point, contact)
            rows.append(foot)
            bias.append(a)
        for leg in locked:
            lock = np.zeros((1, COORDINATES))
            lock[0, THIGH[leg] + 2], lock[0, SHANK[leg] + 2] = 1, -1
            rows.append(lock)
            bias.append(np.zeros(1))
        return np.vstack(rows), np.concatenate(bias)

    def _rolling(self, point, leg):
        """Row of the lowest point of a leg's arc, which is at rest."""
        foot, a = point(SHANK[leg], 2 * leg + 1, self.centre_on_shank)
        foot[0, SHANK[leg] + 2] += self.radius
        return foot, a

    def _solve(self, jac, force, target):
        """Solve M a - J' f = force, J a = target; return a and the constraint forces f."""
        n = len(jac)
        matrix = np.block([[np.diag(self.mass), -jac.T], [jac, np.zeros((n, n))]])
        solution = np.linalg.solve(matrix, np.concatenate([force, target]))
        return solution[:COORDINATES], solution[COORDINATES:]

    def velocities(self, state):
        """Velocities of all bodies, shape (14,), from the three angles and rates."""
        angles, rates = self._links(state[:3]), self._links(state[3:])
        jac, _ = self._constraints(angles, rates, 0, ())
        pick = np.zeros((4, COORDINATES))
        pick[range(4), [THIGH[0] + 2, SHANK[0] + 2, THIGH[1] + 2, SHANK[1] + 2]] = 1
        return np.linalg.solve(
            np.vstack([jac, pick]), np.concatenate([np.zeros(10), rates])
        )

    def positions(self, state):
        """Positions of hip and links, shape (14,); the ground is y = 0."""
        a = self._links(state[:3])
        centre = np.array([-self.radius * a[0], self.radius])
        shank = centre - _turn(a[1], self.centre_on_shank)
        thigh = (
            shank + _turn(a[1], self.knee_on_shank) - _turn(a[0], self.knee_on_thigh)
        )
        hip = thigh + _turn(a[0], self.hip_on_thigh)
        thigh2 = hip - _turn(a[2], self.hip_on_thigh)
        shank2 = (
            thigh2 + _turn(a[2], self.knee_on_thigh) - _turn(a[3], self.knee_on_shank)
        )
        return np.concatenate(
            [hip, thigh, a[:1], shank, a[1:2], thigh2, a[2:3], shank2, a[3:]]
        )

    # Dynamics.

    def _gravity(self, slope):
        pull = np.zeros(COORDINATES)
        for body in (HIP, *THIGH, *SHANK):
            pull[body : body + 2] = self.g * np.sin(slope), -self.g * np.cos(slope)
        return self.mass * pull

    def motion(self, state, slope, locked):
        """Accelerations (14,) and constraint forces; the ground force is entries 8 and
        9.
        """
        jac, bias = self._constraints(
            self._links(state[:3]),
            self._links(state[3:]),
            0,
            (0, 1) if locked else (0,),
        )
        force = self._gravity(slope)
        torque = self.hip_torque(state)
        force[THIGH[1] + 2] += torque
        force[THIGH[0] + 2] -= torque
        return self._solve(jac, force, bias)

    def hip_torque(self, state):
        """Torque between the thighs, on the swing leg."""
        k = self.keys
        between, opening = state[1] - state[0], state[4] - state[3]
        spring = k.get("hip_stiffness", 0.0) * (between - k.get("hip_rest", 0.0))
        damper = k.get("hip_damping", 0.0) * opening
        return k.get("hip_torque", 0.0) - spring - damper

    def accelerations(self, state, slope, locked):
        """Angular accelerations of stance leg, thigh and shank."""
        return self.motion(state, slope, locked)[0][
            [THIGH[0] + 2, THIGH[1] + 2, SHANK[1] + 2]
        ]

    def ground_force(self, state, slope, locked):
        """Force of the ground on the stance foot, (down the slope, normal)."""
        return self.motion(state, slope, locked)[1][8:10]

    def energy(self, state, slope):
        """Kinetic, potential and total energy; potential is zero at the ground under
        theta = 0.
        """
        kinetic = 0.5 * self.mass @ self.velocities(state) ** 2
        potential = -self._gravity(slope) @ self.positions(state)
        return {
            "kinetic": kinetic,
            "potential": potential,
            "total": kinetic + potential,
        }

    def push(self, state, velocities, locked):
        """Velocities after the push-off of leg 0, and its work: its foot leaves the
        ground, and the other has not struck.
        """
        impulse = self.keys.get("push_off", 0.0)
        angles = self._links(state[:3])
        there, _ = self._constraints(angles, np.zeros(4), 0, locked)
        free, _ = self._constraints(angles, np.zeros(4), None, locked)
        contact = there[8:10]
        positions = self.positions(state)
        on_ground = positions[SHANK[0] : SHANK[0] + 2].copy()
        on_ground += _turn(angles[1], self.centre_on_shank) - [0.0, self.radius]
        toward_hip = positions[HIP : HIP + 2] - on_ground
        direction = toward_hip / np.linalg.norm(toward_hip)
        after, _ = self._solve(
            free,
            self.mass * velocities + impulse * direction @ contact,
            np.zeros(len(free)),
        )
        work = 0.5 * self.mass @ after**2 - 0.5 * self.mass @ velocities**2
        return after, work

    def _impact(self, state, contact, locked):
        before = self.velocities(state)
        if contact == 1:
            before, self.push_work = self.push(state, before, locked)
        jac, _ = self._constraints(self._links(state[:3]), np.zeros(4), contact, locked)
        after, impulse = self._solve(jac, self.mass * before, np.zeros(len(jac)))
        loss = 0.5 * self.mass @ before**2 - 0.5 * self.mass @ after**2
        return after, impulse[8:10], loss

    def kneestrike(self, state):
        """Lock the swing knee, the stance foot rolling on; state, ground impulse and
        loss.
        """
        v, impulse, loss = self._impact(state, 0, (0, 1))
        rate = v[THIGH[1] + 2]
        after = np.array([state[0], state[1], state[1], v[THIGH[0] + 2], rate, rate])
        return after, impulse, loss

    def heelstrike(self, state):
        """Stop the swing foot, release the other; the new swing knee is free with
        knees, or locked until just after it.
        """
        is_free = self.knees and self.keys.get("trailing_knee") != "locked"
        v, impulse, loss = self._impact(state, 1, (1,) if is_free else (0, 1))
        rates = v[[THIGH[1] + 2, THIGH[0] + 2, SHANK[0] + 2]]
        if not is_free:  # equal but for rounding
            rates[2] = rates[1]
        return np.array([state[1], state[0], state[0], *rates]), impulse, loss


class SimplestWalker(Stepper):
    """The walker with vanishing foot mass, from Garcia, Chatterjee, Ruina & Coleman
    (1998).

    Length, gravity and hip mass are one. phi is the angle between the legs.
    """

    def accelerations(self, state, slope, locked):
        """Accelerations from the published pair of equations (1998, eq. 1 and 2)."""
        theta, phi, rate = state[0], state[0] - state[1], state[3]
        stance = np.sin(theta - slope)
        inter = stance + rate**2 * np.sin(phi) - np.cos(theta - slope) * np.sin(phi)
        return np.array([stance, stance - inter, stance - inter])

    def ground_force(self, state, slope, locked):
        """Force along the massless stance leg that carries the hip on its circle."""
        size = np.cos(state[0] - slope) - state[3] ** 2
        return size * np.array([-np.sin(state[0]), np.cos(state[0])])

    def energy(self, state, slope):
        """Kinetic, potential and total energy of the hip mass."""
        kinetic, potential = 0.5 * state[3] ** 2, np.cos(state[0] - slope)
        return {
            "kinetic": kinetic,
            "potential": potential,
            "total": kinetic + potential,
        }

    def heelstrike(self, state):
        """The published jump (1998, eq. 4): cos 2 theta, and 1 - cos 2 theta between
        the legs.
        """
        theta, rate = state[0], state[3]
        stance = np.cos(2 * theta) * rate
        thigh = stance - stance * 2 * np.sin(theta) ** 2
        loss = 0.5 * (rate * np.sin(2 * theta)) ** 2
        impulse = stance * np.array([-np.cos(theta), np.sin(theta)]) - rate * np.array(
            [-np.cos(theta), -np.sin(theta)]
        )
        return np.array([-theta, theta, theta, stance, thigh, thigh]), impulse, loss
