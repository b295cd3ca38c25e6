"""Whatever ends a run, and whenever: the same command again finishes with the same
bytes.
"""

import contextlib
import json
import os
import random
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from conftest import GAITSWEEP, ROOT, STUDY
from gaitsweep.pipeline import paths
from gaitsweep.pipeline.archive import write
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study import parse
from processes import alive, companions, descendants, wait_for_points

SLOW = {"TOY_SECONDS": "0.002"}
FILES = ("toy.journal", "toy.journal-wal")
ENDS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
PAGE = 8192


def _clear(toy):
    for file in (toy.folder / "data" / "archive").rglob("*"):
        if file.is_file():
            file.unlink()


def _handles_signals(pid):
    """Whether a process catches TERM, as a run does from its beginning to its end."""
    with contextlib.suppress(OSError):
        caught = re.search(
            r"^SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text(), re.M
        )
        return bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)
    return True


@pytest.mark.soak
def test_two_hundred_random_kills(toy, whole, tell):
    """Any of four signals at a random moment, to the parent or a worker process."""
    dice, killed, ends = random.Random(1), Counter(), Counter()
    while killed.total() < 200:
        process = toy.start(
            "run", "toy.toml", "--chunk", 10, "--snapshot", "0.1", **SLOW
        )
        time.sleep(dice.uniform(0.1, 2.5))
        victims = [process.pid, *descendants(process.pid)]
        victim = process.pid if dice.random() < 0.75 else dice.choice(victims)
        signum = dice.choice(ENDS) if victim == process.pid else signal.SIGKILL
        while (
            signum == signal.SIGINT
            and process.poll() is None
            and not _handles_signals(process.pid)
        ):
            time.sleep(
                0.01
            )  # until its modules are imported, an interrupt is Python's own
        if process.poll() is None:
            os.kill(victim, signum)
            killed[
                f"{'parent' if victim == process.pid else 'worker'} {signum.name}"
            ] += 1
        _, err = process.communicate(timeout=60)
        assert "Traceback" not in err, err
        ends[process.returncode] += 1
        if victim == process.pid:
            assert not alive(victims)
        else:
            assert process.returncode == 0, err
        assert process.returncode in (0, -signum, 128 + signum), err
        if process.returncode == 0:
            assert toy.bytes() == whole
            _clear(toy)
    toy("run", "toy.toml")
    assert toy.bytes() == whole
    tell(
        f"{dict(sorted(killed.items()))}; exit codes {dict(sorted(ends.items()))}: {ends[0] + 1} archives, "
        "all of equal bytes; no process left after 3 s"
    )


#: A plane whose charts describe a part of it, lines side by side, and a long line, with
#: all that is cheaply measured.
REAL = {
    "plane": (
        "A",
        "detuning = { from = 0.1, to = 0.6, n = 120 }\nslope = { from = 1e-3, to = 0.05, n = 40 }",
    ),
    "side": (
        "E",
        "R = [0.0, 0.05, 0.1, 0.15]\nslope = { from = 1e-3, to = 0.05, n = 60 }",
    ),
    "long": ("D", "slope = { from = 1e-4, to = 0.02, n = 4000 }"),
}


@pytest.mark.parametrize(
    "times",
    [
        pytest.param(2, marks=pytest.mark.thorough),
        pytest.param(60, marks=pytest.mark.soak),
    ],
)
def test_gaits_have_the_same_bits_however_they_are_divided(
    tmp_path, tell, resumed, times
):
    """Whatever number of points and of lanes is computed at a time, by how many
    workers, killed or not.
    """
    for name, (walker, axes) in REAL.items():
        (tmp_path / f"{name}.toml").write_text(
            f'name = "{name}"\nwalker = "{walker}"\n[axes]\n{axes}\n'
        )

    def run(dice=None):
        options, environment = [], dict(os.environ)
        if dice:
            options += ["--jobs", str(dice.randint(1, 3))]
            options += [
                "--chunk",
                str(int(np.exp(dice.uniform(np.log(100), np.log(9000))))),
            ] * (dice.random() < 0.8)
            environment["GAITSWEEP_LANES"] = dice.choice(["4", "8"])
        command = [*GAITSWEEP, "run", ".", "--fresh", "--quiet", *options]
        process = subprocess.Popen(
            command, cwd=tmp_path, env={**environment, "PYTHONPATH": str(ROOT)}
        )
        kills = 0
        if (
            dice and dice.random() < 0.8
        ):  # once: charts, or branches, whose worker dies twice have failed
            time.sleep(dice.uniform(1.0, 8.0))
            workers = descendants(process.pid)
            if workers:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(dice.choice(workers), signal.SIGKILL)
                    kills += 1
        assert process.wait(timeout=300) == 0
        return kills, [
            (tmp_path / "data" / "archive" / f"{name}.nc").read_bytes() for name in REAL
        ]

    _, whole = run()
    for number in resumed(times):
        kills, archives = run(random.Random(number))
        assert archives == whole, number
        resumed.found["kills"] += kills
    tell(
        f"{resumed.state} random divisions of real studies, {resumed.found['kills']} workers killed: equal bytes"
    )


def interpret(program, cwd=None):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program],
        text=True,
        capture_output=True,
        env=environment,
        cwd=cwd,
    )


