"""Cascades: gaits of period 1, 2, 4, ... and of other periods, from their folds through their doublings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tasks.continuation import atlas as atlases
from tasks.continuation.cycles import (
    MAX_POINTS,
    Cycle,
    Path,
    Test,
    at_slope,
    doubled,
    flip_test,
    fold_test,
    from_start,
    really_walks,
)
from tasks.dynamics.crisis import lost
from tasks.dynamics.initial_states import gaits_at, r_sequence
from tasks.fits import feigenbaum as scaling
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK, stride
from tasks.walkers.resolve import resolve

Arrays = dict[str, np.ndarray]
#: Options of a study of this kind: the longest period, first periods of the families, starts of their search, and the
#: strides every start must last where the attractor beyond the doublings is sought for its end.
OPTIONS = {"periods": 64, "families": [1], "starts": 400, "strides": 200}
#: Starts that look for that end, their relative distance from the last doubled gait (chaos parts them), and how far
#: beyond the doublings they look, over the doublings' own length.
WALKERS, SPREAD, BEYOND = 32, 1e-9, 3.0
#: How much of the window the first step along a branch takes, and the longest interval to the next flip, in ln slope,
#: that is expected: the first intervals of a cascade need not follow its law.
FIRST_STEP, LONGEST = 0.01, 0.05


@dataclass
class Event:
    """A fold or flip of a family, and the relative error of its slope."""

    kind: str
    cycle: Cycle
    error: float


def cascade(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Flips and folds of a line's families of period-n gaits within a window of slopes.

    Parameters
    ----------
    params : mapping
        `line`; `slope`, ndarray [rad], whose ends are the window and whose values are searched for families of other
        periods than one; and the study's options: `periods`, the longest; `families`, first periods; `starts` of the
        search at each slope; `strides` that walking must last (0: its end is not sought).
    inputs : list
        The line's atlas.

    Returns
    -------
    dict
        Tables `cascade` (family, period, kind, slope, error_bound, ratio, stance_angle, walks), a row for each fold and
        flip, `accumulation` (family, flips, slope, low, high, ratio), and `lost` (family, low, high, starts, strides):
        the slopes between which the chaos beyond a family's doublings ends, in falls or in a gait of period one.
    """
    options = {**OPTIONS, **{k: params[k] for k in OPTIONS if k in params}}
    walker = resolve(params["line"]["walker"], params["line"].get("set"))
    problem = Problem(walker)
    slope = np.sort(np.asarray(params["slope"], float))
    rows: list[dict[str, Any]] = []
    limits: list[dict[str, Any]] = []
    ends: list[dict[str, Any]] = []
    for number in options["families"]:
        families: list[list[Event]] = []
        for start in _first(problem, inputs[0], slope, int(number), int(options["starts"])):
            found = _family(problem, start, slope, int(options["periods"]))
            if not any(_same_birth(found, other) for other in families):
                families.append(found)
        for family, found in enumerate(families):
            name = f"{number}" if len(families) == 1 else f"{number}-{family + 1}"
            flips = np.array([e.cycle.slope for e in found if e.kind == "flip"])
            ratio = iter(scaling.ratios(flips))
            for event in found:
                c = event.cycle
                rows.append(
                    {
                        "family": name,
                        "period": c.period,
                        "kind": event.kind,
                        "slope": c.slope,
                        "error_bound": event.error,
                        "ratio": next(ratio) if event.kind == "flip" else np.nan,
                        "stance_angle": float(c.Y[0].max()),
                        "walks": int(really_walks(problem, c)),
                    }
                )
            value, low, high = scaling.accumulation(flips)
            last = scaling.ratios(flips)
            limits.append(
                {
                    "family": name,
                    "flips": len(flips),
                    "slope": value,
                    "low": low,
                    "high": high,
                    "ratio": float(last[-1]) if len(last) else np.nan,
                }
            )
            if int(options["strides"]) and np.isfinite(value):
                high = min(slope[-1], value + BEYOND * (value - flips[0]))
                before, after = lost(problem, _around(found[-1].cycle), value, high, int(options["strides"]))
                ends.append(
                    {
                        "family": name,
                        "low": before,
                        "high": after,
                        "starts": WALKERS,
                        "strides": int(options["strides"]),
                    }
                )
    out = {
        f"cascade/{k}": np.array([r[k] for r in rows])
        for k in ("family", "period", "kind", "slope", "error_bound", "ratio", "stance_angle", "walks")
    }
    out |= {
        f"accumulation/{k}": np.array([r[k] for r in limits])
        for k in ("family", "flips", "slope", "low", "high", "ratio")
    }
    return out | {f"lost/{k}": np.array([r[k] for r in ends]) for k in ("family", "low", "high", "starts", "strides")}


def _around(cycle: Cycle) -> np.ndarray:
    """Starts beside the steps of a gait, in turn, shape (m, WALKERS)."""
    steps = (
        np.arange(WALKERS) * cycle.period // WALKERS if cycle.period > WALKERS else np.arange(WALKERS) % cycle.period
    )
    return cycle.Y[:, steps] * (1 + SPREAD * (2 * r_sequence(len(cycle.Y), WALKERS) - 1))


