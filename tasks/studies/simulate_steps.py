"""Steps from any state, one after another, with pushes and ground of changing height.

The motion is integrated by heyoka's adaptive Taylor method, which locates the strikes
on its polynomials. This is not the way the step map is computed, whose event times are
unknowns. Ground that rises or falls by `height` at a step ends it when the swing foot's
centre lies l (cos stance - cos swing) = height above the stance foot's (up is
positive); the legs then stand at two different angles.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.equations import system
from gaitsweep.tasks.mechanics.kernel import COMPACT, compiled
from gaitsweep.tasks.mechanics.lumped import Structure, general_structure_of
from gaitsweep.tasks.step.problem import Lanes, Problem, scale_of
from gaitsweep.tasks.step.simulate import (
    BACKWARD,
    CAUSES,
    FORWARD,
    LOST,
    MAX_ANGLE,
    MAX_TIME,
    NO_HEELSTRIKE,
    NO_KNEESTRIKE,
    STRUCK,
    scanner,
)
from gaitsweep.tasks.step.stance import ON_GROUND, between_feet, ground_under
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import Walker, WalkerError

#: Intervals of each phase at whose ends the motion is sampled.
SAMPLES = 48
#: Scaled half angle between the legs below which they count as parallel, and time after
#: which a guard may strike.
_PARALLEL, _MIN_TIME = 1e-6, 1e-9
#: Scaled rate from which a motion counts as lost: its Taylor coefficients might
#: overflow.
_MAX_RATE = 1e8


def simulate_steps(params: Mapping[str, Any]) -> dict[str, Any]:
    """Simulate steps from a state just after heelstrike.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `set` (keys to change), `slope` [rad], `state` (stance
        angle [rad], stance and thigh rate; within a step the angles of stance leg and
        thigh, and of a free shank, then their rates), `steps` (their number n), `pushes` ({step:
        (change of the stance rate, of the thigh rate)}), `ground` ({step: height by
        which the ground rises at the end of the step}), `motion` (whether to sample
        it), `dt` (sample it at this step over all steps) and `limits` (with both limits
        at each strike); in the walker's units.

    Returns
    -------
    dict
        In the walker's units, NaN after a fall: `stance_angle`, `thigh_angle`,
        `stance_rate`, `thigh_rate`, `shank_rate`, shape (n + 1,), just after the
        heelstrike before each step and after the last, before the step's push; `period`
        and `kneestrike_time`, shape (n,); `cause`, of CAUSES, and `steps_taken`. With
        `motion` also `time` (from the start of the step), `theta_st`, `theta_th`,
        `theta_sh` and `foot_x`, shape (n, phases, SAMPLES + 1); with `dt`, in `series`,
        the same along one axis, times from the start, with `rate_st`, `rate_th`,
        `rate_sh` and `step_number`. `above_ground_of` is the slope on which both feet
        would stand where the swing foot begins above the ground behind, else None.

    Raises
    ------
    WalkerError
        If the walker or the state is invalid.
    """
    start = begin(params)
    walker, scale = start.problem.walker, start.parameters[1, 0]
    when = _sampling(params, walker.time_unit)
    taken = _take_steps(start, params, when)

    result = _of_steps(taken.states, taken.times, walker.time_unit)
    result["cause"] = CAUSES[taken.outcome]
    result["steps_taken"] = taken.count
    result["above_ground_of"] = start.ground
    if isinstance(when, _Series):
        result["series"] = _series(walker, taken.motion, taken.times, scale)
    elif when:
        result |= _of_phases(walker, taken.motion, taken.times.shape, scale)

    return result


@dataclass
class _Taken:
    """Steps taken, of n.

    Attributes
    ----------
    states : ndarray, shape (n + 1, 6) [rad, rad/sqrt(leg/g)]
        Angles and rates of three links before each step and after the last; NaN after a
        fall.
    times : ndarray, shape (n, phases) [sqrt(leg/g)]
        Of the strikes since the start of the step.
    motion : list of list of ndarray
        Samples of each phase of each step, scaled.
    count : int
        How many were taken.
    outcome : int
        Of the last one, index of CAUSES.
    """

    states: np.ndarray
    times: np.ndarray
    motion: list[list[np.ndarray]] = field(default_factory=list)
    count: int = 0
    outcome: int = STRUCK

    @classmethod
    def of(cls, n: int, phases: int) -> _Taken:
        """None taken yet of n."""
        return cls(np.full((n + 1, 6), np.nan), np.full((n, phases), np.nan))

    def add(self, k: int, step: Step, locked: bool) -> None:
        """Add what a step shows, which has no kneestrike if the knee was locked."""
        first = self.times.shape[1] - 1 if locked else 0
        self.times[k, first : first + len(step.times)] = step.times
        self.motion.append(step.motion)
        self.outcome = step.outcome


def _take_steps(
    start: Start, params: Mapping[str, Any], when: Sampling | None
) -> _Taken:
    """Take steps with their pushes and ground, until the walker falls."""
    problem, parameters = start.problem, start.parameters[:, 0]
    n, scale = int(params["steps"]), parameters[1]
    taken = _Taken.of(n, problem.phases)
    x, locked = start.x, start.locked
    taken.states[0] = _all_angles(x) * scale
    for k in range(n):
        push, height = _disturbance(params, k, problem.walker)
        pushed = _push(x, push / scale)
        step = take_step(problem, pushed, parameters, height, when, locked)
        taken.add(k, step, locked)
        if step.outcome != STRUCK:
            break

        x, locked = step.state, False
        taken.count = k + 1
        taken.states[k + 1] = _all_angles(x) * scale
        if isinstance(when, _Series):
            when.began += step.times[-1]

    return taken


def _disturbance(
    params: Mapping[str, Any], k: int, walker: Walker
) -> tuple[np.ndarray, float]:
    """The push before a step, and the height by which the ground rises at its end, over
    l.
    """
    push = params.get("pushes", {}).get(k, (0.0, 0.0))
    height = params.get("ground", {}).get(k, 0.0)
    return np.array(push) * walker.time_unit, float(height) / walker.l


def _of_steps(
    states: np.ndarray, times: np.ndarray, time_unit: float
) -> dict[str, Any]:
    """States with which steps begin, and times of their strikes, in the walker's units."""
    rates = states[:, 3:] / time_unit
    phases = times.shape[1]
    knee = times[:, 0] if phases == 2 else np.full(len(times), np.nan)

    return {
        "stance_angle": states[:, 0],
        "thigh_angle": states[:, 1],
        "stance_rate": rates[:, 0],
        "thigh_rate": rates[:, 1],
        "shank_rate": rates[:, 2],
        "period": times[:, -1] * time_unit,
        "kneestrike_time": knee * time_unit,
    }


