"""Design maps: the pins of single walkers, and a cell looked at by brute force."""

import numpy as np
import pytest

from gaitsweep.tasks.branches import extremes, passings
from gaitsweep.tasks.branches.atlas import survey
from gaitsweep.tasks.branches.extremes import Points, Sought, find
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.map_designs import _Rows, _walkers, design
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas, branches, solved


def best(walker, low=1e-4, high=0.2, **overrides):
    line = {"walker": walker, "set": overrides}
    found = design(
        {"line": line, "slope": np.array([low, high])},
        [_atlas(walker, tuple(sorted(overrides.items())))],
    )
    return {k.removeprefix("design/"): v[0] for k, v in found.items()}


def test_the_simplest_walker_is_stable_up_to_its_flip():
    found = best("D")
    assert found["largest_stable_slope"] == pytest.approx(
        0.015088437941119463562, rel=1e-12
    )
    assert found["stability_lost_by"] == "flip"
    assert (found["smallest_slope"], found["smallest_at"]) == (0.0, "any slope")
    # Its speed grows with the slope, so the fastest stable gait is the last one.
    assert found["fastest_slope"] == pytest.approx(
        found["largest_stable_slope"], rel=1e-12
    )


def test_a_walker_that_is_never_stable_has_no_number_and_says_so():
    found = best("E")
    assert np.isnan(found["largest_stable_slope"]) and np.isnan(
        found["fastest_stable_speed"]
    )
    assert found["stability_lost_by"] == "never stable"
    assert found["smallest_slope"] == 0.0


def test_a_walker_that_cannot_be_fails_no_other():
    legs = {"l_s": np.array([0.3, 0.42, 0.5])}
    line = {
        "walker": {"base": "B", "eps_T": 0.1, "R": 0.4, "c_s": 0.4, "l_s": 0.5},
        "set": legs,
    }
    found = design({"line": line, "slope": np.array([1e-3, 0.1])}, [])
    assert found["design/smallest_at"][1] == "no walker" and np.isnan(
        found["design/smallest_slope"][1]
    )
    alone = design(
        {
            "line": {**line, "set": {"l_s": np.array([0.3])}},
            "slope": np.array([1e-3, 0.1]),
        },
        [],
    )
    assert (
        found["design/smallest_at"][0] == alone["design/smallest_at"][0] != "no walker"
    )
    # Gaits at a slope are those of the others, in a plane too.
    cell = {"keys": ["l_s"], "low": [0.3], "high": [0.5], "log": [False], "lines": 3}
    found = design(
        {"line": line, "slope": np.array([1e-3, 0.1]), "at_slope": 0.06, "cell": cell},
        [],
    )
    alone = design(
        {
            "line": {**line, "set": {"l_s": 0.3}},
            "slope": np.array([1e-3, 0.1]),
            "at_slope": 0.06,
        },
        [],
    )
    assert found["design/attractor"].tolist() == [
        alone["design/attractor"][0],
        "no gait",
        "no gait",
    ]
    assert alone["design/attractor"][0] != "no gait"


def test_a_window_cuts_what_is_told():
    found = best("D", 1e-3, 0.01)
    assert (found["largest_stable_slope"], found["stability_lost_by"]) == (
        pytest.approx(0.01, rel=1e-12),
        "window",
    )
    # The last place looked at lies less than a part of a segment before the edge.
    assert 0.0099 < found["fastest_slope"] < 0.01 * (1 + 1e-12)
    assert best("physical", 1e-3, 0.01)["smallest_at"] == "no gait"


@pytest.mark.parametrize(("walker", "overrides"), [("A", {"R": 0.3}), ("physical", {})])
def test_a_cell_by_brute_force(walker, overrides):
    """A grid of slopes that knows no branch sees the same ends to within its own step."""
    low, high, n = 5e-3, 0.2, 391
    found = best(walker, low, high, **overrides)
    slopes = np.linspace(low, high, n)
    grid = solved(
        walker, slopes, want=("stance_angle", "spectral_radius", "speed"), **overrides
    )
    step = slopes[1] - slopes[0]
    gaits = [GAITS.index(g) for g in ("long", "short")]
    there = np.isfinite(grid["stance_angle"][:, gaits]).any(axis=1)
    stable = grid["spectral_radius"] < 1
    assert 0 <= slopes[there][0] - found["smallest_slope"] < step
    assert 0 <= found["largest_stable_slope"] - slopes[stable.any(axis=1)][-1] < step
    speed = np.where(stable, grid["speed"], 0.0)
    assert 0 <= found["fastest_stable_speed"] - speed.max() < 0.01 * speed.max()


