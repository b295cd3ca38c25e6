"""What a figure finds, and that a reader can tell its curves and words apart."""

import itertools
import re

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.text import Text

from gaitsweep.pipeline.report import html_tables, pages, paper
from gaitsweep.pipeline.report.figures import FIGURES, bifurcation, landmarks
from gaitsweep.pipeline.report.figures.degrees import add_degrees
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.stability import add_borders
from gaitsweep.pipeline.report.figures.style import (
    COLOURS,
    NARROW_SMALL_WORDS,
    PRINTED,
    VARIABLES,
    WALKERS,
    End,
    end_labels,
    inks,
    once_laid_out,
    set_heading,
    style,
    thin,
    write_clear,
)
from gaitsweep.pipeline.report.pages import TEMPLATES
from gaitsweep.pipeline.report.source import read
from gaitsweep.pipeline.report.words import plain
from test_report.shape import GAITS, KNEED, POINT, write


def _orbits(tmp_path, exponents, errors, falls=(), lost=1.0):
    """An archive of exponents at slopes 0.01, 0.02 …, with orbits that fall at some."""
    slope = 0.01 * np.arange(1, len(exponents) + 1)
    count = len(slope)
    tables = {
        "lyapunov": {
            "walker": ["C"] * count,
            "slope": slope,
            "index": np.zeros(count, int),
            "exponent": np.array(exponents, float),
            "standard_error": np.array(errors, float),
        },
        "survival": {
            "walker": ["C"] * count,
            "slope": slope,
            "falls": np.isin(np.arange(count), falls).astype(int),
            "lifetime": np.full(count, np.inf),
        },
        "crises": {"walker": ["C"], "slope": [lost]},
    }
    study = 'name = "orbits"\nkind = "orbit"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    return read(write(tmp_path / "o.nc", study, {}, {}, {"C": KNEED}, tables))


def _found(source):
    """Where the only line of a source is chaotic."""
    (line,) = source.lines_of(source.tables["lyapunov"])
    return bifurcation.chaotic(source, line)


def test_chaos_is_where_an_exponent_exceeds_its_standard_errors(tmp_path):
    source = _orbits(tmp_path, [0.001, -0.5, 0.29, 0.4, 0.1, 0.5], [0.1] * 6)

    found = _found(source)

    assert (found.low, found.high) == pytest.approx((0.04, 0.06))
    assert (found.chaotic, found.between) == (2, 3)
    said = FIGURES["lyapunov"](source).words[3]
    assert "from 0.04 to 0.06 rad at 2 of the 3 slopes (C)" in said


def test_transients_are_no_chaos(tmp_path):
    beyond = _orbits(tmp_path, [0.4] * 4, [0.01] * 4, lost=0.035)
    assert _found(beyond).high == pytest.approx(0.03)

    falling = _orbits(tmp_path, [0.4] * 4, [0.01] * 4, falls=(2, 3))
    assert _found(falling).high == pytest.approx(0.02)


def test_exponents_that_are_zero_within_their_errors_are_no_finding(tmp_path):
    source = _orbits(tmp_path, [7.6e-5, 1e-3, -0.2], [1.3e-3] * 3)

    assert _found(source) is None
    assert FIGURES["lyapunov"](source).words[3] == ""


def test_a_walker_has_a_colour_of_its_own_that_is_not_the_papers():
    assert len({*WALKERS.values()}) == len(WALKERS)
    assert {*WALKERS.values()} <= {*COLOURS.values()} - {PRINTED}


@pytest.mark.parametrize("names", [["A", "E"], ["E", "A"], ["", "E", ""], ["E", "E"]])
def test_a_walkers_colour_does_not_depend_on_its_neighbours(names):
    colours = inks(names)

    assert colours[names.index("E")] == WALKERS["E"]
    assert len({*colours}) == len(names) and PRINTED not in colours


def test_pages_have_the_colours_of_the_figures():
    text = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    light, dark = re.findall(r":root \{(.*?)\}", text, re.S)[:2]
    given = dict(re.findall(r"--(line\d+): (#[0-9a-f]{6})", light))

    assert given == COLOURS
    assert {*re.findall(r"--(line\d+):", dark)} == {*COLOURS}


