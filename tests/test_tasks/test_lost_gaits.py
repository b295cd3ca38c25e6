"""Points beside folds, at vanishing rates and in gaps of a branch: each settles, with a
bound that holds.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitsweep.tasks.branches import atlas
from gaitsweep.tasks.branches.refine import COARSE, FINE
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract.registry import GAITS, STATUSES
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.gaits.polish import UNKNOWN, settle, unmeasured
from gaitsweep.tasks.gaits.search import lattice_size, starts
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.mechanics.small_angles import SmallAngles
from gaitsweep.tasks.mechanics.small_gaits import small_gaits
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.verify_step import strike_distance
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import FAILURES, branches, of_label, repeats, solved, some
from oracle import Oracle, StepFailed
from soak.bounds import compared
from soak.missed import built, missed, neighbour

GAP = {
    "m_t": 2.39806,
    "m_s": 0.892079,
    "r_t": 0.15408,
    "r_s": 0.13542,
    "c_t": 0.0961052,
    "c_s": 0.153447,
    "R": 0.174245,
    "eps_T": 0.102999,
}
#: Walker, keys, slope, and the label of a gait that an earlier version reported as not
#: converged.
BESIDE_FOLDS = [
    (
        "physical",
        {
            "m_t": 2.19373,
            "m_s": 1.01723,
            "r_t": 0.101467,
            "r_s": 0.194855,
            "c_t": 0.0792168,
            "c_s": 0.185457,
            "R": 0.178123,
            "eps_T": 0.0807192,
        },
        0.08319180030204733,
        "short",
    ),
    (
        "physical-straight",
        {
            "m_t": 2.45706,
            "m_s": 1.14417,
            "r_t": 0.097367,
            "r_s": 0.230449,
            "c_t": 0.105479,
            "c_s": 0.144793,
            "R": 0.199286,
            "eps_T": 0.0991235,
        },
        0.018271205432375957,
        "long",
    ),
    ("A", {"detuning": 0.861916}, 0.013045939233011155, "long"),
    (
        "physical-straight",
        {
            "m_t": 1.97907,
            "m_s": 1.21517,
            "r_t": 0.107085,
            "r_s": 0.214593,
            "c_t": 0.098876,
            "c_s": 0.18027,
            "R": 0.167897,
            "eps_T": 0.0885691,
        },
        0.018271205432375957,
        "other1",
    ),
    ("A", {"detuning": 1.105346294}, 0.017201447354440028, "other1"),
    ("physical", {}, 0.019129048414023374, "other1"),
    ("physical-straight", {}, 0.015386310517529214, "other1"),
]


@pytest.mark.parametrize(("walker", "overrides", "slope", "label"), BESIDE_FOLDS)
def test_a_point_beside_a_fold_settles(walker, overrides, slope, label):
    out = solved(walker, slope, **overrides)
    assert not np.isin(out["status"], FAILURES).any()
    found = of_label(out, label)
    assert found["status"] == STATUSES["converged"] and found["error_bound"] < 1e-11
    assert repeats(walker, overrides, slope, found) < 1e-6


@pytest.mark.parametrize(
    ("walker", "overrides"), [("physical-straight", {}), ("C", {"detuning": 0.3})]
)
def test_bounds_hold_as_near_a_fold_as_its_slope_is_known(walker, overrides):
    problem, found = branches(walker, **overrides)
    folds = (
        (b, p) for b in found for p in special_points(problem, b) if p["kind"] == "fold"
    )
    for branch, fold in some(folds):
        off = branch.Z[[-1, 0]].T - np.log([fold["slope"], fold["stance_angle"]])
        at = int(np.argmin(np.abs(off).sum(axis=1)))
        side = np.sign(branch.q[at + 1] - branch.q[at])
        slope = fold["slope"] * (1 + side * np.geomspace(1e-2, 1e-13, 12))
        rows = []
        for index, Z, segment in branch.guesses(np.log(slope)):
            near = np.abs(segment - at) < 40
            index, Z, segment = index[near], Z[:, near], segment[near]
            guesses = branch.known_guesses(Z, segment, slope[index])
            rows += compared(
                problem, replace(guesses, leg_passes=np.full(len(index), UNKNOWN))
            )
        # Both gaits at every distance.
        assert len(rows) == 24
        assert all(error <= bound < 1e-9 for _, bound, error, _, _ in rows)


#: Nearly tuned, with a fold at so small a slope that its derivative in doubles is
#: rounding.
TINY_FOLD = {
    **{
        "m_t": 2.8089367342747895,
        "m_s": 0.8289680150753062,
        "r_t": 0.1955414883828786,
        "r_s": 0.1349088128098967,
    },
    **{
        "c_t": 0.07592779639184609,
        "c_s": 0.15140079374558255,
        "R": 0.15182739329675565,
    },
    **{"eps_T": 0.1219618966829219, "l_t": 0.4430969751069832},
}


@pytest.mark.parametrize("shank", [0.4224, 0.4226])
def test_gaits_beside_a_fold_at_a_tiny_slope_settle_in_more_digits(shank):
    problem, found = branches("A", **TINY_FOLD, l_s=shank)
    (branch,) = [b for b in found if len(b.pieces()) == 2]
    (fold,) = branch.turns()
    slope = np.exp(branch.q[fold]) * (1 + np.array([5e-13, 1e-12, 1e-11, 1e-10, 1e-8]))
    angles = []
    for index, Z, segment in branch.guesses(np.log(slope)):
        guesses = branch.known_guesses(Z, segment, slope[index])
        gaits = settle(problem, guesses)
        assert gaits.converged.all() and gaits.step.all() and gaits.doubles.max() > 1e-3
        # Again with derivatives in more digits, from the solution: Newton shows how far
        # it was.
        assert all(
            error <= bound < 1e-11
            for _, bound, error, _, _ in compared(problem, guesses)
        )
        angles.append(gaits.y[0] * gaits.scale)
    # Two gaits that part with the root of the distance.
    apart = np.abs(angles[0] / angles[1] - 1)
    np.testing.assert_allclose(
        apart[1:] / apart[:-1], np.sqrt([2, 10, 10, 100]), rtol=0.05
    )


def test_a_gait_is_kept_where_a_rate_passes_zero():
    for slope in 0.102715733395058 * (1 + np.array([-1e-7, 0.0, 3e-12, 1e-8])):
        found = of_label(solved("C", slope), "long")
        assert found["status"] == STATUSES["converged"]
        assert abs(found["thigh_rate"]) < 1e-6 < abs(found["stance_rate"])
        # In doubles, as beside that slope: there is nothing ill-conditioned about it.
        assert found["error_bound"] < 1e-12 and found["residual"] < 1e-11
        assert repeats("C", {}, slope, found) < 1e-8


def test_no_extended_precision_is_asked_for_where_a_rate_passes_zero(monkeypatch):
    from gaitsweep.tasks.step import extended_precision

    monkeypatch.setattr(extended_precision, "refine", None)
    assert (
        of_label(solved("C", 0.102715733395058), "long")["status"]
        == STATUSES["converged"]
    )


def beside_the_gap(found):
    """The branch that ends where the gap begins, and the one that begins where it ends."""
    return sorted(
        (b for b in found if "end_earlier_strike" in b.why),
        key=lambda b: b.why.index("end_earlier_strike") == 0,
    )


def test_a_gap_in_a_branch_is_no_gait_and_both_its_ends_are_located():
    out = solved(
        "C", [0.00415, 0.00418, 0.0042, 0.004185432668024417, 0.00428, 0.0043], **GAP
    )
    short = GAITS.index("short")
    gone = STATUSES["no_gait"]
    np.testing.assert_array_equal(
        out["status"][:, short], [0, gone, gone, gone, gone, 0]
    )
    problem, found = branches("C", **GAP)
    ends = sorted(
        p["slope"]
        for b in found
        for p in special_points(problem, b)
        if p["kind"] == "end_earlier_strike"
    )
    assert ends == [
        pytest.approx(0.004173662, rel=1e-6),
        pytest.approx(0.004285163, rel=1e-6),
    ]
    # The same fixed point inside the gap: in the second derivation the foot strikes
    # before the knee.
    low, high = beside_the_gap(found)
    q = np.log([0.0042])
    w = 0.5 * (low.Z[:-1, [-1]] + high.Z[:-1, [0]])
    w, converged = newton(problem, w, q)
    assert converged.all()
    stride, scale = problem.stride(w, q)
    state = stride.start[:, 0] * scale[0]
    time_unit = np.sqrt(problem.walker.leg / problem.walker.g)
    with pytest.raises(
        StepFailed, match="after the leg has passed the heelstrike angle"
    ):
        Oracle(problem.walker.table()).step(
            state[0], state[3:] / time_unit, 0.0042, rtol=1e-10, atol=1e-12
        )


def test_a_branch_that_is_lost_before_a_fall_keeps_its_part_from_which_it_was_followed():
    """Near period 10.6 its step makes 1e12 of an error: there lie more nodes than on
    all the branch before.
    """
    keys = {
        "m_t": 1.92417253908927,
        "m_s": 1.0244571768418904,
        "r_t": 0.07013456037792994,
        "r_s": 0.25522646182091324,
        "c_t": 0.09188776139953267,
        "c_s": 0.20148056407242376,
        "R": 0.1857508756275541,
        "eps_T": 0.06862569693966147,
        "l_t": 0.2518588083381534,
        "l_s": 0.5681855775651635,
    }
    found = atlas.survey(Problem(resolve("physical", keys)), COARSE)
    (branch,) = (b for b in found if "no further point" in b.why)
    assert np.exp(branch.q.min()) < 0.236 and np.exp(branch.q.max()) > 0.436
    assert 10 < branch.Z[-2].max() < 11  # rounding decides whether it ends before 10.6


def test_a_gap_between_two_nodes_is_found():
    """Nodes so far apart that none lies in the gap: the guard's minimum between them
    tells.
    """
    from gaitsweep.tasks.branches.lockstep import run

    problem, found = branches("C", **GAP)
    low, high = beside_the_gap(found)
    joined = atlas.Branch(
        low.m,
        np.hstack([low.Z[:, :-1], high.Z[:, 1:]]),
        np.hstack([low.tangent[:, :-1], high.tangent[:, 1:]]),
        np.zeros(len(low.q) + len(high.q) - 2),
        (low.why[0], high.why[1]),
    )
    wide = np.exp(joined.q)
    assert not ((wide > 0.004174) & (wide < 0.004285)).any()
    assert [
        b.why for b in run(problem, atlas._without_gaps(joined, low.Z[:, 0], FINE))
    ] == [low.why, high.why]


def test_a_gap_where_the_released_knee_turns_is_found():
    """It strikes at once there, while at the nodes on both sides its flexion has no
    extremum.
    """
    problem, found = branches("C", detuning=-0.322324752034447)
    ends = sorted(
        p["slope"]
        for b in found
        for p in special_points(problem, b)
        if p["kind"] == "end_earlier_strike"
    )
    assert ends == [
        pytest.approx(0.14243031, rel=1e-6),
        pytest.approx(0.14333601, rel=1e-6),
    ]
    out = solved(
        "C", [0.1424, 0.1425, 0.14329072, 0.1433, 0.1434], detuning=-0.322324752034447
    )
    assert not np.isin(out["status"], FAILURES).any()
    larger = np.nan_to_num(out["stance_angle"]).max(
        axis=1
    )  # the smaller gait has no gap
    np.testing.assert_array_equal(larger > 0.55, [True, False, False, False, True])


def test_an_end_at_which_the_released_knee_turns_is_no_gap():
    """A strike at once limits it, to rounding: finer samples may show that strike at
    the end itself.
    """
    keys = {
        "m_t": 2.890601514599421,
        "m_s": 1.1592517704213854,
        "r_t": 0.2266928239467638,
        "r_s": 0.10744884620933674,
        "c_t": 0.09020602594020488,
        "c_s": 0.19056171835287758,
        "R": 0.2169452260076321,
        "eps_T": 0.11364317136091168,
        "l_t": 0.2790750917247171,
        "l_s": 0.5771611563881274,
    }
    problem = Problem(resolve("C", keys))
    coarse, fine = (atlas.survey(problem, tolerance) for tolerance in (COARSE, FINE))
    assert [b.why for b in coarse] == [b.why for b in fine]
    assert coarse[0].why[1] == "end_earlier_strike"
    assert coarse[0].q[-1] == pytest.approx(fine[0].q[-1], abs=1e-9)


def test_the_distance_from_an_earlier_strike_vanishes_where_one_cuts_in():
    problem, found = branches("C", **GAP)
    (branch,) = [b for b in found if b.why[1] == "end_earlier_strike"]
    w, q = branch.Z[:-1, -5:], branch.q[-5:]
    stride, _ = problem.stride(w, q, samples=256)
    away = strike_distance(stride.scaled_motion(), stride.times)
    assert (np.diff(away) < 0).all() and abs(away[-1]) < 1e-9 < away[-2]


def test_no_branch_is_split_where_newton_jumps():
    """Its last segment before kneestrike meets heelstrike was split at points of other
    branches.
    """
    ends = {}
    for detuning in (0.11, 0.1111111111111111, 0.112):
        _problem, found = branches("C", detuning=detuning)
        (branch,) = [b for b in found if "end_kneestrike_at_heelstrike" in b.why]
        X, tangent = (
            np.delete(each, np.s_[branch.m : -1], axis=0)
            for each in (branch.Z, branch.tangent[:, :-1])
        )
        chords = np.diff(X)
        along = (chords * tangent).sum(axis=0) / np.linalg.norm(tangent, axis=0)
        assert (along > 0.9 * np.linalg.norm(chords, axis=0)).all()
        assert branch.Z[-2, -1] == pytest.approx(branch.Z[-3, -1], rel=1e-12)
        ends[detuning] = np.exp(branch.q[-1])
    values = list(ends.values())
    assert values[0] > values[1] > values[2] > 0.48
    out = solved("C", np.geomspace(1e-3, 0.15, 20), detuning=0.1111111111111111)
    assert not np.isin(out["status"], FAILURES).any()


def test_a_point_is_measured_where_its_segment_does_not_vouch_for_it():
    """Beside a fold the estimate of its own node, infinite, says nothing of a point;
    that of a far one too little.
    """
    problem, found = branches("physical-straight")
    branch = next(b for b in found if len(b.pieces()) > 1)
    fold = branch.pieces()[0][1]
    assert (
        np.isinf(branch.lipschitz[fold])
        and np.isfinite(np.delete(branch.lipschitz, fold)).all()
    )
    q = branch.q[fold] + np.sign(branch.q[fold + 1] - branch.q[fold]) * 1e-8
    (_, Z, _), *_ = (g for g in branch.guesses(np.array([q])))
    guesses = unmeasured(problem, Z[:-1], np.exp([q]))
    ((_, bound, error, _, _),) = compared(
        problem, replace(guesses, lipschitz=np.array([np.inf]))
    )
    assert error <= bound < 1e-12


@pytest.mark.parametrize("count", [8, pytest.param(500, marks=pytest.mark.soak)])
def test_no_point_of_a_random_line_fails(count):
    """Walkers near A, C and the physical one, masses, lengths and offsets off by a
    fifth, or detuned; by both roads.
    """
    from gaitsweep.tasks.studies.solve_points import lines
    from gaitsweep.tasks.walkers.catalogue import CATALOGUE

    keys, failed = (
        ("m_t", "m_s", "r_t", "r_s", "c_t", "c_s", "R", "eps_T", "l_t", "l_s"),
        [],
    )
    for k in range(count):
        random, walker = (
            np.random.default_rng(k),
            ("A", "C", "physical", "physical-straight")[k % 4],
        )
        if walker in ("A", "C") and random.random() < 0.5:
            overrides = {"detuning": random.uniform(-0.3, 1.4)}
        else:
            table = CATALOGUE[walker].table()
            overrides = {
                key: table[key] * (1 + random.uniform(-0.2, 0.2)) for key in keys
            }
        slope = np.exp(random.uniform(np.log(1e-3), np.log(0.15), 25))
        want = ("stance_angle", "status", "reason")
        if k % 8 < 4:
            out = solved(walker, slope, want=want, **overrides)
        else:
            ((_, out),) = lines(
                {
                    "lines": [{"walker": walker, "set": overrides}],
                    "slope": slope,
                    "want": want,
                },
                [],
            )
        for i, g in np.argwhere(np.isin(out["status"], FAILURES)):
            failed.append(
                (walker, overrides, slope[i], out["reasons"][out["reason"][i, g]])
            )
    assert not failed


def test_a_fold_at_a_node_gets_no_node_beside_it():
    """Two nodes that are one but for the last digit have no polynomial between them."""
    from gaitsweep.tasks.studies.solve_points import lines

    near_c = {
        "m_t": 2.5842990949854276,
        "m_s": 1.0897795697340276,
        "r_t": 0.20555592702562264,
        "r_s": 0.10248002454852735,
    }
    near_c |= {
        "c_t": 0.09547836664274166,
        "c_s": 0.15240608532700292,
        "R": 0.1712150670605063,
        "eps_T": 0.07878795719274959,
    }
    near_c |= {"l_t": 0.2975081638879152, "l_s": 0.5104774396091883}
    asked = {
        "lines": [{"walker": "C", "set": near_c}],
        "slope": np.geomspace(1e-3, 0.15, 9),
        "want": ("stance_angle",),
    }
    ((found, _),) = lines(asked, [])
    apart = np.linalg.norm(np.diff(found["Z"][[0, 1, 2, -1]]), axis=0)
    assert (apart > 1e-14).all()


def test_a_kept_point_is_a_step_by_its_own_motion():
    problem, found = branches("C", **GAP)
    for branch in found:
        inner = branch.Z[:-1, 1:-1]
        assert verify_steps(problem, inner, branch.q[1:-1])[1].step.all()


@pytest.mark.parametrize("ratio", [0.4487670699198065, 0.44608828041136744])
def test_long_gaits_of_heavy_point_feet_are_found(ratio):
    """Newton's method finds them from a period in which both legs exchange places only."""
    slope = [1e-4, 0.0102, 0.0318]
    out = solved("E", slope, foot_mass_ratio=ratio)
    assert (out["status"][:, :2] == STATUSES["converged"]).all()
    assert (out["period"][:, 0] > 1.8 * out["period"][:, 1]).all()
    found = {name: value[1, 0] for name, value in out.items() if name != "reasons"}
    assert repeats("E", {"foot_mass_ratio": ratio}, slope[1], found) < 1e-6


