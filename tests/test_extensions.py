"""Packages that add walkers, measures and figures by entry points: that of
docs/extending.md, and broken ones.
"""

import json
import os
import re
import subprocess
import sys
import types

import numpy as np
import pytest
import xarray as xr

import gaitsweep
from conftest import ROOT
from gaitsweep import ArchiveError, StudyError, Variable, extensions
from gaitsweep.pipeline.report import pages
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.contract import registry

SHOWN = re.findall(
    r"```(?:toml|python)\n(.*?)```",
    (ROOT / "docs" / "extending.md").read_text(),
    re.DOTALL,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the package and the study that the page shows, installed."""
    folder = tmp_path_factory.mktemp("extending")
    project, module, study = SHOWN
    (folder / "source").mkdir()
    for name, text in (
        ("source/pyproject.toml", project),
        ("source/swing_rates.py", module),
        ("swing.toml", study),
    ):
        (folder / name).write_text(text)
    uv = [
        sys.executable,
        "-m",
        "uv",
        "--offline",
        "--quiet",
        "pip",
        "install",
        "--no-build-isolation",
        "--no-deps",
    ]
    subprocess.run(
        [*uv, "--python", sys.executable, "--target", "site", "./source"],
        check=True,
        cwd=folder,
    )
    return folder


def command(folder, *words, code=0):
    path = os.pathsep.join([str(folder / "site"), str(ROOT)])
    run = [sys.executable, "-m", "gaitsweep", *words]
    done = subprocess.run(
        run,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == code, done.stderr
    return done.stdout


def test_the_package_shown_works(folder):
    command(folder, "run", "swing.toml")
    with xr.open_dataset(folder / "data" / "archive" / "swing.nc") as archive:
        peak = archive.peak_thigh_rate
        assert (
            peak.units == "1"
            and archive.attrs["m_h"] == 2.0
            and (archive.status[:, :2] == 0).all()
        )
        for label in ("long", "short"):
            found = gaitsweep.solve("E", 0.005, m_h=2.0).set_index("gait").loc[label]
            state = [
                found[name] for name in ("stance_angle", "stance_rate", "thigh_rate")
            ]
            motion = gaitsweep.simulate("E", 0.005, state, 1, motion=True, m_h=2.0)
            rate = np.gradient(
                motion.theta_th.values.ravel(), motion.time.values.ravel()
            )
            assert float(peak.sel(gait=label)[0]) == pytest.approx(
                np.nanmax(np.abs(rate)), rel=2e-3
            )
    command(folder, "report", "data/archive/swing.nc", "-o", "reports")
    page = (folder / "reports" / "swing.html").read_text()
    assert "Swing rates" in page and "largest rate of the swing thigh in a step" in page
    assert (
        len(
            (folder / "reports" / "csv" / "swing-swing_rates.csv")
            .read_text()
            .splitlines()
        )
        == 13
    )
    solved = json.loads(
        command(folder, "solve", "--walker", "heavy-hip", "--slope", "0.01", "--json")
    )
    assert {gait["gait"] for gait in solved} == {"long", "short"}
    assert all(
        "heavy-hip" in command(folder, *words)
        for words in (["walkers"], ["schema"], ["completion", "bash"])
    )
    # Another version of the measure makes the stored results stale.
    assert json.loads(command(folder, "plan", "swing.toml", "--json"))[0]["cached"] == 6
    module = folder / "site" / "swing_rates.py"
    module.write_text(
        module.read_text().replace("measure=peak", "measure=peak, version=2")
    )
    assert json.loads(command(folder, "plan", "swing.toml", "--json"))[0]["cached"] == 0


class Point:
    """An entry point of a package that is not installed."""

    def __init__(self, name, value):
        self.name, self.value, self.dist = (
            name,
            value,
            types.SimpleNamespace(name="other"),
        )

    def load(self):
        if isinstance(self.value, Exception):
            raise self.value
        return self.value


@pytest.fixture
def added(monkeypatch):
    """A function that adds entry points to a group, for one test."""
    variables, reads = dict(registry.VARIABLES), dict(registry.READS)
    points = {}
    monkeypatch.setattr(extensions, "_points", lambda group: points.get(group, {}))

    def add(group, **values):
        points.setdefault(group, {}).update(
            {name: [Point(name, v) for v in each] for name, each in values.items()}
        )

    yield add
    for known, before in ((registry.VARIABLES, variables), (registry.READS, reads)):
        known.clear()
        known.update(before)


def constant(name, value=1.5, **more):
    return Variable(
        name, ("gait",), "number", name, measure=lambda steps, measured: value, **more
    )


def study(**want):
    return {"name": "s", "walker": "E", "axes": {"slope": [0.01]}, "want": want}


BROKEN = {
    "cannot be loaded: ZeroDivisionError: by zero": [ZeroDivisionError("by zero")],
    "is added twice": [constant("mine"), constant("mine")],
    "must be a Variable; it is a int": [3],
    "has another name, kind or group than a measure of a package may": [
        constant("yours")
    ],
}


@pytest.mark.parametrize("said", BROKEN)
def test_a_broken_measure_is_refused_in_a_line(added, tmp_path, said):
    added("measures", mine=BROKEN[said])
    with pytest.raises(StudyError) as error:
        parse.parse(study(variables=["mine"]), "", tmp_path / "s.toml")
    assert (
        said in str(error.value)
        and "`mine`" in str(error.value)
        and "s.toml, want.variables" in str(error.value)
    )
    parse.parse(
        study(variables=["period"]), "", tmp_path / "s.toml"
    )  # nobody asks for it


def test_a_smooth_measure_or_one_of_an_unknown_kind_is_refused(added, tmp_path):
    added(
        "measures",
        a=[constant("a", is_smooth=True)],
        b=[Variable("b", ("gait",), "colour", "b", measure=len)],
    )
    for name in "ab":
        with pytest.raises(StudyError, match="than a measure of a package may"):
            parse.parse(study(variables=[name]), "", tmp_path / "s.toml")


def test_measures_stand_in_the_order_of_their_names_after_our_own(added):
    added("measures", zeta=[constant("zeta")], alpha=[constant("alpha", 2.5)])
    gaitsweep.gaits("E", 0.01, variables=["zeta"])
    found = gaitsweep.gaits("E", [0.01, 0.7], variables=["zeta", "alpha", "period"])
    assert [
        name for name in found.data_vars if name in ("zeta", "alpha", "period")
    ] == ["period", "alpha", "zeta"]
    np.testing.assert_array_equal(found.alpha.sel(gait="long"), [2.5, np.nan])


def test_a_measure_of_several_steps_is_what_it_says(added):
    def angle(steps, measured):
        return measured["stance_angle"]

    for over in ("least", "mean", "greatest", "sum"):
        added(
            "measures",
            **{
                over: [
                    Variable(
                        over, ("gait",), "angle", over, over_steps=over, measure=angle
                    )
                ]
            },
        )
    names = ["least", "mean", "greatest", "sum"]
    gait = gaitsweep.gaits("D", 0.016, steps=2, variables=[*names, "stance_angle"]).sel(
        gait="long"
    )
    least, mean, greatest, both = (float(gait[name]) for name in names)
    assert least < mean < greatest == float(
        gait.stance_angle
    ) and both == pytest.approx(2 * mean, rel=1e-15)
    assert both == pytest.approx(least + greatest, rel=1e-15)


def test_a_measure_that_raises_is_the_reason_of_its_points(added):
    def fails(steps, measured):
        raise RuntimeError("no such muscle")

    added(
        "measures",
        fails=[Variable("fails", ("gait",), "number", "fails", measure=fails)],
    )
    found = gaitsweep.gaits("E", 0.01, variables=["fails"])
    assert "no such muscle" in str(found.reason_text.values[found.reason.values[0]])


def test_a_walker_of_a_package_is_a_table_and_may_lead_to_others(added, tmp_path):
    added(
        "walkers",
        mine=[{"base": "E", "m_h": 2.0}],
        heavier=[{"base": "mine", "R": 0.1}],
        broken=[3],
        E=[{}],
    )
    assert (
        gaitsweep.solve("mine", 0.01).stance_angle[0]
        == gaitsweep.solve("E", 0.01, m_h=2.0).stance_angle[0]
    )
    both = (
        gaitsweep.solve({"base": "heavier", "m_h": 1.0}, 0.01),
        gaitsweep.solve("E", 0.01, m_h=1.0, R=0.1),
    )
    assert both[0].stance_angle[0] == both[1].stance_angle[0]
    assert gaitsweep.solve("E", 0.01).stance_angle[0] != 0  # ours comes first
    for name, said in (
        ("broken", "must be a dict; it is a int"),
        ("mne", "Unknown name `mne`"),
    ):
        with pytest.raises(StudyError, match=said):
            gaitsweep.solve(name, 0.01)


def test_a_figure_that_raises_leaves_the_page_and_says_why(
    added, tmp_path, monkeypatch
):
    def fails(axes, grid):
        raise RuntimeError("<b>no ink</b>")

    plot = {"reads": ("period",), "title": "{T}", "caption": "C", "alt": "A"}
    added(
        "figures",
        fails=[gaitsweep.Plot(fails, **plot)],
        draws=[gaitsweep.Plot(lambda a, g: {"x": [1]}, **plot)],
    )
    monkeypatch.chdir(tmp_path)
    gaitsweep.run(study(figures=["fails", "loglog", "draws"]), quiet=True)
    page = gaitsweep.report("data/archive/s.nc").read_text()
    assert (
        "its package raises RuntimeError: &lt;b&gt;no ink&lt;/b&gt;" in page
        and "{T}" in page
        and "Stance" in page
    )
    with pytest.raises(ArchiveError, match="its package raises RuntimeError"):
        gaitsweep.figure("data/archive/s.nc", "fails")
    monkeypatch.setattr(extensions, "_points", lambda group: {})  # the package is gone
    assert pages.write(["data/archive/s.nc"], tmp_path / "again") and (
        "there is no figure of that name" in (tmp_path / "again" / "s.html").read_text()
    )
