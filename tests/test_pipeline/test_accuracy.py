"""Studies of an accuracy: what is asked, stored and told."""

import json
import time
from dataclasses import replace

import netCDF4
import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.cli.commands import main
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.grid.choose_method import method_of
from gaitsweep.pipeline.grid.method import Method, variables
from gaitsweep.pipeline.study.parse import parse, read
from gaitsweep.tasks.contract.registry import ALWAYS, TASKS

STUDY = """
name = "coarse"
accuracy = {accuracy}
walker = "D"
{options}
[axes]
slope = {{ from = {low}, to = 0.02, n = {n}, spacing = "log" }}
"""


def written(folder, accuracy="1e-6", n=2000, options="", low=1e-4, name="coarse.toml"):
    path = folder / name
    path.write_text(STUDY.format(accuracy=accuracy, n=n, options=options, low=low))
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("accuracy")


@pytest.fixture(scope="module")
def archive(folder):
    gaitsweep.run(written(folder), jobs=1, archive=folder / "coarse.nc", quiet=True)
    return folder / "coarse.nc"


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ("1e-6", 1e-6),
        ("9e-7", 3e-7),
        ("2e-9", 1e-9),
        ("0.01", 1e-2),
        ("1e-15", 1e-15),
        ("3e-3", 3e-3),
    ],
)
def test_an_accuracy_is_rounded_down(tmp_path, given, asked):
    assert read(written(tmp_path, given)).accuracy == asked


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("0", r"`accuracy` must lie in \[1e-15, 0.01\]; got 0"),
        ("-1e-6", "`accuracy` must lie in"),
        ("nan", "`accuracy` must be finite; got nan"),
        ("1", r"`accuracy` must lie in \[1e-15, 0.01\]; got 1"),
        ("1e-20", "`accuracy` must lie in"),
        ('"fast"', "`accuracy` must be a .*number"),
        ("[1e-6]", "`accuracy` must be a .*number"),
    ],
)
def test_a_wrong_accuracy_is_one_sentence(tmp_path, given, words):
    with pytest.raises(StudyError, match=words) as caught:
        read(written(tmp_path, given))
    assert "\n" not in str(caught.value)
    assert "coarse.toml" in str(caught.value)


def test_only_grids_have_an_accuracy(tmp_path):
    with pytest.raises(
        StudyError,
        match="`accuracy` is of the gaits of a grid; this study is a `branch`",
    ):
        read(written(tmp_path, options='kind = "branch"'))


def test_what_would_have_to_be_integrated_is_left_out_unless_named(tmp_path):
    study = read(written(tmp_path))
    assert not {"residual", "energy_imbalance", "multiplier_real", "violations"} & set(
        variables(study)
    )
    assert method_of(study) is Method.INTERPOLATED
    table = {
        "name": "a",
        "accuracy": 1e-6,
        "walker": "D",
        "axes": {"slope": {"from": 1e-3, "to": 0.02, "n": 500}},
    }
    for name in ("residual", "energy_imbalance", "violations"):
        named = parse({**table, "want": {"variables": [name]}}, "", tmp_path / "a.toml")
        assert name in variables(named)
        assert method_of(named) is Method.LONG
    assert (
        method_of(
            parse(
                {**table, "want": {"variables": ["multipliers"]}},
                "",
                tmp_path / "a.toml",
            )
        )
        is Method.INTERPOLATED
    )
    assert (
        method_of(parse({**table, "accuracy": 1e-13}, "", tmp_path / "a.toml"))
        is Method.LONG
    )
    assert set(ALWAYS) <= set(
        variables(
            parse({k: v for k, v in table.items() if k != "accuracy"}, "", tmp_path)
        )
    )


def test_an_archive_says_its_accuracy_and_keeps_no_more_digits(archive):
    with netCDF4.Dataset(archive) as file:
        assert file.accuracy == 1e-6
        assert file["stance_angle"].quantization() == (23, "BitRound")
        assert file["error_bound"].quantization() is None
        bits = np.asarray(file["period"][:]).view(np.uint64) & np.uint64((1 << 29) - 1)
        assert not bits[np.isfinite(np.asarray(file["period"][:]))].any()
        assert np.nanmax(file["error_bound"][:]) <= 1e-6
        assert "residual" not in file.variables
    assert main(["verify", str(archive)]) == 0
    best = gaitsweep.gaits("D", gaitsweep.load(archive).slope.values)
    own = gaitsweep.load(archive)
    labels = own.gait.values
    for name in ("stance_angle", "period"):
        exact = best[name].sel(gait=labels).values
        assert np.nanmax(np.abs(own[name].values / exact - 1)) < 1e-6


@pytest.mark.parametrize("options", [["--jobs", "2"], ["--jobs", "2", "--chunk", "77"]])
def test_bytes_do_not_depend_on_how_it_is_run(archive, tmp_path, options):
    other = tmp_path / "coarse.nc"
    assert (
        main(
            [
                "run",
                str(written(tmp_path)),
                "--archive",
                str(other),
                "--quiet",
                *options,
            ]
        )
        == 0
    )
    assert other.read_bytes() == archive.read_bytes()


