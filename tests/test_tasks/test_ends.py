"""Points beside the ends of walking: recorded ones that failed, and the located ends
themselves.
"""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.tasks.branches import segment, settling
from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.segment import locate_root
from gaitsweep.tasks.branches.settling import settle_on_branches
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import GAITS, STATUSES
from gaitsweep.tasks.gaits import polish
from gaitsweep.tasks.gaits.polish import UNKNOWN, settle
from gaitsweep.tasks.gaits.step_check import verify_steps
from gaitsweep.tasks.measures.gaits import describe
from gaitsweep.tasks.mechanics.lumped import lump
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.lanes import join_lanes
from gaitsweep.tasks.step.verify_step import strikes_fall_in_order, verify
from gaitsweep.tasks.studies.solve_points import lines
from lines import FAILURES, branches, of_label, repeats, solved
from soak.bounds import compared

POINTS = tomllib.loads(Path(__file__).with_name("points_beside_ends.toml").read_text())


def point(name):
    asked = POINTS[name]
    return asked["walker"], asked["set"], asked["slope"], asked["gait"]


def guesses(name):
    """The branch's guess of a recorded point, with the problem."""
    walker, overrides, slope, label = point(name)
    problem, found = branches(walker, **overrides)
    angle = of_label(solved(walker, slope, **overrides), label)["stance_angle"]
    each = [
        b.known_guesses(Z, s, np.array([slope]))
        for b in found
        for _, Z, s in b.guesses(np.log([slope]))
    ]
    return problem, min(each, key=lambda g: abs(np.exp(g.w[0, 0]) - angle))


def between_nodes():
    """A gait of D between nodes: problem, branch and segment, its guess, and unknowns
    and q of the other gait.
    """
    problem, (branch, beside) = branches("D")
    segment = len(branch.q) // 2
    q = branch.q[segment : segment + 2] @ [0.3, 0.7]
    ((_, Z, at),) = [
        each for each in branch.guesses(np.array([q])) if segment in each[2]
    ]
    ((_, other, _),) = beside.guesses(np.array([q]))
    return problem, branch, at, branch.known_guesses(Z, at, np.exp([q])), other


def test_a_guess_that_newton_loses_is_located_on_its_branch():
    """If its slope lies on its segment; elsewhere it stays lost."""
    problem, branch, at, good, other = between_nodes()
    bad = replace(good, w=good.w + 2.0)
    wanted = settle(problem, good)
    assert wanted.converged.all() and not settle(problem, bad).converged.any()
    settled = settle_on_branches(problem, bad, [(problem, branch, at)])
    assert settled.converged.all()
    np.testing.assert_allclose(
        settled.y * settled.scale, wanted.y * wanted.scale, rtol=2e-15
    )
    both = [
        join_lanes([bad, good, bad]),
        [(problem, branch, np.append(at, at)), (problem, branch, at)],
    ]
    assert np.array_equal(
        settle_on_branches(problem, *both).y,
        np.hstack([settled.y, wanted.y, settled.y]),
    )
    # Newton's method leads to the other gait.
    stray = replace(good, w=other[:-1] + 1e-3)
    astray = settle(problem, stray)
    assert astray.converged.all() and abs(np.log(astray.y[0] / wanted.y[0])) > 1e-2
    np.testing.assert_array_equal(
        settle_on_branches(problem, stray, [(problem, branch, at)]).y, settled.y
    )
    away = settle_on_branches(
        problem, replace(bad, slope=3 * bad.slope), [(problem, branch, at)]
    )
    assert not away.converged.any()


def test_only_guesses_that_are_lost_are_settled_again(monkeypatch):
    problem, branch, at, good, _ = between_nodes()
    settled = []
    monkeypatch.setattr(
        settling,
        "settle",
        lambda p, g, **k: settled.append(g.w.shape[1]) or settle(p, g, **k),
    )
    guesses = join_lanes([good, replace(good, w=good.w + 2.0), good])
    assert settle_on_branches(
        problem, guesses, [(problem, branch, np.repeat(at, 3))]
    ).converged.all()
    assert settled == [3, 1]


