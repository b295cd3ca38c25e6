"""Equations as objects: what a few lines on them do, against other roads; and what they
refuse.
"""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import gaitsweep.tasks
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.curves import follow_both_directions
from gaitsweep.tasks.branches.equations import (
    Equations,
    Keys,
    correct_on_curve,
    sensitivity,
    solve,
)
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract.kinds import FOLLOWED, KINDS, kind_of
from gaitsweep.tasks.measures.levels import level
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import branches


def keys_of(walker, **ranges):
    def walker_at(*values):
        return resolve(walker, dict(zip(ranges, values, strict=True)))

    low, high = zip(*ranges.values(), strict=True)
    middle = tuple(0.45 * a + 0.55 * b for a, b in ranges.values())
    return Keys(tuple(ranges), walker_at, low, high, middle)


def points_of(walker, kind, **keys):
    problem, found = branches(walker, **keys)
    every = [point for branch in found for point in special_points(problem, branch)]
    of_kind = [point for point in every if point["kind"] == kind]
    return sorted(of_kind, key=lambda point: point["slope"])


def test_a_gait_of_a_given_speed_is_one_condition():
    problem, found = branches("A")
    branch, wanted = found[0], 0.2

    speed = CONDITIONS["speed"].equal_to(np.log(wanted))
    nearest = np.abs(speed.residual(Equations(problem).evaluate(branch.Z))).argmin()

    gait = solve(Equations(problem, [speed]), branch.Z[:, [nearest]])

    angle = np.exp(gait.Z[0, 0])
    period = gait.Z[-2, 0]

    walker = problem.walker
    foot = walker.R / walker.leg
    step = 2 * walker.leg * ((1 - foot) * np.sin(angle) + foot * angle)
    assert gait.ok[0]
    assert step / (period * walker.time_unit) == pytest.approx(wanted, rel=1e-12)


def test_folds_at_a_fixed_slope_are_a_curve_over_two_keys():
    keys = keys_of("A", detuning=(0.2, 0.9), m_h=(0.05, 0.55))
    fold, *_ = points_of("A", "fold", detuning=0.8, m_h=0.1)
    folds = Equations(keys, [CONDITIONS["fold"]], slope=fold["slope"])
    start = np.append(fold["Z"][:-1], np.array([0.8, 0.1]) / keys.scale)[:, None]
    first = correct_on_curve(folds, start, np.eye(len(start))[:, [-1]])
    window = np.array([keys.low, keys.high]).T / keys.scale[:, None]

    points, _, stopped = follow_both_directions(folds, first, window)

    assert stopped == ("border", "border")
    assert np.ptp(points[:, -2]) > 0.05

    for X in points[[0, -1]]:
        values = dict(zip(keys.names, keys.values(X[-2:, None])[:, 0], strict=True))
        slopes = [point["slope"] for point in points_of("A", "fold", **values)]

        assert min(slopes) == pytest.approx(fold["slope"], rel=1e-9)


def test_how_a_flip_moves_with_keys_is_what_located_flips_show():
    keys = keys_of("A", m_h=(0.3, 0.7), detuning=(0.2, 0.4))
    flip, *_ = points_of("A", "flip", m_h=0.5, detuning=0.3)
    at = np.append(flip["Z"], np.array([0.5, 0.3]) / keys.scale)

    by_keys = sensitivity(Equations(keys, [CONDITIONS["flip"]]), at)[-1]

    h = 1e-4
    for number, moved in enumerate(({"m_h": h}, {"detuning": h})):
        ends = []
        for sign in (1, -1):
            values = {"m_h": 0.5, "detuning": 0.3}
            values |= {key: values[key] + sign * step for key, step in moved.items()}
            there, *_ = points_of("A", "flip", **values)
            ends.append(np.log(there["slope"]))
        assert by_keys[number] == pytest.approx((ends[0] - ends[1]) / (2 * h), rel=1e-5)


@pytest.mark.parametrize("kind", ["window", "speed"])
def test_formulas_of_derivatives_are_what_differences_show(kind):
    problem, found = branches("physical")
    Z, condition, h = found[0].Z[:, 5::20], CONDITIONS[kind], 1e-6
    equations = Equations(problem)
    by_formula = condition.by_Z(equations.evaluate(Z))
    for i, unit in enumerate(np.eye(len(Z))):
        move = h * unit[:, None]
        more, less = (
            condition.residual(equations.evaluate(Z + sign * move)) for sign in (1, -1)
        )
        np.testing.assert_allclose(by_formula[i], (more - less) / (2 * h), atol=1e-8)


def test_two_conditions_fix_a_special_point_in_slope_and_a_key():
    """A flip at a given slope: the key that has it."""
    keys = keys_of("A", detuning=(0.2, 0.4))
    flip, *_ = points_of("A", "flip", detuning=0.3)
    wanted = np.log(flip["slope"]) + 0.02
    conditions = [CONDITIONS["flip"], CONDITIONS["window"].equal_to(wanted)]
    guess = np.append(flip["Z"], 0.3 / keys.scale)[:, None]

    found = solve(Equations(keys, conditions), guess)

    (value,) = keys.values(found.Z[-1:])[0]
    there, *_ = points_of("A", "flip", detuning=value)
    assert found.ok[0] and abs(value - 0.3) > 1e-3
    assert there["slope"] == pytest.approx(np.exp(wanted), rel=1e-10)


