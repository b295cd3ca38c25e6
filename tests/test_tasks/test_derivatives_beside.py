"""Where derivatives by keys do not exist, and that those told are of gaits beside."""

from functools import partial

import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.measures.levels import measures_at
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError


@pytest.mark.parametrize(
    ("walker", "changes", "special", "regular"),
    [
        ("D", {"R": 0.1}, ["r_t", "c_t", "w_t"], ["m_s", "w_s", "m_h"]),
        ("D", {"hip_stiffness": 0.1, "push_off": 0.02}, ["m_s"], ["push_off"]),
        ("D", {"R": 0.1, "hip_torque": 0.05}, ["m_s", "r_t"], ["hip_torque"]),
        ("D", {"m_t": 0.0, "m_h": 1.0, "c_t": 0.2, "R": 0.1}, ["m_t"], ["m_s"]),
    ],
)
def test_limits_that_no_gaits_beside_tend_to_are_told(
    walker, changes, special, regular
):
    """Keys that would give massless legs their inertia, or a torque to accelerate."""
    found = gaitsweep.sensitivities(walker, 0.01, keys=special + regular, **changes)

    for key in special:
        at = found.sel(key=key)
        assert "special: walkers beside it" in str(at.key_reason.values), key
        assert all(np.isnan(at[name]).all() for name in at)
    for key in regular:
        at = found.sel(key=key, gait="long")
        assert at.key_reason == ""
        assert np.isfinite(at.period)


#: Keys that are changed of each walker of the catalogue.
CHANGES = [
    {},
    {"R": 0.1},
    {"hip_stiffness": 0.05},
    {"push_off": 0.02},
    {"hip_torque": 0.01, "hip_damping": 0.01},
    {"m_h": 0.5},
]
#: Walkers, slopes and keys beside whose values of any of them walkers are many.
QUICK = [
    ("D", 0.01, {"R": 0.1}),
    ("B", 0.01, {"hip_stiffness": 0.05, "push_off": 0.02}),
]
SLOW = [
    ("physical", 0.03, {}),
    ("physical-straight", 0.03, {}),
    ("D", 0.01, {"R": 0.1, "hip_stiffness": 0.1}),
    ("D", 0.01, {"m_t": 0.0, "m_h": 1.0, "c_t": 0.2}),
    ("D", 0.01, {"m_s": 1e-4, "r_t": 0.01}),
    ("D", 0.01, {"m_s": 1e-3, "R": 0.1, "c_t": 1e-3}),
    ("A", 0.02, {"R": 0.0}),
]
for walker in (*"ABCDEF", "C-printed"):
    for changes in CHANGES:
        SLOW.append((walker, 0.01, changes))
SETTINGS = QUICK.copy()
for setting in SLOW:
    SETTINGS.append(pytest.param(*setting, marks=pytest.mark.thorough))


@pytest.mark.parametrize(("walker", "slope", "changes"), SETTINGS)
def test_whatever_is_told_is_what_gaits_beside_have_and_all_else_has_a_reason(
    walker, slope, changes
):
    """Gaits are solved from the own one, with steps of all keys that fall to 1e-8; of
    one-sided differences two steps are extrapolated.
    """
    own = resolve(walker, changes)
    names = ["stance_angle", "period", "loss_normal"]
    found = gaitsweep.sensitivities(walker, slope, variables=names, **changes)
    gaits = gaitsweep.gaits(walker, slope, variables=[*START, *names], **changes)
    measured = 0

    for label in ("long", "short"):
        gait = gaits.sel(gait=label)
        if np.isnan(gait.period):
            continue
        here = np.array([float(gait[name]) for name in names])
        for key in found.key.values[1:]:
            at = found.sel(gait=label, key=key)
            reason = str(at.key_reason.values)
            told = np.array([float(at[name]) for name in names])
            if reason:
                assert np.isnan(told).all(), key
                continue

            quotients = _quotients(own, slope, gait, key, here, names)
            assert _is_among(told, quotients, here), key
            measured += 1
    assert measured > 5


START = ("stance_angle", "stance_rate", "thigh_rate", "shank_rate", "kneestrike_time")


def _is_among(told, quotients, here):
    """Whether each derivative is one of several quotients, over the measures too."""
    size = np.abs(told) + np.abs(here)
    apart = np.abs(quotients - told) / size
    off = np.nanmin(apart, axis=0)
    return np.isfinite(told).all() and off.max() < 1e-3


def _quotients(walker, slope, gait, key, here, names):
    """Difference quotients (k, names) by a key: central ones, and those of each side."""
    steps = np.array([1e-4, 1e-6, 1e-8])
    value = getattr(walker, key)
    own = partial(_beside, walker, slope, gait, key, names)
    more = np.array([own(value + step) for step in steps])
    less = np.array([own(value - step) for step in steps])

    steps = steps[:, None]
    up, down = (more - here) / steps, (here - less) / steps
    central = (more - less) / (2 * steps)

    extrapolated = [(100 * q[1:] - q[:-1]) / 99 for q in (up, down)]
    return np.vstack([central, *extrapolated])


def _beside(walker, slope, gait, key, names, value):
    """Measures of the gait near one, of a walker with another value of a key."""
    missing = np.full(len(names), np.nan)
    try:
        problem = Problem(walker.having(key, value))
    except WalkerError:
        return missing
    w = _guess(problem, gait, slope)
    settled = settle(problem, unmeasured(problem, w, np.array([slope])))
    if not (settled.converged & settled.step)[0]:
        return missing
    Z = np.vstack([settled.w, np.log([slope])])
    there = Equations(problem).evaluate(Z)
    of_gait = measures_at(names, there)
    return np.array([of_gait[name][0] for name in names])


def _guess(problem, gait, slope):
    """Unknowns w of a gait, of another walker."""
    unit = problem.walker.time_unit
    state = np.array([[float(gait[name])] for name in START[:3]])
    state[1:] *= unit

    times = [float(gait.period) / unit]
    if problem.walker.knees:
        times.insert(0, float(gait.kneestrike_time) / unit)

    y = problem.section_of(state, np.array([slope]))
    return np.vstack([np.log(y[:1]), y[1:] / y[0], np.reshape(times, (-1, 1))])


def test_a_derivative_beside_a_kink_is_that_of_its_own_side():
    """The swing foot of the short gait is lowest at another instant of the step where
    the leg's offset is a little less.
    """
    names = ["foot_clearance"]
    found = gaitsweep.sensitivities("B", 0.01, keys=["w_t"], variables=names)
    told = float(found.foot_clearance.sel(gait="short", key="w_t"))

    own = resolve("B").w_t
    clearance = []
    for beside in (own - 1e-6, own + 1e-6):
        gaits = gaitsweep.gaits("B", 0.01, w_t=beside, variables=names)
        short = gaits.sel(gait="short")
        clearance.append(float(short.foot_clearance))

    less, more = clearance
    assert told == pytest.approx((more - less) / 2e-6, rel=1e-6)
