"""Gaits that repeat after n steps: against simulation, the product of single steps, orbits, and other units."""

import numpy as np
import pytest

import pipeline
from lines import branches as atlas_of
from tasks.continuation.cycles import at_slope
from tasks.follow_cycles import CycleBranch, cycle_branches, from_arrays, to_arrays
from tasks.solve_cycles import _is_exact, _worst, cycle_points
from tasks.status import NOT_CONVERGED

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
    slope = np.array([0.01508, 0.0150885, 0.01509, 0.0151, 0.0152, 0.0176, 0.0177])
    one, two = (pipeline.gaits("D", slope, steps=n).sel(gait="long") for n in (1, 2))
    np.testing.assert_array_equal(two.status == 0, one.spectral_radius > 1)
    # Near the flip its multiplier is 1 - 4 (what the single gait's is beyond -1).
    beyond = one.spectral_radius.values[2:4] - 1
    assert 1 - two.spectral_radius.values[2:4] == pytest.approx(4 * beyond, rel=0.02)
    np.testing.assert_array_equal(two.spectral_radius[1:] < 1, [True, True, True, True, True, False])
    assert (two.error_bound[2:] < 2e-9).all()
    sentence = two.reason_text[two.reason[0]].item()
    assert sentence.startswith("No gait of period 2 at this slope: the branches found span 0.0150884 to 0.034")


def test_every_gait_is_listed_once_under_its_label():
    three = pipeline.gaits("D", 0.015, steps=3)
    assert (three.status == 0).values.tolist() == [True, False, True, False]
    assert three.stance_angle[0] > three.stance_angle[2] and len({*three.piece.values[[0, 2]].tolist()}) == 2
    assert three.branch.values.tolist() == [0, -1, 0, -1]


def test_the_two_gaits_beside_a_fold_are_on_two_pieces():
    problem, known = atlas_of("D")
    (branch,) = cycle_branches(problem, known, 3)
    low, high = np.log(0.0122), np.log(0.0123)
    while high - low > 1e-12:
        middle = (low + high) / 2
        low, high = (low, middle) if list(branch.guesses(middle)) else (middle, high)
    # So near that both lie between the same two computed gaits.
    assert [piece for piece, *_ in branch.guesses(high + 1e-9)] == [0, 1]
    assert np.exp(high) == pytest.approx(0.0122808, abs=1e-7)


def test_a_gait_that_repeats_sooner_is_none_of_n_steps():
    problem, known = atlas_of("D")
    flip = cycle_branches(problem, known, 2)[0].cycles[0]
    single = [at_slope(problem, flip.Y, flip.times, slope) for slope in (0.0140, 0.0145)]
    assert all(cycle.ok for cycle in single)
    line = {"walker": "D", "set": {}}
    branches = to_arrays([CycleBranch(single, [])])
    asked = {"line": line, "branches": branches, "steps": 2, "slope": np.array([0.0142]), "want": ("period",)}
    answer = cycle_points(asked)
    assert answer["status"][0, 0] == NOT_CONVERGED and np.isnan(answer["period"][0, 0])


def test_a_branch_between_two_flips_is_followed_from_one_of_them():
    """The physical walker's gaits of two steps leave those of one at 0.019131 and come back to them at 0.020230."""
    problem, known = atlas_of("physical")
    followed = cycle_branches(problem, known, 2)
    spans = [sorted(branch.cycles[i].slope for i in (0, -1)) for branch in followed]
    assert len(spans) == 2 and spans[0] == pytest.approx([0.0191312, 0.0202299], abs=2e-7)
    first, *inner, last = followed[0].cycles
    apart = [np.abs(c.Y - np.roll(c.Y, 1, axis=1)).max() for c in (first, *inner, last)]
    assert apart[0] == 0 and apart[-1] < 1e-5 < 1e-4 < min(apart[1:-5])
    # A gait of two steps is none of one step.
    assert not _is_exact(first) and all(_is_exact(c) for c in inner)


def test_a_gait_on_two_branches_is_listed_once():
    problem, known = atlas_of("D")
    branches = to_arrays(cycle_branches(problem, known, 2) * 2)
    line = {"walker": "D", "set": {}}
    asked = {"line": line, "branches": branches, "steps": 2, "slope": np.array([0.016]), "want": ("period",)}
    assert cycle_points(asked)["status"].tolist() == [[0, 1, 1, 1]]


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
