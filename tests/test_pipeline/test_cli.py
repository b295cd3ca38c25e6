"""What a user types: quick, one line for an error, the promised exit codes."""

import errno
import fcntl
import functools
import itertools
import json
import logging
import math
import os
import re
import resource
import shlex
import shutil
import sqlite3
import subprocess
import sys
import threading
import time
import tomllib
import tracemalloc
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import netCDF4
import numpy as np
import pytest

import gaitsweep
from conftest import ROOT, STUDY, TOYS, Toy
from gaitsweep import load
from gaitsweep.pipeline.archive import read, write
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import locks
from gaitsweep.pipeline.engine import work as engine_work
from gaitsweep.pipeline.engine.progress import last_state
from gaitsweep.pipeline.errors import (
    ArchiveError,
    BusyError,
    DiskFullError,
    StoppedError,
    StudyError,
    WorkerError,
    unwritten,
)
from gaitsweep.pipeline.terminal import duration
from gaitsweep.tasks.contract.status import beyond
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.statics import is_tuned
from processes import companions, ended

#: For a shell, in folders with spaces too.
TOY_COMMAND = shlex.join([sys.executable, str(TOYS / "gaitsweep_toy.py")])


def command(*arguments, cwd=None):
    return subprocess.run(
        [sys.executable, "-m", "gaitsweep", *map(str, arguments)],
        cwd=cwd,
        text=True,
        timeout=60,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
    )


def quickest(*arguments, cwd=None, tries=3):
    """Least processor time of a few [s], on a machine that loads numpy in 0.15 s:
    shared ones slow down by the hour.
    """

    def least(*command):
        times = []
        for _ in range(tries):
            process = subprocess.Popen(
                [sys.executable, *command],
                cwd=cwd,
                stdout=subprocess.DEVNULL,
                env={**os.environ, "PYTHONPATH": str(ROOT)},
            )
            _, status, used = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
            assert process.returncode == 0
            times.append(used.ru_utime + used.ru_stime)
        return min(times)

    return least("-m", "gaitsweep", *arguments) / max(
        1.0, least("-c", "import numpy") / 0.15
    )


@pytest.mark.parametrize("is_terminal", [True, False])
def test_a_command_shows_what_is_logged(is_terminal, monkeypatch, capsys):
    logger = logging.getLogger("gaitsweep")

    def log(options):
        logger.info("It takes long.")
        logger.warning("gaitsweep: It is wrong.")
        return 0

    monkeypatch.setattr(commands.terminal, "is_terminal", lambda: is_terminal)
    monkeypatch.setattr("gaitsweep.pipeline.cli.walkers.run", log)
    assert commands.main(["walkers"]) == 0

    shown = capsys.readouterr().err.splitlines()
    told = ["gaitsweep: It takes long."] * is_terminal
    assert shown == [*told, "gaitsweep: It is wrong."]
    assert not logger.handlers


def test_help_is_quick():
    assert quickest("--help") < 0.15


