"""Flows, impacts and the stride map against the second derivation (tests/oracle.py)."""

import mpmath
import numpy as np
import pytest

from gaitsweep.tasks.gaits.search import search
from gaitsweep.tasks.mechanics.lumped import constants_of, structure_of
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve, resolve_many
from gaitsweep.tasks.walkers.walker import Walker
from gaitsweep.tasks.walkers.walker_array import WalkerArray
from oracle import Oracle, SimplestWalker

#: Asymmetric on purpose: every constant of the lumped equations is there.
ODD = Walker(
    l_t=0.4,
    w_t=0.03,
    m_t=1.7,
    r_t=0.11,
    c_t=0.12,
    l_s=0.55,
    w_s=-0.02,
    m_s=0.6,
    r_s=0.13,
    c_s=0.2,
    R=0.15,
    eps_T=0.08,
    m_h=2.0,
    g=3.3,
)


def stride(walker, theta, rates, slope, times):
    """Image of one state by the stride map, in the walker's units; times are guesses."""
    problem = Problem(walker)
    time_unit = np.sqrt(walker.leg / walker.g)
    y = np.array([theta, *np.array(rates[: problem.m - 1]) * time_unit])[:, None]
    p = problem.parameters(np.array([slope]), np.array([1.0]))
    times = np.array(times)[:, None] / time_unit
    for _ in range(12):
        s = problem.map(y, times, p)
        times = s.times
    out = s.image[:, 0].copy()
    out[1:] /= time_unit
    return out, times[:, 0] * time_unit


@pytest.mark.parametrize(
    "walker",
    [CATALOGUE["E"], CATALOGUE["B"], CATALOGUE["physical-straight"], ODD],
    ids=["E", "B", "physical-straight", "odd"],
)
def test_a_stride_agrees_with_the_oracle(walker):
    found, gaits, verdict = search(Problem(walker), 0.04)
    at = np.flatnonzero(verdict.anthropomorphic)[-1]
    theta = float(np.exp(found[0, at]))
    start = gaits.start[:, at] / gaits.start[0, at] * theta
    # Beside the gait, so that agreement is not just that of two fixed points.
    theta *= 1.005
    rates = np.array([start[2] * 1.004, start[3], start[3]]) * np.sqrt(
        walker.g / walker.leg
    )
    if walker.point_foot:
        rates[1:] = rates[0] * np.cos(2 * theta)
    step = Oracle(walker.table()).step(theta, rates, 0.04)
    image, times = stride(walker, theta, rates, 0.04, [step.period])
    assert times[-1] == pytest.approx(step.period, rel=1e-11)
    assert image[0] == pytest.approx(step.theta, rel=1e-11)
    np.testing.assert_allclose(image[1:], step.rates[: len(image) - 1], rtol=1e-10)


def test_a_stride_of_d_agrees_with_the_textbook():
    rates = np.array([-0.21, -0.21 * np.cos(0.4), -0.21 * np.cos(0.4)])
    step = SimplestWalker().step(0.2, rates, 0.01)
    image, times = stride(CATALOGUE["D"], 0.2, rates, 0.01, [step.period])
    np.testing.assert_allclose(
        [*image, times[-1]], [step.theta, step.rates[0], step.period], rtol=1e-11
    )


def test_a_kneed_stride_agrees_with_the_oracle():
    walker = CATALOGUE["physical"]
    oracle = Oracle(walker.table())
    # The kneed section lies just before heelstrike; the oracle starts just after it.
    first = oracle.step(0.2433, [-1.048, -0.304, -1.480], 0.036)
    time_unit = oracle.step(first.theta, first.rates, 0.036)
    before, after = first.before_heelstrike, time_unit.before_heelstrike
    image, times = stride(
        walker,
        first.theta,
        before[3:5],
        0.036,
        [time_unit.kneestrike_time, time_unit.period],
    )
    np.testing.assert_allclose(
        times, [time_unit.kneestrike_time, time_unit.period], rtol=1e-10
    )
    np.testing.assert_allclose(image, [time_unit.theta, *after[3:5]], rtol=1e-9)


