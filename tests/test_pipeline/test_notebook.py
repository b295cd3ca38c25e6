"""`from gaitsweep import load, run, solve`: the command line's results as Datasets and
tables.
"""

import base64
import contextlib
import json
import os
import pathlib
import pickle
import re
import subprocess
import sys
import time
import types
from concurrent.futures import ThreadPoolExecutor
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import gaitsweep
from conftest import ROOT
from gaitsweep.pipeline.api import studies
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.engine import progress
from gaitsweep.pipeline.engine.engine import Engine
from gaitsweep.pipeline.engine.listener import Finished
from gaitsweep.pipeline.errors import ArchiveError, StudyError
from gaitsweep.pipeline.graph.layers import Layer
from gaitsweep.pipeline.graph.plan import Summary
from gaitsweep.tasks.contract.registry import TASKS

STUDY = {
    "name": "mine",
    "walker": {"base": "E", "l_t": 0.6},
    "axes": {"slope": np.geomspace(0.004, 0.05, 4), "foot_mass_ratio": [0.1, 0.05]},
    "want": {
        "variables": ["stance_angle", "period", "violations", "multipliers"],
        "fits": ["scaling"],
    },
}


@pytest.fixture(scope="module")
def mine(tmp_path_factory):
    """A small sweep, run from a mapping, and the archive's place."""
    path = tmp_path_factory.mktemp("mine") / "mine.nc"
    return gaitsweep.run(STUDY, jobs=1, archive=path, quiet=True), path


def test_a_sweep_in_three_lines_is_tidy(mine):
    found, path = mine
    assert dict(found.sizes) == {
        "slope": 4,
        "foot_mass_ratio": 2,
        "gait": 2,
        "multiplier": 3,
        "violation": 7,
    }
    np.testing.assert_array_equal(found.slope, STUDY["axes"]["slope"])
    assert found.identical(gaitsweep.load(path))
    assert (
        found.attrs["tables"] == ["fits/scaling"] and found.stance_angle.units == "rad"
    )


@pytest.mark.parametrize(
    "stream",
    [None, types.SimpleNamespace(write=len, flush=int)],
    ids=["closed", "an object"],
)
def test_a_run_needs_no_standard_error(mine, monkeypatch, capsys, stream):
    found, path = mine
    monkeypatch.setattr(sys, "stderr", stream)
    assert (
        found.identical(gaitsweep.run(STUDY, jobs=1, archive=path))
        and capsys.readouterr().out == ""
    )


def test_flags_are_words_and_multipliers_complex(mine):
    found, _path = mine
    assert set(np.unique(found.status)) <= {"converged", "no_gait"}
    assert (np.isfinite(found.stance_angle) == (found.status == "converged")).all()
    assert all(text.endswith(".") for text in found.reason.values.ravel())
    # Legs of a point-foot walker scuff when they are parallel, at small slopes by less
    # than the limit.
    scuff = found.violations.sel(violation="scuff")
    assert (
        scuff.dtype == bool
        and not scuff.isel(slope=0).any()
        and scuff.isel(slope=-1).any()
    )
    radius = np.abs(found.multipliers).max("multiplier")
    np.testing.assert_array_equal(radius.fillna(-1), found.spectral_radius.fillna(-1))


def test_gaits_of_two_steps_at_one_point():
    found = gaitsweep.solve("D", 0.016, steps=2)
    alone = gaitsweep.gaits("D", 0.016, steps=2).isel(gait=0)
    assert list(found.gait) == ["long"] and list(found.columns) == list(
        gaitsweep.solve("D", 0.009).columns
    )
    for name in ("stance_angle", "period", "speed", "error_bound"):
        assert found[name][0] == alone[name].item()
    none = gaitsweep.solve("D", 0.014, steps=2)
    assert none.empty and none.attrs["absent"][0].startswith(
        "No gait of period 2 at this slope: the branches found span"
    )
    with pytest.raises(
        StudyError, match=r"`steps` must be a whole number from 1 to 64; got 65"
    ):
        gaitsweep.solve("D", 0.014, steps=65)