def test_a_small_plan_is_quick_and_loads_no_solver(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    assert quickest("plan", "s.toml", cwd=tmp_path) < 0.4
    program = (
        "import sys; from gaitsweep.pipeline.cli import commands; "
        "commands.main(['plan', 's.toml']);print(*sys.modules)"
    )
    found = (
        subprocess.run(
            [sys.executable, "-c", program],
            cwd=tmp_path,
            text=True,
            capture_output=True,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        .stdout.splitlines()[-1]
        .split()
    )
    assert not {
        "heyoka",
        "scipy",
        "joblib",
        "netCDF4",
        "h5py",
        "xarray",
        "matplotlib",
        "dask",
    } & {m.split(".")[0] for m in found}
    assert not {"multiprocessing", "importlib.metadata"} & set(
        found
    )  # of workers and of other packages' measures
    assert not list(tmp_path.glob("data*"))


@pytest.mark.parametrize(
    "axes",
    [
        "slope = { from = 1e-4, to = 0.2, n = 1000000 }",
        "slope = { from = 1e-4, to = 0.2, n = 1000 }\nw_t = { from = 0, to = 0.1, n = 1000 }",
    ],
)
def test_a_plan_of_a_million_points_is_quick_and_small(tmp_path, axes):
    (tmp_path / "s.toml").write_text(f'name = "s"\nwalker = "E"\n[axes]\n{axes}\n')
    assert quickest("plan", "s.toml", cwd=tmp_path) < 1.0
    told, kibibytes = plan_and_memory(tmp_path)
    assert "1,000,000 points" in told and kibibytes < 200 << 10


def plan_and_memory(folder):
    """First line of the plan of a study, and the memory that it took [KiB]: the kernel's
    own high-water mark of this program, as getrusage would count what the parent held
    before it.
    """
    program = (
        "from pathlib import Path; from gaitsweep.pipeline.cli import commands; commands.main(['plan', 's.toml']);"
        "print(Path('/proc/self/status').read_text().split('VmHWM:')[1].split()[0])"
    )
    found = subprocess.run(
        [sys.executable, "-c", program],
        cwd=folder,
        text=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ).stdout.splitlines()
    return found[0], int(found[-1])


def test_slopes_are_read_as_arrays_however_many(tmp_path):
    axes = "slope = { from = 1e-3, to = 0.02, n = 10000000 }\nR = { from = 0.0, to = 0.2, n = 100 }"
    (tmp_path / "s.toml").write_text(f'name = "s"\nwalker = "E"\n[axes]\n{axes}\n')

    told, kibibytes = plan_and_memory(tmp_path)

    # Ten million slopes are 80 MB; as numbers of Python they would be 320.
    assert "1,000,000,000 points" in told and kibibytes < 300 << 10


LONG_NAME = [300 * "x" + ".nc"]
CHUNK = "Argument --chunk: must be a whole number from 1 to 1,000,000,000; got {} (gaitsweep run --help)."


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["solve", "--walkr", "D", "--slope", "0.01"],
            "Unknown option `--walkr`, did you mean `--walker`?",
        ),
        (
            ["run"],
            "The following arguments are required: STUDY.toml (gaitsweep run --help).",
        ),
        (["run", "none.toml"], "There is no file none.toml."),
        (
            ["run", "s.toml", "--jobs", "0"],
            "Argument --jobs: must be a whole number from 1 to 1,000; got 0 (gaitsweep run --help).",
        ),
        (
            ["run", "s.toml", "t.toml", "--archive", "x.nc"],
            "`--archive` names one file, but there are several studies.",
        ),
        (
            ["run", "s.toml", "--archive", ""],
            "Argument --archive: must name a file; got '' (gaitsweep run --help).",
        ),
        *(
            (
                ["run", "s.toml", "--archive", name],
                f"Argument --archive: must be a name that ends in .nc; got {name} (gaitsweep run --help).",
            )
            for name in ("x", ".nc", "a.journal")
        ),
        (
            ["run", "s.toml", "--archive", "/"],
            "Argument --archive: must name a file; got '/' (gaitsweep run --help).",
        ),
        (
            ["run", "s.toml", "--archive", "a\udcff"],
            "Argument --archive: must name a file; got 'a\\udcff' (gaitsweep run --help).",
        ),
        (
            ["run", "s.toml", "--jobs", "1001"],
            "Argument --jobs: must be a whole number from 1 to 1,000; got 1001 (gaitsweep run --help).",
        ),
        (
            ["run", "s.toml", "--archive", "s.toml/x.nc"],
            "s.toml cannot be written: File exists.",
        ),
        (
            ["run", "s.toml", "--cluster", "nowhere"],
            "`--cluster` must be tcp://HOST:PORT or local:N, N from 1 to 999; got nowhere.",
        ),
        (
            ["run", "s.toml", "--cluster", "local:0"],
            "`--cluster` must be tcp://HOST:PORT or local:N, N from 1 to 999; got local:0.",
        ),
        *(
            (
                ["run", "s.toml", "--snapshot", seconds],
                f"Argument --snapshot: must be at least 0 s; got {seconds} (gaitsweep run --help).",
            )
            for seconds in ("nan", "-5")
        ),
        (["plan", "s.toml", "s.toml"], "Two studies are called toy."),
        (["verify", "none.nc"], "There is no archive none.nc."),
        *(
            (
                [command, *LONG_NAME * n],
                f"{LONG_NAME[0]} cannot be read: File name too long.",
            )
            for command, n in (("verify", 1), ("report", 1), ("diff", 2), ("prove", 1))
        ),
        (["run", "s.toml", "--chunk", 999 * "9"], CHUNK.format(60 * "9")),
        (["run", "s.toml", "--chunk", "٣"], CHUNK.format("٣")),
        *(
            (
                ["solve", "--walker", "D", "--slope", slope],
                f"Argument --slope: must be a number; got {slope} (gaitsweep solve --help).",
            )
            for slope in ("0.٠١", "0.0_1")
        ),
        (
            ["solve", "--walker", "D", "--slope", "0.01", "--set", "R=abc"],
            "Argument --set: `R` must be a number; got abc (gaitsweep solve --help).",
        ),
        (
            ["solve", "--walker", "D", "--slope", "0.01", "--set", "m_t=[1,2]"],
            "Argument --set: `m_t` must be one number, that of both legs; got [1,2] (gaitsweep solve --help).",
        ),
        (
            ["solve", "--walker", "D", "--slope", "0.01", "--limit", "scuff=x"],
            "Argument --limit: `scuff` must be a number; got x (gaitsweep solve --help).",
        ),
        (
            ["solve", "--walker", "D", "--at", "speed"],
            "Argument --at: must be MEASURE=VALUE; got speed (gaitsweep solve --help).",
        ),
        (
            ["solve", "--walker", "D", "--slope", "0.01", "--vary", "R"],
            "`vary` needs `at`, a measure with its value; got 'R'.",
        ),
        (
            ["solve", "--walker", "D", "--slope", "0.01", "--steps", "0"],
            "Argument --steps: must be a whole number from 1 to 64; got 0 (gaitsweep solve --help).",
        ),
        (
            ["diff", "a.nc", "b.nc", "--rtol", "period=1"],
            "Argument --rtol: `period` must lie in [0, 1); got 1 (gaitsweep diff --help).",
        ),
        (["verify", "/dev/null"], "/dev/null is a device, not an archive."),
        (
            ["completion", 999 * "x"],
            f"Unknown shell `{'x' * 57}...`, known: bash, zsh.",
        ),
        *(
            (
                [*command, "s.toml"],
                "s.toml is a study or a walker; an archive NAME.nc is wanted.",
            )
            for command in (["report"], ["verify"], ["prove"], ["diff", "a.nc"])
        ),
        (["diff", "a.nc", "none.nc"], "There is no archive none.nc."),
        (["diff", "a.nc", "a.nc"], "a.nc is no netCDF file that can be read."),
        *(
            ([command, "a.nc"], "a.nc is an archive; a file NAME.toml is wanted.")
            for command in ("run", "plan")
        ),
        *(
            (
                [command, "--walker", "D", "--slope", "2"],
                "`slope` must lie in [1e-18, 0.5) rad; got 2.0: degrees? 2 degrees are 0.0349066 rad.",
            )
            for command in ("solve", "prove")
        ),
        (
            ["solve", "--walker", "D", "--slope", "29"],
            "`slope` must lie in [1e-18, 0.5) rad; got 29.0.",
        ),
        (
            ["solve", "--walker", "D", "--slope", "40", "--degrees"],
            "`slope` must lie in [5.73e-17, 28.65) degrees; got 40.",
        ),
        (
            ["solve", "--walker", "D", "--slope", "0.01", "--set", "m_q=1"],
            "`m_q` is not a walker key (did you mean `m_t` or `m_s` or `m_h`?); got 1.0.",
        ),
        (
            ["solve", "--walker", "Q", "--slope", "0.1"],
            "Unknown name `Q`, known: A, B, C, D, E, F,"
            " physical, physical-straight, A-printed, C-printed, or a file FILE.toml.",
        ),
        (
            [
                "solve",
                "--walker",
                "E",
                "--slope",
                "0.01",
                "--set",
                "foot_mass_ratio=0.1",
                "--set",
                "m_h=1",
            ],
            "`m_h` is set by `foot_mass_ratio`, which owns m_t, m_s, m_h; got 1.0.",
        ),
        (
            ["solve", "--walker", "E", "--slope", "0.01", "--set", "slope=3"],
            "`slope` is not a walker key (keys: l_t, w_t, m_t, r_t, c_t, l_s, w_s, m_s, r_s, c_s, R, eps_T, m_h, g,"
            " push_off, hip_stiffness, hip_damping, hip_rest, hip_torque, knees, trailing_knee, detuning,"
            " foot_mass_ratio); got 3.0.",
        ),
        *(
            (
                [
                    command,
                    "--walker",
                    "D",
                    "--slope",
                    "0.01",
                    "--set",
                    "R=0.1",
                    "--set",
                    "m_h=1",
                    "--set",
                    "R=0.2",
                ],
                f"Argument --set: `R` is given twice (gaitsweep {command} --help).",
            )
            for command in ("solve", "prove")
        ),
        (
            ["plan", "s.toml", "--accuracy", "5"],
            "`accuracy` must lie in [1e-15, 0.01]; got 5.0.",
        ),
        *(
            (
                [
                    command,
                    "--walker",
                    "D",
                    "--slope",
                    "0.01",
                    "--set",
                    f"knees={value}",
                ],
                f"Argument --set: `knees` must be true or false; got {value} (gaitsweep {command} --help).",
            )
            for command, value in (("solve", "1"), ("solve", "no"), ("prove", "0"))
        ),
        (["sovle"], "Unknown command `sovle`, did you mean `solve`?"),
        (
            ["frobnicate"],
            f"Unknown command `frobnicate`, known: {', '.join(commands.COMMANDS)}.",
        ),
    ],
)
def test_bad_input_is_one_line_and_exit_2(
    tmp_path, monkeypatch, capsys, arguments, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.nc").write_text("no archive")
    for name in ("s.toml", "t.toml"):
        (tmp_path / name).write_text(
            STUDY.replace("toy", "t") if name == "t.toml" else STUDY
        )
    assert commands.main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    if said:
        assert err == f"gaitsweep: {said}\n"


def test_a_folder_that_cannot_be_written_is_said(toy):
    if os.geteuid() == 0:
        (toy.folder / "data").write_text("in the way")
    else:
        (toy.folder / "data").mkdir(mode=0o500)
    assert "cannot be written" in toy("run", "toy.toml", expect=2).stderr


@pytest.mark.parametrize("name", ["journal", "lock", "events", "record", "archive"])
def test_a_folder_in_the_place_of_a_file_is_named(toy, name):
    path = getattr(companions(toy), name)
    path.mkdir(parents=True)
    (said,) = toy("run", "toy.toml", "--quiet", expect=2).stderr.splitlines()
    assert str(path.relative_to(toy.folder)) in said and "directory" in said


def test_a_limit_of_the_system_is_not_called_damage(toy, monkeypatch, capsys):
    toy("run", "toy.toml")
    archive = toy.folder / "data" / "archive" / "toy.nc"
    for code, said in (
        (errno.EAGAIN, "Resource temporarily unavailable"),
        (errno.EMFILE, "Too many open files"),
    ):
        monkeypatch.setattr(
            read.subprocess, "Popen", Mock(side_effect=OSError(code, os.strerror(code)))
        )
        assert commands.main(["verify", str(archive)]) == 3
        assert (
            capsys.readouterr().err
            == f"gaitsweep: {archive} cannot be tried in another process: {said}.\n"
        )
        error = unwritten(archive, OSError(code, os.strerror(code)))
        assert (error.exit_code, str(error)) == (
            3,
            f"A limit of the system is reached at {archive}: {said}.",
        )
    monkeypatch.setattr(read.subprocess, "Popen", Mock(return_value=ended(1)))
    assert commands.main(["verify", str(archive)]) == 3


@pytest.mark.parametrize("files", [8, 10, 12])
def test_few_file_handles_are_said_in_one_line(toy, files):
    limit = f"import resource; resource.setrlimit(resource.RLIMIT_NOFILE, ({files}, {files}))"
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
            "toy.toml",
            "--quiet",
        ],
        cwd=toy.folder,
        env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{TOYS}"},
        capture_output=True,
        text=True,
    )
    assert done.returncode in (2, 3), done.stderr
    assert "Internal" not in done.stderr and done.stderr.count("\n") == 1


def test_status_tells_what_happened_to_people_and_machines(toy):
    assert "there is no record of a run" in toy("status", "toy.toml").stdout
    toy("run", "toy.toml", "--quiet")
    text = toy("status").stdout
    assert re.search(
        r"^data/archive/toy.nc: finished: 400 points in [\d.]+ s\n  converged 400$",
        text,
        re.M,
    )
    (found,) = json.loads(toy("status", "--json").stdout)
    assert json.loads(toy("status", "--json", found["archive"]).stdout) == [found]
    (toy.folder / "other.nc").touch()
    (none,) = json.loads(toy("status", "--json", "other.nc").stdout)
    assert none == {"archive": "other.nc"}
    assert found["done"] == 400 and found["running"] is False


