"""The gaits of a line that lie nearest to given states: at given slopes, or at any.

Errors are not bounded here, so that ten thousand states take a second or two: gaits are
as accurate as Newton's method leaves them in doubles, some 1e-13.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.gaits.labels import places
from gaitsweep.tasks.gaits.newton import newton, newton_step, similarity
from gaitsweep.tasks.gaits.step_check import LONG_BELOW, gait_ratio
from gaitsweep.tasks.mechanics.arrays import LogSlopes, PerLane, Sections, Unknowns
from gaitsweep.tasks.mechanics.sums import matvec, total
from gaitsweep.tasks.step.iterate import Ended, iterate
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.several_steps import begun_at, from_largest

#: Newton steps from the polynomial of a branch; nearly all take two.
_MAX_STEPS = 8
#: Steps along a branch to the point nearest to a state, and the longest in ln slope.
_MAX_STEPS_ALONG = 20
_LONGEST = 0.5
#: Steps along a branch below which the point nearest to a state is reached: the next one
#: is of the order of its square.
_REACHED = 1e-8
#: How far branches curve over a step along them, at most, in units of its square.
_CURVED = 10.0
#: Points of a branch from node to node, to which sections are compared first, and by how
#: much its polynomials may be off.
_POINTS_BETWEEN = 8
_INEXACT = 1e-3
#: Way along a branch over which differences of states are taken.
_SHORT_WAY = 1e-5
#: Coordinates beyond which the way along a branch is lost.
_MOST = 60.0


@dataclass
class Gaits:
    """Gaits in n lanes.

    Attributes
    ----------
    state : ndarray, shape (3, n) [rad, rad/sqrt(leg/g)]
        Stance angle, stance rate and thigh rate just after heelstrike; NaN of none.
    before : ndarray, shape (2, n) [rad/sqrt(leg/g)]
        Rates of the old stance leg and the old swing leg just before heelstrike.
    radius : ndarray, shape (n,)
        Spectral radius of the derivative of all steps.
    ratio : ndarray, shape (n,)
        Gait ratio, which tells long from short ones.
    passes : ndarray, shape (n,)
        How often the legs pass; 1 unless said otherwise.
    place : ndarray of int, shape (n,)
        Label, as `tasks.gaits.labels.places` has it; -1 of none.
    steps : ndarray of int, shape (n,)
        After how many steps they repeat; 1 of none.
    """

    state: np.ndarray
    before: np.ndarray
    radius: PerLane
    ratio: PerLane
    passes: PerLane
    place: np.ndarray
    steps: np.ndarray

    @classmethod
    def none(cls, n: int) -> Gaits:
        """Return n lanes without a gait."""
        nan = np.full(n, np.nan)
        return cls(
            state=np.full((3, n), np.nan),
            before=np.full((2, n), np.nan),
            radius=nan,
            ratio=nan.copy(),
            passes=nan.copy(),
            place=np.full(n, -1),
            steps=np.ones(n, int),
        )

    def put(self, lanes: np.ndarray, gaits: Gaits) -> None:
        """Replace the gaits of some lanes."""
        for name, values in vars(self).items():
            values[..., lanes] = getattr(gaits, name)


def described(problem: Problem, w: Unknowns, log_slope: LogSlopes) -> Gaits:
    """Return solved gaits, of one step or of several.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
        In similarity coordinates.
    log_slope : ndarray, shape (n,)
        ln of the slope in rad.
    """
    if not w.shape[1]:
        return Gaits.none(0)

    stride, scale = problem.stride(w, log_slope)
    state = problem.start(stride.y * scale, np.exp(log_slope))[:3]
    before = stride.one.impact * scale
    if stride.steps > 1:  # of the heelstrike that ends the last step
        before = before[:, -1]

    n = w.shape[1]
    values = np.linalg.eigvals(np.moveaxis(stride.jacobian, -1, 0))
    radius = np.abs(values).max(axis=1)
    ratio = gait_ratio(stride)
    place = np.where(ratio < LONG_BELOW, 0, 1)
    steps = np.full(n, problem.steps)
    return Gaits(state, before, radius, ratio, np.ones(n), place, steps)


def gaits_at(
    problem: Problem, branches: Sequence[Branch], slope: np.ndarray
) -> list[Gaits]:
    """Return a line's gaits at given slopes, one set for each piece of a branch and each
    of the steps at which a gait may begin.

    Parameters
    ----------
    problem : Problem
    branches : sequence of Branch
        The line's atlas, or its branches of gaits of the problem's steps.
    slope : ndarray, shape (n,) [rad]
    """
    found: list[list[Gaits]] = []
    q = np.log(slope)
    for branch in branches:
        for index, Z, segment in branch.guesses(q):
            w, converged = newton(
                problem,
                Z[:-1].copy(),
                q[index],
                max_iterations=_MAX_STEPS,
            )
            lanes = index[converged]
            passes = branch.leg_passes[segment[converged]]
            begun = []
            for w_begun in _begun(problem, w[:, converged]):
                gaits = Gaits.none(len(slope))
                gaits.put(lanes, described(problem, w_begun, q[lanes]))
                gaits.passes[lanes] = passes

                begun.append(gaits)

            found.append(begun)

    _label(found)
    return [gaits for begun in found for gaits in begun]


def _begun(problem: Problem, w: Unknowns) -> Iterator[Unknowns]:
    """Yield the same gaits begun at each of their steps, first at that with the largest
    stance angle.
    """
    w = from_largest(w, problem.m, problem.steps)
    for first in range(problem.steps):
        yield begun_at(w, problem.m, problem.steps, first)


def _label(found: Sequence[list[Gaits]]) -> None:
    """Give gaits, each begun at all of its steps, their labels among all of a slope."""
    if not found:
        return

    largest = [begun[0] for begun in found]
    angle = np.array([gaits.state[0] for gaits in largest])
    passes = np.array([gaits.passes for gaits in largest])
    ratio = np.array([gaits.ratio for gaits in largest])
    labels = places(np.where(passes == 1, angle, np.nan), ratio)
    for begun, place in zip(found, labels, strict=True):
        for gaits in begun:
            gaits.place = place


def nearest_on_branches(
    problem: Problem, branches: Sequence[Branch], y: Sections, within: PerLane
) -> list[tuple[PerLane, Gaits, np.ndarray]]:
    """Return the gaits of every branch, begun at each of their steps, that lie nearest to
    given sections, the drives at which they are, and how they change with these.

    Parameters
    ----------
    problem : Problem
    branches : sequence of Branch
        The line's atlas, or its branches of gaits of the problem's steps.
    y : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Of one step.
    within : ndarray, shape (n,)
        Relative distance beyond which a gait is of no interest.

    Returns
    -------
    list of (drive, gaits, changes)
        For each branch and first step; NaN where none is so near. The drive is the slope as the problem
        counts it, and `changes` (3, n) of the states are by its ln, to some ten digits.
    """
    target = np.vstack([np.log(y[:1]), y[1:] / y[0]])
    found = []
    for along_branch in _points_begun(problem, branches):
        points, near = _nearest_points(along_branch, target, within)
        some = problem.some(near)
        along = _Along(some, target[:, near], points[:, near], within[near])
        ended = iterate(along, len(near), _MAX_STEPS_ALONG)

        reached = np.flatnonzero(ended == Ended.CONVERGED)
        lanes = near[reached]

        drive = np.full(y.shape[1], np.nan)
        gaits = Gaits.none(y.shape[1])
        w = along.Z[:-1, reached]
        q = along.Z[-1, reached]
        drive[lanes] = np.exp(q)
        gaits.put(lanes, described(problem, w, q))
        changes = np.full_like(gaits.state, np.nan)
        changes[:, lanes] = along.changes(reached)
        found.append((drive, gaits, changes))

    return found


def _nearest_points(
    points: np.ndarray, target: np.ndarray, within: PerLane
) -> tuple[np.ndarray, np.ndarray]:
    """Of points (m + phases + 1, k) along a branch those nearest to sections of one step
    in similarity coordinates, and the numbers of the sections that may be of interest.
    """
    m = len(target)
    apart = np.abs(np.diff(points[:m], axis=1)).max(axis=0)
    after = np.append(apart, 0.0)
    before = np.append(0.0, apart)
    spacing = np.maximum(before, after)

    tree = cKDTree(points[:m].T)
    distance, nearest = tree.query(target.T, p=np.inf)
    largest = np.abs(target).max(axis=0)
    allowed = within * largest + spacing[nearest] + _INEXACT
    return points[:, nearest], np.flatnonzero(distance <= allowed)


def _points_begun(problem: Problem, branches: Sequence[Branch]) -> Iterator[np.ndarray]:
    """Yield points (m + phases + 1, k) along every branch, begun at each of their steps."""
    for branch in branches:
        points = np.hstack([*between_nodes(branch)])
        w, q = points[:-1], points[-1:]

        for first in range(problem.steps):
            begun = begun_at(w, problem.m, problem.steps, first)
            yield np.vstack([begun, q])


def between_nodes(branch: Branch) -> Iterator[np.ndarray]:
    """Yield the nodes of each piece of a branch, and points between them, in order."""
    for first, last in branch.pieces():
        nodes = np.arange(first, last + 1)
        places = np.linspace(first, last, _POINTS_BETWEEN * (last - first) + 1)
        q = np.interp(places, nodes, branch.q[nodes])
        yield branch.on_piece(first, last, q)[0]


@dataclass
class _Along:
    """The way along a branch to the points nearest to sections `target` (m, n) of the
    first step: Newton's step onto the branch, then the step along it that brings the point nearest, to first
    order. `Z` (m + phases + 1, n) are the points.
    """

    problem: Problem
    target: np.ndarray
    Z: np.ndarray
    within: PerLane

    def step(self, lanes: np.ndarray, taken: int) -> np.ndarray:
        """Step once more in some lanes."""
        m = len(self.target)
        onto, tangent = self._directions(lanes)
        left = self.target[:, lanes] - self.Z[:m, lanes] - onto[:m]
        along = _projected(left, tangent[:m])
        moves = tangent * along
        is_far = self._is_far(lanes, left - moves[:m], onto, moves)

        along = np.clip(along, -_LONGEST, _LONGEST)
        step = np.vstack([onto, np.zeros_like(along)]) + tangent * along
        size = np.abs(step).max(axis=0)
        exists = np.isfinite(size)
        step[:, exists] /= np.maximum(size[exists], 1.0)
        self.Z[:, lanes[exists]] += step[:, exists]

        is_lost = np.abs(self.Z[:, lanes]).max(axis=0) > _MOST

        return np.select(
            [~exists | is_lost, size < _REACHED, is_far],
            [Ended.SINGULAR, Ended.CONVERGED, Ended.DIVERGED],
            Ended.RUNNING,
        )

    def _directions(self, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Newton's step (m + phases, n) onto the branch, and the tangent of points by ln
        slope, by the implicit function theorem.
        """
        w, q = self.Z[:-1, lanes], self.Z[-1, lanes]
        problem = self.problem.some(lanes)
        stride, _ = problem.stride(w, q, by_drive=True)
        onto = newton_step(stride, w)

        m = problem.m
        by_slope = stride.derivative[:, -1] * np.exp(q)
        moves = matvec(stride.inverse, by_slope)
        of_section = similarity(stride.y, moves[:m])
        return onto, np.vstack([of_section, moves[m:], np.ones_like(q)[None]])

    def changes(self, lanes: np.ndarray) -> np.ndarray:
        """By how much states (3, n) of some lanes change, by ln slope along the branch."""
        if not len(lanes):
            return np.empty((3, 0))
        _, tangent = self._directions(lanes)
        way = _SHORT_WAY * tangent
        ahead = self._states(lanes, self.Z[:, lanes] + way)
        behind = self._states(lanes, self.Z[:, lanes] - way)
        return np.asarray((ahead - behind) / (2.0 * _SHORT_WAY))

    def _states(self, lanes: np.ndarray, Z: np.ndarray) -> np.ndarray:
        """States (3, n) of points, of some lanes."""
        angle = np.exp(Z[:1])
        rates = Z[1 : len(self.target)] * angle

        section = np.vstack([angle, rates])
        slope = np.exp(Z[-1])
        problem = self.problem.some(lanes)
        state = problem.start(section, slope)
        return state[:3]

    def _is_far(
        self,
        lanes: np.ndarray,
        beside: np.ndarray,
        onto: np.ndarray,
        moves: np.ndarray,
    ) -> np.ndarray:
        """Whether the target lies beside the branch by more than is of interest, and than
        the curvature over the moves along it may explain.
        """
        largest = np.abs(self.target[:, lanes]).max(axis=0)
        square = np.abs(moves).max(axis=0) ** 2 + np.abs(onto).max(axis=0) ** 2
        allowed = self.within[lanes] * largest + _CURVED * square
        return np.asarray(np.abs(beside).max(axis=0) > allowed)


@np.errstate(invalid="ignore", divide="ignore")
def _projected(vectors: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """How far vectors (m, n) lead along tangents."""
    return np.asarray(total(tangent * vectors) / total(tangent**2))
