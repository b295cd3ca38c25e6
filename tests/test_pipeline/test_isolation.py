"""One bad point costs one point."""

import re
import sqlite3
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from conftest import STUDY
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.engine import division
from gaitsweep.pipeline.store import file
from processes import suspend, wait_for_points

#: Trouble, the status it ends with, and words of its reason.
TROUBLES = {
    "raise": ("raised", "RuntimeError: trouble at 0.050"),
    "exit": ("raised", "SystemExit: 3"),
    "unpicklable": ("raised", "Local"),
    "segfault": ("worker_died", "SIGSEGV"),
    "kill": ("worker_died", "SIGKILL"),
    "hang": ("timed_out", "longer than 0.5 s"),
    "eat": ("out_of_memory", "more than 256 MiB"),
}
LIMITED = (
    STUDY.replace("n = 200", "n = 191")
    + '[limits]\nseconds = 0.5\nmemory = "256 MiB"\n'
)
ONE_LINE = LIMITED.replace("[0.0, 0.25]", "[0.25]")


def opened(toy, name="toy"):
    return xr.open_dataset(
        toy.folder / "data" / "archive" / f"{name}.nc", engine="netcdf4"
    ).load()


@pytest.fixture(scope="module")
def innocent(tmp_path_factory):
    from conftest import Toy

    toy = Toy(tmp_path_factory.mktemp("innocent"))
    toy.write(ONE_LINE)
    toy("run", "toy.toml")
    return opened(toy)


@pytest.mark.parametrize("trouble", TROUBLES)
def test_a_bad_point_gets_a_status_and_all_others_keep_their_bits(
    toy, innocent, trouble
):
    toy.write(ONE_LINE.replace("= 0.5", "= 5") if trouble == "eat" else ONE_LINE)
    toy("run", "toy.toml", expect=1, TOY_TROUBLE=f"{trouble}@0.05")
    found = opened(toy)
    status, words = TROUBLES[trouble]
    bad = np.isclose(found.slope, 0.05)
    meanings = dict(
        zip(found.status.flag_meanings.split(), found.status.flag_values, strict=True)
    )
    assert (found.status[bad] == meanings[status]).all()
    reasons = found.reason_text.values[found.reason[bad].values]
    assert all(words in str(r) for r in reasons.ravel())
    for name in ("stance_angle", "multiplier_real", "residual", "status"):
        np.testing.assert_array_equal(found[name][~bad], innocent[name][~bad])
        if name != "status":
            assert np.isnan(found[name][bad]).all()
    np.testing.assert_array_equal(found.branch[~bad], innocent.branch[~bad])
    assert (found.branch[bad] == -1).all()


@pytest.mark.parametrize("trouble", ["raise", "kill"])
def test_a_bad_point_of_a_block_of_lines_costs_one_point(toy, trouble):
    """Short lines are computed side by side; archives are the same, whichever way."""
    lines = LIMITED.replace("[0.0, 0.25]", "[0.0, 0.25, 0.5, 0.75]").replace(
        "= 0.5", "= 5"
    )
    toy.write(lines)
    toy("run", "toy.toml", expect=1, TOY_TROUBLE=f"{trouble}@0.05")
    archive = toy.folder / "data" / "archive" / "toy.nc"
    apart = archive.read_bytes()
    toy(
        "run",
        "toy.toml",
        "--fresh",
        expect=1,
        TOY_TROUBLE=f"{trouble}@0.05",
        TOY_SIDE_BY_SIDE="toy:lines",
    )
    assert archive.read_bytes() == apart
    assert (opened(toy).status.sel(gait="long") != 0).sum() == 4


def test_a_line_without_an_atlas_costs_its_block_nothing(toy):
    lines = STUDY.replace("[0.0, 0.25]", "[0.25, 0.5, 13.0]")
    toy.write(lines)
    toy("run", "toy.toml", expect=1, TOY_SIDE_BY_SIDE="toy:lines")
    found = opened(toy)
    assert (found.status.sel(gait="long", w_t=[0.25, 0.5]) == 0).all()
    reasons = found.reason_text.values[found.reason.sel(w_t=13.0).values]
    assert all("no atlas here" in str(each) for each in reasons.ravel())


def test_what_workers_log_is_said_once(toy):
    """Each line has a point that logs the same."""
    toy.write(LIMITED)

    err = toy("run", "toy.toml", "--chunk", 5, TOY_TROUBLE="log@0.05").stderr

    assert err.count("engine: Trouble is in sight.\n") == 1
    assert (opened(toy).status.sel(gait="long") == 0).all()


