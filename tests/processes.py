"""Watching a run from outside: its files, its event log, its processes."""

import time
from pathlib import Path


def beside(toy, what=".journal"):
    """A file of a toy's run."""
    return toy.folder / "data" / "archive" / f"toy{what}"


def wait_for_points(toy, n=1, seconds=60):
    """Wait until the event log tells of so many chunks."""
    log, end = beside(toy, ".events.jsonl"), time.monotonic() + seconds
    while time.monotonic() < end:
        if log.exists() and log.read_text().count('"chunk"') >= n:
            return
        time.sleep(0.02)
    raise AssertionError("no point was solved in time")


def descendants(pid):
    """Process ids below that one."""
    try:
        children = [int(c) for t in Path(f"/proc/{pid}/task").glob("*/children") for c in t.read_text().split()]
    except OSError:
        return []
    return children + [d for c in children for d in descendants(c)]


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