def _curve(count):
    """Gaits whose spectral radius passes 1 at slope 0.04, where the angle is 0.2."""
    slope = np.geomspace(0.01, 0.1, count)
    radius = (slope / 0.04) ** 0.7
    return pd.DataFrame(
        {
            "slope": slope,
            "stance_angle": np.sqrt(slope),
            "spectral_radius": radius,
            "stable": (radius < 1).astype(float),
            "gait": "long",
        }
    )


@pytest.mark.parametrize("count", [2, 7, 40])
def test_a_stable_part_ends_where_the_multiplier_leaves_the_unit_circle(count):
    whole = add_borders(_curve(count))

    (border,) = whole[whole["border"]].to_dict("records")
    assert border["slope"] == pytest.approx(0.04, rel=1e-9)
    assert border["stance_angle"] == pytest.approx(0.2, rel=1e-9)
    assert whole["slope"].is_monotonic_increasing
    assert len(whole) == count + 1


def test_borders_leave_the_choice_of_the_points_drawn_as_it_is():
    curve = _curve(101)

    drawn = thin(add_borders(curve), 11)

    computed = drawn[~drawn["border"].astype(bool)]
    assert computed["slope"].tolist() == thin(curve, 11)["slope"].tolist()
    assert len(drawn) == 12


def test_a_figure_draws_thick_up_to_the_flip_and_its_data_is_what_was_computed(
    tmp_path,
):
    curve = _curve(12)
    dims = ("slope", "gait")
    grid = {
        name: (dims, np.stack([curve[name], np.full(12, np.nan)], 1))
        for name in ("stance_angle", "spectral_radius")
    }
    study = 'name = "flip"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    coords = {"slope": curve["slope"].to_numpy(), "gait": GAITS}
    source = read(write(tmp_path / "f.nc", study, grid, coords, {"C": KNEED}))

    sketch = FIGURES["linear"](source)

    (axes,) = sketch.panels
    thick = [line for line in axes.lines if line.get_linewidth() == 2.6]
    ends = [np.nanmax(np.where(np.isnan(y), np.nan, x)) for x, y in map(_xy, thick)]
    assert max(ends) == pytest.approx(0.04, rel=1e-6)
    assert len(sketch.data) == 12
    assert {line.get_color() for line in thick} == {WALKERS["C"]}


def _xy(line):
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def _boxes(axes: Axes):
    """Boxes of the words of axes as they are drawn, without the lines to them."""
    axes.figure.draw_without_rendering()
    return {text.get_text(): Text.get_window_extent(text) for text in axes.texts}


@pytest.mark.parametrize("side", ["left", "right"])
def test_names_at_the_ends_of_curves_overlap_neither_each_other_nor_the_frame(side):
    with style():
        sketch = Sketch("linear", 350)
        (axes,) = sketch.panels
        heights = [0.97, 0.98, 0.981, 0.99, 1.0, 0.0, 0.001, 0.002, 0.003]
        x = np.linspace(0, 1, 50)
        for height in heights:
            axes.plot(
                x, 0.1 + (height - 0.1) * x if side == "right" else height - 0.5 * x
            )
        ends = [
            End(1.0 if side == "right" else 0.0, height, f"name {k}", COLOURS["line0"])
            for k, height in enumerate(heights)
        ]

        end_labels(axes, ends, side)

        boxes = _boxes(axes)
        assert len(boxes) == len(heights)
        for one, other in itertools.combinations(boxes.values(), 2):
            assert not one.overlaps(other)
        frame = axes.get_window_extent()
        for box in boxes.values():
            assert frame.y0 - 1 <= box.y0 and box.y1 <= frame.y1 + 1
            assert not any(_touches(line, box) for line in axes.lines)


def _touches(line, box):
    points = line.get_transform().transform(line.get_xydata())
    return bool(box.count_contains(points))


def test_words_move_away_from_a_curve():
    with style():
        sketch = Sketch("linear", 350)
        (axes,) = sketch.panels
        x = np.linspace(0, 1, 400)
        axes.plot(x, 0.5 + 0 * x)
        axes.set_ylim(0, 1)
        places = [(10, 0, "left"), (0, 20, "center")]

        words = [("0.0150", (0.5, 0.5)), ("0.016", (0.5, 0.8))]
        write_clear(axes, words, places)
        sketch.figure.draw_without_rendering()

        boxes = _boxes(axes)
        assert not _touches(axes.lines[0], boxes["0.0150"])
        assert axes.texts[1].xyann == (10, 0)


