"""Whatever ends a run, and whenever: the same command again finishes with the same bytes."""

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

import pytest

from conftest import ROOT, STUDY, Toy
from pipeline import paths
from pipeline.archive import write
from pipeline.plan.missing import Plan
from pipeline.store.journal import Journal
from pipeline.store.segment import MAGIC, SUFFIX
from pipeline.study import parse
from processes import alive, descendants, sidecar_path, wait_for_points

SLOW = {"TOY_SECONDS": "0.002"}
#: With rows of the journal alone, and with chunks of 20 points that workers finish.
WAYS = {"rows": {}, "finished chunks": {"TOY_CHUNK": "20"}}
ENDS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
PAGE = 4096


@pytest.fixture(scope="module")
def wholes(tmp_path_factory, whole):
    """Bytes of an undisturbed run with rows and with finished chunks."""
    toy = Toy(tmp_path_factory.mktemp("finished"))
    toy.write()
    toy("run", "toy.toml", **WAYS["finished chunks"])
    return {"rows": whole, "finished chunks": toy.bytes()}


def _clear(toy):
    for file in (toy.folder / "data" / "archive").iterdir():
        file.unlink()


def _handles_signals(pid):
    """Whether a process catches TERM, as a run does from its beginning to its end."""
    with contextlib.suppress(OSError):
        caught = re.search(r"^SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text(), re.M)
        return bool(int(caught[1], 16) >> (signal.SIGTERM - 1) & 1)
    return True


@pytest.mark.soak
@pytest.mark.parametrize("way", WAYS)
def test_two_hundred_random_kills(toy, wholes, tell, way):
    """Any of four signals at a random moment, to the parent or a worker process."""
    dice, killed, ends = random.Random(1), Counter(), Counter()
    while killed.total() < 200:
        process = toy.start("run", "toy.toml", "--chunk", 10, "--snapshot", "0.1", **SLOW, **WAYS[way])
        time.sleep(dice.uniform(0.1, 2.5))
        victims = [process.pid, *descendants(process.pid)]
        victim = process.pid if dice.random() < 0.75 else dice.choice(victims)
        signum = dice.choice(ENDS) if victim == process.pid else signal.SIGKILL
        while signum == signal.SIGINT and process.poll() is None and not _handles_signals(process.pid):
            time.sleep(0.01)  # until its modules are imported, an interrupt is Python's own
        if process.poll() is None:
            os.kill(victim, signum)
            killed[f"{'parent' if victim == process.pid else 'worker'} {signum.name}"] += 1
        _, err = process.communicate(timeout=60)
        assert "Traceback" not in err, err
        ends[process.returncode] += 1
        if victim == process.pid:
            assert not alive(victims)
        else:
            assert process.returncode == 0, err
        assert process.returncode in (0, -signum, 128 + signum), err
        if process.returncode == 0:
            assert toy.bytes() == wholes[way]
            _clear(toy)
    toy("run", "toy.toml", **WAYS[way])
    assert toy.bytes() == wholes[way]
    tell(
        f"{way}: {dict(sorted(killed.items()))}; exit codes {dict(sorted(ends.items()))}: {ends[0] + 1} archives, "
        "all of equal bytes; no process left after 3 s"
    )


def interpret(program, cwd=None):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], text=True, capture_output=True, env=environment, cwd=cwd
    )


@pytest.mark.parametrize(("pause", "code", "said"), [(1.2, 130, "held\n"), (0.1, 1, "held\nsoft\n")])
def test_a_second_interrupt_is_hard_unless_it_is_the_first_once_more(pause, code, said):
    """The first waits for what must not be cut in two; the second does not."""
    program = (
        "import os, signal, time; from pipeline.execution.runner import Signals; signals = Signals()\n"
        "def interrupt(): os.kill(os.getpid(), signal.SIGINT)\n"
        "with signals.handle():\n"
        f"    with signals: interrupt(); print('held', flush=True); time.sleep({pause}); interrupt(); "
        "print('soft', flush=True)\n"
    )
    done = interpret(program)
    assert (done.returncode, done.stdout) == (code, said)
    assert code == 130 or done.stderr.endswith("StoppedError: Stopped by SIGINT; finished results are kept.\n")