def _sampling(params: Mapping[str, Any], time_unit: float) -> Sampling | None:
    """When to sample the motion, if that is asked for."""
    if params.get("dt"):
        return _Series(float(params["dt"]) / time_unit, bool(params.get("limits")))
    return _evenly if params.get("motion") else None


def _of_phases(
    walker: Walker,
    motion: list[list[np.ndarray]],
    shape: tuple[int, ...],
    scale: float,
) -> dict[str, Any]:
    """Samples of each phase of n steps, shape (n, phases), in the walker's units."""
    n, phases = shape
    samples = np.full((n, 4, phases, SAMPLES + 1), np.nan)
    for k, of_step in enumerate(motion):
        first = phases - len(of_step) if k == 0 and len(of_step) < phases else 0
        for place, phase in enumerate(of_step):
            samples[k, :, first + place] = phase[:4]

    angles = samples[:, 1:] * scale
    result = {
        "time": samples[:, 0] * walker.time_unit,
        "foot_x": -walker.R * angles[:, 0],
    }
    for i, link in enumerate(("st", "th", "sh")):
        result[f"theta_{link}"] = angles[:, i]
    return result


def _series(
    walker: Walker, motion: list[list[np.ndarray]], times: np.ndarray, scale: float
) -> dict[str, Any]:
    """Samples of all steps in a row, in the walker's units; times since the start."""
    ends = np.cumsum(times[:, -1])
    begins = np.concatenate([[0.0], ends])
    numbers, parts = [], []
    for k, of_step in enumerate(motion):
        for phase in of_step:
            numbers.append(np.full(phase.shape[1], k, np.int32))
            parts.append(phase + np.array([begins[k], *[0.0] * 6])[:, None])

    rows = np.hstack(parts) if parts else np.empty((7, 0))
    result = {
        "step_number": np.concatenate(numbers) if numbers else np.empty(0, np.int32),
        "time": rows[0] * walker.time_unit,
        "foot_x": -walker.R * rows[1] * scale,
    }
    for i, link in enumerate(("st", "th", "sh")):
        result[f"theta_{link}"] = rows[1 + i] * scale
        result[f"rate_{link}"] = rows[4 + i] * scale / walker.time_unit

    return result


