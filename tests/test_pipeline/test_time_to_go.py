"""How long a run will take is told from what its parts took, which sample it evenly."""

import contextlib
import json
import time
from pathlib import Path

import numpy as np
import pytest

from conftest import STUDY
from gaitsweep.pipeline.engine.executors import Engine
from gaitsweep.pipeline.engine.jobs import Jobs
from gaitsweep.pipeline.engine.progress import Progress
from gaitsweep.pipeline.engine.scheduler import Scheduler
from gaitsweep.pipeline.engine.signals import Signals
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid import grid
from gaitsweep.pipeline.store.record import Points, pack
from gaitsweep.pipeline.store.store import Store
from gaitsweep.pipeline.study import parse
from processes import sidecar_path

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


class Simulated(Engine):
    """An engine of two workers whose time is counted, not spent."""

    def __init__(self, cost):
        super().__init__()
        self.cost, self.spent = cost, 0.0

    @contextlib.contextmanager
    def parallel(self):
        def parallel(_, take):
            for number, job in iter(take, None):
                took, result = 0.01, {"outcome": "ok", "reason": "", "data": b""}
                if job.packing:
                    slope = job.params["slope"]
                    line = round(job.params["line"]["set"].get("w_t", 0) / 0.1 * 23)
                    took += float(np.sum(self.cost(line, slope)))
                    points = Points.of_ending(
                        len(slope), "raised", "", job.params["want"]
                    )
                    result = {"record": pack(points, job.packing), "atlases": []}
                self.spent += took
                yield number, {**result, "seconds": took, "pid": 0}

        yield parallel


@pytest.mark.parametrize("name", UNEVEN)
def test_what_is_left_is_told_to_a_half_after_a_fifth_of_the_work(
    tmp_path, monkeypatch, name
):
    monkeypatch.setattr(
        grid, "MOST_POINTS", 100
    )  # some tenths of a second of work, as in any run
    axes, cost = UNEVEN[name]
    (tmp_path / "s.toml").write_text(
        f'name = "s"\nwalker = "E"\n[axes]\n{axes}\n[want]\nvariables = ["period"]\n'
    )
    engine, told = Simulated(cost), []
    with contextlib.closing(Store(tmp_path / "j")) as store:
        plan = Plan(parse.read(tmp_path / "s.toml"), store)
        progress = Progress(
            plan, summary(plan), tmp_path / "log", quiet=True, engine=engine
        )

        def listen(event, details):
            progress(event, details)
            told.append((engine.spent, 2 * progress.state()["eta"]))

        Scheduler([Jobs(plan, engine, listen)], engine, Signals()).run()
        progress.file.close()
    wrong = [
        left / (engine.spent - spent)
        for spent, left in told
        if 0.2 * engine.spent <= spent <= 0.7 * engine.spent
    ]
    assert len(wrong) > 10 and min(wrong) > 1 / 1.5 and max(wrong) < 1.5


@pytest.mark.soak
def test_the_time_to_go_of_a_real_run(toy, tell):
    """Toy points, a tenth of which cost twenty times as much as the others."""
    toy.write(STUDY.replace("n = 200", "n = 8000").replace("w_t = [0.0, 0.25]", ""))
    began = time.time()
    toy("run", "toy.toml", TOY_SECONDS="0.004", TOY_COSTLY="0.14 0.16 0.08")
    took, wrong = time.time() - began, []
    for line in Path(sidecar_path(toy, ".events.jsonl")).read_text().splitlines():
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
