"""Branches, their folds, flips and ends, against what was computed before and against
themselves.
"""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.optimize import brentq

from gaitsweep.tasks.branches import atlas
from gaitsweep.tasks.branches.atlas import survey
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import Equations, solve
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.lockstep import run
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.branches.refine import COARSE, FINE, without_jumps
from gaitsweep.tasks.branches.root import bracketed_root
from gaitsweep.tasks.branches.special_points import passings, special_points
from gaitsweep.tasks.branches.tracking import correct, follow
from gaitsweep.tasks.contract.registry import GAITS, STATUSES
from gaitsweep.tasks.gaits.newton import LONGEST_PERIOD
from gaitsweep.tasks.gaits.polish import UNKNOWN, settle
from gaitsweep.tasks.gaits.search import search
from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.walker import Walker
from lines import branches, gait, solved, some
from soak.bounds import compared
from soak.stress import random_walker


def points_of(walker, **overrides):
    problem, found = branches(walker, **overrides)
    return [p for b in found for p in special_points(problem, b)]


def pick(points, kind):
    return [p for p in points if p["kind"] == kind]


def test_the_first_flip_of_d():
    (flip,) = pick(points_of("D"), "flip")
    assert flip["slope"] == pytest.approx(0.015088437941119463562, rel=1e-13)


def test_the_loci_of_the_machine():
    kneed, straight = points_of("physical"), points_of("physical-straight")
    low, high, beyond = sorted(p["slope"] for p in pick(kneed, "fold"))
    assert (low, high) == (
        pytest.approx(0.0191, abs=5e-5),
        pytest.approx(0.0530, abs=5e-5),
    )
    # The second branch of claim T8, off the paper's figure.
    assert beyond == pytest.approx(0.163722480, rel=1e-8)
    one = min(pick(kneed, "end_kneestrike_at_heelstrike"), key=lambda p: p["slope"])
    assert (one["slope"], one["stance_angle"]) == (
        pytest.approx(0.0364, abs=5e-5),
        pytest.approx(0.1488, abs=1e-4),
    )
    three = min(pick(kneed, "release_hyperextension"), key=lambda p: p["stance_angle"])
    assert three["slope"] == pytest.approx(0.02154, abs=5e-6)
    assert three["stance_angle"] == pytest.approx(0.0194, abs=5e-5)
    (fold,) = pick(straight, "fold")
    assert fold["slope"] == pytest.approx(0.0154, abs=5e-5)
    (two,) = pick(straight, "end_tangential_heelstrike")
    assert (two["slope"], two["stance_angle"]) == (
        pytest.approx(0.0561, abs=5e-5),
        pytest.approx(0.2365, abs=5e-5),
    )
    (four,) = pick(straight, "end_zero_step")
    assert (four["slope"], four["stance_angle"]) == (
        pytest.approx(0.0211, abs=5e-5),
        pytest.approx(0.0, abs=1e-4),
    )


def test_the_kneed_walker_flips_and_hyperextends():
    for name, flip in (("C", 0.0769), ("C-printed", 0.0786)):
        (found,) = pick(points_of(name), "flip")
        assert found["slope"] == pytest.approx(flip, abs=5e-5)
    released = [p["slope"] for p in pick(points_of("C"), "release_hyperextension")]
    assert min(released) == pytest.approx(2.2077e-4, rel=1e-4)
    assert max(released) == pytest.approx(0.0079745, abs=5e-8)


