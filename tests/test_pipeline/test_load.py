"""Very many small jobs, killed again and again, and very many points: memory and open
files stay as they are.
"""

import contextlib
import os
import random
import signal
import time
from collections import Counter
from pathlib import Path

import pytest

from processes import alive, companions, descendants

STUDY = """name = "toy"
walker = "E"
[axes]
slope = {{ from = 0.01, to = 0.2, n = 50 }}
w_t = {{ from = 0.0, to = 1.0, n = {n} }}
[want]
variables = ["stance_angle"]
"""
WARM = 50_000  # of the log of events before memory and files are looked at [byte]
#: Growth of the parent over a run [byte]: the libraries that write the archive, and
#: what a job may leave behind.
MEMORY, BYTES_A_JOB = 64 << 20, 100


def _held(pid):
    """Open files of a process and its resident memory [byte]; None once it is gone."""
    with contextlib.suppress(OSError):
        resident = int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf(
            "SC_PAGE_SIZE"
        )
        return len(os.listdir(f"/proc/{pid}/fd")), resident
    return None


@pytest.mark.parametrize(
    ("n", "kills"), [(60, 2), pytest.param(20_000, 200, marks=pytest.mark.soak)]
)
def test_a_million_small_jobs_and_two_hundred_kills(toy, tell, n, kills):
    """Each job is one point. The same command is given until the run ends; its ends are
    drawn by lot.
    """
    toy.write(STUDY.format(n=n))
    dice, ends, end = random.Random(kills), Counter(), time.monotonic() + 3600
    growth = jobs = 0
    files, log = set(), companions(toy).events
    while True:
        process = toy.start(
            "run", "toy.toml", "--quiet", "--snapshot", 300, TOY_CHUNK="1"
        )
        stop = time.monotonic() + (
            dice.uniform(0.5, 8)
            if ends.total() < kills
            else max(30, end - time.monotonic())
        )
        base, began = None, log.stat().st_size if log.exists() else 0
        while process.poll() is None and time.monotonic() < stop:
            time.sleep(0.05)
            held = _held(process.pid)
            if (
                held and log.exists() and log.stat().st_size > began + WARM
            ):  # everything is imported
                base = base or held
                files.add(held[0])
                growth = max(growth, held[1] - base[1])
        below = descendants(process.pid)
        signum = dice.choice([signal.SIGKILL, signal.SIGTERM])
        if process.poll() is None:
            os.kill(process.pid, signum)
        _, err = process.communicate(timeout=120)
        assert "Traceback" not in err, err
        assert not alive(below)
        ends[process.returncode] += 1
        jobs = log.read_text().count('"chunk"')
        if process.returncode == 0 or time.monotonic() > end:
            break
    assert files and max(files) < 60 and growth < MEMORY + BYTES_A_JOB * jobs, (
        files,
        growth,
        jobs,
    )
    tell(
        f"{jobs:,} jobs of {50 * n:,} points, ended {dict(ends)}: at most {max(files)} files open,"
        f" memory grew by {growth / 1e6:.0f} MB"
    )


@pytest.mark.parametrize(
    ("slopes", "lines"),
    [(50_000, 4), pytest.param(10_000_000, 100, marks=pytest.mark.soak)],
)
def test_a_journal_of_a_billion_points(toy, tell, slopes, lines):
    """Points of long lines, as fast as the parent takes them; what it holds is that of
    a line, not of all.
    """
    toy.write(STUDY.format(n=lines).replace("n = 50 ", f"n = {slopes} "))
    process = toy.start("run", "toy.toml", "--quiet", TOY_DIGITS="2", TOY_CHUNK="1000")
    log, base = companions(toy).events, None
    growth = files = largest = 0
    while process.poll() is None:
        time.sleep(0.05)
        held = _held(process.pid)
        largest = max(largest, held[1] if held else 0)
        if held and log.exists() and log.stat().st_size > 10 * WARM:
            base = base or held
            files, growth = max(files, held[0]), max(growth, held[1] - base[1])
    out, err = process.communicate()
    assert (process.returncode, err) == (0, ""), out + err
    assert (
        log.read_text().count('"begin"') == 1
        and files < 60
        and growth < MEMORY + 16 * slopes
    )
    assert largest < 4 * MEMORY + 32 * slopes
    archive = toy.folder / "data" / "archive" / "toy.nc"
    toy("verify", archive)
    size = archive.stat().st_size
    tell(
        f"{slopes * lines:,} points: {files} files open, memory grew by {growth / 1e6:.0f} MB to at most"
        f" {largest / 1e6:.0f} MB; {size / 1e9:.1f} GB"
    )