def test_a_gait_to_which_newton_jumps_from_its_branch_has_not_converged(monkeypatch):
    problem, branch, at, good, other = between_nodes()
    gait = settle(problem, good)
    assert settling._is_near(problem, gait, good.w).all()
    for i in range(len(good.w)):
        w = good.w.copy()
        w[i] += 2e-4
        assert not settling._is_near(problem, gait, w).any()
    # It is located elsewhere, at the other gait or near it.
    for off, lies_between in (
        (0.0, Branch.lies_between),
        (1e-3, lambda *_: np.array([True])),
    ):
        stray = other + off

        def elsewhere(part, number, test, stray=stray):
            found = yield from locate_root(part, number, test)
            return replace(found, Z=stray, at=replace(found.at, Z=stray))

        monkeypatch.setattr(segment, "locate_root", elsewhere)
        monkeypatch.setattr(Branch, "lies_between", lies_between)
        guess = replace(good, w=stray[:-1] + 1e-3)
        assert settle(problem, guess).converged.all()
        assert not settle_on_branches(
            problem, guess, [(problem, branch, at)]
        ).converged.any()


@pytest.mark.parametrize("name", POINTS)
def test_a_point_beside_an_end_settles_by_both_roads(name):
    walker, overrides, slope, label = point(name)
    long_road = solved(walker, slope, **overrides)
    asked = {
        "lines": [{"walker": walker, "set": overrides}],
        "slope": np.array([slope]),
        "want": tuple(long_road),
    }
    ((_, short_road),) = lines(asked, [])
    angles = []
    for out in (long_road, short_road):
        assert not np.isin(out["status"], FAILURES).any()
        found = of_label(out, label)
        assert found["status"] == STATUSES["converged"] and found["error_bound"] < 1e-11
        angles.append((found["stance_angle"], found["error_bound"]))
    (one, bound), (other, other_bound) = angles
    assert abs(one - other) <= (bound + other_bound) * one


@pytest.mark.parametrize(
    "name", ["upright_with_the_foot_down", "tangential_strike_in_more_digits"]
)
def test_no_doubt_is_left_beside_an_end(name):
    """The foot falls as the leg is upright; the knee strikes almost tangentially:
    samples left a doubt.
    """
    problem, guess = guesses(name)
    gaits = settle(problem, guess)

    _, check = verify_steps(problem, gaits.w, np.log(guess.slope))

    assert check.step.all() and not check.doubt.any()


def test_what_samples_leave_in_doubt_has_not_converged_and_says_so(monkeypatch):
    """It counted as a step."""

    def in_doubt(*asked):
        stride, check = verify_steps(*asked)
        check.doubt[:] = True
        return stride, check

    problem, guess = guesses("upright_with_the_foot_down")
    monkeypatch.setattr(polish, "verify_steps", in_doubt)

    gaits = settle(problem, guess)
    out = describe(problem, gaits, guess.slope, ("stance_angle",))

    assert (out["status"] == STATUSES["not_converged"]).all() and np.isnan(
        out["stance_angle"]
    ).all()
    assert "was not verified" in status.reasons("", "")[out["reason"][0]]


@pytest.mark.parametrize(
    ("name", "end"),
    [
        ("late_foot_with_knee", 0.038367979989360465),
        ("upright", 0.03376239445272391),
        ("upright_with_the_foot_down", 0.18804023602452624),
    ],
)
def test_an_end_that_only_samples_show_has_the_error_of_samples(name, end):
    """Bisected by 65,536 samples of each phase; the foot dips between few, or touches
    as the leg is upright.
    """
    walker, overrides, *_ = point(name)
    problem, found = branches(walker, **overrides)
    special = [
        p
        for b in found
        for p in special_points(problem, b)
        if p["kind"] == "end_earlier_strike"
    ]
    nearest = min(special, key=lambda p: abs(np.log(p["slope"] / end)))
    assert abs(nearest["slope"] / end - 1) <= nearest["error_bound"] < 1e-5


@pytest.mark.parametrize("name", [name for name in POINTS if "fall" not in name])
def test_its_bound_holds_against_more_digits(name):
    problem, guess = guesses(name)
    ((_, bound, error, _, _),) = compared(
        problem, replace(guess, leg_passes=np.array([UNKNOWN]))
    )
    assert error <= bound < 1e-11


