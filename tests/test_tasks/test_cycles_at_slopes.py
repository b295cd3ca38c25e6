"""Gaits that repeat after n steps: against simulation, the product of single steps, orbits, and other units."""

import numpy as np
import pytest

import pipeline
from lines import branches as atlas_of
from tasks.follow_cycles import cycle_branches, from_arrays, to_arrays
from tasks.solve_cycles import _worst

STATE = ("stance_angle", "stance_rate", "thigh_rate")
#: Walkers, slopes and periods that have a gait, and its least magnitude of the largest multiplier.
CASES = [("D", 0.016, 2), ("D", 0.018, 4), ("D", 0.015, 3), ("C", 0.08, 2), ("C", 0.09, 4)]


def first(walker, slope, n, **options):
    gaits = pipeline.gaits(walker, slope, steps=n, **options)
    assert gaits.status[0] == 0
    return gaits.isel(gait=0)


def state_of(gait):
    return np.array([gait[name].item() for name in STATE])


@pytest.mark.parametrize(("walker", "slope", "n"), CASES)
def test_simulation_comes_back_after_n_steps_and_not_before(walker, slope, n):
    gait = first(walker, slope, n)
    state = state_of(gait)
    steps = pipeline.simulate(walker, slope, state, n)
    after = np.array([steps[name].values for name in STATE])
    assert after[:, n] == pytest.approx(state, rel=1e-10)
    assert np.abs(after[0, 1:n] - state[0]).min() > 1e-4 and after[0, :n].max() == state[0]
    assert gait.period.item() == pytest.approx(steps.period.sum().item(), rel=1e-12)
    assert gait.error_bound < 1e-11 and gait.residual < 1e-13
    for name in ("shank_rate", "kneestrike_time"):
        assert gait[name].item() == pytest.approx(steps[name].values[0], rel=1e-10, nan_ok=True)


@pytest.mark.parametrize(("walker", "slope", "n"), CASES)
def test_the_multipliers_are_those_of_the_product_of_its_steps(walker, slope, n):
    gait = first(walker, slope, n)
    state, product, losses = state_of(gait), np.eye(3), np.zeros(3)
    for _ in range(n):
        step = pipeline.step_map(walker, slope, state)
        state, product, losses = step.state, step.jacobian @ product, losses + np.nan_to_num(step.losses)
    values = np.linalg.eigvals(product)
    values = values[np.argsort(-np.abs(values))]
    multipliers = gait.multiplier_real.values + 1j * gait.multiplier_imag.values
    assert np.sort_complex(multipliers[:3]) == pytest.approx(np.sort_complex(values), abs=1e-9)
    assert gait.spectral_radius.item() == pytest.approx(abs(values[0]), rel=1e-9)
    for name, loss in zip(("loss_normal", "loss_tangential", "loss_kneestrike"), losses, strict=True):
        assert np.nan_to_num(gait[name].item()) == pytest.approx(loss, rel=1e-10)
    assert abs(gait.energy_imbalance) < 1e-13


def test_orbits_of_the_simplest_walker_settle_on_its_stable_gaits():
    for slope, n in ((0.016, 2), (0.018, 4)):
        gait, single = first("D", slope, n), first("D", slope, 1)
        assert gait.spectral_radius < 1 < single.spectral_radius
        walk = pipeline.simulate("D", slope, state_of(single) * 1.001, 600)
        assert walk.stance_angle[-8:].max().item() == pytest.approx(gait.stance_angle.item(), rel=1e-9)