@pytest.mark.parametrize(
    "asked",
    [
        {"walker": "A", "slope": 0.02, "R": 0.25, "tuned": ["w_t"]},
        {"walker": "D", "slope": 0.016, "steps": 2},
        {"walker": "A", "slope": 0.02, "at": {"froude_speed": 0.2}, "vary": "m_h"},
    ],
)
def test_a_notebook_shows_the_steps_of_gaits_as_pictures_that_lie_in_the_page(asked):
    found = gaitsweep.solve(**asked)

    shown = found._repr_html_()

    pictures = re.findall(
        r'<img alt="(long|short) step, (stable|unstable)" width="360"'
        r' src="data:image/svg\+xml;base64,([^"]+)">',
        shown,
    )
    assert 0 < len(pictures) == len(found)
    for (label, stability, picture), gait in zip(
        pictures, found.itertuples(), strict=True
    ):
        assert label == gait.gait and (stability == "stable") == (gait.stable == 1)
        ElementTree.fromstring(base64.b64decode(picture))
    assert shown.endswith(pd.DataFrame(found)._repr_html_())
    assert "<script" not in shown and "http" not in re.sub(r"base64,[^\"]+", "", shown)


def test_what_is_taken_from_gaits_is_an_ordinary_table():
    found = gaitsweep.solve("D", 0.009)

    assert type(found[["slope"]]) is type(found.copy()) is pd.DataFrame
    assert pickle.loads(pickle.dumps(found))._repr_html_() == found._repr_html_()
    assert "<img" not in gaitsweep.solve("D", 0.014, steps=2)._repr_html_()
    found.columns = [name.upper() for name in found.columns]
    assert "<img" not in found._repr_html_() and "STANCE_ANGLE" in found._repr_html_()


def test_a_loaded_grid_can_be_written(mine, tmp_path):
    """Its complex multipliers are left to their parts."""
    found, _path = mine
    found.isel(slope=[0, 1]).to_netcdf(tmp_path / "part.nc")
    part = xr.load_dataset(tmp_path / "part.nc")
    assert "multipliers" not in part and part.multiplier_imag.equals(
        found.multiplier_imag[:2]
    )
    assert (part.status == found.status[:2]).all() and part.violations.dtype == bool
    found.sel(gait="long").to_netcdf(
        tmp_path / "long.nc"
    )  # a shorter string, without a warning
    assert xr.load_dataset(tmp_path / "long.nc").gait == "long"


def test_a_loaded_grid_calls_itself_a_dataset(mine):
    found, _path = mine
    assert (
        repr(found).startswith("<xarray.Dataset>")
        and "xarray.Dataset" in found._repr_html_()
    )


def test_a_report_of_one_archive_is_its_page(mine, tmp_path):
    _, path = mine
    page = gaitsweep.report(path, tmp_path / "pages")
    assert page == tmp_path / "pages" / "mine.html" and page.exists()
    other = tmp_path / "other.nc"
    other.write_bytes(path.read_bytes())
    assert (
        gaitsweep.report([path, str(other)], str(tmp_path / "pages"), only=True)
        == tmp_path / "pages" / "index.html"
    )
    with pytest.raises(ArchiveError, match=r"^There is no archive .*none.nc\.$"):
        gaitsweep.report(tmp_path / "none.nc", tmp_path / "pages")
    (tmp_path / "data" / "archive").mkdir(parents=True)
    (tmp_path / "data" / "archive" / "near.nc").touch()
    with (
        contextlib.chdir(tmp_path),
        pytest.raises(
            ArchiveError, match=r"near; did you mean data/archive/near\.nc\?$"
        ),
    ):
        gaitsweep.report("near", tmp_path / "pages")
    with pytest.raises(ArchiveError, match="^An archive must be a file; got int"):
        gaitsweep.report([1], tmp_path / "pages")