def test_a_branch_followed_the_other_way_has_the_same_ends():
    """One end lies on a segment that must be split first, now the first of the branch
    and now the last.
    """
    problem, found = branches("C", detuning=0.112)
    (branch,) = [b for b in found if "end_kneestrike_at_heelstrike" in b.why]
    (tracks,) = follow(problem, branch.Z[:, [len(branch.q) // 2]])
    (up,), (down,) = (
        run(problem, atlas.branches_along(problem, *pair, FINE))
        for pair in (tracks, tracks[::-1])
    )
    assert (
        up.why
        == down.why[::-1]
        == ("end_earlier_strike", "end_kneestrike_at_heelstrike")
    )
    np.testing.assert_allclose(
        up.Z[:, [0, -1]], down.Z[:, [-1, 0]], rtol=1e-12, atol=1e-13
    )


def test_a_branch_ends_where_a_search_no_longer_finds_its_gait():
    """The time of kneestrike changes ever faster towards the end, and beyond it the
    step has no such kneestrike.
    """
    problem = Problem(random_walker("kneed, near", 336))
    found = survey(problem)
    (end,) = [
        np.exp(b.q[0])
        for b in found
        if b.why == ("end_tangential_kneestrike", "end_kneestrike_at_heelstrike")
    ]
    for slope, number in ((1.01 * end, 2), (0.99 * end, 1)):
        assert search(problem, slope)[2].step.sum() == number
        assert (
            sum(len(index) for b in found for index, _, _ in b.guesses(np.log([slope])))
            == number
        )


def test_a_fold_is_found_however_few_nodes_there_are():
    problem, found = branches("physical-straight")
    (branch,) = [b for b in found if len(b.pieces()) == 2]
    fold = branch.pieces()[0][1]
    for every in (16, 64):
        kept = np.union1d(np.arange(0, len(branch.q), every), len(branch.q) - 1)
        assert fold not in kept
        few = Branch(
            branch.m,
            branch.Z[:, kept],
            branch.tangent[:, kept],
            branch.lipschitz[kept],
            branch.why,
        )
        located = run(problem, atlas._with_folds(few))
        assert located.q[located.pieces()[0][1]] == pytest.approx(
            branch.q[fold], abs=1e-14
        )


def test_a_polynomial_in_the_slope_is_reproduced_however_fast_the_time_runs():
    """Towards a fall the time is a logarithm of the slope; the coordinates of the gait
    are not to follow it there.
    """
    q = np.linspace(0, 3, 7)

    def gaits(q):
        Z = np.stack([q / 3 + q**2 / 10, q**7 / 3**7, -8 * np.log(3.1 - q), q])
        rate = np.stack(
            [1 / 3 + q / 5, 7 * q**6 / 3**7, 8 / (3.1 - q), np.ones_like(q)]
        )
        return Z, rate

    Z, rate = gaits(q)
    branch = Branch(2, Z, rate, np.zeros(7), ("window", "end_fall"))
    between = np.linspace(0.05, 2.95, 20)
    ((index, found, _),) = branch.guesses(between)
    np.testing.assert_allclose(
        found[[0, 1, 3]], gaits(between[index])[0][[0, 1, 3]], rtol=1e-13, atol=1e-13
    )


def test_tangents_point_along_the_branch():
    Z, one = np.zeros((2, 1)), np.ones(1)
    point = Point(Z, np.array([[0.6], [-0.8]]), one > 0, one, one, Z, None)
    for along in ([1.0, 0.0], [-1.0, 0.0], [0.0, 2.0]):
        tangent = point.oriented(np.array(along)[:, None]).direction[:, 0]
        assert tangent @ along > 0 and np.abs(tangent).tolist() == [0.6, 0.8]


def test_where_one_component_turns_a_branch_runs_in_another():
    """The angle turns between two nodes; everywhere else, and there too, the slope is
    the better coordinate.
    """
    q = np.linspace(-6.0, -3.0, 7)
    Z = np.array([0.1 * (q + 4.6) ** 2, 3 + 0.01 * q, q])
    tangent = np.array([0.2 * (q + 4.6), np.full(7, 0.01), np.ones(7)])
    branch = Branch(1, Z, tangent, np.ones(7), ("window", "window"))
    assert branch.axis.tolist() == [2] * 6
    place = np.linspace(0, 6, 50)
    assert branch.at(place)[0] == pytest.approx(0.1 * (place / 2 - 1.4) ** 2)


def test_a_located_flip_has_the_multiplier():
    problem, found = branches("E", foot_mass_ratio=0.05)
    for branch, p in some(
        (b, p) for b in found for p in pick(special_points(problem, b), "flip")
    ):
        ((_, Z, _),) = [
            g for g in branch.guesses(np.array([np.log(p["slope"])])) if len(g[0])
        ]
        stride, _ = problem.stride(Z[:-1], np.log([p["slope"]]))
        assert np.abs(np.linalg.eigvals(stride.jacobian[:, :, 0]) + 1).min() < 1e-9


def test_a_pair_of_reciprocal_real_multipliers_is_no_point_of_neimark_and_sacker():
    neutral = gait("E", 0.0641736546388099, "short")
    assert (neutral["multiplier_imag"][:2] == 0).all()
    assert neutral["multiplier_real"][:2].prod() == pytest.approx(1, abs=1e-9)
    assert not pick(points_of("E"), "neimark_sacker")


def test_a_pole_of_the_derivative_is_no_flip():
    """Where heelstrike turns tangential det(DP + 1) changes sign through infinity,
    whether or not the end is named.
    """
    problem = Problem(random_walker("kneed, near", 1))
    (branch,) = [b for b in survey(problem) if "end_tangential_heelstrike" in b.why]
    ends = tuple(
        "window" if why == "end_tangential_heelstrike" else why for why in branch.why
    )
    assert not pick(special_points(problem, replace(branch, why=ends)), "flip")


def test_a_pole_of_the_local_exponent_is_no_root():
    """At folds, where the slope turns, it changes sign through infinity: two of the
    machine's were taken for roots.
    """
    for walker, count in (("physical", 3), ("physical-straight", 2)):
        problem, found = branches(walker)
        points = [
            point
            for branch in found
            for _, point in passings(problem, branch, CONDITIONS["exponent_two_thirds"])
        ]
        assert len(points) == count
        for point in points:
            assert point.direction[0, 0] / point.direction[-1, 0] == pytest.approx(
                2 / 3, abs=1e-10
            )


def test_a_scalar_at_a_point_of_a_branch_is_that_of_its_coordinates():
    problem, found = branches("physical")
    Z = found[0].Z[:, ::20]
    at, point = evaluate(problem, Z), correct(problem, Z, None, max_iterations=1)
    for kind in (
        "flip",
        "neimark_sacker",
        "release_hyperextension",
        "end_kneestrike_at_heelstrike",
    ):
        np.testing.assert_allclose(
            CONDITIONS[kind].residual(point.at),
            CONDITIONS[kind].residual(at),
            rtol=1e-6,
            atol=1e-10,
        )


def test_special_points_are_solved_with_derivatives_of_points_nearby(monkeypatch):
    """The steps themselves bring the row up to date, and no point goes far."""
    problem, found = branches("B")
    Z, steps = found[0].at(np.array([20.5])), []
    stride = Problem.stride
    monkeypatch.setattr(
        Problem, "stride", lambda *a, **more: steps.append(1) or stride(*a, **more)
    )
    row, q = np.eye(len(Z))[:, [-1]], Z[-1, 0]

    def at_slope(q):
        return Equations(problem, [CONDITIONS["window"].equal_to(q)])

    near = solve(at_slope(q + 0.1), Z, rows=1.3 * row)
    assert (
        near.ok[0]
        and near.Z[-1, 0] == pytest.approx(q + 0.1, abs=1e-13)
        and len(steps) < 8
    )
    assert near.rows[-1, 0] == pytest.approx(1.0, abs=0.2)
    far = solve(at_slope(q + 0.7), Z, rows=1.5 * row)
    assert not far.ok[0] and far.error[0] == np.inf
    np.testing.assert_array_equal(far.Z, Z)


def test_forward_and_back_to_the_start():
    problem, found = branches("B")
    branch = found[0]
    k = int(np.argmin(np.abs(branch.q - np.log(0.02))))
    start = branch.Z[:, [k]]
    ((_, up),) = follow(problem, start)
    there = correct(problem, up.Z[:, [-3]], None)
    ((down, _),) = follow(problem, there.Z)
    # Come back to the start's slope exactly and compare.
    nearest = int(np.argmin(np.abs(down.Z[-1] - branch.q[k])))
    Z, along = down.Z[:, nearest], down.tangent[:, nearest] / down.tangent[-1, nearest]
    guess = np.append((Z + along * (branch.q[k] - Z[-1]))[:-1], branch.q[k])
    back = correct(problem, guess[:, None], None)
    np.testing.assert_allclose(
        back.Z[: problem.m, 0], start[: problem.m, 0], rtol=2e-14
    )


def test_the_polynomials_lead_newton_to_rounding():
    problem, found = branches("F")
    rng = np.random.default_rng(1)
    for branch in found:
        q = rng.uniform(np.log(1e-3), np.log(0.2), 50)
        ((index, Z, _),) = branch.guesses(q)
        w = Z[:-1]
        before, _ = problem.stride(w, q[index])
        assert np.abs(before.newton / before.y).max() < 2e-12


def test_a_bracketed_root_is_found_as_scipy_finds_it():
    for function, a, b in (
        (lambda x: np.cos(x) - x, 0.0, 1.0),
        (lambda x: x**3 - 2, 0.0, 5.0),
        (lambda x: np.exp(-30 * x) - 0.3, 2.0, -1.0),
        (lambda x: x, -1.0, 0.0),
    ):
        asked = Mock(side_effect=function)
        found = bracketed_root(asked, a, b)
        np.testing.assert_allclose(
            found, brentq(function, a, b, xtol=1e-300, rtol=9e-16), rtol=5e-16
        )
        assert asked.call_count <= 15
    with pytest.raises(ValueError, match="no change of sign"):
        bracketed_root(lambda x: x * x + 1, -1.0, 1.0)


def tangential(problem, y, time, slope):
    """Slope at which a straight-legged gait's heelstrike is tangential, by Newton in
    long double.
    """
    exact = extended_precision._extended_step_map(problem.structure, 0)
    constants = lump(problem.walker, np.longdouble)
    fixed = [np.longdouble(1.0), *(constants[k] for k in problem.structure.constants)]

    def equations(U):
        residual, impact = exact(
            U[:-2], U[-2:-1], np.array([U[-1], *fixed], np.longdouble)
        )
        return np.append(residual, impact.sum())

    U = np.array([*y, time, slope], np.longdouble)
    h = np.longdouble(1e-7)
    for _ in range(8):
        columns = [
            (equations(U + h * e) - equations(U - h * e)) / (2 * h)
            for e in np.eye(len(U))
        ]
        step = np.linalg.solve(np.array(columns, float).T, -equations(U).astype(float))
        U = U + step
    assert np.abs(step).max() < 1e-18
    return U[-1]


@pytest.mark.parametrize(
    ("name", "overrides"), [("physical-straight", {}), ("A", {"detuning": 0.95})]
)
def test_a_tangential_end_agrees_with_long_double_within_its_bound(name, overrides):
    problem, found = branches(name, **overrides)
    branch = next(b for b in found if "end_tangential_heelstrike" in b.why)
    end = next(
        p
        for p in special_points(problem, branch)
        if p["kind"] == "end_tangential_heelstrike"
    )
    w = branch.Z[:-1, branch.why.index("end_tangential_heelstrike") * -1]
    angle = np.exp(w[0])
    exact = tangential(problem, [angle, *angle * w[1:-1]], w[-1], end["slope"])
    assert abs(float(end["slope"] / exact - 1)) < end["error_bound"] < 1e-12


@pytest.mark.parametrize(
    ("detuning", "ends"),
    [
        # On either side of where two branches touch, at detuning 0.723863604 and slope
        # 0.100186864 (claim T6).
        (
            0.72386,
            [
                ("kneestrike_at_heelstrike", "kneestrike_at_heelstrike"),
                ("tangential_heelstrike", "window"),
            ],
        ),
        (
            0.7239,
            [
                ("kneestrike_at_heelstrike", "tangential_heelstrike"),
                ("kneestrike_at_heelstrike", "window"),
            ],
        ),
    ],
)
def test_no_branch_jumps_to_one_it_almost_touches(detuning, ends):
    _, found = branches("C", detuning=detuning)
    why = [
        tuple(
            sorted(end.replace("end of the ", "").removeprefix("end_") for end in b.why)
        )
        for b in found
    ]
    assert sorted(why) == ends


def test_a_branch_ends_where_the_stance_leg_comes_to_stand_still():
    first = survey(Problem(replace(CATALOGUE["B"], R=0.3533, m_s=1.0)))[0]
    assert first.why[1] == "end_fall"
    # There the period diverges with the logarithm of the slope's distance; rounding
    # must not split segments for ever.
    assert first.Z[-2, -1] == pytest.approx(LONGEST_PERIOD, abs=1e-11)
    assert len(first.q) < 800


def unknown(index):
    return np.full(len(index), UNKNOWN)


#: A walker near C of which a kneestrike turns tangential.
LATE_KNEE = {
    **{
        "m_t": 2.224896846218005,
        "m_s": 0.8013614687927322,
        "r_t": 0.21641419552219643,
        "r_s": 0.08585627546332361,
    },
    **{
        "c_t": 0.0799433695653307,
        "c_s": 0.20938159715559101,
        "R": 0.1620871366377472,
        "eps_T": 0.11484503222140877,
    },
    **{"l_t": 0.3464294621359108, "l_s": 0.4085395947448572},
}


@pytest.mark.parametrize(
    ("name", "overrides", "strike"),
    [
        ("physical-straight", {}, "heelstrike"),
        ("physical", {}, "heelstrike"),
        ("C", {"detuning": 0.1}, "heelstrike"),
        ("C", LATE_KNEE, "kneestrike"),
    ],
)
def test_bounds_hold_as_near_a_tangential_end_as_its_slope_is_known(
    name, overrides, strike
):
    problem, found = branches(name, **overrides)
    branch, side = next(
        (b, b.why.index(why))
        for b in found
        if (why := f"end_tangential_{strike}") in b.why
    )
    q, inwards = branch.q[-side], np.sign(branch.q[1 - 3 * side] - branch.q[-side])
    slope = np.exp(q) * (1 + inwards * np.geomspace(1e-12, 1e-2, 21))
    rows = []
    for index, Z, segment in branch.guesses(np.log(slope)):
        near = np.abs(segment - side * len(branch.q)) < 40
        if not near.any():
            continue
        guesses = branch.known_guesses(Z[:, near], segment[near], slope[index][near])
        rows += compared(problem, replace(guesses, leg_passes=unknown(guesses.slope)))
    assert len(rows) == 21
    assert all(error < bound < 1e-11 for _, bound, error, _, _ in rows)


def test_points_converge_up_to_a_fall():
    """The step before it amplifies its start 1e10 times: beside the end doubles alone
    resolve no gait.
    """
    problem, found = branches("C", detuning=1.2694457027163444)
    (branch,) = [b for b in found if "end_fall" in b.why]
    side = branch.why.index("end_fall")
    inwards = np.sign(branch.q[1 - 3 * side] - branch.q[-side])
    slope = np.exp(branch.q[-side]) * (1 + inwards * np.geomspace(1e-12, 1e-3, 7))
    lone = [
        (Z, segment, i)
        for i, Z, segment in branch.guesses(np.log(slope))
        if segment.max() > len(branch.q) - 9
    ]
    ((Z, segment, index),) = lone if side else lone[:1]
    at = settle(problem, branch.known_guesses(Z, segment, slope[index]))
    assert (
        at.converged.all()
        and at.step.all()
        and (at.bound < 1e-9).all()
        and len(index) == 7
    )
    assert (at.times[-1] > 11.5).any() and at.doubles.max() > 1e-6


def test_an_earlier_strike_before_heelstrike_turns_tangential_is_the_end():
    """At slope 0.0061 the foot grazes the ground shortly before the strike that turns
    tangential at 0.00609.
    """
    _, found = branches("C", detuning=0.13642725891485585)
    (branch,) = [b for b in found if "end_earlier_strike" in b.why]
    end = np.exp(branch.q[0])
    assert branch.why[0] == "end_earlier_strike" and end == pytest.approx(
        0.0061531, rel=1e-4
    )
    out = solved(
        "C",
        [0.0061, end * (1 - 1e-6), end * (1 + 1e-6), 0.0065],
        detuning=0.13642725891485585,
    )
    np.testing.assert_array_equal(
        out["status"][:, GAITS.index("short")] == 0, [False, False, True, True]
    )
    assert not np.isin(out["status"], [STATUSES["not_converged"]]).any()


def test_a_singular_derivative_ends_no_survey():
    """Heelstrike turns tangential between two nodes, where the map's derivative is one
    column to the last digit.
    """
    (branch,) = survey(
        Problem(
            Walker(
                l_t=0.4076273331582905,
                w_t=0.09347589723409368,
                m_t=0.036760265359138074,
                r_t=0.11703360199179433,
                c_t=0.21177644858915898,
                l_s=0.5923726668417095,
                w_s=-0.08270528673840194,
                m_s=0.019289748290847984,
                r_s=0.16422574634352305,
                c_s=-0.12107330029517688,
                R=0.48477183884406094,
                eps_T=-0.12415307211285737,
                m_h=0.031433349548861844,
                g=1.0,
                knees=False,
            )
        )
    )
    assert set(branch.why) == {"end_fall", "end_tangential_heelstrike"}


def test_a_folds_bound_holds_in_other_units():
    """Lengths in other units round everything anew and change no slope."""
    lengths = ("l_t", "w_t", "r_t", "c_t", "l_s", "w_s", "r_s", "c_s", "R")
    walker, slopes = CATALOGUE["physical-straight"], []
    for unit in (1.0, 3.0, 0.7):
        problem = Problem(
            replace(walker, **{key: unit * getattr(walker, key) for key in lengths})
        )
        (fold,) = pick(
            [p for b in survey(problem) for p in special_points(problem, b)], "fold"
        )
        slopes.append(fold["slope"])
    assert np.ptp(slopes) / slopes[0] < fold["error_bound"] < 3e-14


def test_nodes_that_do_not_lie_along_a_branch_are_removed():
    _, found = branches("C")
    branch = found[0]
    assert branch.in_order(branch.Z[:, 0]) is branch
    Z = branch.Z.copy()
    k = len(branch.q) // 3
    Z[:, k] += 2 * (Z[:, k - 1] - Z[:, k])  # beyond its neighbour
    for start in (Z[:, 0], Z[:, -1], Z[:, 0] + 1e-12):
        mended = replace(branch, Z=Z).in_order(start)
        assert len(mended.q) == len(branch.q) - 1 and mended.in_order(start) is mended
    # Seen from one end this node does not lie along the branch, from the other and from
    # itself its neighbour does not.
    for start, without in ((0, k), (-1, k - 1), (k, k - 1)):
        np.testing.assert_array_equal(
            replace(branch, Z=Z).in_order(Z[:, start]).Z, np.delete(Z, without, axis=1)
        )


def test_a_gait_without_neighbours_does_not_decide_what_remains_of_its_branch():
    branch = branches("D")[1][0]
    n, k = len(branch.q), len(branch.q) // 3
    for start, cuts, nodes in (
        (k, [k - 2, k], range(k - 1)),
        (1, [1], range(2, n)),
        (k, [k - 3, k], range(k - 2, k + 1)),
    ):
        np.testing.assert_array_equal(
            branch.part_of(branch.Z[:, start], np.array(cuts)).Z,
            branch.Z[:, list(nodes)],
        )
    # A tangent at right angles to the branch.
    tangent = branch.tangent.copy()
    tangent[:, k] = (
        np.eye(len(tangent))[0] - branch.direction[0, k] * branch.direction[:, k]
    )
    assert len(replace(branch, tangent=tangent).in_order(branch.Z[:, k]).q) == n - 1


def test_of_a_branch_that_jumps_to_another_only_one_part_is_kept():
    """The long gait and the short one, whose orientation determinants differ in sign."""
    problem, found = branches("D")
    turned = [
        {"Z": b.Z[:, ::-1], "tangent": -b.tangent[:, ::-1], "why": b.why[::-1]}
        for b in found
    ]
    up = [
        b if b.q[0] < b.q[-1] else replace(b, **other)
        for b, other in zip(found, turned, strict=True)
    ]
    long, short = (
        b.part(np.flatnonzero((b.q > np.log(1e-4)) & (b.q < np.log(0.01)))) for b in up
    )
    k = len(long.q) // 3
    before, after = np.arange(k + 1), np.flatnonzero(short.q > long.q[k])
    Z = np.hstack([long.Z[:, before], short.Z[:, after]])
    tangent = np.hstack([long.tangent[:, before], short.tangent[:, after]])
    joined = Branch(problem.m, Z, tangent, np.zeros(len(Z.T)), ("", ""))
    for start, part in (
        (long.Z[:, k], long.Z[:, before]),
        (short.Z[:, after[0]], short.Z[:, after]),
    ):
        kept = run(problem, without_jumps(joined, start))
        np.testing.assert_array_equal(kept.Z, part)
        assert "no further point" in kept.why
    whole = run(problem, without_jumps(up[0], up[0].Z[:, 0]))
    assert whole is up[0]


def test_a_step_to_another_root_of_a_guard_is_refused():
    """Beyond slope 0.0146 the gait goes on; the time of kneestrike used to jump to a
    root before the step began.
    """
    found = survey(Problem(random_walker("kneed, near", 306)), COARSE)
    (end,) = [
        np.exp(b.q[0])
        for b in found
        if b.why == ("end_tangential_kneestrike", "end_kneestrike_at_heelstrike")
    ]
    assert end == pytest.approx(0.014628, abs=1e-6)


@pytest.mark.parametrize("distance", [1e-4, 1e-7, 1e-10])
@pytest.mark.parametrize("name", ["physical", "physical-straight"])
def test_a_coarse_atlas_tells_gaits_beside_a_fold_apart(name, distance):
    problem, fine = branches(name)
    folds = [b.q[first] for b in fine for first in b.turns()]
    for branch in survey(problem, COARSE):
        for q in folds:
            for side in (-1, 1):
                at = np.array([q + side * distance])
                gaits = [
                    settle(problem, branch.known_guesses(Z, s, np.exp(at)))
                    for _, Z, s in branch.guesses(at)
                ]
                assert all(gait.converged.all() for gait in gaits)
                angles = np.sort(
                    [float(gait.y[0, 0] * gait.scale[0]) for gait in gaits]
                )
                assert (np.diff(angles) > 1e-7 * angles[1:]).all()
