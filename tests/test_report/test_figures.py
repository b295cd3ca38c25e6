import itertools
import re
import shlex

import netCDF4
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

from gaitsweep.pipeline.report import cells, folder, html_tables
from gaitsweep.pipeline.report.figures import (
    FIGURES,
    Undrawn,
    continued,
    design_maps,
    draw,
    fields,
    landmarks,
    over_key,
    slices,
    svg,
)
from gaitsweep.pipeline.report.figures.body import Body
from gaitsweep.pipeline.report.figures.cycle import traced_steps
from gaitsweep.pipeline.report.figures.degrees import add_degrees
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import (
    COLOURS,
    MUTED,
    NARROW_WORDS,
    WALKERS,
    canvas,
    choose_rows,
    draw_guide,
    hatch,
    on_map,
    set_log,
    style,
    title_of,
)
from gaitsweep.pipeline.report.figures.svg import TARGETS, key, render
from gaitsweep.pipeline.report.source import read
from gaitsweep.pipeline.report.words import WORDS, plain, sentences, spaced
from lines import some
from test_report import synthetic
from test_report.shape import GAITS, KNEED, POINT, write


@pytest.fixture(scope="module")
def sources(archives):
    return {source.slug: source for source in map(read, archives)}


@pytest.mark.parametrize(
    ("study", "name"),
    [
        ("transition", n)
        for n in (
            "loglog",
            "linear",
            "residuals",
            "transition_ladder",
            "angles",
            "walker",
            "conditions",
        )
    ]
    + [("detuning", "locus"), ("cascade", "bifurcation"), ("cascade", "basin")]
    + [("design", "heatmap"), ("design", "design")],
)
def test_each_figure_is_drawn_from_its_archive(sources, study, name):
    drawing = draw(sources[study], name, "test")
    assert drawing.svg.startswith("<svg")
    assert len(drawing.data)
    assert sum(len(one["rows"]) for one in drawing.targets) <= TARGETS


def test_the_legend_stands_in_words_too_for_narrow_pages(sources):
    drawing = draw(sources["transition"], "loglog", "test")
    legend = drawing.svg[drawing.svg.index('class="told"') :]
    written = re.findall(r"<text[^>]*>([^<]*)</text>", legend)
    told = [label for _, _, label in drawing.keys]
    assert "short step" in told and set(told) <= set(written)
    styles = {label: style for style, _, label in drawing.keys}
    assert styles["short step"] == "border-top:1.4px dashed var(--ink)"
    # What an earlier figure of the page has told is in neither.
    again = draw(sources["transition"], "loglog", "test", told={*told})
    assert again.keys == [] and 'class="told"' not in again.svg


def test_markers_of_a_legend_are_characters_filled_or_hollow():
    drawn = Sketch("loglog", 200)
    drawn.dot_key("fold", mfc="#ffffff")
    drawn.dot_key("end", MUTED, "v")
    drawn.dot_key("of no form", marker="h")
    drawn.draw_legend(set())
    assert [key(line) for line in drawn.legend] == [
        ("color:var(--ink)", "○", "fold"),
        ("color:var(--muted)", "▼", "end"),
        ("color:var(--ink)", "●", "of no form"),
    ]


#: Figures for which the archive of a cascade has all data.
_OF_CASCADE = ("bifurcation", "basin", "walker", "conditions", "parameters")


@pytest.mark.parametrize(
    "name",
    [name for name in FIGURES if name not in _OF_CASCADE],
)
def test_a_figure_whose_data_is_missing_is_not_drawn(sources, name):
    absent = WORDS["figures"][name]["absent"]
    with pytest.raises(Undrawn, match=f"^the archive has no {absent}$"):
        draw(sources["cascade"], name, "test")


def test_marks_lie_on_the_curve_and_carry_the_command_of_their_point(sources):
    drawing = draw(sources["transition"], "loglog", "test")
    one = next(t for t in drawing.targets if t["label"].startswith("short step"))
    assert shlex.split(one["command"])[:4] == ["gaitsweep", "solve", "--walker", "E"]
    assert "foot_mass_ratio=0.1" in one["command"]
    rows = np.array([row[:3] for row in one["rows"]], float)
    assert (np.diff(rows[:, 0]) > 0).all()
    assert (
        np.isclose(rows[:, 2], sources["transition"].grid["slope"].values[:, None])
        .any(axis=0)
        .all()
    )
    assert rows[:, 0].max() <= drawing.width
    assert rows[:, 1].max() <= drawing.height


def _drawn(sketch):
    """Slopes and angles of every line drawn of gaits: unbroken runs of points."""
    for drawn in sketch.figure.axes[0].lines:
        x, y = (np.asarray(values, float) for values in drawn.get_data())
        there = np.isfinite(x) & np.isfinite(y)
        for run in np.split(np.arange(len(x)), np.flatnonzero(np.diff(there)) + 1):
            if there[run[0]] and drawn.get_color() in COLOURS.values():
                yield x[run], y[run]


@pytest.mark.parametrize("name", ["linear", "loglog", "residuals"])
def test_no_line_joins_two_branches_or_two_pieces_of_one(tmp_path, name):
    source = read(synthetic.jumping(tmp_path))
    sketch = FIGURES[name](source)
    runs = list(_drawn(sketch))
    assert all(
        np.abs(np.diff(y)).max(initial=0) < (0.02 if name != "residuals" else 5)
        for _, y in runs
    )
    if name != "residuals":
        # The curve that changes its label at 0.02 has no gap there.
        assert any(
            (x.min() < 0.0201) & (x.max() > 0.02) & (len(x) > 20) for x, _ in runs
        )
        assert set(sketch.data["gait"]) == {"long", "other1", "other2"}
        last = next(x for x, y in runs if y[0] == pytest.approx(0.11))
        assert last[-1] == pytest.approx(0.0205)


def test_fitted_laws_of_two_branches_are_not_carried_on_to_a_crossing(tmp_path):
    axes = FIGURES["loglog"](read(synthetic.jumping(tmp_path))).figure.axes[0]
    ends = [
        tuple(line.get_xdata())
        for line in axes.lines
        if line.get_color() == MUTED and len(line.get_xdata()) == 2
    ]
    assert sorted(ends) == [(0.005, 0.03), (0.03, 0.08)]


@pytest.mark.parametrize(("edge", "parts"), [(0.04, 2), (0.06, 1)])
def test_a_locus_that_leaves_its_window_is_not_joined_where_it_comes_back(
    tmp_path, edge, parts
):
    way = np.linspace(
        -1, 1, 201
    )  # through a fold at slope 0.05, and through 0.04 on the way there and back
    slope, angle = 0.05 - 0.04 * way**2, 0.2 + 0.1 * way
    kept = slope <= edge + 1e-12
    rows = {
        "branch": np.zeros(kept.sum(), int),
        "slope": slope[kept],
        "stance_angle": angle[kept],
    }
    text = f'name = "window"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, {edge}]'
    archive = write(tmp_path / "w.nc", text, {}, {}, {"C": KNEED}, {"branches": rows})
    axes = FIGURES["locus"](read(archive)).figure.axes[0]
    runs = [
        y
        for y in (np.asarray(line.get_ydata(), float) for line in axes.lines)
        if np.isfinite(y).any()
    ]
    assert len(runs) == parts and sum(map(len, runs)) == kept.sum()
    assert max(np.abs(np.diff(y)).max() for y in runs) < 0.002


def test_a_locus_marks_no_point_where_a_branch_leaves_the_window(tmp_path):
    slope = np.linspace(0.01, 0.04, 30)
    rows = {"branch": np.zeros(30, int), "slope": slope, "stance_angle": 0.1 + slope}
    kinds = {
        "kind": ["flip", "window"],
        "slope": [0.02, 0.04],
        "stance_angle": [0.12, 0.14],
    }
    text = (
        'name = "window"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, 0.04]'
    )
    tables = {"branches": rows, "special_points": kinds}

    axes = FIGURES["locus"](
        read(write(tmp_path / "w.nc", text, {}, {}, {"C": KNEED}, tables))
    ).figure.axes[0]

    marked = [
        line.get_xdata().tolist()
        for line in axes.lines
        if line.get_linestyle() == "None"
    ]
    assert [0.02] in marked and [0.04] not in marked