def test_a_figure_shows_itself_in_a_notebook_and_can_be_saved(mine, tmp_path):
    _, path = mine
    figure = gaitsweep.figure(path, "loglog")
    svg = figure._repr_svg_()
    assert (
        svg.startswith("<?xml")
        and "fill: #ffffff" in svg
        and "var(--" not in svg
        and "slope" in svg
    )
    figure.savefig(tmp_path / "loglog.png")
    with pytest.raises(
        StudyError, match=r"^Unknown figure `loglgo`, did you mean `loglog`\?$"
    ):
        gaitsweep.figure(path, "loglgo")
    with pytest.raises(
        ArchiveError,
        match=r"mine.nc has no figure basin: the archive has no outcomes of initial conditions\.$",
    ):
        gaitsweep.figure(path, "basin")


def test_a_figure_is_drawn_with_its_own_settings(mine, tmp_path):
    """Whatever a `matplotlibrc` of the current folder says."""
    _, path = mine
    (tmp_path / "matplotlibrc").write_text(
        "figure.dpi: nonsense\naxes.grid: nonsense\n"
    )
    code = f"import gaitsweep; print(gaitsweep.figure({str(path)!r}, 'loglog')._repr_svg_()[:5])"
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert (done.stdout, done.stderr) == ("<?xml\n", "")


def test_an_error_in_a_notebook_has_one_line_of_the_caller_and_a_sentence():
    with pytest.raises(StudyError) as caught:
        gaitsweep.gaits("E", 0.7)
    place, sentence = caught.value._render_traceback_()
    assert (
        place.endswith('    gaitsweep.gaits("E", 0.7)\n')
        and place.count("File") == 1
        and __file__ in place
    )
    assert (
        sentence
        == "StudyError: `slope` must lie in [1e-18, 0.5) rad; got 0.7: degrees? 0.7 degrees are 0.0122173 rad."
    )
    assert StudyError("Nowhere.")._render_traceback_() == ["StudyError: Nowhere."]


def test_a_sweep_and_a_single_solve_agree(mine):
    found, _ = mine
    slope = float(found.slope[2])
    alone = gaitsweep.solve(STUDY["walker"], slope, foot_mass_ratio=0.05).set_index(
        "gait"
    )
    there = found.isel(slope=2).sel(foot_mass_ratio=0.05)
    assert list(alone.index) == ["long", "short"]
    for name in ("stance_angle", "period"):
        np.testing.assert_allclose(
            alone[name], there[name].sel(gait=["long", "short"]), rtol=1e-12
        )
    assert alone.multipliers["long"][0] == pytest.approx(
        complex(there.multipliers.sel(gait="long")[0]), rel=1e-9
    )
    assert alone.attrs["search"] and np.isnan(alone.kneestrike_time).all()


def test_solve_gives_what_the_command_gives(capsys):
    table = gaitsweep.solve("D", 0.009)
    assert commands.main(["solve", "--walker", "D", "--slope", "0.009", "--json"]) == 0
    for row, gait in zip(
        table.to_dict("records"), json.loads(capsys.readouterr().out), strict=True
    ):
        assert row["period"] == gait["period"] and row["violations"] == tuple(
            gait["violations"]
        )
        assert [[z.real, z.imag] for z in row["multipliers"]] == gait["multipliers"]


