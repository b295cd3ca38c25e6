"""Pseudo-arclength continuation: predictor, corrector and step control.

What is continued are the zeros Z of any equations with one more unknown than there are
of them: branches of gaits (`tracking`), of any number of steps, and curves of special
points (`curves`). Lanes have points of their own and share nothing but the
call. In shapes, n counts lanes and c coordinates of Z.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.root import hermite, passes
from gaitsweep.tasks.mechanics.arrays import Coordinates, Marks, Numbers, PerLane
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.iterate import Ended, iterate
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes

#: Points beyond which a curve may have closed.
_LEAST_CLOSED = 3

#: Equations of some lanes at their points Z (c, n), to first order, a dataclass: their
#: `residual` (c - 1, n) and its `derivative` (c - 1, c, n); and the size of a bordered
#: Newton step that rounding makes (n,), by the bordered matrix (n, c, c).
Linearise = Callable[[ndarray, ndarray], Any]
RoundingStep = Callable[[ndarray, Any], "ndarray | float"]
#: One equation more: by the numbers of lanes (j,), the other equations there, the
#: Newton steps that led to their points (c, j) and whether these have grown (j,), its
#: derivatives (c, j) and its values (j,).
Border = Callable[[ndarray, Any, ndarray, ndarray], "tuple[ndarray, ndarray]"]


@dataclass(frozen=True)
class Newton:
    """When bordered Newton ends.

    A lane is lost after `max_iterations`, or a step larger than `max_step`. It has
    converged after a step that is rounding, or `enough` in all coordinates, or after one
    below `small` that is larger than `shrinking` times the one before.
    """

    max_iterations: int
    max_step: float
    small: float
    shrinking: float
    enough: float = 0.0


@dataclass
class Point:
    """Points of n lanes that solve equations, as Newton's method found them.

    Attributes
    ----------
    Z, direction : ndarray, shape (c, n)
        The points and the tangents there, of length one, to the side on which the
        border's equation grows. Where keys are free, `Z` are X, all unknowns of
        `equations.Equations`.
    ok : ndarray of bool, shape (n,)
        Whether Newton converged.
    last_step, rounding : ndarray, shape (n,)
        Size of the last step, infinite where there was none, and of one that rounding
        alone makes.
    rows : ndarray, shape (c, n)
        Derivatives of the border's equation.
    at : object
        The equations there, to first order: at the point or a Newton step away, as
        what corrected it linearises them; `equations.solve` leaves those of the gait.
    """

    Z: Coordinates
    direction: Coordinates
    ok: Marks
    last_step: PerLane
    rounding: PerLane
    rows: Coordinates
    at: Any

    @property
    def error(self) -> ndarray:
        """Bound on the error of Z, infinite where Newton did not converge, shape (n,)."""
        return np.where(self.ok, self.rounding + 2 * self.last_step, np.inf)

    def oriented(self, direction: Coordinates) -> Point:
        """Return the points with their tangents turned to the side of some directions
        (c, n).
        """
        sign = np.where(total(self.direction * direction) < 0, -1.0, 1.0)
        return replace(self, direction=sign * self.direction)


def bordered_matrix(derivative: ndarray, border: Coordinates) -> ndarray:
    """Return the matrix (n, c, c) of equations with derivatives (c - 1, c, n) and of
    one more, (c, n).
    """
    return np.concatenate([derivative, border[None]]).transpose(2, 0, 1)


def _solve_bordered(
    matrix: ndarray, right: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Solve linear systems, and find the directions in which all equations but the last
    stay satisfied.

    Parameters
    ----------
    matrix : ndarray, shape (n, c, c)
        Becomes the identity, in place, where there is no solution.
    right : ndarray, shape (c, n)

    Returns
    -------
    solution, direction : ndarray, shape (c, n)
        Along the direction the last equation's value grows by 1; both are 0 where there
        is no solution.
    solvable : ndarray of bool, shape (n,)
    """
    solvable = np.isfinite(matrix).all(axis=(1, 2))
    solvable &= np.isfinite(right).all(axis=0)
    both = np.zeros((*right.T.shape, 2))
    both[..., 0] = right.T
    both[:, -1, 1] = 1.0
    try:
        solution = np.linalg.solve(matrix[solvable], both[solvable])
    except np.linalg.LinAlgError:  # one of them is singular to the last digit
        solvable[solvable] = np.linalg.det(matrix[solvable]) != 0
        solution = np.linalg.solve(matrix[solvable], both[solvable])

    both[:] = 0.0
    both[solvable] = solution
    matrix[~solvable] = np.eye(matrix.shape[1])
    return both[..., 0].T, both[..., 1].T, solvable