def test_special_points_tell_whether_they_are_supercritical(tmp_path):
    slope = np.linspace(0.01, 0.04, 30)
    rows = {"branch": np.zeros(30, int), "slope": slope, "stance_angle": 0.1 + slope}
    kinds = {"kind": ["flip", "fold"], "slope": [0.02, 0.03]}
    kinds |= {"stance_angle": [0.12, 0.13], "criticality": ["supercritical", ""]}
    text = 'name = "b"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, 0.04]'
    tables = {"branches": rows, "special_points": kinds}

    sketch = FIGURES["locus"](
        read(write(tmp_path / "b.nc", text, {}, {}, {"C": KNEED}, tables))
    )

    (marks,) = [each for each in sketch.marks if each.label == "special point"]
    assert marks.rows["told"].tolist() == ["flip, supercritical", "fold"]


@pytest.mark.parametrize("kind", ["flip", "fold"])
def test_points_of_curves_tell_whether_they_are_supercritical(tmp_path, kind):
    curve = {"curve": [0, 0], "kind": [kind] * 2, "key": ["R"] * 2}
    curve |= {"slope": [0.01, 0.02], "value": [0.1, 0.2]}
    told = ["supercritical", "subcritical"] if kind == "flip" else ["", ""]
    text = 'name = "c"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
    tables = {"curves": curve | {"criticality": told}}

    sketch = FIGURES["curves"](
        read(write(tmp_path / "c.nc", text, {}, {}, {"C": KNEED}, tables))
    )

    assert ("criticality" in sketch.marks[0].tips) == (kind == "flip")


def _quantities(folder, **columns):
    """A line of two gaits with some variables, those of the second twice those of the
    first.
    """
    slope = np.geomspace(0.01, 0.1, 40)
    grid = {
        name: (("slope", "gait"), np.stack([values(slope), 2 * values(slope)], 1))
        for name, values in columns.items()
    }
    study = 'name = "quantities"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    return write(
        folder / "quantities.nc",
        study,
        grid,
        {"slope": slope, "gait": GAITS},
        {"C": KNEED},
    )


def test_power_and_speed_have_each_its_own_unit(tmp_path):
    archive = _quantities(
        tmp_path, speed=lambda s: s ** (1 / 3), power=lambda s: s ** (4 / 3)
    )
    with netCDF4.Dataset(archive, "a") as file:
        file["speed"].units, file["power"].units = "m s-1", "W"
    axes = FIGURES["power"](read(archive)).figure.axes[0]
    assert (axes.get_xlabel(), axes.get_title(loc="left")) == (
        "speed v (m s⁻¹)",
        "power P (W)",
    )


@pytest.mark.parametrize("name", ["multipliers", "measured"])
def test_no_line_crosses_slopes_without_a_gait(tmp_path, name):
    archive = _quantities(
        tmp_path,
        spectral_radius=lambda s: np.where((s > 0.03) & (s < 0.05), np.nan, 0.7),
    )
    overlay = {"slope": [0.02], "spectral_radius": [0.1]}
    xr.Dataset({k: ("row", v) for k, v in overlay.items()}).to_netcdf(
        archive, mode="a", group="overlay"
    )
    runs = [x for x, _ in _drawn(FIGURES[name](read(archive)))]
    assert {x[-1] < 0.03 or x[0] > 0.05 for x in runs} == {True}


@pytest.mark.parametrize("name", ["linear", "multipliers", "measured"])
def test_a_gait_at_one_slope_alone_is_a_dot(tmp_path, name):
    """A line of one point is invisible."""
    alone = {
        v: lambda s: np.where(s == s[3], 0.3, np.nan)
        for v in ("stance_angle", "spectral_radius")
    }
    archive = _quantities(tmp_path, **alone)
    overlay = {"slope": [0.02], "spectral_radius": [0.1]}
    xr.Dataset({k: ("row", v) for k, v in overlay.items()}).to_netcdf(
        archive, mode="a", group="overlay"
    )
    axes = FIGURES[name](read(archive)).figure.axes[0]
    dots = [line.get_xdata() for line in axes.lines if line.get_marker() == "o"]
    assert len(dots) == 2 and np.allclose(dots, np.geomspace(0.01, 0.1, 40)[3])


@pytest.mark.parametrize("walkers", [("D",), ("A", "B", "D"), tuple("ABCDEFGHIJKL")])
def test_a_census_draws_gaits_at_their_slopes_or_side_by_side_around_them(
    tmp_path, walkers
):
    slope = np.tile([1e-3, 1e-2], len(walkers))
    rows = {
        "walker": np.repeat(walkers, 2),
        "slope": slope,
        "anthropomorphic": np.ones(len(slope), int),
    }
    counts = {"unseen": np.full(len(slope), 0.1), "converged": np.full(len(slope), 9)}
    text = f'name = "census"\nkind = "census"\nwalker = {list(walkers)}\n[axes]\nslope = [0.001, 0.01]\n'
    tables = {
        "census": rows | {"stance_angle": slope ** (1 / 3)},
        "coverage": rows | counts,
    }
    sketch = FIGURES["census"](
        read(
            write(
                tmp_path / "c.nc", text, {}, {}, dict.fromkeys(walkers, POINT), tables
            )
        )
    )
    drawn = np.array([mark.rows[mark.x] for mark in sketch.marks]) / [1e-3, 1e-2]
    assert np.abs(np.log(drawn)).max() < np.log(1.25) * (len(walkers) > 1) + 1e-12
    np.testing.assert_allclose(np.exp(np.log(drawn).mean()), 1)
    assert ("side by side" in sketch.words[1]) == (len(walkers) > 1)


@pytest.mark.parametrize(
    ("outcome", "is_fall"),
    [
        ("knee never struck", True),
        ("motion lost", True),
        ("fell forward", True),
        ("walks on", False),
    ],
)
def test_a_basin_tells_falls_of_every_cause_from_walking(tmp_path, outcome, is_fall):
    angle, rate = (
        side.ravel()
        for side in np.meshgrid(np.linspace(0.1, 0.3, 10), np.linspace(-0.3, -0.1, 10))
    )
    rows = {
        "stance_angle": angle,
        "stance_rate": rate,
        "outcome": np.where(np.arange(100) < 25, outcome, "long"),
    }
    areas = {
        "outcome": ["long", outcome],
        "area": [0.03, 0.01],
        "standard_error": [1e-4, 1e-4],
    }
    text = 'name = "basin"\nkind = "basin"\nwalker = "C"\n[axes]\nslope = [0.05]\n'
    tables = {"basin": rows, "areas": areas}

    sketch = FIGURES["basin"](
        read(write(tmp_path / "b.nc", text, {}, {}, {"C": KNEED}, tables))
    )

    assert (outcome in sketch.words[3]) != is_fall and "long" in sketch.words[3]


@pytest.mark.parametrize(
    ("walker", "title", "when"),
    [(KNEED, "stance rate", "before"), (POINT, "stance rate θ̇*", "after")],
)
def test_a_basin_in_a_section_of_three_coordinates_says_which_plane_and_which_rates(
    tmp_path, walker, title, when
):
    angle, rate = (
        side.ravel()
        for side in np.meshgrid(np.linspace(0.1, 0.3, 10), np.linspace(-0.3, -0.1, 10))
    )
    rows = {
        "slope": np.full(100, 0.05),
        "stance_angle": angle,
        "stance_rate": rate,
        "swing_rate": 1.25 * rate,
    }
    text = 'name = "basin"\nkind = "basin"\nwalker = "C"\n[axes]\nslope = [0.05]\n'
    tables = {"basin": rows | {"outcome": np.array(["long"] * 100)}}
    sketch = FIGURES["basin"](
        read(write(tmp_path / "b.nc", text, {}, {}, {"C": walker}, tables))
    )
    assert sketch.figure.axes[0].get_title(loc="left") == title
    assert (
        f"is 1.25 times the stance leg's, as in the long gait, both just {when} heelstrike"
        in sketch.words[1]
    )


def test_a_heatmap_on_a_logarithmic_axis_has_every_cell_around_its_value(tmp_path):
    radius, slope = np.array([0.1, 0.2]), np.geomspace(1e-4, 0.1, 4)
    grid = {"speed": (("R", "slope", "gait"), np.ones((2, 4, 2)))}
    text = 'name = "map"\nwalker = "B"\n[axes]\nslope = [0.01]\n'
    archive = write(
        tmp_path / "m.nc",
        text,
        grid,
        {"R": radius, "slope": slope, "gait": GAITS},
        {"B": POINT},
    )
    sketch = FIGURES["heatmap"](read(archive))
    axes = sketch.figure.axes[0]
    borders = axes.collections[0].get_coordinates()[0, :, 0]
    np.testing.assert_allclose(
        borders, np.geomspace(1e-4, 0.1, 4)[0] * 10 ** (np.arange(5) - 0.5)
    )
    assert axes.get_xlim() == pytest.approx((borders[0], borders[-1]))
    assert "Hatched" not in sketch.words[1]


