"""Memory is bounded: what a run holds of a point is less than the point's results, and
ten million fit in 1 GiB.
"""

import os
import threading
import time
from pathlib import Path

import pytest

from processes import descendants

MIB = 1 << 20
STUDY = """name = "toy"
walker = "E"
gaits = ["long", "short"]
[axes]
slope = {{ from = 1e-4, to = 0.2, n = {n} }}
[want]
variables = ["stance_angle", "period", "multipliers"]
fits = ["scaling"]
"""


def peaks(toy, *arguments):
    """Peak resident memory [byte] of a command and of the largest process below it, and
    its time [s].
    """
    began, found = time.monotonic(), {}
    process = toy.start(*arguments, TOY_CHUNK="16384")
    reader = threading.Thread(target=process.communicate)
    reader.start()
    while reader.is_alive():
        for pid in (process.pid, *descendants(process.pid)):
            try:
                mark = (
                    Path(f"/proc/{pid}/status")
                    .read_text()
                    .split("VmHWM:")[1]
                    .split()[0]
                )
                found[pid] = 1024 * int(mark)
            except (OSError, IndexError):
                continue
        time.sleep(0.02)
    reader.join()
    assert process.returncode == 0
    return (
        found.pop(process.pid),
        max(found.values(), default=0),
        time.monotonic() - began,
    )


def test_a_point_costs_the_parent_little_memory(toy):
    few, many = 150_000, 500_000  # below, what is held once is not full yet
    parent = []
    for n in (few, many):
        toy.write(STUDY.format(n=n))
        found, worker, _ = peaks(toy, "run", "toy.toml", "--fresh")
        parent.append(found)
        assert worker < 256 * MIB
    assert parent[1] - parent[0] < (many - few) * (1 << 30) / 1e7


@pytest.mark.soak
def test_ten_million_points_fit(toy, tell):
    took = {}
    for n in (1_000_000, 10_000_000):
        toy.write(STUDY.format(n=n))
        parent, worker, took[n] = peaks(toy, "run", "toy.toml", "--fresh")
        assert parent < 1 << 30 and worker < 512 * MIB
        sizes = [
            os.path.getsize(toy.folder / f"data/archive/toy.{kind}") // MIB
            for kind in ("journal", "nc")
        ]
        tell(
            f"{n:,} points run in {took[n]:.0f} s: parent {parent // MIB} MiB, workers {worker // MIB} MiB; journal"
            f" {sizes[0]} MiB, archive {sizes[1]} MiB"
        )
    assert took[10_000_000] < 13 * took[1_000_000]
    for command in (
        ("plan", "toy.toml"),
        ("run", "toy.toml"),
        ("verify", "data/archive/toy.nc"),
    ):
        parent, worker, seconds = peaks(toy, *command)
        assert max(parent, worker) < 1 << 30
        tell(
            f"{command[0]} of it once it is there: {max(parent, worker) // MIB} MiB, {seconds:.0f} s"
        )