def test_gaits_of_polynomials_are_not_probed(tmp_path):
    """Their jobs are large from the first: a few points cost as much time as thousands."""
    gaitsweep.run(
        written(tmp_path, n=60_000), jobs=1, archive=tmp_path / "coarse.nc", quiet=True
    )
    events = [
        json.loads(line)
        for line in Companions(tmp_path / "coarse.nc").events.read_text().splitlines()
    ]
    sizes = [event["points"] for event in events if event["event"] == "chunk"]
    assert sum(sizes) == 60_000
    assert len(sizes) <= 4


def test_another_accuracy_solves_again_and_says_so(folder, archive, capsys):
    study = str(folder / "coarse.toml")
    assert (
        main(["plan", study, "--archive", str(archive), "--accuracy", "1e-8", "--json"])
        == 0
    )
    (record,) = json.loads(capsys.readouterr().out)
    assert (record["changed"], record["new"]) == (2000, 0)
    before = archive.read_bytes()
    assert (
        main(["run", study, "--archive", str(archive), "--accuracy", "1e-8", "--quiet"])
        == 0
    )
    with netCDF4.Dataset(archive) as file:
        assert file.accuracy == 1e-8
        assert np.nanmax(file["error_bound"][:]) <= 1e-8
    assert main(["run", study, "--archive", str(archive), "--quiet"]) == 0
    assert archive.read_bytes() == before


#: The points of a process whose digits beyond doubles are not what they are.
FEWER_DIGITS = """
from gaitsweep.tasks.studies.solve_points import points
from gaitsweep.tasks.step import extended_precision

refine = extended_precision.refine
extended_precision.refine = lambda *args: refine(*args)._replace(error=2e-15)
"""


def test_gaits_less_accurate_than_asked_are_kept_and_told(
    tmp_path, capsys, monkeypatch
):
    (tmp_path / "fewer_digits.py").write_text(FEWER_DIGITS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setitem(
        TASKS, "points", replace(TASKS["points"], function="fewer_digits:points")
    )
    study = written(tmp_path, "1e-15", n=2, options="options.steps = 2", low=0.0165)
    assert (
        main(["run", str(study), "--archive", str(tmp_path / "a.nc"), "--quiet"]) == 1
    )
    out = gaitsweep.load(tmp_path / "a.nc")
    less = out.status == "less_accurate"
    assert less.any()
    assert np.isfinite(out.stance_angle.values[less.values]).all()
    assert (out.error_bound.values[less.values] > 1e-15).all()
    assert "exceeds the accuracy wanted" in str(out.reason.values[less.values][0])
    assert main(["verify", str(tmp_path / "a.nc")]) == 0, capsys.readouterr().out


def test_one_point_to_an_accuracy(capsys):
    assert (
        main(
            [
                "solve",
                "--walker",
                "D",
                "--slope",
                "0.01",
                "--accuracy",
                "1e-15",
                "--json",
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert [gait["status"] for gait in found] == ["converged", "converged"]
    assert all(gait["error_bound"] <= 1e-15 for gait in found)
    assert main(["solve", "--walker", "D", "--slope", "0.01", "--accuracy", "2"]) == 2
    assert "`accuracy` must lie in [1e-15, 0.01]; got 2" in capsys.readouterr().err


def test_arrays_to_an_accuracy():
    slope = np.geomspace(1e-3, 0.1, 1000)
    for n in (1000, 20):
        coarse, best = (
            gaitsweep.gaits("B", slope[:n], accuracy=a, variables=["period"])
            for a in (1e-5, None)
        )
        assert (coarse.status == best.status).all()
        error = np.abs(coarse.period / best.period - 1)
        assert np.nanmax(error) < 1e-5
        assert (error.values[np.isfinite(error)] > 0).any()
        assert "residual" not in coarse
        assert coarse.attrs["accuracy"] == 1e-5 and "accuracy" not in best.attrs
    with pytest.raises(StudyError, match="`accuracy` must lie in"):
        gaitsweep.gaits("B", slope, accuracy=0.5)


@pytest.mark.thorough
def test_a_million_gaits_take_seconds_and_fewer_if_asked_for_again():
    slope, took = np.linspace(0.001, 0.05, 10**6), []
    for _ in range(2):
        began = time.process_time()
        found = gaitsweep.gaits("C", slope, accuracy=1e-6, variables=["period"])
        took.append(time.process_time() - began)

    assert found.period.sel(gait="long").notnull().all()
    # Measured: 4.4 s, then 2.1 s.
    assert took[0] < 40
    assert took[1] < took[0]


def test_short_lines_and_planes_keep_their_accuracy(tmp_path):
    table = {
        "name": "p",
        "walker": "B",
        "axes": {"slope": [0.008], "R": np.linspace(0.0, 0.2, 70).tolist()},
    }
    best = gaitsweep.run(
        {**table, "want": {"variables": ["stance_angle"]}},
        archive=tmp_path / "best.nc",
        quiet=True,
    )
    for axes in (table["axes"], {**table["axes"], "R": [0.0, 0.1, 0.2]}):
        asked = {
            **table,
            "accuracy": 1e-4,
            "axes": axes,
            "want": {"variables": ["stance_angle"]},
        }
        own = gaitsweep.run(asked, archive=tmp_path / "own.nc", quiet=True)
        assert (own.status == "converged").all()
        if len(axes["R"]) == 70:
            assert np.nanmax(np.abs(own.stance_angle / best.stance_angle - 1)) < 1e-4
            assert (own.branch == best.branch).all()
        assert own.error_bound.max() <= 1e-4