def test_a_heatmap_without_a_gait_in_some_cells_says_how_these_are_drawn(sources):
    assert "Hatched: no such gait." in FIGURES["heatmap"](sources["design"]).words[1]


@pytest.mark.parametrize("key", ["m_h", "w_t", "c_s"])
def test_keys_that_are_symbols_are_titles_as_they_are(key):
    assert spaced(key) == key and spaced("push_off") == "push off"


def test_branches_touch_where_a_curve_of_folds_turns_back_and_not_one_of_flips(
    tmp_path,
):
    kinds = ["fold", "flip"]
    curve = {
        "curve": [0, 0, 1, 1],
        "kind": np.repeat(kinds, 2),
        "key": ["detuning"] * 4,
        "slope": [0.01, 0.02] * 2,
    }
    turns = {
        "turn": ["key"] * 2,
        "key": ["detuning"] * 2,
        "kind": kinds,
        "slope": [0.011, 0.021],
        "value": [0.5, 0.6],
    }
    text = (
        'name = "curves"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
    )
    tables = {"curves": curve | {"value": [0.1, 0.2] * 2}, "turnings": turns}
    sketch = FIGURES["curves"](
        read(write(tmp_path / "c.nc", text, {}, {}, {"C": KNEED}, tables))
    )
    assert "re-pair at detuning 0.5 and slope 0.011 rad." in sketch.words[3]


def test_a_codimension_two_point_of_two_curves_is_named_once(tmp_path):
    kinds = ["fold", "flip"]
    curve = {
        "curve": [0, 0, 1, 1],
        "kind": np.repeat(kinds, 2),
        "key": ["detuning"] * 4,
        "slope": [0.01, 0.02] * 2,
        "value": [0.1, 0.2] * 2,
    }
    met = {
        "kind": kinds,
        "point": ["fold-flip"] * 2,
        "key": ["detuning"] * 2,
        "slope": [0.015, 0.015 + 1e-13],
        "value": [0.15, 0.15],
    }
    text = (
        'name = "curves"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
    )
    tables = {"curves": curve, "meetings": met}
    sketch = FIGURES["curves"](
        read(write(tmp_path / "c.nc", text, {}, {}, {"C": KNEED}, tables))
    )
    sketch.figure.draw_without_rendering()

    where = "fold-flip at detuning 0.15, slope 0.015 rad"
    assert any(f"Codimension-two points: {where}." in words for words in sketch.words)
    assert [words.get_text() for words in sketch.panels[0].texts] == ["fold-flip"]
    (marks,) = [each for each in sketch.marks if each.label == "fold-flip"]
    assert marks.rows["command"].str.contains("--set detuning=0.15").all()


def test_over_two_keys_a_codimension_two_point_lies_at_both(tmp_path):
    place = {"slope": [0.01] * 2, "key": ["detuning"] * 2, "other_key": ["R"] * 2}
    kinds = ["neimark_sacker"] * 2
    curve = {"curve": [0, 0], "kind": kinds, **place, "value": [0.1, 0.2]}
    met = {"kind": ["fold"], "point": ["cusp"], "value": [0.15], "other_value": [0.25]}
    met |= {name: values[:1] for name, values in place.items()}
    text = 'name = "c"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01]\n'
    text += "[options]\nplane = { detuning = [0.0, 1.0], R = [0.1, 0.4] }\n"
    tables = {"curves": curve | {"other_value": [0.2, 0.3]}, "meetings": met}

    sketch = FIGURES["curves"](
        read(write(tmp_path / "c.nc", text, {}, {}, {"C": KNEED}, tables))
    )

    sketch.figure.draw_without_rendering()

    where = "cusp at detuning 0.15, R 0.25, slope 0.01 rad"
    assert any(f"Codimension-two points: {where}." in words for words in sketch.words)
    (label,) = sketch.panels[0].texts
    assert label.xy == (0.25, 0.15)
    assert any(words.startswith("Neimark–Sacker points over") for words in sketch.words)
    (marks,) = [each for each in sketch.marks if each.label == "cusp"]
    command = marks.rows["command"].iloc[0]
    assert "--set detuning=0.15" in command and "--set R=0.25" in command


def test_a_curve_names_the_unit_of_its_key(tmp_path):
    curve = {
        "curve": [0, 0, 1, 1],
        "kind": np.repeat(["flip", "fold"], 2),
        "key": ["R"] * 4,
        "slope": [0.01, 0.02] * 2,
    }
    text = (
        'name = "curves"\nkind = "curve"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
    )
    tables = {"curves": curve | {"value": [0.1, 0.2] * 2}}
    archive = write(tmp_path / "c.nc", text, {}, {}, {"C": KNEED}, tables)
    with netCDF4.Dataset(archive, "a") as file:
        file["curves/value"].units = "m"
    sketch = FIGURES["curves"](read(archive))
    assert sketch.figure.axes[0].get_title(loc="left") == "R (m)"
    assert sketch.words[1] == "Flips and folds over slope and R."


@pytest.mark.parametrize(
    ("ratios", "said"),
    [([4.5], " is 4.5."), ([4.5, 4.6], "s are 4.5, 4.6."), ([np.nan], "")],
)
def test_the_last_ratios_of_a_cascade_are_counted(tmp_path, ratios, said):
    flips = {
        "slope": [0.01, 0.015, 0.016],
        "kind": ["flip"] * 3,
        "family": ["1"] * 3,
        "period": [1, 2, 4],
    }
    text = 'name = "cascade"\nkind = "cascade"\nwalker = "D"\n[axes]\nslope = [0.01, 0.02]\n'
    tables = {
        "cascade": flips,
        "accumulation": {"slope": [0.0163] * len(ratios), "ratio": ratios},
    }
    sketch = FIGURES["cascade"](
        read(write(tmp_path / "c.nc", text, {}, {}, {"D": POINT}, tables))
    )
    assert sketch.words[3].startswith(f"The last ratio{said}" if said else "")


@pytest.mark.parametrize("lines", [9, 12])
def test_a_bifurcation_diagram_of_many_lines_says_how_many_it_draws(tmp_path, lines):
    radius = np.repeat(np.linspace(0.1, 0.2, lines), 2)
    orbits = {"R": radius, "slope": [0.01, 0.02] * lines, "stance_angle": radius}
    text = 'name = "orbits"\nkind = "orbit"\nwalker = "B"\n[axes]\nslope = [0.01, 0.02]\nR = [0.1, 0.2]\n'
    sketch = FIGURES["bifurcation"](
        read(write(tmp_path / "o.nc", text, {}, {}, {"B": POINT}, {"orbits": orbits}))
    )
    assert sum(bool(axes.lines) for axes in sketch.figure.axes) == 9
    assert ("9 of 12 lines are drawn." in sketch.words[1]) == (lines == 12)


def test_branches_of_one_label_have_one_colour_and_one_entry_in_the_legend(tmp_path):
    slope = np.linspace(0.01, 0.05, 30)
    rows = {
        "branch": np.repeat([0, 1], 30),
        "slope": np.tile(slope, 2),
        "stance_angle": np.append(slope, 2 * slope),
    }
    text = 'name = "b"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, 0.1]\n'
    archive = write(
        tmp_path / "b.nc",
        text,
        {},
        {},
        {"C": KNEED},
        {"branches": rows | {"gait": ["long"] * 60}},
    )
    sketch = FIGURES["locus"](read(archive))
    assert [key.get_label() for key in sketch.keys] == ["long step"]
    assert {
        line.get_color() for line in sketch.panels[0].lines if len(line.get_xdata()) > 1
    } == {WALKERS["C"]}