@pytest.mark.parametrize("name", ["D", "E", "B", "physical-straight", "C"])
def test_the_exact_jacobian_is_the_difference_quotient(name):
    problem = Problem(CATALOGUE[name])
    slope = np.array([0.04])
    found, gaits, verdict = search(problem, slope[0])
    at = np.flatnonzero(verdict.anthropomorphic)[-1]
    scale = np.exp2(np.floor(found[0, at] / np.log(2)))
    # Near the long gait, but no fixed point: every derivative counts.
    y = (
        gaits.y[:, at : at + 1]
        * scale
        * np.array([1.02, 1.01, 0.99])[: problem.m, None]
    )
    times = gaits.times[:, at : at + 1]

    def image(y, slope):
        p = problem.parameters(slope, np.array([1.0]))
        t = times
        for _ in range(12):
            s = problem.map(y, t, p, by_drive=True)
            t = s.times
        return s

    base, h = image(y, slope), 2e-5
    for k in range(problem.m):
        e = np.zeros_like(y)
        e[k] = h
        # Fourth order, so that step and rounding both stay below the tolerance.
        d = (
            8 * (image(y + e, slope).image - image(y - e, slope).image)
            - (image(y + 2 * e, slope).image - image(y - 2 * e, slope).image)
        ) / (12 * h)
        np.testing.assert_allclose(
            d[:, 0],
            base.jacobian[:, k, 0],
            rtol=0,
            atol=1e-9 * np.abs(base.jacobian).max(),
        )
    h = 1e-5
    d = (
        8 * (image(y, slope + h).image - image(y, slope - h).image)
        - (image(y, slope + 2 * h).image - image(y, slope - 2 * h).image)
    ) / (12 * h)
    np.testing.assert_allclose(
        d[:, 0], base.by_drive[:, 0], rtol=0, atol=1e-9 * np.abs(base.by_drive).max()
    )


def test_lanes_are_independent_of_their_neighbours():
    problem = Problem(CATALOGUE["E"])
    rng = np.random.default_rng(7)
    n = 37
    w = np.vstack(
        [
            np.log(rng.uniform(0.1, 0.3, n)),
            rng.uniform(-1.2, -0.9, n),
            rng.uniform(2.5, 3.9, n),
        ]
    )
    q = np.log(rng.uniform(0.005, 0.03, n))
    together, _ = problem.stride(w, q, samples=8)
    order = rng.permutation(n)
    shuffled, _ = problem.stride(w[:, order], q[order], samples=8)
    assert np.array_equal(together.image[:, order], shuffled.image)
    assert np.array_equal(together.jacobian[..., order], shuffled.jacobian)
    for lane in (0, 17, n - 1):
        alone, _ = problem.stride(w[:, lane : lane + 1], q[lane : lane + 1], samples=8)
        assert np.array_equal(together.newton[:, lane], alone.newton[:, 0])


def test_a_lost_lane_costs_only_itself():
    problem = Problem(CATALOGUE["B"])
    w = np.tile(np.array([np.log(0.2), -1.05, -0.95, 3.8])[:, None], (1, 6))
    good, _ = problem.stride(w, np.full(6, np.log(0.01)))
    w[1, 2] = 1e200
    mixed, _ = problem.stride(w, np.full(6, np.log(0.01)))
    assert np.isnan(mixed.image[:, 2]).all()
    keep = [0, 1, 3, 4, 5]
    assert np.array_equal(mixed.image[:, keep], good.image[:, keep])


@pytest.mark.parametrize("name", ["A", "C"])
@pytest.mark.parametrize("detuning", [1e-13, 2.36e-5, 0.02, 0.3])
def test_the_offset_of_a_nearly_tuned_leg_has_all_its_digits(name, detuning):
    """It is the leg's first moment about the line from hip to foot centre, in which
    thigh and shank all but cancel.
    """
    walker = resolve(name, {"detuning": detuning})
    with mpmath.workdps(60):
        k = {
            key: mpmath.mpf(value)
            for key, value in walker.table().items()
            if isinstance(value, float)
        }
        d = k["l_s"] - k["R"]
        eps_s = mpmath.asin(k["l_t"] * mpmath.sin(k["eps_T"]) / d)
        leg = k["l_t"] * mpmath.cos(k["eps_T"]) + d * mpmath.cos(eps_s) + k["R"]
        thigh = k["c_t"] * mpmath.sin(k["eps_T"]) + k["w_t"] * mpmath.cos(k["eps_T"])
        shank = (
            k["l_t"] * mpmath.sin(k["eps_T"])
            - k["c_s"] * mpmath.sin(eps_s)
            + k["w_s"] * mpmath.cos(eps_s)
        )
        mass = 2 * (k["m_t"] + k["m_s"]) + k.get("m_h", 0)
        offset = float(-(k["m_t"] * thigh + k["m_s"] * shank) / mass / leg)
    structure = structure_of(walker)
    alone = constants_of(WalkerArray.of([walker]), structure)[:, 0]
    found = alone[structure.constants.index("S_a_re")]
    assert found == pytest.approx(offset, rel=2.3e-16, abs=0) and found != 0
    # The same in an array of walkers, of which some are nearly tuned.
    several = constants_of(
        resolve_many(name, {"detuning": np.array([0.5, detuning])}), structure
    )
    np.testing.assert_array_equal(several[:, 1], alone)