@dataclass
class Start:
    """What steps from a state begin with.

    Attributes
    ----------
    problem : Lanes
    parameters : ndarray, shape (n_parameters, 1)
        Slope, scale and constants.
    y : ndarray, shape (3, 1), or None
        The state in section coordinates, scaled; None of one within a step.
    x : ndarray, shape (4,) or (6,)
        The same as angles and rates of the links, scaled.
    locked : bool
        Whether a knee is locked already.
    ground : float or None
        The slope of the ground on which both feet would stand, if the swing foot is above
        the ground behind the stance foot [rad].
    """

    problem: Lanes
    parameters: np.ndarray
    y: np.ndarray | None
    x: np.ndarray
    locked: bool = False
    ground: float | None = None


def begin(params: Mapping[str, Any]) -> Start:
    """Return what steps from a state begin with.

    Parameters
    ----------
    params : mapping
        `walker`, `set`, `slope` and `state`, as `simulate_steps` takes them.

    Raises
    ------
    WalkerError
        If the walker or the state is invalid.
    """
    problem = section_problem(walker_of_line(params))
    slope = np.array([float(params["slope"])])
    state, time_unit = np.array(params["state"], float), problem.walker.time_unit
    if len(state) != 3:
        half = len(state) // 2
        state[half:] *= time_unit
        if len(state) == 6 or abs(state[:2].sum()) > ON_GROUND:
            return _begin_within(problem, slope, state)
        state = state[[0, 2, 3]] / [1.0, time_unit, time_unit]

    if not 0 < state[0] < MAX_ANGLE:
        raise WalkerError(
            "state",
            f"{float(state[0])!r} rad",
            f"must have a stance angle in (0, {MAX_ANGLE:.4g}) rad",
        )

    scale = scale_of(state[:1])
    parameters = problem.parameters(slope, scale)
    on_section = (state * [1.0, time_unit, time_unit])[:, None]
    y = problem.section_of(on_section, slope) / scale
    x = problem.map.start(y, parameters)[: problem.map.start_size, 0]
    return Start(problem, parameters, y, x)


def _begin_within(problem: Lanes, slope: np.ndarray, state: np.ndarray) -> Start:
    """What a step goes on with from a state within it: angles, then rates over
    sqrt(g/leg), of two links or three.
    """
    walker, links = problem.walker, len(state) // 2
    if links == 3 and not walker.knees:
        raise WalkerError("state", f"{len(state)} numbers", "must have no knee")

    stance, thigh, shank = state[[0, 1, links - 1]]
    angles = np.abs(state[:links])
    if not angles.max() < MAX_ANGLE:
        raise WalkerError(
            "state", f"{angles.max():g} rad", f"must have angles below {MAX_ANGLE:.4g}"
        )
    if shank > thigh:
        raise WalkerError(
            "state", f"{shank - thigh:g} rad", "must not overextend the knee"
        )

    way = between_feet(walker, stance, thigh, shank)
    height = float(way.imag)
    ground = float(slope[0] - ground_under(way))
    if height < 0:
        raise WalkerError(
            "state",
            f"{height:.3g}",
            "must have the swing foot above the ground; both feet of this state stand on"
            f" a slope of {ground:.6g} rad ({np.degrees(ground):.2f}°), to which it belongs",
        )

    scale = scale_of(np.maximum(angles.max(keepdims=True), 1e-3))
    parameters = problem.parameters(slope, scale)
    locked = links == 2
    is_behind = stance > thigh
    x = state / scale
    return Start(problem, parameters, None, x, locked, ground if is_behind else None)


