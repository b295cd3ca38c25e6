"""Bands around curves and bars at special points, of archives without a solver."""

import numpy as np
import pytest

from gaitsweep.pipeline.report import html_tables
from gaitsweep.pipeline.report.figures import FIGURES, draw
from gaitsweep.pipeline.report.source import read
from test_report.shape import GAITS, POINT, write

RADII, SLOPES = np.array([0.1, 0.2]), np.linspace(0.01, 0.05, 5)
NAMES = np.array(["slope", "m_t", "m_s", "R"], dtype=object)


@pytest.fixture
def grid(tmp_path):
    """A grid over R whose angles have the derivatives 0, 2, 0 and -1 by NAMES, but for
    one gait without that by m_t.
    """

    def archive(tolerances, missing=False):
        dims = ("R", "slope", "gait")
        angle = 0.1 + SLOPES[:, None] * np.ones((2, 5, 2))
        rates = np.broadcast_to([0.0, 2.0, 0.0, -1.0], (*angle.shape, 4)).copy()
        if missing:
            rates[0, 2, 0, 1] = np.nan
        held = {
            "stance_angle": (dims, angle),
            "stance_angle_by_key": ((*dims, "key"), rates),
            "spectral_radius": (dims, np.full(angle.shape, 0.5)),
            "status": (dims, np.zeros(angle.shape, "i1")),
            "reason": (dims, np.zeros(angle.shape, "i2")),
        }
        coords = {"R": RADII, "slope": SLOPES, "gait": GAITS, "key": NAMES}
        study = (
            'name = "bands"\nwalker = "E"\n[axes]\nslope = [0.01]\n[figures]\n'
            f"tolerances = {tolerances}\n"
        )
        return read(write(tmp_path / "b.nc", study, held, coords, {"E": POINT}))

    return archive


def test_a_half_width_is_the_sum_over_keys_at_the_values_of_its_line(grid):
    source = grid('{ m_t = 0.001, R = "10%" }')

    data = FIGURES["linear"](source).data

    known = data["stance_angle_half_width"].to_numpy()
    np.testing.assert_allclose(known, 0.002 + 0.1 * data["R"], rtol=1e-12)


@pytest.mark.parametrize("figure", ["linear", "over_key"])
def test_a_page_says_which_key_has_most_and_which_has_nothing(grid, figure):
    source = grid('{ m_t = 0.001, R = "10%", m_s = "5%" }')

    caption = draw(source, figure, "salt", small=False).caption

    assert (
        "where keys are off by m_t ± 0.001, R ± 10 %, m_s ± 5 %: the worst" in caption
    )
    assert "Most of it comes from R (87 % of the half-width of stance angle)" in caption
    assert "Nothing depends on m_s." in caption
    assert "have no derivative" not in caption


def test_a_band_has_a_gap_where_a_derivative_is_missing(grid):
    source = grid("{ m_t = 0.001 }", missing=True)

    drawn = draw(source, "linear", "salt", small=False)

    known = drawn.data["stance_angle_half_width"]
    assert known.isna().sum() == 1
    assert "There is no band where gaits have no derivative by m_t." in drawn.caption


def test_without_tolerances_there_is_no_band(grid):
    drawn = draw(grid("{}"), "linear", "salt", small=False)

    assert "stance_angle_half_width" not in drawn.data
    assert "Bands" not in drawn.caption


@pytest.fixture
def branch(tmp_path):
    """A branch with a flip and a fold that move with two keys, the fold with one only,
    and an end of which no derivative is known.
    """
    slope = np.linspace(0.01, 0.04, 30)
    rows = {"branch": np.zeros(30, int), "slope": slope, "stance_angle": 0.1 + slope}
    ends = ["end_zero_step"]
    points = {"branch": [0] * 3, "kind": ["flip", "fold", *ends]}
    points |= {"slope": [0.02, 0.03, 0.04], "stance_angle": [0.12, 0.13, 0.14]}
    rates = {"branch": [0] * 5, "kind": ["flip", "flip", "fold", *ends, *ends]}
    rates |= {"slope": [0.02, 0.02, 0.03, 0.04, 0.04]}
    rates |= {"key": ["m_t", "R", "m_t", "m_t", "R"], "key_units": ["1"] * 5}
    rates |= {"slope_by_key": [-0.5, 0.2, 1.0, np.nan, np.nan]}
    text = (
        'name = "b"\nkind = "branch"\nwalker = "B"\n[axes]\nslope = [0.01, 0.04]\n'
        '[figures.tolerances]\nm_t = "1%"\nR = 0.005\n'
    )
    tables = {"branches": rows, "special_points": points}
    tables["special_sensitivities"] = rates
    walker = {"B": POINT | {"R": 0.2}}
    return read(write(tmp_path / "b.nc", text, {}, {}, walker, tables))


def test_special_points_have_half_widths_where_every_key_has_its_derivative(branch):
    table = next(
        each for each in html_tables.results(branch) if each.name == "special_points"
    )

    flip, *others = table.frame.to_dict("records")
    assert flip["slope_half_width"] == pytest.approx(0.5 * 0.004 + 0.2 * 0.005)
    assert flip["most_from"] == "m_t"
    assert len(others) == 2
    assert all(np.isnan(each["slope_half_width"]) for each in others)
    assert all(each["most_from"] == "" for each in others)


def test_a_locus_draws_bars_at_special_points_and_says_so(branch):
    sketch = FIGURES["locus"](branch)

    (bars,) = sketch.panels[0].collections
    (bar,) = bars.get_segments()
    np.testing.assert_allclose(bar[:, 0], [0.017, 0.023])
    assert "m_t ± 1 %, R ± 0.005" in sketch.words[1]
    assert "Most of it comes from m_t (flip at 0.02)." in sketch.words[1]