@pytest.mark.parametrize(("key", "own"), [("R", True), ("foot_mass_ratio", False)])
def test_a_design_map_tells_of_circles_where_it_has_some(tmp_path, key, own):
    side = np.linspace(0.1, 0.3, 3)
    names = (*design_maps.MAPPED, "fastest_slope")
    rows = {
        key: np.repeat(side, 3),
        "c_t": np.tile(side, 3),
        **dict.fromkeys(names, np.arange(9) / 100),
    }
    text = f'name = "d"\nkind = "design"\nwalker = "B"\n[axes]\n{key} = [0.1, 0.3]\nc_t = [0.1]\nslope = [0.01, 0.1]\n'
    walker = POINT | {"R": 0.2, "c_t": 0.2}
    sketch = FIGURES["design"](
        read(write(tmp_path / "d.nc", text, {}, {}, {"B": walker}, {"design": rows}))
    )
    assert (
        ("Circles: the walker itself." in sketch.words[1])
        == own
        == bool(sketch.figure.axes[0].lines)
    )


def test_a_measured_loss_is_not_drawn_among_shares_of_losses(tmp_path):
    losses = {
        f"loss_{part}": lambda s: s for part in ("normal", "tangential", "kneestrike")
    }
    archive = _quantities(tmp_path, **losses, spectral_radius=lambda s: s)
    overlay = {
        "slope": [0.02, 0.05],
        "loss_normal": [3.0, 4.0],
        "spectral_radius": [0.1, 0.2],
    }
    xr.Dataset({k: ("row", v) for k, v in overlay.items()}).to_netcdf(
        archive, mode="a", group="overlay"
    )
    drawn = {
        name: FIGURES[name](read(archive)).figure for name in ("losses", "multipliers")
    }
    assert {name: len(figure.axes[0].containers) for name, figure in drawn.items()} == {
        "losses": 0,
        "multipliers": 1,
    }


def test_a_walker_table_gives_a_command_with_its_base_and_keys(sources):
    drawing = draw(sources["design"], "heatmap", "test")
    words = shlex.split(drawing.panels[0]["command"])
    assert words[:4] == ["gaitsweep", "solve", "--walker", "B"]
    # The script adds the keys along the map, and the slope.
    assert [drawing.panels[0][side]["name"] for side in "xy"] == ["slope", "R"]


def test_a_ladder_of_many_detunings_is_drawn_in_nine_panels(tmp_path):
    drawing = draw(read(synthetic.detuning(tmp_path, 17)), "locus", "test")
    assert drawing.data["detuning"].nunique() == 9
    assert "9 of 17 lines" in drawing.caption


def test_a_sentence_stands_where_its_value_is_given_and_numbers_are_printed():
    texts = {
        "always": "From {low:2} to {high}, {name}.",
        "many": "Of {many} lines.",
        "none": "None.",
    }
    values = {
        "low": 1.26e-5,
        "high": np.float64(0.5),
        "name": "{low}",
        "many": 3,
        "none": 0,
    }
    assert sentences(texts, values) == "From 1.3 × 10⁻⁵ to 0.5, {low}. Of 3 lines."
    assert (
        sentences(texts, values | {"many": "", "none": True})
        == "From 1.3 × 10⁻⁵ to 0.5, {low}. None."
    )


def test_rows_of_maps_are_named_by_what_tells_them_apart():
    every = [{"walker": "B", "c_t": 0.01 * k} for k in range(9)]
    rows, names, words = choose_rows(every)
    assert rows == [every[k] for k in (0, 3, 5, 8)] and names == [
        f"c_t = {0.01 * k:g}" for k in (0, 3, 5, 8)
    ]
    assert words == "Rows, 4 of 9: c_t = 0; c_t = 0.03; c_t = 0.05; c_t = 0.08."
    assert choose_rows(every[:1]) == (every[:1], [""], "")


def test_every_figure_has_its_words():
    # `check` and `diff` are on pages of commands, no figures of a study.
    assert set(WORDS["figures"]) == {"all", "check", "diff", *FIGURES}
    assert all(
        {"title", "caption", "alt", "absent"} <= set(WORDS["figures"][name])
        for name in FIGURES
    )


def test_the_body_closes_as_the_paper_says():
    body = Body.of(KNEED)
    assert body.length == pytest.approx(0.606136, abs=5e-7)
    hip = complex(body.hip(0.0))
    assert body.foot(body.knee(hip, 0.0), 0.0) == pytest.approx(0.2j)
    assert body.knee(hip, 0.0).real < 0


@pytest.mark.parametrize("table", [POINT, KNEED])
def test_both_feet_stand_on_the_ground_at_heelstrike_one_step_apart(table):
    body, angle = Body.of(table), 0.21
    hip = complex(body.hip(angle))
    stance, swing = (body.foot(body.knee(hip, a), a) for a in (angle, -angle))
    assert stance.imag == pytest.approx(body.radius)
    assert swing.imag == pytest.approx(body.radius)
    contacts = [
        foot.real + body.radius * a for foot, a in ((stance, angle), (swing, -angle))
    ]
    assert contacts[0] - contacts[1] == pytest.approx(
        2 * (body.length * np.sin(angle) + body.radius * angle)
    )


def test_a_traced_step_ends_where_the_next_begins(sources):
    for step in some(traced_steps(sources["transition"])):
        first, last = step.frame.iloc[0], step.frame.iloc[-1]
        assert last["theta_st"] == pytest.approx(first["theta_th"], abs=1e-3)
        assert last["theta_th"] == pytest.approx(first["theta_st"], abs=1e-3)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0153, "0.0153"),
        (-3.0, "−3"),
        (1.2e-6, "1.2 × 10⁻⁶"),
        (1e-9, "10⁻⁹"),
        (float("nan"), "–"),
    ],
)
def test_numbers_are_written_as_people_write_them(value, text):
    assert plain(value) == text


def test_an_orbit_beyond_the_loss_of_walking_is_called_a_transient_and_each_interval_what_it_is(
    tmp_path,
):
    slopes = np.array([0.0185, 0.019, 0.01906])

    def page(walker, upto):
        mark = {"landmark": [f"{walker} loss of walking"], "walker": [walker], "point": [""], "printed": [0.019],
                "half_unit": [5e-4], "slope": [0.01904], "stance_angle": [np.nan],
                "slope_low": [0.01803], "slope_high": [0.01905]}  # fmt: skip
        rows = {"walker": [walker] * upto, "slope": slopes[:upto]}
        orbits, survival = (
            {"stance_angle": np.full(upto, 0.24)},
            {"starts": [2] * upto, "strides": [1152] * upto},
        )
        text = f'name = "orbits"\nkind = "orbit"\nwalker = "{walker}"\n[axes]\nslope = [0.0185, 0.019, 0.01906]'
        tables = {"orbits": rows | orbits, "crises": mark, "survival": rows | survival}
        source = read(
            write(
                tmp_path / f"{walker}-{upto}.nc", text, {}, {}, {walker: KNEED}, tables
            )
        )
        drawing = draw(source, "bifurcation", "test")
        return (
            drawing.caption + drawing.finding,
            html_tables.landmarks(source)[0].note,
            drawing.svg,
        )

    caption, note, svg = page("D", 3)
    assert (
        "beyond the loss of walking are transients, not yet fallen after 576 steps"
        in caption
    )
    assert (
        "computed 0.01904 (between 0.01803 and 0.01905)" in caption
        and "rounding range" not in svg
    )
    assert "bracket" in note and "rounding" not in note + caption
    assert "transients" not in page("D", 2)[0]
    for walker, words, noted in (
        ("C", "0.018–0.0191 with exact tuning", "allows (of C with exact tuning)."),
        (
            "C-printed",
            "0.018–0.0191 with the parameters as printed",
            "parameters allows.",
        ),
    ):
        caption, note, svg = page(walker, 3)
        assert words in caption and note.endswith(noted) and "rounding range" in svg


def test_eight_walkers_are_drawn_and_of_more_the_caption_says_how_many(tmp_path):
    for count, said in ((8, ""), (9, "8 of 9 walkers are drawn.")):
        names = [f"w{k}" for k in range(count)]
        text = f'name = "many"\nwalker = {names}\n[axes]\nslope = [0.01]'
        walkers = {name: KNEED | {"c_t": 0.02 * k} for k, name in enumerate(names)}
        source = read(write(tmp_path / f"{count}.nc", text, {}, {}, walkers))
        for name in ("walker", "conditions"):
            drawing = draw(source, name, "test")
            assert drawing.data["walker"].nunique() == 8 and drawing.caption.endswith(
                said
            )
            assert ("are drawn" in drawing.caption) == bool(said)


