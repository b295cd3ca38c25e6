"""The task `design`: the best performance of each walker, so that a grid of walkers shows the effect of its keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.continuation import atlas as atlases
from tasks.continuation.branch import Branch
from tasks.continuation.locate import locate_root, row
from tasks.continuation.lockstep import run
from tasks.continuation.special_points import END_NAMES
from tasks.continuation.tracking import MIN_SLOPE, Point
from tasks.fixed_points.multipliers import multipliers
from tasks.measures.kinematics import travel
from tasks.step.problem import Problem
from tasks.walkers.resolve import resolve

Arrays = dict[str, np.ndarray]
#: Intervals between two nodes of a branch at whose ends its speed is evaluated.
_INTERVALS = 16
#: Entries in place of a reason where there is no number.
_NO_GAIT, _NEVER_STABLE = "no gait", "never stable"
#: Columns of the fastest stable gait: its slope, and its state just after heelstrike.
_START = ("fastest_slope", "stance_angle", "stance_rate", "thigh_rate", "shank_rate")


def design(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Find where a line walks, where it walks stably, and its largest stable speed.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray [rad], whose ends are the window.
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Table `design`, one row in the walker's units: smallest_slope (0 if branches continue to vanishing
        slopes) and smallest_at, the event there; largest_stable_slope and stability_lost_by; fastest_stable_speed, its
        fastest_froude_speed and fastest_slope. Only gaits in the window count, and its edge is called `window`.
        Numbers are NaN where there is `no gait`, or where it is `never stable`.

    Notes
    -----
    Stability changes where the spectral radius is one, located on the branch for any bifurcation; its name follows from
    the multiplier that leaves the unit circle. Speeds are evaluated on the branch's polynomial between its nodes.
    """
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    slope = np.asarray(params["slope"], float)
    window = (np.log(slope.min()), np.log(slope.max()))
    least: list[tuple[float, str]] = []
    most: list[tuple[float, str]] = []
    speeds: list[tuple[float, ...]] = []
    m, time_unit = problem.m, np.sqrt(walker.leg / walker.g)
    for branch in atlases.from_arrays(inputs[0]):
        least += _lowest(branch, window)
        Z, ends = _stable_part(problem, branch)
        q = Z[:, m]
        inside = (q >= window[0]) & (q <= window[1])
        if not inside.any():
            continue
        most += [(s, why) for s, why in ends if window[0] <= s <= window[1]]
        most += [(window[1], "window")] if (q > window[1]).any() else []
        slopes, angle = np.exp(q[inside]), np.exp(Z[inside, 0])
        period = Z[inside, -1] * time_unit
        speed = travel(walker, slopes, angle, period)["speed"]
        fastest = np.array([speed.argmax()])
        y = np.vstack([angle, angle * Z[inside, 1:m].T])[:, fastest]
        state = problem.start(y, slopes[fastest])[:, 0] / [1.0, time_unit, time_unit, time_unit]
        speeds.append((float(speed.max()), float(slopes[fastest[0]]), *map(float, state)))
    (first, event), (last, loss) = min(least, default=(np.nan, _NO_GAIT)), max(most, default=(np.nan, _NEVER_STABLE))
    best, *start = max(speeds, default=(np.nan,) * 6)
    values = {
        "smallest_slope": 0.0 if first < np.log(10 * MIN_SLOPE) else float(np.exp(first)),
        "smallest_at": event,
        "largest_stable_slope": float(np.exp(last)),
        "stability_lost_by": loss if least else _NO_GAIT,
        "fastest_stable_speed": best,
        "fastest_froude_speed": best / np.sqrt(walker.g * walker.leg),
        **dict(zip(_START, start, strict=True)),
    }
    return {f"design/{k}": np.array([v]) for k, v in values.items()}


def _lowest(branch: Branch, window: tuple[float, float]) -> list[tuple[float, str]]:
    """Smallest ln slope of a branch's gaits in the window, and the event there; empty where it has none."""
    gaits = branch.q[branch.leg_passes == 1]
    if not len(gaits) or gaits.min() > window[1] or gaits.max() < window[0]:
        return []
    k = int(np.argmin(branch.q))
    if branch.q[k] <= np.log(10 * MIN_SLOPE):
        return [(float(branch.q[k]), "any slope")]
    if gaits.min() < window[0]:
        return [(window[0], "window")]
    return [(float(gaits.min()), _end(branch, k) or "fold")]


def _end(branch: Branch, node: int) -> str:
    """Name of a branch's end at a node; empty where it continues."""
    why = {0: branch.why[0], len(branch.q) - 1: branch.why[1]}.get(node, "")
    return END_NAMES.get(why, why)


def _stable_part(problem: Problem, branch: Branch) -> tuple[np.ndarray, list[tuple[float, str]]]:
    """Gaits along the stable parts of a branch.

    Returns
    -------
    Z : ndarray, shape (n, m + 1 + phases)
        Rows of the branch, closely spaced.
    ends : list
        (ln slope, name) of every point at which stability, or the stable branch itself, ends.
    """
    m = branch.m
    step, _ = problem.stride(np.delete(branch.Z, m, axis=1).T, branch.q)
    stable = (np.abs(multipliers(step.jacobian, m)).max(axis=1) < 1) & (branch.leg_passes == 1)
    rows, ends = [np.zeros((0, branch.Z.shape[1]))], []
    for k in np.nonzero(stable[1:] | stable[:-1])[0]:
        axis = branch.axis[k]
        a, b = branch.Z[k, axis], branch.Z[k + 1, axis]
        if stable[k] != stable[k + 1]:
            point, _ = run(problem, locate_root(branch, int(k), _excess))
            ends.append((float(point.X[m, 0]), _bifurcation(point)))
            a, b = (a, row(point)[axis]) if stable[k] else (row(point)[axis], b)
        rows.append(branch.evaluate(np.full(_INTERVALS + 1, k), np.linspace(a, b, _INTERVALS + 1)))
    ends += [(float(branch.q[k]), _end(branch, k)) for k in (0, len(branch.q) - 1) if stable[k]]
    return np.vstack(rows), ends


def _largest_multiplier(point: Point) -> complex:
    return complex(multipliers(point.stride.jacobian, len(point.stride.y))[0, 0])


def _excess(point: Point, direction: np.ndarray) -> float:
    return abs(_largest_multiplier(point)) - 1


def _bifurcation(point: Point) -> str:
    """Name of the point at which a multiplier leaves the unit circle."""
    value = _largest_multiplier(point)
    return "neimark_sacker" if abs(value.imag) > 1e-6 else "flip" if value.real < 0 else "fold"