@pytest.mark.parametrize("ratio", [0.02, 0.2, 0.44])
def test_point_feet_exchange_places_in_the_periods_of_gaits_of_small_angles(ratio):
    out, slope = solved("E", [1e-7], foot_mass_ratio=ratio), np.array([1e-7])
    for label, place in (("short", 0), ("long", 1)):
        found = of_label(out, label)
        linear = SmallAngles(resolve("E", {"foot_mass_ratio": ratio}))
        periods = linear.exchange_periods(found["stance_angle"][None], slope)
        assert periods[place, 0] == pytest.approx(found["period"], rel=5e-3)


@pytest.mark.parametrize("detuning", [1.8, 2.0, 2.06])
def test_short_gaits_of_steep_slopes_are_found(detuning):
    """The rates in which legs exchange places to first order are far from theirs."""
    slope = [0.139, 0.3]
    out = solved("A", slope, detuning=detuning)
    assert (out["status"][:, :2] == STATUSES["converged"]).all()
    found = {name: value[0, 1] for name, value in out.items() if name != "reasons"}
    assert found["period"] < 0.6 * out["period"][0, 0]
    assert repeats("A", {"detuning": detuning}, slope[0], found) < 1e-6


#: Walkers of one link whose legs swing faster or slower than those of the catalogue:
#: their slope, and stance angle and period of gaits, which simulations walk for 200
#: steps.
FAST_AND_SLOW = [
    (
        {"l": 0.517, "m": 5.0, "c": 0.1053, "r": 0.022, "R": 0.483, "m_h": 3.19},
        0.0015,
        [(0.098275898832063393, 0.293635174356), (0.07065, None)],
    ),
    (
        {"l": 0.924, "m": 5.0, "c": 0.0997, "r": 0.049, "R": 0.076, "m_h": 2.44},
        0.0254,
        [(0.16983, None), (0.15973966147925395, 0.264413715606)],
    ),
    (
        {
            "l": 0.22697,
            "m": 6.79027,
            "c": 0.0177785601,
            "r": 0.23826,
            "R": 0.77303,
            "m_h": 4.37745,
        },
        0.0044,
        [(0.73339586234200248, 2.74712925986), (0.51267, None)],
    ),
    (
        {"l": 0.792, "m": 5.0, "c": 0.0258, "r": 0.0307, "R": 0.208, "m_h": 17.2},
        0.002132064845791061,
        [(0.077612, None), (0.076138, None)],
    ),
    (
        # Without a mass at the hip, the stance leg reacts to the swing leg.
        {"l": 1.0, "m": 1.0, "c": 0.804713, "r": 0.0214085, "R": 0.0, "m_h": 0.0},
        0.12333,
        [(0.112367, None), (0.102205, None)],
    ),
]