def test_places_of_words_are_sought_when_a_legend_has_taken_its_room():
    with style():
        sketch = Sketch("linear", 200)
        (axes,) = sketch.panels
        sizes = []
        once_laid_out(axes, lambda: sizes.append(axes.bbox.height))
        for k in range(12):
            sketch.key(f"curve {k}")
        sketch.draw_legend(set())

        sketch.figure.draw_without_rendering()

        assert sizes == [axes.bbox.height]
        assert sizes[0] < 120


def test_titles_of_panels_stand_above_their_numbers_in_degrees():
    with style():
        sketch = Sketch("linear", 200)
        (axes,) = sketch.panels
        axes.set_xlabel("slope γ (rad)")
        set_heading(axes, "stance angle")
        add_degrees(sketch.figure)

        sketch.figure.draw_without_rendering()

        title = next(t for t in axes.findobj(Text) if t.get_text() == "stance angle")
        numbers = [t for t in axes.findobj(Text) if t.get_text().endswith("°")]
        highest = max(number.get_window_extent().y1 for number in numbers)
        assert title.get_window_extent().y0 > highest


def test_two_foot_masses_of_the_paper_are_called_and_coloured_as_its_walkers(tmp_path):
    slope = np.geomspace(1e-6, 0.1, 30)
    dims = ("foot_mass_ratio", "slope", "gait")
    grid = {"stance_angle": (dims, np.tile(slope[:, None] ** (1 / 3), (2, 1, 2)))}
    coords = {"foot_mass_ratio": [0.1, 0.05], "slope": slope, "gait": GAITS}
    study = (
        'name = "f5"\nwalker = "E"\n[axes]\nslope = [0.1]\n'
        "foot_mass_ratio = [0.1, 0.05]\n"
    )
    pair = {"pair": ["E / F"], "foot_mass_ratios": ["0.1 / 0.05"]}
    tables = {"fits/transition_ratio": pair}
    source = read(write(tmp_path / "f.nc", study, grid, coords, {"E": POINT}, tables))

    sketch = FIGURES["loglog"](source)

    names = {COLOURS[ink]: name for name, ink in sketch.lines}
    assert names == {WALKERS["E"]: "E (ρ = 0.1)", WALKERS["F"]: "F (ρ = 0.05)"}
    assert {*sketch.data["foot_mass_ratio"]} == {0.1, 0.05}
    assert {*sketch.data["walker"]} == {"E"}


def _basin(tmp_path, walks):
    """An archive of a basin over 20 × 20 initial conditions that walk where told."""
    x, y = (
        grid.ravel()
        for grid in np.meshgrid(np.linspace(0.1, 0.3, 20), np.linspace(-0.3, -0.1, 20))
    )
    outcome = np.where(walks(x, y), "long", "fell forward")
    tables = {
        "basin": {
            "slope": np.full(len(x), 0.01),
            "stance_angle": x,
            "stance_rate": y,
            "outcome": outcome,
        },
        "areas": {
            "outcome": ["fell forward", "long"],
            "area": [0.03, 0.0054],
            "standard_error": [1e-5, 8e-5],
        },
    }
    study = 'name = "b"\nkind = "basin"\nwalker = "D"\n[axes]\nslope = [0.01]\n'
    return read(write(tmp_path / "b.nc", study, {}, {}, {"D": POINT}, tables))


def test_a_basin_within_the_window_has_an_area_and_a_share_of_a_window_is_no_finding(
    tmp_path,
):
    source = _basin(tmp_path, lambda x, y: np.hypot(x - 0.2, y + 0.2) < 0.05)

    sketch = FIGURES["basin"](source)

    assert (
        sketch.words[3] == "Areas of the basins over θ* and θ̇*: long 0.0054 ± 8 × 10⁻⁵."
    )
    (panel, *_) = sketch.maps
    column, row = panel.cells["first"]
    assert (
        np.hypot(panel.values.columns[column] - 0.2, panel.values.index[row] + 0.2)
        < 0.02
    )


def test_a_basin_that_reaches_the_edge_of_the_window_is_said_to_be_cut(tmp_path):
    source = _basin(tmp_path, lambda x, y: x < 0.2)

    said = FIGURES["basin"](source).words[3]

    assert (
        said.endswith("their whole areas are not known: long.") and "0.0054" not in said
    )