@pytest.mark.parametrize("events", [3, 3_000, 30_000])
def test_the_last_state_is_found_however_many_events_follow(tmp_path, events):
    """Thousands of tasks a second leave megabytes between two states; of these, only a
    part is in memory.
    """
    state, task = (
        {"event": name, "points": 7, "of": "x" * 100} for name in ("state", "task")
    )
    log = tmp_path / "log"
    lines = [
        json.dumps(event) + "\n" for event in ({**state, "points": 8}, state, task)
    ]
    begin = json.dumps({"time": 5.0, "event": "begin"}) + "\n"
    log.write_text(
        "no event\n" + begin + "".join(lines[:2]) + lines[2] * events + lines[2][:20]
    )
    tracemalloc.start()
    try:
        assert last_state(log) == {**state, "began": 5.0, "over": False}
        assert tracemalloc.get_traced_memory()[1] < 2e6
    finally:
        tracemalloc.stop()
    log.write_text(log.read_text() + '\n{"event": "end"}\n')
    assert last_state(log) == {**state, "began": 5.0, "over": True}
    log.write_text("x" * 1_000_000)
    assert last_state(log) is None


def test_quiet_is_quiet_and_the_summary_counts(toy):
    assert toy("run", "toy.toml", "--quiet").stderr == ""
    done = toy("run", "toy.toml")
    assert done.stdout == "" and "toy: 400 points (converged 400)" in done.stderr
    assert (
        done.stderr.splitlines()[-1]
        == "To see it: gaitsweep report data/archive/toy.nc  (makes reports/index.html)"
    )
    record = json.loads(companions(toy).record.read_text())
    assert (
        record["exit_code"] == 0
        and record["counts"] == {"converged": 400}
        and record["seconds"] > 0
    )


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("x" * 222 + ".nc", "File name too long."),
        (
            "gone.nc",
            "No such file or directory.",
        ),  # a link into a folder that is not there
        ("a\\b.nc", "the netCDF library opens no file of such a name."),
    ],
)
def test_where_no_archive_can_be_written_nothing_is_computed(toy, name, said):
    (toy.folder / "gone.nc").symlink_to("nowhere/s.nc")
    ended = toy("run", "toy.toml", "--archive", name, expect=2)
    assert (
        ended.stderr.splitlines()[0] == f"gaitsweep: {name} cannot be written: {said}"
    )
    assert not list(toy.folder.glob("*.journal")) and not list(toy.folder.glob(".*"))


@pytest.mark.parametrize(
    "name", [b"a\\b", b"\xe4", b" lead"], ids=["backslash", "latin-1", "blank"]
)
def test_the_folder_of_a_study_may_have_any_name(toy, name):
    toy("run", "toy.toml", "--quiet")
    folder = Path(os.fsdecode(os.path.join(os.fsencode(toy.folder), name)))
    folder.mkdir()
    Toy(folder)("run", "../toy.toml", "--quiet")
    assert Toy(folder).bytes() == toy.bytes()
    assert "is intact" in Toy(folder)("verify", "data/archive/toy.nc").stdout
    if b"lead" not in name:
        said = toy("verify", folder / "data" / "archive" / "toy.nc", expect=1).stdout
        assert said.startswith("The netCDF library opens no file of such a name as ")


def test_the_folder_of_an_archive_may_begin_with_a_blank(toy):
    (toy.folder / " data").mkdir()
    toy("run", "toy.toml", "--quiet", "--archive", " data/toy.nc")
    assert "is intact" in toy("verify", " data/toy.nc").stdout


@pytest.mark.parametrize(
    "record",
    [
        '"elapsed": 3.0',
        '"points": "some", "counts": 3',
        '"points": 0, "counts": {}, "stages": [1]',
    ],
)
def test_a_state_of_another_version_is_told_as_such(
    tmp_path, monkeypatch, capsys, record
):
    monkeypatch.chdir(tmp_path)
    archive = tmp_path / "data" / "archive" / "s.nc"
    Companions(archive).folder.mkdir(parents=True)
    Companions(archive).events.write_text(f'{{"event": "state", {record}}}\n')
    assert commands.main(["status"]) == 0
    assert (
        capsys.readouterr().out
        == "data/archive/s.nc: its record of a run is not one of this version.\n"
    )


@pytest.mark.parametrize("redirection", ["2>&-", "2>/dev/full", "<&- >&- 2>&-"])
def test_a_run_needs_no_standard_error(toy, redirection):
    toy("run", "toy.toml", "--quiet")
    whole = toy.bytes()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(TOYS)])}
    command = f"{TOY_COMMAND} run toy.toml --fresh {redirection}"
    assert (
        subprocess.run(
            ["bash", "-c", command], cwd=toy.folder, env=environment
        ).returncode
        == 0
    )
    assert toy.bytes() == whole


def test_letters_that_a_terminal_lacks_are_printed_by_number(toy):
    (toy.folder / "θ.nc").touch()
    said = toy("status", "θ.nc", PYTHONIOENCODING="latin-1").stdout
    assert said == "\\u03b8.nc: there is no record of a run.\n"


@pytest.mark.parametrize("buffer", [False, True], ids=["unbuffered", "buffered"])
@pytest.mark.parametrize("arguments", ["status", "--version", "--help", "run --help"])
def test_output_that_finds_no_room_is_said(toy, arguments, buffer):
    """Short output waits in a buffer until the command ends, unless `PYTHONUNBUFFERED`
    is set.
    """
    paths = {
        "PYTHONPATH": os.pathsep.join([str(ROOT), str(TOYS)]),
        "PYTHONUNBUFFERED": "" if buffer else "1",
    }
    command = f"{TOY_COMMAND} {arguments}"
    run = functools.partial(
        subprocess.run,
        cwd=toy.folder,
        env=os.environ | paths,
        capture_output=True,
        text=True,
    )
    done = run(["bash", "-c", f"{command} >/dev/full"])
    assert (done.returncode, done.stderr) == (
        4,
        "gaitsweep: The disk is full; not everything could be printed.\n",
    )
    done = run(["bash", "-c", f"({command}; echo $? >&2) | true"])
    assert done.stderr in (
        "1\n",
        "0\n",
    )  # of a reader that has gone, and of one that was not gone yet


def test_a_run_is_not_refused_by_a_look_at_its_state(toy):
    """`status` holds the lock for a moment, and it still names the last run."""
    toy("run", "toy.toml", "--quiet")
    path = toy.folder / "data" / "archive" / "toy.nc"
    with companions(toy).lock.open() as file:
        fcntl.flock(file, fcntl.LOCK_SH)
        timer = threading.Timer(0.1, fcntl.flock, (file, fcntl.LOCK_UN))
        timer.start()
        with locks.lock_archive(path):
            pass
        timer.join()


@pytest.mark.parametrize(
    ("line", "shown"), [('name = "Öre 2"', "Öre 2"), ("", "custom")]
)
def test_a_walker_of_a_file_is_shown_by_its_name(
    tmp_path, monkeypatch, capsys, line, shown
):
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text(f'[walker]\nbase = "D"\n{line}\n', encoding="utf-8")
    assert commands.main(["walkers", "mine.toml"]) == 0
    assert capsys.readouterr().out.startswith(f"{shown}: a walker of your own\n")


@pytest.mark.parametrize("reason", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP])
def test_a_disk_without_locks_is_refused(toy, monkeypatch, capsys, reason):
    """As some network disks are; two runs of one archive would not know of each other."""
    monkeypatch.chdir(toy.folder)
    monkeypatch.setattr(
        locks.fcntl, "flock", Mock(side_effect=OSError(reason, os.strerror(reason)))
    )
    assert commands.main(["run", "toy.toml", "--jobs", "1"]) == 2
    assert capsys.readouterr().err.endswith(
        "cannot be locked: its disk has no locks; choose another folder.\n"
    )
    assert not companions(toy).journal.exists()


def test_a_disk_without_shared_memory_holds_a_journal(toy, monkeypatch):
    """SQLite keeps no write-ahead log there, but a journal to roll back; this file
    system of its own has none.
    """
    monkeypatch.chdir(toy.folder)
    toy.write('name = "toy"\nwalker = "D"\n[axes]\nslope = [0.01]\n')
    run = ["run", "toy.toml", "--jobs", "1", "--quiet"]
    assert commands.main(run) == 0
    whole, connect, modes = toy.bytes(), sqlite3.connect, []

    def without_shared_memory(path, **options):
        options["uri"] = True
        db = connect(
            path if str(path).startswith("file:") else f"file:{path}?vfs=unix-dotfile",
            **options,
        )
        modes.append(db.execute("PRAGMA journal_mode=WAL").fetchone())
        return db

    monkeypatch.setattr(sqlite3, "connect", without_shared_memory)
    for options in (["--fresh"], []):
        assert commands.main([*run, *options]) == 0
        assert toy.bytes() == whole
    assert ("delete",) in modes and ("wal",) not in modes


