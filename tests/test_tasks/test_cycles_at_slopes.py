"""Gaits that repeat after n steps: against simulation, the product of single steps,
orbits, and other units.
"""

import mpmath as mp
import numpy as np
import pytest

import gaitsweep
import oracle
from exact_special_points import steps_of
from extended import Walker, _derivative
from gaitsweep.tasks.branches.atlas import from_arrays, to_arrays
from gaitsweep.tasks.branches.flips import begun_at_flips, doubled
from gaitsweep.tasks.branches.settling import _is_near
from gaitsweep.tasks.branches.special_points import flips
from gaitsweep.tasks.branches.tracking import (
    HALVED,
    MAX_MULTIPLIER,
    correct,
    follow,
)
from gaitsweep.tasks.gaits.polish import settle, unmeasured
from gaitsweep.tasks.step.several_steps import (
    begun_at,
    distances_of_steps,
    from_largest,
    joined,
    sections,
)
from gaitsweep.tasks.studies import follow_cycles
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from gaitsweep.tasks.studies.locate_cascade import Orbits
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from lines import branches as atlas_of
from test_tasks.test_gaits_beside_folds import points

STATE = ("stance_angle", "stance_rate", "thigh_rate")
#: Walkers, slopes and periods that have a gait, and its least magnitude of the largest
#: multiplier.
CASES = [
    ("D", 0.016, 2),
    ("D", 0.018, 4),
    ("D", 0.015, 3),
    ("C", 0.08, 2),
    ("C", 0.09, 4),
]


def first(walker, slope, n, **options):
    gaits = gaitsweep.gaits(walker, slope, steps=n, **options)
    assert gaits.status[0] == 0
    return gaits.isel(gait=0)


def state_of(gait):
    return np.array([gait[name].item() for name in STATE])


@pytest.mark.parametrize(("walker", "slope", "n"), CASES)
def test_simulation_comes_back_after_n_steps_and_not_before(walker, slope, n):
    gait = first(walker, slope, n)
    state = state_of(gait)
    steps = gaitsweep.simulate(walker, slope, state, n)
    after = np.array([steps[name].values for name in STATE])
    assert after[:, n] == pytest.approx(state, rel=1e-10)
    assert (
        np.abs(after[0, 1:n] - state[0]).min() > 1e-4 and after[0, :n].max() == state[0]
    )
    assert gait.period.item() == pytest.approx(steps.period.sum().item(), rel=1e-12)
    assert gait.error_bound < 1e-11 and gait.residual < 1e-13
    for name in ("shank_rate", "kneestrike_time"):
        assert gait[name].item() == pytest.approx(
            steps[name].values[0], rel=1e-10, nan_ok=True
        )


@pytest.mark.parametrize(("walker", "slope", "n"), CASES)
def test_the_multipliers_are_those_of_the_product_of_its_steps(walker, slope, n):
    gait = first(walker, slope, n)
    state, product, losses = state_of(gait), np.eye(3), np.zeros(3)
    for _ in range(n):
        step = gaitsweep.step_map(walker, slope, state)
        state, product, losses = (
            step.state,
            step.jacobian @ product,
            losses + np.nan_to_num(step.losses),
        )
    values = np.linalg.eigvals(product)
    values = values[np.argsort(-np.abs(values))]
    multipliers = gait.multiplier_real.values + 1j * gait.multiplier_imag.values
    assert np.sort_complex(multipliers[:3]) == pytest.approx(
        np.sort_complex(values), abs=1e-9
    )
    assert gait.spectral_radius.item() == pytest.approx(abs(values[0]), rel=1e-9)
    for name, loss in zip(
        ("loss_normal", "loss_tangential", "loss_kneestrike"), losses, strict=True
    ):
        assert np.nan_to_num(gait[name].item()) == pytest.approx(loss, rel=1e-10)
    assert abs(gait.energy_imbalance) < 1e-13