def test_walkers_that_look_alike_are_drawn_once_under_their_names(tmp_path):
    walkers = {
        "free": KNEED,
        "locked": KNEED | {"knees": False},
        "heavier": KNEED | {"m_h": 9.0},
    }
    text = f'name = "alike"\nwalker = {list(walkers)}\n[axes]\nslope = [0.01]'
    source = read(write(tmp_path / "a.nc", text, {}, {}, walkers))
    sketch = FIGURES["walker"](source)
    assert [axes.get_title() for axes in sketch.panels] == ["free, locked", "heavier"]
    assert set(sketch.data["walker"]) == {"free, locked", "heavier"}
    assert FIGURES["conditions"](source).data["walker"].tolist() == list(walkers)


def test_power_is_drawn_without_dimensions_where_the_speed_is_archived_so(tmp_path):
    dims, slopes = ("slope", "gait"), np.array([0.01, 0.02])
    grid = {"stance_angle": (dims, np.full((2, 1), 0.2)), "spectral_radius": (dims, np.full((2, 1), 0.5)),
            "froude_speed": (dims, np.array([[0.1], [0.3]])), "power": (dims, np.array([[7.0], [9.0]])),
            "speed": (dims, np.array([[0.5], [0.6]]))}  # fmt: skip
    text = 'name = "p"\nwalker = "A"\n[axes]\nslope = [0.01, 0.02]'
    coords = {"slope": slopes, "gait": np.array(["long"], object)}
    sketch = FIGURES["power"](
        read(write(tmp_path / "p.nc", text, grid, coords, {"A": POINT}))
    )
    # P = m g v sin γ.
    assert np.allclose(
        sketch.data["power P/(m g √(g l))"],
        [0.1 * np.sin(0.01), 0.3 * np.sin(0.02)],
        rtol=1e-14,
    )
    (axes,) = sketch.panels
    assert axes.get_xlabel() == "speed v/√(gl)" and "P/(m g √(g l))" in axes.get_title(
        loc="left"
    )


def test_contours_are_dark_on_the_light_half_of_a_map_and_cells_without_a_gait_are_hatched():
    assert on_map(0.1, 0, 1) == "#ffffff" and on_map(0.9, 0, 1) == "#101418"
    axes = Figure().subplots()
    hatch(axes)
    assert axes.patch.get_hatch() and axes.patch.get_linewidth() == 0


def test_a_page_tells_each_legend_once(sources):
    told = set()
    first, second = (
        draw(sources["transition"], name, "x", told=told)
        for name in ("loglog", "linear")
    )
    assert first.svg.count(">long step<") == 1 and second.svg.count(">long step<") == 0
    assert draw(sources["transition"], "linear", "x").svg.count(">long step<") == 1


def test_the_largest_exponent_and_the_survival_of_orbits_are_drawn(tmp_path):
    slopes = np.array([0.015, 0.018, 0.019])
    exponents = {
        "slope": np.repeat(slopes, 2),
        "index": [0, 1] * 3,
        "exponent": [-0.2, -1, 0.1, 5, 0.3, -1],
        "standard_error": [0.02] * 6,
    }
    lives = {"slope": slopes, "lifetime": [np.inf, np.inf, 40.0]}
    text = 'name = "o"\nkind = "orbit"\nwalker = "D"\n[axes]\nslope = [0.015, 0.018, 0.019]'
    tables = {"lyapunov": exponents, "survival": lives}
    sketch = FIGURES["lyapunov"](
        read(write(tmp_path / "o.nc", text, {}, {}, {"D": POINT}, tables))
    )
    top, below = sketch.panels
    assert top.lines[1].get_ydata().tolist() == [-0.2, 0.1, 0.3] and below.lines[
        0
    ].get_ydata().tolist() == [40.0]
    said = sketch.words[3]
    assert said.endswith("from 0.018 to 0.019 rad at all 2 slopes (D).")
    tips = [mark.tips for mark in sketch.marks]
    assert [each["slope"] for each in tips] == ["γ (rad)"] * 2
    assert tips[0]["exponent"] == "exponent (per step)"
    assert tips[1]["lifetime"] == "lifetime (steps)"
    # A line that is alone has its walker's name in the CSV file.
    assert set(sketch.data["line"]) == {"D"}


@pytest.mark.parametrize(
    ("units", "title", "told"),
    [("SI", "period (s)", "s"), ("1", "period", "own units")],
)
def test_periods_have_the_units_of_their_walkers(tmp_path, units, title, told):
    slope, dims = np.geomspace(0.01, 0.1, 40), ("slope", "gait")
    angle = np.stack([slope, 2 * slope], 1)
    grid = {"stance_angle": (dims, angle), "period": (dims, 1 + angle)}
    grid["walker_units"] = ((), np.array(units, object))
    coords, text = {"slope": slope, "gait": GAITS}, 'name = "q"\nwalker = "C"\n[axes]\n'
    archive = write(
        tmp_path / "q.nc",
        text + "slope = [0.01]\n",
        grid,
        coords,
        {"C": KNEED | {"units": units}},
    )

    sketch = FIGURES["linear"](read(archive))

    assert {mark.tips["period"] for mark in sketch.marks} == {title}
    assert set(sketch.data["period_unit"]) == {told}


def test_columns_that_tell_little_stand_last_and_a_long_table_is_an_excerpt():
    n = 80
    frame = pd.DataFrame(
        {
            "walker": ["C"] * n,
            "branch": range(n),
            "slope": np.linspace(0, 1, n),
            "period": [2.0] * n,
        }
    )
    table = html_tables.named("special_points", frame)
    assert table.heads == ["γ", "walker", "T", "branch"]
    assert len(table.rows) == 12 and "68 more rows are in the archive." in table.note
    assert list(table.frame) == list(frame)


def _present(panels):
    """For each map, whether there is a gait in each of its cells; `as` names an earlier
    map with the same.
    """
    for panel in panels:
        field = panel["fields"]["present"]
        field = panels[field["as"]]["fields"]["present"] if "as" in field else field
        digits = iter(field["text"])
        yield [field["words"][fields._DIGITS.index(word)] for word in digits
               for _ in range(fields._DIGITS.index(next(digits)) + 1)]  # fmt: skip


def test_a_design_map_leads_to_its_walkers(sources):
    panels = draw(sources["design"], "design", "test").panels
    cells = list(_present(panels))
    assert sum(map(len, cells)) == 27
    assert sorted([panels[0]["x"]["name"], panels[0]["y"]["name"]]) == ["R", "c_t"]
    assert [0.08, 0.1, 0.12] in [panels[0][side]["values"] for side in "xy"]
    assert shlex.split(panels[0]["command"])[:2] == ["gaitsweep", "solve"]
    # Three walkers are never stable: no slope to solve them at.
    assert sum(map(sum, cells)) == 24


def _cube(tmp_path, heights):
    """A map over radius and slope at several heights, each known by its speed."""
    radius, slope = np.array([0.1, 0.2, 0.3]), np.array([0.01, 0.02])
    speed = (
        10 * heights[:, None, None, None]
        + radius[:, None, None]
        + slope[:, None]
        + np.array([0.0, 0.5])
    )
    text = 'name = "cube"\nwalker = "B"\n[axes]\nslope = [0.01]\n[want]\nfigures = ["heatmap"]\n'
    # The longest axes last: the map is over the first two.
    grid = {"speed": (("R", "slope", "c_t", "gait"), np.moveaxis(speed, 0, 2))}
    coords = {
        "R": radius,
        "slope": slope,
        "c_t": heights,
        "gait": np.array(["long", "short"], object),
    }
    return draw(
        read(write(tmp_path / "cube.nc", text, grid, coords, {"B": POINT})),
        "heatmap",
        "test",
    )


def test_a_heatmap_of_three_axes_is_a_row_of_maps_for_each_value_of_the_third(tmp_path):
    drawing = _cube(tmp_path, np.array([0.08, 0.1, 0.12]))
    assert "Rows: c_t = 0.08; c_t = 0.1; c_t = 0.12." in drawing.caption
    assert set(drawing.data["c_t"]) == {0.08, 0.1, 0.12} and len(drawing.data) == 36
    np.testing.assert_allclose(
        drawing.data["speed"]
        - 10 * drawing.data["c_t"]
        - drawing.data["R"]
        - drawing.data["slope"],
        0.5 * (drawing.data["gait"] == "short"),
        atol=1e-12,
    )
    commands = [
        shlex.split(panel["command"]) for panel in drawing.panels if "command" in panel
    ]
    assert {
        word for words in commands for word in words if word.startswith("c_t=")
    } == {
        "c_t=0.08",
        "c_t=0.1",
        "c_t=0.12",
    }
    assert drawing.svg.count("c_t = 0.1<") == 2