def test_doubled_gaits_begin_at_the_flip():
    """The paper, section 3: period doubling of the simplest walker begins at 0.015."""
    slope = np.array([0.01508, 0.01509, 0.0151, 0.0152, 0.0176, 0.0177])
    one, two = (pipeline.gaits("D", slope, steps=n).sel(gait="long") for n in (1, 2))
    np.testing.assert_array_equal(two.status == 0, one.spectral_radius > 1)
    # Near the flip its multiplier is 1 - 4 (what the single gait's is beyond -1).
    beyond = one.spectral_radius.values[1:3] - 1
    assert 1 - two.spectral_radius.values[1:3] == pytest.approx(4 * beyond, rel=0.02)
    np.testing.assert_array_equal(two.spectral_radius[1:] < 1, [True, True, True, True, False])
    assert (two.error_bound[1:] < 2e-9).all()
    sentence = two.reason_text[two.reason[0]].item()
    assert sentence.startswith("No gait of period 2 at this slope: the branches found span 0.0150884 to 0.034")


def test_every_gait_is_listed_once_under_its_label():
    three = pipeline.gaits("D", 0.015, steps=3)
    assert (three.status == 0).values.tolist() == [True, False, True, False]
    assert three.stance_angle[0] > three.stance_angle[2] and len({*three.piece.values[[0, 2]].tolist()}) == 2
    assert three.branch.values.tolist() == [0, -1, 0, -1]
    # Both sides of one fold, at which they are one gait.
    fold = 0.0122808
    beside = pipeline.gaits("D", [fold + 1e-6, fold - 1e-6], steps=3)
    assert (beside.status == 0).values[:, [0, 2]].tolist() == [[True, True], [False, False]]
    assert abs(beside.stance_angle[0, 0] - beside.stance_angle[0, 2]) < 1e-3


def test_a_walker_without_flips_has_no_doubled_gaits():
    none = pipeline.gaits("E", 0.001, steps=2)
    assert (none.status == 1).all() and none.stance_angle.isnull().all()
    assert "No gait of period 2 found: no flip of fewer steps begins one." in none.reason_text.values


@pytest.mark.parametrize(("slope", "n"), [(0.0151, 2), (0.016, 2), (0.018, 4), (0.015, 3)])
def test_the_error_bound_holds_in_other_units(slope, n):
    """The same gait with another leg and gravity, in which every operation rounds differently."""
    plain = first("D", slope, n)
    other = first("D", slope, n, l_t=0.65, l_s=0.65, c_s=0.65, g=3.7)
    bound = plain.error_bound.item() + other.error_bound.item()
    assert abs(other.stance_angle / plain.stance_angle - 1) < bound < 1e-9
    assert abs(other.period / plain.period / np.sqrt(1.3 / 3.7) - 1) < bound
    assert abs(other.stance_rate / plain.stance_rate * np.sqrt(1.3 / 3.7) - 1) < bound


def test_violations_are_the_worst_of_the_steps():
    gait = first("D", 0.016, 2, variables=["violations"])
    state = state_of(first("D", 0.016, 2))
    # Massless legs push along themselves: the largest demand is that of the widest angle.
    assert gait.friction_demand.item() == pytest.approx(np.tan(state[0]), rel=1e-9)
    assert gait.violations.item() & 1
    amounts = {
        "violations": np.array([1, 4], np.int32),
        "scuff_depth": np.array([0.1, 0.3]),
        "least_normal_force": np.array([0.9, 0.8]),
        "unlocking_torque": np.array([-2.0, -1.0]),
        "unlocking_torque_time": np.array([0.7, 0.2]),
    }
    assert _worst(amounts) == {
        "violations": 5,
        "scuff_depth": 0.3,
        "least_normal_force": 0.8,
        "unlocking_torque": -1.0,
        "unlocking_torque_time": 0.2,
    }


def test_branches_survive_as_arrays():
    problem, known = atlas_of("D")
    followed = cycle_branches(problem, known, 3)
    again = from_arrays(to_arrays(followed))
    for a, b in zip(followed, again, strict=True):
        for (p, Y, times), (r, U, others) in zip(a.guesses(np.log(0.016)), b.guesses(np.log(0.016)), strict=True):
            assert p == r
            np.testing.assert_array_equal(Y, U)
            np.testing.assert_array_equal(times, others)
