"""A walker's step map with its constants filled in: one walker for all lanes, or one
for each.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import TypeVar

import numpy as np

from gaitsweep.tasks.mechanics.lumped import Structure, constants_of
from gaitsweep.tasks.step.drive import (
    OVER_SLOPE,
    SLOPE,
    Drive,
    over_slopes,
    unit_of_impulse,
)
from gaitsweep.tasks.step.several_steps import AnyStride, StepSequence
from gaitsweep.tasks.step.step_map import StrideMap, stride_map
from gaitsweep.tasks.walkers.walker import Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray

EPS = np.finfo(float).eps

AnyProblem = TypeVar("AnyProblem", bound="Problem")


class Problem:
    """One walker's step map, or that of several steps in a row, with its constants
    filled in.

    `map` is that of all `steps` after which gaits repeat, `step` that of one. `m` is
    the number of the section coordinates of all of them, and `phases` that of their
    phases: 2 a step for knees, 1 for straight legs.
    """

    map: StrideMap | StepSequence
    step: StrideMap
    #: Columns of `constants` that the lanes have.
    lanes: slice | np.ndarray = slice(None)
    #: What gaits are followed over: the slope, or push-off or torque at one slope.
    drive: Drive

    def __init__(self, walker: Walker, steps: int = 1, drive: Drive = OVER_SLOPE):
        self.drive = drive
        structure = drive.structure(walker)
        self.walker = walker
        self.constants = constants_of(WalkerArray.of([walker]), structure)
        self._set(structure, steps)

    def _set(self, structure: Structure, steps: int) -> None:
        """Set what the structure and the number of steps decide."""
        self.structure, self.steps, self.step = structure, steps, stride_map(structure)
        self.map = self.step if steps == 1 else StepSequence(self.step, steps)
        self.m, self.phases = self.map.m, steps * (2 if structure.kneed else 1)

    def of_steps(self, steps: int) -> Problem:
        """Return the same walker's problem of so many steps."""
        if steps == self.steps:
            return self
        other = copy.copy(self)
        other._set(self.structure, steps)
        return other

    def slopes(self, drive: np.ndarray) -> np.ndarray:
        """Return the slopes [rad] at values of the drive, shape (n,)."""
        return self.drive.slopes(drive)

    @property
    def features(self) -> tuple[str, ...]:
        """What some variables are of, as `Walker.features` has it."""
        return self.structure.features

    def impulses(self, n: int) -> np.ndarray:
        """Return the impulses of the push-off of n lanes, shape (n,) [mass sqrt(g leg)]."""
        walker = self.every_walker
        own = walker.push_off / unit_of_impulse(walker)
        return np.asarray(np.broadcast_to(own, n))

    def driven_by(self, drive: float) -> Problem:
        """Return the problem of the walker that has a value of the drive, one for all
        lanes, over the slope.
        """
        if self.drive.key == SLOPE:
            return self.over(OVER_SLOPE)
        assert self.constants.shape[1] == 1, "several walkers: `lanes_at` has them"
        other = self.over(OVER_SLOPE)
        other.walker, _ = self.drive.at(self.walker, drive)
        other.constants = constants_of(WalkerArray.of([other.walker]), self.structure)
        return other

    def at_slopes(
        self, drive: np.ndarray
    ) -> Iterator[tuple[np.ndarray, Problem, np.ndarray]]:
        """Yield the problems over slopes of the walkers that values of the drive make:
        which of the values (n,) each is of, and their slopes as it counts them. Values
        that are not finite make none.
        """
        if self.drive.key == SLOPE:
            yield np.arange(len(drive)), self, drive
            return

        for value in np.unique(drive[np.isfinite(drive)]).tolist():
            numbers = np.flatnonzero(drive == value)
            over, counted = over_slopes(float(self.slopes(drive[numbers[:1]])[0]))
            walker = self.driven_by(value)
            yield numbers, walker.over(over), np.full(len(numbers), counted)

    def walkers_at(self, drive: np.ndarray) -> Walker:
        """Return the walkers that values of the drive (n,) make, as an array; where the
        slope drives, those of the lanes.
        """
        if self.drive.key == SLOPE:
            return self.every_walker
        return self.drive.walkers(self.every_walker, drive)

    def lanes_at(self, drive: np.ndarray) -> tuple[Problem, np.ndarray]:
        """Return the problem over slopes of the walkers that values of the drive (n,)
        make, in a lane for each, and their slopes as it counts them.
        """
        if self.drive.key == SLOPE:
            return self, drive
        assert self.drive.base is not None
        over, counted = over_slopes(self.drive.base)
        walkers = self.drive.walkers(self.every_walker, drive)
        lanes = Lanes(walkers, self.structure, over, self._constants_at(drive))
        return lanes.of_steps(self.steps), np.full(len(drive), counted)

    def _constants_at(self, drive: np.ndarray) -> np.ndarray:
        """The structure's constants of every lane, shape (constants, n)."""
        constants = self.constants[:, self.lanes]
        constants = np.broadcast_to(constants, (len(constants), len(drive)))
        return self.drive.constants(self.structure, constants, drive)

    def over(self: AnyProblem, drive: Drive) -> AnyProblem:
        """Return the same walkers' problem, with slopes counted as a drive has them."""
        if drive == self.drive:
            return self
        other = copy.copy(self)
        other.drive = drive
        return other

    def parameters(self, drive: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Runtime parameters of every lane.

        Parameters
        ----------
        drive : ndarray, shape (n,)
            The slope [rad], or another drive as `Drive` counts it.
        scale : ndarray, shape (n,)
            Power of two by which angles and rates are divided.

        Returns
        -------
        ndarray, shape (n_parameters, n)
        """
        return np.vstack([self.slopes(drive), scale, self._constants_at(drive)])

    def some(self, lanes: np.ndarray | slice) -> Problem:
        """Return the problem of some lanes: the same where all lanes share a walker.

        Parameters
        ----------
        lanes : ndarray of int, shape (k,), or slice
        """
        return self

    @property
    def every_walker(self) -> Walker:
        """The walker, or those of all lanes as an array."""
        return self.walker

    def walker_of(self, lane: int) -> Walker:
        """Return the walker of a lane."""
        return self.walker

    def alone(self, lane: int) -> Problem:
        """Return the problem of one lane's walker."""
        return self

    def stride(
        self,
        w: np.ndarray,
        log_slope: np.ndarray,
        by_drive: bool = False,
        samples: int = 0,
        coarse: bool = False,
    ) -> tuple[AnyStride, np.ndarray]:
        """Evaluate steps at similarity coordinates.

        Parameters
        ----------
        w : ndarray, shape (m + phases, n)
            ln(angle), rates/angle, event times: of order one over decades of slope.
        log_slope : ndarray, shape (n,)
            ln of the slope in rad.
        by_drive : bool
            Also differentiate by what drives, the slope most often.
        samples : int
            Equal intervals of each phase at whose ends the motion is also returned.
        coarse : bool
            Integrate to the search's tolerance only.

        Returns
        -------
        stride : Stride
        scale : ndarray, shape (n,)
            Power of two by which its angles and rates are divided.
        """
        y, scale = self.section(w)
        stride = self.map(
            y,
            w[self.m :],
            self.parameters(np.exp(log_slope), scale),
            by_drive,
            samples,
            coarse,
        )
        return stride, scale

    def without_derivatives(
        self, w: np.ndarray, log_slope: np.ndarray, samples: int = 0
    ) -> AnyStride:
        """Evaluate steps as `stride` does, but for their derivatives."""
        y, scale = self.section(w)
        parameters = self.parameters(np.exp(log_slope), scale)
        return self.map.without_derivatives(y, w[self.m :], parameters, samples)

    def section(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Scaled section coordinates of similarity coordinates, and the power of two
        that divides them.

        Parameters
        ----------
        w : ndarray, shape (m or more, n)

        Returns
        -------
        y : ndarray, shape (m, n)
        scale : ndarray, shape (n,)
        """
        angle = np.exp(w[0])
        scale = scale_of(angle)
        return np.vstack([angle, angle * w[1 : self.m]]) / scale, scale

    def start(self, y: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """State just after heelstrike of section states; of those of several steps, of
        the first.

        Parameters
        ----------
        y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        drive : ndarray, shape (n,)
            As for `parameters`.

        Returns
        -------
        ndarray, shape (4, n) [rad, rad/sqrt(leg/g)]
            Stance angle and the rates of stance leg, thigh and shank.
        """
        scale, size = scale_of(y[0]), self.map.start_size
        state = self.map.start(y / scale, self.parameters(drive, scale))[:size] * scale
        return state[[0, size // 2, size // 2 + 1, size - 1]]

    def section_of(self, state: np.ndarray, drive: np.ndarray) -> np.ndarray:
        """Section coordinates of states just after heelstrike: what `start` takes to
        them.

        Parameters
        ----------
        state : ndarray, shape (3, n) [rad, rad/sqrt(leg/g)]
            Stance angle, stance rate and thigh rate.
        drive : ndarray, shape (n,)
            As for `parameters`.

        Returns
        -------
        ndarray, shape (m, n)
            For kneed walkers with the rates just before the heelstrike, of which those
            after it are linear functions, but for what a push-off adds.
        """
        if not self.structure.kneed:
            return state[: self.m].copy()

        scale, size = scale_of(state[0]), self.map.start_size
        at_rest = np.vstack([state[:1] / scale, np.zeros_like(state[1:])])
        start = self.map.start(at_rest, self.parameters(drive, scale))
        rates = [size // 2, size // 2 + 1]
        by_y = start[size:].reshape(size, 3, -1)
        matrix = by_y[rates, 1:].transpose(2, 0, 1)
        gained = state[1:] - start[rates] * scale
        before = np.linalg.solve(matrix, gained.T[:, :, None])[:, :, 0].T
        return np.vstack([state[:1], before])


class Lanes(Problem):
    """The step map with a walker of its own in every lane; all are of one structure.

    Parameters
    ----------
    walkers : WalkerArray or sequence of Walker
        Lane i has walker i; they are kept as an array.
    structure : Structure, optional
        By default the first walker's.
    drive : Drive
    constants : ndarray, shape (constants, n), optional
        The structure's, where they are known.
    """

    lanes: np.ndarray

    def __init__(
        self,
        walkers: WalkerArray | Sequence[Walker],
        structure: Structure | None = None,
        drive: Drive = OVER_SLOPE,
        constants: np.ndarray | None = None,
    ):
        self.drive = drive
        self.walkers = (
            walkers if isinstance(walkers, WalkerArray) else WalkerArray.of(walkers)
        )
        self.walker = walkers[0]
        self._set(structure or drive.structure(self.walker), 1)
        if constants is None:
            constants = constants_of(self.walkers, self.structure)
        self.constants = constants
        self.lanes = np.arange(len(walkers))

    def some(self, lanes: np.ndarray | slice) -> Lanes:
        """Return the problem of some lanes, each with its walker.

        Parameters
        ----------
        lanes : ndarray of int, shape (k,), or slice
        """
        some = copy.copy(self)
        some.lanes = self.lanes[lanes]
        return some

    @property
    def every_walker(self) -> WalkerArray:
        """The walkers of all lanes."""
        return self.walkers.some(self.lanes)

    def walker_of(self, lane: int) -> Walker:
        """Return the walker of a lane."""
        return self.walkers[self.lanes[lane]]

    def alone(self, lane: int) -> Problem:
        """Return the problem of one lane's walker."""
        alone = Problem.__new__(Problem)
        alone.drive = self.drive
        alone.walker = self.walker_of(lane)
        alone.constants = self.constants[:, [self.lanes[lane]]]
        alone._set(self.structure, self.steps)
        return alone


def scale_of(angle: np.ndarray) -> np.ndarray:
    """Power of two by which angles and rates of a step from a stance angle are divided."""
    return np.asarray(np.exp2(np.floor(np.log2(angle))))


def sizes(y: np.ndarray) -> np.ndarray:
    """Scales by which errors of (angle, rates...) are relative: the angle, and for
    every rate the largest of them.

    Parameters
    ----------
    y : ndarray, shape (m, n)

    Returns
    -------
    ndarray, shape (m, n)
    """
    rates = y[1:]
    return np.vstack(
        [np.abs(y[:1]), np.broadcast_to(np.abs(rates).max(axis=0), rates.shape)]
    )


def joint_sizes(y: np.ndarray, phases: int) -> np.ndarray:
    """Scales of y, as `sizes` has them, and of the event times, which are of order one.

    Parameters
    ----------
    y : ndarray, shape (m, n)
    phases : int

    Returns
    -------
    ndarray, shape (m + phases, n)
    """
    return np.vstack([sizes(y), np.ones((phases, y.shape[1]))])


def residual_sizes(y: np.ndarray, phases: int) -> np.ndarray:
    """Scales of the joint residual: those of y, and the stance angle for the guards of
    the strikes.

    Parameters
    ----------
    y : ndarray, shape (m, n)
    phases : int

    Returns
    -------
    ndarray, shape (m + phases, n)
    """
    return np.vstack([sizes(y), np.broadcast_to(np.abs(y[:1]), (phases, y.shape[1]))])