def test_a_heatmap_of_many_values_says_which_it_draws(tmp_path):
    drawing = _cube(tmp_path, np.linspace(0.05, 0.15, 11))
    assert (
        "Rows, 4 of 11: c_t = 0.05; c_t = 0.08; c_t = 0.12; c_t = 0.15."
        in drawing.caption
    )


def test_a_design_map_of_a_third_key_says_which_values_it_draws(tmp_path):
    key, height, thigh = (
        np.ravel(a)
        for a in np.meshgrid([0.1, 0.2], [0.08, 0.1], [0.3, 0.4, 0.5], indexing="ij")
    )
    best = {
        "R": key,
        "c_t": height,
        "l_t": thigh,
        "smallest_slope": thigh,
        "largest_stable_slope": thigh,
        "fastest_froude_speed": thigh,
        "fastest_slope": thigh / 10,
    } | synthetic.states(dict.fromkeys(("smallest", "largest", "fastest"), thigh))
    axes = "R = [0.1]\nc_t = [0.1]\nl_t = [0.3]\nslope = [0.1]"
    text = f'name = "d"\nwalker = "B"\n[axes]\n{axes}\n[want]\nfigures = ["design"]'
    coords = {"R": np.unique(key), "c_t": np.unique(height), "l_t": np.unique(thigh)}
    drawing = draw(
        read(
            write(tmp_path / "d.nc", text, {}, coords, {"B": POINT}, {"design": best})
        ),
        "design",
        "test",
    )
    assert (
        "Rows: l_t = 0.3; l_t = 0.4; l_t = 0.5." in drawing.caption
        and len(drawing.data) == 12
    )
    commands = [
        shlex.split(panel["command"]) for panel in drawing.panels if "command" in panel
    ]
    assert sum(map(len, _present(drawing.panels))) == 36 and {
        w for c in commands for w in c if w.startswith("l_t=")
    } == {
        "l_t=0.3",
        "l_t=0.4",
        "l_t=0.5",
    }


def test_a_fine_design_map_has_labelled_contours_and_marks_the_tuned_and_the_physical_walker(
    tmp_path,
):
    mass, detuning = np.linspace(0.0, 5.97, 20), np.linspace(0.005, 1.0, 30)
    m, d = (np.ravel(a) for a in np.meshgrid(mass, detuning, indexing="ij"))
    quantity = 0.01 * d * (1 + 0.2 * m)
    best = {
        "m_h": m,
        "detuning": d,
        "smallest_slope": quantity,
        "largest_stable_slope": np.where(d < 0.6, 0.05 - quantity, np.nan),
        "fastest_froude_speed": 0.2 + quantity,
        "fastest_slope": quantity,
        "surveyed": np.zeros(len(m)),
    }
    axes = "m_h = { from = 0.0, to = 5.97, n = 20 }\ndetuning = { from = 0.005, to = 1.0, n = 30 }\nslope = [1e-6, 0.4]"
    text = f'name = "d"\nkind = "design"\nwalker = "A"\n[axes]\n{axes}\n[want]\nfigures = ["design"]'
    source = read(
        write(
            tmp_path / "d.nc",
            text,
            {},
            {"m_h": mass, "detuning": detuning},
            {"A": POINT},
            {"design": best},
        )
    )
    with style():
        sketch = FIGURES["design"](source)
    maps = [axes for axes in sketch.figure.axes if axes.get_label() != "<colorbar>"]
    assert len(maps) == 3 and len(sketch.figure.axes) == 6
    for axes in maps:
        # Two rings, one white and one black, around each walker: at the border of the
        # map, one step beside its cells.
        places = [tuple(line.get_xydata()[0]) for line in axes.lines]
        assert sorted(places) == sorted([(0.0, 0.0), (1.0, 0.0)] * 2)
        assert axes.get_xlim()[0] < 0.005 and axes.texts
    assert (
        "Circles: the exactly tuned walker (detuning 0) and the physical one (1)."
        in sketch.words[1]
    )
    assert "surveyed" not in sketch.data and len(sketch.data) == 600
    drawing = draw(source, "design", "test")
    assert sum(len(target["rows"]) for target in drawing.targets) <= 260


def test_numbers_have_six_digits_and_errors_two():
    frame = pd.DataFrame(
        {
            "slope": [0.0150884379411195, 0.02, 1e-6],
            "error_bound": [1.3e-14, 0.03, 1e-3],
        }
    )
    assert [c.text for c in cells.column_cells("slope", frame)] == [
        "0.0150884",
        "0.02",
        "10⁻⁶",
    ]
    assert [c.value for c in cells.column_cells("slope", frame)] == list(frame["slope"])
    assert [c.text for c in cells.column_cells("error_bound", frame)] == [
        "1.3 × 10⁻¹⁴",
        "0.03",
        "0.001",
    ]


def test_comparable_numbers_of_a_column_have_the_same_decimals():
    frame = pd.DataFrame(
        {
            "period": [0.757, 1.1],
            "mixed": [1e-6, 3.0],
            "zero": [0.0, 1.23456789],
            "walks": [1, 0],
        }
    )
    assert [c.text for c in cells.column_cells("period", frame)] == ["0.757", "1.100"]
    assert [c.text for c in cells.column_cells("mixed", frame)] == ["10⁻⁶", "3"]
    assert [c.text for c in cells.column_cells("zero", frame)] == ["0", "1.23457"]
    assert [c.text for c in cells.column_cells("walks", frame)] == ["yes", "no"]


def test_the_ends_of_an_interval_are_told_apart():
    frame = pd.DataFrame(
        {"low": [0.0182933977], "high": [0.0182933982], "slope": [0.018293398]}
    )
    low, high = (cells.column_cells(name, frame)[0].text for name in ("low", "high"))
    assert low != high and "(" not in low


@pytest.mark.parametrize("share", [1e-3, 1e-7, 1e-12, 2**-52])
def test_two_values_that_differ_are_told_apart(share):
    """Down to neighbours among doubles."""
    first = np.array([0.0182933977, 1.0, -4.75, 7.0])
    second = first * (1 + share)
    second[3] = 7.0
    frame = pd.DataFrame({"first": first, "second": second})

    one, other = (cells.column_cells(name, frame) for name in frame)

    differ = [a.text != b.text for a, b in zip(one, other, strict=True)]
    assert differ == [True, True, True, False]
    assert [c.text for c in (one[3], other[3])] == ["7", "7"]


def test_values_that_are_absent_or_infinite_have_no_digits_to_tell_apart():
    frame = pd.DataFrame(
        {"first": [np.inf, np.inf, np.nan, 0.0], "second": [np.inf, 1.0, 1.0, 0.0]}
    )

    one, other = (cells.column_cells(name, frame) for name in frame)

    assert [c.text for c in one] == ["∞", "∞", "–", "0"]
    assert [c.text for c in other] == ["∞", "1", "1", "0"]


def test_a_title_over_all_panels_is_that_of_each_whatever_stands_above_it():
    figure = Figure()
    panels = figure.subplots(1, 2)
    panels[0].set_title("(a) detuning = 0", loc="left")
    panels[0].set_xlabel("slope (rad)")
    assert [title_of(panels[0], side) for side in "xy"] == [
        "slope (rad)",
        "(a) detuning = 0",
    ]
    figure.supylabel("stance angle (rad)")
    assert [title_of(axes, "y") for axes in panels] == ["stance angle (rad)"] * 2
    assert title_of(panels[1], "x") == ""


def test_what_is_drawn_in_radians_has_second_axes_in_degrees():
    figure = Figure()
    panels = figure.subplots(2, 2, sharex=True)
    for axes in panels.ravel():
        axes.plot([0.0, 0.1], [0.1, 0.3])
        axes.set_title("stance angle (rad)", loc="left")
    panels[1][0].set_xlabel("slope (rad)")
    panels[0][1].set_yscale("log")
    panels[1][1].set_title("speed", loc="left")
    add_degrees(figure)
    figure.draw_without_rendering()
    # Those on top share the slope below; of the heights one is logarithmic and one a
    # speed.
    seconds = [[axes.child_axes for axes in row] for row in panels]
    assert [[len(axes) for axes in row] for row in seconds] == [[2, 1], [1, 0]]
    top, right = seconds[0][0]
    assert top.get_xlim() == pytest.approx(np.degrees(panels[0][0].get_xlim()))
    assert right.get_ylim() == pytest.approx(np.degrees(panels[0][0].get_ylim()))
    labels = [label.get_text() for label in right.get_yticklabels()]
    assert (
        labels == [f"{tick:g}°" for tick in right.get_yticks()]
        and 3 <= len(labels) <= 6
    )