@pytest.mark.parametrize(
    ("walker", "slope", "n"),
    [*CASES, ("C", 0.05, None), ("B", 0.01, None), ("physical", 0.04, None)],
)
def test_speed_power_and_cost_are_those_of_distance_and_losses(walker, slope, n):
    """The contact rolls along the slope, and what is lost per step is drawn from
    gravity.
    """
    gait, w = (
        first(walker, slope, n)
        if n
        else gaitsweep.gaits(walker, slope).sel(gait="long"),
        CATALOGUE[walker],
    )
    angles = (
        gaitsweep.simulate(walker, slope, state_of(gait), n).stance_angle.values[:n]
        if n
        else [gait.stance_angle]
    )
    length = sum(
        2 * (w.leg - w.R) * np.sin(angle) + 2 * w.R * angle
        for angle in np.array(angles)
    )
    lost = np.nansum(
        [gait[f"loss_{name}"] for name in ("normal", "tangential", "kneestrike")]
    )
    weight = (2 * (w.m_t + w.m_s) + w.m_h) * w.g
    assert gait.speed.item() == pytest.approx(length / gait.period.item(), rel=1e-11)
    assert gait.froude_speed.item() == pytest.approx(
        gait.speed.item() / np.sqrt(w.g * w.leg), rel=1e-14
    )
    assert gait.power.item() == pytest.approx(lost / gait.period.item(), rel=1e-11)
    assert gait.cost_of_transport.item() == pytest.approx(
        lost / (weight * length), rel=1e-11
    )


@pytest.mark.parametrize(("walker", "slope", "n"), [("C", 0.08, 2), ("B", 0.01, 2)])
def test_the_velocity_ratio_is_that_of_the_heelstrike_after_the_first_step(
    walker, slope, n
):
    """Each loss is half of an eigenvalue of the contact mass times the velocity along
    its eigenvector, squared.
    """
    gait = solve_one({"walker": walker, "slope": slope, "steps": n})["gaits"][0]
    losses = gaitsweep.step_map(walker, slope, [gait[name] for name in STATE]).losses
    values, vectors = np.linalg.eigh(np.array(gait["contact_mass_matrix"]))
    normal = int(np.argmax(np.abs(vectors[1])))
    along = np.sqrt(
        2
        * np.array(
            [losses.normal if k == normal else losses.tangential for k in (0, 1)]
        )
        / values
    )
    ratios = [
        abs(x / y) for x, y in (vectors @ (along * [1, sign]) for sign in (1, -1))
    ]
    assert min(abs(ratio / abs(gait["velocity_ratio"]) - 1) for ratio in ratios) < 1e-9


def test_orbits_of_the_simplest_walker_settle_on_its_stable_gaits():
    for slope, n in ((0.016, 2), (0.018, 4)):
        gait, single = first("D", slope, n), first("D", slope, 1)
        assert gait.spectral_radius < 1 < single.spectral_radius
        walk = gaitsweep.simulate("D", slope, state_of(single) * 1.001, 600)
        assert walk.stance_angle[-8:].max().item() == pytest.approx(
            gait.stance_angle.item(), rel=1e-9
        )


def test_doubled_gaits_begin_at_the_flip():
    """The paper, section 3: period doubling of the simplest walker begins at 0.015."""
    slope = np.array([0.01508, 0.0150885, 0.01509, 0.0151, 0.0152, 0.0176, 0.0177])
    one, two = (gaitsweep.gaits("D", slope, steps=n).sel(gait="long") for n in (1, 2))
    np.testing.assert_array_equal(two.status == 0, one.spectral_radius > 1)
    # Near the flip its multiplier is 1 - 4 (what the single gait's is beyond -1).
    beyond = one.spectral_radius.values[2:4] - 1
    assert 1 - two.spectral_radius.values[2:4] == pytest.approx(4 * beyond, rel=0.02)
    np.testing.assert_array_equal(
        two.spectral_radius[1:] < 1, [True, True, True, True, True, False]
    )
    assert (two.error_bound[2:] < 2e-9).all()
    sentence = two.reason_text[two.reason[0]].item()
    assert sentence.startswith(
        "No gait of period 2 at this slope: the branches found span 0.0150884 to 0.034"
    )


def test_doubled_gaits_are_followed_from_a_flip_beside_which_newton_steps_are_rounding():
    """At small slopes: the last point that is found on the way to the flip begins the
    branch.
    """
    slope, keys = np.array([4.16e-4, 4.17e-4, 0.001, 0.01]), {"m_t": 0.3976305559090616}
    one, two = (
        gaitsweep.gaits("B", slope, steps=n, **keys).sel(gait="long") for n in (1, 2)
    )
    np.testing.assert_array_equal(two.status == 0, one.spectral_radius > 1)
    assert (two.spectral_radius[1:] < 1).all() and np.abs(
        two.energy_imbalance[1:]
    ).max() < 1e-12


def test_every_gait_is_listed_once_under_its_label():
    three = gaitsweep.gaits("D", 0.015, steps=3)
    assert (three.status == 0).values.tolist() == [True, False, True, False]
    assert (
        three.stance_angle[0] > three.stance_angle[2]
        and len({*three.piece.values[[0, 2]].tolist()}) == 2
    )
    assert three.branch.values.tolist() == [0, -1, 0, -1]