@pytest.mark.parametrize(("peak", "is_border"), [(0.31, False), (0.5, True)])
def test_an_extreme_on_the_border_of_a_map_is_called_so(tmp_path, peak, is_border):
    R, c_t = np.meshgrid(np.linspace(0.1, 0.5, 9), np.linspace(0.05, 0.1, 9))
    R, c_t = R.ravel(), c_t.ravel()
    slope = 0.2 - (R - peak) ** 2 - (c_t - 0.075) ** 2
    best = {
        "walker": ["B"] * len(R),
        "R": R,
        "c_t": c_t,
        "smallest_slope": 0.01 + 0 * R,
        "largest_stable_slope": slope,
        "fastest_froude_speed": 0.3 + 0 * R,
    }
    study = (
        'name = "d"\nkind = "design"\nwalker = "B"\n[axes]\nR = [0.1, 0.5]\n'
        "c_t = [0.05, 0.1]\nslope = [0.01]\n"
    )
    archive = write(tmp_path / "d.nc", study, {}, {}, {"B": POINT}, {"design": best})

    said = FIGURES["design"](read(archive)).words[3]

    (largest,) = re.findall(r"Largest stable γ \(rad\): [^.]*\.[^(]*\(([^)]*)\)", said)
    assert largest.endswith("on the map's border") == is_border


@pytest.mark.parametrize("table", [KNEED, POINT])
def test_every_parameter_of_a_walker_is_named_once_where_it_is_measured(
    tmp_path, table
):
    study = 'name = "p"\nwalker = "X"\n[axes]\nslope = [0.01]\n'
    grid = {"stance_angle": (("slope", "gait"), np.full((1, 2), 0.2))}
    coords = {"slope": [0.01], "gait": GAITS}
    source = read(write(tmp_path / "p.nc", study, grid, coords, {"X": table}))

    with style():
        sketch = FIGURES["parameters"](source)
        boxes = _boxes(sketch.panels[0])

    named = [words.partition(" ")[0] for words in boxes]
    needed = {"l_t", "m_t", "c_t", "w_t", "l_s", "m_s", "c_s", "w_s", "m_h"}
    needed |= {key for key in ("R", "eps_T", "r_t", "r_s") if table[key]}
    assert sorted(named) == sorted(needed)
    assert any(f": {plain(table['m_t'])}" in words for words in boxes)
    for one, other in itertools.combinations(boxes.values(), 2):
        assert not one.overlaps(other)


def test_the_static_conditions_say_what_each_walker_lacks_of_them(tmp_path):
    walkers = {
        "upright": POINT,
        "thigh": POINT | {"w_t": 0.001},
        "shank": POINT | {"w_s": -0.002, "knees": True},
    }
    names = ", ".join(f'"{name}.toml"' for name in walkers)
    study = f'name = "c"\nwalker = [{names}]\n[axes]\nslope = [0.01]\n'
    source = read(write(tmp_path / "c.nc", study, {}, {}, walkers))

    drawn = FIGURES["conditions"](source)

    # The thighs are four fifths of the mass, the shanks one.
    assert drawn.words[3] == (
        "The conditions hold for upright.toml but for rounding."
        " thigh.toml misses the first by 0.0008;"
        " shank.toml misses the first by 0.0004 and the second by 0.002."
    )
    below = [axes.texts[0].get_text() for axes in drawn.panels]
    assert below == ["cross: 0", "cross: −0.0008", "cross: 0.0004\ndashed line: 0.002"]


@pytest.mark.parametrize(
    ("slopes", "shown"),
    [
        ("{ from = 0.07, to = 0.1, n = 9 }", ["flip", "loss"]),
        ("[0.08, 0.001, 0.0001]", ["flip", "exponent"]),
        ("0.1035", []),
    ],
)
def test_landmarks_at_other_slopes_than_a_studys_are_not_on_its_page(
    tmp_path, slopes, shown
):
    landmarks = {
        "walker": ["C", "C", "C"],
        "landmark": ["flip", "exponent", "loss"],
        "point": ["", "", ""],
        "printed": [0.084, 0.00015, np.nan],
        "printed_half_unit": [0.0005, 5e-6, np.nan],
        "slope": [0.0769, 0.00016, 0.0965],
        "slope_low": [0.07, 1e-4, 0.09],
        "slope_high": [0.08, 2e-4, 0.1],
        "stance_angle": [0.44, 0.03, np.nan],
    }
    study = f'name = "l"\nkind = "orbit"\nwalker = "C"\n[axes]\nslope = {slopes}\n'
    tables = {"landmarks": landmarks}
    source = read(write(tmp_path / "l.nc", study, {}, {}, {"C": KNEED}, tables))

    rows = [row for table in html_tables.landmarks(source) for row in table.rows]

    assert [row[0].text for row in rows] == shown