def section_problem(walker: Walker) -> Lanes:
    """Step map of a walker with three coordinates on its section, those of point feet
    as of other straight legs.
    """
    return Lanes([walker], general_structure_of(walker))


def _push(x: np.ndarray, change: np.ndarray) -> np.ndarray:
    """State with changes (2,) added to the scaled rates of stance leg and swing leg; a
    free knee is not bent by it.
    """
    n = len(x) // 2
    return x + np.concatenate([np.zeros(n), change[:1], np.repeat(change[1:], n - 1)])


def _all_angles(x: np.ndarray) -> np.ndarray:
    """Angles and rates of three links (6,); a locked shank moves as its thigh."""
    return x if len(x) == 6 else x[[0, 1, 1, 2, 3, 3]]


@dataclass
class Step:
    """One step: its event times, the scaled state after it, and samples (7, k) of each
    phase of its motion.
    """

    outcome: int
    times: list[float]
    state: np.ndarray
    motion: list[np.ndarray]


#: At which times within a phase its motion is sampled, from when it begins within the
#: step and how long it takes.
Sampling = Callable[[float, float], np.ndarray]


def _evenly(begin: float, duration: float) -> np.ndarray:
    """The ends of equal intervals of a phase."""
    return np.linspace(0.0, duration, SAMPLES + 1)


@dataclass
class _Series:
    """Times at a constant step `dt` over all steps, of which the present one began at
    `began`; with `limits` also both ends of each phase.
    """

    dt: float
    limits: bool
    began: float = 0.0

    def __call__(self, begin: float, duration: float) -> np.ndarray:
        """Times within a phase; one at its end belongs to the next."""
        start = self.began + begin
        first = int(np.ceil(start / self.dt - 1e-9))
        last = int(np.ceil((start + duration) / self.dt - 1e-9))
        at = np.clip(np.arange(first, last) * self.dt - start, 0.0, duration)
        if not self.limits:
            return at

        inside = at[(at > _MIN_TIME) & (at < duration - _MIN_TIME)]
        return np.concatenate([[0.0], inside, [duration]])


def take_step(
    problem: Problem,
    x: np.ndarray,
    parameters: np.ndarray,
    height: float = 0.0,
    when: Sampling | None = None,
    locked: bool = False,
) -> Step:
    """Take one step.

    Parameters
    ----------
    problem : Problem
    x : ndarray, shape (4,) or (6,)
        Scaled state just after heelstrike.
    parameters : ndarray, shape (n_parameters,)
    height : float
        By which the ground rises at the end of the step, over l.
    when : callable, optional
        At which times to sample the motion.
    locked : bool
        Whether the knee is locked already.

    Returns
    -------
    Step
    """
    structure, begin = problem.structure, 0.0
    scan, lane = scanner(structure), parameters[:, None]
    times, motion = [], []
    for free in (True, False) if structure.kneed and not locked else (False,):
        x, end, outcome, samples = _phase(structure, free).integrate(
            x, begin, parameters, height, when
        )
        motion += samples
        if outcome != STRUCK:
            break

        times.append(end)
        if free:
            x, begin = scan.lock(x[:, None], lane)[:, 0], end
    else:
        x = scan.land(x[:, None], lane)[:, 0]

    return Step(outcome, times, x, motion)