def test_gaits_at_a_value_of_a_measure_in_python_and_by_the_command(capsys):
    table = gaitsweep.solve("A", at={"froude_speed": 0.2})
    assert sorted(table.gait) == ["long", "short"]
    words = ["solve", "--walker", "A", "--at", "froude_speed=0.2", "--json"]
    assert commands.main(words) == 0
    told = json.loads(capsys.readouterr().out)
    assert table.slope.tolist() == [gait["slope"] for gait in told]
    for slope, speed in zip(table.slope, table.froude_speed, strict=True):
        there = gaitsweep.solve("A", slope).froude_speed
        assert speed == pytest.approx(0.2, rel=1e-12)
        assert np.abs(there - 0.2).min() < 1e-12

    key = {"vary": "m_h", "between": (0.05, 1.0), "slope": 0.02}
    (m_h,) = gaitsweep.solve("A", at={"froude_speed": 0.2}, **key).m_h
    assert np.abs(gaitsweep.solve("A", 0.02, m_h=m_h).froude_speed - 0.2).min() < 1e-12
    none = gaitsweep.solve("A", at={"speed": 9.0})
    assert none.empty and none.attrs["absent"][0].startswith("No gait has speed = 9 ")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "`slope` is needed, or `at` with the value of a measure."),
        (["--at", "sped=1"], "Unknown measure `sped`, did you mean `speed`?"),
        (
            ["--at", "speed=1", "--slope", "0.1"],
            "`slope` is varied and cannot be set too; got 0.1.",
        ),
        (
            ["--at", "speed=1", "--vary", "R"],
            "`vary` needs `slope`, as a key is varied; got 'R'.",
        ),
        (
            ["--at", "speed=1", "--between", "0.3", "0.1"],
            "`between` must be two increasing numbers; got [0.3, 0.1].",
        ),
        (
            ["--at", "speed=1", "--between", "0", "0.1"],
            "`between` must be slopes above 0, as nothing but gravity drives the walker; "
            "got (0.0, 0.1).",
        ),
        (
            ["--at", "speed=1", "--at", "period=1"],
            "`at` must name one measure; got 'speed, period'.",
        ),
    ],
)
def test_targets_that_cannot_be_asked_are_refused_in_a_line(words, message, capsys):
    assert commands.main(["solve", "--walker", "A", *words]) == 2
    assert capsys.readouterr().err == f"gaitsweep: {message}\n"


def test_no_gait_is_an_empty_table_that_says_how_it_was_sought():
    found = gaitsweep.solve("physical", 1e-4)
    assert (
        list(found.columns) == list(gaitsweep.solve("E", 0.01).columns)
        and "stance_angle" in found
    )
    assert found.empty and any(
        "initial guesses" in sentence for sentence in found.attrs["search"]
    )


def test_a_table_is_a_frame_with_units(mine):
    _, path = mine
    table = gaitsweep.load(path, "fits/scaling")
    assert {"gait", "exponent", "foot_mass_ratio"} <= set(table.columns)
    assert (
        table.attrs["units"]["slope"] == "rad"
        if "slope" in table
        else table.attrs["units"]["exponent"] == "1"
    )
    with pytest.raises(
        ArchiveError, match=r"mine.nc has no table branches; it has fits/scaling\.$"
    ):
        gaitsweep.load(path, "branches")


def test_a_study_may_be_a_file_text_or_a_mapping(tmp_path):
    text = 'name = "s"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02]\n'
    for name in ("s.toml", "a=b.toml"):
        (tmp_path / name).write_text(text)
    read = [
        studies._study(one)
        for one in (
            tmp_path / "s.toml",
            str(tmp_path / "s.toml"),
            str(tmp_path / "a=b.toml"),
            text,
            {"name": "s", "walker": "E", "axes": {"slope": np.array([0.01, 0.02])}},
            {"name": "s", "walker": "E", "axes": {"slope": xr.DataArray([0.01, 0.02])}},
            {
                "name": "s",
                "walker": "E",
                "axes": {"slope": pd.Series([0.01, 0.02], index=[7, 3])},
            },
        )
    ]
    assert (
        len(
            {
                (one.name, one.walkers, tuple(one.values_along), one.variables)
                for one in read
            }
        )
        == 1
    )


