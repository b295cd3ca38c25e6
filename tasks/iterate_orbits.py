"""Orbits: strides from many starts at many slopes, the attractors they end on, and the falls."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.continuation import atlas as atlases
from tasks.dynamics.initial_states import gaits_at, r_sequence
from tasks.dynamics.lyapunov import Exponents, estimate
from tasks.fixed_points.polish import SAFETY_FACTOR
from tasks.step.problem import EPS, Problem
from tasks.step.simulate import CAUSES, STRUCK, stride
from tasks.walkers.resolve import resolve

Arrays = dict[str, np.ndarray]
#: Options of a study of this kind, and what they are where it is silent.
OPTIONS = {"gait": "long", "starts": 8, "spread": 1e-3, "transient": 400, "strides": 240, "shown": 120}
#: Strides over which the directions of growth settle before they are counted, and blocks the rest is cut into.
SETTLE, BLOCKS = 16, 8
NO_START = "no gait to start from"
#: What a row of the table holds, and the longest period at which an orbit is looked for to repeat.
SHOWN, LONGEST = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period", "error_bound"), 64
#: Lanes advanced together: their states stay in the cache.
LANES = 4096


def orbit(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Strides from starts near a gait, at every slope.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray, shape (n,) [rad]; and the study's options: `gait` whose neighbourhood the starts
        fill, `starts` at each slope, `spread` (their relative distance), `transient` (strides dropped), `strides`
        (strides kept, all of which count for the exponents), `shown` (the last of them, tabled).
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `orbits` (slope, start, stride; angle and rates just after the heelstrike it begins with, its period, and
        the error bound of where it leads; repeats_to, how far the orbit has settled), `lyapunov` (slope, index,
        exponent, standard_error, strides, reason), `falls` (slope, start, steps, cause) and `survival` (slope, starts,
        falls, strides, lifetime: strides walked a fall). Exponents are per stride; only orbits that walk to the end are
        in the first two.

    Notes
    -----
    Transients are flown to about 1e-8, kept strides exactly. Exponents are those of the map on its section; the
    stride's superficial zero multipliers (paper, section 2.2) would add minus infinities.
    """
    options = {**OPTIONS, **{k: params[k] for k in OPTIONS if k in params}}
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    slope = np.asarray(params["slope"], float)
    known, gaits = gaits_at(problem, atlases.from_arrays(inputs[0]), slope, str(options["gait"]))
    count = int(options["starts"])
    # The same offsets at every slope, so an orbit does not depend on which slopes stand beside it.
    offsets = np.tile(2 * r_sequence(problem.m, count) - 1, (1, len(known)))
    y = np.repeat(gaits, count, axis=1) * (1 + float(options["spread"]) * offsets)
    lane_slope, start = np.repeat(slope[known], count), np.tile(np.arange(count), len(known))
    time_unit = np.sqrt(walker.leg / walker.g)
    parts = [
        _walked(problem, y[:, k : k + LANES], lane_slope[k : k + LANES], options) for k in range(0, y.shape[1], LANES)
    ]
    rows = np.concatenate([p["rows"] for p in parts], axis=2) if parts else np.zeros((0, len(SHOWN), 0))
    steps = np.concatenate([p["steps"] for p in parts]) if parts else np.zeros(0, int)
    outcome = np.concatenate([p["outcome"] for p in parts]) if parts else np.zeros(0, int)
    means = np.concatenate([p["means"] for p in parts], axis=2) if parts else np.zeros((BLOCKS, problem.m, 0))
    walks = outcome == STRUCK
    kept = rows[:, :, walks] * np.array([1, 1 / time_unit, 1 / time_unit, 1 / time_unit, time_unit, 1])[:, None]
    shown, n = len(kept), int(walks.sum())
    out = {
        "orbits/slope": np.repeat(lane_slope[walks], shown),
        "orbits/start": np.repeat(start[walks], shown),
        "orbits/stride": np.tile(np.arange(int(options["strides"]) - shown, int(options["strides"])), n),
        **{f"orbits/{name}": kept[:, i].T.ravel() for i, name in enumerate(SHOWN)},
        "orbits/repeats_to": np.repeat(_repeats(kept[:, 0]), shown),
    }
    lost = np.setdiff1d(np.arange(len(slope)), known)
    out |= {
        "falls/slope": np.concatenate([lane_slope[~walks], slope[lost]]),
        "falls/start": np.concatenate([start[~walks], np.full(len(lost), -1)]),
        "falls/steps": np.concatenate([steps[~walks], np.zeros(len(lost), int)]),
        "falls/cause": np.array([CAUSES[c] for c in outcome[~walks]] + [NO_START] * len(lost), "U24"),
    }
    out |= _survival(lane_slope, steps, ~walks)
    return out | _exponents(means[:, :, walks], lane_slope[walks], int(options["strides"]) - SETTLE)


