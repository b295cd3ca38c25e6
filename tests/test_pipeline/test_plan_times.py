"""Plans: the work that is told beforehand against the processor time of the run, and
the record for machines.
"""

import json
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from conftest import ROOT, STUDY
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid.choose_method import method_of, seconds_over_plane
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.store import Outcome
from gaitsweep.pipeline.study.parse import read

LINE = 'name = "s"\nwalker = "D"\n[axes]\nslope = { from = 0.001, to = 0.02, n = 20 }\n'
#: Studies of every sort that a plan's time is promised for.
STUDIES = {
    "a line": LINE,
    "a hundred lines": LINE.replace('"D"', '"E"')
    + "R = { from = 0.0, to = 0.3, n = 100 }\n",
    "1e5 points": LINE.replace("n = 20", "n = 100000"),
    "a plane": LINE.replace('"D"', '"E"').replace("n = 20", "n = 8")
    + "R = { from = 0.0, to = 0.1, n = 150 }\n",
    "walkers that differ in units": LINE.replace("n = 20", "n = 8")
    + "m_h = [0.0, 0.1]\ng = { from = 1.0, to = 10.0, n = 200 }\n",
    "a kneed line": LINE.replace('"D"', '"C"'),
    "cascade": 'name = "s"\nkind = "cascade"\nwalker = "D"\n[axes]\nslope = [0.01, 0.02]\n',
    "basin": 'name = "s"\nkind = "basin"\nwalker = "D"\n[axes]\nslope = [0.009]\n',
    "orbits": 'name = "s"\nkind = "orbit"\nwalker = "D"\n[axes]\nslope = { from = 0.014, to = 0.0189, n = 20 }\n',
    "what drives": LINE.replace("n = 20", "n = 3")
    + "push_off = { from = 0.03, to = 0.2, n = 12 }\n",
    "values": 'name = "s"\nwalker = "D"\nat = { step_length = [0.1, 0.2, 0.3, 0.4], vary = "slope" }\n'
    "[axes]\nm_h = [0.0, 0.1, 0.2, 0.3]\n",
    "values by a key": 'name = "s"\nwalker = "D"\n'
    'at = { step_length = [0.1, 0.2], vary = "push_off", between = [1e-3, 0.2] }\n'
    "[axes]\nslope = [0.0, 0.005]\n",
    "gaits of two steps": LINE.replace("0.001", "0.0155") + "[options]\nsteps = 2\n",
}


