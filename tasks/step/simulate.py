"""Steps from any initial state: the times of the strikes, the state after them, and
falls.

The step map needs event times. At a fixed point they are unknowns beside the state;
from any other state they are located here: all lanes advance together by a fixed time
step of Dormand and Prince's fifth-order formula, each monitors its own guard, and a
lane that strikes leaves the batch. The times are accurate to about 1e-8; the exact step
map corrects them and the image to the last digits and adds the Jacobian, which is as
accurate as the times before correction. A lane's bits depend on its initial state
alone.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.arrays import (
    Numbers,
    Parameters,
    PerLane,
    Sections,
    Slopes,
    States,
    Times,
)
from gaitsweep.tasks.mechanics.equations import Sym, Symbols
from gaitsweep.tasks.mechanics.impacts import release
from gaitsweep.tasks.mechanics.kernel import (
    LANES,
    CompiledFunction,
    compiled,
    whole_groups,
)
from gaitsweep.tasks.mechanics.lumped import Structure
from gaitsweep.tasks.mechanics.sums import total
from gaitsweep.tasks.step.crossing import crossings, guard
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.problem import Problem, scale_of
from gaitsweep.tasks.step.symbols import dot, end_of_step, field, lock_knee, vector

#: Outcomes of a step. All but STRUCK are falls.
STRUCK, BACKWARD, FORWARD, NO_KNEESTRIKE, NO_HEELSTRIKE, LOST = range(6)
CAUSES = (
    "walks",
    "fell backward",
    "fell forward",
    "knee never struck",
    "foot never struck",
    "motion lost",
)
#: Stance angle beyond which a walker has fallen [rad] and its ln, and the longest time
#: a step may take [sqrt(leg/g)].
MAX_LOG_ANGLE = 0.5
MAX_ANGLE, MAX_TIME = float(np.exp(MAX_LOG_ANGLE)), 12.0
#: Time step of the scan [sqrt(leg/g)], by whether there are knees: a free shank swings
#: faster.
_TIME_STEP = {False: 0.125, True: 0.0625}
#: Largest angle of a state within a step that sets its scale, at least [rad].
_LEAST_ANGLE = 1e-3
#: Lanes simulated side by side: their states stay in the cache.
_SIDE_BY_SIDE = 4096
#: Most time steps taken before strikes are looked for: of a lane, about as many as a
#: phase takes, and of all lanes together.
_MAX_BLOCK, _BLOCK = 28, 8192
#: Angle, and change of an angle in a time step, at which a block ends [rad].
_WILD = 4.0

#: Dormand and Prince (J. Comput. Appl. Math. 6 (1980) 19-26), fifth order in six
#: stages.
_STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)


@dataclass
class SimulatedSteps:
    """One step of n lanes from any initial state.

    Attributes
    ----------
    image : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        Section coordinates after it, NaN where the walker fell.
    times : ndarray, shape (k, n) [sqrt(leg/g)]
        Kneestrike, for knees, and heelstrike.
    outcome : ndarray of int, shape (n,)
        Index of CAUSES.
    jacobian : ndarray, shape (m, m, n)
        NaN of falls; empty where the steps are not exact.
    closing : ndarray, shape (m + k, k, n)
        How image and times [sqrt(leg/g)] change with what the guards of the strikes, which
        are scaled angles, are off; NaN of falls, empty where the steps are not exact.
    """

    image: Sections
    times: Times
    outcome: np.ndarray
    jacobian: np.ndarray
    closing: np.ndarray


class Scanner:
    """A structure's compiled time steps and impacts, to integrate many lanes to their
    strikes.
    """

    def __init__(self, structure: Structure):
        self.structure = structure
        self._step = {free: self._compile_step(free) for free in structure.phases[::-1]}
        self._lock = self._strike = None
        if structure.kneed:
            self._lock = _compile(structure, 6, lock_knee)
        else:
            strike = functools.partial(end_of_step, structure)
            self._strike = _compile(structure, 4, strike)

    def _compile_step(self, free: bool) -> CompiledFunction:
        p = Symbols(self.structure)
        x, h = vector("x", 6 if free else 4), hy.make_vars("h")
        stage, derivatives = x, []
        for weights in _STAGES:
            derivatives.append(field(p, stage, free))
            used = [i for i, weight in enumerate(weights) if weight]
            mean = []
            for rates in zip(*derivatives, strict=True):
                mean.append(dot([weights[i] for i in used], [rates[i] for i in used]))
            stage = [start + h * rate for start, rate in zip(x, mean, strict=True)]

        return CompiledFunction(stage, [*x, h, *p.variables])

    @functools.cached_property
    def _rates_on_uneven_ground(self) -> CompiledFunction:
        """Rates after a heelstrike from two links' state and the parameters, at any two
        angles of the legs.
        """
        return compiled(_release_on_uneven_ground, self.structure)

    @staticmethod
    def _call(function: CompiledFunction, *inputs: np.ndarray) -> np.ndarray:
        """Call a compiled function on lanes (k, n) padded to whole SIMD groups."""
        values = function(whole_groups(np.concatenate(inputs), LANES))
        return values[:, : inputs[0].shape[1]]

    def _advance(
        self, free: bool, x: States, h: PerLane, parameters: Parameters
    ) -> np.ndarray:
        """States after a time step h (n,) of the formula, of three links or two."""
        return self._call(self._step[free], x, h[None], parameters)

    def lock(self, x: States, parameters: Parameters) -> np.ndarray:
        """State of two links after kneestrike from that of three before it."""
        assert self._lock
        return self._call(self._lock, x, parameters)

    def strike(self, x: States, parameters: Parameters) -> np.ndarray:
        """Section coordinates at heelstrike from the state of two links just before it:
        just after it for straight legs, just before it for knees.
        """
        if self._strike is None:
            return x[1:4].copy()
        return self._call(self._strike, x, parameters)

    def land(self, x: States, parameters: Parameters) -> np.ndarray:
        """State just after a heelstrike on ground of any height, on which the legs
        stand at two different angles, from that of two links just before it.
        """
        rates = self._call(self._rates_on_uneven_ground, x, parameters)
        return np.vstack([x[1], np.repeat(x[:1], len(rates) - 1, axis=0), rates])

    def to_heelstrike(
        self, x: States, parameters: Parameters, height: PerLane | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Integrate every lane from just after a heelstrike to just before the next.

        Parameters
        ----------
        x : ndarray, shape (4 or 6, n)
            Scaled states.
        parameters : ndarray, shape (n_parameters, n)
            Slope, scale and the structure's constants.
        height : ndarray, shape (n,), optional
            By which the ground rises until then, over l.

        Returns
        -------
        lanes : ndarray of int, shape (k,)
            Those that strike.
        state : ndarray, shape (4, k)
            Theirs.
        times : ndarray, shape (phases, n) [sqrt(leg/g)]
            Kneestrike, for knees, and heelstrike; NaN of those that do not strike.
        outcome : ndarray of int, shape (n,)
            Index of CAUSES.
        """
        n, phases = x.shape[1], self.structure.phases
        times, outcome = np.full((len(phases), n), np.nan), np.full(n, LOST)
        lanes, begin = np.arange(n), np.zeros(n)
        for strike, free in zip(times, phases, strict=True):
            rise = None if free or height is None else height[lanes]
            x, time, outcome[lanes] = self.integrate_to_event(
                free, x, begin, parameters[:, lanes], rise
            )
            struck = outcome[lanes] == STRUCK
            lanes, x = lanes[struck], x[:, struck]
            begin = (begin + time)[struck]
            strike[lanes] = begin
            if free and len(lanes):
                x = self.lock(x, parameters[:, lanes])

        return lanes, x, times, outcome

    def integrate_to_event(
        self,
        free: bool,
        x: States,
        begin: PerLane,
        parameters: Parameters,
        height: PerLane | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integrate every lane to its strike.

        Parameters
        ----------
        free : bool
            To kneestrike with the knee free, or to heelstrike with it locked.
        x : ndarray, shape (size, n)
            Scaled states.
        begin : ndarray, shape (n,)
            Time since the step began [sqrt(leg/g)].
        parameters : ndarray, shape (n_parameters, n)
        height : ndarray, shape (n,), optional
            By which the ground rises until heelstrike, over l.

        Returns
        -------
        state : ndarray, shape (size, n)
            At the strike, NaN where there is none.
        time : ndarray, shape (n,) [sqrt(leg/g)]
            Since the phase began, of those that strike.
        outcome : ndarray of int, shape (n,)
            Index of CAUSES.
        """
        n, h = x.shape[1], _TIME_STEP[self.structure.kneed]
        state, time = np.full_like(x, np.nan), np.zeros(n)
        way = _Way(self, free, h, begin, parameters, height, state, time)
        outcome = np.full(n, NO_KNEESTRIKE if free else NO_HEELSTRIKE)
        lanes, taken, most = np.arange(n), 0, int(MAX_TIME / h)
        inputs = _inputs(x, h, parameters)
        while len(lanes) and taken < most:
            count = _block_of(free, inputs[:, : len(lanes)], h, most - taken)
            X = self._advance_block(free, inputs, h, count)
            ended, cause = way.end(lanes, X[:, :, : len(lanes)], taken)
            taken += len(X) - 1
            inputs[: len(x)] = X[-1]
            if len(ended):
                outcome[lanes[ended]] = cause
                lanes, inputs = _without(ended, lanes, inputs)

        return state, time, outcome

    def _advance_block(
        self, free: bool, inputs: np.ndarray, h: float, count: int
    ) -> np.ndarray:
        """States (steps + 1, size, n) before and after each of up to `count` time
        steps, from those among the inputs of whole groups of lanes.

        A lane that strikes or falls on the way is integrated with the others. A block
        ends where the angles of one became so large that in the next step the compiled
        sine might reduce those of its neighbours in another way.
        """
        size = 6 if free else 4
        X = np.empty((count + 1, size, inputs.shape[1]))
        X[0] = inputs[:size]
        self._step[free].iterate(inputs, X)
        scale = inputs[size + 2]
        return X[: 2 + _steps_before_wild(X[1:-1], h, scale)]

    def refine(
        self,
        free: bool,
        x: States,
        fraction: np.ndarray,
        h: float,
        parameters: Parameters,
        ground: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Time within the time step at which the guard vanishes, by Newton on the
        formula, and the state there.
        """
        size, n = x.shape
        inputs = _inputs(x, h, parameters)

        def advanced(at: np.ndarray) -> np.ndarray:
            inputs[size] = whole_groups(at, LANES)
            return self._step[free](inputs)[:, :n]

        at = fraction * h
        for _ in range(2):
            g, rate = guard(free, advanced(at), ground)
            at = np.minimum(np.maximum(at - g / rate, 0.0), h)
        return at, advanced(at)


def _block_of(free: bool, x: States, h: float, most: int) -> int:
    """Time steps of lanes, at most so many, that are taken from some states (size or
    more, n) before strikes are looked for: where all are about to strike, as many as
    all will take.
    """
    count = min(most, _MAX_BLOCK, _BLOCK // x.shape[1])
    g, rate = guard(free, x)
    if g.min() > 0 and rate.max() < 0:
        latest = -float((g / rate).min()) / h
        count = int(min(count, 2 + latest))
    return max(1, count)


def _without(
    ended: Numbers, lanes: Numbers, inputs: np.ndarray
) -> tuple[Numbers, np.ndarray]:
    """The lanes that have not ended, with their inputs in whole groups."""
    goes_on = np.ones(len(lanes), bool)
    goes_on[ended] = False
    kept = np.flatnonzero(goes_on)
    return lanes[kept], whole_groups(inputs[:, kept], LANES)


def _inputs(x: States, h: float, parameters: Parameters) -> np.ndarray:
    """What a compiled time step takes: states, its length and parameters, of whole
    groups of lanes.
    """
    lengths = np.full((1, x.shape[1]), h)
    return whole_groups(np.concatenate([x, lengths, parameters]), LANES)


@dataclass
class _Way:
    """Lanes on their way to a strike, with the states and times of those that struck."""

    scan: Scanner
    free: bool
    h: float
    begin: PerLane
    parameters: Parameters
    height: PerLane | None
    state: States
    time: PerLane

    def end(
        self, lanes: Numbers, X: np.ndarray, taken: int
    ) -> tuple[Numbers, np.ndarray]:
        """Places of lanes that end within time steps, after so many taken, and why."""
        first, fraction = self._first_strikes(lanes, X)
        steps = len(X) - 1
        cause = np.full(len(lanes), STRUCK)
        for why, ends in self._falls(lanes, X, taken):
            at = np.where(ends.any(axis=0), ends.argmax(axis=0), steps)
            sooner = at < first
            first[sooner] = at[sooner]
            cause[sooner] = why

        ended = np.flatnonzero(first < steps)
        struck = ended[cause[ended] == STRUCK]
        if len(struck):
            place = first[struck]
            begin = (taken + place) * self.h
            self._strike(lanes[struck], X[place, :, struck].T, fraction[struck], begin)

        return ended, cause[ended]

    def _first_strikes(
        self, lanes: Numbers, X: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The first time step of each lane in which it may strike, the number of all
        where it does not, and the fraction of that step.
        """
        step, lane, share = crossings(self.free, X, self.h, self._ground(lanes))
        first = np.full(len(lanes), len(X) - 1)
        fraction = np.zeros(len(lanes))
        first[lane[::-1]] = step[::-1]
        fraction[lane[::-1]] = share[::-1]
        return first, fraction

    def _falls(
        self, lanes: Numbers, X: np.ndarray, taken: int
    ) -> Iterator[tuple[int, np.ndarray]]:
        """After which time steps (steps, n) lanes end without a strike, by why, in the
        order in which that counts; what follows the first end of a lane does not.
        """
        if not np.isfinite(X[-1]).all():  # what is lost remains so
            yield LOST, ~np.isfinite(X[1:]).all(axis=1)

        angle = X[1:, 0]
        scale = self.parameters[1, lanes]
        largest = scale.max()
        if not angle.min() * largest >= -MAX_ANGLE:
            yield FORWARD, angle * scale < -MAX_ANGLE
        if not angle.max() * largest <= MAX_ANGLE:
            yield BACKWARD, angle * scale > MAX_ANGLE

        elapsed = np.arange(taken + 1, taken + len(X))[:, None] * self.h
        begin = self.begin[lanes]
        if begin.max() + elapsed[-1] > MAX_TIME:
            late = NO_KNEESTRIKE if self.free else NO_HEELSTRIKE
            yield late, begin + elapsed > MAX_TIME

    def _strike(
        self, lanes: Numbers, x: States, share: np.ndarray, begin: np.ndarray
    ) -> None:
        """Locate the strikes of some lanes within the time steps that begin at x."""
        within, self.state[:, lanes] = self.scan.refine(
            self.free, x, share, self.h, self.parameters[:, lanes], self._ground(lanes)
        )
        self.time[lanes] = begin + within

    def _ground(self, lanes: Numbers) -> np.ndarray | None:
        """What `crossings` takes of the ground."""
        if self.height is None:
            return None
        return np.array([self.parameters[1, lanes], self.height[lanes]])


@np.errstate(invalid="ignore")
def _steps_before_wild(X: np.ndarray, h: float, scale: PerLane) -> int:
    """Number of states (steps, size, n) before the angles of one are, or change, so much
    that the next step is not to be trusted; all if none are.
    """
    # Time steps are below 1: a rate changes an angle by less than its own number.
    bound = _WILD / scale.max()
    if X.max(initial=0.0) < bound and X.min(initial=0.0) > -bound:
        return len(X)

    half = X.shape[1] // 2
    angles = np.abs(X[:, :half]).max(axis=1)
    changes = h * np.abs(X[:, half:]).max(axis=1)
    is_tame = (np.maximum(angles, changes) * scale < _WILD).all(axis=1)
    return len(X) if is_tame.all() else int(is_tame.argmin())


def _compile(
    structure: Structure,
    size: int,
    outputs: Callable[[Symbols, list[Sym]], list[Sym]],
) -> CompiledFunction:
    """Compile a function of a state and the parameters."""
    p, x = Symbols(structure), vector("x", size)
    return CompiledFunction(outputs(p, x), [*x, *p.variables])


def _release_on_uneven_ground(structure: Structure) -> CompiledFunction:
    """Compile what `Scanner._rates_on_uneven_ground` is."""
    return _compile(
        structure,
        4,
        lambda p, x: release(structure, p, x[1], x[2], x[3], old_angle=x[0]),
    )


@functools.lru_cache(maxsize=16)
def scanner(structure: Structure) -> Scanner:
    """Return the compiled scanner of a structure, one a process."""
    return compiled(Scanner, structure)


def stride(
    problem: Problem, y: Sections, slope: Slopes, exact: bool = True
) -> SimulatedSteps:
    """Simulate one step from any state on the section.

    Parameters
    ----------
    problem : Problem
        The walker.
    y : ndarray, shape (m, n)
        Section coordinates [rad, rad/sqrt(leg/g)].
    slope : ndarray, shape (n,) [rad]
    exact : bool
        Correct by the exact step map and give its Jacobian (to about 1e-7); otherwise
        the image is accurate to 1e-8.

    Returns
    -------
    SimulatedSteps
    """
    n = y.shape[1]
    if n > _SIDE_BY_SIDE:
        parts = np.split(np.arange(n), range(_SIDE_BY_SIDE, n, _SIDE_BY_SIDE))
        blocks = []
        for part in parts:
            some = problem.some(part)
            blocks.append(stride(some, y[:, part], slope[part], exact))
        joined: SimulatedSteps = join_lanes(blocks)
        return joined

    steps, scale, parameters = _scan(problem, y, slope)
    if exact:
        _correct(problem, steps, y / scale, scale, parameters)
    return steps


def _correct(
    problem: Problem,
    steps: SimulatedSteps,
    y: Sections,
    scale: PerLane,
    parameters: Parameters,
) -> None:
    """Correct simulated steps from scaled sections by the exact step map, in place."""
    m, k = len(y), len(steps.times)
    steps.jacobian = np.full((m, *y.shape), np.nan)
    steps.closing = np.full((m + k, k, y.shape[1]), np.nan)
    lanes = np.flatnonzero(steps.outcome == STRUCK)
    if len(lanes):
        at = problem.step(y[:, lanes], steps.times[:, lanes], parameters[:, lanes])
        steps.image[:, lanes] = at.image * scale[lanes]
        steps.times[:, lanes] = at.times
        steps.jacobian[:, :, lanes] = at.jacobian
        steps.closing[:, :, lanes] = _closing(at.derivative, m, k)
        steps.outcome[lanes[~np.isfinite(at.image).all(axis=0)]] = LOST


@np.errstate(divide="ignore", invalid="ignore")  # guards that close tangentially
def _closing(derivative: np.ndarray, m: int, k: int) -> np.ndarray:
    """What `SimulatedSteps` has, from the derivatives of the joint equations by state,
    times and drive, (m + k, m + k + 1, n).
    """
    by_times = derivative[:, m : m + k]
    guards = by_times[m:]
    # A guard does not feel the strikes after its own.
    moved = np.zeros_like(guards)
    for i in range(k):
        moved[i, i] = 1.0
        for j in range(i):
            moved[i] += guards[i, j] * moved[j]
        moved[i] = -moved[i] / guards[i, i]

    image = total(by_times[:m, [j]] * moved[j] for j in range(k))
    return np.concatenate([image, moved])


def fly_on(
    problem: Problem, links: States, is_bent: np.ndarray, slope: Slopes
) -> tuple[Sections, np.ndarray]:
    """Fly states within a step to the heelstrike that ends it.

    Parameters
    ----------
    problem : Problem
        The walker, n lanes.
    links : ndarray, shape (6, n) [rad, rad/sqrt(leg/g)]
        Angles, then rates, of stance leg, swing thigh and swing shank.
    is_bent : ndarray of bool, shape (n,)
        Whether the swing knee is bent, so that a kneestrike is to come; of straight knees
        it has been, or is now.
    slope : ndarray, shape (n,) [rad]

    Returns
    -------
    section : ndarray, shape (m, n) [rad, rad/sqrt(leg/g)]
        NaN of falls.
    outcome : ndarray of int, shape (n,)
        Index of CAUSES.
    """
    scan = scanner(problem.structure)
    scale = scale_of(np.maximum(np.abs(links[:3]).max(axis=0), _LEAST_ANGLE))
    parameters = problem.parameters(slope, scale)
    x, outcome = _with_locked_knees(scan, links / scale, is_bent, parameters)

    lanes = np.flatnonzero(outcome == STRUCK)
    state, _, outcome[lanes] = scan.integrate_to_event(
        False, x[:, lanes], np.zeros(len(lanes)), parameters[:, lanes]
    )

    section = np.full((problem.m, len(slope)), np.nan)
    struck = outcome[lanes] == STRUCK
    lanes = lanes[struck]
    if len(lanes):
        landed = scan.strike(state[:, struck], parameters[:, lanes])
        section[:, lanes] = landed * scale[lanes]

    return section, outcome


def _with_locked_knees(
    scan: Scanner, x: States, is_bent: np.ndarray, parameters: Parameters
) -> tuple[States, np.ndarray]:
    """Scaled states (4, n) of two links after kneestrike, from those of three, and the
    outcomes until then.
    """
    outcome = np.full(x.shape[1], STRUCK)
    two = x[[0, 1, 3, 4]]
    if not scan.structure.kneed:
        return two, outcome

    bent = np.flatnonzero(is_bent)
    if len(bent):
        x[:, bent], _, outcome[bent] = scan.integrate_to_event(
            True, x[:, bent], np.zeros(len(bent)), parameters[:, bent]
        )

    lanes = np.flatnonzero(outcome == STRUCK)
    if len(lanes):
        two[:, lanes] = scan.lock(x[:, lanes], parameters[:, lanes])
    return two, outcome


def step_onto(
    problem: Problem, y: Sections, slope: Slopes, height: PerLane
) -> SimulatedSteps:
    """Simulate two steps: one that ends on ground of another height, and one on ground
    parallel to the slope.

    Parameters
    ----------
    problem : Problem
        The walker.
    y : ndarray, shape (m, n)
        Section coordinates [rad, rad/sqrt(leg/g)] before them.
    slope : ndarray, shape (n,) [rad]
    height : ndarray, shape (n,)
        By which the ground rises at the end of the first step, over l.

    Returns
    -------
    SimulatedSteps
        The second step, not exact.
    """
    return _scan(problem, y, slope, height)[0]


def _scan(
    problem: Problem, y: Sections, slope: Slopes, height: PerLane | None = None
) -> tuple[SimulatedSteps, np.ndarray, np.ndarray]:
    """Steps by the scan alone (those after one onto a `height`), with the scales and
    parameters of every lane.
    """
    n = y.shape[1]
    image, times = np.full(y.shape, np.nan), np.full((problem.phases, n), np.nan)
    lanes, outcome = _standing(y)
    scale = np.ones(n)
    scale[lanes] = scale_of(y[0, lanes])
    parameters = problem.parameters(slope, scale)
    start = problem.map.start(y[:, lanes] / scale[lanes], parameters[:, lanes])
    x = start[: problem.map.start_size]

    def walk(height: PerLane | None) -> States:
        """The state before the next heelstrike, of those that come to it."""
        nonlocal lanes
        struck, state, times[:, lanes], outcome[lanes] = scan.to_heelstrike(
            x, parameters[:, lanes], height
        )
        lanes = lanes[struck]
        return state

    scan = scanner(problem.structure)
    if height is not None:
        x = walk(height[lanes])
        x = scan.land(x, parameters[:, lanes]) if len(lanes) else x

    x = walk(None)
    if len(lanes):
        image[:, lanes] = scan.strike(x, parameters[:, lanes]) * scale[lanes]
    none = np.empty((0, 0, n))
    steps = SimulatedSteps(image, times, outcome, none, none)
    return steps, scale, parameters


def _standing(y: Sections) -> tuple[Numbers, np.ndarray]:
    """Lanes whose walkers may take a step, and how the others have fallen already."""
    outcome = np.full(y.shape[1], LOST)
    # With the new stance leg behind or upright the walker falls back.
    outcome[np.isfinite(y[0]) & (y[0] <= 0)] = BACKWARD
    outcome[y[0] >= MAX_ANGLE] = FORWARD
    valid = np.isfinite(y).all(axis=0) & (y[0] > 0) & (y[0] < MAX_ANGLE)
    return np.flatnonzero(valid), outcome