@pytest.mark.parametrize("place", [(0.999, 0.5), (0.001, 0.5), (0.5, 0.999)])
def test_words_beside_a_point_stay_within_the_frame(place):
    places = [(8, 8, "left"), (-8, 8, "right"), (-8, -10, "right"), (8, -10, "left")]
    with style():
        sketch = Sketch("linear", 350)
        (axes,) = sketch.panels
        axes.set(xlim=(0, 1), ylim=(0, 1))

        write_clear(axes, [("resonance 1:1", place)], places)

        (box,) = _boxes(axes).values()
    frame = axes.get_window_extent()
    assert frame.x0 <= box.x0 and box.x1 <= frame.x1
    assert frame.y0 <= box.y0 and box.y1 <= frame.y1


@pytest.mark.parametrize("slope", [0.0705, 0.0765, 0.0935, 0.0995])
def test_words_at_lines_across_a_panel_stay_within_its_frame_at_any_size(slope):
    row = {
        "walker": "C",
        "printed": 0.085,
        "half_unit": 0.0005,
        "slope": slope,
        "slope_low": 0.07,
        "slope_high": 0.1,
    }
    with style():
        sketch = Sketch("bifurcation", 300)
        (axes,) = sketch.panels
        axes.set(xlim=(0.07, 0.1), ylim=(0, 1))

        landmarks.draw_over_slopes(axes, pd.DataFrame([row]))

        boxes = _boxes(axes)
        on_left = {text.get_text(): text.get_ha() == "right" for text in axes.texts}
    frame = axes.get_window_extent()
    for words, box in boxes.items():
        width = box.width * NARROW_SMALL_WORDS / 8
        left = box.x1 - width if on_left[words] else box.x0
        assert frame.x0 <= left and left + width <= frame.x1


def test_the_number_of_a_point_stands_on_no_curve(tmp_path):
    slope = np.linspace(0.01, 0.1, 200)
    count = len(slope)
    branches = {
        "walker": ["C"] * (2 * count),
        "branch": np.repeat([0, 1], count),
        "slope": np.tile(slope, 2),
        # The second curve passes where the number would stand.
        "stance_angle": np.concatenate([np.sqrt(slope), np.sqrt(slope) - 0.03]),
    }
    point = {
        "walker": ["C"],
        "landmark": ["point 1"],
        "point": ["1"],
        "printed": [np.nan],
        "half_unit": [np.nan],
        "slope": [0.05],
        "slope_low": [np.nan],
        "slope_high": [np.nan],
        "stance_angle": [np.sqrt(0.05)],
    }
    study = 'name = "n"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
    tables = {"branches": branches, "landmarks": point}
    source = read(write(tmp_path / "n.nc", study, {}, {}, {"C": KNEED}, tables))

    with style():
        sketch = FIGURES["locus"](source)
        (axes,) = sketch.panels
        box = _boxes(axes)["1"]

    for line in axes.lines:
        assert not box.count_contains(_pixels_along(line))


def _pixels_along(line):
    """Places on a curve, many between two of its points."""
    points = line.get_transform().transform(np.transpose(_xy(line)))
    number = np.arange(len(points))
    dense = np.linspace(0, len(points) - 1, 20 * len(points))
    return np.stack([np.interp(dense, number, side) for side in points.T], axis=1)


def test_a_walking_cycle_and_a_basin_have_the_colour_of_their_walker(tmp_path):
    time = np.linspace(0, 1, 9)
    trace = {
        "walker": ["C"] * 9,
        "gait": ["long"] * 9,
        "slope": [0.01] * 9,
        "time": time,
        "theta_st": 0.2 - 0.4 * time,
        "theta_th": 0.4 * time - 0.2,
    }
    study = 'name = "t"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    tables = {"trace": trace}
    source = read(write(tmp_path / "t.nc", study, {}, {}, {"C": KNEED}, tables))

    sketch = FIGURES["angles"](source)

    thick = [line for line in sketch.panels[0].lines if line.get_linewidth() == 2.2]
    assert {line.get_color() for line in thick} == {WALKERS["C"]}

    basin = FIGURES["basin"](_basin(tmp_path, lambda x, y: x < 0.2))
    assert basin.maps[0].cells["ink"] == VARIABLES[WALKERS["D"]]


