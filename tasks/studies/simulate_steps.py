"""Steps from any state, one after another, with pushes and ground of changing height.

The motion is integrated by heyoka's adaptive Taylor method, which locates the strikes
on its polynomials. This is not the way the step map is computed, whose event times are
unknowns. Ground that rises or falls by `height` at a step ends it when the swing foot's
centre lies l (cos stance - cos swing) = height above the stance foot's (up is
positive); the legs then stand at two different angles.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import heyoka as hy
import numpy as np

from gaitsweep.tasks.mechanics.equations import system
from gaitsweep.tasks.mechanics.kernel import prepare_compiler
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
        angle [rad], stance and thigh rate), `steps` (their number n), `pushes` ({step:
        (change of the stance rate, of the thigh rate)}), `ground` ({step: height by
        which the ground rises at the end of the step}), `motion` (whether to sample
        it); in the walker's units.

    Returns
    -------
    dict
        In the walker's units, NaN after a fall: `stance_angle`, `thigh_angle`,
        `stance_rate`, `thigh_rate`, `shank_rate`, shape (n + 1,), just after the
        heelstrike before each step and after the last, before the step's push; `period`
        and `kneestrike_time`, shape (n,); `cause`, of CAUSES, and `steps_taken`. With
        `motion` also `time` (from the start of the step), `theta_st`, `theta_th`,
        `theta_sh` and `foot_x`, shape (n, phases, SAMPLES + 1).

    Raises
    ------
    WalkerError
        If the walker or the state is invalid.
    """
    problem, parameters, _, x = begin(params)
    walker, scale = problem.walker, parameters[1, 0]
    n, phases, time_unit = int(params["steps"]), problem.phases, walker.time_unit
    states, times = np.full((n + 1, 6), np.nan), np.full((n, phases), np.nan)
    motion = np.full((n, 4, phases, SAMPLES + 1), np.nan)
    outcome, taken = STRUCK, 0
    for k in range(n + 1):
        states[k] = _all_angles(x) * scale
        if k == n:
            break
        x = _push(
            x, np.array(params.get("pushes", {}).get(k, (0.0, 0.0))) * time_unit / scale
        )
        height = float(params.get("ground", {}).get(k, 0.0)) / walker.l
        step = take_step(
            problem, x, parameters[:, 0], height, bool(params.get("motion"))
        )
        times[k, : len(step.times)] = step.times
        motion[k, :, : len(step.motion)] = np.moveaxis(step.motion, 1, 0)
        outcome = step.outcome
        if outcome != STRUCK:
            break
        taken, x = k + 1, step.state
    rates = states[:, 3:] / time_unit
    result = {
        "stance_angle": states[:, 0],
        "thigh_angle": states[:, 1],
        "stance_rate": rates[:, 0],
        "thigh_rate": rates[:, 1],
        "shank_rate": rates[:, 2],
        "period": times[:, -1] * time_unit,
        "kneestrike_time": (times[:, 0] if phases == 2 else np.full(n, np.nan))
        * time_unit,
        "cause": CAUSES[outcome],
        "steps_taken": taken,
    }
    if params.get("motion"):
        angles = motion[:, 1:] * scale
        result |= {"time": motion[:, 0] * time_unit, "foot_x": -walker.R * angles[:, 0]}
        result |= {
            f"theta_{link}": angles[:, i] for i, link in enumerate(("st", "th", "sh"))
        }
    return result


def begin(
    params: Mapping[str, Any],
) -> tuple[Lanes, np.ndarray, np.ndarray, np.ndarray]:
    """What steps from a state begin with.

    Parameters
    ----------
    params : mapping
        `walker`, `set`, `slope` and `state`, as `simulate_steps` takes them.

    Returns
    -------
    problem : Lanes
    parameters : ndarray, shape (n_parameters, 1)
        Slope, scale and constants.
    y, x : ndarray, shape (3, 1) and (4,) or (6,)
        The state in section coordinates, and as angles and rates of the links; scaled.

    Raises
    ------
    WalkerError
        If the walker or the state is invalid.
    """
    problem = section_problem(walker_of_line(params))
    slope = np.array([float(params["slope"])])
    state, time_unit = np.array(params["state"], float), problem.walker.time_unit
    if not 0 < state[0] < MAX_ANGLE:
        raise WalkerError(
            "state",
            f"{float(state[0])!r} rad",
            f"must have a stance angle in (0, {MAX_ANGLE:.4g}) rad",
        )
    scale = scale_of(state[:1])
    parameters = problem.parameters(slope, scale)
    y = (
        problem.section_of((state * [1.0, time_unit, time_unit])[:, None], slope)
        / scale
    )
    return (
        problem,
        parameters,
        y,
        problem.map.start(y, parameters)[: problem.map.start_size, 0],
    )


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
    """One step: its event times, the scaled state after it, and samples (phases, 4,
    SAMPLES + 1) of its motion.
    """

    outcome: int
    times: list[float]
    state: np.ndarray
    motion: np.ndarray


def take_step(
    problem: Problem,
    x: np.ndarray,
    parameters: np.ndarray,
    height: float = 0.0,
    sampled: bool = False,
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
    sampled : bool
        Whether to sample the motion.

    Returns
    -------
    Step
    """
    structure, begin = problem.structure, 0.0
    scan, lane = scanner(structure), parameters[:, None]
    times, motion = [], []
    for free in (True, False) if structure.kneed else (False,):
        x, end, outcome, samples = _phase(structure, free).integrate(
            x, begin, parameters, height, sampled
        )
        motion += samples
        if outcome != STRUCK:
            break
        times.append(end)
        if free:
            x, begin = scan.lock(x[:, None], lane)[:, 0], end
    else:
        x = scan.land(x[:, None], lane)[:, 0]
    return Step(outcome, times, x, np.array(motion).reshape(-1, 4, SAMPLES + 1))


class _Phase:
    """The motion of three links to kneestrike (`free`), or of two to heelstrike, with
    its events.
    """

    def __init__(self, structure: Structure, free: bool):
        prepare_compiler()
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
        )

    def integrate(
        self,
        x: np.ndarray,
        begin: float,
        parameters: np.ndarray,
        height: float,
        sampled: bool,
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
        sampled : bool

        Returns
        -------
        state : ndarray, shape (2 links,)
        end : float [sqrt(leg/g)]
            Time of the strike since the step began.
        outcome : int
            Index of CAUSES.
        samples : list of ndarray, shape (4, SAMPLES + 1)
            Times and angles of the motion, also of one that ends in a fall; empty where
            not asked for.
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
            MAX_TIME - begin, c_output=sampled
        )
        end, state = float(self._taylor.time), np.array(self._taylor.state)
        event = -1 - int(stop)  # heyoka counts the events that stop it down from -1
        outcome = (
            self.outcomes[event]
            if event in (0, 1, 2)
            else NO_KNEESTRIKE
            if self.links == 3
            else NO_HEELSTRIKE
        )
        if not np.isfinite(state).all():
            outcome = LOST
        samples = []
        if sampled and outcome != LOST:
            at = np.linspace(0.0, end, SAMPLES + 1)
            angles = motion(at)[:, : self.links].T
            samples = [np.vstack([begin + at, angles[0], angles[1], angles[-1]])]
        return state, begin + end, outcome, samples


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
    return _Phase(structure, free)
