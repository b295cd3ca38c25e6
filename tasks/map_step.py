"""The step map at one state: its image, Jacobian, modes, event times and losses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tasks.measures.losses import heelstrike_losses, kneestrike_loss
from tasks.mechanics.lumped import structure_of
from tasks.step.problem import Lanes, Problem
from tasks.step.simulate import CAUSES, MAX_ANGLE, STRUCK, stride
from tasks.walkers.resolve import resolve
from tasks.walkers.walker import Walker, WalkerError

#: Evaluations of the exact map after the scan, whose event times are good to 1e-8: the second leaves rounding only.
_EVALUATIONS = 2


def map_step(params: Mapping[str, Any]) -> dict[str, Any]:
    """Map one state just after heelstrike to the next.

    Parameters
    ----------
    params : mapping
        `walker` (name or table), `set` (keys to change), `slope` [rad], and `state`, three numbers: stance angle [rad],
        stance rate and thigh rate just after heelstrike, in the walker's units.

    Returns
    -------
    dict
        In the walker's units: `state` (3,) after the step; its derivatives `jacobian` (3, 3) by the state and
        `by_slope` (3,); `eigenvalues` (3,) of the Jacobian, largest magnitude first, and `eigenvectors` (3, 3), its
        columns, of length one; `kneestrike_time` and `heelstrike_time`; `loss_normal`, `loss_tangential` and
        `loss_kneestrike`. What only knees have is None without them.

    Raises
    ------
    WalkerError
        If the walker or the state cannot be, or the step does not end in a heelstrike.

    Notes
    -----
    The swing shank of a kneed walker starts with the rate that a heelstrike gives it, which the state determines. Point
    feet are mapped in all three coordinates, although after a heelstrike the thigh's rate follows from the others.
    """
    walker = resolve(params["walker"], params.get("set"))
    state, slope = np.array(params["state"], float), np.array([float(params["slope"])])
    check_state(state)
    problem = section_problem(walker)
    time_unit = np.sqrt(walker.leg / walker.g)
    units = np.array([1.0, time_unit, time_unit])  # by which the walker's are multiplied
    scale = np.exp2(np.floor(np.log2(state[:1])))
    parameters = problem.parameters(slope, scale)
    y = to_section(problem, state * units / scale, parameters)
    scanned = stride(problem, y * scale, slope, exact=False)
    if scanned.outcome[0] != STRUCK:
        cause = CAUSES[scanned.outcome[0]]
        raise WalkerError("state", tuple(state.tolist()), f"leads to no heelstrike ({cause})")
    times = scanned.times
    for _ in range(_EVALUATIONS):
        step = problem.map(y, times, parameters, slope=True)
        times = step.times
    before, after = (_from_section(problem, section, parameters) for section in (y, step.image))
    image = after[0] * scale / units
    jacobian = after[1] @ step.jacobian[:, :, 0] @ np.linalg.inv(before[1]) * units / units[:, None]
    values, vectors = _modes(jacobian, walker.point_foot or walker.massless_leg)
    energy = walker.total_mass * walker.g * walker.leg
    normal, tangential = heelstrike_losses(walker, image[:1], step.impact * scale)
    return {
        "state": image,
        "jacobian": jacobian,
        "by_slope": after[1] @ step.by_slope[:, 0] * scale / units,
        "eigenvalues": values,
        "eigenvectors": vectors,
        "kneestrike_time": float(times[0, 0] * time_unit) if walker.knees else None,
        "heelstrike_time": float(times[-1, 0] * time_unit),
        "loss_normal": float(normal[0] * energy),
        "loss_tangential": float(tangential[0] * energy),
        "loss_kneestrike": float(kneestrike_loss(walker, step.knee * scale)[0] * energy) if walker.knees else None,
    }


def section_problem(walker: Walker) -> Lanes:
    """Step map of a walker with three coordinates on its section, those of point feet as of other straight legs."""
    return Lanes([walker], replace(structure_of(walker), point_foot=False))


def check_state(state: np.ndarray) -> None:
    """Check that a state lies on the section.

    Parameters
    ----------
    state : ndarray, shape (3,)
        Stance angle [rad], stance rate and thigh rate.

    Raises
    ------
    WalkerError
        If the stance leg is not in front of the ground's normal, or so far that the walker has fallen.
    """
    if not 0 < state[0] < MAX_ANGLE:
        raise WalkerError("state", f"{float(state[0])!r} rad", f"must have a stance angle in (0, {MAX_ANGLE}) rad")


def to_section(problem: Problem, state: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Section coordinates of a state just after heelstrike.

    Parameters
    ----------
    problem : Problem
        As `section_problem` returns it.
    state : ndarray, shape (3,)
        Scaled stance angle, stance rate and thigh rate [sqrt(g/leg)].
    parameters : ndarray, shape (n_parameters, 1)

    Returns
    -------
    ndarray, shape (3, 1)
        For kneed walkers with the rates just before the heelstrike, of which those after it are linear functions.
    """
    if not problem.structure.kneed:
        return state[:, None]
    at_rest = np.array([[state[0]], [0.0], [0.0]])
    rates = np.linalg.solve(_from_section(problem, at_rest, parameters)[1][1:, 1:], state[1:])
    return np.array([state[:1], *rates[:, None]])


def _from_section(problem: Problem, y: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """State (3,) just after heelstrike at section coordinates y (3, 1), and its derivative (3, 3) by them."""
    size = problem.map.start_size
    start, by_y = np.split(problem.map.start(y, parameters)[:, 0], [size])
    rows = [0, size // 2, size // 2 + 1]
    return start[rows], by_y.reshape(size, 3)[rows]


def _modes(jacobian: np.ndarray, singular: bool) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, largest magnitude first, the last exactly zero where the map is singular, and eigenvectors."""
    values, vectors = (x.astype(complex) for x in np.linalg.eig(jacobian))
    order = np.lexsort((-values.imag, -values.real, -np.abs(values)))
    values, vectors = values[order], vectors[:, order]
    if singular:  # a heelstrike of these legs leaves the thigh's rate no freedom
        values[2] = 0.0
    largest = np.take_along_axis(vectors, np.abs(vectors).argmax(axis=0)[None], axis=0)
    return values, vectors * np.abs(largest) / largest
