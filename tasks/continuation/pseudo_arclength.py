"""Pseudo-arclength continuation: predictor, corrector and step control.

What is continued are the zeros Z of any equations with one more unknown than there are
of them: branches of gaits (`tracking`), of any number of steps, and curves of special
points (`codimension_one`). Lanes have points of their own and share nothing but the
call. In shapes, n counts lanes and c coordinates of Z.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gaitsweep.tasks.continuation.root import hermite, passes
from gaitsweep.tasks.mechanics.sums import norm, total
from gaitsweep.tasks.step.lanes import lanes_of, replace_lanes

#: Points beyond which a curve may have closed.
_LEAST_CLOSED = 3

#: Equations of some lanes at their points Z (c, n), to first order, a dataclass: their
#: `residual` (c - 1, n) and its `derivative` (c - 1, c, n); and the size of a bordered
#: Newton step that rounding makes (n,), by the bordered matrix (n, c, c).
Linearise = Callable[[np.ndarray, np.ndarray], Any]
RoundingStep = Callable[[np.ndarray, Any], "np.ndarray | float"]
#: One equation more: by the numbers of lanes (j,), the other equations there, the
#: Newton steps that led to their points (c, j) and whether these have grown (j,), its
#: derivatives (c, j) and its values (j,).
Border = Callable[
    [np.ndarray, Any, np.ndarray, np.ndarray], "tuple[np.ndarray, np.ndarray]"
]


@dataclass(frozen=True)
class Newton:
    """When bordered Newton ends.

    A lane is lost after `max_iterations`, or a step larger than `max_step`. It has
    converged after a step that is rounding or `enough`, or after one below `small` that
    is larger than `shrinking` times the one before.
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
        border's equation grows.
    ok : ndarray of bool, shape (n,)
        Whether Newton converged.
    last_step, rounding : ndarray, shape (n,)
        Size of the last step, infinite where there was none, and of one that rounding
        alone makes.
    rows : ndarray, shape (c, n)
        Derivatives of the border's equation.
    at : object
        The equations there, to first order: at the point or a Newton step away.
    """

    Z: np.ndarray
    direction: np.ndarray
    ok: np.ndarray
    last_step: np.ndarray
    rounding: np.ndarray
    rows: np.ndarray
    at: Any

    @property
    def error(self) -> np.ndarray:
        """Bound on the error of Z, infinite where Newton did not converge, shape (n,)."""
        return np.where(self.ok, self.rounding + 2 * self.last_step, np.inf)

    def oriented(self, direction: np.ndarray) -> Point:
        """Return the points with their tangents turned to the side of some directions
        (c, n).
        """
        sign = np.where(total(self.direction * direction) < 0, -1.0, 1.0)
        return replace(self, direction=sign * self.direction)


def bordered_matrix(derivative: np.ndarray, border: np.ndarray) -> np.ndarray:
    """Return the matrix (n, c, c) of equations with derivatives (c - 1, c, n) and of
    one more, (c, n).
    """
    return np.concatenate([derivative, border[None]]).transpose(2, 0, 1)


def _solve_bordered(
    matrix: np.ndarray, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    solvable = np.isfinite(matrix).all(axis=(1, 2)) & np.isfinite(right).all(axis=0)
    both = np.zeros((*right.T.shape, 2))
    both[..., 0], both[:, -1, 1] = right.T, 1.0
    try:
        solution = np.linalg.solve(matrix[solvable], both[solvable])
    except np.linalg.LinAlgError:  # one of them is singular to the last digit
        solvable[solvable] = np.linalg.det(matrix[solvable]) != 0
        solution = np.linalg.solve(matrix[solvable], both[solvable])
    both[:] = 0.0
    both[solvable], matrix[~solvable] = solution, np.eye(matrix.shape[1])
    return both[..., 0].T, both[..., 1].T, solvable


def _plane(Z: np.ndarray, normal: np.ndarray) -> Border:
    """The equations of planes normal to some directions through points Z as they are
    now, wherever these move.
    """
    start = Z.copy()

    def equation(lanes: np.ndarray, *_: Any) -> tuple[np.ndarray, np.ndarray]:
        return normal[:, lanes], total(
            normal[:, lanes] * (Z[:, lanes] - start[:, lanes])
        )

    return equation


# Where a strike is tangential to the last digit the map has no derivative.
@np.errstate(invalid="ignore", over="ignore", divide="ignore")
def bordered_newton(
    linearise: Linearise,
    rounding_step: RoundingStep,
    limits: Newton,
    Z: np.ndarray,
    border: np.ndarray | Border,
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
    n, Z = Z.shape[1], Z.copy()
    equation = border if callable(border) else _plane(Z, border)
    step, direction, rows = (np.zeros_like(Z) for _ in range(3))
    ok, grown, last_step, rounding = (
        np.zeros(n, bool),
        np.zeros(n, bool),
        np.full(n, np.inf),
        np.full(n, np.inf),
    )
    active = np.arange(n)
    for _ in range(limits.max_iterations):
        system = linearise(active, Z[:, active])
        rows[:, active], value = equation(
            active, system, step[:, active], grown[active]
        )
        matrix = bordered_matrix(system.derivative, rows[:, active])
        change, along, solvable = _solve_bordered(
            matrix, -np.vstack([system.residual, value])
        )
        size, before = (
            np.where(solvable, np.abs(change[sized]).max(axis=0), np.inf),
            last_step[active],
        )
        moving = size <= limits.max_step
        Z[:, active[moving]] += change[:, moving]
        rounding[active] = rounding_step(matrix, system)
        at_rest = size <= np.maximum(rounding[active], limits.enough)
        done = moving & (
            at_rest | ((size < limits.small) & (size > limits.shrinking * before))
        )
        ok[active], grown[active], last_step[active] = done, size > before, size
        step[:, active], direction[:, active] = change, along
        # A lane that is done keeps its own last step, so its bits do not depend on the
        # others.
        if len(active) == n:
            at = system
        else:
            replace_lanes(at, active, system)
        active = active[moving & ~done]
        if not len(active):
            break
    length = norm(direction)
    length[length == 0] = 1.0  # in lanes that are lost
    return Point(Z, direction / length, ok, last_step, rounding, rows, at)


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

    def accepts(
        self, error: np.ndarray, step: np.ndarray, cosine: np.ndarray
    ) -> np.ndarray:
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

    def after(self, step: np.ndarray, measure: np.ndarray) -> np.ndarray:
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
        factor = np.clip(
            (self.target / np.maximum(measure, 1e-12)) ** self.power, *self.growth
        )
        return np.minimum(self.longest, step * factor)


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

    Z: np.ndarray
    tangent: np.ndarray
    stop_reason: str


def joined(down: Track, up: Track) -> tuple[np.ndarray, np.ndarray]:
    """Return the points and tangents (c, p) of both directions from one point, in the
    order of the track up.
    """
    return np.hstack([down.Z[:, :0:-1], up.Z]), np.hstack(
        [-down.tangent[:, :0:-1], up.tangent]
    )


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
        self, control: StepControl, Z: np.ndarray, tangent: np.ndarray, step: float
    ):
        self.control = control
        self.Z, self.tangent, self.turning = Z.copy(), tangent.copy(), np.zeros(Z.shape)
        self.step = np.full(Z.shape[1], step)
        # The points before the last ones, the tangents there, and the distances; 0
        # where there are none.
        self.before, self.back = (Z.copy(), tangent.copy()), np.zeros(Z.shape[1])
        n, self.first = Z.shape[1], (Z.copy(), tangent.copy())
        self.count, self.stop = np.zeros(n, int), np.full(n, "", object)
        self.log: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self.record(np.arange(n))

    @abstractmethod
    def correct(
        self, tracks: np.ndarray, guess: np.ndarray, border: np.ndarray
    ) -> Point:
        """Corrected points of some tracks (j,), of predicted ones (c, j), in planes
        normal to (c, j).
        """

    def judge(
        self, tracks: np.ndarray, point: Point, guess: np.ndarray, error: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which corrected points are fair (j,), besides what the step control demands,
        and what that keeps near target.

        They are given with the predicted ones (c, j) and the distances between them
        (j,).
        """
        return np.ones(len(tracks), bool), error

    def reasons(self, tracks: np.ndarray, point: Point, last: np.ndarray) -> np.ndarray:
        """Why some tracks (j,) stop at points that follow on others (c, j); empty where
        they go on.
        """
        return np.full(len(tracks), "", object)

    def follow(self, most: int) -> list[Track]:
        """Follow all tracks until each stops: for a reason, or after the most points."""
        while len(active := np.flatnonzero(self.stop == "")):
            last = self.Z[:, active], self.tangent[:, active]
            point, fair = self.advance(active)
            new, refused, last = active[fair], active[~fair], lanes_of(last, fair)
            self.record(new)
            self.stop[new] = self.reasons(new, lanes_of(point, fair), last[0])
            closes = passes(
                lanes_of(self.first, new), last, (self.Z[:, new], self.tangent[:, new])
            )
            self.stop[new[(self.stop[new] == "") & (self.count[new] >= most)]] = (
                TOO_MANY
            )
            # Whatever lies beyond: it has been there.
            self.stop[new[closes & (self.count[new] > _LEAST_CLOSED)]] = CLOSED
            self.stop[refused[self.step[refused] < self.control.shortest]] = NO_FURTHER
        owner = np.concatenate([tracks for tracks, _, _ in self.log])
        order = np.argsort(owner, kind="stable")
        bounds = np.cumsum(self.count)[:-1]
        Z, tangent = (
            np.split(np.hstack([e[i] for e in self.log])[:, order], bounds, axis=1)
            for i in (1, 2)
        )
        return [
            Track(*each) for each in zip(Z, tangent, self.stop.tolist(), strict=True)
        ]

    def record(self, tracks: np.ndarray) -> None:
        """Add the last points of tracks to what was found."""
        self.count[tracks] += 1
        self.log.append((tracks, self.Z[:, tracks], self.tangent[:, tracks]))

    def advance(self, active: np.ndarray) -> tuple[Point, np.ndarray]:
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
        h, border = self.step[active], self.tangent[:, active].copy()
        guess = self.Z[:, active] + h * border + 0.5 * h * h * self.turning[:, active]
        point = self.correct(active, self._near(active, guess, border), border)
        error = norm(point.Z - guess)
        cosine = total(point.direction * border)
        fair, measure = self.judge(active, point, guess, error)
        fair = fair & point.ok & self.control.accepts(error, h, np.abs(cosine))
        new = active[fair]
        tangent = np.where(cosine >= 0, point.direction, -point.direction)[:, fair]
        Z = point.Z[:, fair]
        # The tangent keeps turning as over the last step.
        chord = norm(Z - self.Z[:, new])
        self.turning[:, new] = (tangent - self.tangent[:, new]) / chord
        for values, last in zip(self.before, (self.Z, self.tangent), strict=True):
            values[:, new] = last[:, new]
        self.back[new] = chord
        self.Z[:, new], self.tangent[:, new] = Z, tangent
        self.step[new] = self.control.after(h[fair], measure[fair])
        self.step[active[~fair]] *= self.control.reduction
        return point, fair

    def _near(
        self, active: np.ndarray, guess: np.ndarray, border: np.ndarray
    ) -> np.ndarray:
        """Where Newton's method begins in the planes of the predicted points: on the
        cubic through the last two.
        """
        # Before a fall it converges only from so near that a parabola allows but tiny
        # steps.
        has_two = self.back[active] > 0
        length = np.where(has_two, self.back[active], 1.0)
        a, b = lanes_of((self.before, (self.Z, self.tangent)), active)
        off = hermite(a, b, length, 1 + self.step[active] / length) - guess
        return guess + np.where(has_two, off - border * total(border * off), 0.0)