@pytest.mark.parametrize(
    ("pause", "code", "said"), [(1.2, 130, "first\n"), (0.1, 1, "first\nsoft\n")]
)
def test_a_second_interrupt_is_hard_unless_it_is_the_first_once_more(pause, code, said):
    """The first is looked for between results; the second ends at once."""
    program = (
        "import os, signal, time; from gaitsweep.pipeline.engine.runner import Signals; signals = Signals()\n"
        "def interrupt(): os.kill(os.getpid(), signal.SIGINT)\n"
        "signals.handle()\n"
        f"interrupt(); print('first', flush=True); time.sleep({pause}); interrupt(); print('soft', flush=True)\n"
        "signals.check()\n"
    )
    done = interpret(program)
    assert (done.returncode, done.stdout) == (code, said)
    assert code == 130 or done.stderr.endswith(
        "StoppedError: Stopped by SIGINT; finished results are kept.\n"
    )


def test_a_signal_that_comes_after_the_last_look_for_one_does_not_end_the_next_run():
    """Signals are handled up to the end, when no worker is left to be ended."""
    program = (
        "import os, signal; from gaitsweep.pipeline.engine.signals import Signals, worker_process\n"
        "earlier, signals = signal.getsignal(signal.SIGTERM), Signals(); signals.handle()\n"
        "os.kill(os.getpid(), signal.SIGTERM); signals.restore(); worker_process.WorkerProcess().close()\n"
        "print(signal.getsignal(signal.SIGTERM) is earlier)\n"
    )
    done = interpret(program)
    assert (done.stdout, done.stderr, done.returncode) == ("True\n", "", 0)


@pytest.mark.parametrize("when", ["while it stops", "while its record is written"])
def test_a_signal_that_comes_twice_leaves_a_line_and_a_record(toy, when):
    """As `timeout` sends it: to its command, and a moment later to the group, of which
    that is one.
    """
    place = {
        "while it stops": "worker_process.close_all",
        "while its record is written": "runner._write_record",
    }[when]
    program = (
        "import os, signal, sys; from gaitsweep.pipeline.engine import runner, worker_process\n"
        "from gaitsweep.pipeline.cli import commands\n"
        "def again(call): return lambda *arguments: (os.kill(os.getpid(), signal.SIGTERM), call(*arguments))\n"
        f"{place} = again({place})\n"
        "runner.Progress.begin = lambda self: os.kill(os.getpid(), signal.SIGTERM)\n"
        "sys.exit(commands.main(['run', 'toy.toml']))\n"
    )
    done = interpret(program, cwd=toy.folder)
    assert (done.returncode, done.stderr) == (
        143,
        "gaitsweep: Stopped by SIGTERM; finished results are kept.\n",
    )
    assert json.loads(companions(toy).record.read_text())["exit_code"] == 143


def test_an_archive_is_on_the_disk_before_it_takes_its_place(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(STUDY)
    journal, steps = Journal(tmp_path / "j"), []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(
        os,
        "fsync",
        lambda fd: (steps.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd)),
    )
    monkeypatch.setattr(
        os, "replace", lambda a, b: (steps.append((str(a), str(b))), replace(a, b))
    )
    write.write(Plan(parse.read(tmp_path / "s.toml"), journal), tmp_path / "s.nc")
    journal.close()
    draft, place = str(paths.of(tmp_path / "s.nc")), str(tmp_path / "s.nc")
    assert steps == [draft, (draft, place), str(tmp_path)]


def test_an_archive_that_is_a_link_stays_one(tmp_path):
    (tmp_path / "s.toml").write_text(STUDY)
    (tmp_path / "far").mkdir()
    (tmp_path / "s.nc").symlink_to(tmp_path / "far" / "away.nc")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        write.write(Plan(parse.read(tmp_path / "s.toml"), journal), tmp_path / "s.nc")
    assert (tmp_path / "s.nc").is_symlink() and [
        f.name for f in (tmp_path / "far").iterdir()
    ] == ["away.nc"]


@pytest.mark.parametrize("cuts", [1, pytest.param(60, marks=pytest.mark.soak)])
def test_a_power_cut_costs_what_was_not_on_the_disk_yet(toy, whole, tell, cuts):
    """The files as they are at some moment, without some of the pages that they took
    last; a run from there.
    """
    dice, lost, kept = random.Random(cuts), Counter(), 0
    for _ in range(cuts):
        process = toy.start("run", "toy.toml", "--chunk", 10, **SLOW)
        wait_for_points(toy, dice.randint(1, 15))
        for name in FILES:  # what was mapped in memory is gone with the power
            shutil.copy(companions(toy).folder / name, toy.folder / name)
        process.kill()
        process.communicate()
        _clear(toy)
        for name in FILES:
            shutil.move(toy.folder / name, companions(toy).folder / name)
        log = companions(toy).folder / "toy.journal-wal"
        with open(log, "r+b") as file:
            size = log.stat().st_size
            for _ in range(dice.randint(0, 8)):
                file.seek(max(0, size - PAGE * dice.randint(1, 40)))
                file.write(dice.choice([bytes(PAGE), dice.randbytes(PAGE)])[:size])
                lost["pages"] += 1
            if dice.random() < 0.5:
                file.truncate(dice.randint(0, size))
                lost["tails"] += 1
        toy("run", "toy.toml", "--chunk", 10)
        assert toy.bytes() == whole
        with sqlite3.connect(companions(toy).journal) as db:
            assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        db.close()
        kept += companions(toy).events.read_text().count('"chunk"') < 20
        _clear(toy)
    tell(
        f"{cuts} power cuts ({dict(lost)} lost): equal bytes after each, {kept} with earlier work kept"
    )
