"""The page of runs in flight."""

import itertools
import json
import os
import re
import time
from pathlib import Path

import pytest

from conftest import Toy
from gaitsweep.pipeline.cli import status
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine.locks import lock_archive
from gaitsweep.pipeline.report.progress_page import ProgressPage

_STATE = {
    "time": 1.0, "event": "state", "elapsed": 20.0, "points": 400, "cached": 0,
    "done": 100, "todo": 400, "tasks": {}, "counts": {"converged": 100},
    "stages": {"atlas": {"done": 2, "todo": 2, "eta": 0.0},
               "points": {"done": 100, "todo": 400, "eta": 60.0}},
    "rate": 5.0, "eta": 60.0, "overdue": False, "memory": 1 << 20, "workers": [],
}  # fmt: skip


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    toy = Toy(tmp_path_factory.mktemp("finished"))
    toy.write('name = "toy"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02]\n')
    toy("run", "toy.toml")
    return toy.folder / "data" / "archive" / "toy.nc"


def test_the_page_of_a_run_tells_stages_until_it_ends_and_costs_a_hundredth(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(os, "nice", lambda by: 0)
    archive = tmp_path / "toy.nc"
    companions = Companions(archive)
    companions.make_folder()
    companions.events.write_text(json.dumps(_STATE) + "\n")
    page = tmp_path / "runs.html"
    texts, pauses = [], []
    ProgressPage().text({}, {})  # templates are loaded once
    used = [sum(os.times()[:4])]

    with lock_archive(archive):

        def sleep(seconds):
            texts.append(page.read_text())
            used.append(sum(os.times()[:4]))
            pauses.append(seconds)
            if len(texts) == 2:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            status.keep_page([archive], page, sleep)

    for text in texts:
        assert '<meta http-equiv="refresh" content="5">' in text
        assert re.search(r'<progress max="400" value="100" aria-label="points', text)
        assert "60 s to go" in text and "searches" in text
    spent = [b - a for a, b in itertools.pairwise(used)]
    # The clock of processor time has ticks of 10 ms.
    assert all(p >= 100 * (s - 0.02) for p, s in zip(pauses, spent, strict=True))
    assert "refresh" not in page.read_text().partition("<style>")[0]


def test_a_page_says_no_more_that_a_run_is_in_flight_once_it_is_ended(tmp_path, toy):
    archive = tmp_path / "toy.nc"
    companions = Companions(archive)
    companions.make_folder()
    companions.events.write_text(json.dumps(_STATE) + "\n")
    page = tmp_path / "runs.html"

    with lock_archive(archive):
        watch = toy.start("status", archive, "--page", page)
        while not page.exists() and watch.poll() is None:
            time.sleep(0.02)
        running = page.read_text()
        watch.terminate()
        watch.communicate(timeout=60)

    assert (
        'http-equiv="refresh"' in running
        and 'http-equiv="refresh"' not in page.read_text()
    )


def test_stopped_runs_have_no_time_to_go():
    archive = Path("toy.nc")
    stages = {archive: [("points", 100, 400, 61.0)]}

    stopped = ProgressPage().text(stages, {archive: []})
    running = ProgressPage().text(stages, {archive: []}, [archive])

    assert "61 s" in running and "61 s" not in stopped


def test_a_page_of_runs_replaces_no_file_of_others(tmp_path):
    page = tmp_path / "runs.html"
    page.write_text("mine")
    with pytest.raises(Exception, match="not a file of gaitsweep"):
        status.keep_page([tmp_path / "toy.nc"], page)
    assert page.read_text() == "mine"


@pytest.mark.parametrize(
    ("began_after", "is_over", "is_earlier"),
    [(10.0, False, True), (-10.0, False, False), (10.0, True, False)],
)
def test_a_page_says_that_an_archive_is_of_an_earlier_run(
    archive, monkeypatch, began_after, is_over, is_earlier
):
    """A run that is over has an archive of its results, though it may have found it
    written.
    """
    monkeypatch.setattr(os, "nice", lambda by: 0)
    begin = {"time": archive.stat().st_mtime + began_after, "event": "begin"}
    events = [begin, _STATE, *[{"event": "end"}] * is_over]
    lines = [json.dumps(event) for event in events]
    Companions(archive).events.write_text("\n".join(lines) + "\n")

    page = archive.with_name("runs.html")

    status.keep_page([archive], page)

    text = page.read_text()
    assert ("of an earlier run" in text) is is_earlier
    assert ("Published by an earlier run" in text) is is_earlier
    assert ("Published until now" in text) is not is_earlier


@pytest.mark.thorough
def test_a_page_kept_beside_a_run_shows_figures_and_lines_and_ends_with_it(toy):
    toy.write(
        'name = "toy"\nwalker = "E"\n[axes]\nw_t = [0.0, 0.1]\n'
        "slope = { from = 1e-4, to = 0.2, n = 200 }\n"
        '[want]\nvariables = ["stance_angle"]\nfigures = ["linear"]\n'
    )
    archive = toy.folder / "data" / "archive" / "toy.nc"
    run = toy.start(
        "run", "toy.toml", "--chunk", 5, "--snapshot", "0", TOY_SECONDS="0.4"
    )
    while not archive.exists() and run.poll() is None:
        time.sleep(0.02)

    watch = toy.start("status", "toy.toml", "--page", "runs.html")
    page, first = toy.folder / "runs.html", ""
    while "<svg" not in first and run.poll() is None:
        first = page.read_text() if page.exists() else ""
        time.sleep(0.02)
    assert 'http-equiv="refresh"' in first and "<svg" in first
    assert "Lines that lack points" in first and 'aria-label="w_t = 0: ' in first

    run.communicate()
    watch.communicate(timeout=120)
    last = page.read_text()
    assert watch.returncode == 0 and 'http-equiv="refresh"' not in last
    assert "finished: 400 points" in last and "2 of 2 lines are finished" in last
    assert len(last) < 500_000
