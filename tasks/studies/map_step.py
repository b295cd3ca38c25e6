"""The step map at one state: its image, Jacobian, modes, event times and losses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gaitsweep.tasks.measures.drive import push_off
from gaitsweep.tasks.measures.losses import heelstrike_losses, kneestrike_loss
from gaitsweep.tasks.mechanics.arrays import Parameters
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import CAUSES, STRUCK
from gaitsweep.tasks.step.step_map import Stride
from gaitsweep.tasks.studies.simulate_steps import Start, Step, begin, take_step
from gaitsweep.tasks.walkers.walker import WalkerError


def map_step(params: Mapping[str, Any]) -> dict[str, Any]:
    """Map one state just after heelstrike to the next.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `set` (keys to change), `slope` [rad], and `state`,
        three numbers: stance angle [rad], stance rate and thigh rate just after
        heelstrike, in the walker's units; or one within a step, as `simulate_steps`
        takes it, from which the walker first goes on to the heelstrike.

    Returns
    -------
    dict
        In the walker's units: `state` (3,) after the step; its derivatives `jacobian`
        (3, 3) by the state and `by_slope` (3,); `eigenvalues` (3,) of the Jacobian,
        largest magnitude first, and `eigenvectors` (3, 3), its columns, of length one;
        `kneestrike_time` and `heelstrike_time`; `loss_normal`, `loss_tangential` and
        `loss_kneestrike`. What only knees have is None without them.

    Raises
    ------
    WalkerError
        If the walker or the state cannot be, or the step does not end in a heelstrike.

    Notes
    -----
    The swing shank of a kneed walker starts with the rate that a heelstrike gives it, which the state determines. Point
    feet are mapped in all three coordinates, although after a heelstrike the thigh's
    rate follows from the others.
    """
    start = _on_section(begin(params), params)
    located = _to_heelstrike(start, params)
    guessed = np.array(located.times)[:, None]
    problem = start.problem
    parameters = start.parameters
    y = start.y
    assert y is not None
    step = problem.step(y, guessed, parameters, by_drive=True)

    walker = problem.walker
    mapped = _in_states(problem, y, step, parameters)
    image = mapped["state"]
    jacobian = mapped["jacobian"]
    values, vectors = _modes(jacobian, walker.point_foot or walker.massless_leg)
    kneestrike, heelstrike = (step.times[[0, -1], 0] * walker.time_unit).tolist()

    return {
        **mapped,
        "eigenvalues": values,
        "eigenvectors": vectors,
        "kneestrike_time": kneestrike if walker.knees else None,
        "heelstrike_time": heelstrike,
        **_losses(problem, step, image[:1], parameters),
    }


def _in_states(
    problem: Problem, y: np.ndarray, step: Stride, parameters: Parameters
) -> dict[str, np.ndarray]:
    """The image of a state, and its derivatives by the state and the slope, in the
    walker's units, from the step's at section coordinates y (3, 1).
    """
    scale = parameters[1]
    time_unit = problem.walker.time_unit
    # In the solver's units these are the walker's times its unit of time.
    units = np.array([1.0, time_unit, time_unit])

    _, by_section_before = _start(problem, y, parameters)
    after, by_section_after = _start(problem, step.image, parameters)
    by_before = np.linalg.inv(by_section_before)
    by_state = by_section_after @ step.jacobian[:, :, 0] @ by_before
    by_slope = by_section_after @ step.by_drive[:, 0]

    return {
        "state": after * scale / units,
        "jacobian": by_state * units / units[:, None],
        "by_slope": by_slope * scale / units,
    }


def _losses(
    problem: Problem,
    step: Stride,
    angle: np.ndarray,
    parameters: Parameters,
) -> dict[str, float | None]:
    """Energies lost in the strikes of a step that ends at a stance angle."""
    walker, scale = problem.walker, parameters[1]
    push = None
    if problem.structure.pushes_off:
        push = push_off(walker, angle, problem.impulses(1))
    energy = walker.total_mass * walker.g * walker.leg
    normal, tangential = heelstrike_losses(walker, angle, step.impact * scale, push)
    knee = None
    if walker.knees:
        knee = float(kneestrike_loss(walker, step.knee * scale)[0] * energy)

    return {
        "loss_normal": float(normal[0] * energy),
        "loss_tangential": float(tangential[0] * energy),
        "loss_kneestrike": knee,
    }


def _to_heelstrike(start: Start, params: Mapping[str, Any]) -> Step:
    """The step from a start, which must end in a heelstrike."""
    lane = start.parameters[:, 0]
    step = take_step(start.problem, start.x, lane, locked=start.locked)
    if step.outcome != STRUCK:
        state = np.array(params["state"], float)
        cause = CAUSES[step.outcome]
        raise WalkerError(
            "state", tuple(state.tolist()), f"leads to no heelstrike ({cause})"
        )

    return step


def _on_section(start: Start, params: Mapping[str, Any]) -> Start:
    """A start just after heelstrike: of a state within a step, the one that ends it."""
    if start.y is not None:
        return start

    step = _to_heelstrike(start, params)
    walker = start.problem.walker
    parameters = start.parameters
    links = len(step.state) // 2
    state = step.state[[0, links, links + 1]] * parameters[1]
    state[1:] /= walker.time_unit
    return begin({**params, "state": state})


def _start(
    problem: Problem,
    y: np.ndarray,
    parameters: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled angle, stance and thigh rate at the start of a step from section
    coordinates (3, 1), and derivatives.
    """
    size = problem.map.start_size
    start, by_y = np.split(problem.map.start(y, parameters)[:, 0], [size])
    rows = [0, size // 2, size // 2 + 1]
    return start[rows], by_y.reshape(size, 3)[rows]


def _modes(jacobian: np.ndarray, singular: bool) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, largest magnitude first, the last exactly zero where the map is
    singular, and eigenvectors.
    """
    values, vectors = (x.astype(complex) for x in np.linalg.eig(jacobian))
    order = np.lexsort((-values.imag, -values.real, -np.abs(values)))
    values = values[order]
    vectors = vectors[:, order]
    if singular:  # a heelstrike of these legs leaves the thigh's rate no freedom
        values[2] = 0.0
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    return values, vectors * np.abs(largest) / largest
