"""Basins: outcomes at known slopes, areas against finer grids, and counts of gaits."""

import numpy as np
import pytest

from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.orbits.stable_manifold import saddle_at
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.simulate import STRUCK, stride
from gaitsweep.tasks.studies import count_gaits
from gaitsweep.tasks.studies.count_gaits import census, deflated, starts
from gaitsweep.tasks.studies.map_basin import basin
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas, branches, solved


def mapped(slope, size, **options):
    line = {"walker": "D", "set": {}}
    return basin(
        {"line": line, "slope": np.array([slope]), "size": size, **options},
        [_atlas("D", ())],
    )


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
    outcomes = set(
        mapped(0.0126, 60, stance_angle=[0.18, 0.3], stance_rate=[-0.3, -0.18])[
            "areas/outcome"
        ]
    )
    assert {"long", "period 3", "fell forward"} <= outcomes


def test_the_stable_manifold_of_the_short_gait_bounds_the_long_gaits_basin():
    """A. L. Schwab and M. Wisse (2001) draw the basin of the simplest walker; its edge
    is the saddle's manifold.
    """
    found = mapped(0.009, 60, **RANGE)
    points = np.array(
        [found[f"stable_manifold/{k}"] for k in ("stance_angle", "stance_rate")]
    )
    assert points.shape[1] > 100 and set(found["stable_manifold/gait"]) == {"short"}
    assert found["stable_manifold/point"].tolist() == list(range(points.shape[1]))
    problem = Problem(resolve("D", None))
    saddle = np.array(
        [found[f"fixed_points/{k}"][1] for k in ("stance_angle", "stance_rate")]
    )
    # Orbits from there pass the saddle, though the points are rounded to seven digits.
    y, nearest = points, np.full(points.shape[1], np.inf)
    for _ in range(10):
        y = stride(problem, y, np.full(y.shape[1], 0.009)).image
        nearest = np.fmin(nearest, np.linalg.norm(y - saddle[:, None], axis=0))
    assert np.median(nearest) < 1e-3 and np.mean(nearest < 6e-3) > 0.95
    # Two starts on either side of it, a millionth apart, leave the saddle in opposite
    # directions.
    left, right = (
        leaving(problem, points + sign * np.array([[1e-6], [0.0]]), saddle)
        for sign in (-1, 1)
    )
    assert np.mean(left * right < 0) > 0.95
    # It bounds the basin: beside most of it, and for the rest in layers too thin for a
    # ten-thousandth, one start walks.
    walks = [
        outlast(problem, points + sign * np.array([[1e-4], [0.0]])) for sign in (-1, 1)
    ]
    assert np.mean(walks[0] != walks[1]) > 0.75


def leaving(problem, y, saddle):
    """Deviation along the unstable direction one step after orbits are nearest to the
    saddle.
    """
    jacobian = stride(problem, saddle[:, None], np.array([0.009])).jacobian[:, :, 0]
    values, left = np.linalg.eig(jacobian.T)
    left = left[:, values.argmax()]
    deviations = []
    for _ in range(14):
        y = stride(problem, y, np.full(y.shape[1], 0.009)).image
        deviations.append(y - saddle[:, None])
    nearest = np.nanargmin(np.linalg.norm(deviations, axis=1), axis=0)
    return np.array(
        [left @ deviations[k + 1][:, i] for i, k in enumerate(nearest.tolist())]
    )


def outlast(problem, y):
    """Whether starts walk for 30 steps."""
    lanes = np.arange(n := y.shape[1])
    for _ in range(30):
        step = stride(problem, y, np.full(y.shape[1], 0.009), exact=False)
        y, lanes = step.image[:, step.outcome == STRUCK], lanes[step.outcome == STRUCK]
    return np.isin(np.arange(n), lanes)


def test_the_order_of_slopes_only_orders_the_tables():
    """Points of the manifold are counted at each slope: falling slopes raised an error."""
    slopes = np.array([0.009, 0.012])
    options = {"line": {"walker": "D", "set": {}}, "size": 20, "steps": 20}
    rising, falling = (
        basin({**options, "slope": s}, [_atlas("D", ())])
        for s in (slopes, slopes[::-1])
    )
    assert set(rising["stable_manifold/slope"]) == set(slopes)
    for name, column in rising.items():
        of_rising, of_falling = (
            out[f"{name.split('/')[0]}/slope"] for out in (rising, falling)
        )
        for s in slopes:
            np.testing.assert_array_equal(
                column[of_rising == s], falling[name][of_falling == s], name
            )


