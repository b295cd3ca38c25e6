"""The tables of printed landmarks, and the lines fitted to the two regimes of a short
step.
"""

import numpy as np
import pytest

from gaitsweep.tasks.fits.transition import fitted_lines
from gaitsweep.tasks.ledger.lines import paper_of
from gaitsweep.tasks.ledger.locate_landmarks import corners, crises, landmarks
from gaitsweep.tasks.studies.solve_points import atlas

# The search for gaits lets lanes that go astray overflow.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
PAPER = paper_of([], [])


def _landmarks(*walkers):
    lines = [{"walker": w, "set": {}, "name": w} for w in walkers]
    table = landmarks({"lines": lines}, [PAPER.line(w).arrays for w in walkers])
    columns = {
        name.removeprefix("landmarks/"): column for name, column in table.items()
    }
    return [
        dict(zip(columns, row, strict=True))
        for row in zip(*columns.values(), strict=True)
    ]


def test_the_points_of_figure_6_are_numbered_and_lie_where_the_branches_end():
    rows = _landmarks("physical", "physical-straight")
    points = {r["point"]: r for r in rows if r["point"]}
    assert set(points) == {"1", "2", "3", "4"}
    # Slopes of the ledger's claims P4 to P6; that of the fourth is extrapolated to
    # steps that vanish.
    expected = {"1": 0.03638698, "2": 0.05611778, "3": 0.02154161, "4": 0.02110135}
    assert {k: r["slope"] for k, r in points.items()} == pytest.approx(
        expected, rel=2e-5
    )
    assert points["4"]["stance_angle"] < 1e-4 and np.isnan(points["4"]["slope_low"])
    printed = {r["walker"]: r for r in rows if r["printed"] > 0}
    assert {w: r["printed"] for w, r in printed.items()} == {
        "physical": 0.020,
        "physical-straight": 0.016,
    }
    assert all(
        r["slope_low"] < r["printed"] < r["slope_high"] for r in printed.values()
    )
    assert all(
        r["slope_low"] < r["slope"] < r["slope_high"] for r in rows if r["point"] != "4"
    )


def test_landmarks_do_not_depend_on_what_their_process_computed_before():
    """Workers go from study to study, and atlases of short lines are coarser."""
    walker = {"line": {"walker": "D", "set": {}}}
    given = [atlas(walker, []), atlas({**walker, "coarse": True}, [])]
    tables = []
    for k in (0, 1, 0):
        lines = [{"walker": "D", "set": {}, "name": "D"}]
        tables.append(landmarks({"lines": lines}, [given[k]]))
        used = paper_of(lines, [given[k]]).line("D").arrays
        assert used.keys() == given[k].keys()
        assert all(used[name] is values for name, values in given[k].items())
    assert (
        tables[0]["landmarks/slope"].tolist() == tables[2]["landmarks/slope"].tolist()
    )


def test_an_exact_walkers_landmark_has_no_interval_of_rounding():
    (flip,) = _landmarks("D")
    assert flip["slope"] == pytest.approx(0.0150884379411195, rel=1e-11)
    assert flip["slope_low"] == flip["slope_high"] == flip["slope"]
    assert abs(flip["printed"] - flip["slope"]) < flip["half_unit"] == 5e-4


def test_the_loss_of_walking_is_read_from_the_tables_of_its_line():
    """What other tasks have located is tabulated, not located again."""
    lines = [{"walker": w, "set": {}, "name": w} for w in ("C", "D", "E")]
    lost = {
        "lost/family": np.array(["1"]),
        "lost/low": np.array([0.1]),
        "lost/high": np.array([0.11]),
    }
    rounding = {
        "corners/low": np.array([0.08, 0.12]),
        "corners/high": np.array([0.09, 0.13]),
    }
    table = crises({"lines": lines}, [{**lost, **rounding}, lost, {}])
    assert table["crises/walker"].tolist() == ["C", "D"]
    assert table["crises/slope"].tolist() == [0.5 * (0.1 + 0.11)] * 2
    assert table["crises/slope_low"].tolist() == [0.08, 0.1] and table[
        "crises/slope_high"
    ].tolist() == [0.13, 0.11]


def test_walkers_without_rounded_parameters_have_no_corners():
    for walker, settings in (
        ("D", {}),
        ("E", {}),
        ("C", {"R": 0.1}),
        ({"l_t": 1.0}, {}),
    ):
        table = corners({"line": {"walker": walker, "set": settings}}, [{}])
        assert {name: len(column) for name, column in table.items()} == {
            "corners/low": 0,
            "corners/high": 0,
        }


def test_a_study_without_walkers_of_the_paper_has_no_landmarks():
    assert (
        landmarks(
            {
                "lines": [
                    {"walker": {"l_t": 1.0}, "set": {}},
                    {"walker": "C", "set": {"R": 0.1}},
                ]
            },
            [{}, {}],
        )
        == {}
    )


def test_fitted_lines_recover_two_power_laws_and_their_crossing():
    slope = np.geomspace(1e-8, 0.1, 400)
    angle = np.minimum(20 * slope, 0.9 * slope ** (1 / 3))
    crossing = (0.9 / 20) ** 1.5
    fitted = fitted_lines(slope, angle, crossing)
    assert fitted.slope == pytest.approx(crossing, rel=1e-10)
    assert (fitted.exponent, fitted.amplitude, fitted.cube_root) == pytest.approx(
        (1, 20, 0.9), rel=1e-10
    )
    assert (fitted.below, fitted.above) == (crossing / 10, 3 * crossing)
    assert np.isnan(fitted_lines(slope[:200], angle[:200], crossing).slope)
