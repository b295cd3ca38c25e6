"""How long a run will take is told from what its parts took, which sample it evenly."""

import io
import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from answering import Answering, study_of
from conftest import STUDY
from gaitsweep.pipeline.engine import display
from gaitsweep.pipeline.engine.loop import run_all
from gaitsweep.pipeline.engine.progress import Progress
from gaitsweep.pipeline.engine.request import Answer
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid import grid
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.points import Points
from processes import companions

PEAK = "slope = { from = 0.01, to = 0.2, n = 40000 }"
#: Axes, and seconds of a point by its line's number and slope.
UNEVEN = {
    "even": (PEAK, lambda line, slope: 1e-3 + 0 * slope),
    "a dear tenth": (
        PEAK,
        lambda line, slope: np.where(abs(slope - 0.15) < 0.01, 2e-2, 1e-3),
    ),
    "dear towards zero": (
        'slope = { from = 1e-12, to = 0.1, n = 40000, spacing = "log" }',
        lambda line, slope: 1e-5 * (1 + (1e-6 / slope) ** 0.5),
    ),
    "dear lines": (
        PEAK.replace("40000", "4000") + "\nw_t = { from = 0, to = 0.1, n = 24 }",
        lambda line, slope: 1e-4 * (1 + line) + 0 * slope,
    ),
}


class Simulated:
    """Answers as two workers would, whose time is counted, not spent."""

    def __init__(self, cost):
        self.cost, self.spent = cost, 0.0

    def __call__(self, request):
        answer = Answer(seconds=0.01)
        if request.codec:
            slope = request.params["slope"]
            line = round(request.params["line"]["set"].get("w_t", 0) / 0.1 * 23)
            answer.seconds += float(np.sum(self.cost(line, slope)))
            want = request.params["want"]
            points = Points.of_ending(len(slope), "raised", "", want)
            answer.record = request.codec.encode(points)
        self.spent += answer.seconds
        return answer


@pytest.mark.parametrize("name", UNEVEN)
def test_what_is_left_is_told_to_a_half_after_a_fifth_of_the_work(
    tmp_path, monkeypatch, name
):
    monkeypatch.setattr(
        grid, "MOST_POINTS", 100
    )  # some tenths of a second of work, as in any run
    axes, cost = UNEVEN[name]
    text = f'name = "s"\nwalker = "E"\n[axes]\n{axes}\n'
    plan = Plan(study_of(text + '[want]\nvariables = ["period"]\n'), Memory())
    workers, told = Simulated(cost), []
    engine = Answering(workers)

    class Watched(Progress):
        def finished(self, done):
            super().finished(done)
            told.append((workers.spent, 2 * self.state()["eta"]))

    watched = Watched(plan, summary(plan), tmp_path / "log", engine, quiet=True)
    run_all([Work(plan, [watched])], engine)
    watched.file.close()

    wrong = [
        left / (workers.spent - spent)
        for spent, left in told
        if 0.2 * workers.spent <= spent <= 0.7 * workers.spent
    ]
    assert len(wrong) > 10 and min(wrong) > 1 / 1.5 and max(wrong) < 1.5


class Screen(io.StringIO):
    """A standard error that is a terminal."""

    def isatty(self):
        return True

    def fileno(self):
        return 2


STATE = {
    "points": 1000, "cached": 100, "done": 240, "todo": 900, "rate": 42.0, "eta": 19.7,
    "counts": {}, "stages": {"points": {"done": 240, "todo": 900}}, "overdue": False,
}  # fmt: skip


class Shown:
    """A study in that state, of which a result came so many seconds ago."""

    def __init__(self, seconds):
        self.seconds = seconds

    @property
    def changed(self):
        return time.monotonic() - self.seconds

    def state(self):
        return STATE

    def log_state(self):
        """Nothing."""


def _displayed(monkeypatch, screen, seconds=0.0):
    """What a display writes to a screen within some of its intervals."""
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setattr(display, "_BAR", 0.01)
    monkeypatch.setattr(display, "_LINE", 0.01)
    with display.Display([9], quiet=False) as shown:
        shown.begin(Shown(seconds))
        time.sleep(0.2)
    return screen.getvalue()


@pytest.mark.parametrize("columns", [200, 40, 0])
def test_the_progress_of_all_studies_is_a_bar_on_a_terminal(monkeypatch, columns):
    """However narrow the terminal is; one may not know its width."""
    size = os.terminal_size((columns, 24))
    monkeypatch.setattr(os, "get_terminal_size", lambda number: size)

    lines = _displayed(monkeypatch, Screen()).split("\r")

    whole = [line for line in lines if line.startswith(" 34%|")]
    assert whole and max(map(len, lines)) < (columns or 120)
    if columns != 40:
        assert "340 of 1,000 points (34 %), 42 a second, 19.7 s to go" in whole[0]


def test_the_progress_in_a_file_is_a_line_now_and_then(monkeypatch):
    lines = _displayed(monkeypatch, io.StringIO()).splitlines()

    assert len(lines) > 1
    assert {*lines} == {"340 of 1,000 points (34 %), 42 a second, 19.7 s to go"}


@pytest.mark.parametrize(
    ("seconds", "told"), [(5.0, "14.7 s to go"), (30.0, "longer than planned")]
)
def test_the_time_to_go_falls_while_jobs_run(monkeypatch, seconds, told):
    lines = _displayed(monkeypatch, io.StringIO(), seconds).splitlines()

    assert lines and all(line.endswith(told) for line in lines)


def test_the_time_to_go_does_not_rise_while_studies_wait(monkeypatch):
    """Two are over after 20 s, so that each of the seven that wait takes 10 s."""
    shown = display.Display([9] * 10, quiet=True)
    shown.over, shown.open = 2, [Shown(5.0)]
    shown.start = time.monotonic() - 25.0

    assert shown._state()["eta"] == pytest.approx(19.7 + 7 * 10.0 - 5.0, abs=0.5)


@pytest.mark.soak
def test_the_time_to_go_of_a_real_run(toy, tell):
    """Toy points, a tenth of which cost twenty times as much as the others."""
    toy.write(STUDY.replace("n = 200", "n = 8000").replace("w_t = [0.0, 0.25]", ""))
    began = time.time()
    toy("run", "toy.toml", TOY_SECONDS="0.004", TOY_COSTLY="0.14 0.16 0.08")
    took, wrong = time.time() - began, []
    for line in Path(companions(toy).events).read_text().splitlines():
        event = json.loads(line)
        if (
            event["event"] == "state"
            and 0.2 * took < event["time"] - began < 0.7 * took
        ):
            wrong.append(event["eta"] / (began + took - event["time"]))
    assert len(wrong) > 2 and min(wrong) > 1 / 1.5 and max(wrong) < 1.5
    tell(
        f"time to go of a run of {took:.0f} s, a tenth of it twenty times as dear: {min(wrong):.2f} to"
        f" {max(wrong):.2f} of what it was, between 20 and 70 % of the time"
    )