def test_curves_over_an_axis_of_their_key_have_one_column_of_it(tmp_path):
    curve = {
        "detuning": [1.0, 1.0],
        "curve": [0, 0],
        "kind": ["fold", "fold"],
        "key": ["detuning", "detuning"],
        "slope": [0.01, 0.02],
        "value": [0.1, 0.2],
    }
    study = (
        'name = "c"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
        "detuning = [1.0]\n"
    )
    tables = {"curves": curve}
    source = read(write(tmp_path / "c.nc", study, {}, {}, {"C": KNEED}, tables))

    data = FIGURES["curves"](source).data

    assert "key" not in data and "value" not in data
    assert data["detuning"].tolist() == [0.1, 0.2]


def test_residuals_say_how_far_the_worst_law_is_off(tmp_path):
    slope = np.geomspace(1e-4, 0.1, 31)
    # Within its range the law is 2 % too large at one slope alone.
    angle = slope ** (1 / 3)
    angle[10] /= 1.02
    angle[slope > 0.02] *= 3
    law = {"walker": ["C"], "gait": ["long"], "quantity": ["stance_angle"]}
    law |= {"regime": ["small"], "exponent": [1 / 3], "amplitude": [1.0]}
    law |= {"from": [1e-4], "to": [0.01], "n": [21]}
    study = 'name = "r"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    archive = write(
        tmp_path / "r.nc",
        study,
        {"stance_angle": (("slope", "gait"), angle[:, None])},
        {"slope": slope, "gait": np.array(["long"], object)},
        {"C": KNEED},
        {"fits/scaling": law},
    )

    sketch = FIGURES["residuals"](read(archive))

    assert sketch.words[3] == "The laws fit to within 2 %."


def test_turns_of_curves_name_the_key_that_turns(tmp_path):
    turns = {"curve": [0, 0], "turn": ["key", "slope"], "key": ["m_h"] * 2}
    turns |= {"slope": [0.01, 0.02], "value": [0.1, 0.2]}
    study = 'name = "c"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    archive = write(tmp_path / "c.nc", study, {}, {}, {"C": KNEED}, {"turnings": turns})

    (table,) = html_tables.results(read(archive))

    assert [row[table.heads.index("turn")].text for row in table.rows] == [
        "m_h",
        "slope",
    ]


def test_what_tells_two_laws_of_one_curve_apart_is_shown(tmp_path):
    laws = {
        "walker": ["C"] * 3,
        "gait": ["long", "long", "short"],
        "quantity": ["stance_angle"] * 3,
        "regime": ["small", "large", "small"],
        "exponent": [0.99, 0.36, 0.99],
        "exponent_low": [0.9, 0.3, 0.9],
        "exponent_high": [1.0, 0.4, 1.0],
        "amplitude": [1.0, 2.0, 3.0],
        "from": [1e-6, 1e-3, 1e-6],
        "to": [1e-5, 0.1, 1e-3],
        "n": [9, 9, 9],
    }
    once = {name: values[1:] for name, values in laws.items()}
    shown = []
    for name, table in (("twice", laws), ("once", once)):
        study = f'name = "{name}"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
        path = tmp_path / f"{name}.nc"
        tables = {"fits/scaling": table}
        (fits,) = html_tables.results(
            read(write(path, study, {}, {}, {"C": KNEED}, tables))
        )
        shown.append("regime" in fits.heads[: fits.most])

    assert shown == [True, False]


def test_a_claim_without_words_of_its_own_is_typeset():
    assert paper.claim({"id": "none", "printed": "P ~ v^4"}) == "P ∝ v⁴"


def test_a_table_with_a_column_for_each_walker_keeps_them_narrow(tmp_path):
    names = ["A", "B", "C", "D", "E", "F"]
    frame = {
        "walker": names,
        "zero_slope_capable": [1] * 6,
        "chaos": ["no walking beyond the slopes at which the period doubles"] * 6,
    }
    study = 'name = "f"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    tables = {"figure10": frame}
    archive = write(tmp_path / "f.nc", study, {}, {}, {"C": KNEED}, tables)

    (table,) = html_tables.results(read(archive))
    page = pages.write([archive], tmp_path / "reports")

    assert table.turned and table.heads == ["", *names]
    text = page.read_text(encoding="utf-8")
    assert 'class="archive turned"' in text and ".turned td.long { min-width" in text