@pytest.mark.parametrize(
    ("low", "high"), [(0.0155, 0.0185), (0.01, 0.05), (1e-3, 0.1), (1e-6, 0.1)]
)
def test_ticks_of_a_logarithmic_axis_differ(low, high):
    axes = Figure().subplots()
    set_log(axes, "x")
    axes.set_xlim(low, high)
    axes.figure.draw_without_rendering()
    labels = [label.get_text() for label in axes.get_xticklabels() if label.get_text()]
    assert len(labels) == len(set(labels)) > 1


def test_fitted_lines_are_those_of_the_lines_own_foot_mass_ratio(tmp_path):
    """The lightest feet had the lines of all ratios near zero."""
    ratios = np.array([1e-8, 1e-9])
    fits = {
        "foot_mass_ratio": ratios,
        "fitted_exponent": np.ones(2),
        "fitted_amplitude": np.ones(2),
        "fitted_cube_root": np.ones(2),
        "slope_transition_fitted": np.array([2e-4, 1e-4]),
    }
    slope = np.geomspace(1e-6, 0.1, 30)
    dims = ("foot_mass_ratio", "slope", "gait")
    grid = {"stance_angle": (dims, np.tile(slope[:, None] ** (1 / 3), (2, 1, 2)))}
    coords = {"foot_mass_ratio": ratios, "slope": slope, "gait": GAITS}
    study = (
        'name = "light"\nwalker = "E"\n[axes]\nslope = [0.1]\n'
        "foot_mass_ratio = [1e-8, 1e-9]\n"
    )
    tables = {"fits/transition": fits}
    archive = write(tmp_path / "light.nc", study, grid, coords, {"E": POINT}, tables)

    said = FIGURES["loglog"](read(archive)).values["crossings"]

    assert said == "They cross at 0.0002 (ρ = 10⁻⁸) and 0.0001 (ρ = 10⁻⁹)."


def test_the_data_of_a_figure_says_in_words_what_is_stable():
    sketch = Sketch("residuals", 100).finish(
        pd.DataFrame({"slope": [0.1, 0.2, 0.3], "stable": [1.0, 0.0, np.nan]})
    )
    assert (
        sketch.data["stable"].tolist()[:2] == ["yes", "no"]
        and sketch.data["stable"].isna().sum() == 1
    )
    assert (sketch.values["stable_low"], sketch.values["stable_high"]) == (0.1, 0.1)
    assert folder.csv_text(sketch.data).splitlines()[1:] == [
        "0.1,yes",
        "0.2,no",
        "0.3,",
    ]


def test_words_of_guides_and_landmarks_stand_beside_the_curves():
    figure = canvas(200)
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1])
    draw_guide(axes, 0.5, "swing leg at rest")
    (words,) = axes.texts
    figure.draw_without_rendering()
    assert (
        words.get_window_extent().x0 >= axes.bbox.x1
        and words.get_window_extent().x1 <= figure.bbox.x1
    )
    row = {
        "walker": "D",
        "printed": 0.5,
        "half_unit": 0.05,
        "slope": 0.6,
        "slope_low": 0.55,
        "slope_high": 0.65,
    }
    landmarks.draw_over_slopes(axes, pd.DataFrame([row]))
    figure.draw_without_rendering()
    lowest = axes.transData.transform((0, 0))[1]
    assert len(axes.texts) == 3 and all(
        text.get_window_extent().y1 <= lowest for text in axes.texts[1:]
    )


def test_a_design_map_says_where_its_best_walkers_are(sources):
    finding = draw(sources["design"], "design", "design").finding
    table = sources["design"].table("design", "smallest_slope", "fastest_froude_speed")
    assert f"γ (rad): {plain(table['smallest_slope'].min())} (" in finding
    assert f"v/√(gl): {plain(table['fastest_froude_speed'].max())} (" in finding
    assert re.search(
        r"^Smallest slope γ \(rad\): \S+ \(.+ = .+\)\. Largest stable γ \(rad\): \S+ \(.+\)\. F",
        finding,
    )


def _volume(tmp_path, sizes, walkers=("B",)):
    """An archive of a grid of several axes, whose speed tells the place; the gait of the
    first place lacks.
    """
    names = ("R", "slope", "c_t", "l_t", "m_t", "m_h")[: len(sizes)]
    values = [np.linspace(0.1, 0.2, size) for size in sizes]
    dims = ("walker", *names, "gait")
    shape = (len(walkers), *sizes, 2)
    angle = 0.1 + np.arange(np.prod(shape)).reshape(shape) / np.prod(shape)
    angle.flat[0] = np.nan
    grid = {
        "stance_angle": (dims, angle),
        "stance_rate": (dims, -1.5 * angle),
        "thigh_rate": (dims, -0.5 * angle),
        "speed": (dims, 2 * angle),
        "status": (dims, np.isnan(angle).astype("i1")),
    }
    coords = dict(zip(names, values, strict=True)) | {"gait": GAITS}
    axes = "\n".join(f"{name} = [0.1]" for name in names)
    given = str(list(walkers)).replace("'", '"')
    text = (
        f'name = "v"\nwalker = {given}\n[axes]\n{axes}\n[want]\nfigures = ["heatmap"]'
    )
    coords |= {"walker": np.array(walkers, object)}
    return read(
        write(tmp_path / "v.nc", text, grid, coords, dict.fromkeys(walkers, POINT))
    )


def test_slices_hold_all_gaits_of_a_grid(tmp_path):
    source = _volume(tmp_path, (9, 12, 3), ("B", "<b>"))

    held = slices.volume(source)

    # The longest axes last.
    assert [axis["name"] for axis in held["axes"]] == ["c_t", "R", "slope"]
    assert [line["at"]["walker"] for line in held["lines"]] == ["B", "<b>"]
    assert held["quantities"][0] == ["speed", "speed v"] and held["every"] == 324
    # In the order in which the page's script counts them; browsers read them back.
    encoded = held["fields"]["speed"]
    speed = source.grid["speed"].transpose(..., "R", "slope")
    expected = [
        speed.isel(walker=w, gait=g, c_t=c).values
        for w, g, c in itertools.product(range(2), range(2), range(3))
    ]
    assert encoded["log"] and encoded["step"] == pytest.approx(1e-4)
    assert encoded["texts"] == [
        fields.numbers(part, encoded["step"], True)["text"] for part in expected
    ]
    present = held["fields"]["present"]
    assert present["words"] == [False, True] and present["text"].startswith("00")


def test_slices_say_which_gaits_have_a_quantity(tmp_path):
    """Times of kneestrike of walkers without knees were 1."""
    source = _volume(tmp_path, (9, 12, 3), ("B", "<b>"))
    speed = source.grid["speed"]
    is_kneed = xr.DataArray([True, False], dims="walker")
    source.grid["kneestrike_time"] = speed.where(is_kneed)
    source.grid["unlocking_torque"] = speed.where(False)

    held = slices.volume(source)

    names = [name for name, _ in held["quantities"]]
    assert "kneestrike_time" in names and "unlocking_torque" not in names
    own = held["fields"]["kneestrike_time"]["present"]
    assert own != held["fields"]["present"] and own["words"] == [False, True]
    assert "present" not in held["fields"]["speed"]


def test_no_line_over_a_key_joins_curves_between_which_a_label_passes():
    """The label of a curve that ends passed to another, and a line led there."""
    angle = xr.DataArray(
        [[0.30, 0.10], [0.31, 0.09], [0.32, 0.21], [0.33, 0.22]],
        dims=("push_off", "gait"),
    )
    goes_on = continued.goes_on(angle, "push_off").reshape(4, 2)
    assert goes_on.tolist() == [[True, True], [True, False], [True, True], [False] * 2]
    across = continued.goes_on(angle.transpose(), "push_off").reshape(2, 4)
    assert (across == goes_on.T).all()


