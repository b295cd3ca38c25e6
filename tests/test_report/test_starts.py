"""The starts that a page holds for its script: lines with their walkers and branches,
lattices of maps, addresses.
"""

import json
import re
from dataclasses import replace
from urllib.parse import parse_qs

import numpy as np
import pandas as pd
import pytest

from gaitsweep.pipeline.report import html_tables, pages
from gaitsweep.pipeline.report.figures import draw, fields, starts
from gaitsweep.pipeline.report.source import read
from test_report.shape import KNEED, POINT, write

RATES = ("stance_rate", "thigh_rate", "shank_rate")


def _grid(folder, varied=None, columns=None):
    """Two lines of a folded curve: a lower piece that rises in slope to 0.08, and an
    upper one that returns.
    """
    slope = np.linspace(0.01, 0.1, 46)
    below, above = 2 * slope, np.where(slope > 0.02, 0.4 - slope, np.nan)
    below = np.where(slope < 0.08, below, np.nan)
    angle = np.stack([np.stack([above, below], -1)] * 2)
    dims = ("foot_mass_ratio", "slope", "gait")
    piece = np.broadcast_to([1, 0], angle.shape).astype("i2")
    grid = {
        "stance_angle": (dims, angle),
        **{name: (dims, -(k + 1) * angle) for k, name in enumerate(RATES)},
        "spectral_radius": (dims, 0.5 + 10 * angle),
        "branch": (dims, np.where(np.isnan(angle), -1, 0).astype("i2")),
        "piece": (dims, piece),
        **{
            key: (("foot_mass_ratio",), np.array(values))
            for key, values in (columns or {}).items()
        },
    }
    coords = {
        "foot_mass_ratio": [0.1, 0.05],
        "slope": slope,
        "gait": np.array(["long", "short"], object),
    }
    axes = "[axes]\nfoot_mass_ratio = [0.1, 0.05]\nslope = [0.01]\n"
    text = f'name = "s"\nwalker = "E"\n{axes}[want]\nfigures = ["linear"]'
    return read(write(folder / "s.nc", text, grid, coords, {"E": POINT}, varied=varied))


def test_a_line_is_run_through_its_fold_in_order(tmp_path):
    lines = starts.lines(_grid(tmp_path))
    assert [line["at"] for line in lines] == [
        {"walker": "E", "foot_mass_ratio": ratio} for ratio in (0.1, 0.05)
    ]
    (branch,) = lines[0]["branches"]
    slopes, angles = np.array(branch)[:, 0], np.array(branch)[:, 1]
    # Up the lower piece, and back down the upper one: the angle rises all the way, and
    # the slope turns once.
    assert (np.diff(angles) > 0).all()
    assert (np.diff(np.sign(np.diff(slopes))) != 0).sum() == 1
    np.testing.assert_allclose(
        np.array(branch)[:, 2:], -angles[:, None] * [1, 2], rtol=1e-6
    )
    assert lines[0]["command"] == "gaitsweep solve --walker E --set foot_mass_ratio=0.1"


def test_a_line_begins_with_a_stable_gait_where_there_is_one(tmp_path):
    first = parse_qs(starts.lines(_grid(tmp_path))[0]["first"])
    assert (
        first["walker"] == ["E"] and float(first["stance_angle"][0]) < 0.05
    )  # radius below 1


def test_keys_that_a_derived_axis_moves_are_those_of_the_line(tmp_path):
    source = _grid(tmp_path, {"m_s": "foot_mass_ratio", "m_t": "foot_mass_ratio"},
                   {"m_s": [0.1, 0.05], "m_t": [0.4, 0.45]})  # fmt: skip
    keys = [line["keys"] for line in starts.lines(source)]
    assert [(k["m_s"], k["m_t"]) for k in keys] == [(0.1, 0.4), (0.05, 0.45)]


def test_a_walker_of_which_the_archive_lacks_a_key_does_not_walk(tmp_path):
    source = _grid(tmp_path)
    del source.walkers["E"]["c_t"]
    assert starts.lines(source) == []


def test_gaits_of_several_steps_fly_freely_for_the_script_solves_gaits_of_one(tmp_path):
    one, *_ = starts.lines(_grid(tmp_path))
    source = _grid(tmp_path)
    source.grid.attrs["steps"] = 2
    two, *_ = starts.lines(source)
    assert (
        one["branches"]
        and one["first"]
        and two == {**one, "branches": [], "first": "", "command": two["command"]}
    )
    assert "--steps 2" in two["command"]
    targets = draw(source, "linear", "s").targets
    assert targets and all(target["free"] for target in targets)


def test_the_limits_of_violations_are_the_archives(tmp_path):
    source = _grid(tmp_path)
    assert (
        starts.lines(source)[0]["keys"]["violation_limits"] == []
    )  # of an earlier version
    source.provenance["violation_limits"] = [("scuff", 1e-3), ("friction", 0.2)]
    assert starts.lines(source)[0]["keys"]["violation_limits"] == [1e-3, 0.2]