def test_the_two_gaits_beside_a_fold_are_on_two_pieces():
    problem, known = atlas_of("D")
    (branch,) = cycle_branches(problem, known, 3)
    (fold,) = branch.turns()
    assert np.exp(branch.q[fold]) == pytest.approx(0.0122808, abs=1e-7)
    # So near that both lie between the fold and the next node.
    at = branch.guesses(branch.q[[fold]] + 1e-12)
    assert [int(branch.piece(segment)[0]) for *_, segment in at] == [0, 1]
    assert not branch.guesses(branch.q[[fold]] - 1e-9)


def twice(problem, w):
    """Gaits as gaits of twice as many steps."""
    return joined(
        w[0],
        *(np.tile(part, (2, 1, 1)) for part in sections(w, problem.m, problem.steps)),
    )


def test_a_gait_that_repeats_sooner_is_none_of_n_steps():
    problem, known = atlas_of("D")
    slope = np.array([0.0142])
    ((_, Z, _),) = known[0].guesses(np.log(slope))
    several, w = problem.of_steps(2), twice(problem, Z[:-1])
    gait = settle(several, unmeasured(several, w, slope))
    assert gait.converged.all() and not _is_near(several, gait, w).any()
    assert not distances_of_steps(w, several.m, 2).any()


def test_a_gait_whose_halves_came_together_is_not_the_one_guessed():
    """Beside a flip Newton's method may fall onto the gait of half the period, of which
    rounding leaves two copies.
    """
    problem, known = atlas_of("D")
    (branch,) = cycle_branches(problem, known, 2)
    several, slope = problem.of_steps(2), np.exp(branch.q[[0]]) * (1 + 1e-9)
    ((_, Z, segment),) = branch.guesses(np.log(slope))
    guess = branch.known_guesses(Z, segment, slope)
    gait = settle(several, guess)
    assert gait.converged.all() and _is_near(several, gait, guess.w).all()
    # The same guess, farther from repeating sooner than what was found.
    y, durations = sections(guess.w, several.m, 2)
    middle = y.mean(axis=0)
    apart = joined(guess.w[0], middle + 3 * (y - middle), durations)
    assert (
        np.abs(apart - guess.w).max() < 2e-4
        and not _is_near(several, gait, apart).any()
    )
    # Gaits of an odd number of steps repeat sooner only where all agree.
    assert distances_of_steps(
        np.array([[0.0, 0.5, 1.0, 0.5, 1.1, 0.5, 1, 2, 3]]).T, 6, 3
    ) == pytest.approx(0.1)


def test_the_same_gait_begins_at_any_of_its_steps():
    problem, known = atlas_of("D")
    several, slope = problem.of_steps(4), first("D", 0.018, 4)
    walk = gaitsweep.simulate("D", 0.018, state_of(slope), 4)
    w = np.array(
        [
            np.log(walk.stance_angle.values[:4]),
            walk.stance_rate.values[:4] / walk.stance_angle.values[:4],
        ]
    )
    branch = cycle_branches(problem, known, 4)[-1]
    ((_, Z, _),) = branch.guesses(np.log([0.018]))
    own = from_largest(Z[:-1], several.m, 4)
    for k in range(4):
        begun = begun_at(own, several.m, 4, k)
        assert begun[:2, 0] == pytest.approx(w[:, k], rel=1e-5)
        assert begun[-1] == pytest.approx(walk.period.sum().item(), rel=1e-6)
    np.testing.assert_allclose(begun_at(begun, several.m, 4, 1), own, rtol=1e-14)


def test_a_branch_between_two_flips_is_followed_from_one_of_them():
    """The physical walker's gaits of two steps leave those of one at 0.019131 and come
    back to them at 0.020230.
    """
    problem, known = atlas_of("physical")
    followed, several = cycle_branches(problem, known, 2), problem.of_steps(2)
    spans = [sorted(np.exp(branch.q[[0, -1]])) for branch in followed]
    assert len(spans) == 2 and spans[0] == pytest.approx(
        [0.0191312, 0.0202299], abs=2e-7
    )
    branch = followed[0]
    assert branch.why == ("branch_point", "branch_point") and branch.folds()[
        [0, -1]
    ].tolist() == [0, len(branch.q) - 1]
    apart = distances_of_steps(branch.Z[:-1], several.m, 2)[0]
    assert apart[[0, -1]] == pytest.approx(0, abs=1e-15) and apart[1:-1].min() > 1e-6
    # The slope falls to the flip at which the branch ends, too.
    assert branch.q[1] > branch.q[0] and branch.q[-1] < branch.q[-2]
    for end in (0, -1):
        slope, angle = np.exp(branch.q[end]), np.exp(branch.Z[0, end])
        near = gaitsweep.gaits("physical", slope * (1 + 1e-7), steps=2)
        merged = np.abs(near.stance_angle / angle - 1) < 3e-3
        assert near.status.values[merged].tolist() == [0]