@pytest.mark.parametrize(("walker", "slope", "gaits"), FAST_AND_SLOW)
def test_gaits_of_fast_and_slow_legs_are_found(walker, slope, gaits):
    table = {**walker, "knees": False, "g": 9.81}

    found = solve_one({"walker": table, "slope": slope})["gaits"]

    assert len(found) == len(gaits)
    for gait, (angle, period) in zip(found, gaits, strict=True):
        digits = 1e-12 if period else 3e-5
        assert gait["stance_angle"] == pytest.approx(angle, rel=digits)
        if period:
            assert gait["period"] == pytest.approx(period, rel=1e-11)


@pytest.mark.parametrize("centre", [0.005, 0.03, 0.05, 0.07, 0.1, 0.13, 0.2, 0.3])
def test_both_gaits_are_found_wherever_the_mass_of_a_leg_lies(centre):
    walker = {
        "l": 0.9,
        "m": 5.0,
        "c": centre,
        "r": centre / 2,
        "R": 0.1,
        "m_h": 5.0,
        "knees": False,
        "g": 9.81,
    }

    found = solve_one({"walker": walker, "slope": 0.01})["gaits"]

    assert [gait["gait"] for gait in found] == ["long", "short"]


@pytest.mark.parametrize("centre", [0.0, -0.05])
def test_a_leg_that_is_balanced_about_the_hip_is_searched_like_a_slow_one(centre):
    walker = {
        "l": 0.9,
        "m": 5.0,
        "c": centre,
        "r": 0.2,
        "R": 0.1,
        "m_h": 5.0,
        "knees": False,
        "g": 9.81,
    }

    solved = solve_one({"walker": walker, "slope": 0.01})

    assert solved["gaits"] == [] and len(solved["absent"]) == 2
    assert "with periods from 1.12 to 3.58" in solved["absent"][0]