def place(log_slope):
    """A gait at a special point that walks, is long and not stable."""
    none, no = np.full(1, np.nan), np.zeros(1, bool)
    return Points(
        line=np.zeros(1, int),
        kind=np.array(["window"], "U32"),
        Z=np.array([[0.0], [0.0], [0.0], [log_slope]]),
        rows=np.zeros((4, 1)),
        error=np.zeros(1),
        log_froude=none,
        speed_error=none,
        walks=~no,
        long=~no,
        stable=no,
        faster=no,
    )


def test_a_gait_on_the_edge_but_for_rounding_is_in_the_window():
    """Its smallest slope was listed, beside `no gait` for what it never is: stable."""
    window = (np.log(0.01), np.log(0.02))
    rows = _Rows(1, Sought(window))
    rows.store(
        branches("D")[0],
        np.zeros(1, int),
        place(np.nextafter(window[0], -np.inf)),
        surveyed=1,
    )
    assert rows.at["smallest_slope"]["kind"].tolist() == ["window"]
    assert rows.at["largest_stable_slope"]["kind"].tolist() == ["never stable"]


def test_a_branch_below_the_window_gives_no_gait_at_any_slope():
    """A branch from vanishing slopes counted though it ends before the window begins."""
    problem, found = branches("D")
    below = [branch.part(np.flatnonzero(branch.q < np.log(0.05))) for branch in found]
    for branch in below:
        branch.ratio, branch.leg_passes = (
            np.zeros(len(branch.q)),
            np.ones(len(branch.q), int),
        )
    for low, number in ((0.01, True), (0.1, False)):
        window = (np.log(low), np.log(0.2))
        points = find(
            Lanes(_walkers("D", {}, 1), problem.structure), [below], Sought(window)
        )
        assert (extremes.best(points, 1, window)["smallest_slope"][0] >= 0) == number


def test_a_walker_slightly_off_its_line_does_not_walk_at_any_slope():
    """Its branches reach the least slope that is followed, as a tuned walker's do, but
    have a smallest slope.
    """
    for w_s, vanishes in ((0.0, True), (3e-15, False)):
        walker = resolve("E", {"w_s": w_s})

        points = find(
            Lanes([walker]),
            [survey(Problem(walker), COARSE)],
            Sought((np.log(1e-4), np.log(0.1))),
        )

        assert (extremes.ANY_SLOPE in points.kind) is vanishes
        assert "window" in points.kind[points.walks]


def test_a_special_point_off_the_branch_is_not_one_of_its_points(monkeypatch):
    """Newton's method may lead to another branch: a point up to 0.5 from its guess was
    taken.
    """
    problem, found = branches("D")
    lanes, window = (
        Lanes(_walkers("D", {}, 1), problem.structure),
        (np.log(1e-3), np.log(0.2)),
    )
    flips = find(lanes, [found], Sought(window)).kind == "flip"

    def astray(*asked):
        point = solve(*asked)
        point.Z[1] += 0.1
        return point

    solve = passings.solve
    monkeypatch.setattr(passings, "solve", astray)
    points = find(lanes, [found], Sought(window))

    assert flips.any() and not points.walks[points.kind == "flip"].any()


def test_an_end_that_samples_locate_has_their_error():
    """Ends without equations of their own had an error of 1e-9, whatever that of the
    branch's end.
    """
    problem, found = branches("physical-straight")
    (branch,) = [b for b in found if "end_zero_step" in b.why]
    branch.end_errors = (3e-6, 3e-6)
    window = (np.log(1e-3), np.log(0.2))
    points = find(
        Lanes(_walkers("physical-straight", {}, 1), problem.structure),
        [[branch]],
        Sought(window),
    )
    assert (
        points.error[points.kind == "end_zero_step"] >= 3e-6
    ).all() and "end_zero_step" in points.kind
