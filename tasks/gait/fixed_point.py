"""Fixed points of the stride map: batched Newton, and the search from nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tasks.gait.stride import SAMPLES, Stride, StrideMap, apply, stride_map
from tasks.gait.verify import Verdict, verify
from tasks.mechanics.lumped import Structure, constants_of, structure_of
from tasks.walkers.parameters import Walker

EPS = np.finfo(float).eps
#: Periods beyond are a fall: the stance leg has all but come to stand upright [sqrt(leg/g)].
LONGEST_PERIOD = 12.0
#: Newton steps a start may take; an honest one takes 2 to 8.
MOST_ITERATIONS = 25
#: The same for a rough flight: what is not near by then hardly ever arrives.
MOST_ROUGH = 10
#: Rough starts this far away at their first, second, ... step are given up: hardly one arrives, and others do.
HOPELESS = (20.0, 6.0, 4.0, 3.0)
#: Rough starts in one cell of this size after three steps arrive at one gait: the nearest to it goes on.
MERGED = 0.1


class Problem:
    """One walker's stride map with its constants in place."""

    def __init__(self, walker: Walker):
        self.walker = walker
        self.structure: Structure = structure_of(walker)
        self.map: StrideMap = stride_map(self.structure)
        self.constants = constants_of(walker, self.structure)
        self.m, self.phases = self.map.m, 2 if walker.knees else 1

    def parameters(self, slope: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Runtime parameters of every lane, shape (n_parameters, n)."""
        return np.vstack([slope, scale, np.broadcast_to(self.constants[:, None], (len(self.constants), len(slope)))])

    def some(self, lanes: np.ndarray) -> Problem:
        """The problem of some lanes: the same, where all lanes share a walker."""
        return self

    def walker_of(self, lane: int) -> Walker:
        """The walker of a lane."""
        return self.walker

    def stride(self, w: np.ndarray, log_slope: np.ndarray, slope: bool = False,
               samples: int = 0, rough: bool = False) -> tuple[Stride, np.ndarray]:
        """Evaluate strides at similarity coordinates.

        Parameters
        ----------
        w : ndarray, shape (m + phases, n)
            ln(angle), rates/angle, event times: of order one over decades of slope.
        log_slope : ndarray, shape (n,)

        Returns
        -------
        Stride, and the power-of-two scale (n,) its angles and rates are in.
        """
        angle = np.exp(w[0])
        scale = np.exp2(np.floor(np.log2(angle)))
        y = np.vstack([angle, angle * w[1:self.m]]) / scale
        stride = self.map(y, w[self.m:], self.parameters(np.exp(log_slope), scale), slope, samples, rough)
        return stride, scale


class Lanes(Problem):
    """The stride map with a walker of its own in every lane; all are of one structure."""

    def __init__(self, walkers: Sequence[Walker], structure: Structure | None = None,
                 constants: np.ndarray | None = None):
        self.walkers, self.walker = walkers, walkers[0]
        self.structure = structure or structure_of(walkers[0])
        self.map = stride_map(self.structure)
        self.constants = constants if constants is not None else np.array(
            [constants_of(w, self.structure) for w in walkers]).T
        self.m, self.phases = self.map.m, 2 if self.structure.kneed else 1

    def parameters(self, slope: np.ndarray, scale: np.ndarray) -> np.ndarray:
        return np.vstack([slope, scale, self.constants])

    def some(self, lanes: np.ndarray) -> Lanes:
        return Lanes([self.walkers[i] for i in lanes], self.structure, self.constants[:, lanes])

    def walker_of(self, lane: int) -> Walker:
        return self.walkers[lane]


@dataclass
class Arrival:
    """Where a stride's Newton step leads: `y` (m, n) section, `times` (k, n), `state` (a, n) just after heelstrike.

    `values` (o, n) are what a gait is known by, its angle, rates and period, and `by_y` (o, m, n) their derivatives;
    `size` (o, n) is what their errors are measured by: rates by the largest of them, which alone cannot vanish;
    `reach` (o, n) is how far an image wrong by all of itself would move them.
    """

    y: np.ndarray
    times: np.ndarray
    state: np.ndarray
    values: np.ndarray
    size: np.ndarray
    by_y: np.ndarray
    reach: np.ndarray


def arrival(problem: Problem, stride: Stride, parameters: np.ndarray) -> Arrival:
    """Take the Newton step of strides flown with some parameters."""
    y = stride.y + stride.newton
    times = stride.times + apply(stride.times_by_y, stride.newton)
    size = problem.map.start_size
    begin, shown = problem.map.start(y, parameters), [0, *range(size // 2, size)]
    state, by_y = begin[:size], begin[size:].reshape(size, *y.shape)
    values, by_y = np.vstack([state[shown], times[-1:]]), np.concatenate([by_y[shown], stride.times_by_y[-1:]])
    measure = np.vstack([sizes(values[:-1]), np.abs(values[-1:])])
    reach = measure + apply(np.abs(by_y), apply(np.abs(stride.inverse), sizes(y)))
    return Arrival(y, times, state, values, measure, by_y, reach)


def sizes(y: np.ndarray) -> np.ndarray:
    """What errors of (angle, rates...) are measured by: the angle, and the largest rate for every rate, shape (m, n)."""
    rates = y[1:]
    return np.vstack([np.abs(y[:1]), np.broadcast_to(np.abs(rates).max(axis=0), rates.shape)])


#: Units a stride is flown in to see how it rounds; a number divisible by fifteen is exact in each.
UNITS = (1.0, 0.75, 1.25, 0.9375)


@np.errstate(invalid="ignore", divide="ignore", over="ignore")
def noise(problem: Problem, w: np.ndarray, log_slope: np.ndarray, near: int = 1) -> np.ndarray:
    """Standard deviation that rounding gives angle, rates and period of a fixed point, over their `reach`, (o, n).

    Measured: one stride is flown in units that round every operation on the way anew, from `near` starts side by side.
    NaN where there is no stride.
    """
    m, slope, variances = problem.m, np.exp(log_slope), []
    for turn in range(near):
        angle = np.exp(w[0] + 1e-8 * turn)
        scale = np.exp2(np.floor(np.log2(angle)))
        mantissa, exponent = np.frexp(np.vstack([angle, angle * w[1:m]]) / scale / 15)
        y = 15 * np.ldexp(np.rint(np.ldexp(mantissa, 45)), exponent - 45)
        seen = []
        for unit in UNITS:
            parameters = problem.parameters(slope, scale * unit)
            found = arrival(problem, problem.map(y / unit, w[m:], parameters), parameters)
            seen.append(np.vstack([found.values[:-1] * unit, found.values[-1:]]))
        # Units do not change what is measured in them.
        reach = np.vstack([found.reach[:-1] * unit, found.reach[-1:]])
        variances.append(np.var(seen, axis=0, ddof=1) / reach**2)
    known = np.isfinite(variances)
    return np.sqrt(np.where(known, variances, 0.0).sum(axis=0) / known.sum(axis=0))


def similarity(y: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """Change of (ln angle, rates/angle) for a change dy of scaled coordinates y, to first order."""
    d = dy / y[0]
    return np.vstack([d[:1], d[1:] - y[1:] / y[0] * d[:1]])


def newton_step(stride: Stride, w: np.ndarray) -> np.ndarray:
    """The Newton step of a stride in similarity coordinates, shape (m + phases, n)."""
    times = stride.times + apply(stride.times_by_y, stride.newton)
    return np.vstack([similarity(stride.y, stride.newton), times - w[len(stride.y):]])


def rounding(stride: Stride) -> np.ndarray:
    """How far rounding of the stride map alone can move the fixed point, relative, shape (m, n).

    Notes
    -----
    With J = I - DP, rounding of the image moves the fixed point by J^-1, and rounding of the start, carried through
    the stride, by J^-1 DP = J^-1 - I, which is far smaller than |J^-1| |DP|. What is rounded on the way lies between
    the two. An estimate, by which Newton knows that it is done, and of special points; that of gaits is measured (`noise`).
    """
    size = sizes(stride.y)
    # Off balance, a short step is flown by forces and rates that dwarf its section; their rounding adds up on the way.
    most = size.max(axis=0)
    beyond = 48 * np.maximum(0, np.maximum(np.abs(stride.impact).max(axis=0), np.abs(stride.start).max(axis=0)) - 2 * most)
    # Angles become rates on the way and rates angles: the largest of them rounds them all. A point foot's motion has
    # few constants; that of others many, each of them rounded, and several times the operations.
    share = 0.5 if len(size) == 2 else 3.0
    landed = np.broadcast_to(share * (size + np.abs(stride.image)).max(axis=0), size.shape)
    through = np.abs(stride.inverse - np.eye(len(size))[:, :, None])
    return EPS * (apply(np.abs(stride.inverse), landed + beyond) + apply(through, size + beyond)) / size


@dataclass
class Solved:
    """Outcome of Newton on n lanes: coordinates, and whether they converged."""

    w: np.ndarray
    converged: np.ndarray


def newton(problem: Problem, w: np.ndarray, log_slope: np.ndarray, rough: bool = False,
           hopeless: Sequence[float] = (1e6,), merge: float = 0.0) -> Solved:
    """Damped Newton on every lane; finished lanes leave the batch.

    Parameters
    ----------
    w : ndarray, shape (m + phases, n)
        Starts, in similarity coordinates.
    log_slope : ndarray, shape (n,)
    rough : bool
        Only to the search's tolerance.
    hopeless : sequence of float
        Size of the first, second, ... step that ends a lane's search; the last holds from there on.
    merge : float
        After three steps, of lanes at one slope that share a cell of this size, only that with the least step goes on.
    """
    w = w.copy()
    n = w.shape[1]
    converged = np.zeros(n, bool)
    active = np.arange(n)
    last = np.full(n, np.inf)
    for taken in range(MOST_ROUGH if rough else MOST_ITERATIONS):
        if not len(active):
            break
        stride, _ = problem.some(active).stride(w[:, active], log_slope[active], rough=rough)
        step = newton_step(stride, w[:, active])
        size = np.abs(step).max(axis=0)
        noise = np.nan_to_num(rounding(stride).max(axis=0), nan=np.inf)
        alive = np.isfinite(size) & (size < hopeless[min(taken, len(hopeless) - 1)])
        step[:, alive] *= np.minimum(1.0, 0.5 / np.maximum(size[alive], 1e-300))
        w[:, active[alive]] += step[:, alive]
        # Done when the step is rounding, or has become small and stopped shrinking.
        done = alive & ((size < (1e-5 if rough else noise)) | ((size < 1e-6) & (size > 0.3 * last[active])))
        sane = (np.abs(w[1:problem.m, active]) < 50).all(axis=0) & (w[problem.m:, active] > 0.05).all(axis=0)
        sane &= (w[-1, active] < LONGEST_PERIOD) & (w[0, active] < 0.4)
        converged[active[done & sane]] = True
        last[active] = size
        active = active[alive & sane & ~done]
        if merge and taken > 1:
            active = active[np.argsort(last[active], kind="stable")]
            cells = np.vstack([log_slope[active], np.round(w[:, active] / merge)])
            active = np.sort(active[np.unique(cells, axis=1, return_index=True)[1]])
    return Solved(w, converged)


def judged(problem: Problem, w: np.ndarray, log_slope: np.ndarray) -> tuple[Stride, Verdict]:
    """Strides with their verdicts; where samples leave a doubt, finer ones decide."""
    stride, _ = problem.stride(w, log_slope, samples=SAMPLES)
    return stride, settled(problem, stride, w, log_slope)


def settled(problem: Problem, stride: Stride, w: np.ndarray, log_slope: np.ndarray) -> Verdict:
    """The verdict on sampled strides; lanes in doubt are sampled again, sixteen times as finely."""
    assert stride.motion is not None
    verdict = verify(stride.motion, stride.closing, stride.times)
    lanes = np.nonzero(verdict.doubt)[0]
    if len(lanes):
        fine, _ = problem.some(lanes).stride(w[:, lanes], log_slope[lanes], samples=16 * SAMPLES)
        assert fine.motion is not None
        closer = verify(fine.motion, fine.closing, fine.times)
        verdict.step[lanes], verdict.passes[lanes], verdict.doubt[lanes] = closer.step, closer.passes, closer.doubt
    return verdict


# Where heelstrike is tangential to the last digit its rates have no value.
@np.errstate(invalid="ignore", divide="ignore")
def gait_ratio(stride: Stride) -> np.ndarray:
    """u = (swing rate - stance rate)/|stance rate| just before heelstrike: below 1/2 a gait is long."""
    return (stride.impact[1] - stride.impact[0]) / np.abs(stride.impact[0])


def starts(problem: Problem, slope: float) -> np.ndarray:
    """A fixed lattice of starts over step length, period and swing rate, shape (m + phases, n).

    Notes
    -----
    Stance angles run from the linear (slope) to the cube-root scaling; the stance rate is that of an inverted
    pendulum that crosses from +angle to -angle in the period.
    """
    top = np.log(min(2.0 * slope ** (1 / 3), 0.7))
    bottom = np.log(max(1.5 * slope, 0.02 * slope ** (1 / 3)))
    angles = np.linspace(bottom, top, 9)
    periods = np.array([2.0, 2.5, 3.0, 3.5, 4.0])
    swing = np.array([1.0]) if problem.m == 2 else np.array([-0.9, -0.3, 0.3]) if problem.phases == 2 else np.array(
        [1.0, 0.5])
    knee = np.array([0.55, 0.75]) if problem.phases == 2 else np.array([1.0])
    grid = np.meshgrid(angles, periods, swing, knee, indexing="ij")
    log_angle, period, ratio, fraction = (g.ravel() for g in grid)
    rate = -1.0 / np.tanh(period / 2)
    rows = [log_angle, rate]
    if problem.m == 3:
        rows.append(-ratio * rate if problem.phases == 2 else ratio * rate)
    if problem.phases == 2:
        rows.append(fraction * period)
    return np.vstack([*rows, period])


def search(problem: Problem, slope: float) -> tuple[np.ndarray, Stride | None, Verdict | None]:
    """Every gait the lattice of starts leads to at one slope, distinct, in order of the stance angle.

    Returns
    -------
    w : ndarray, shape (m + phases, found)
    stride, verdict
        Their strides and what those are; None where nothing was found.
    """
    w = found_at(problem, [slope])[0]
    if not w.shape[1]:
        return w, None, None
    return w, *judged(problem, w, np.full(w.shape[1], np.log(slope)))


def found_at(problem: Problem, slopes: Sequence[float]) -> list[np.ndarray]:
    """Fixed points, steps or not, that the lattice of starts leads to at each of some slopes, shapes (m + phases, found)."""
    lattice = [starts(problem, slope) for slope in slopes]
    at = np.repeat(np.arange(len(slopes)), [w.shape[1] for w in lattice])
    w, log_slope = np.hstack(lattice), np.log(np.asarray(slopes))
    if problem.phases == 2:
        # Three links are dear: the search flies roughly, and only what it finds is flown exactly.
        near = newton(problem, w, log_slope[at], rough=True, hopeless=HOPELESS, merge=MERGED)
        w, at = _distinct(near.w[:, near.converged], at[near.converged], 1e-3)
    solved = newton(problem, w, log_slope[at])
    w, at = _distinct(solved.w[:, solved.converged], at[solved.converged], 1e-5)
    return [w[:, at == i] for i in range(len(slopes))]


def _distinct(w: np.ndarray, at: np.ndarray, apart: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns of w in a fixed order, without those nearer than `apart` to one kept that shares their `at`."""
    order = np.lexsort([*np.round(w, 6)[::-1], at])
    w, at = w[:, order], at[order]
    keep: list[int] = []
    for i in range(w.shape[1]):
        if all(at[i] != at[j] or np.abs(w[:, i] - w[:, j]).max() > apart for j in keep):
            keep.append(i)
    return w[:, keep], at[keep]
