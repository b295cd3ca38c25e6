"""Lines solved once for all tests."""

import functools

import numpy as np

from gaitsweep.tasks.contract.registry import COSTLY, GAITS, STATUSES, VARIABLES
from gaitsweep.tasks.studies.solve_points import atlas, points
from gaitsweep.tasks.walkers.resolve import resolve
from oracle import Oracle

WANT = tuple(v for v in VARIABLES if VARIABLES[v].group not in COSTLY)
FAILURES = [
    code for name, code in STATUSES.items() if name not in ("converged", "no_gait")
]


@functools.lru_cache(maxsize=32)
def _atlas(walker, overrides):
    return atlas({"line": {"walker": walker, "set": dict(overrides)}}, [])


def solved(walker, slopes, want=WANT, **overrides):
    """Points of a line at some slopes."""
    line = {"walker": walker, "set": overrides}
    found = _atlas(walker, tuple(sorted(overrides.items())))
    return points(
        {"line": line, "slope": np.atleast_1d(np.asarray(slopes, float)), "want": want},
        [found],
    )


def gait(walker, slope, label, **overrides):
    """One gait as a dict of numbers."""
    out = solved(walker, slope, **overrides)
    g = GAITS.index(label)
    return {k: v[0, g] for k, v in out.items() if k != "reasons"}


def branches(walker, **overrides):
    """The atlas's branches, and the walker's problem."""
    from gaitsweep.tasks.branches.atlas import from_arrays
    from gaitsweep.tasks.step.problem import Problem

    found = _atlas(walker, tuple(sorted(overrides.items())))
    return Problem(resolve(walker, overrides)), from_arrays(found)


def some(found):
    """What was found, as a list that is not empty: a loop over nothing asserts nothing."""
    found = list(found)
    assert found
    return found


def of_label(out, label):
    g = GAITS.index(label)
    return {k: v[0, g] for k, v in out.items() if k != "reasons"}


def repeats(walker, overrides, slope, found):
    """How far a step of the second derivation, with scipy's events, lands from a gait,
    relative.
    """
    rates = np.array([found["stance_rate"], found["thigh_rate"], found["shank_rate"]])
    model = Oracle(resolve(walker, overrides).table())
    rates = rates if model.knees else rates[:2]
    step = model.step(found["stance_angle"], rates, slope, rtol=1e-11, atol=1e-12)
    moved = np.abs(step.rates[: len(rates)] - rates).max() / np.abs(rates).max()
    return max(
        abs(step.theta / found["stance_angle"] - 1),
        moved,
        abs(step.period / found["period"] - 1),
    )