def test_a_snapshot_that_finds_no_room_does_not_end_the_run(toy, monkeypatch, capsys):
    monkeypatch.chdir(toy.folder)
    written, errors = (
        write.write,
        iter([DiskFullError("The disk is full: toy.nc is unchanged.")]),
    )

    def fail_once(plan, path):
        for error in errors:
            raise error
        return written(plan, path)

    monkeypatch.setattr("gaitsweep.pipeline.archive.write.write", fail_once)
    toy.write('name = "toy"\nwalker = "D"\n[axes]\nslope = [0.01]\n')
    assert commands.main(["run", "toy.toml", "--jobs", "1", "--snapshot", "0"]) == 0
    said = "The archive is not published before the end: The disk is full: toy.nc is unchanged.\n"
    assert capsys.readouterr().err.startswith(said)


def test_memory_is_counted_in_pages_of_the_system(toy, monkeypatch):
    """Which on some are of 64 KiB."""
    monkeypatch.chdir(toy.folder)
    monkeypatch.setattr(resource, "getpagesize", lambda: 1 << 40)
    toy.write(
        'name = "toy"\nwalker = "D"\n[axes]\nslope = [0.01]\n[limits]\nmemory = "1024 TiB"\n'
    )
    commands.main(["run", "toy.toml", "--jobs", "1", "--quiet"])
    assert last_state(companions(toy).events)["memory"] > 1 << 40


def test_a_clock_set_back_during_a_run_changes_no_duration(toy, monkeypatch, capsys):
    monkeypatch.chdir(toy.folder)
    monkeypatch.setattr(
        time, "time", functools.partial(next, itertools.count(2e9, -3600.0))
    )
    toy.write('name = "toy"\nwalker = "D"\n[axes]\nslope = [0.01]\n')
    assert commands.main(["run", "toy.toml", "--jobs", "1"]) == 0
    assert " in -" not in capsys.readouterr().err
    assert last_state(companions(toy).events)["elapsed"] > 0


def test_a_record_that_finds_no_room_is_missed(toy, monkeypatch, capsys):
    monkeypatch.chdir(toy.folder)
    monkeypatch.setattr(
        "gaitsweep.pipeline.engine.runner._write_record",
        Mock(side_effect=OSError(errno.ENOSPC, "No room")),
    )
    toy.write('name = "toy"\nwalker = "D"\n[axes]\nslope = [0.01]\n')
    assert commands.main(["run", "toy.toml", "--jobs", "1", "--quiet"]) == 0
    assert "toy.run.json cannot be written: No room." in capsys.readouterr().err


def test_the_record_accounts_for_time_and_memory(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "D"\n[axes]\nslope = [0.005, 0.01, 0.015]\n'
    )
    path = tmp_path / "s.nc"
    clock = time.monotonic()
    assert (
        commands.main(
            [
                "run",
                f"{tmp_path}/s.toml",
                "--archive",
                str(path),
                "--jobs",
                "2",
                "--quiet",
            ]
        )
        == 0
    )
    elapsed, account = (
        time.monotonic() - clock,
        json.loads(Companions(path).record.read_text())["account"],
    )
    assert 0 < account["integrators"] < account["workers_cpu"] < 2 * elapsed
    assert account["python"] == pytest.approx(
        account["workers_cpu"] - account["integrators"], abs=2e-3
    )
    # One block of lines keeps one of the two workers idle.
    assert 0.5 <= account["workers_idle"] <= 1 and account["parent_cpu"] > 0
    assert all(
        1 << 24 < account[f"{name}_memory"] < 1 << 31 for name in ("parent", "worker")
    )
    assert (
        commands.main(["run", f"{tmp_path}/s.toml", "--archive", str(path), "--quiet"])
        == 0
    )
    again = json.loads(Companions(path).record.read_text())["account"]
    assert again["workers_cpu"] == 0 and again["workers_idle"] == 1


def test_several_studies_end_with_one_account_of_them_all(toy):
    toy.write(STUDY.replace('"toy"', '"other"'), "other.toml")
    said = toy("run", "toy.toml", "other.toml").stderr.splitlines()
    assert said[-2].startswith("2 studies in ") and said[-2].endswith(": converged 800")
    assert said[-1].startswith("To see it: gaitsweep report data/archive/*.nc")


def test_a_task_that_studies_share_is_computed_once(tmp_path, monkeypatch):
    """Two studies of orbits over the same slopes; the second is refused nothing that
    the first has.
    """
    monkeypatch.chdir(tmp_path)
    text = 'name = "{}"\nkind = "orbit"\nwalker = "D"\n[axes]\nslope = [0.01]\n[options]\nsteps = 30\ntransient = {}\n'
    for name, transient in (("a", 5), ("b", 5), ("c", 6)):
        (tmp_path / f"{name}.toml").write_text(text.format(name, transient))
    assert commands.main(["run", "a.toml", "b.toml", "c.toml", "--quiet"]) == 0
    events = [
        [
            json.loads(line)
            for line in Companions(Path(f"data/archive/{name}.nc"))
            .events.read_text()
            .splitlines()
        ]
        for name in "abc"
    ]
    spent = [
        {e["task"]: e["seconds"] for e in log if e["event"] == "task"} for log in events
    ]
    assert sorted(s["atlas"] > 0 for s in spent) == [False, False, True]
    assert (
        sorted(s["orbit"] > 0 for s in spent[:2]) == [False, True]
        and spent[2]["orbit"] > 0
    )
    accounts = [
        json.loads(Companions(Path(f"data/archive/{name}.nc")).record.read_text())[
            "account"
        ]["workers_cpu"]
        for name in "abc"
    ]
    assert 0.0 in accounts[:2]
    assert commands.main(["diff", "data/archive/a.nc", "data/archive/b.nc"]) == 0