@pytest.mark.parametrize("centre", [0.04, 0.1, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("hip", [0.0, 2.0, 40.0])
def test_a_line_has_the_long_gait_that_small_angles_prove(centre, hip):
    """As slopes vanish, the legs of a long gait exchange places at equal rates; which
    periods allow it is exact.
    """
    walker = resolve(
        {
            "l": 0.8,
            "m": 1.0,
            "c": centre * 0.8,
            "r": 0.1,
            "R": 0.2,
            "m_h": hip,
            "knees": False,
        }
    )
    linear = SmallAngles(walker)
    period = np.linspace(0.5, 1.5, 4001) * linear.swing
    stance, swing = linear.exchange_rates(
        np.ones_like(period), period, np.zeros_like(period)
    )
    apart = swing - stance
    roots = period[:-1][(np.diff(np.sign(apart)) != 0) & (np.abs(np.diff(apart)) < 1)]

    long, *_ = solve_one({"walker": walker.table(), "slope": 1e-9})["gaits"]

    assert np.abs(roots / long["period"] - 1).min() < 1e-3


@pytest.mark.parametrize(("slope", "apart"), [(1e-8, 1e-4), (0.02, 0.1)])
def test_a_kneed_step_begins_as_small_angles_have_it(slope, apart):
    """The time of kneestrike is that of other rates, so both are near those of the
    gait.
    """
    problem, found = branches("C")
    gaits = [Z[:, 0] for branch in found for _, Z, _ in branch.guesses(np.log([slope]))]
    assert len(gaits) == 2
    for log_angle, rate, swing_rate, kneestrike, period, _ in gaits:
        asked = (
            np.array([x]) for x in (np.exp(log_angle), period, swing_rate / rate, slope)
        )

        (guess, _), (time, _) = SmallAngles(problem.walker).kneed_exchange(*asked)

        assert guess == pytest.approx(rate * np.exp(log_angle), rel=apart)
        assert time == pytest.approx(kneestrike, rel=max(apart / 2, 5e-3))


@pytest.mark.parametrize(
    ("draw", "numbers", "rate"),
    [
        (built, range(2), 0.0),
        pytest.param(neighbour, range(6, 12), 0.0, marks=pytest.mark.thorough),
        pytest.param(built, range(2, 16), 0.0, marks=pytest.mark.thorough),
        pytest.param(neighbour, range(1000, 2000), 0.01, marks=pytest.mark.soak),
        pytest.param(built, range(2000), 0.01, marks=pytest.mark.soak),
    ],
)
def test_a_survey_misses_few_gaits_that_a_dense_search_finds(draw, numbers, rate):
    outcome = missed(numbers, draw)
    assert outcome.gaits.total() > len(numbers) / 2
    assert outcome.lacking.total() <= rate * outcome.gaits.total(), outcome.each


def test_a_gait_missing_from_a_survey_is_counted(monkeypatch):
    monkeypatch.setattr(
        "gaitsweep.tasks.branches.atlas.survey_lines",
        lambda problem, tolerance: [[] for _ in problem.lanes],
    )
    outcome = missed(range(4, 8))
    assert (
        outcome.lacking == outcome.gaits
        and len(outcome.each) == outcome.gaits.total() > 0
    )
    assert outcome.rows()[-1]["missed"] == outcome.gaits.total()


@pytest.mark.parametrize("hip", [1.0, 2.5, 2.75, 4.0])
def test_gaits_of_large_angles_are_found(hip):
    """Of large round feet on steep slopes, on which both gaits have angles of about a
    radian.
    """
    problem = Problem(resolve("A", {"R": 0.4, "m_h": hip}))
    (branch,) = atlas.survey(problem, COARSE)
    angles = np.exp(
        sorted(float(Z[0, 0]) for _, Z, _ in branch.guesses(np.log([0.22])))
    )
    assert len(angles) == 2 and 0.9 < angles[0] < angles[1] - 0.05 < 1.2


#: Walkers of which a survey once missed a gait of a dense search: their slope, and the
#: gait's stance angle and period over sqrt(leg/g).
ONCE_MISSED = [
    (
        # Its knee strikes at its second return.
        {
            "knees": True,
            "l_t": 0.5384030561322111,
            "l_s": 0.46159694386778893,
            "R": 0.36927755509423116,
            "w_t": 0.0,
            "w_s": 0.0,
            "m_t": 1.0,
            "m_s": 2.2402928338872297,
            "c_t": 0.15857089670256136,
            "c_s": 0.19495301523693562,
            "r_t": 0.26338527299161557,
            "r_s": 0.03479814975459054,
            "eps_T": 0.13326358547261702,
            "m_h": 13.444971545194845,
            "tuned": ["w_t", "w_s"],
        },
        0.16045992405605508,
        0.783761831056658,
        4.041927914093873,
    ),
    (
        # Its links hang far from a line: its knee strikes early.
        {
            "knees": True,
            "l_t": 0.3481348016127335,
            "l_s": 0.6518651983872665,
            "R": 0.22652236713505475,
            "w_t": 0.0,
            "w_s": 0.0,
            "m_t": 1.0,
            "m_s": 4.161431974355467,
            "c_t": 0.1363148526496973,
            "c_s": 0.3608952591978687,
            "r_t": 0.052097043074326686,
            "r_s": 0.015835333321526254,
            "eps_T": 0.3631423493607564,
            "m_h": 0.0,
        },
        0.1024741363047373,
        0.27998599041667405,
        2.256902700483364,
    ),
    (
        # A mass almost at the foot takes short steps of tiny angles.
        {
            "knees": False,
            "l": 1.0,
            "c": 0.9779584248988958,
            "r": 0.08900834288065654,
            "m": 1.0,
            "R": 0.0,
            "m_h": 0.04235828713698168,
        },
        0.03278115771734512,
        0.004764201983982064,
        0.9647399934683581,
    ),
    (
        # The same, with another hip.
        {
            "knees": False,
            "l": 1.0,
            "c": 0.9879571009451552,
            "r": 0.038798117318019514,
            "m": 1.0,
            "R": 0.0,
            "m_h": 0.05518788300036697,
        },
        0.012096917749262229,
        0.00157159088868034,
        0.926664957477395,
    ),
    (
        # A nearly balanced leg.
        {
            "knees": False,
            "l": 0.744,
            "c": 0.009,
            "r": 0.301,
            "m": 5.0,
            "R": 0.256,
            "m_h": 1.03,
        },
        0.0011,
        0.04171479706736009,
        9.922710995531968,
    ),
]


@pytest.mark.parametrize(("walker", "slope", "angle", "period"), ONCE_MISSED)
def test_a_survey_has_the_gaits_that_it_once_missed(walker, slope, angle, period):
    found = atlas.survey(Problem(resolve(walker)), COARSE)

    at_slope = [
        Z[:, 0] for branch in found for _, Z, _ in branch.guesses(np.log([slope]))
    ]
    assert [
        Z
        for Z in at_slope
        if np.exp(Z[0]) == pytest.approx(angle, rel=1e-5)
        and Z[-2] == pytest.approx(period, rel=1e-5)
    ]


@pytest.mark.parametrize(("radius", "hip"), [(0.4, 5.0), (0.8, 0.5)])
def test_rates_of_steps_on_vanishing_slopes_are_those_of_small_angles(radius, hip):
    """Rolling on a round foot down the slope is part of them."""
    length = 1.0 - radius
    walker = {"knees": False, "l": length, "c": 0.4 * length, "r": 0.1, "m": 1.0}
    problem = Problem(resolve(walker | {"R": radius, "m_h": hip}))
    slope = np.array([1e-9])
    for branch in atlas.survey(problem, COARSE):
        for _, Z, _ in branch.guesses(np.log(slope)):
            angle = np.exp(Z[0])

            rates = SmallAngles(problem.walker).exchange_rates(angle, Z[-2], slope)

            assert rates[:, 0] / angle == pytest.approx(Z[1:3, 0], rel=1e-3)


@pytest.mark.parametrize(
    ("radius", "centre"), [(0.0, 0.3), (0.0, 0.97), (0.3, 0.6), (0.3, 0.97)]
)
def test_gaits_of_vanishing_angles_are_those_of_small_angles(radius, centre):
    """As the slope vanishes, angles in proportion to it become exact."""
    length = 1.0 - radius
    walker = {"knees": False, "l": length, "c": centre * length, "r": 0.05, "m": 1.0}
    problem = Problem(resolve(walker | {"R": radius, "m_h": 1.0}))
    slope = 1e-9
    short = [
        Z[:, 0]
        for branch in atlas.survey(problem, COARSE)
        for _, Z, _ in branch.guesses(np.log([slope]))
        if np.exp(Z[0, 0]) < 1e-6
    ]
    assert short

    (found,) = small_gaits(SmallAngles(problem.walker), [slope])

    for log_angle, *rates, period, _ in short:
        apart = found.T / [np.exp(log_angle), *rates, period] - 1
        # Periods are interpolated between those looked at, and angles change fast with
        # them.
        assert (np.abs(apart) < [0.2, 0.02, 0.02, 0.005]).all(axis=1).any()


def test_gaits_of_small_angles_are_guessed_once_where_they_are_the_same_on_all_slopes():
    linear = SmallAngles(resolve("A"))

    found = small_gaits(linear, [0.1, 1e-3, 0.01])

    assert [gaits.shape[1] > 0 for gaits in found] == [False, True, False]


@pytest.mark.parametrize(
    ("walker", "more"),
    [("C", 1), ("physical", 1), *((w[0], 2) for w in ONCE_MISSED[:2])],
)
def test_only_knees_that_small_angles_do_not_tell_are_guessed_twice(walker, more):
    walker, slopes = resolve(walker), [0.003, 0.05]

    guesses = sum(w.shape[1] for w in starts(walker, slopes))

    size = lattice_size(walker, slopes, 1)
    assert size * (more - 0.5) < guesses <= size * more


def test_a_knee_that_overextends_little_may_strike_at_its_second_return():
    walker = resolve(ONCE_MISSED[0][0])
    asked = (np.array([x]) for x in (0.3, 3.5, 0.9, 0.01))

    first, second = SmallAngles(walker).kneed_exchange(*asked)[1][:, 0]

    assert first == pytest.approx(1.12, abs=0.03)
    assert second == pytest.approx(2.16, abs=0.06)


#: Legs that have no inertia, or no length, and how they are refused.
ONE_LINK = {"knees": False, "l": 1.0, "c": 0.3, "r": 0.1, "m": 1.0, "m_h": 1.0}
TWO_LINKS = {
    **{"knees": True, "l_t": 0.5, "l_s": 0.5, "R": 0.0, "w_t": 0.0, "w_s": 0.0},
    **{"m_t": 1.0, "m_s": 1.0, "c_t": 0.2, "c_s": 0.2, "r_t": 0.1, "r_s": 0.1},
    **{"eps_T": 0.0, "m_h": 1.0},
}
REFUSED = [
    (
        ONE_LINK | {"c": 0.0, "r": 0.0},
        "`c` must lie off the hip, or `r` be > 0: the leg has no inertia; got 0.0.",
    ),
    (ONE_LINK | {"l": 0.0}, "`l` must be > 0; got 0.0."),
    (ONE_LINK | {"r": -0.1}, "`r` must be >= 0; got -0.1."),
    (
        ONE_LINK | {"m": 0.0, "m_h": 0.0},
        "`m` must leave the walker some mass (m or m_h > 0); got 0.0.",
    ),
    (
        ONE_LINK | {"c": 1.0, "r": 0.0, "m_h": 0.0},
        "`m_h` must be > 0 where the legs are points at feet without a radius: a walker "
        "that stands has no inertia; got 0.0.",
    ),
    (
        TWO_LINKS | {"c_s": 0.0, "r_s": 0.0},
        "`r_s` must leave the shank some inertia about its knee; got 0.0.",
    ),
    (
        TWO_LINKS | {"c_t": 0.0, "r_t": 0.0, "r_s": 0.0},
        "`r_s` must be > 0 where the thigh has no inertia about the hip: the knee of a "
        "straight leg has none; got 0.0.",
    ),
]


@pytest.mark.parametrize(("walker", "sentence"), REFUSED)
def test_legs_without_inertia_are_refused_by_their_own_keys(walker, sentence):
    with pytest.raises(WalkerError) as error:
        resolve(walker)

    assert str(error.value) == sentence


def test_legs_of_a_millimetre_beside_a_hip_of_a_tonne_have_the_gaits_of_their_ratios():
    small = {**ONE_LINK, "l": 1e-3, "c": 3e-4, "r": 1e-4, "m": 1e-3, "m_h": 1e3}
    large = {**ONE_LINK, "m": 1e-3, "m_h": 1e3}

    found, same = (
        [
            gait["stance_angle"]
            for gait in solve_one({"walker": w, "slope": 0.01})["gaits"]
        ]
        for w in ({**small, "g": 9.81}, large)
    )

    assert len(found) == 2 and found == pytest.approx(same, rel=1e-9)


@pytest.mark.parametrize("centre", [-1e-5, -1e-3])
def test_a_leg_that_stands_on_the_hip_and_falls_fast_has_no_gait(centre):
    walker = ONE_LINK | {"c": centre, "r": 0.0}

    assert solve_one({"walker": walker, "slope": 0.01})["gaits"] == []


@pytest.mark.parametrize(("radius", "angle"), [(0.95, 0.143805669), (0.98, 0.14849969)])
def test_a_foot_almost_as_round_as_the_leg_is_long_has_its_long_gait(radius, angle):
    """Its angles are beyond those of pointed feet, in proportion to (leg/l)^(2/3)
    (section 4.1): that of .95 was found by luck, that of .98 was not.
    """
    walker = {"base": "B", "R": radius}
    slope = 1e-3 * (1 - radius) ** 2
    gaits = solve_one({"walker": walker, "slope": slope})["gaits"]
    labels = {gait["gait"]: gait for gait in gaits}
    assert labels["long"]["stance_angle"] == pytest.approx(angle, rel=1e-6)
