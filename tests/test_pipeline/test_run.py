"""A run survives what ends it, and gives the same bytes however it went."""

import contextlib
import importlib.metadata
import json
import os
import platform
import random
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time

import netCDF4
import pytest

from conftest import ROOT, STUDY, TOYS, Toy
from gaitsweep.pipeline import paths
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import runner
from gaitsweep.pipeline.errors import BusyError
from processes import (
    alive,
    companions,
    damaged,
    descendants,
    drafts,
    ignored,
    wait_for_points,
)

SLOW = {"TOY_SECONDS": "0.002"}


@pytest.mark.parametrize(
    ("jobs", "chunk"),
    [
        (1, 7),
        (3, 64),
        *(
            pytest.param(jobs, chunk, marks=pytest.mark.soak)
            for jobs in (1, 2, 3)
            for chunk in (1, 7, 64, 1000)
        ),
    ],
)
def test_bytes_do_not_depend_on_workers_and_chunks(toy, whole, tell, jobs, chunk):
    toy(
        "run",
        "toy.toml",
        "--jobs",
        jobs,
        "--chunk",
        chunk,
        OMP_NUM_THREADS="2",
        OPENBLAS_NUM_THREADS="2",
    )
    assert toy.bytes() == whole
    tell(f"local, --jobs {jobs}, --chunk {chunk}: equal bytes")


def test_a_run_needs_no_shared_memory(toy, whole):
    """As where there is no /dev/shm, and joblib makes no semaphores: the run says that
    it has one worker.
    """
    said = toy("run", "toy.toml", JOBLIB_MULTIPROCESSING="0").stderr

    assert toy.bytes() == whole
    assert (
        said.count("One worker computes at a time: /dev/shm cannot be written.") == 1
        and "joblib" not in said
    )


def test_many_studies_run_with_few_open_files(toy):
    """Five files of a study are open while it runs; more studies than that wait."""
    (toy.folder / "many").mkdir()
    for k in range(70):
        toy.write(
            f'name = "s{k}"\nwalker = "E"\n[axes]\nslope = [{0.01 + k / 1000}]\n',
            f"many/s{k}.toml",
        )
    limit = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))"
    program = f"{limit}\nimport runpy, sys\nsys.argv = sys.argv[1:]\nrunpy.run_path(sys.argv[0], run_name='__main__')"

    done = subprocess.run(
        [
            sys.executable,
            "-W",
            "ignore",
            "-c",
            program,
            str(TOYS / "gaitsweep_toy.py"),
            "run",
            "many",
        ],
        cwd=toy.folder,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{TOYS}"},
        capture_output=True,
        text=True,
    )

    assert done.returncode == 0, done.stderr
    assert len(list((toy.folder / "data/archive").glob("*.nc"))) == 70
    assert "70 studies in " in done.stderr and ": converged 70" in done.stderr


def test_a_worker_that_cannot_see_its_memory_is_no_result(toy, whole):
    """As where /proc is hidden: the run ends, and with /proc the same command computes
    every point.
    """
    said = toy("run", "toy.toml", "--quiet", expect=3, TOY_WITHOUT="/proc").stderr
    assert (
        said.count("\n") == 1
        and "A worker cannot begin its task: FileNotFoundError: " in said
        and "/proc/" in said
    )

    toy("run", "toy.toml")
    assert toy.bytes() == whole


def test_the_same_command_again_computes_and_writes_nothing(toy):
    toy("run", "toy.toml")
    first = written(toy)
    toy("run", "toy.toml")
    assert written(toy) == first
    log = [json.loads(line) for line in companions(toy).events.read_text().splitlines()]
    begins = [i for i, event in enumerate(log) if event["event"] == "begin"]
    assert len(begins) == 2 and not [
        e for e in log[begins[1] :] if e["event"] in ("chunk", "task")
    ]


def written(toy):
    """The archive's place on the disk, which each writing changes."""
    return companions(toy).archive.stat().st_ino