def refused(toy):
    """Studies of which one is wrong, one is held by another run and one has a foreign
    journal.
    """
    folder = toy.folder / "data" / "archive"
    foreign, busy = Companions(folder / "foreign.nc"), Companions(folder / "busy.nc")
    busy.folder.mkdir(parents=True)
    for name in ("a", "busy", "foreign", "z"):
        toy.write(
            STUDY.replace('"toy"', f'"{name}"').replace("n = 200", "n = 20"),
            f"{name}.toml",
        )
    toy.write("nonsense = 1", "wrong.toml")
    foreign.journal.write_text("not ours")
    lock = busy.lock.open("w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    return lock, [f"{name}.toml" for name in ("a", "wrong", "busy", "foreign", "z")]


def test_a_study_that_is_refused_does_not_end_the_list(toy):
    lock, studies = refused(toy)
    with lock:
        said = toy("run", *studies, expect=2).stderr
        assert (
            toy(
                "run", "a.toml", "busy.toml", "z.toml", "--quiet", expect=5
            ).stderr.count("\n")
            == 1
        )
    assert [
        line
        for line in said.splitlines()
        if line.startswith("2 of 5 studies in ")
        and line.endswith(
            ": converged 80; not run to the end: wrong.toml, busy.toml, foreign.toml"
        )
    ]
    for words in (
        "Unknown key `nonsense`",
        "busy.nc is held by another run",
        "foreign.journal is not a journal",
    ):
        assert said.count(words) == 1
    assert all(
        (toy.folder / "data" / "archive" / f"{name}.nc").exists() for name in ("a", "z")
    )


@pytest.mark.parametrize(
    ("ends", "code"),
    [
        ([0, 1, 0], 1),
        ([1, BusyError("b"), 0], 5),
        ([BusyError("b"), ArchiveError("a"), 1], 2),
        ([ValueError(), WorkerError("w"), BusyError("b")], 3),
        ([DiskFullError("d"), WorkerError("w"), 0], 4),
        ([DiskFullError("d"), StoppedError(2, "s"), 0], 130),
        ([1, StoppedError(15, "s"), 0], 143),
    ],
)
def test_several_studies_end_with_the_gravest_code(
    toy, monkeypatch, capsys, ends, code
):
    monkeypatch.chdir(toy.folder)
    names = ["a", "b", "c"]
    for name in names:
        toy.write(STUDY.replace('"toy"', f'"{name}"'), f"{name}.toml")

    def run(targets, options, report):
        for end in ends:
            if isinstance(end, Exception):
                report(end)
        codes = [
            end if isinstance(end, int) else getattr(end, "exit_code", 2)
            for end in ends
        ]
        return [
            SimpleNamespace(study=s, path=p, code=c, counts=Counter())
            for (s, p), c in zip(targets, codes, strict=True)
        ]

    monkeypatch.setattr("gaitsweep.pipeline.engine.runner.run", run)
    assert commands.main(["run", *(f"{name}.toml" for name in names)]) == code
    said, left = (
        capsys.readouterr().err,
        [f"{n}.toml" for n, end in zip(names, ends, strict=True) if end not in (0, 1)],
    )
    assert (f"not run to the end: {', '.join(left)}\n" in said) == bool(left)
    assert said.count("gaitsweep: ") == sum(isinstance(end, Exception) for end in ends)


def test_one_study_that_fails_on_the_way_does_not_end_the_others(
    toy, monkeypatch, capsys
):
    """Its archive cannot be written; the others have theirs, and each its own record."""
    monkeypatch.chdir(toy.folder)
    for name in ("a", "b", "c"):
        toy.write(
            f'name = "{name}"\nwalker = "D"\n[axes]\nslope = [0.01]\n', f"{name}.toml"
        )
    written = write.write

    def fail(plan, path):
        if plan.study.name == "b":
            raise DiskFullError("The disk is full.")
        return written(plan, path)

    monkeypatch.setattr("gaitsweep.pipeline.archive.write.write", fail)
    assert commands.main(["run", "a.toml", "b.toml", "c.toml", "--jobs", "1"]) == 4
    assert re.search(
        r"2 of 3 studies in [\d.]+ s: converged 2; not run to the end: b.toml\n",
        capsys.readouterr().err,
    )
    folder = Path("data", "archive")
    assert sorted(path.stem for path in folder.glob("*.nc")) == ["a", "c"]
    records = {
        name: json.loads(Companions(folder / f"{name}.nc").record.read_text())
        for name in "abc"
    }
    assert {name: record["exit_code"] for name, record in records.items()} == {
        "a": 0,
        "b": 4,
        "c": 0,
    }
    assert records["b"]["error"] == "The disk is full."


def test_one_study_whose_results_cannot_be_read_does_not_end_the_others(
    toy, monkeypatch, capsys
):
    """Not even while joblib asks for its next job."""
    monkeypatch.chdir(toy.folder)
    for name in ("a", "b"):
        fitted = '\n[want]\nvariables = ["period"]\nfits = ["scaling"]\n'
        toy.write(
            f'name = "{name}"\nwalker = "D"\n[axes]\nslope = [0.001, 0.002, 0.005, 0.01]{fitted}',
            f"{name}.toml",
        )
    read = engine_work.study_inputs

    def fail(plan, name):
        if plan.study.name == "a":
            raise ArchiveError("It cannot be read.")
        return read(plan, name)

    monkeypatch.setattr(engine_work, "study_inputs", fail)
    assert commands.main(["run", "a.toml", "b.toml", "--jobs", "2"]) == 2
    said = capsys.readouterr().err
    assert said.count("It cannot be read.") == 1 and "1 of 2 studies in" in said
    assert [path.stem for path in Path("data", "archive").glob("*.nc")] == ["b"]


def test_verbose_tells_of_every_chunk_in_words(toy):
    told = [
        line
        for line in toy("run", "toy.toml", "--verbose").stderr.splitlines()
        if line.startswith("chunk: ")
    ]
    assert told and all(
        "task points" in line and "counts converged" in line and "=" not in line
        for line in told
    )


def test_verify_and_diff_exit_with_1(toy):
    toy("run", "toy.toml")
    archive = toy.folder / "data" / "archive" / "toy.nc"
    other = toy.folder / "other.nc"
    other.write_bytes(archive.read_bytes())
    toy("verify", archive)
    assert toy("diff", archive, other).stdout == "They agree.\n"
    with netCDF4.Dataset(other, "a") as file:
        file["status"][0] = 7
    assert "not_attempted" in toy("verify", other, expect=1).stdout
    other.write_bytes(archive.read_bytes()[:5000])
    assert (
        toy("verify", other, expect=1).stdout
        == f"{other} is no netCDF file that can be read.\n"
    )
    toy("diff", archive, other, expect=2)
    shutil.copy(archive, other)
    with netCDF4.Dataset(other, "a") as file:
        file["status"][0] = 7
    assert "`status`" in toy("diff", archive, other, expect=1).stdout


def test_solve_shows_ten_rows_of_six_digits_and_why_a_label_has_no_gait(capsys):
    def told(*words):
        assert commands.main(["solve", *words]) == 0
        return capsys.readouterr().out.splitlines()

    long = told("--walker", "physical", "--slope", "0.03")
    assert long[0] == "long (stable, converged)" and all(
        line.startswith("  ") for line in long[1:11]
    )
    rows = dict(line.split(maxsplit=1) for line in long[1:11])
    assert (
        rows["stance_angle"] == "0.213078 rad"
        and rows["multipliers"] == "0.514712, -0.329638, -0.180249, 0"
    )
    assert (
        rows["violations"] == "stance_knee_unlocks"
        and float(rows["error_bound"]) < 1e-12
    )
    assert long[11:] == ["No short gait: none between 0.0223799 and 0.036387 rad."]
    assert told("--walker", "physical", "--slope", "0.001") == [
        "No long gait: none below 0.0191229 rad.",
        "No short gait: none below 0.0219291 rad.",
    ]
    # A pair of multipliers that rounding leaves beside the real axis is real; to all
    # digits a true pair is not.
    assert any(
        line.endswith("-0.143612-0.266375j, 0.255931")
        for line in told("--walker", "A", "--slope", "0.03")
    )
    (none,) = told("--walker", "D", "--slope", "0.014", "--steps", "2")
    assert none.startswith("No gait of period 2 at this slope: the branches found span")


def test_slopes_beyond_all_branches_are_told_apart_from_gaps():
    spans = [(0.1, 0.2), (0.3, 0.4)]
    said = {
        slope: beyond("long", spans, slope) for slope in (0.05, 0.15, 0.2, 0.25, 0.5)
    }
    assert said == {
        0.05: "No long gait: none below 0.1 rad.",
        0.15: "",
        0.2: "",
        0.25: "No long gait: none between 0.2 and 0.3 rad.",
        0.5: "No long gait: none above 0.4 rad.",
    }
    assert beyond("short", [], 0.1) == ""


def printed(capsys, *arguments):
    """What `solve` prints of the first gait, by name."""
    assert commands.main(["solve", "--all-variables", *arguments]) == 0
    lines = capsys.readouterr().out.splitlines()[1:]
    return dict(line.split(maxsplit=1) for line in lines if line.startswith("  "))


def test_solve_speaks_of_degrees_on_request(capsys):
    walker = ["--walker", "physical-straight"]
    plain = printed(capsys, *walker, "--slope", repr(math.radians(2)))
    degrees = printed(capsys, *walker, "--slope", "2", "--degrees")
    assert degrees["slope"] == "2 deg" and degrees["period"] == plain["period"]
    for name, unit in (("stance_angle", "deg"), ("thigh_rate", "deg s-1")):
        (there, told), (here, _) = (
            text[name].split(maxsplit=1) for text in (degrees, plain)
        )
        assert (
            float(there) == pytest.approx(math.degrees(float(here)), rel=1e-13)
            and told == unit
        )


def test_the_conditions_at_vanishing_slope_are_not_said_to_suffice(capsys, tmp_path):
    """This walker meets both, and no gait of it is found below slopes of 0.14."""
    links = "l_t = 0.38\nm_t = 1.75\nr_t = 0.11\nc_t = 0.16\nl_s = 0.44\nm_s = 0.82\nr_s = 0.125\nc_s = 0.17\n"
    rest = "w_t = -0.03391885257471573\nw_s = 0.022431516334982173\nR = 0.15\neps_T = 0.1\nm_h = 5.2\nknees = true\n"
    (tmp_path / "tuned.toml").write_text("[walker]\n" + links + rest)
    assert commands.main(["walkers", f"{tmp_path}/tuned.toml"]) == 0
    assert "not every such walker does" in capsys.readouterr().out
    assert (
        commands.main(
            ["solve", "--walker", f"{tmp_path}/tuned.toml", "--slope", "1e-4", "--json"]
        )
        == 0
    )
    assert capsys.readouterr().out == "[]\n"


def test_slopes_in_the_words_of_a_search_are_said_to_be_in_radians(capsys):
    """At 0.06 degrees too, guesses are made at slopes from 0.0007 rad on."""
    for options, said in ((["--degrees"], True), ([], False)):
        assert (
            commands.main(
                ["solve", "--walker", "physical-straight", "--slope", "0.001", *options]
            )
            == 0
        )
        told = capsys.readouterr().err
        assert "at 18 slopes from 0.0007" in told and ("in rad" in told) == said


def test_simulate_tells_steps_and_their_end_in_words_and_to_machines(capsys):
    def told(*words, code=0):
        assert (
            commands.main(["simulate", "--walker", "D", "--slope", "0.009", *words])
            == code
        )
        return capsys.readouterr().out

    head, *rows, end = told("--steps", "3", "--push", "1", "-1e-2", "0").splitlines()
    assert head.split("  ") == [
        "step",
        "stance_angle (rad)",
        "stance_rate",
        "thigh_rate",
        "period",
    ]
    assert rows[0].split() == ["0", "0.200311", "-0.199832", "-0.184009", "3.88246"]
    assert (
        len(rows) == 4
        and rows[1].split()[1:4] == rows[0].split()[1:4]
        and rows[2].split()[1] != "0.200311"
    )
    assert end == "All 3 steps end in a heelstrike."

    gait = gaitsweep.gaits("D", 0.009).sel(gait="short")
    state = [
        gait[name].item() for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    found = gaitsweep.simulate("D", 0.009, state, 2, pushes={0: (0.0, -1e-3)}, R=0.1)
    words = ["--steps", "2", "--push", "0", "0", "-1e-3", "--set", "R=0.1", "--json"]
    by_state = json.loads(
        told("--state", *map(repr, state), *words), parse_constant=pytest.fail
    )
    assert (
        set(by_state) == set(found.variables) and by_state["outcome"] == found.outcome
    )
    np.testing.assert_array_equal(
        np.array(by_state["stance_angle"], float), found.stance_angle
    )
    assert (
        by_state["kneestrike_time"] == [None] * 3 and None in by_state["stance_angle"]
    )  # it falls
    short = json.loads(told("--gait", "short", "--steps", "1", "--json"))
    assert short["stance_angle"][0] == pytest.approx(state[0], rel=1e-12)

    assert told("--push", "0", "0.1", "0").splitlines()[1:] == [
        "   0            0.200311    -0.199832   -0.184009",
        "Step 0: fell backward.",
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--state", "0.2", "-.2", "-1e-1", "--gait", "long"],
            "Steps begin either at a `--state` or at a `--gait`.",
        ),
        (["--gait", "lnog"], "Unknown name `lnog`, did you mean `long`?"),
        (["--push", "10", "0", "0"], "`pushes` must name steps from 0 to 9; got 10."),
        (["--push", "0.5", "0", "0"], "`pushes` must name steps from 0 to 9; got 0.5."),
        (
            ["--push", "1", "0", "0", "--push", "1", "1", "0"],
            "`--push` is given twice for step 1.",
        ),
        (
            ["--slope", "2"],
            "`slope` must lie in [1e-18, 0.5) rad; got 2.0: degrees? 2 degrees are 0.0349066 rad.",
        ),
        (["--set", "R=-1"], "`R` must be >= 0; got -1.0."),
        (
            ["--state", "0.2", "-.2", "-.1", "--set", "steps=3"],
            "`steps` is not a walker key (did you mean `eps_T`?); got 3.0.",
        ),
    ],
)
def test_wrong_steps_are_refused_in_a_sentence(capsys, words, said):
    assert commands.main(["simulate", "--walker", "D", "--slope", "0.009", *words]) == 2
    assert capsys.readouterr() == ("", f"gaitsweep: {said}\n")