@pytest.mark.parametrize("when", ["while it stops", "while its record is written"])
def test_a_signal_that_comes_twice_leaves_a_line_and_a_record(toy, when):
    """As `timeout` sends it: to its command, and a moment later to the group, of which that is one."""
    place = {"while it stops": "worker_process.close_all", "while its record is written": "runner._write_record"}[when]
    program = (
        "import os, signal, sys; from pipeline.execution import runner, worker_process\n"
        "from pipeline.cli import commands\n"
        "def again(call): return lambda *arguments: (os.kill(os.getpid(), signal.SIGTERM), call(*arguments))\n"
        f"{place} = again({place})\n"
        "runner.Progress.begin = lambda self: os.kill(os.getpid(), signal.SIGTERM)\n"
        "sys.exit(commands.main(['run', 'toy.toml']))\n"
    )
    done = interpret(program, cwd=toy.folder)
    assert (done.returncode, done.stderr) == (143, "gaitsweep: Stopped by SIGTERM; finished results are kept.\n")
    assert json.loads(sidecar_path(toy, ".run.json").read_text())["exit_code"] == 143


def test_a_signal_in_a_callback_of_the_interpreter_is_not_told_by_a_traceback():
    """Where no error can be raised, as while a module is imported: the next one ends the run."""
    program = (
        "import os, signal, weakref; from pipeline.execution.runner import Signals\n"
        "class Module: pass\n"
        "module = Module(); kept = weakref.ref(module, lambda _: os.kill(os.getpid(), signal.SIGTERM))\n"
        "try:\n"
        "    with Signals().handle(): del module; raise RuntimeError('a worker is gone')\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    done = interpret(program)
    assert (done.stdout, done.stderr) == ("StoppedError Stopped by SIGTERM; finished results are kept.\n", "")


def test_an_archive_is_on_the_disk_before_it_takes_its_place(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text(STUDY)
    journal, steps = Journal(tmp_path / "j"), []
    fsync, replace = os.fsync, os.replace
    monkeypatch.setattr(os, "fsync", lambda fd: (steps.append(os.readlink(f"/proc/self/fd/{fd}")), fsync(fd)))
    monkeypatch.setattr(os, "replace", lambda a, b: (steps.append((str(a), str(b))), replace(a, b)))
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
    assert (tmp_path / "s.nc").is_symlink() and [f.name for f in (tmp_path / "far").iterdir()] == ["away.nc"]


@pytest.mark.parametrize("cuts", [1, pytest.param(60, marks=pytest.mark.soak)])
@pytest.mark.parametrize("way", WAYS)
def test_a_power_cut_costs_what_was_not_on_the_disk_yet(toy, wholes, tell, cuts, way):
    """The files as they are at some moment, without some of the pages that they took last; a run from there."""
    files = ("", "-wal", SUFFIX) if WAYS[way] else ("", "-wal")
    dice, lost, kept = random.Random(cuts), Counter(), 0
    for _ in range(cuts):
        process = toy.start("run", "toy.toml", "--chunk", 10, **SLOW, **WAYS[way])
        wait_for_points(toy, dice.randint(1, 15))
        for suffix in files:  # what was mapped in memory is gone with the power
            shutil.copy(sidecar_path(toy, f".journal{suffix}"), toy.folder / f"cut{suffix}")
        process.kill()
        process.communicate()
        _clear(toy)
        for suffix in files:
            shutil.move(toy.folder / f"cut{suffix}", sidecar_path(toy, f".journal{suffix}"))
        for suffix in files[1:]:
            log, page = sidecar_path(toy, f".journal{suffix}"), PAGE if suffix == "-wal" else PAGE // 16
            kept_bytes = len(MAGIC) if suffix == SUFFIX else 0  # on the disk before anything else
            with open(log, "r+b") as file:
                size = log.stat().st_size
                for _ in range(dice.randint(0, 8)):
                    file.seek(max(kept_bytes, size - page * dice.randint(1, 40)))
                    file.write(dice.choice([bytes(page), dice.randbytes(page)])[:size])
                    lost[f"pages {suffix}"] += 1
                if dice.random() < 0.5:
                    file.truncate(dice.randint(kept_bytes, size))
                    lost[f"tails {suffix}"] += 1
        toy("run", "toy.toml", "--chunk", 10, **WAYS[way])
        assert toy.bytes() == wholes[way]
        with sqlite3.connect(sidecar_path(toy)) as db:
            assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        db.close()
        kept += sidecar_path(toy, ".events.jsonl").read_text().count('"chunk"') < 40
        _clear(toy)
    tell(f"{way}: {cuts} power cuts ({dict(lost)} lost): equal bytes after each, {kept} with earlier work kept")