def test_an_archive_that_is_not_of_the_results_is_written_again(toy, whole):
    """Whether one bit of it changed, it was removed, or results of another accuracy
    were written in between.
    """
    toy("run", "toy.toml")
    archive = companions(toy).archive
    data = bytearray(archive.read_bytes())
    data[-1] ^= 1
    archive.write_bytes(data)
    toy("run", "toy.toml")
    assert toy.bytes() == whole
    archive.unlink()
    toy("run", "toy.toml")
    assert toy.bytes() == whole
    for _ in range(2):  # the second time both are stored
        toy("run", "toy.toml", "--accuracy", "1e-4")
        assert toy.bytes() != whole
        toy("run", "toy.toml")
        assert toy.bytes() == whole


def test_an_archive_is_written_again_when_the_name_of_a_variable_changes(toy, tmp_path):
    """As when the code is brought up to date, without a commit of its own."""
    shutil.copytree(
        ROOT / "gaitsweep",
        tmp_path / "other/gaitsweep",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    other = {"PYTHONPATH": f"{tmp_path / 'other'}{os.pathsep}{TOYS}"}
    toy("run", "toy.toml", **other)
    table = tmp_path / "other/gaitsweep/tasks/contract/variables.toml"
    table.write_text(
        table.read_text().replace("duration of one step", "time that a step takes")
    )

    toy("run", "toy.toml", **other)

    with netCDF4.Dataset(companions(toy).archive) as file:
        assert file["period"].long_name == "time that a step takes"


def test_failures_are_told_again_by_a_run_that_writes_nothing(toy):
    trouble = {"TOY_TROUBLE": "raise@0.2"}
    failures = re.findall(
        r".* x .* First: .*", toy("run", "toy.toml", expect=1, **trouble).stderr
    )
    archive = written(toy)
    again = toy("run", "toy.toml", expect=1, **trouble).stderr
    assert failures == re.findall(r".* x .* First: .*", again) != []
    assert written(toy) == archive


@pytest.mark.parametrize(
    ("signum", "code"),
    [
        (signal.SIGINT, 130),
        (signal.SIGTERM, 143),
        (signal.SIGHUP, 129),
        (signal.SIGKILL, -9),
    ],
)
def test_a_stopped_run_leaves_no_process_and_resumes_to_the_same_bytes(
    toy, whole, signum, code
):
    process = toy.start("run", "toy.toml", "--chunk", 20, **SLOW)
    wait_for_points(toy, 2)
    children = descendants(process.pid)
    assert len(children) == 2
    process.send_signal(signum)
    _, err = process.communicate(timeout=10)
    assert process.returncode == code
    assert "Traceback" not in err
    assert not alive(children)
    kept = companions(toy).events.read_text().count('"chunk"')
    toy("run", "toy.toml", "--chunk", 20)
    assert toy.bytes() == whole
    events = map(json.loads, companions(toy).events.read_text().splitlines())
    # What was at work when the run was stopped is computed again, and nothing else.
    assert (
        sum(event["points"] for event in events if event["event"] == "chunk")
        <= 400 + 2 * 20
        and kept >= 2
    )


@pytest.mark.parametrize("signum", [signal.SIGHUP, signal.SIGINT])
def test_a_signal_that_was_ignored_from_the_start_stays_ignored(toy, whole, signum):
    """`nohup gaitsweep run`, and a job that a script has put into the background."""
    with ignored(signum):
        process = toy.start("run", "toy.toml", "--chunk", 20, **SLOW)
    wait_for_points(toy, 2)
    process.send_signal(signum)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert toy.bytes() == whole


def test_a_killed_worker_process_costs_nothing(toy, whole):
    process = toy.start("run", "toy.toml", "--chunk", 20, **SLOW)
    wait_for_points(toy, 1)
    os.kill(descendants(process.pid)[0], signal.SIGKILL)
    process.communicate(timeout=60)
    assert process.returncode == 0
    assert toy.bytes() == whole


def test_two_runs_on_one_archive_name_the_holder(toy):
    process = toy.start("run", "toy.toml", "--chunk", 20, TOY_SECONDS="0.1")
    wait_for_points(toy, 1)
    second = toy("run", "toy.toml", expect=5)
    assert (
        f"process {process.pid} on {os.uname().nodename}, started 20" in second.stderr
    )
    assert f"running as process {process.pid}" in toy("status", "toy.toml").stdout
    process.kill()
    process.wait()
    assert "stopped" in toy("status", "toy.toml").stdout
    toy("run", "toy.toml")
    assert "finished" in toy("status").stdout


def test_a_denser_grid_reuses_its_atlases(toy):
    toy("run", "toy.toml")
    toy.write(
        STUDY.replace("n = 200", "n = 399").replace("[0.0, 0.25]", "[0.0, 0.25, 0.5]")
    )
    plan = toy("plan", "toy.toml").stdout
    assert "atlas        per line: 1 new, 2 cached" in plan
    assert (
        "per point: 1,197 new" in plan
    )  # other slopes are other chunks, solved from the atlases that are there
    toy("run", "toy.toml")
    dense = toy.bytes()
    toy("run", "toy.toml", "--fresh")
    assert toy.bytes() == dense


def test_a_bumped_version_reruns_its_dependents_only(toy):
    toy("run", "toy.toml")
    plan = toy("plan", "toy.toml", TOY_VERSIONS="scaling=2").stdout
    assert (
        "2 cached" in plan and "400 cached" in plan and "per study: 1 changed" in plan
    )
    plan = toy("plan", "toy.toml", TOY_VERSIONS="points=2").stdout
    assert (
        "per line: 2 cached" in plan
        and "400 changed" in plan
        and "per study: 1" in plan
    )
    plan = toy("plan", "toy.toml", TOY_VERSIONS="atlas=2").stdout
    assert "per line: 2 changed" in plan and "400 changed" in plan


def test_a_run_says_what_it_did_and_that_code_changed(toy):
    def told(**environment):
        done = toy("run", "toy.toml", "--jobs", 1, **environment)
        return done.stdout + done.stderr

    def change_code():
        with contextlib.closing(sqlite3.connect(companions(toy).journal)) as db, db:
            assert (
                db.execute(
                    "UPDATE notes SET value = 'other' WHERE key = 'code'"
                ).rowcount
                == 1
            )

    changed = "has changed since some of these results were stored"
    first = told()
    assert "toy: 400 points (" in first and changed not in first
    record = json.loads(companions(toy).record.read_text())
    said = (
        "toy",
        "toy.nc",
        1,
        None,
        importlib.metadata.version("gaitsweep"),
        platform.node(),
    )
    assert (
        tuple(
            record[name]
            for name in ("study", "archive", "jobs", "cluster", "version", "host")
        )
        == said
    )
    change_code()
    assert changed in told() and changed not in told()
    change_code()
    assert changed not in told(TOY_VERSIONS="scaling=2")


def test_a_plan_equals_what_runs(toy):
    toy("run", "toy.toml")
    toy.write(
        STUDY.replace(
            '"stance_angle", "multipliers"', '"stance_angle", "period", "energy"'
        )
    )
    plan = toy("plan", "toy.toml").stdout
    assert (
        "per line: 2 cached" in plan
        and "400 changed" in plan
        and "1 its inputs change" in plan
    )
    toy("run", "toy.toml")
    log = [json.loads(line) for line in companions(toy).events.read_text().splitlines()]
    last = log[max(i for i, e in enumerate(log) if e["event"] == "begin") :]
    assert sum(e["points"] for e in last if e["event"] == "chunk") == 400
    assert [e["task"] for e in last if e["event"] == "task"] == ["scaling"]


@pytest.mark.parametrize(
    "part",
    [
        0.4,
        *(
            pytest.param(part, marks=pytest.mark.soak)
            for part in (0, 0.02, 0.2, 0.6, 0.8, 0.99)
        ),
    ],
)
def test_a_truncated_journal_loses_what_is_cut_off_and_no_more(toy, whole, tell, part):
    toy("run", "toy.toml", "--chunk", 10)
    size = companions(toy).journal.stat().st_size
    os.truncate(companions(toy).journal, int(part * size))
    toy("run", "toy.toml", "--chunk", 10)
    assert toy.bytes() == whole
    log = [json.loads(line) for line in companions(toy).events.read_text().splitlines()]
    last = max(i for i, event in enumerate(log) if event["event"] == "begin")
    again = sum(event["points"] for event in log[last:] if event["event"] == "chunk")
    assert again <= 400 * (1 - part) + 80
    tell(
        f"journal cut to {part:.0%}: {again} of 400 points computed again, equal bytes"
    )


@pytest.mark.parametrize("times", [2, pytest.param(100, marks=pytest.mark.soak)])
def test_a_damaged_journal_gives_the_same_bytes(toy, whole, tell, times):
    """Whatever was damaged but the mark by which it is known: one run mends it, the
    next has nothing to do.
    """
    dice, again = random.Random(times), 0
    toy("run", "toy.toml")
    made = companions(toy).journal.read_bytes()
    for _ in range(times):
        companions(toy).journal.write_bytes(made[:100] + damaged(made[100:], dice))
        for file in (companions(toy).events, companions(toy).archive):
            file.unlink()
        toy("run", "toy.toml")
        assert toy.bytes() == whole
        with contextlib.closing(sqlite3.connect(companions(toy).journal)) as db:
            assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        again += '"chunk"' in companions(toy).events.read_text()
        toy("run", "toy.toml")
        log = companions(toy).events.read_text()
        assert toy.bytes() == whole and '"chunk"' not in log[log.rindex('"begin"') :]
    tell(
        f"{times} damaged journals: equal bytes after each, {again} with points computed again"
    )


def test_a_lost_atlas_is_made_again_for_who_reads_it(toy):
    toy.write(STUDY.replace('["scaling"]', '["transition"]'))
    toy("run", "toy.toml")
    first = toy.bytes()
    with contextlib.closing(sqlite3.connect(companions(toy).journal)) as db:
        db.execute(
            "DELETE FROM records WHERE key LIKE 'atlas-%' OR key LIKE 'transition-%'"
        )
        db.commit()
    toy("run", "toy.toml")
    assert toy.bytes() == first


def test_a_run_touches_no_file_of_another(toy):
    """Whatever studies are called, and whatever a user keeps beside them."""
    folder = toy.folder / "data" / "archive"
    companions(toy).folder.mkdir(parents=True)
    others = [
        folder / name
        for name in (
            "toy.nc.tmp.5.nc",
            "toy.nc.tmp.backup",
            "b.nc.tmp.7",
            f".toy.nc.{32 * '0'}",
            "toy.journal",
            ".gaitsweep/toy.nc.tmp.5.journal",
            f".gaitsweep/.toy.journal.{32 * 'f'}",
            ".gaitsweep/README",
        )
    ]
    for file in others:
        file.write_text("mine")
    toy.write(STUDY.replace("n = 200", "n = 3"))
    toy("run", "toy.toml")
    toy("run", "toy.toml", "--archive", "data/archive/*.nc")
    assert [file.read_text() for file in others] == ["mine"] * len(others)


def test_drafts_are_removed_once_their_process_is_gone(tmp_path):
    path, gone, alive = tmp_path / "toy.nc", "0" * 32, "1" * 32
    companions = Companions(path)
    companions.make_folder()
    mine = [
        paths.of(file, gone) for file in (path, companions.journal, companions.record)
    ]
    others = [
        paths.of(tmp_path / "toy.nc", alive),
        paths.of(tmp_path / "toy2.nc", gone),
        tmp_path / "toy.nc.tmp.5",
    ]
    for file in (*mine, *others):
        file.touch()
    companions.lock.write_text(
        json.dumps({"pid": 1, "host": "here", "started": "now", "drafts": gone})
    )
    with runner.lock_archive(path):
        assert not [file for file in mine if file.exists()] and all(
            file.exists() for file in others
        )
        paths.of(path).touch()
        with pytest.raises(BusyError), runner.lock_archive(path):
            pass
        assert paths.of(path).exists()
    for text in ("", "[]", '{"drafts": 3}', '{"drafts": "../toy2.nc"}', "\0\xff"):
        companions.lock.write_text(text)
        with runner.lock_archive(path):
            assert all(file.exists() for file in others)


def test_a_foreign_file_is_not_touched(toy):
    companions(toy).folder.mkdir(parents=True)
    for file in (companions(toy).journal, companions(toy).archive):
        file.write_text("not ours\n")
        for options in ((), ("--fresh",)):
            assert "move it away" in toy("run", "toy.toml", *options, expect=2).stderr
            assert file.read_text() == "not ours\n"
        file.unlink()


def test_a_mangled_archive_is_replaced_unopened(toy, whole):
    """What crashes or hangs the netCDF library is never given to it by the run itself."""
    toy("run", "toy.toml")
    archive = companions(toy).archive
    data = archive.read_bytes()
    archive.write_bytes(data[: 1 << 14] + b"\xff" * (len(data) - (1 << 14)))
    toy("run", "toy.toml")
    assert toy.bytes() == whole


def test_snapshots_can_be_read_while_the_run_goes_on(toy, whole):
    import netCDF4

    process = toy.start("run", "toy.toml", "--chunk", 10, "--snapshot", "0", **SLOW)
    seen = set()
    while process.poll() is None:
        if companions(toy).archive.exists():
            with netCDF4.Dataset(companions(toy).archive) as file:
                seen.add(int(file.not_attempted))
                assert file.variables["status"].shape == (200, 2, 2)
        time.sleep(0.01)
    process.communicate()
    # How many snapshots there are depends on the load; one of a run that goes on there
    # is.
    assert max(seen) > 0
    assert toy.bytes() == whole


def test_a_study_of_another_kind_gives_tables(toy):
    import xarray as xr

    toy.write(
        'name = "toy"\nkind = "orbit"\nwalker = ["E", "F"]\n[axes]\nslope = [0.01, 0.02]\nw_t = [0.0, 0.1]\n'
    )
    toy("run", "toy.toml")
    archive = toy.folder / "data" / "archive" / "toy.nc"
    assert dict(xr.open_dataset(archive, engine="netcdf4").sizes) == {
        "walker": 2,
        "w_t": 2,
        "reason_index": 1,
    }
    rows = xr.open_dataset(archive, group="orbits", engine="netcdf4")
    assert rows.walker.values.tolist() == ["E"] * 4 + ["F"] * 4
    assert rows.w_t.values.tolist() == [0, 0, 0.1, 0.1] * 2
    assert rows.period.attrs == {"long_name": "duration of one step", "units": "1"}


@pytest.mark.soak
@pytest.mark.parametrize(
    ("n", "chunk", "place"),
    [(15_000, 100, "journal"), (40_000, 10**6, "journal"), (200, 100, "nc")],
)
def test_a_full_disk_stops_cleanly(toy, tmp_path, tell, n, chunk, place):
    """8 MB, full while the journal or the archive is written; with room again the same
    command finishes.
    """
    (small := tmp_path / "small").mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", small], capture_output=True
    ).returncode:
        pytest.skip("no right to mount a tmpfs")
    try:
        toy("run", "toy.toml", "--archive", small / "toy.nc")
        old = (small / "toy.nc").read_bytes()
        toy.write(
            STUDY.replace("n = 200", f"n = {n}")
            + "# changed, so that the archive is written again\n"
        )
        if place == "nc":
            disk = os.statvfs(small)
            used = (disk.f_blocks - disk.f_bfree) * disk.f_frsize
            subprocess.run(
                ["mount", "-o", f"remount,size={used + (len(old) * 3 // 4)}", small],
                check=True,
            )
        done = toy(
            "run", "toy.toml", "--archive", small / "toy.nc", "--chunk", chunk, expect=4
        )
        assert "disk is full" in done.stderr and "Traceback" not in done.stderr
        assert not re.search("HDF5|Error", done.stderr)
        assert (small / "toy.nc").read_bytes() == old
        assert not drafts(small)
        kept = Companions(small / "toy.nc").events.read_text().count('"chunk"')
        subprocess.run(["mount", "-o", "remount,size=64m", small], check=True)
        toy("run", "toy.toml", "--archive", small / "toy.nc")
        toy("run", "toy.toml")
        assert Toy.clean((small / "toy.nc").read_bytes()) == toy.bytes()
    finally:
        subprocess.run(["umount", small], check=True)
    assert re.search(r"full: \S*toy\.([\w-]+)", done.stderr)[1] == place
    tell(
        f"{2 * n:,} points on a small disk: exit 4 at the {place} after {kept} chunks, old archive intact;"
        " with room again the bytes of a run elsewhere"
    )