def test_a_branch_without_rates_has_no_starts(tmp_path):
    rows = {"branch": [0, 0], "slope": [0.01, 0.02], "stance_angle": [0.1, 0.2]}
    text = 'name = "b"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, 0.02]'
    (line,) = starts.lines(
        read(write(tmp_path / "b.nc", text, {}, {}, {"C": KNEED}, {"branches": rows}))
    )
    assert line["branches"] == [] and line["first"] == "" and starts.brief([line]) == []


def _points_of_curves(folder):
    """A curve of three points over the detuning of a line, with their walkers."""
    keys = np.array([0.1, 0.5, 0.9])
    line = {"walker": ["C"] * 3, "detuning": [0.5] * 3, "value": keys}

    curve = line | {"curve": [0] * 3, "kind": ["fold"] * 3}
    curve |= {"key": ["detuning"] * 3, "slope": [0.01, 0.02, 0.03]}
    curve["stance_angle"] = [0.2] * 3
    for name in RATES:
        curve[name] = [-0.3] * 3

    walkers = line | {"w_t": -keys, "c_t": 2 * keys}
    for name in ("l_t", "m_t", "R"):
        walkers[name] = [KNEED[name]] * 3

    text = 'name = "c"\nkind = "curve"\nwalker = "C"\n[axes]\ndetuning = [0.5]\n'
    text += 'slope = [0.01, 0.1]\n[want]\nfigures = ["curves"]'
    grid = {"w_t": (("detuning",), [-0.5]), "c_t": (("detuning",), [1.0])}
    varied = dict.fromkeys(grid, "detuning")

    archive = write(
        folder / "c.nc",
        text,
        grid,
        {"detuning": [0.5]},
        {"C": KNEED},
        {"curves": curve, "curve_walkers": walkers},
        varied=varied,
    )
    return read(archive)


def test_points_of_curves_over_a_key_start_the_walkers_there(tmp_path):
    source = _points_of_curves(tmp_path)
    drawing = draw(source, "curves", "s")
    commands = {row[2] for target in drawing.targets for row in target["rows"]}

    lines = starts.lines(source, commands)

    assert [line["at"] for line in lines] == [
        {"walker": "C", "detuning": value} for value in (0.1, 0.5, 0.9)
    ]
    assert [line["keys"]["w_t"] for line in lines] == [-0.1, -0.5, -0.9]
    assert [line["keys"]["c_t"] for line in lines] == [0.2, 1.0, 1.8]
    # The page's script finds them by the commands of the points.
    for line, slope in zip(lines, ("0.01", "0.02", "0.03"), strict=True):
        assert f"{line['command']} --slope {slope}" in commands

    (target,) = drawing.targets
    assert len(target["starts"]) == 3
    assert target["command"] not in {line["command"] for line in lines}
    assert starts.lines(source) == []


def test_points_of_curves_without_their_walkers_do_not_walk(tmp_path):
    source = _points_of_curves(tmp_path)
    commands = {row[2] for row in draw(source, "curves", "s").targets[0]["rows"]}
    del source.tables["curve_walkers"]
    assert starts.lines(source, commands) == []


def test_rows_of_a_table_have_the_addresses_of_their_gaits(tmp_path):
    text = 'name = "b"\nkind = "branch"\nwalker = "C"\n[axes]\nslope = [0.01, 0.02]\ndetuning = [0.1]'
    rows = {
        "walker": ["C"] * 2,
        "detuning": [0.1] * 2,
        "slope": [0.01, 0.02],
        "stance_angle": [0.1, np.nan],
    }
    source = read(
        write(tmp_path / "b.nc", text, {}, {}, {"C": KNEED}, {"special_points": rows})
    )
    found = starts.addresses(source, source.tables["special_points"])
    assert found == ["walker=C&detuning=0.1&slope=0.01&stance_angle=0.1", ""]
    assert starts.addresses(
        source, source.tables["special_points"].drop(columns="stance_angle")
    ) == ["", ""]


