"""Points of a branch chosen to a tolerance: the same figure from far fewer points."""

import numpy as np
import pytest

from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.parse import parse
from gaitsweep.tasks.branches.atlas import to_arrays
from gaitsweep.tasks.branches.sampling import apart, chosen, plane
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.mechanics.kernel import flow
from gaitsweep.tasks.studies.follow_branches import _dense, branch
from lines import branches


def figure_error(truth, points):
    """Greatest distance of a curve's points from a polyline, each looked for among the
    lines nearby.
    """
    worst = 0.0
    nearest = np.array([np.linalg.norm(points - t, axis=1).argmin() for t in truth])
    for t, k in zip(truth, nearest, strict=True):
        lines = [(i, i + 1) for i in range(max(0, k - 2), min(len(points) - 1, k + 2))]
        worst = max(
            worst, min(apart(t[None], points[i], points[j])[0] for i, j in lines)
        )
    return worst


def drawn(problem, Z):
    """What is drawn: ln slope, ln angle, ln period and the spectral radius, its
    logarithm where it is large.
    """
    stride, _ = problem.stride(Z[:-1], Z[-1])
    radius = np.nan_to_num(
        np.abs(multipliers(stride.jacobian, problem.m)).max(axis=1), nan=1e9
    )
    shown = np.where(radius < 1, radius, 1 + np.log(np.maximum(radius, 1)))
    return np.column_stack([plane(Z), shown])


def uniform(found, low, high, n):
    """Points of a branch at equally spaced slopes, in its order, as a grid's figure
    joins them.
    """
    points, places = [], []
    for _, Z, segment in found.guesses(np.log(np.linspace(low, high, n))):
        at = Z[found.axis[segment], np.arange(len(segment))]
        a, b = found.ends_of(segment)
        points.append(Z)
        places.append(segment + (at - a) / (b - a))
    return np.hstack(points)[:, np.argsort(np.concatenate(places))]


@pytest.mark.parametrize(
    ("walker", "low", "high", "tolerance"),
    [
        ("D", 1e-4, 0.1, 1e-3),
        ("E", 1e-4, 0.2, 1e-4),
        ("physical-straight", 0.012, 0.05, 1e-3),
    ],
)
def test_the_same_figure_from_a_fifth_of_a_uniform_grid_s_points(
    walker, low, high, tolerance
):
    problem, found = branches(walker)
    for one in found:
        Z = chosen(problem, one, low, high, tolerance)
        if not Z.shape[1]:
            continue
        truth = drawn(problem, _dense(problem, one, low, high, 3000))
        adaptive = figure_error(truth, drawn(problem, Z))
        # At a corner of the radius, the tolerance along the branch and that across.
        assert adaptive < 2 * tolerance
        grid = uniform(one, low, high, 5 * Z.shape[1])
        if grid.shape[1] < 4:
            continue
        # A grid of five times the points has the greater error still; its folds and
        # ends it misses altogether.
        assert figure_error(truth, drawn(problem, grid)) > adaptive


def test_a_change_of_stability_lies_between_near_points():
    problem, found = branches("D")
    (long,) = [b for b in found if b.ratio[np.abs(b.q - np.log(0.01)).argmin()] < 0.5]
    Z = chosen(problem, long, 1e-3, 0.1, 1e-3)
    stride, _ = problem.stride(Z[:-1], Z[-1])
    stable = np.abs(multipliers(stride.jacobian, 2)).max(axis=1) < 1
    (turn,) = np.nonzero(np.diff(stable))[0]
    slopes = np.sort(np.exp(Z[-1, turn : turn + 2]))
    assert slopes[0] <= 0.015088437941119464 <= slopes[1]
    assert np.log(slopes[1] / slopes[0]) <= 1e-3


def test_the_choice_is_the_atlas_s_alone_and_flies_little():
    problem, found = branches("E")
    line = {
        "line": {"walker": "E", "set": {}},
        "slope_from": 1e-4,
        "slope_to": 0.1,
        "adaptive": 1e-3,
    }
    first = branch(line, [to_arrays(found)])
    counter = flow(problem.structure, 2, False)
    counter.evaluations = 0
    again = branch(line, [to_arrays(found)])
    for name, values in first.items():
        assert values.tobytes() == again[name].tobytes()
    # Each point's own stride, its radius and one between any two, the special points
    # besides.
    assert counter.evaluations < 4 * len(first["branches/slope"]) + 300


def table(slope, **more):
    return {
        "name": "one",
        "kind": "branch",
        "walker": "E",
        "axes": {"slope": slope},
        **more,
    }


def test_a_study_may_ask_for_a_tolerance(tmp_path):
    study = parse(
        table({"from": 0.01, "to": 0.1, "adaptive": 1e-3}), "", tmp_path / "one.toml"
    )
    assert study.options["adaptive"] == 1e-3
    assert study.values_along.tolist() == [0.01, 0.1]


@pytest.mark.parametrize(
    ("slope", "more", "said"),
    [
        (
            {"from": 0.01, "to": 0.1, "adaptive": 1e-3},
            {"kind": "grid"},
            'kind "branch"',
        ),
        (
            {"from": 0.01, "to": 0.1, "adaptive": 0},
            {},
            r"must lie in \[1e-6, 0.1\]; got 0",
        ),
        ({"from": 0.01, "to": 0.1, "adaptive": "fine"}, {}, "must be a number"),
        (
            {"from": 0.01, "to": 0.1, "adaptive": 1e-3, "n": 9},
            {},
            "either `n` or `adaptive`",
        ),
        ({"to": 0.1, "adaptive": 1e-3}, {}, "`from` is missing"),
        ({"from": 0.2, "to": 0.1, "adaptive": 1e-3}, {}, "must be less than"),
    ],
)
def test_nonsense_is_refused_in_one_line(slope, more, said, tmp_path):
    with pytest.raises(StudyError, match=said) as refused:
        parse(table(slope, **more), "", tmp_path / "one.toml")
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("least", [2, 50, 1000])
def test_a_branch_has_as_many_points_as_asked_for_and_no_more_than_that_takes(least):
    problem, (one, *_) = branches("E")
    points, nodes = (_dense(problem, one, 1e-3, 0.1, n).shape[1] for n in (least, 0))
    assert least <= points <= max(nodes, 2 * least + 2)