def test_a_branch_whose_halves_come_together_ends_at_the_nearest_flip():
    problem, known = atlas_of("D")
    (branch,), several = cycle_branches(problem, known, 2), problem.of_steps(2)
    (flip,) = [flip for each in known for flip in flips(problem, each)]
    for side, order in enumerate(
        (slice(1, None), slice(None, 0, -1))
    ):  # the flip as its first end, and as its last
        Z, why = branch.Z[:, order], (HALVED, "") if side == 0 else ("", HALVED)
        cut = type(branch)(
            several.m, Z, branch.tangent[:, order], np.zeros(len(Z.T)), why, steps=2
        )
        other = correct(
            problem,
            flip.Z + 0.04 * np.append(np.arange(len(flip.w)) < problem.m, 1)[:, None],
            None,
        ).at
        ended = begun_at_flips(cut, [other, flip])
        assert ended.why[side] == "branch_point" and 0 < ended.end_errors[side] < 1e-12
        end, beside = ((0, 1), (-1, -2))[side]
        assert ended.q[end] == flip.q[0] and ended.tangent[-1, end] == 0
        # The neighbour lies along the tangent that leaves the flip, against the one
        # that arrives there.
        chord = ended.Z[:, beside] - ended.Z[:, end]
        along = chord @ ended.tangent[:, end]
        assert np.sign(along) == 1 - 2 * side
        assert abs(along) == pytest.approx(np.linalg.norm(chord), rel=1e-3)
        assert begun_at_flips(cut, [other]).why[side] == "no further point"


def test_an_accuracy_spares_digits():
    problem, known = atlas_of("D")
    branches, several = cycle_branches(problem, known, 2), problem.of_steps(2)
    found, coarse = (
        points(several, branches, np.array([0.016]), **more)
        for more in ({}, {"accuracy": 1e-4})
    )
    assert found["status"].tolist() == coarse["status"].tolist() == [[0, 1, 1, 1]]
    # Without an accuracy all digits are kept.
    assert (
        found["error_bound"][0, 0] < 1e-11 < 1e-6 < coarse["error_bound"][0, 0] <= 1e-4
    )
    assert found["stance_angle"][0, 0] != coarse["stance_angle"][0, 0]
    assert found["stance_angle"][0, 0] == pytest.approx(
        coarse["stance_angle"][0, 0], rel=1e-4
    )