def _plane(Z: Coordinates, normal: ndarray) -> Border:
    """The equations of planes normal to some directions through points Z as they are
    now, wherever these move.
    """
    start = Z.copy()

    def equation(lanes: Numbers, *_: Any) -> tuple[ndarray, ndarray]:
        rows = normal[:, lanes]
        return rows, total(rows * (Z[:, lanes] - start[:, lanes]))

    return equation


# Where a strike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def bordered_newton(
    linearise: Linearise,
    rounding_step: RoundingStep,
    limits: Newton,
    Z: Coordinates,
    border: Coordinates | Border,
    sized: Sequence[int] | slice = slice(None),
) -> Point:
    """Solve for the zeros at which one equation more holds, by Newton's method.

    Parameters
    ----------
    linearise : callable
        The equations of lanes, ndarray of int (j,), at points (c, j).
    rounding_step : callable
        Size of a step that rounding alone makes.
    limits : Newton
    Z : ndarray, shape (c, n)
        Predicted points.
    border : ndarray, shape (c, n), or callable
        Directions of planes through the predicted points in which the zeros lie, or
        another equation.
    sized : sequence of int
        Coordinates whose largest change is the size of a step.

    Returns
    -------
    Point
    """
    n = Z.shape[1]
    search = _BorderedNewton(linearise, rounding_step, limits, Z, border, sized)
    if not n:
        search.step(np.arange(0), 0)  # equations of no lanes are still equations
    ended = iterate(search, n, limits.max_iterations)
    return search.reached(ended == Ended.CONVERGED)


class _BorderedNewton:
    """The rule of bordered Newton, with arguments as `bordered_newton` has them."""

    def __init__(
        self,
        linearise: Linearise,
        rounding_step: RoundingStep,
        limits: Newton,
        Z: Coordinates,
        border: Coordinates | Border,
        sized: Sequence[int] | slice,
    ):
        self.linearise = linearise
        self.rounding_step = rounding_step
        self.limits = limits
        self.sized = sized

        n = Z.shape[1]
        self.Z = Z.copy()
        self.equation = border if callable(border) else _plane(self.Z, border)
        self.change = np.zeros_like(Z)
        self.direction = np.zeros_like(Z)
        self.rows = np.zeros_like(Z)
        self.grown = np.zeros(n, bool)
        self.size = np.full(n, np.inf)
        self.rounding = np.full(n, np.inf)
        self.at: Any = None

    def step(self, lanes: Numbers, taken: int) -> ndarray:
        system = self.linearise(lanes, self.Z[:, lanes])
        last, grown = self.change[:, lanes], self.grown[lanes]
        rows, value = self.equation(lanes, system, last, grown)
        matrix = bordered_matrix(system.derivative, rows)
        right = -np.vstack([system.residual, value])
        change, direction, solvable = _solve_bordered(matrix, right)

        size = np.abs(change[self.sized]).max(axis=0)
        size[~solvable] = np.inf
        moving = size <= self.limits.max_step
        self.Z[:, lanes[moving]] += change[:, moving]
        self.rounding[lanes] = self.rounding_step(matrix, system)
        ended = self._ended(lanes, size, change)
        self.grown[lanes] = size > self.size[lanes]
        self.size[lanes] = size

        self.change[:, lanes] = change
        self.direction[:, lanes] = direction
        self._keep(lanes, system, rows)
        return ended

    def _keep(self, lanes: Numbers, system: Any, rows: Coordinates) -> None:
        """Keep the equations of some lanes: one that is done keeps those of its own
        last step, so its bits do not depend on the others.
        """
        self.rows[:, lanes] = rows
        if self.at is None or len(lanes) == len(self.size):
            self.at = system
        else:
            replace_lanes(self.at, lanes, system)

    def _ended(self, lanes: Numbers, size: PerLane, change: Coordinates) -> ndarray:
        """Why lanes end after steps of some sizes, or that they go on; what only leads
        to others is accurate enough by the largest change of all coordinates.
        """
        limits = self.limits
        largest = np.abs(change).max(axis=0)
        at_rest = (size <= self.rounding[lanes]) | (largest <= limits.enough)
        shrinks = size <= limits.shrinking * self.size[lanes]
        is_last = at_rest | ((size < limits.small) & ~shrinks)
        ended = np.where(is_last, Ended.CONVERGED, Ended.RUNNING)
        ended[~(size <= limits.max_step)] = Ended.DIVERGED
        return ended

    def reached(self, ok: Marks) -> Point:
        """Return the points reached, of which some (n,) are solutions."""
        length = norm(self.direction)
        length[length == 0] = 1.0  # in lanes that are lost
        return Point(
            Z=self.Z,
            direction=self.direction / length,
            ok=ok,
            last_step=self.size,
            rounding=self.rounding,
            rows=self.rows,
            at=self.at,
        )