def test_gaits_over_a_key_are_of_unknown_stability_where_their_radius_is():
    """They counted as unstable ones."""
    radius = xr.DataArray(
        [[0.5], [np.nan], [1.5]],
        {"push_off": [0.1, 0.2, 0.3], "gait": ["long"]},
        dims=("push_off", "gait"),
    )
    here = xr.Dataset({"spectral_radius": radius, "stance_angle": 0 * radius + 0.2})
    here = here.assign_coords(slope=0.0)

    rows = over_key._rows(here, "push_off")

    assert rows["stable"].tolist() == pytest.approx([1.0, np.nan, 0.0], nan_ok=True)


def test_lines_side_by_side_go_on_where_values_are_few():
    """Every gait is nearer to the other line's next one than to its own, but not to
    where its own leads.
    """
    at = np.array([0.1, 0.2, 0.4, 0.8])
    angle = np.sqrt(at)[:, None] * [1.0, 1.1]
    angle = xr.DataArray(angle, {"push_off": at}, dims=("push_off", "gait"))
    goes_on = continued.goes_on(angle, "push_off").reshape(4, 2)
    assert goes_on.tolist() == [[True, True]] * 3 + [[False, False]]


@pytest.mark.parametrize("sizes", [(8, 8, 8, 8, 8, 8), (200, 90, 12)])
def test_slices_of_a_large_grid_say_of_how_many_points_they_are(tmp_path, sizes):
    held = slices.volume(_volume(tmp_path, sizes))

    lengths = [len(axis["values"]) for axis in held["axes"]]
    assert held["every"] == np.prod(sizes) > held["held"] == np.prod(lengths)
    assert held["held"] <= 12_000
    characters = sum(
        len(text)
        for name, field in held["fields"].items()
        if name != "present"
        for text in field["texts"]
    )
    assert characters <= 130_000


def test_a_grid_of_two_axes_has_no_slices(tmp_path):
    assert slices.volume(_volume(tmp_path, (5, 4))) == {}


def test_what_meets_on_a_curve_is_named_in_its_table_though_all_points_have_one_name():
    columns = {"kind": ["flip", "fold"], "point": ["fold-flip"] * 2, "slope": [0.1] * 2}
    heads = html_tables.named("meetings", pd.DataFrame(columns)).heads
    assert heads == ["kind", "point", "γ"]


def test_numbers_that_would_touch_on_a_narrow_page_are_left_out_there(tmp_path):
    with style():
        sketch = Sketch("diff", 200, 1, 2)
        for axes, decimals in zip(sketch.panels, (1, 4), strict=True):
            axes.set_xlim(0, 1)
            axes.set_xticks(np.linspace(0, 1, 6))
            axes.xaxis.set_major_formatter(f"{{x:.{decimals}f}}")
        figure = render(
            sketch.finish(pd.DataFrame(), variables="speed"), "diff", "s", False
        )

    crowded = re.findall(r'<g class="crowded"> *<text[^>]*>([^<]*)', figure.svg)
    shown = {text.strip() for text in re.findall(r"<text[^>]*>([^<]*)", figure.svg)}
    # The first of the second panel would touch the last of the first.
    assert [text.strip() for text in crowded] == ["0.0000", "0.4000", "0.8000"]
    assert {"0.0", "0.2", "0.4", "0.6", "0.8", "1.0", "0.2000"} <= shown


@pytest.mark.parametrize(("length", "is_wide"), [(10, False), (120, True)])
def test_a_figure_whose_words_would_leave_a_narrow_page_keeps_its_size(length, is_wide):
    with style():
        sketch = Sketch("diff", 200)
        words = sketch.panels[0].text(0.5, 0.5, "m" * length, fontsize=7, ha="center")
        words.set_in_layout(False)
        figure = render(
            sketch.finish(pd.DataFrame(), variables="speed"), "diff", "s", False
        )

    assert figure.is_wide == is_wide


def test_a_legend_makes_no_figure_wide_as_narrow_pages_tell_it_below():
    with style():
        sketch = Sketch("diff", 200)
        sketch.key("m" * 70)
        sketch.draw_legend(set())
        figure = render(
            sketch.finish(pd.DataFrame(), variables="speed"), "diff", "s", False
        )

    assert "m" * 70 in figure.svg
    assert not figure.is_wide


def test_small_pictures_close_what_they_open():
    """A group that closes itself took the end of the one around it away."""
    picture = '<svg><g><g id="a"/></g> <g id="b"> </g><g class="c"><path/></g></svg>'

    assert svg._small(picture) == '<svg> <g class="c"><path/></g></svg>'


def test_marks_of_small_pictures_keep_their_form():
    """Rounded to whole numbers, a dot is nothing, and draws nothing."""
    picture = '<svg viewBox="0 0 9 9"><path id="m1" d="M 0 0.456 "/><path d="M 7.89 1 "/></svg>'

    small = svg._adapt(picture, 0)

    assert 'd="M 0 0.45 "' in small and 'd="M 7 1 "' in small


def test_titles_of_maps_stay_apart_on_a_narrow_page(sources):
    figure = draw(sources["design"], "design", "test")
    lefts = sorted({axes["box"][0] for axes in figure.axes})

    # Of words on several lines each is placed on its own.
    placed = re.findall(r'translate\(([\d.]+) [\d.]+\)">([^<]*)', figure.svg)

    assert {round(float(x), 2) for x, _ in placed} == {*lefts} and len(lefts) == 3
    for x, text in placed:
        end = float(x) + 0.55 * NARROW_WORDS * len(text.strip())
        assert end < min((y for y in lefts if y > float(x) + 1), default=figure.width)


def _level_beyond(slope):
    """Stance angles that leave free the room of an inset."""
    return 0.3 * np.minimum(1, slope / 0.02) ** 0.3


def _crowded(folder, lines, crowd, shape=_level_beyond):
    """Lines of a branch of a shape, the first with special points that crowd at the
    origin, and one apart.
    """
    slope = np.linspace(0.0, 0.2, 201)
    angle = shape(slope)
    branches = {name: [] for name in ("walker", "detuning", "slope", "stance_angle")}
    for line in range(lines):
        branches["walker"] += ["C"] * len(slope)
        branches["detuning"] += [0.1 * line] * len(slope)
        branches["slope"] += slope.tolist()
        branches["stance_angle"] += angle.tolist()

    at = [0.002 * (k + 1) for k in range(crowd)] + [0.15]
    special = {"walker": ["C"] * len(at), "detuning": [0.0] * len(at)}
    special |= {"kind": ["fold"] * len(at), "slope": at}
    special["stance_angle"] = np.interp(at, slope, angle).tolist()

    values = ", ".join(f"{0.1 * line:g}" for line in range(lines))
    text = 'name = "b"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.0, 0.2]\n'
    tables = {"branches": branches, "special_points": special}
    return read(
        write(
            folder / "b.nc",
            f"{text}detuning = [{values}]\n",
            {},
            {},
            {"C": KNEED},
            tables,
        )
    )


@pytest.mark.parametrize("lines", [1, 3])
def test_a_corner_in_which_special_points_crowd_is_enlarged(tmp_path, lines):
    sketch = FIGURES["locus"](_crowded(tmp_path, lines, 3))

    insets = [axes.child_axes for axes in sketch.panels]
    assert [len(found) for found in insets] == [1] + [0] * (lines - 1)
    (inset,) = insets[0]
    # It holds the points that crowd, and not the one apart, with some margin.
    (right, top) = inset.get_xlim()[1], inset.get_ylim()[1]
    assert 0.006 < right < 1.5 * 0.006
    (drawn,) = [line for line in inset.lines if line.get_linestyle() == "None"]
    assert drawn.get_xdata().tolist() == [0.002, 0.004, 0.006]
    assert max(drawn.get_ydata()) < top
    # The branch is drawn in it too, and its place is framed in the panel.
    assert any(len(line.get_xdata()) > 100 for line in inset.lines)
    assert any(
        list(line.get_xdata()) == [0, right, right] for line in sketch.panels[0].lines
    )
    assert "enlarged" in sketch.words[1]


def test_no_corner_is_enlarged_where_few_points_lie_or_a_curve_is_in_the_way(tmp_path):
    for crowd, shape in ((2, _level_beyond), (3, lambda slope: 40 * slope**3)):
        sketch = FIGURES["locus"](_crowded(tmp_path, 1, crowd, shape))
        assert not sketch.panels[0].child_axes
        assert "enlarged" not in sketch.words[1]