def test_a_stable_gait_has_no_manifold_that_parts_its_basin():
    problem = Problem(resolve("D", None))
    found = mapped(0.009, 8, **RANGE)
    long, short = (
        np.array(
            [found[f"fixed_points/{k}"][i] for k in ("stance_angle", "stance_rate")]
        )
        for i in (0, 1)
    )
    assert saddle_at(problem, long, 0.009) is None
    saddle = saddle_at(problem, short, 0.009)
    assert saddle.multiplier == pytest.approx(4.00386, abs=1e-4)  # of the step map
    # Along the left eigenvector a deviation grows by the multiplier, the other
    # direction does not contribute.
    jacobian = stride(problem, short[:, None], np.array([0.009])).jacobian[:, :, 0]
    np.testing.assert_allclose(
        saddle.along @ jacobian, saddle.multiplier * saddle.along, rtol=1e-6
    )
    # Beyond the flip the long gait's one multiplier outside is negative: its manifold
    # parts nothing.
    late = mapped(0.016, 8)
    y = np.array(
        [late[f"fixed_points/{k}"][0] for k in ("stance_angle", "stance_rate")]
    )
    assert saddle_at(problem, y, 0.016) is None and set(
        late["stable_manifold/gait"]
    ) <= {"short"}


def test_nothing_walks_where_walking_is_lost():
    outcomes = mapped(0.022, 40, steps=2000)["areas/outcome"]
    assert all(o.startswith(("fell", "foot")) for o in outcomes)


def test_outcomes_do_not_depend_on_the_grid():
    """Cells of a grid of 40 are every third of a grid of 120 of the same range."""
    coarse, fine = mapped(0.009, 40, **RANGE), mapped(0.009, 120, **RANGE)
    at = fine["basin/outcome"].reshape(120, 120)[1::3, 1::3]
    same = np.isclose(
        fine["basin/stance_angle"].reshape(120, 120)[1::3, 1::3].ravel(),
        coarse["basin/stance_angle"],
        rtol=0,
        atol=0,
    )
    assert np.array_equal(at.ravel()[same], coarse["basin/outcome"][same])
    assert same.any()


def test_areas_are_in_the_units_of_their_axes():
    """Of angle and rate, as the axes of the map: they were in rad^2 with rates over
    sqrt(g/leg).
    """
    found = []
    for g in (1.0, 4.0):
        line, key = {"walker": "D", "set": {"g": g}}, (("g", g),)
        params = {"line": line, "slope": np.array([0.009]), "size": 6, "steps": 3}
        found.append(basin(params, [_atlas("D", key)]))
    one, other = found
    assert other["basin/stance_rate"] == pytest.approx(2 * one["basin/stance_rate"])
    for name in ("area", "standard_error"):
        assert other[f"areas/{name}"] == pytest.approx(2 * one[f"areas/{name}"])
    sides = [
        np.unique(other[f"basin/{name}"]) for name in ("stance_angle", "stance_rate")
    ]
    whole = np.prod([len(side) * (side[1] - side[0]) for side in sides])
    assert other["areas/area"].sum() == pytest.approx(whole)


@pytest.mark.parametrize("name", ["D", "E"])
def test_there_are_two_gaits_that_walk_like_people(name):
    found = census(
        {
            "line": {"walker": name, "set": {}},
            "slope": np.array([0.005, 0.05]),
            "starts": 1500,
        },
        [],
    )
    assert found["coverage/anthropomorphic"].tolist() == [2, 2]
    assert found["coverage/non_anthropomorphic"].tolist() == [0, 0]
    assert (found["census/hits"] > 1).all()
    assert (found["coverage/unseen"] < 0.1).all()


def test_gaits_of_steep_slopes_are_found():
    """Slow for their angle, or larger than guesses were: of B's two, one was found, and
    1.4 % called unseen.
    """
    for name, slope in (("D", 0.4), ("E", 0.4), ("B", 0.3), ("B", 0.4)):
        found = census(
            {
                "line": {"walker": name, "set": {}},
                "slope": np.array([slope]),
                "starts": 600,
            },
            [],
        )
        known = np.sort(solved(name, slope)["stance_angle"][0, :2])
        assert found["census/stance_angle"] == pytest.approx(known, rel=1e-10)
        assert (found["census/hits"] > 1).all()