def test_a_run_that_was_suspended_blames_no_point(toy):
    """All of its processes stopped for longer than a point may take, as a scheduler
    does; the worker wakes last.
    """
    toy.write(ONE_LINE.replace("n = 191", "n = 3").replace("= 0.5", "= 2"))
    process = toy.start("run", "toy.toml", "--chunk", 1, "--jobs", 1, TOY_SECONDS="0.8")
    wait_for_points(toy, 1)
    suspend(process.pid, 2.5)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert (opened(toy).status.sel(gait="long") == 0).all()


def test_a_point_that_takes_too_long_once_is_tried_again(toy):
    toy.write(ONE_LINE.replace("n = 191", "n = 3"))
    toy(
        "run",
        "toy.toml",
        "--chunk",
        1,
        TOY_TROUBLE=f"once@{np.linspace(0.01, 0.2, 3)[1]}",
    )
    assert (toy.folder / "hung").exists() and (
        opened(toy).status.sel(gait="long") == 0
    ).all()


def test_failed_points_are_kept_until_retried(toy):
    toy.write(LIMITED)
    toy("run", "toy.toml", expect=1, TOY_TROUBLE="raise@0.05 segfault@0.15")
    again = toy("run", "toy.toml", expect=1)
    assert "raised 2" in again.stderr and "worker_died 2" in again.stderr
    assert (
        "2 x It raised RuntimeError: trouble at 0.050. First: E w_t=0.0 slope=0.05\n"
        in again.stderr
    )
    assert (
        "80 retried" in toy("plan", "toy.toml", "--retry-failed").stdout
    )  # four chunks of twenty
    toy("run", "toy.toml", "--retry-failed")
    retried = toy.bytes()
    toy("run", "toy.toml", "--fresh")
    assert toy.bytes() == retried


def test_a_failed_atlas_costs_its_line(toy):
    toy.write(STUDY.replace("[0.0, 0.25]", "[0.0, 13.0]"))
    toy("run", "toy.toml", expect=1)
    found = opened(toy)
    assert (found.status.sel(w_t=0.0, gait="long") == 0).all()
    assert (found.status.sel(w_t=13.0) == 8).all()
    assert (
        "The atlas of the line: it raised ValueError: no atlas here."
        in found.reason_text.values
    )
    with netCDF4.Dataset(toy.folder / "data" / "archive" / "toy.nc") as file:
        assert "failed_tasks" not in file.groups


def test_an_atlas_that_fails_beside_stored_points_is_told(tmp_path, capsys):
    """Points of short lines keep no atlas; figures that read one have it made later."""
    study, archive = tmp_path / "s.toml", tmp_path / "s.nc"
    study.write_text('name = "s"\nwalker = "D"\n[axes]\nslope = [0.005, 0.01]\n')
    assert (
        commands.main(["run", f"{study}", "--archive", f"{archive}", "--jobs", "1"])
        == 0
    )
    study.write_text(
        study.read_text() + '[want]\nfigures = ["angles"]\n[limits]\nseconds = 1e-5\n'
    )
    capsys.readouterr()
    assert (
        commands.main(["run", f"{study}", "--archive", f"{archive}", "--jobs", "1"])
        == 1
    )
    err = capsys.readouterr().err
    assert "2 points (converged 2)" in err and "\n  atlas: timed_out; " in err
    failed = xr.load_dataset(archive, engine="netcdf4", group="failed_tasks")
    assert failed.task.values.tolist() == [
        "atlas"
    ] and failed.outcome.values.tolist() == ["timed_out"]


def test_a_result_that_no_journal_can_hold_costs_its_line(
    tmp_path, monkeypatch, capsys
):
    """It was called a damage of the journal, and computed three times."""
    connect = file.connect

    def limited(*args, **options):
        db = connect(*args, **options)
        db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 300_000)
        return db

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(file, "connect", limited)
    monkeypatch.setattr(division, "MAX_PAYLOAD", 299_000)
    orbit = (
        "[axes]\nslope = [0.01]\n[options]\nsteps = 1000\nshown = 1000\nstarts = 8\n"
    )
    Path("s.toml").write_text(f'name = "s"\nkind = "orbit"\nwalker = "D"\n{orbit}')
    assert commands.main(["run", "s.toml", "--jobs", "1"]) == 1
    assert re.search(
        r"1 x Its result of \d+ B is larger than a journal can hold\.",
        capsys.readouterr().err,
    )
