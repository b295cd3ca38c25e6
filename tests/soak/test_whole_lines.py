"""Whole random lines: nothing is wrong with them, and whatever were wrong would be
told.
"""

from dataclasses import replace

import pytest

from soak import whole_lines as module
from soak.whole_lines import whole_lines

#: Seeds of a walker with straight legs, and of one whose special points are solved in
#: other units too.
STRAIGHT, IN_OTHER_UNITS = 5, 49
LINES = [range(k, k + 250) for k in range(0, 2500, 250)]


def named(seeds):
    return f"{seeds.start}-{seeds.stop - 1}"


@pytest.mark.parametrize(
    "seeds",
    [
        range(STRAIGHT, STRAIGHT + 1),
        *(pytest.param(each, marks=pytest.mark.soak) for each in LINES),
    ],
    ids=named,
)
def test_nothing_is_wrong_with_whole_lines(seeds, tell):
    found = whole_lines(seeds)
    tell(str(found))
    assert not found.wrong, found.wrong[:5]
    assert found.lines > 0.98 * len(seeds) and found.points == 40 * found.lines
    assert found.compared > 2 * found.lines and 0 < found.farthest_error <= 1


def test_slopes_lie_beside_folds_and_ends_at_every_distance():
    one = whole_lines([STRAIGHT])
    assert (
        one.beside >= 5 and one.points == 40 and one.branches >= 1 and not one.special
    )


def test_special_points_are_solved_in_other_units():
    found = whole_lines([IN_OTHER_UNITS])
    assert found.confirmed == found.special > 0
    assert 0 < found.farthest_special < 1e-11 and 0 < found.farthest_gait < 1e-11


def test_a_point_that_fails_is_told(monkeypatch):
    solve = module.points

    def lost(params, inputs):
        out = solve(params, inputs)
        out["status"][3, 0] = 2
        return out

    monkeypatch.setattr(module, "points", lost)
    ((what, at),) = whole_lines([STRAIGHT]).wrong
    assert what == "Converged, and verified to be a step." and at.command.startswith(
        "gaitsweep solve --walker "
    )


def test_a_bound_that_is_too_small_is_told(monkeypatch):
    original = module.hardest.__globals__["compared"]

    def too_small(problem, guesses):
        return [
            (slope, bound, 3 * bound, *rest)
            for slope, bound, _, *rest in original(problem, guesses)
        ]

    monkeypatch.setitem(module.hardest.__globals__, "compared", too_small)
    found = whole_lines([STRAIGHT])
    assert {what for what, _ in found.wrong} == {
        "true error over bound"
    } and found.farthest_error > 1


def test_special_points_and_gaits_that_change_with_units_are_told(monkeypatch):
    solve = module.solve

    def moved(equations, guess):
        found = solve(equations, guess)
        return replace(found, Z=found.Z + 1e-7)

    monkeypatch.setattr(module, "solve", moved)
    found = whole_lines([IN_OTHER_UNITS])
    assert len(found.wrong) == found.special > 0
    monkeypatch.setattr(module, "solve", solve)
    monkeypatch.setitem(module._UNITS, "angle", 1.001)
    assert "in other units" in {what for what, _ in whole_lines([IN_OTHER_UNITS]).wrong}