@pytest.mark.parametrize("name", ["before_a_fall", "before_a_fall_with_knees"])
def test_a_gait_before_a_fall_does_not_depend_on_where_newton_begins(name):
    """The step amplifies its start 1e10 times and more: no simulation from doubles can
    tell.
    """
    problem, guess = guesses(name)
    gaits = [
        settle(problem, replace(guess, w=guess.w + shift)) for shift in (0.0, 3e-14)
    ]
    assert all(gait.converged.all() and gait.doubles > 1e-3 for gait in gaits)
    one, other = (gait.y[:, 0] * gait.scale for gait in gaits)
    assert (
        np.abs(one - other) <= (gaits[0].bound + gaits[1].bound) * np.abs(one)
    ).all()


def test_derivatives_by_differences_are_those_of_the_step_map():
    problem, found = branches("physical")
    branch = found[0]
    k = len(branch.q) // 2
    w, q = branch.Z[:-1, [k]], branch.q[[k]]
    stride, scale = problem.stride(w, q)
    exact = extended_precision._extended_step_map(problem.structure, 1)
    number = exact.number
    parameters = np.array(
        [number(v) for v in problem.parameters(np.exp(q), scale)[:, 0]], dtype=number
    )
    y, times = (
        np.array([number(v) for v in values[:, 0]], dtype=number)
        for values in (stride.y, w[problem.m :])
    )
    residual, _ = exact(y, times, parameters)
    np.testing.assert_allclose(
        exact.inverse(y, times, parameters, residual),
        stride.inverse[:, :, 0],
        rtol=1e-6,
    )


def test_a_second_derivation_takes_the_same_step():
    walker, overrides, slope, label = point("upright")
    assert (
        repeats(
            walker,
            overrides,
            slope,
            of_label(solved(walker, slope, **overrides), label),
        )
        < 1e-6
    )


def test_a_foot_that_passes_the_ground_before_the_stance_leg_is_upright_does_not_strike():
    """The guard falls through zero in an interval in which the stance angle changes its
    sign, before or after it.
    """
    time = np.linspace(0, 1, 3)[:, None, None]
    for upright, strikes in ((0.35, False), (0.15, True)):
        stance, foot = upright - time, np.array([0.5, -0.5, -1.0])[:, None, None]
        phase = np.concatenate(
            [stance, foot - stance, -np.ones_like(stance), np.zeros_like(stance)],
            axis=1,
        )
        last = np.concatenate(
            [-1 - time, 2 - time, -np.ones_like(time), -np.ones_like(time)], axis=1
        )
        # The foot is on the ground at time 0.25.
        three = np.concatenate(
            [phase[:, :2], phase[:, 1:2] - 1, phase[:, 2:], phase[:, 3:]], axis=1
        )
        check = verify([three, last], np.full((2, 1), -1.0), np.array([[1.0], [2.0]]))
        assert check.step[0] == (not strikes) and check.doubt[0]


def test_strikes_at_once_are_in_order_to_rounding():
    closing = np.array([[-1.0, -1.0, -1.0, 1.0], [-1e-3, -1e-3, -1.0, -1.0]])
    times = np.array([[2.0, 2.0, 2.0, 1.0], [2.0 - 1e-11, 2.0 - 1e-8, 1.9, 2.0]])
    np.testing.assert_array_equal(
        strikes_fall_in_order(closing, times), [True, False, False, False]
    )


@pytest.mark.parametrize(
    ("off", "early", "happens"),
    [(1e-8, 1e-7, True), (1e-8, 1e-5, False), (0.0, 1e-7, False)],
)
def test_a_knee_that_rounding_delays_finds_the_foot_as_much_lower(off, early, happens):
    """Where a long step amplifies rounding, a gait was refused whose foot struck 15
    times as fast as its knee.
    """
    time = np.linspace(0, 1, 9)
    stance, foot, knee = (
        0.3 - 0.6 * time,
        4.8 * time * (1 - time),
        0.325 * time * (1 - time) + off * time,
    )
    foot[-1] -= 4.8 * early
    rates = (
        np.full(9, -0.6),
        4.8 * (1 - 2 * time) + 0.6,
        4.8 * (1 - 2 * time) + 0.6 - 0.325 * (1 - 2 * time),
    )
    three = np.array([stance, foot - stance, foot - stance - knee, *rates]).T[
        :, :, None
    ]
    two = three[-1:, [0, 1, 3, 4]] + np.zeros((9, 1, 1))
    two[:, 1, 0] += 4.8 * early * time
    check = verify(
        [three, two], np.array([[-0.325], [-4.8]]), np.array([[1.0], [1.0 - early]])
    )
    assert (check.step[0], check.leg_passes[0], check.doubt[0]) == (happens, 1, False)