@pytest.mark.parametrize(
    ("gait", "said"),
    [
        ("long", "No long gait: none below 0.0191229 rad."),
        ("other1", "There is no other1 gait at this slope."),
    ],
)
def test_without_a_gait_nothing_is_simulated(capsys, gait, said):
    assert (
        commands.main(
            ["simulate", "--walker", "physical", "--slope", "0.001", "--gait", gait]
        )
        == 1
    )
    assert capsys.readouterr() == ("", f"gaitsweep: {said}\n")


@pytest.mark.parametrize("form", [[], ["--json"]])
@pytest.mark.parametrize(
    ("slope", "steps", "said"),
    [("0.01", "1", ["No long gait", "No short gait"]), ("0.2", "2", ["No gait of"])],
)
def test_why_there_is_no_gait_is_said_once(capsys, form, slope, steps, said):
    words = ["--walker", "physical-straight", "--slope", slope, "--steps", steps]
    assert commands.main(["solve", *words, *form]) == 0
    told = capsys.readouterr()
    # What is read by machines holds gaits alone.
    where, elsewhere = (told.err, told.out) if form else (told.out, told.err)
    for words in said:
        assert where.count(words) == 1
    assert "No " not in elsewhere and "no gait" not in elsewhere


def test_degrees_of_a_rate_without_a_unit_of_time_are_no_angle(capsys):
    gait = printed(capsys, "--walker", "D", "--slope", "0.5", "--degrees")
    assert gait["stance_angle"].endswith(" deg") and gait["stance_rate"].endswith(
        " deg per unit of time"
    )


def test_solve_finds_gaits_of_several_steps(capsys):
    gait = printed(
        capsys,
        "--walker",
        "D",
        "--slope",
        "0.016",
        "--steps",
        "2",
        "--limit",
        "scuff=0",
    )
    assert (
        float(gait["period"]) == pytest.approx(2 * 3.88, abs=0.1)
        and gait["violations"] == "scuff"
    )
    # The mean of both steps, each twice the sine of its angle.
    assert float(gait["step_length"]) == pytest.approx(2 * 0.239, abs=0.005)
    assert (
        commands.main(
            ["solve", "--walker", "D", "--slope", "0.014", "--steps", "2", "--json"]
        )
        == 0
    )
    told = capsys.readouterr()
    assert told.out == "[]\n" and "No gait of period 2 at this slope" in told.err
    assert (
        commands.main(
            ["solve", "--walker", "D", "--slope", "0.016", "--steps", "2", "--all"]
        )
        == 2
    )
    assert (
        "`steps` must be 1 for gaits whose legs pass more than once; got 2"
        in capsys.readouterr().err
    )


def test_solve_tells_units_where_a_walker_has_any(capsys):
    assert (
        commands.main(["solve", "--walker", "A", "--slope", "0.03", "--all-variables"])
        == 0
    )
    told = capsys.readouterr().out
    for name, unit in (
        ("slope", "rad"),
        ("stance_angle", "rad"),
        ("thigh_rate", "rad s-1"),
        ("period", "s"),
        ("speed", "m s-1"),
        ("loss_normal", "J"),
        ("residual", ""),
        ("error_bound", ""),
    ):
        assert re.search(
            rf"^  {name} +[-+.e\d]+{' ' * bool(unit)}{unit}$", told, re.M
        ), name
    assert commands.main(["solve", "--walker", "D", "--slope", "0.009"]) == 0
    told = capsys.readouterr().out
    assert re.search(r"^  stance_angle +0\.200311 rad$", told, re.M)
    assert re.search(r"^  period +3\.88246$", told, re.M)


def test_the_version_is_told(capsys):
    with pytest.raises(SystemExit) as end:
        commands.main(["--version"])
    assert end.value.code == 0 and re.fullmatch(
        r"gaitsweep \d+\.\d+\S*\n", capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("typed", "found"),
    [
        ("gaitsweep so", ["solve"]),
        ("gaitsweep --debug ver", ["verify"]),
        ("gaitsweep run --ret", ["--retry-failed"]),
        ("gaitsweep run st", ["study.toml"]),
        ("gaitsweep solve --walker physical-", ["physical-straight"]),
        ("gaitsweep solve --set m_", ["m_t=", "m_s=", "m_h="]),
        ("gaitsweep tune --free l_", ["l_t", "l_s"]),
        ("gaitsweep completion z", ["zsh"]),
    ],
)
def test_a_shell_completes_what_is_typed(tmp_path, capsys, typed, found):
    assert commands.main(["completion", "bash"]) == 0
    (tmp_path / "study.toml").touch()
    words = typed.split()
    program = (
        f"{capsys.readouterr().out}\nCOMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}\n"
        'complete -p gaitsweep >/dev/null || exit 1; _gaitsweep; printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", program], cwd=tmp_path, text=True, capture_output=True
    )
    assert done.stdout.split() == found and done.stderr == ""