def test_only_distinct_results_of_the_census_are_integrated_exactly(monkeypatch):
    exact = []

    def counted(problem, w, log_slope, coarse=False, **options):
        exact.extend([] if coarse else [w.shape[1]])
        return newton(problem, w, log_slope, coarse, **options)

    monkeypatch.setattr(count_gaits, "newton", counted)
    found = census(
        {"line": {"walker": "D", "set": {}}, "slope": np.array([0.01]), "starts": 1000},
        [],
    )
    assert len(found["census/slope"]) == 2 and found["coverage/converged"][0] > 20
    assert exact and max(exact) < 10


def test_deflation_leads_to_the_gait_that_plain_newton_misses():
    """One start of thirty strikes at all; plain Newton takes it to one gait of E,
    deflated Newton to the other.
    """
    found = census(
        {"line": {"walker": "E", "set": {}}, "slope": np.array([0.01]), "starts": 30},
        [],
    )
    assert found["coverage/converged"].tolist() == [1]
    assert found["coverage/found_deflated"].tolist() == [1]
    assert sorted(found["census/hits"]) == [0, 1]
    many = census(
        {"line": {"walker": "E", "set": {}}, "slope": np.array([0.01]), "starts": 600},
        [],
    )
    assert found["census/stance_angle"] == pytest.approx(
        many["census/stance_angle"], rel=1e-12
    )
    assert many["coverage/found_deflated"].tolist() == [0]


def test_deflated_newton_keeps_away_from_what_is_known():
    problem, slope = Problem(resolve("E")), 0.01
    y = starts(problem, slope, 600)
    flown = stride(problem, y, np.full(600, slope), exact=False)
    begin = np.vstack([np.log(y[0]), y[1:] / y[0], flown.times])[
        :, flown.outcome == STRUCK
    ]
    w, converged = newton(problem, begin, np.full(begin.shape[1], np.log(slope)))
    w = w[:, converged]
    both = [w[:, k] for k in (np.argmin(w[0]), np.argmax(w[0]))]
    for mine, other in (both, both[::-1]):
        ends, near = deflated(problem, begin, mine[:, None], slope)
        assert near.any()
        assert np.abs(ends[:, near] - other[:, None]).max() < 2e-3
        assert not deflated(problem, mine[:, None] + 1e-4, mine[:, None], slope)[
            1
        ].any()
    assert not deflated(problem, begin, np.array(both).T, slope)[1].any()


def test_starts_fill_the_section():
    y = starts(Problem(resolve("C")), 0.01, 512)
    slowest = -0.7 * np.maximum(y[0] - 0.01, 0.0)
    for row in (np.log(y[0]), (y[1] - slowest) / (4 * y[0] + slowest), y[2] / y[1]):
        counts, _ = np.histogram(row, 8)
        assert counts.min() > 50


def test_rates_of_a_census_are_those_after_heelstrike(monkeypatch):
    """With knees they were those before it."""
    (_, found), slope = branches("C"), np.array([0.03])
    w = np.column_stack([Z[:-1] for b in found for _, Z, _ in b.guesses(np.log(slope))])
    ones = np.ones(w.shape[1], int)
    monkeypatch.setattr(count_gaits, "_solve", lambda *_: (w, ones, len(ones)))
    monkeypatch.setattr(count_gaits, "_deflate", lambda *_: (w, ones, 0, 0))
    counted = census(
        {"line": {"walker": "C", "set": {}}, "slope": slope, "starts": 1}, []
    )
    known = solved("C", slope)
    for name in ("stance_angle", "stance_rate", "period"):
        assert sorted(counted[f"census/{name}"]) == pytest.approx(
            sorted(known[name][0, :2]), rel=1e-9
        ), name


@pytest.mark.parametrize("slope", [1e-6, 1e-10])
def test_periods_are_told_apart_at_any_slope(slope):
    """Orbits of E alternate between angles 6 % apart; compared without their size,
    those of small ones seemed equal.
    """
    found = basin(
        {
            "line": {"walker": "E", "set": {}},
            "slope": np.array([slope]),
            "size": 12,
            "steps": 800,
        },
        [_atlas("E", ())],
    )
    assert (
        "period 2" in found["areas/outcome"]
        and "period 1" not in found["areas/outcome"]
    )