def processor_time(folder, *arguments):
    """Processor time of a command and all its processes [s]."""
    command = [sys.executable, "-m", "gaitsweep", *arguments]
    process = subprocess.Popen(
        command, cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return used.ru_utime + used.ru_stime


def slowness():
    """Processor time of a fixed piece of work, over that on the core of the plan's
    costs.
    """
    begun = time.process_time()
    numbers = np.random.default_rng(1).random(200_000)
    for _ in range(10):
        np.exp(np.sort(numbers))
        sorted((x * x for x in numbers[:100_000].tolist()), reverse=True)
    return (time.process_time() - begun) / 0.31


@pytest.mark.parametrize("name", [*STUDIES, "more slopes than are stored"])
def test_the_time_of_a_plan_is_that_of_its_run(name, tmp_path, monkeypatch, capsys):
    """Within a factor of three on a core as fast as this one, which may be shared."""
    monkeypatch.chdir(tmp_path)
    if name not in STUDIES:  # a few points, which took as long as the start of a worker
        (tmp_path / "s.toml").write_text(LINE.replace("n = 20", "n = 4"))
        processor_time(tmp_path, "run", "s.toml", "--quiet", "--jobs", "1")
    (tmp_path / "s.toml").write_text(
        STUDIES.get(name, LINE.replace("n = 20", "n = 200"))
    )
    assert commands.main(["plan", "s.toml", "--json"]) == 0
    (plan,) = json.loads(capsys.readouterr().out)
    taken = processor_time(tmp_path, "run", "s.toml", "--quiet", "--jobs", "1")
    for _ in range(
        3
    ):  # the first run may compile, and the machine may be slow or fast for half a minute
        if not 1 / 3 < plan["seconds"] / taken < 3:
            before = slowness()
            taken = processor_time(
                tmp_path, "run", "s.toml", "--quiet", "--jobs", "1", "--fresh"
            )
            taken /= (before + slowness()) / 2
    assert 1 / 3 < plan["seconds"] / taken < 3, (
        f"{plan['seconds']:.2f} s planned, {taken:.2f} s taken"
    )


def test_costs_grow_with_what_is_asked(tmp_path):
    def seconds(text, name):
        (tmp_path / "s.toml").write_text(text)
        return Graph(read(tmp_path / "s.toml")).seconds(name)

    orbits = STUDIES["orbits"]
    one, twice = (
        seconds(orbits + f"[options]\ntransient = {n}\nsteps = {n}\n", "orbit")
        for n in (1000, 2000)
    )
    assert twice == pytest.approx(2 * one)
    basin = STUDIES["basin"]
    many = seconds(basin.replace("[0.009]", "[0.009, 0.01]"), "basin")
    assert many == pytest.approx(2 * seconds(basin, "basin"))
    # Charts over two keys cost twice as much as over one, and few lines beside them are
    # surveyed.
    plane = LINE.replace('"D"', '"E"') + "R = { from = 0.0, to = 0.1, n = 1000 }\n"
    two = plane + "m_h = { from = 0.0, to = 0.1, n = 20 }\n"
    assert 20 * seconds(two, "charts") == pytest.approx(2 * seconds(plane, "charts"))
    assert seconds(plane, "atlas") < 0.1 * 0.05

    def method(n, slopes=20, walker="E"):
        (tmp_path / "s.toml").write_text(
            f'name = "s"\nwalker = "{walker}"\n[axes]\nslope = {{ from = 0.001, to = 0.02, n = {slopes} }}\n'
            f"m_h = {{ from = 0.0, to = 0.1, n = {n} }}\n"
        )
        study = read(tmp_path / "s.toml")
        by_charts, by_lines = seconds_over_plane(study)
        return str(method_of(study)), by_charts < by_lines

    # Charts are made where they take less than lines one by one: more slopes, or knees,
    # make them pay for fewer lines.
    assert method(20) == ("short", False) and method(40) == ("plane", True)
    assert method(20, 200) == ("plane", True) and method(16, 20, "C") == (
        "short",
        False,
    )
    assert method(24, 20, "C") == ("plane", True) and method(11, 200, "C") == (
        "short",
        False,
    )
    assert method(100, 300) == ("plane", True) and method(100, 10_000) == (
        "long",
        False,
    )
    # A list counts by its length; a study of a straight and a kneed walker is their
    # mean.
    assert seconds(
        STUDIES["cascade"] + "[options]\nfamilies = [1, 3]\n", "cascade"
    ) == pytest.approx(2 * seconds(STUDIES["cascade"], "cascade"))
    straight, kneed, both = (
        seconds(LINE.replace('"D"', w), "points") for w in ('"D"', '"C"', '["D", "C"]')
    )
    assert both == pytest.approx((straight + kneed) / 2) and kneed > straight
    # Violations and proofs cost more than the gaits; longer gaits are searched for.
    dear = [
        seconds(LINE + f'[want]\nvariables = ["{v}"]\n', "points")
        for v in ("period", "violations")
    ]
    assert dear[0] == pytest.approx(straight) and dear[1] > dear[0]
    atlas = [
        seconds(LINE + f"[options]\nsteps = {n}\n", "atlas") for n in (1, 2, 3, 4, 8)
    ]
    assert (
        sorted(set(atlas)) != atlas[:1] and atlas[1] < atlas[2] == atlas[3] < atlas[4]
    )


@pytest.mark.parametrize("name", ["a line", "a plane", "gaits of two steps", "long"])
def test_lines_that_differ_in_units_are_planned_as_one(tmp_path, name):
    def seconds(text):
        (tmp_path / "s.toml").write_text(text)
        return summary(Plan(read(tmp_path / "s.toml"), Memory())).seconds

    text = STUDIES.get(name, LINE.replace("n = 20", "n = 1000"))
    units = "[axes]\ng = { from = 1.0, to = 10.0, n = 60 }\n"

    one, sixty = seconds(text), seconds(text.replace("[axes]\n", units))

    # Each point is converted, which takes little.
    assert 0.9 * one < sixty < 2 * one


def test_charts_are_planned_alike_whether_or_not_anything_is_stored(tmp_path):
    """Those of walkers that differ only in units are of all their lines."""
    units = "g = { from = 1.0, to = 10.0, n = 60 }\n"
    (tmp_path / "s.toml").write_text(STUDIES["a plane"] + units)
    study = read(tmp_path / "s.toml")
    other = Memory()
    other.put_result("another task", Outcome("ok", ""), b"")

    nothing = summary(Plan(study, Memory()))
    something = summary(Plan(study, other))

    assert something.todo["charts"] == nothing.todo["charts"] != {}
    assert something.cached["charts"] == 0
    assert something.seconds == pytest.approx(nothing.seconds)


def test_a_plan_for_machines(tmp_path, monkeypatch, capsys):
    (tmp_path / "s.toml").write_text(STUDY)
    (tmp_path / "o.toml").write_text(
        STUDIES["orbits"].replace('"s"', '"o"')
        + "[options]\nstarts = 1\ntransient = 5\n"
    )
    monkeypatch.chdir(tmp_path)

    def plan(*arguments):
        assert commands.main(["plan", *arguments, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    study, orbits = plan("s.toml", "o.toml")
    points = read(tmp_path / "s.toml").points
    keys = [
        "study",
        "archive",
        "points",
        "new",
        "changed",
        "cached",
        "omitted",
        "integrated",
        "seconds",
        "tasks",
    ]
    assert list(study) == list(orbits) == keys
    assert (study["points"], study["new"], study["changed"], study["cached"]) == (
        points,
        points,
        0,
        0,
    )
    assert study["archive"].endswith("data/archive/toy.nc") or study[
        "archive"
    ].endswith(f"{study['study']}.nc")
    assert (
        study["integrated"] == points
        and orbits["integrated"] == 0
        and orbits["new"] == 1
    )
    assert {"violations", "proofs", "claims"} <= set(
        study["omitted"]
    ) and "violations" not in orbits["omitted"]
    assert commands.main(["run", "s.toml", "--quiet", "--jobs", "1"]) == 0
    (done,) = plan("s.toml")
    assert (done["new"], done["cached"], done["integrated"], done["seconds"]) == (
        0,
        points,
        0,
        0.0,
    )


def test_what_is_not_wanted_is_in_the_record_alone(tmp_path, monkeypatch, capsys):
    (tmp_path / "s.toml").write_text(
        LINE + '[want]\nvariables = ["period", "violations"]\nfits = ["scaling"]\n'
    )
    monkeypatch.chdir(tmp_path)
    assert commands.main(["plan", "s.toml"]) == 0
    told = capsys.readouterr().out
    assert "not wanted" not in told and "version" not in told

    assert commands.main(["plan", "--json", "s.toml"]) == 0
    names = json.loads(capsys.readouterr().out)[0]["omitted"]
    assert names[-5:] == ["trace", "transition", "landmarks", "crises", "claims"]
    assert {"multipliers", "energy", "proofs"} < set(names) and not {
        "violations",
        "scaling",
        "orbit",
    } & set(names)


@pytest.mark.parametrize(
    ("axes", "want", "said"),
    [
        ("slope = [0.01, 0.02]", 'figures = ["heatmap"]', "only slope has"),
        ("slope = [0.01]", 'figures = ["heatmap"]', "none has"),
        ("slope = [0.01]", 'fits = ["scaling"]', "1 slope may not be enough"),
        ("slope = [0.01, 0.02]\nR = [0.1, 0.2]", 'figures = ["heatmap"]', ""),
    ],
)
def test_a_plan_says_what_a_grid_is_too_small_for(
    tmp_path, monkeypatch, capsys, axes, want, said
):
    study = f'name = "s"\nwalker = "E"\n[axes]\n{axes}\n[want]\n{want}\n'
    (tmp_path / "s.toml").write_text(study)
    monkeypatch.chdir(tmp_path)

    assert commands.main(["plan", "s.toml"]) == 0

    told = capsys.readouterr().out
    assert said in told and ("  note: " in told) == bool(said)
