"""Watching a run from outside: its files, its event log, its processes; and damaging
what it left.
"""

import contextlib
import fcntl
import os
import pty
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from unittest.mock import MagicMock

from gaitsweep.pipeline.companions import Companions

ROOT = Path(__file__).parents[1]


def companions(toy):
    """The companions of a toy's archive."""
    return Companions(toy.folder / "data" / "archive" / "toy.nc")


def drafts(folder):
    """Names of the hidden files in a folder of archives, companions apart."""
    return {file.name for file in folder.rglob(".*")} - {".gaitsweep"}


def wait_for_points(toy, n=1, seconds=60):
    """Wait until the event log tells of so many chunks."""
    log, end = companions(toy).events, time.monotonic() + seconds
    while time.monotonic() < end:
        if log.exists() and log.read_text().count('"chunk"') >= n:
            return
        time.sleep(0.02)
    raise AssertionError("no point was solved in time")


def descendants(pid):
    """Process ids below that one."""
    try:
        children = [
            int(c)
            for t in Path(f"/proc/{pid}/task").glob("*/children")
            for c in t.read_text().split()
        ]
    except OSError:
        return []
    return children + [d for c in children for d in descendants(c)]


def ended(code):
    """In place of a process, one that has ended so."""
    process = MagicMock(returncode=code)
    process.__enter__.return_value = process
    process.poll.return_value, process.communicate.return_value = code, (None, None)
    return process


def alive(pids, seconds=3.0):
    """Those of the processes that still run after so long."""
    end = time.monotonic() + seconds
    while (found := _running(pids)) and time.monotonic() < end:
        time.sleep(0.05)
    return found


def _running(pids):
    found = []
    for pid in pids:
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except OSError:
            continue
        if state != "Z":
            found.append(pid)
    return found


@contextlib.contextmanager
def ignored(signum):
    """Processes that are started inside ignore that signal, as `nohup` has it."""
    kept = signal.signal(signum, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signum, kept)


def damaged(data, dice):
    """The same bytes with a random fault: single bits and bytes, whole regions, pages
    in the wrong place, a cut.
    """
    data, n = bytearray(data), len(data)
    place, size = dice.randrange(n), dice.randint(2, 9000)
    kind = dice.choice(
        ["bit", "byte", "bytes", "head", "noise", "zeros", "ones", "page", "cut"]
    )
    if kind == "bit":
        data[place] ^= 1 << dice.randrange(8)
    elif kind in ("byte", "bytes", "head"):
        for _ in range(dice.randint(2, 30) if kind == "bytes" else 1):
            data[dice.randrange(min(n, 1200) if kind == "head" else n)] = (
                dice.randrange(256)
            )
    elif kind == "page":
        here, there = (4096 * dice.randrange(max(1, n // 4096)) for _ in range(2))
        data[here : here + 4096] = data[there : there + 4096]
    elif kind == "cut":
        del data[place:]
    else:
        size = min(size, n - place)
        data[place : place + size] = {
            "noise": dice.randbytes,
            "zeros": bytes,
            "ones": lambda m: b"\xff" * m,
        }[kind](size)
    return bytes(data)


def suspend(pid: int, seconds: float) -> None:
    """Stop a process and those below it for so long; then they wake one after another."""
    group = [pid, *descendants(pid)]
    for each in group:
        os.kill(each, signal.SIGSTOP)
    time.sleep(seconds)
    for each in group:
        with contextlib.suppress(
            ProcessLookupError
        ):  # one that woke may have ended another
            os.kill(each, signal.SIGCONT)
        time.sleep(0.3)


def on_a_terminal(arguments, cwd, size=(24, 80)):
    """Exit code of `gaitsweep` and what it writes to standard error, a terminal of so
    many rows and columns.
    """
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "gaitsweep", *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    )
    os.close(theirs)
    said = b""
    with contextlib.suppress(OSError):  # nobody writes there any more
        while part := os.read(ours, 1 << 16):
            said += part
    os.close(ours)
    return process.wait(100), said.decode()
