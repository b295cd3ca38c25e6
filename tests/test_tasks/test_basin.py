"""Basins: outcomes at known slopes, areas against finer grids, and counts of gaits."""

import numpy as np
import pytest

from lines import _atlas
from tasks.count_gaits import census, deflated, starts
from tasks.fixed_points.newton import newton
from tasks.map_basin import basin
from tasks.step.problem import Problem
from tasks.step.simulate import STRUCK, stride
from tasks.walkers.resolve import resolve


def mapped(slope, size, **options):
    line = {"walker": "D", "set": {}}
    return basin({"line": line, "slope": np.array([slope]), "size": size, **options}, [_atlas("D", ())])


def share(found, outcome):
    which = found["areas/outcome"] == outcome
    return found["areas/area"][which].sum(), found["areas/standard_error"][which].sum()


RANGE = {"stance_angle": [0.1, 0.3], "stance_rate": [-0.3, -0.1]}


def test_the_area_of_the_long_gaits_basin():
    coarse, fine = mapped(0.009, 60, **RANGE), mapped(0.009, 120, **RANGE)
    (a, a_error), (b, b_error) = share(coarse, "long"), share(fine, "long")
    assert abs(a - b) < 4 * np.hypot(a_error, b_error)
    assert b_error < a_error
    assert fine["areas/share"].sum() == pytest.approx(1.0)
    assert len(fine["basin/outcome"]) == 120**2


def test_stable_period_one_and_three_live_side_by_side():
    outcomes = set(mapped(0.0126, 60, stance_angle=[0.18, 0.3], stance_rate=[-0.3, -0.18])["areas/outcome"])
    assert {"long", "period 3", "fell forward"} <= outcomes


def test_nothing_walks_where_walking_is_lost():
    outcomes = mapped(0.022, 40, steps=2000)["areas/outcome"]
    assert all(o.startswith(("fell", "foot")) for o in outcomes)


def test_outcomes_do_not_depend_on_the_grid():
    """Cells of a grid of 40 are every third of a grid of 120 of the same range."""
    coarse, fine = mapped(0.009, 40, **RANGE), mapped(0.009, 120, **RANGE)
    at = fine["basin/outcome"].reshape(120, 120)[1::3, 1::3]
    same = np.isclose(
        fine["basin/stance_angle"].reshape(120, 120)[1::3, 1::3].ravel(), coarse["basin/stance_angle"], rtol=0, atol=0
    )
    assert np.array_equal(at.ravel()[same], coarse["basin/outcome"][same])
    assert same.any()


@pytest.mark.parametrize("name", ["D", "E"])
def test_there_are_two_gaits_that_walk_like_people(name):
    found = census({"line": {"walker": name, "set": {}}, "slope": np.array([0.005, 0.05]), "starts": 1500}, [])
    assert found["coverage/anthropomorphic"].tolist() == [2, 2]
    assert found["coverage/non_anthropomorphic"].tolist() == [0, 0]
    assert (found["census/hits"] > 1).all()
    assert (found["coverage/unseen"] < 0.1).all()


def test_deflation_leads_to_the_gait_that_plain_newton_misses():
    """One start of thirty strikes at all; plain Newton takes it to one gait of E, deflated Newton to the other."""
    found = census({"line": {"walker": "E", "set": {}}, "slope": np.array([0.01]), "starts": 30}, [])
    assert found["coverage/converged"].tolist() == [1]
    assert found["coverage/found_deflated"].tolist() == [1]
    assert sorted(found["census/hits"]) == [0, 1]
    many = census({"line": {"walker": "E", "set": {}}, "slope": np.array([0.01]), "starts": 600}, [])
    assert found["census/stance_angle"] == pytest.approx(many["census/stance_angle"], rel=1e-12)
    assert many["coverage/found_deflated"].tolist() == [0]


def test_deflated_newton_keeps_away_from_what_is_known():
    problem, slope = Problem(resolve("E")), 0.01
    y = starts(problem, slope, 600)
    flown = stride(problem, y, np.full(600, slope), exact=False)
    begin = np.vstack([np.log(y[0]), y[1:] / y[0], flown.times])[:, flown.outcome == STRUCK]
    solved = newton(problem, begin, np.full(begin.shape[1], np.log(slope)))
    w = solved.w[:, solved.converged]
    both = [w[:, k] for k in (np.argmin(w[0]), np.argmax(w[0]))]
    for mine, other in (both, both[::-1]):
        ends = deflated(problem, begin, mine[:, None], slope)
        assert ends.shape[1] > 0
        assert np.abs(ends - other[:, None]).max() < 2e-3
    assert deflated(problem, begin, np.array(both).T, slope).shape[1] == 0


def test_starts_fill_the_section():
    y = starts(Problem(resolve("C")), 0.01, 512)
    for row in (np.log(y[0]), y[1] / y[0], y[2] / y[1]):
        counts, _ = np.histogram(row, 8)
        assert counts.min() > 50