def _same_birth(a: list[Event], b: list[Event]) -> bool:
    """True where two gaits are the two sides of one fold."""
    return bool(
        a
        and b
        and a[0].kind == b[0].kind == "fold"
        and abs(a[0].cycle.q - b[0].cycle.q) < 1e-9
        and _apart(a[0].cycle, b[0].cycle) < 1e-4
    )


def _first(problem: Problem, atlas: Arrays, slope: np.ndarray, n: int, starts: int) -> list[Cycle]:
    """A first gait of each family of that period."""
    if n == 1:
        known, y = gaits_at(problem, atlases.from_arrays(atlas), slope[:1], "long")
        found = from_start(problem, y[:, 0], slope[0], 1) if len(known) else None
        return [found] if found else []
    for s in slope:
        distinct = cycles_at(problem, atlas, float(s), n, starts)
        if distinct:
            return distinct
    return []


def cycles_at(problem: Problem, atlas: Arrays, slope: float, n: int, starts: int) -> list[Cycle]:
    """Distinct gaits of exact period n at one slope, stable ones first.

    Notes
    -----
    Starts lie on a low-discrepancy lattice around the long gait, wide enough to hold every attractor of the paper's
    walkers; those that come back near themselves after n strides are polished by Newton on all n sections.
    """
    known, y = gaits_at(problem, atlases.from_arrays(atlas), np.array([slope]), "long")
    if not len(known):
        return []
    Y = [y[:, :1] * (1 + 0.2 * (2 * r_sequence(problem.m, starts) - 1))]
    times: list[np.ndarray] = []
    for _ in range(n + 1):
        now = stride(problem, Y[-1], np.full(Y[-1].shape[1], slope), exact=False)
        on = now.outcome == STRUCK
        Y, times = [a[:, on] for a in Y] + [now.image[:, on]], [t[:, on] for t in times] + [now.times[:, on]]
    if not Y[-1].shape[1]:
        return []
    # The first stride throws every start onto the map's strongly contracted image.
    back = np.abs(Y[n + 1] - Y[1]).max(axis=0)
    found: list[Cycle] = []
    for lane in np.argsort(back, kind="stable")[:60]:
        cycle = at_slope(
            problem,
            np.array([Y[i][:, lane] for i in range(1, n + 1)]).T,
            np.array([times[i][:, lane] for i in range(1, n + 1)]).T,
            slope,
        )
        if not cycle.ok or not _exact_period(cycle) or not really_walks(problem, cycle):
            continue
        if all(_apart(cycle, other) > 1e-7 for other in found):
            found.append(cycle)
    return sorted(found, key=lambda c: float(np.abs(c.multipliers()[0])))


def _exact_period(cycle: Cycle) -> bool:
    n = cycle.period
    return all(np.abs(cycle.Y - np.roll(cycle.Y, k, axis=1)).max() > 1e-6 for k in range(1, n) if n % k == 0)


def _apart(a: Cycle, b: Cycle) -> float:
    return min(float(np.abs(a.Y - np.roll(b.Y, k, axis=1)).max()) for k in range(b.period))


def _family(problem: Problem, start: Cycle, slope: np.ndarray, longest: int) -> list[Event]:
    """A family's folds, then its flips, each branch switched to at the flip before."""
    low, high = np.log(slope[0]), np.log(slope[-1])
    up = np.zeros(start.Y.size + 1)
    up[-1] = 1.0
    found: list[Event] = []
    if start.period > 1:
        # Down the slope to the fold the family is born at; of its two sides the one nearer stability cascades.
        down = Path(problem, start, -up, FIRST_STEP * (high - low))
        found += _events(down, fold_test, "fold", low, high)
        if found:
            start = min(down.points[-2:], key=lambda c: float(np.abs(c.multipliers()[0])))
    path: Path | None = Path(problem, start, up, FIRST_STEP * (high - low))
    expected = high - low
    while path is not None and path.points[-1].period <= longest:
        flips = _events(path, flip_test, "flip", low, high)
        if not flips:
            break
        before = [e.cycle.q for e in found]
        found += flips
        flip = flips[0].cycle
        # The next interval, as Feigenbaum expects it of the one before.
        expected = min(LONGEST, (flip.q - before[-1]) / scaling.DELTA if before else 0.02 * expected)
        path = doubled(problem, flip, expected) if 2 * flip.period <= longest else None
    return found


def _events(path: Path, test: Test, kind: str, low: float, high: float) -> list[Event]:
    """The first zero of a test function along a branch inside the window, as a list of none or one."""
    for _ in range(MAX_POINTS):
        if not path.advance():
            return []
        before, after = path.points[-2:]
        if test(before) * test(after) < 0:
            cycle = path.locate_root(test)
            return [Event(kind, cycle, _slope_error(path, test, cycle))]
        if not low - 0.05 <= after.q <= high + 0.05:
            return []
    return []


def _slope_error(path: Path, test: Test, cycle: Cycle) -> float:
    """Relative error of an event's slope: the corrector's last step, and rounding of the Jacobians in the test."""
    eps = np.finfo(float).eps
    before, after = path.points[-2:]
    if test is fold_test:
        return cycle.error + 8 * eps
    rounding_std = 16 * eps * cycle.period * (1 + np.abs(cycle.A).max()) ** 2
    return float(cycle.error + 8 * eps + rounding_std * abs((after.q - before.q) / (test(after) - test(before))))