def test_a_point_that_no_branch_has_is_not_found_and_the_guess_is_kept():
    problem, found = branches("A")
    Z = found[0].Z[:, [len(found[0].q) // 2]]
    faster = CONDITIONS["speed"].equal_to(np.log(50.0))
    missed = solve(Equations(problem, [faster]), Z)
    assert not missed.ok[0] and missed.error[0] == np.inf
    np.testing.assert_array_equal(missed.Z, Z)
    nowhere = solve(Equations(problem, [CONDITIONS["flip"]]), np.full_like(Z, 0.3))
    assert not nowhere.ok[0]


def test_measures_change_with_a_key_at_the_end_of_its_range_as_within_a_wider_one():
    """Beyond the end the walker itself is continued, not only its equations of motion:
    the loss of a heelstrike is that of its masses.
    """
    problem, (branch, *_) = branches("B")
    own, Z = problem.walker.m_s, branch.Z[:, [len(branch.q) // 2]]
    loss = level("loss_normal", 0.01)

    def by_key(low, high):
        keys = keys_of("B", m_s=(low, high))
        X = np.vstack([Z, own / keys.scale])

        system = Equations(keys, [loss]).at(X)

        return system.derivative[-1, -1, 0] / keys.scale[0]

    within = by_key(0.5 * own, 1.5 * own)

    assert by_key(own, 1.5 * own) == pytest.approx(within, rel=1e-3)
    assert by_key(0.5 * own, own) == pytest.approx(within, rel=1e-3)


def test_where_there_is_no_walker_a_lane_is_lost_and_its_neighbour_is_not():
    def walker_at(value):
        if value > 0.35:
            raise WalkerError("detuning", value, "is too large here")
        return resolve("A", {"detuning": value})

    keys = Keys(("detuning",), walker_at, (0.2,), (0.4,), (0.31,))
    flip, *_ = points_of("A", "flip", detuning=0.3)
    both = np.tile(np.append(flip["Z"], 0.3)[:, None], 2)
    both[-1] = np.array([0.3, 0.38]) / keys.scale
    across = np.tile(np.eye(len(both))[:, [-1]], 2)
    found = correct_on_curve(Equations(keys, [CONDITIONS["flip"]]), both, across)
    assert found.ok.tolist() == [True, False]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda p: Equations(p, [CONDITIONS["flip"], CONDITIONS["fold"]]),
            "2 conditions (flip, fold) need as many free unknowns; there are 1",
        ),
        (
            lambda p: Equations(p, [CONDITIONS["flip"]], slope=0.01),
            "1 conditions (flip) need as many free unknowns; there are 0",
        ),
        (
            lambda p: Equations(
                keys_of("A", R=(0.1, 0.2)),
                [CONDITIONS["speed"].equal_to(v) for v in (-1.0, -2.0)],
            ),
            "condition `speed` stands twice; one would do",
        ),
        (
            lambda p: Equations(
                keys_of("A", R=(0.1, 0.2)), [CONDITIONS["window"]], slope=0.1
            ),
            "the slope is fixed; condition `window` sets it too",
        ),
        (
            lambda p: solve(Equations(p), np.zeros((5, 1))),
            "1 unknowns are free and 0 conditions given; solving takes one for each",
        ),
        (
            lambda p: Keys((), resolve, (), (), ()),
            "keys must be named, each once; got ()",
        ),
        (
            lambda p: keys_of("A", R=(0.2, 0.1)),
            "range of `R` must rise; got 0.2 to 0.1",
        ),
    ],
)
def test_what_cannot_be_solved_is_refused_in_a_line(make, message):
    with pytest.raises(ValueError, match="^" + re.escape(message)):
        make(Problem(resolve("A")))


def test_every_condition_is_of_a_kind_and_each_followed_kind_has_one():
    assert set(CONDITIONS) <= set(KINDS)
    assert set(FOLLOWED) <= set(CONDITIONS)
    for name, kind in KINDS.items():
        assert kind.meaning, name
        assert set(kind.undefined) <= set(CONDITIONS), name
        # Where gaits end that have an equation, one side of it is that of steps.
        if name in CONDITIONS:
            assert (CONDITIONS[name].walking != 0) == bool(kind.ends), name


def _names_compared(file):
    """Lines of a module that compare something with the name of a kind of points."""
    source = file.read_text(encoding="utf-8")
    if not any(f'"{name}"' in source for name in KINDS):
        return

    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Compare):
            continue

        sides = [node.left, *node.comparators]
        texts = {
            part.value
            for side in sides
            if not isinstance(side, ast.Subscript)
            for part in ast.walk(side)
            if isinstance(part, ast.Constant)
        }
        if texts & set(KINDS):
            yield f"{file.name}:{node.lineno}"


def test_what_follows_from_the_name_of_a_kind_stands_in_the_table():
    """Claims of the paper are about points of some kinds; the solver asks the table."""
    tasks = Path(gaitsweep.tasks.__file__).parent
    solver = {*tasks.rglob("*.py")} - {*(tasks / "ledger").rglob("*.py")}
    found = [place for file in solver for place in _names_compared(file)]
    assert len(solver) > 150 and len(found) <= 5, found


def test_a_reason_of_a_branch_that_is_no_kind_has_no_consequences():
    reason = kind_of("no further point")
    assert not (reason.turns_slope or reason.is_crossing or reason.ends)
    assert kind_of("branch_point").turns_slope