def _repeats(angles: np.ndarray) -> np.ndarray:
    """Largest relative change of each orbit's angles (strides, n) after the period that changes them least."""
    periods = range(1, min(LONGEST, len(angles) // 2) + 1)
    if not periods:
        return np.full(angles.shape[1], np.nan)
    return np.min([np.abs(angles[p:] / angles[:-p] - 1).max(axis=0) for p in periods], axis=0)


def _survival(lane_slope: np.ndarray, steps: np.ndarray, fell: np.ndarray) -> Arrays:
    """How long walking lasts at every slope: all strides walked over all falls."""
    slopes, which = np.unique(lane_slope, return_inverse=True)
    strides, falls = np.bincount(which, steps, len(slopes)), np.bincount(which, fell, len(slopes))
    with np.errstate(divide="ignore"):
        lifetime = strides / falls
    return {
        "survival/slope": slopes,
        "survival/starts": np.bincount(which, minlength=len(slopes)),
        "survival/falls": falls.astype(int),
        "survival/strides": strides.astype(int),
        "survival/lifetime": lifetime,
    }


def _exponents(means: np.ndarray, lane_slope: np.ndarray, strides: int) -> Arrays:
    """The table of exponents, each slope's orbits taken together; NaN, with a reason, where strides are too few."""
    short = strides < BLOCKS
    reason = (
        f"Exponents need at least {SETTLE + BLOCKS} strides; these orbits have {SETTLE + strides}." if short else ""
    )
    if short:
        means, strides = np.full_like(means, np.nan), 0
    rows: dict[str, list[float]] = {k: [] for k in ("slope", "index", "exponent", "standard_error", "strides")}
    for s in np.unique(lane_slope):
        mine = lane_slope == s
        value, error = estimate(means[:, :, mine])
        for i in range(len(value)):
            row = (s, i, value[i], error[i], strides * int(mine.sum()))
            for column, x in zip(rows.values(), row, strict=True):
                column.append(x)
    table = {f"lyapunov/{k}": np.array(v, float if k not in ("index", "strides") else int) for k, v in rows.items()}
    return table | {"lyapunov/reason": np.full(len(rows["slope"]), reason)}


def _walked(problem: Problem, y: np.ndarray, slope: np.ndarray, options: Mapping[str, Any]) -> Arrays:
    """Transient and kept strides of some lanes; those that fall leave the batch."""
    n, strides, shown = y.shape[1], int(options["strides"]), min(int(options["shown"]), int(options["strides"]))
    steps, outcome = np.zeros(n, int), np.full(n, STRUCK)
    rows = np.full((shown, len(SHOWN), n), np.nan)
    means = np.full((BLOCKS, problem.m, n), np.nan)
    lanes = np.arange(n)
    for _ in range(int(options["transient"])):
        now = stride(problem, y, slope[lanes], exact=False)
        walks = now.outcome == STRUCK
        outcome[lanes], steps[lanes[walks]] = now.outcome, steps[lanes[walks]] + 1
        y, lanes = now.image[:, walks], lanes[walks]
        if not len(lanes):
            break
    growth = Exponents.begin(problem.m, len(lanes), BLOCKS)
    for k in range(strides if len(lanes) else 0):
        now = stride(problem, y, slope[lanes])
        walks = now.outcome == STRUCK
        outcome[lanes], steps[lanes[walks]] = now.outcome, steps[lanes[walks]] + 1
        if not walks.all():
            growth = Exponents(growth.Q[:, :, walks], growth.blocks[:, :, walks], growth.counts)
        before, y, lanes = y[:, walks], now.image[:, walks], lanes[walks]
        if not len(lanes):
            break
        assert now.jacobian is not None
        growth.step(now.jacobian[:, :, walks], (k - SETTLE) * BLOCKS // (strides - SETTLE) if k >= SETTLE else None)
        if k >= strides - shown:
            rows[k - strides + shown][:, lanes] = _step(problem, before, y, now.times[:, walks], slope[lanes])
    means[:, :, lanes] = growth.means()
    return {"rows": rows, "steps": steps, "outcome": outcome, "means": means}


def _step(problem: Problem, y: np.ndarray, image: np.ndarray, times: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """What the table holds of the steps from section states y (m, n) to `image`, shape (len(SHOWN), n).

    Notes
    -----
    The step is flown again in another unit, in which every operation rounds anew; the bound is as many times the change
    as that of a gait is standard deviations.
    """
    scale = np.exp2(np.floor(np.log2(y[0])))
    size = problem.map.start_size
    begin = problem.map.start(y / scale, problem.parameters(slope, scale))[:size] * scale
    unit = 0.75 * scale
    again = problem.map(y / unit, times, problem.parameters(slope, unit))
    off = np.abs(again.image * unit - image)
    largest = np.abs(image[1:]).max(axis=0)
    error = np.max([off[0] / image[0], *(off[1:] / largest), np.abs(again.times[-1] / times[-1] - 1)], axis=0)
    return np.vstack([begin[[0, size // 2, size // 2 + 1, size - 1]], times[-1], SAFETY_FACTOR * (error + EPS)])