def test_gaits_that_no_flip_begins_are_searched_for():
    """The long gait of E has doubled at any slope: its two steps, by the step map, were
    not found.
    """
    found = gaitsweep.gaits("E", [1e-6, 0.004, 0.006], steps=2).sel(gait="long")
    np.testing.assert_allclose(
        found.stance_angle[1:], [0.13273476092302, 0.15360049], rtol=1e-8
    )
    for gait in (found.isel(slope=i) for i in range(3)):
        state = [
            float(gait[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
        ]
        steps = [gaitsweep.step_map("E", gait.slope.item(), state)]
        steps.append(gaitsweep.step_map("E", gait.slope.item(), steps[0].state))
        np.testing.assert_allclose(steps[1].state, state, rtol=1e-12)
        radius = np.abs(np.linalg.eigvals(steps[1].jacobian @ steps[0].jacobian)).max()
        assert gait.spectral_radius.item() == pytest.approx(radius, rel=1e-9)
    # They double again, which leads to gaits of four steps.
    assert (gaitsweep.gaits("E", 0.006, steps=4).status == 0).any()


@pytest.mark.parametrize("slope", [1e-18, 1e-13])
def test_at_the_least_slopes_more_digits_resolve_gaits_of_several_steps(slope):
    """Doubles did not."""
    gait = gaitsweep.gaits("E", slope, steps=2).sel(gait="long")
    assert gait.status == 0 and gait.error_bound < 1e-9
    problem, known = atlas_of("E")
    guesses = [
        Z
        for branch in cycle_branches(problem, known, 2)
        for _, Z, _ in branch.guesses(np.log([slope]))
    ]
    Z = min(guesses, key=lambda Z: abs(np.exp(Z[0, 0]) - gait.stance_angle.item()))[
        :, 0
    ]
    Y, times = steps_of(problem.of_steps(2), Z)
    states = problem.start(Y, np.full(2, slope))[:3]
    angle, period = extended_cycle(
        CATALOGUE["E"].table(), slope, np.vstack([states, times]).T
    )
    assert abs(float(gait.stance_angle.item() / angle - 1)) < gait.error_bound
    assert abs(float(gait.period.item() / period - 1)) < gait.error_bound


def test_a_search_finds_every_gait_at_a_slope():
    """Those to which exact integration of all guesses leads."""
    problem, known = atlas_of("D")

    found = Orbits(problem, known, np.array([0.0189]), 4, 300).cycles(4)

    radii = [abs(gait.at.multipliers[0, 0]) for gait in found]
    assert radii == pytest.approx([4.592890282, 91.69654024, 174.6124980], rel=1e-8)
    for gait in found:
        w = gait.Z[:-1]
        y, _ = sections(w, gait.at.m, 4)
        state = problem.start(np.exp(w[0, 0]) * y[0], np.array([0.0189]))[:3, 0]
        steps = gaitsweep.simulate("D", 0.0189, state, 4)
        assert steps.stance_angle.values[4] == pytest.approx(state[0], rel=1e-6)


def test_gaits_that_are_found_are_followed_beside_those_that_flips_begin(monkeypatch):
    problem, known = atlas_of("D")
    followed = []

    def counted(problem, Z, step):
        followed.append((problem.steps, Z.shape[1]))
        return follow(problem, Z, step)

    monkeypatch.setattr(follow_cycles, "follow", counted)

    branches = cycle_branches(problem, known, 4)

    # Other gaits that the search finds lie on the two branches.
    assert len(branches) == 2 and followed == [(2, 1), (4, 2)]


def test_steps_along_a_branch_grow_where_multipliers_are_far_from_those_of_flips():
    problem, known = atlas_of("D")
    (flip,) = [flip for branch in known for flip in flips(problem, branch)]
    gait, _, step = doubled(flip, 5e-4)

    ((_, up),) = follow(gait.at.problem, gait.Z, np.array([step]))

    nodes = correct(gait.at.problem, up.Z, None).at
    largest = np.real(nodes.multipliers[:, 0])
    assert largest[0] > 0.8 and largest[-1] < -MAX_MULTIPLIER
    changes = np.abs(np.diff(largest))
    is_far = largest[1:] < -5
    assert changes[~is_far].max() < 1.5
    # Steps that change the sum by no more than 0.6 would be 25 at least.
    assert is_far.sum() < 15


def test_no_gait_is_found_where_nothing_begins_one():
    none = gaitsweep.gaits("E", 0.001, steps=3)
    assert (none.status == 1).all() and none.stance_angle.isnull().all()
    assert (
        "No gait of period 3 found: no flip of fewer steps begins one."
        in none.reason_text.values
    )


@pytest.mark.parametrize(
    ("slope", "n"), [(0.0151, 2), (0.016, 2), (0.018, 4), (0.015, 3)]
)
def test_the_error_bound_holds_in_other_units(slope, n):
    """The same gait with another leg and gravity, in which every operation rounds
    differently.
    """
    plain = first("D", slope, n)
    other = first("D", slope, n, l_t=0.65, l_s=0.65, c_s=0.65, g=3.7)
    bound = plain.error_bound.item() + other.error_bound.item()
    assert abs(other.stance_angle / plain.stance_angle - 1) < bound < 1e-9
    assert abs(other.period / plain.period / np.sqrt(1.3 / 3.7) - 1) < bound
    assert abs(other.stance_rate / plain.stance_rate * np.sqrt(1.3 / 3.7) - 1) < bound


@pytest.mark.parametrize(
    ("walker", "keys"),
    [
        ("A", {"detuning": 1.2920094126389283}),
        ("physical-straight", {"m_s": 0.9313486113114027}),
    ],
)
def test_a_strike_that_turns_tangential_is_no_flip(walker, keys):
    """There the derivative has a pole, and det(I + A) another sign."""
    problem, known = atlas_of(walker, **keys)
    assert not [flip for branch in known for flip in flips(problem, branch)]
    assert any(branch.why[0] == "end_tangential_heelstrike" for branch in known)


def test_violations_are_the_worst_of_the_steps():
    gait = first("D", 0.018, 4, variables=["violations"])
    state = state_of(first("D", 0.018, 4))
    angles = gaitsweep.simulate("D", 0.018, state, 4).stance_angle.values
    # A massless leg can only push along itself: each step demands the most friction at
    # its steeper end.
    assert gait.friction_demand.item() == pytest.approx(np.tan(angles).max(), rel=1e-9)
    assert gait.friction_demand_heelstrike.item() == pytest.approx(
        np.tan(angles[1:]).max(), rel=1e-9
    )
    assert gait.foot_clearance.item() == -gait.scuff_depth.item() < 0
    assert gait.violations.item() == 0 and 0 < gait.least_normal_force.item() < 1


def test_the_time_of_the_worst_torque_counts_from_the_start_of_the_gait():
    gait, model = (
        first("C", 0.09, 4, variables=["violations"]),
        oracle.Oracle(CATALOGUE["C"].table()),
    )
    steps = gaitsweep.simulate("C", 0.09, state_of(first("C", 0.09, 4)), 4)
    rates = np.array(
        [steps[f"{link}_rate"].values for link in ("stance", "thigh", "shank")]
    )
    starts = np.concatenate(
        [steps.stance_angle.values * np.array([[1], [-1], [-1]]), rates]
    )[:, :4]
    # On these slopes the stance knee is held least at the start of a step.
    torque = [-model.motion(state, 0.09, False)[1][10] for state in starts.T]
    assert np.argmax(torque) == 2
    assert gait.unlocking_torque.item() == pytest.approx(max(torque), rel=1e-9)
    assert gait.unlocking_torque_time.item() == pytest.approx(
        steps.period.values[:2].sum(), rel=1e-9
    )


def test_branches_survive_as_arrays():
    problem, known = atlas_of("D")
    followed = cycle_branches(problem, known, 3)
    for a, b in zip(followed, from_arrays(to_arrays(followed)), strict=True):
        assert (a.steps, a.why, a.end_errors) == (
            b.steps,
            b.why,
            b.end_errors,
        ) and a.steps == 3
        for name in ("Z", "tangent", "ratio", "leg_passes", "safe", "coefficients"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def extended_cycle(walker, slope, guess):
    """Largest stance angle and period of a point-foot walker's gait of several steps,
    by Newton in 113 bits.

    `guess` has a row (angle, stance rate, thigh rate, time) for each step.
    """
    walker, z = (
        Walker(walker, mp.mpf(slope)),
        [mp.mpf(float(x)) for x in np.ravel(guess)],
    )
    n = len(z) // 4
    for _ in range(60):
        residual, matrix = [], mp.zeros(4 * n)
        for i in range(n):
            step = z[4 * i : 4 * i + 4]
            guards, end, _ = walker.stride(step)
            after = (i + 1) % n * 4
            residual += guards + [
                e - a for e, a in zip(end, z[after : after + 3], strict=True)
            ]
            matrix[4 * i : 4 * i + 4, 4 * i : 4 * i + 4] = _derivative(
                walker, step, mp.mpf("1e-10"), 2
            )
            for k in range(3):
                matrix[4 * i + 1 + k, after + k] -= 1
        dz = -mp.lu_solve(matrix, mp.matrix(residual))
        z = [a + d for a, d in zip(z, dz, strict=True)]
        if max(abs(d) for d in dz) < mp.mpf("1e-22"):
            return max(z[::4]), sum(z[3::4])
    raise ArithmeticError("no convergence")


@pytest.mark.parametrize(
    ("beyond", "worst"), [(1e-4, 1e-9), (3e-7, 3e-7), (1e-8, 1e-5), (1e-11, 3e-4)]
)
def test_the_error_bound_holds_beside_a_flip(beyond, worst):
    """Down to where the gait merges with that of one step, against 113 bits."""
    problem, known = atlas_of("D")
    (branch,) = cycle_branches(problem, known, 2)
    slope = float(np.exp(branch.q[0])) * (1 + beyond)
    gait = first("D", slope, 2)
    walk = gaitsweep.simulate("D", slope, state_of(gait), 2)
    angle, period = extended_cycle(
        "D", slope, np.array([walk[name].values[:2] for name in (*STATE, "period")]).T
    )
    error = (
        abs(float(gait.stance_angle.item() / angle - 1)),
        abs(float(gait.period.item() / period - 1)),
    )
    assert max(error) < gait.error_bound < worst