@pytest.mark.parametrize("side", [12, 200])
def test_a_map_carries_all_its_cells_in_at_most_25_kilobytes(tmp_path, side):
    slope, radius = np.linspace(0.01, 0.05, side), np.linspace(0.1, 0.4, side)
    angle = 0.1 + radius[:, None, None] * slope[:, None] * np.array([1.0, np.pi])
    angle[radius > 0.3, : side // 4] = np.nan
    dims = ("R", "slope", "gait")
    grid = {
        "stance_angle": (dims, angle),
        **{name: (dims, -np.sqrt(2) * angle) for name in RATES},
    }
    text = 'name = "m"\nwalker = "B"\n[axes]\nR = [0.1]\nslope = [0.01]\n[want]\nfigures = ["heatmap"]'
    coords = {"R": radius, "slope": slope, "gait": np.array(["long", "short"], object)}
    made = write(
        tmp_path / "m.nc",
        text,
        grid,
        coords,
        {"B": POINT | {"R": 0.2}},
        varied={"R": ["R"]},
    )
    drawing = draw(read(made), "heatmap", "test")
    assert len(json.dumps(drawing.panels, separators=(",", ":"))) < 25_000
    assert len(drawing.panels) == 2
    for panel in drawing.panels:
        assert [panel["x"]["name"], panel["y"]["name"]] == ["slope", "R"]
        assert "stance_angle" in panel["fields"]


@pytest.mark.parametrize("rises", [True, False])
def test_branches_and_maps_over_a_falling_axis_are_those_over_a_rising_one(
    tmp_path, rises
):
    """Places on a branch and keys that a derived one moves are looked up by values in
    rising order.
    """
    source = _grid(tmp_path, {"m_s": "foot_mass_ratio"}, {"m_s": [0.1, 0.05]})
    order = {
        name: np.argsort(source.grid[name].values)
        for name in ("foot_mass_ratio", "slope")
    }
    other = replace(
        source,
        grid=source.grid.isel({k: v if rises else v[::-1] for k, v in order.items()}),
    )
    (first, *_), panel = starts.lines(other), draw(other, "heatmap", "test").panels[0]
    wanted = next(line for line in starts.lines(source) if line["at"] == first["at"])
    assert first["branches"] == wanted["branches"]
    assert panel["y"]["values"] == [0.05, 0.1] and panel["moved"] == {
        "m_s": [["foot_mass_ratio"], [0.05, 0.1]]
    }
    assert panel["x"]["values"] == sorted(panel["x"]["values"])


def test_a_cell_of_a_map_has_the_key_that_both_its_axes_move(tmp_path):
    radius, mass = np.array([0.3, 0.1]), np.array([1.0, 2.0])
    table = {"w_t": (("R", "m_s"), np.array([[1.0, 2.0], [3.0, 4.0]]))}
    dims = ("R", "m_s", "gait")
    angle = np.full((2, 2, 1), 0.2)
    grid = {
        "stance_angle": (dims, angle),
        **dict.fromkeys(RATES, (dims, -angle)),
        **table,
    }
    text = 'name = "m"\nwalker = "B"\n[axes]\nR = [0.3]\nm_s = [1.0]\nslope = [0.01]\n[want]\nfigures = ["heatmap"]'
    coords = {"R": radius, "m_s": mass, "gait": np.array(["long"], object)}
    varied = {"R": ["R"], "m_s": ["m_s"], "w_t": ["R", "m_s"]}
    source = read(
        write(tmp_path / "m.nc", text, grid, coords, {"B": POINT}, varied=varied)
    )
    assert source.parameters({"walker": "B", "R": 0.1, "m_s": 2.0})["w_t"] == 4.0
    angles = pd.DataFrame(
        angle[..., 0], pd.Index([0.3, 0.1], name="R"), pd.Index([1.0, 2.0], name="m_s")
    )
    panel = starts.cells(
        source, {"slope": 0.01}, {"stance_angle": angles}, (), 1, "gait"
    )
    assert panel["moved"] == {"w_t": [["R", "m_s"], [3.0, 4.0, 1.0, 2.0]]}
    table = html_tables.walkers(source)
    assert {row[0].text: row[2].text for row in table.rows}["w_t"] == "by R, m_s"


def test_a_page_holds_its_lines_and_the_index_two_of_them(tmp_path):
    source = _grid(tmp_path)
    out = pages.write([source.path], tmp_path / "out").parent
    held = {name: json.loads(re.search(r'id="lines">(.*?)</script>', (out / name).read_text(), re.S)[1])
            for name in ("s.html", "index.html")}  # fmt: skip
    assert held["s.html"] == starts.lines(source)
    assert [len(line["branches"][0]) for line in held["index.html"]] == [1, 1]
    first = parse_qs(held["index.html"][0]["first"])
    assert held["index.html"][0]["branches"][0][0][0] == pytest.approx(
        float(first["slope"][0]), rel=1e-6
    )


def test_the_script_is_small_and_holds_no_comment():
    script = pages._script()
    assert len(f"<script>{script}".encode()) <= 80_000
    assert not re.search(r"^\s*(//|/\*)", script, re.M)


def test_slopes_of_a_map_keep_their_digits_beside_steps_that_vanish():
    slope = np.array([[4.2449449527e-5, 0.0], [0.05, np.nan]])
    made = starts._fields(
        {"slope": slope, "stance_angle": np.where(slope >= 0, 0.1, np.nan)}, False, 1
    )
    assert made["slope"]["log"] and made["slope"]["step"] <= 1e-9
    assert made["still"] == fields.words(np.array([[False, True], [False, False]]))
    assert "still" not in starts._fields(
        {"slope": slope[:1, :1], "stance_angle": slope[:1, :1]}, False, 1
    )