class _Phase:
    """The motion of three links to kneestrike (`free`), or of two to heelstrike, with
    its events.
    """

    def __init__(self, structure: Structure, free: bool):
        flow = system(structure, free, 0, False)
        self.links, self.parameters = 3 if free else 2, flow.parameters()
        q = hy.make_vars(*(f"q{i}" for i in range(self.links)))
        scale, height, limit = (hy.par[len(flow.held) + i] for i in range(3))
        half_sum = scale * (q[0] + q[1]) * 0.5
        half_between = scale * (q[1] - q[0]) * 0.5
        # Height of the swing foot's centre above the stance foot's, less that of the
        # ground, over l.
        gap = 2.0 * hy.sin(half_sum) * hy.sin(half_between) - height
        self.outcomes = [STRUCK, BACKWARD, FORWARD]
        self._taylor: Any = hy.taylor_adaptive(
            flow.equations,
            state=np.zeros(2 * self.links),
            t_events=[
                hy.t_event(
                    q[1] - q[2] if free else gap,
                    direction=hy.event_direction.negative,
                    callback=_is_no_kneestrike if free else _is_no_heelstrike,
                ),
                hy.t_event(q[0] - limit, direction=hy.event_direction.positive),
                hy.t_event(q[0] + limit, direction=hy.event_direction.negative),
            ],
            **COMPACT,
        )

    def integrate(
        self,
        x: np.ndarray,
        begin: float,
        parameters: np.ndarray,
        height: float,
        when: Sampling | None,
    ) -> tuple[np.ndarray, float, int, list[np.ndarray]]:
        """Integrate a scaled state to the strike.

        Parameters
        ----------
        x : ndarray, shape (2 links,)
        begin : float [sqrt(leg/g)]
            Time since the step began.
        parameters : ndarray, shape (n_parameters,)
        height : float
            By which the ground rises, over l.
        when : callable, optional
            At which times to sample the motion.

        Returns
        -------
        state : ndarray, shape (2 links,)
        end : float [sqrt(leg/g)]
            Time of the strike since the step began.
        outcome : int
            Index of CAUSES.
        samples : list of ndarray, shape (7, k)
            Times, angles and rates of the three links, also of a motion that ends in a
            fall; empty where not asked for.
        """
        if not np.abs(x).max() < _MAX_RATE:
            return x, begin, LOST, []

        scale = parameters[1]
        self._taylor.pars[:] = [
            *self.parameters(parameters),
            scale,
            height,
            MAX_ANGLE / scale,
        ]
        self._taylor.state[:], self._taylor.time = x, 0.0
        self._taylor.reset_cooldowns()
        stop, _, _, _, motion, _ = self._taylor.propagate_until(
            MAX_TIME - begin, c_output=when is not None
        )
        end, state = float(self._taylor.time), np.array(self._taylor.state)
        outcome = self._outcome(int(stop), state)
        samples = []
        if when and outcome != LOST:
            at = when(begin, end)
            samples = [self._sampled(motion(at), begin + at)]

        return state, begin + end, outcome, samples

    def _outcome(self, stop: int, state: np.ndarray) -> int:
        """Index of CAUSES for what ended an integration, and the state there."""
        if not np.isfinite(state).all():
            return LOST
        event = -1 - stop  # heyoka counts the events that stop it down from -1
        if event in (0, 1, 2):
            return int(self.outcomes[event])
        return NO_KNEESTRIKE if self.links == 3 else NO_HEELSTRIKE

    def _sampled(self, states: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Times, and angles and rates of three links, from states at these."""
        by_time = states.reshape(len(time), 2 * self.links)  # perhaps at none
        angles, rates = np.split(by_time.T, 2)
        links = [0, 1, self.links - 1]
        return np.vstack([time, angles[links], rates[links]])


def _is_no_kneestrike(taylor: Any, sign: int) -> bool:
    """Whether the motion goes on where the flexion falls to zero: at the start of a
    step it has not flexed.
    """
    return taylor.time < _MIN_TIME


def _is_no_heelstrike(taylor: Any, sign: int) -> bool:
    """Whether the motion goes on where the foot reaches the ground: beside the stance
    foot, or with that leg behind.

    It does so beside the stance foot also after the swing leg has turned over the hip.
    """
    x, scale = taylor.state, taylor.pars[-3]
    return not (x[0] < 0 and 2 * _PARALLEL < x[1] - x[0] < np.pi / scale)


@functools.lru_cache(maxsize=16)
def _phase(structure: Structure, free: bool) -> _Phase:
    """The compiled motion of a phase, one a process."""
    return compiled(_Phase, structure, free)