@dataclass(frozen=True)
class StepControl:
    """Which steps along a curve are accepted, and how long the next is.

    A step is refused if the corrected point is farther from the predicted one than
    `max_error`, or than `max_bend` times the step, or if the tangent turns by more than
    the angle of cosine `min_cosine`; the next is `reduction` times as long. After an
    accepted one it is (`target` / a measure of its error)^`power` times as long, within
    `growth`.
    """

    shortest: float
    longest: float
    min_cosine: float
    target: float
    power: float
    growth: tuple[float, float]
    reduction: float
    max_error: float = np.inf
    max_bend: float = np.inf

    def accepts(self, error: PerLane, step: PerLane, cosine: PerLane) -> ndarray:
        """Whether steps may be accepted, shape (n,).

        Parameters
        ----------
        error : ndarray, shape (n,)
            Distance of the corrected from the predicted points.
        step : ndarray, shape (n,)
        cosine : ndarray, shape (n,)
            Of the angle between the tangents before and after.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        return np.asarray(
            (error < self.max_error)
            & (error < self.max_bend * step)
            & (cosine > self.min_cosine)
        )

    def after(self, step: PerLane, measure: PerLane) -> ndarray:
        """Length of the next steps after accepted ones, shape (n,).

        Parameters
        ----------
        step : ndarray, shape (n,)
        measure : ndarray, shape (n,)
            What is to be near `target`.

        Returns
        -------
        ndarray, shape (n,)
        """
        factor = (self.target / np.maximum(measure, 1e-12)) ** self.power
        return np.minimum(self.longest, step * np.clip(factor, *self.growth))


#: Why a track stops that returns to its start, that could be continued no further, or
#: that has the most points.
CLOSED, NO_FURTHER, TOO_MANY = "closed", "no further point", "too many points"


@dataclass(frozen=True)
class Track:
    """A curve followed in one direction from a point.

    Attributes
    ----------
    Z, tangent : ndarray, shape (c, p)
        Its points in order, and the unit tangents there, along the track.
    stop_reason : str
        Why it stops at its last point.
    """

    Z: Coordinates
    tangent: Coordinates
    stop_reason: str


def joined(down: Track, up: Track) -> tuple[ndarray, ndarray]:
    """Return the points and tangents (c, p) of both directions from one point, in the
    order of the track up.
    """
    Z = np.hstack([down.Z[:, :0:-1], up.Z])
    tangent = np.hstack([-down.tangent[:, :0:-1], up.tangent])
    return Z, tangent


class Tracks(ABC):
    """Curves in progress: the last points of n of them, all points in the order they
    were found, and why they stopped.

    Whoever follows curves says how their points are corrected, which are fair, and
    where they stop.

    Attributes
    ----------
    Z, tangent : ndarray, shape (c, n)
        Last points and the tangents there, along the tracks.
    turning : ndarray, shape (c, n)
        How fast the tangents turned over the last steps.
    step : ndarray, shape (n,)
        Length of the next steps.
    count : ndarray of int, shape (n,)
        Points so far.
    stop : ndarray of str, shape (n,)
        Why they stopped; empty where they go on.
    """

    def __init__(
        self,
        control: StepControl,
        Z: Coordinates,
        tangent: Coordinates,
        step: float | PerLane,
    ):
        n = Z.shape[1]
        self.control = control
        self.Z = Z.copy()
        self.tangent = tangent.copy()
        self.turning = np.zeros(Z.shape)
        self.step = np.full(n, step)
        self.first = Z.copy(), tangent.copy()
        # The points before the last ones, the tangents there, and the distances; 0
        # where there are none.
        self.before = Z.copy(), tangent.copy()
        self.back = np.zeros(n)

        self.count = np.zeros(n, int)
        self.stop = np.full(n, "", object)
        self.log: list[tuple[ndarray, ndarray, ndarray]] = []
        self.record(np.arange(n))

    @abstractmethod
    def correct(
        self, tracks: Numbers, guess: Coordinates, border: Coordinates
    ) -> Point:
        """Corrected points of some tracks (j,), of predicted ones (c, j), in planes
        normal to (c, j).
        """

    def judge(
        self, tracks: Numbers, point: Point, guess: Coordinates, error: PerLane
    ) -> tuple[ndarray, ndarray]:
        """Which corrected points are fair (j,), besides what the step control demands,
        and what that keeps near target.

        They are given with the predicted ones (c, j) and the distances between them
        (j,).
        """
        return np.ones(len(tracks), bool), error

    def reasons(self, tracks: Numbers, point: Point, last: Coordinates) -> ndarray:
        """Why some tracks (j,) stop at points that follow on others (c, j); empty where
        they go on.
        """
        return np.full(len(tracks), "", object)

    def follow(self, most: int) -> list[Track]:
        """Follow all tracks until each stops: for a reason, or after the most points."""
        while len(active := np.flatnonzero(self.stop == "")):
            last = self.Z[:, active], self.tangent[:, active]
            point, fair = self.advance(active)
            new = active[fair]
            if not fair.all():
                point, last = lanes_of((point, last), fair)
            self.record(new)

            self.stop[new] = self.reasons(new, point, last[0])
            too_many = (self.stop[new] == "") & (self.count[new] >= most)
            self.stop[new[too_many]] = TOO_MANY
            # Whatever lies beyond: it has been there.
            now = self.Z[:, new], self.tangent[:, new]
            closes = passes(lanes_of(self.first, new), last, now)
            closes &= self.count[new] > _LEAST_CLOSED
            self.stop[new[closes]] = CLOSED

            refused = active[~fair]
            is_short = self.step[refused] < self.control.shortest
            self.stop[refused[is_short]] = NO_FURTHER

        return self._followed()

    def _followed(self) -> list[Track]:
        """The tracks with all points that were found."""
        owners, points, tangents = zip(*self.log, strict=True)
        order = np.argsort(np.concatenate(owners), kind="stable")
        bounds = np.cumsum(self.count)[:-1]
        Z = np.split(np.hstack(points)[:, order], bounds, axis=1)
        tangent = np.split(np.hstack(tangents)[:, order], bounds, axis=1)
        return list(map(Track, Z, tangent, self.stop.tolist()))

    def record(self, tracks: Numbers) -> None:
        """Add the last points of tracks to what was found."""
        self.count[tracks] += 1
        self.log.append((tracks, self.Z[:, tracks], self.tangent[:, tracks]))

    def advance(self, active: Numbers) -> tuple[Point, ndarray]:
        """Try a step of some tracks.

        Parameters
        ----------
        active : ndarray of int, shape (j,)

        Returns
        -------
        point : Point
            The corrected points.
        fair : ndarray of bool, shape (j,)
            Which of them were accepted; the next step of the other tracks is shorter.
        """
        h = self.step[active]
        border = self.tangent[:, active].copy()
        guess = self.Z[:, active] + h * border + 0.5 * h * h * self.turning[:, active]
        point = self.correct(active, self._near(active, guess, border), border)

        error = norm(point.Z - guess)
        cosine = total(point.direction * border)
        fair, measure = self.judge(active, point, guess, error)
        fair = fair & point.ok & self.control.accepts(error, h, np.abs(cosine))

        new = active[fair]
        tangent = np.where(cosine >= 0, point.direction, -point.direction)
        self._move(new, point.Z[:, fair], tangent[:, fair])
        self.step[new] = self.control.after(h[fair], measure[fair])
        self.step[active[~fair]] *= self.control.reduction
        return point, fair

    def _move(self, tracks: Numbers, Z: Coordinates, tangent: Coordinates) -> None:
        """Make points Z (c, j) the last ones of some tracks (j,)."""
        last, last_tangent = self.Z[:, tracks], self.tangent[:, tracks]
        chord = norm(Z - last)
        # The tangent keeps turning as over the last step.
        self.turning[:, tracks] = (tangent - last_tangent) / chord
        self.before[0][:, tracks] = last
        self.before[1][:, tracks] = last_tangent
        self.back[tracks] = chord
        self.Z[:, tracks] = Z
        self.tangent[:, tracks] = tangent

    def _near(
        self, active: Numbers, guess: Coordinates, border: Coordinates
    ) -> ndarray:
        """Where Newton's method begins in the planes of the predicted points: on the
        cubic through the last two.
        """
        # Before a fall it converges only from so near that a parabola allows but tiny
        # steps.
        has_two = self.back[active] > 0
        length = np.where(has_two, self.back[active], 1.0)
        a, b = lanes_of((self.before, (self.Z, self.tangent)), active)
        share = 1 + self.step[active] / length
        off = hermite(a, b, length, share) - guess
        in_plane = off - border * total(border * off)
        return guess + np.where(has_two, in_plane, 0.0)