@pytest.mark.parametrize("name", ["😀.toml", "é\x7f\t.toml", 'a "b" \\ c.toml'])
def test_a_walker_file_of_a_mapping_may_have_any_name(tmp_path, name):
    (tmp_path / name).write_text('[walker]\nbase = "E"\nR = 0.0\n')
    study = studies._study(
        {"name": "s", "walker": str(tmp_path / name), "axes": {"slope": [0.01]}}
    )
    assert study.walkers[0]["base"] == "E"


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        (
            {"name": "s", "walker": "E", "axes": {"slope": 0.1}},
            r"`slope` must be a list, or a table of from, to, n and spacing; got 0.1 \(study, axes.slope\)",
        ),
        (
            {"name": "s", "walker": "E", "axes": {"slope": None}},
            r"`axes` must be a number, a text, a list or a mapping",
        ),
        ("name = ", "The study cannot be read: Invalid value"),
        ("none.toml", "There is no file none.toml"),
        (None, "A study must be a file, a text or a mapping; got NoneType"),
        (b"name = 1", "A study must be a file, a text or a mapping; got bytes"),
        (
            {"name": "s", "walker": "\ud83d.toml", "axes": {"slope": [0.1]}},
            "The study cannot be read: Escaped character is not a Unicode scalar value",
        ),
    ],
)
def test_a_wrong_study_is_one_sentence(wanted, said):
    with pytest.raises(StudyError, match=said) as error:
        gaitsweep.run(wanted)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("arguments", "keys", "said"),
    [
        (("D", 0.7), {}, r"`slope` must lie in \[1e-18, 0.5\) rad; got 0.7"),
        (("Q", 0.1), {}, "Unknown name `Q`, known: A, B"),
        (("D", 0.1), {"l_tt": 1}, "did you mean `l_t`"),
    ],
)
def test_a_wrong_point_is_one_sentence(arguments, keys, said):
    with pytest.raises(StudyError, match=said):
        gaitsweep.solve(*arguments, **keys)


@pytest.mark.parametrize("jobs", [0, -1, 1001, "2", None, True])
def test_a_wrong_number_of_workers_is_one_sentence(jobs):
    with pytest.raises(
        StudyError, match=f"`jobs` must be a whole number from 1 to 1,000; got {jobs!r}"
    ):
        gaitsweep.run(STUDY, jobs=jobs)


def test_no_path_is_one_sentence():
    with pytest.raises(ArchiveError, match="An archive must be a file; got NoneType"):
        gaitsweep.load(None)


def test_calls_from_threads_take_turns(monkeypatch):
    """Compiled integrators hold one state, as the HDF5 library does; a run that ends
    closes all worker processes.
    """
    inside, most = [], []

    def slow(*_):
        inside.append(1)
        most.append(len(inside))
        time.sleep(0.05)
        inside.pop()
        raise StudyError("Enough.")

    walker = type("Slow", (dict,), {"items": slow})()
    monkeypatch.setattr("gaitsweep.pipeline.archive.read.size_of", slow)
    with ThreadPoolExecutor(8) as pool:
        calls = [
            *(
                pool.submit(function, walker, 0.01)
                for function in (gaitsweep.gaits, gaitsweep.solve) * 2
            ),
            *(
                pool.submit(gaitsweep.step_map, walker, 0.01, (0.1, 0, 0))
                for _ in range(2)
            ),
            *(
                pool.submit(gaitsweep.simulate, walker, 0.01, (0.1, 0, 0), 2)
                for _ in range(2)
            ),
            *(pool.submit(gaitsweep.load, __file__) for _ in range(2)),
            *(pool.submit(gaitsweep.run, walker) for _ in range(2)),
        ]
        assert {str(call.exception()) for call in calls} == {"Enough."}
    assert most == [1] * 12


def test_a_notebook_shows_a_bar_that_ends_full(monkeypatch, tmp_path, capsys):
    interactive = types.ModuleType("IPython")
    interactive.get_ipython = lambda: types.SimpleNamespace(kernel=True, config={})
    monkeypatch.setitem(sys.modules, "IPython", interactive)

    gaitsweep.run(
        {**STUDY, "axes": {"slope": [0.01, 0.02]}}, jobs=1, archive=tmp_path / "m.nc"
    )

    said = capsys.readouterr().err
    assert "100%|" in said and "2 of 2 points (100 %)" in said
    assert "mine: 2 points" in said


def test_a_state_tells_rate_and_one_time_to_go():
    stages = {
        "atlas": {"done": 2, "todo": 3, "eta": 4.0},
        "points": {"done": 240, "todo": 900, "eta": 15.7},
        "scaling": {"done": 1, "todo": 1, "eta": 0.0},
    }
    state = {
        "points": 1000,
        "cached": 100,
        "done": 240,
        "rate": 42.0,
        "counts": {"converged": 239, "timed_out": 1},
        "stages": stages,
        "eta": 19.7,
    }
    assert progress.sentence(state) == (
        "340 of 1,000 points (34 %), 42 a second, searches 2 of 3, scaling 1 of 1, timed_out 1, 19.7 s to go"
    )