def test_zsh_runs_the_function_of_bash(capsys):
    scripts = {}
    for shell in ("bash", "zsh"):
        assert commands.main(["completion", shell]) == 0
        scripts[shell] = capsys.readouterr().out
    head, _, body = scripts["zsh"].partition("bashcompinit && bashcompinit\n")
    assert head.startswith("# zsh") and body == scripts["bash"].partition("\n")[2]


def test_debug_shows_where_and_changes_no_exit_code(capsys):
    for arguments in (
        ["solve", "--walker", "X", "--slope", "0.01"],
        ["verify", "none.nc"],
    ):
        assert commands.main(["--debug", *arguments]) == commands.main(arguments) == 2
    assert capsys.readouterr().err.count("Traceback") == 2


def test_a_walker_loses_its_knees_by_a_key(tmp_path):
    found = [
        command(
            "solve",
            "--walker",
            "physical",
            "--slope",
            "0.03",
            "--json",
            *more,
            cwd=tmp_path,
        )
        for more in (("--set", "knees=false"), ())
    ]
    straight, kneed = (json.loads(f.stdout) for f in found)
    assert {g["kneestrike_time"] for g in straight} == {None} and all(
        g["kneestrike_time"] for g in kneed
    )


def test_tune_says_what_moved_above_a_table_ready_to_paste(capsys):
    assert commands.main(["tune", "--walker", "D"]) == 0
    assert capsys.readouterr().out.startswith(
        "# It meets the zero-slope conditions already; no key was changed.\n"
    )
    assert commands.main(["tune", "--walker", "C-printed"]) == 0
    told = capsys.readouterr().out
    assert "# w_t changed from -0.023 to -0.02288" in told
    assert re.search(r"# shank offset: -0.000351 before, (0|\S+e-1[6-9]) after", told)
    assert tomllib.loads(told)["walker"]["w_s"] == pytest.approx(0.0223541, abs=5e-8)


def test_report_adds_leaves_only_and_opens(toy, monkeypatch, capsys):
    monkeypatch.chdir(toy.folder)
    opened = []
    monkeypatch.setattr(
        "webbrowser.open", lambda address: opened.append(address) or len(opened) < 2
    )
    toy.write(STUDY.replace('"toy"', '"other"'), "other.toml")
    toy("run", "toy.toml", "other.toml", "--quiet")

    def pages():
        return {path.stem for path in (toy.folder / "reports").glob("*.html")} - {
            "index",
            "ledger",
        }

    capsys.readouterr()
    assert commands.main(["report", "data/archive/toy.nc"]) == 0 and not opened
    assert capsys.readouterr().out == "reports/index.html\nreports/toy.html\n"
    assert (
        commands.main(
            ["report", "data/archive/toy.nc", "data/archive/other.nc", "--only"]
        )
        == 0
    )
    assert capsys.readouterr().out == "reports/index.html\n"
    assert commands.main(["report", "data/archive/other.nc", "--open"]) == 0
    assert pages() == {"toy", "other"} and opened == [
        (toy.folder / "reports" / "index.html").as_uri()
    ]
    assert capsys.readouterr().err == ""
    assert commands.main(["report", "data/archive/other.nc", "--only", "--open"]) == 0
    assert (
        pages() == {"other"}
        and capsys.readouterr().err == "gaitsweep: No browser could be opened.\n"
    )


def test_a_full_disk_is_said_wherever_it_is_met(toy, monkeypatch, capsys):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.chdir(toy.folder)
    toy("run", "toy.toml")
    monkeypatch.setattr("gaitsweep.pipeline.engine.runner.lock_archive", full)
    monkeypatch.setattr("gaitsweep.pipeline.report.pages.write", full)
    for arguments in (["run", "toy.toml"], ["report", "data/archive/toy.nc"]):
        assert commands.main(arguments) == 4
        assert capsys.readouterr().err.endswith(
            "cannot be written: No space left on device.\n"
        )


def test_a_run_that_broke_off_is_not_finished(toy, monkeypatch, capsys):
    monkeypatch.chdir(toy.folder)
    monkeypatch.setattr(
        "gaitsweep.pipeline.archive.write.write", Mock(side_effect=StudyError("No."))
    )
    assert commands.main(["run", "toy.toml", "--jobs", "1"]) == 2
    commands.main(["status", "toy.toml"])
    assert "toy.nc: stopped; " in capsys.readouterr().out


def test_walkers_from_files_keep_their_names(toy):
    for name, mass in (("light", 0.5), ("heavy", 2.0)):
        table = dict(
            dict.fromkeys(
                ("w_t", "r_t", "c_t", "w_s", "r_s", "c_s", "R", "eps_T"), 0.0
            ),
            l_t=0.5,
            l_s=0.5,
            m_t=1.0,
            m_s=mass,
        )
        (toy.folder / f"{name}.toml").write_text(
            "[walker]\n" + "".join(f"{k} = {v}\n" for k, v in table.items())
        )
    toy.write(
        STUDY.replace(
            'walker = "E"', 'walker = ["light.toml", "heavy.toml", "E"]'
        ).replace("200", "5")
    )
    toy("run", "toy.toml")
    with netCDF4.Dataset(toy.folder / "data" / "archive" / "toy.nc") as file:
        assert file["walker"][:].tolist() == ["light.toml", "heavy.toml", "E"]
        assert set(file["fits/scaling/walker"][:]) == {"light.toml", "heavy.toml", "E"}


def test_claims_are_printed_with_their_numbers(capsys):
    assert commands.main(["claims", "D2", "--json"]) == 0
    (claim,) = json.loads(capsys.readouterr().out)
    assert (
        claim["id"] == "D2"
        and claim["printed_value"] == 0.015
        and claim["interval_low"] is None
    )
    assert claim["value"] == pytest.approx(0.0150884379411195, rel=1e-12)
    assert commands.main(["claims", "D2"]) == 0
    said = capsys.readouterr().out
    assert "D2: proved" in said and "γ < 0.015" in said and "0.0150884379411" in said
    assert "  printed     0.015 +- 0.0005\n  computed    0.0150884\n" in said
    # Where the paper prints none, no number stands alone, without its name.
    assert commands.main(["claims", "E2"]) == 0
    *_, line = capsys.readouterr().out.splitlines()
    assert line.startswith("  computed    local exponents of the stance angle over")
    assert commands.main(["claims", "D99"]) == 2
    assert capsys.readouterr().err.startswith(
        "gaitsweep: There is no claim 'D99'; there are D1, "
    )


def test_claims_come_in_the_order_of_the_paper_as_they_are_known(
    tmp_path, monkeypatch, capsys
):
    """The first are known soon; those of its appendix need all gaits with knees."""
    monkeypatch.chdir(tmp_path)
    row = dict.fromkeys(("quotation", "source", "computed", "printed_value", "value"))
    asked = []

    def answer(name, params):
        assert capsys.readouterr().out.count(": reproduced") == min(1, len(asked))
        asked.extend(params["ids"])
        return [{**row, "id": params["ids"][0], "verdict": "reproduced"}]

    monkeypatch.setattr("gaitsweep.pipeline.cli.claims.ask", answer)

    assert commands.main(["claims", "A1", "E1", "D2"]) == 0
    assert asked == ["D2", "E1", "A1"]


