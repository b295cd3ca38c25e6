"""How a run may end, wherever its jobs are computed: what the user is told, what is
lost, and that the same command again finishes with the same bytes.
"""

import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from conftest import ROOT, STUDY, TOYS, Toy
from processes import alive, companions, descendants, suspend, wait_for_points

#: Where jobs are computed.
PLACES = {
    "one worker": ("--jobs", 1),
    "three workers": ("--jobs", 3),
    "a cluster": ("--cluster", "local:2"),
}
#: A point may take half a second, and two lines have 191 points each, one at 0.05.
LIMITED = (
    STUDY.replace("n = 200", "n = 191")
    + '[limits]\nseconds = 0.5\nmemory = "256 MiB"\n'
)
#: What happens at a point, the status that it gets, and words of its reason.
BAD_POINTS = {
    "raise": ("raised", "RuntimeError: trouble at 0.050"),
    "segfault": ("worker_died", "SIGSEGV"),
    "hang": ("timed_out", "longer than 0.5 s"),
}
SLOW = {"TOY_SECONDS": "0.004"}


@pytest.fixture(
    params=[
        "three workers",
        pytest.param("one worker", marks=pytest.mark.thorough),
        pytest.param("a cluster", marks=pytest.mark.thorough),
    ]
)
def place(request):
    if request.param == "a cluster":
        pytest.importorskip("distributed")
    return PLACES[request.param]


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The archive of the limited study where nothing is bad."""
    toy = Toy(tmp_path_factory.mktemp("good"))
    toy.write(LIMITED)
    toy("run", "toy.toml")
    return toy


def opened(toy):
    return xr.load_dataset(toy.folder / "data" / "archive" / "toy.nc", engine="netcdf4")


def jobs_of_last_run(toy):
    """Events of chunks and tasks since the last run began."""
    events = [
        json.loads(line) for line in companions(toy).events.read_text().splitlines()
    ]
    begin = max(i for i, event in enumerate(events) if event["event"] == "begin")
    return [event for event in events[begin:] if event["event"] in ("chunk", "task")]


def test_a_run_that_ends_well_leaves_nothing_to_do(toy, whole, place):
    toy("run", "toy.toml", *place)

    assert toy.bytes() == whole
    assert "nothing to do" in toy("plan", "toy.toml").stdout
    toy("run", "toy.toml", *place)
    assert toy.bytes() == whole and not jobs_of_last_run(toy)


@pytest.mark.parametrize("trouble", BAD_POINTS)
def test_a_bad_point_costs_that_point(toy, good, place, trouble):
    status, words = BAD_POINTS[trouble]
    toy.write(LIMITED)

    toy("run", "toy.toml", *place, expect=1, TOY_TROUBLE=f"{trouble}@0.05")

    found, wanted = opened(toy), opened(good)
    bad = np.isclose(found.slope, 0.05)
    codes = found.status.flag_meanings.split().index(status)
    assert (found.status[bad] == found.status.flag_values[codes]).all()
    said = found.reason_text.values[found.reason[bad].values]
    assert all(words in reason for reason in said.ravel())
    for name in ("stance_angle", "multiplier_real", "status"):
        np.testing.assert_array_equal(found[name][~bad], wanted[name][~bad])
    toy("run", "toy.toml", *place, "--retry-failed")
    assert toy.bytes() == good.bytes()


def test_a_task_that_raises_costs_what_needs_it(toy, place):
    toy.write(STUDY.replace("[0.0, 0.25]", "[0.0, 13.0]"))

    toy("run", "toy.toml", *place, expect=1)

    found = opened(toy)
    assert (found.status.sel(w_t=0.0, gait="long") == 0).all()
    said = found.reason_text.values[found.reason.sel(w_t=13.0).values]
    assert all("it raised ValueError: no atlas here" in each for each in said.ravel())
    toy("run", "toy.toml", *place, expect=1)
    assert not jobs_of_last_run(toy)


def test_a_worker_that_is_killed_costs_nothing(toy, whole, place):
    process = toy.start("run", "toy.toml", *place, "--chunk", 10, **SLOW)
    wait_for_points(toy, 2)
    os.kill(descendants(process.pid)[0], signal.SIGKILL)

    _, err = process.communicate(timeout=60)

    assert process.returncode == 0, err
    assert toy.bytes() == whole


@pytest.mark.parametrize(
    ("signum", "code"), [(signal.SIGTERM, 143), (signal.SIGKILL, -9)]
)
def test_a_run_that_is_stopped_loses_the_jobs_in_flight(
    toy, whole, place, signum, code
):
    process = toy.start("run", "toy.toml", *place, "--chunk", 10, **SLOW)
    wait_for_points(toy, 2)
    children = descendants(process.pid)
    process.send_signal(signum)

    _, err = process.communicate(timeout=20)

    assert process.returncode == code, err
    assert "Traceback" not in err and not alive(children)
    stored = sum(event.get("points", 0) for event in jobs_of_last_run(toy))
    toy("run", "toy.toml", *place, "--chunk", 10)
    again = sum(event.get("points", 0) for event in jobs_of_last_run(toy))
    # What was recorded is not computed again; chunks of 20 points are the jobs. A kill may
    # come between a record and its line in the log.
    least = 400 - 20 * (signum == signal.SIGKILL)
    assert toy.bytes() == whole and least <= stored + again <= 400 + 3 * 20


def test_a_run_that_was_suspended_goes_on(toy, whole, place):
    process = toy.start("run", "toy.toml", *place, "--chunk", 10, **SLOW)
    wait_for_points(toy, 2)
    suspend(process.pid, 1.5)

    _, err = process.communicate(timeout=60)

    assert process.returncode == 0, err
    assert toy.bytes() == whole


def test_a_journal_that_may_not_grow_ends_the_run_and_keeps_what_it_holds(toy, place):
    """As on a full disk; where there is room again, the same command finishes."""
    toy.write(STUDY.replace("n = 200", "n = 20000"))
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (900000,) * 2)"
    program = (
        f"{limit}\nimport runpy, sys\nsys.argv = sys.argv[1:]\n"
        "runpy.run_path(sys.argv[0], run_name='__main__')"
    )
    words = [TOYS / "gaitsweep_toy.py", "run", "toy.toml", "--quiet", *place]
    environment = {"PYTHONPATH": f"{ROOT}{os.pathsep}{TOYS}", "TOY_CHUNK": "500"}

    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program, *map(str, words)],
        cwd=toy.folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )

    assert done.returncode == 4, done.stderr
    assert done.stderr.count("\n") == 1
    assert "toy.journal cannot be written: File too large." in done.stderr
    kept = sum(event.get("points", 0) for event in jobs_of_last_run(toy))
    toy("run", "toy.toml", *place, TOY_CHUNK="500")
    resumed = toy.bytes()
    again = sum(event.get("points", 0) for event in jobs_of_last_run(toy))
    assert kept > 0 and kept + again <= 40_000 + 500
    toy("run", "toy.toml", "--fresh", TOY_CHUNK="500")
    assert toy.bytes() == resumed