@pytest.fixture
def shown(tmp_path):
    """Progress of 8 atlases and 900 points, of 2 s each, on three workers."""
    layers = {name: Layer(TASKS[name], True, ()) for name in ("atlas", "points")}
    graph = types.SimpleNamespace(layers=layers, seconds=lambda name: 2.0)
    study = types.SimpleNamespace(points=900)
    plan = types.SimpleNamespace(study=study, graph=graph)
    todo = Summary({"atlas": {"new": 8}, "points": {"new": 900}}, {})
    found = progress.Progress(plan, todo, tmp_path / "log", Engine(3), quiet=True)
    yield found
    found.file.close()


def test_the_time_to_go_is_planned_before_it_is_measured(shown):
    assert progress.sentence(shown.state()).endswith(", 10.1 min to go")
    shown.start -= 1000  # seconds without a first result: the plan's estimate is wrong
    said = progress.sentence(progress.total([shown.state()]))
    assert said.endswith(", longer than planned")


def test_the_time_to_go_is_the_sum_of_its_stages(shown):
    cell = types.SimpleNamespace(line=0)
    atlas = types.SimpleNamespace(task="atlas", chunk=None, line=0, lines=0)
    orbit = types.SimpleNamespace(task="orbit", chunk=None, line=0, lines=0)
    points = types.SimpleNamespace(
        task="points", chunk=cell, line=0, lines=0, points=100
    )

    for _ in range(2):
        shown.finished(Finished(atlas, 1, seconds=5.25))
    shown.finished(Finished(points, 100, counts={"converged": 90}, seconds=1.0))
    shown.finished(Finished(points, 100, counts={"converged": 100}, seconds=5.0))
    shown.finished(Finished(orbit, 1, "timed_out", seconds=1.0))
    shown.dropped(types.SimpleNamespace(task="points", points=10), "timed_out")

    state = shown.state()
    assert state["done"] == 210
    assert state["counts"] == {"converged": 190, "timed_out": 10}
    # 210 points, those that were lost too, took 6 s, and 690 are left.
    stages = {name: stage["eta"] for name, stage in state["stages"].items()}
    assert stages == {"atlas": 10.5, "points": 6.6}
    assert state["eta"] == pytest.approx(17.1, abs=0.1)


def test_the_last_node_takes_as_long_as_the_others(shown):
    """It was told as a third of it, as if the three workers shared it."""
    atlas = types.SimpleNamespace(task="atlas", chunk=None, line=0, lines=0)
    for _ in range(7):
        shown.finished(Finished(atlas, 1, seconds=6.0))

    assert shown.state()["stages"]["atlas"]["eta"] == 6.0


def test_laws_are_fitted_to_the_wanted_gaits_only(tmp_path, monkeypatch):
    """Those that an earlier run has stored were fitted too: another archive than that
    of a fresh run.
    """
    monkeypatch.chdir(tmp_path)
    slope = {"from": 1e-4, "to": 0.05, "n": 260, "spacing": "log"}
    study = {
        "name": "one",
        "walker": "E",
        "axes": {"slope": slope},
        "want": {"variables": ["stance_angle"]},
    }
    study["want"]["fits"] = ["scaling"]
    gaitsweep.run(study, jobs=1, quiet=True)
    long = study | {"gaits": ["long"]}
    gaitsweep.run(long, jobs=1, quiet=True)
    gaitsweep.run(long, jobs=1, quiet=True, fresh=True, archive="fresh.nc")
    resumed, fresh = (
        pathlib.Path(name).read_bytes() for name in ("data/archive/one.nc", "fresh.nc")
    )
    assert resumed == fresh
    assert (
        gaitsweep.load("fresh.nc", "fits/scaling")
        .set_index("gait")
        .exponent["short"]
        .isna()
        .all()
    )