def test_where_the_knee_strikes_at_once_the_end_has_the_error_that_this_leaves():
    """Nearer the end rounding decides whether the knee's guard has another root than
    that of its release.
    """
    walker, overrides, _, label = point("at_once")
    problem, found = branches(walker, **overrides)
    ends = [
        (p["slope"], p["error_bound"])
        for b in found
        for p in special_points(problem, b)
        if "kneestrike" in p["kind"]
    ]
    end, error = min(ends)
    # The knee's release without a rate, where the strike's time would vanish.
    assert abs(end / 0.13294632627479924 - 1) < error < 1e-7
    out = solved(walker, [end * (1 - 1e-9), end * (1 + 1e-9)], **overrides)
    g = GAITS.index(label)
    np.testing.assert_array_equal(
        out["status"][:, g], [STATUSES["no_gait"], STATUSES["converged"]]
    )
    assert out["kneestrike_time"][1, g] / np.sqrt(
        problem.walker.leg / 9.81
    ) == pytest.approx(2e-6, rel=0.2)


def test_of_two_ends_on_one_segment_the_first_ends_the_branch():
    walker, overrides, *_ = point("turning")
    problem, found = branches(walker, **overrides)
    (branch,) = [b for b in found if "end_tangential_kneestrike" in b.why]
    side = -branch.why.index("end_tangential_kneestrike")
    stride, _ = problem.stride(branch.Z[:-1, [side]], branch.q[[side]])
    assert abs(stride.closing[0, 0]) < 1e-6 and np.diff(branch.Z[-3:-1, side]) > 5e-3


def shorter_steps(problem, y, time, slope, ratio):
    """Slopes at which steps of ever smaller angle, y[0] = 1 in its own unit, repeat:
    Newton's method in long double.
    """
    exact = extended_precision._extended_step_map(problem.structure, 0)
    constants = lump(problem.walker, np.longdouble)
    fixed = [constants[k] for k in problem.structure.constants]
    U, slopes = np.array([*y[1:] / y[0], time, slope], np.longdouble), []
    for angle in y[0] / np.longdouble(ratio) ** np.arange(6):

        def equations(U, angle=angle):
            scaled = np.append(np.longdouble(1), U[:-2])
            residual, _ = exact(
                scaled, U[-2:-1], np.array([U[-1], angle, *fixed], np.longdouble)
            )
            return residual / np.abs(U[:-2]).max()

        h = np.longdouble(1e-9) * np.array(
            [*np.full(len(U) - 2, np.abs(U[:-2]).max()), 1.0, slope], np.longdouble
        )
        for _ in range(12):
            columns = [
                (equations(U + d) - equations(U - d)) / (2 * d.max())
                for d in np.diag(h)
            ]
            step = np.linalg.solve(
                np.array(columns, float).T, -equations(U).astype(float)
            )
            U = U + step
            if np.abs(step[-1]) < 1e-16 * slope:
                break
        slopes.append(U[-1])
        # Rates vanish with the root of the angle.
        U = np.append(U[:-2] * np.sqrt(ratio), U[-2:])
    return np.array(slopes)


@pytest.mark.parametrize(
    ("name", "overrides"), [("physical-straight", {}), ("A", {"detuning": 0.3})]
)
def test_the_slope_of_vanishing_steps_is_that_of_ever_shorter_ones(name, overrides):
    problem, found = branches(name, **overrides)
    (branch,) = [b for b in found if "end_zero_step" in b.why]
    (end,) = [
        p for p in special_points(problem, branch) if p["kind"] == "end_zero_step"
    ]
    node = branch.Z[:-1, -branch.why.index("end_zero_step")]
    angle = np.exp(node[0])
    slopes = shorter_steps(
        problem, np.array([angle, *angle * node[1:-1]]), node[-1], end["slope"], 4.0
    )
    while len(slopes) > 1:
        # Powers of the root of the angle, one after another.
        order = 7 - len(slopes)
        slopes = slopes[1:] + (slopes[1:] - slopes[:-1]) / (2**order - 1)
    assert abs(float(slopes[0] / end["slope"] - 1)) < end["error_bound"] < 1e-8
