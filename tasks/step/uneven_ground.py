"""Steps onto ground of another height, of many lanes, located as `tasks.step.simulate` locates those on even ground."""

from __future__ import annotations

import functools

import heyoka as hy
import numpy as np

from tasks.mechanics.equations import Symbols
from tasks.mechanics.impacts import heelstrike
from tasks.mechanics.kernel import CompiledFunction, prepare_compiler
from tasks.mechanics.lumped import Structure
from tasks.step.problem import Problem
from tasks.step.simulate import LOST, STRUCK, SimulatedSteps, scanner


@functools.lru_cache(maxsize=16)
def heelstrike_of(structure: Structure) -> CompiledFunction:
    """Return the rates after a heelstrike, compiled, from two links' state and the parameters, at any two angles."""
    prepare_compiler()
    p = Symbols(structure)
    x = list(hy.make_vars(*(f"x{i}" for i in range(4))))
    rates = heelstrike(p, x[1], x[2], x[3], structure.kneed, old_angle=x[0])
    return CompiledFunction(rates, [*x, *p.variables])


def step_onto(problem: Problem, y: np.ndarray, slope: np.ndarray, height: np.ndarray) -> SimulatedSteps:
    """Simulate two steps: one that ends on ground of another height, and one on ground parallel to the slope.

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
        The second step.
    """
    scan, scale = scanner(problem.structure), np.exp2(np.floor(np.log2(y[0])))
    parameters, lanes = problem.parameters(slope, scale), np.arange(y.shape[1])
    x = problem.map.start(y / scale, parameters)[: problem.map.start_size]
    image, times = np.full_like(y, np.nan), np.full((problem.phases, len(lanes)), np.nan)
    outcome = np.full(len(lanes), LOST)
    for ground in (height, None):
        begin = np.zeros(len(lanes))
        for free in (True, False) if problem.phases == 2 else (False,):
            own = parameters[:, lanes]
            over = ground[lanes] if ground is not None and not free else None
            x, time, outcome[lanes] = scan.integrate_to_event(free, x, begin, own, over)
            struck = outcome[lanes] == STRUCK
            lanes, begin, x = lanes[struck], (begin + time)[struck], x[:, struck]
            times[0 if free else -1, lanes] = begin
            if free and len(lanes):
                x = scan.lock(x, parameters[:, lanes])
        if ground is not None and len(lanes):
            rates = scan.call(heelstrike_of(problem.structure), x, parameters[:, lanes])
            x = np.vstack([x[1], np.repeat(x[:1], len(rates) - 1, axis=0), rates])
    if len(lanes):
        image[:, lanes] = scan.strike(x, parameters[:, lanes]) * scale[lanes]
    return SimulatedSteps(image, times, outcome)
