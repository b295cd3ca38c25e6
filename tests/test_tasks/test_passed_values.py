"""Where curves of gaits pass values: of gaits of several steps, and beside samples that
have no value.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitsweep.tasks.branches.conditions import Condition
from gaitsweep.tasks.measures.passed import Curve, Sampled
from gaitsweep.tasks.studies.solve_at_value import solve_at_value
from gaitsweep.tasks.studies.solve_points import atlas, points
from lines import branches

SLOW = pytest.mark.thorough


@pytest.mark.parametrize(
    ("steps", "measure", "value", "window"),
    [
        (
            2,
            "speed",
            0.128,
            (0.0152, 0.03),
        ),
        pytest.param(
            2,
            "friction_demand",
            0.3,
            (0.0152, 0.03),
            marks=SLOW,
        ),
        pytest.param(
            4,
            "stance_angle",
            0.236,
            (0.0101, 0.0211),
            marks=SLOW,
        ),
        pytest.param(
            4,
            "speed",
            0.116,
            (0.0101, 0.0211),
            marks=SLOW,
        ),
    ],
)
def test_gaits_of_several_steps_at_a_value_are_those_of_a_dense_grid(
    steps, measure, value, window
):
    slope = np.linspace(*window, 120)
    expected = crossings_on_pieces(measure, value, slope, steps)

    asked = {
        "walker": "D",
        "measure": measure,
        "value": value,
        "between": window,
        "steps": steps,
    }
    found = solve_at_value(asked)["gaits"]

    slopes = [gait["slope"] for gait in found]
    assert expected
    assert slopes == pytest.approx(expected, rel=1e-4)
    for gait in found:
        assert gait[measure] == pytest.approx(value, rel=1e-11)
        assert gait["error_bound"] < 1e-12


def crossings_on_pieces(measure, value, slope, steps):
    """Slopes at which gaits of D of some steps pass a value, by linear interpolation on
    each piece of their branches.
    """
    line = {"walker": "D", "set": {}}
    request = {
        "line": line,
        "slope": slope,
        "want": (measure,),
        "steps": steps,
    }
    branches_of_steps = atlas({"line": line, "steps": steps}, [])
    grid = points(request, [branches_of_steps])
    is_gait = grid["status"] == 0
    pieces = grid["branch"] * 100 + grid["piece"]

    found = []
    for piece in np.unique(pieces[is_gait]).tolist():
        row, gait = np.nonzero((pieces == piece) & is_gait)
        off = grid[measure][row, gait] - value
        found += roots(slope[row], off)
    return sorted(found)


def roots(x, y):
    """Where a function with values at places passes 0, by linear interpolation."""
    found = []
    for k in np.flatnonzero(y[1:] * y[:-1] < 0).tolist():
        share = y[k] / (y[k] - y[k + 1])
        root = x[k] + share * (x[k + 1] - x[k])
        found.append(float(root))
    return found


@pytest.mark.parametrize("side", [1, -1])
def test_a_value_is_found_at_a_sample_beside_which_there_is_none(side):
    """A fall to a value at the last sample that has one was no passing."""
    problem, (branch, *_) = branches("D")
    node = len(branch.q) // 2
    q = float(branch.q[node])

    def falling(there):
        off = side * (q - there.q)
        off[np.abs(off) < 1e-12] = 0.0
        return np.where(off < -1e-6, np.nan, off)

    curve = Curve.of_branch(problem, branch).between(node - 3, node + 3)
    passed = Sampled.of(curve, Condition("level", falling)).passes_target()

    assert passed.X[-1] == pytest.approx([q], abs=1e-9)


def test_values_on_either_side_of_a_gap_without_any_are_no_passing():
    problem, (branch, *_) = branches("D")
    node = len(branch.q) // 2
    low, high = branch.q[[node - 1, node + 1]]

    def jumping(there):
        inside = (there.q - low) * (there.q - high) <= 0
        return np.where(inside, np.nan, np.sign(there.q - branch.q[node]))

    curve = Curve.of_branch(problem, branch).between(node - 3, node + 3)
    passed = Sampled.of(curve, Condition("level", jumping)).passes_target()

    assert not passed.X.size


def test_a_curve_without_any_value_passes_none():
    problem, (branch, *_) = branches("D")

    def nowhere(there):
        return np.full(len(there.q), np.nan)

    curve = Curve.of_branch(problem, branch)
    passed = Sampled.of(curve, Condition("level", nowhere)).passes_target()

    assert not passed.X.size


def test_an_end_is_compared_with_values_beside_it_and_not_with_the_largest():
    """A measure that grows without bound somewhere else makes no value its end's."""
    problem, (branch, *_) = branches("D")
    node = len(branch.q) // 2

    def growing(there):
        return np.where(there.q < branch.q[node - 2], -1e15, there.q)

    curve = Curve.of_branch(problem, branch).between(node - 3, node + 3)
    beyond = float(branch.q[node + 3]) + 1e-3
    passed = Sampled.of(curve, Condition("level", growing)).passes(np.array([beyond]))

    assert not passed.X.size


@pytest.mark.parametrize("place", [0.0, 0.6])
def test_a_gait_to_which_a_curve_returns_is_found_once(place):
    """As a closed curve does where it ends; here it comes back along its way, and has
    the value at another gait in between.
    """
    problem, (branch, *_) = branches("D")
    node = len(branch.q) // 2
    forth = Curve.of_branch(problem, branch).between(node - 3, node + 3)
    first, other = forth.at(np.array([place, 2.4]))[-1]

    def there_and_back(places):
        return forth.at(3.0 - np.abs(3.0 - places))

    def product(there):
        return (there.q - first) * (there.q - other)

    curve = replace(forth, nodes=7, at=there_and_back)
    passed = Sampled.of(curve, Condition("level", product)).passes_target()

    assert passed.X[-1] == pytest.approx([first, other], abs=1e-9)