def test_verify_answers_machines(tmp_path, capsys):
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "D"\n[axes]\nslope = [0.01]\n'
    )
    path = tmp_path / "s.nc"
    assert (
        commands.main(
            [
                "run",
                f"{tmp_path}/s.toml",
                "--archive",
                str(path),
                "--jobs",
                "1",
                "--quiet",
            ]
        )
        == 0
    )
    capsys.readouterr()
    assert commands.main(["verify", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "archive": str(path),
        "valid": True,
        "problems": [],
    }
    with netCDF4.Dataset(path, "a") as file:
        file["period"][0, 0] = 1.0
    assert commands.main(["verify", str(path), "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["problems"] == [
        "`period` is not as it was written."
    ]


def test_times_are_told_in_the_unit_that_people_use():
    told = {
        0.0123: "0.0123 s",
        119: "119 s",
        121: "2.02 min",
        7300: "2.03 h",
        99.9e6: "27,800 h",
        3.6e12: "1,000,000,000 h",
    }
    assert {seconds: duration(seconds) for seconds in told} == told


def test_a_walker_of_ones_own_is_shown_by_its_name(tmp_path, capsys):
    for name, shown in (
        ('name = "biped"\n', "biped: a walker of your own"),
        ("", "custom: a walker of your own"),
    ):
        (tmp_path / "own.toml").write_text(f'[walker]\n{name}base = "A"\nm_h = 1.0\n')
        assert commands.main(["walkers", f"{tmp_path}/own.toml"]) == 0
        assert capsys.readouterr().out.splitlines()[0] == shown


def test_solve_flags_violations_above_the_limits_that_it_is_given(capsys):
    for limit, flags in (("scuff=0.01", []), ("scuff=0", ["scuff"])):
        words = [
            "solve",
            "--walker",
            "C",
            "--slope",
            "0.02",
            "--json",
            "--limit",
            limit,
        ]
        assert commands.main(words) == 0
        long = json.loads(capsys.readouterr().out)[0]
        assert (
            long["gait"] == "long"
            and [name for name in long["violations"] if name == "scuff"] == flags
        )
    assert commands.main([*words[:-1], "scuf=1"]) == 2
    assert "Unknown violation `scuf`, did you mean `scuff`?" in capsys.readouterr().err


def _archived(folder, text):
    """The archive of a study, run and verified."""
    study, archive = folder / "s.toml", folder / "s.nc"
    study.write_text(text)
    assert (
        commands.main(
            ["run", str(study), "--archive", str(archive), "--jobs", "1", "--quiet"]
        )
        == 0
    )
    assert commands.main(["verify", str(archive)]) == 0
    return load(archive)


def test_keys_are_tuned_at_every_line_and_archived_along_the_axes_that_move_them(
    tmp_path, capsys
):
    text = 'name = "s"\nwalker = "A"\n[axes]\nslope = [1e-6]\nR = [0.1, 0.3]\nm_h = [0.0, 1.0]\nm_t = [2.0, 3.0]\n'
    found = _archived(tmp_path, f'{text}[options]\ntuned = ["w_t"]\n')
    assert found.w_t.dims == ("R", "m_t") and "walker_notes" not in found.attrs
    for at in ({"R": 0.1, "m_h": 1.0, "m_t": 3.0}, {"R": 0.3, "m_h": 0.0, "m_t": 2.0}):
        walker = resolve({"base": "A", "tuned": ["w_t"]}, at)
        assert (
            is_tuned(walker) and found.w_t.sel(R=at["R"], m_t=at["m_t"]) == walker.w_t
        )
        angle = float(found.stance_angle.sel(at).isel(slope=0).sel(gait="long"))
        words = [
            "solve",
            "--walker",
            "A",
            "--slope",
            "1e-6",
            "--tuned",
            "w_t",
            "--json",
        ]
        capsys.readouterr()
        assert (
            commands.main(
                [*words, *(w for k, v in at.items() for w in ("--set", f"{k}={v}"))]
            )
            == 0
        )
        solved = json.loads(capsys.readouterr().out)[0]
        assert (solved["gait"], solved["stance_angle"]) == (
            "long",
            pytest.approx(angle, rel=1e-12),
        )
        same = gaitsweep.gaits("A", 1e-6, tuned=["w_t"], **at).stance_angle.sel(
            gait="long"
        )
        assert float(same) == pytest.approx(angle, rel=1e-12)
    assert gaitsweep.solve("A", 1e-6, R=0.3).empty


def test_keys_of_a_leg_of_one_link_are_axes_and_arguments(tmp_path, capsys):
    text = 'name = "s"\n[walker]\nknees = false\nl = 1.0\nm = 1.0\nc = 0.4\nm_h = 5.0\n[axes]\nslope = [0.01]\n'
    found = _archived(
        tmp_path, f"{text}c = [0.3, 0.4]\nl = [0.8, 1.0]\nm_h = [2.0, 5.0]\n"
    )
    assert (
        found.c_s.dims == ("c", "l")
        and found.l_s.dims == ("l",)
        and found.l.units == "1"
    )
    table = {"knees": False, "l": 1.0, "m": 1.0, "c": 0.4, "m_h": 5.0}
    angle = found.stance_angle.sel(c=0.3, l=0.8, m_h=2.0, gait="long").values
    own = (
        gaitsweep.gaits({**table, "c": 0.3, "l": 0.8, "m_h": 2.0}, 0.01)
        .stance_angle.sel(gait="long")
        .values
    )
    set_ = (
        gaitsweep.gaits(table, 0.01, c=0.3, l=0.8, m_h=2.0)
        .stance_angle.sel(gait="long")
        .values
    )
    assert own == set_
    # Few points are solved by other code, which rounds otherwise.
    np.testing.assert_allclose(angle, own, rtol=1e-12)
    assert (
        commands.main(["solve", "--walker", "A", "--slope", "0.01", "--set", "l=1"])
        == 2
    )
    assert "`l` is a key of a leg of one link" in capsys.readouterr().err


def test_a_tuned_walker_that_a_key_moves_off_its_conditions_is_said_to_be_no_longer_tuned(
    tmp_path, capsys
):
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "A"\n[axes]\nslope = [0.02]\nR = [0.2, 0.25]\n'
    )
    assert commands.main(["plan", str(tmp_path / "s.toml")]) == 0
    said = "With this R, A is no longer tuned (leg_offset "
    assert f"note: {said}" in capsys.readouterr().out
    words = ["--archive", str(tmp_path / "s.nc"), "--jobs", "1", "--quiet"]
    assert commands.main(["run", str(tmp_path / "s.toml"), *words]) == 0
    assert load(tmp_path / "s.nc").walker_notes.startswith(said)
    assert (
        commands.main(["report", str(tmp_path / "s.nc"), "-o", str(tmp_path / "pages")])
        == 0
    )
    assert said in (tmp_path / "pages" / "s.html").read_text()
    capsys.readouterr()
    (tmp_path / "s.toml").write_text(
        'name = "s"\nwalker = "A"\n[axes]\nslope = [0.02]\nm_h = [0.2, 0.25]\n'
    )
    assert commands.main(["plan", str(tmp_path / "s.toml")]) == 0
    assert "tuned" not in capsys.readouterr().out
    for key, said in (("R=0.25", True), ("detuning=0.1", False), ("m_h=1", False)):
        assert (
            commands.main(["solve", "--walker", "A", "--slope", "0.02", "--set", key])
            == 0
        )
        assert ("no longer tuned" in capsys.readouterr().err) == said


def test_gaitsweep_alone_prints_its_help(capsys):
    with pytest.raises(SystemExit) as end:
        commands.main([])

    told = capsys.readouterr()
    assert end.value.code == 0 and told.err == ""
    assert told.out.startswith("usage: gaitsweep")
    assert {*commands.COMMANDS} <= {*told.out.split()}


def test_a_study_named_without_its_ending_and_figures_in_the_wrong_table(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    study = (
        'name = "mine"\nwalker = "E"\nfigures = ["loglog"]\n[axes]\nslope = [0.01]\n'
    )
    (tmp_path / "mine.toml").write_text(study)

    assert commands.main(["run", "mine"]) == 2
    assert "did you mean `mine.toml`?" in capsys.readouterr().err
    assert commands.main(["plan", "mine.toml"]) == 2
    assert "names of figures belong to `[want]`" in capsys.readouterr().err


def test_residuals_that_are_rounding_are_printed_as_zero(capsys):
    assert commands.main(["walkers", "C"]) == 0
    assert re.search(r"^leg_offset +0$", capsys.readouterr().out, re.M)
    assert commands.main(["walkers", "C-printed"]) == 0
    assert re.search(r"^shank_offset +-?0.000351\d*$", capsys.readouterr().out, re.M)


def test_a_plan_for_machines_has_the_names_that_the_docs_tell(tmp_path, capsys):
    path = tmp_path / "s.toml"
    path.write_text(
        'name = "s"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02]\n'
        '[want]\nvariables = ["stance_angle"]\n'
    )
    assert commands.main(["plan", str(path), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    (record,) = record if isinstance(record, list) else [record]

    docs = Path(__file__).parents[2] / "docs" / "studies.md"
    told = docs.read_text(encoding="utf-8").partition("`--json` gives a record")[2]
    told = told.partition("Where a file")[0]
    assert set(re.findall("`([a-z]+)`", told)) == set(record)
    assert record["points"] == record["new"] == record["integrated"] == 2
    assert "scaling" in record["omitted"] and record["seconds"] > 0


def test_a_command_shows_the_place_of_an_error_in_a_study(tmp_path, capsys):
    path = tmp_path / "s.toml"
    path.write_text('name = "s"\nwalker = E\n')
    assert commands.main(["plan", str(path)]) != 0
    first, *place = capsys.readouterr().err.splitlines()
    assert first.endswith(
        "s.toml cannot be read: Invalid value (at line 2, column 10)."
    )
    assert place == ["  2 | walker = E", "    |          ^"]
