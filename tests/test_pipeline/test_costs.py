"""How long a run will take is told by what its regions cost, not by how many points are left."""

import contextlib
import itertools
import json
import time
from pathlib import Path

import numpy as np
import pytest

from conftest import STUDY
from pipeline import serialize
from pipeline.execution.archive_chunks import ArchiveChunks
from pipeline.execution.estimates import Costs
from pipeline.execution.executors import Engine
from pipeline.execution.job import Job
from pipeline.execution.point_queue import PointQueue
from pipeline.execution.scheduler import Scheduler
from pipeline.execution.study_jobs import StudyJobs
from pipeline.plan.missing import LineWork, Plan
from pipeline.store.journal import Journal
from pipeline.study import parse
from processes import sidecar_path

PEAK = "slope = { from = 0.01, to = 0.2, n = 40000 }"
#: Axes, and seconds of a point by its line's number and slope.
UNEVEN = {
    "even": (PEAK, lambda line, slope: 1e-3 + 0 * slope),
    "a dear tenth": (PEAK, lambda line, slope: np.where(abs(slope - 0.15) < 0.01, 2e-2, 1e-3)),
    "a dear twentieth": (PEAK, lambda line, slope: np.where(abs(slope - 0.0333) < 0.005, 5e-2, 1e-3)),
    "dear towards zero": (
        'slope = { from = 1e-12, to = 0.1, n = 40000, spacing = "log" }',
        lambda line, slope: 1e-5 * (1 + (1e-6 / slope) ** 0.5),
    ),
    "dear lines": (
        PEAK.replace("40000", "4000") + "\nw_t = { from = 0, to = 0.1, n = 12 }",
        lambda line, slope: 1e-4 * (1 + line) + 0 * slope,
    ),
    "dear lines and regions": (
        PEAK.replace("40000", "10000") + "\nw_t = { from = 0, to = 0.1, n = 6 }",
        lambda line, slope: 2e-4 * (1 + line) * np.where(slope > 0.18, 10, 1),
    ),
}


class Simulated(Engine):
    """An engine of two workers whose time is counted, not spent."""

    def __init__(self, cost, overhead=0.01, ahead=1):
        super().__init__()
        self.cost, self.overhead, self.ahead, self.spent, self.finished = cost, overhead, ahead, 0.0, 0

    @contextlib.contextmanager
    def parallel(self):
        def several(jobs):
            while some := list(itertools.islice(jobs, self.ahead)):
                yield from some

        def parallel(jobs):
            for number, job in several(jobs):
                took = self.overhead
                result = {"outcome": "ok", "reason": "", "data": serialize.dump({})}
                if job.divided == "slope":
                    slope = job.params["slope"]
                    line = round(job.params["line"]["set"].get("w_t", 0) / 0.1 * 59)
                    took = self.overhead + float(np.sum(self.cost(line, slope)))
                    self.finished += len(slope) if job.chunk else 0
                    states = {
                        "status": np.zeros((len(slope), 4), np.int8),
                        "reasons": np.array([""]),
                        "reason": np.zeros((len(slope), 4), np.int16),
                    }
                    result = {"rows": [(slope.tobytes(), serialize.dump(states), serialize.dump({}))]}
                self.spent += took
                yield number, {**result, "seconds": took, "pid": 0}

        yield parallel


@pytest.mark.parametrize("name", UNEVEN)
def test_what_is_left_is_told_to_a_quarter_after_a_fifth_of_the_work(tmp_path, name):
    axes, cost = UNEVEN[name]
    (tmp_path / "s.toml").write_text(f'name = "s"\nwalker = "E"\n[axes]\n{axes}\n[want]\nvariables = ["period"]\n')
    found = parse.read(tmp_path / "s.toml")
    engine, told = Simulated(cost), []
    journal = Journal(tmp_path / "j")

    def listen(*_):
        told.append((engine.spent, jobs.costs.seconds_left()))

    jobs = StudyJobs(Plan(found, journal), engine, listen, found.points)
    Scheduler([jobs], engine).run()
    journal.close()
    wrong = [
        abs(left / (engine.spent - spent) - 1)
        for spent, left in told
        if 0.2 * engine.spent <= spent <= 0.7 * engine.spent
    ]
    assert len(wrong) > 10 and max(wrong) < 0.25
    assert len(told) < 100 * found.lines + 4 * engine.spent  # chunks are not much smaller for it


@pytest.mark.parametrize(("overhead", "cost"), [(0.002, 1e-5), (0.03, 1e-5), (0.01, 1e-4)])
def test_cheap_points_are_finished_by_workers_however_long_a_job_takes_to_begin(tmp_path, overhead, cost):
    """Where it takes longer than a probe's points do, these seem as dear as points beside a singularity."""
    (tmp_path / "s.toml").write_text('name = "s"\nwalker = "E"\n[axes]\n' + PEAK.replace("40000", "400000"))
    study, engine = parse.read(tmp_path / "s.toml"), Simulated(lambda line, slope: cost + 0 * slope, overhead)
    with contextlib.closing(Journal(tmp_path / "j", points=study.points)) as journal:
        Scheduler([StudyJobs(Plan(study, journal), engine, lambda *_: None, study.points)], engine).run()
    assert engine.finished > 0.9 * study.points


@pytest.mark.parametrize("cost", [1e-4, 2e-6])
def test_a_line_whose_jobs_end_together_is_probed_once_and_loses_no_point(tmp_path, cost):
    """Results that come before a line is probed ask for it again."""
    (tmp_path / "s.toml").write_text('name = "s"\nwalker = "E"\n[axes]\n' + PEAK.replace("40000", "400000"))
    study, probed = parse.read(tmp_path / "s.toml"), []
    engine = Simulated(lambda line, slope: np.where(slope < 0.011, 1e-3, cost), ahead=4)
    with contextlib.closing(Journal(tmp_path / "j", points=study.points)) as journal:
        plan = Plan(study, journal)
        jobs = StudyJobs(plan, engine, lambda *_: None, study.points)
        probes = jobs.costs.probes
        jobs.costs.probes = lambda *asked: probed.append(asked[0]) or probes(*asked)
        Scheduler([jobs], engine).run()
        assert probed == [0]
        assert not len(plan.line(0).missing)


def test_jobs_that_wait_do_not_hold_the_points_of_their_lines(tmp_path):
    """Atlases of a hundred lines of ten million slopes held four gigabytes."""
    (tmp_path / "s.toml").write_text('name = "s"\nwalker = "E"\n[axes]\n' + PEAK)
    study = parse.read(tmp_path / "s.toml")
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        jobs = StudyJobs(Plan(study, journal), Engine(2), lambda *_: None, study.points)
        jobs.advance()
        atlas, _ = jobs.take()
        jobs._open_line(jobs.plan.line(0), ())
        waiting = [atlas, *jobs._queue.jobs]
        assert [job.name for job in waiting[:2]] == ["atlas", "points"]
        assert all(len(job.work.missing) == 0 and job.missing == len(study.slope) for job in waiting)


def test_the_points_of_a_line_whose_atlas_fails_are_left_no_longer(tmp_path):
    (tmp_path / "s.toml").write_text('name = "s"\nwalker = "E"\n[axes]\n' + PEAK)
    study, told = parse.read(tmp_path / "s.toml"), []
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        jobs = StudyJobs(Plan(study, journal), Engine(2), lambda *event: told.append(event), study.points)
        jobs.advance()
        atlas, _ = jobs.take()
        jobs.record(atlas, {"outcome": "raised", "reason": "It raised.", "data": b"", "seconds": 0.1})
        assert told[-1][1]["lost"] == len(study.slope) and jobs.costs.points == study.points - len(study.slope)


def test_a_result_that_comes_while_its_line_is_probed_does_not_have_it_probed_again(tmp_path, monkeypatch):
    (tmp_path / "s.toml").write_text('name = "s"\nwalker = "E"\n[axes]\n' + PEAK)
    study, probed = parse.read(tmp_path / "s.toml"), []
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        jobs = StudyJobs(Plan(study, journal), Engine(2), lambda *_: None, study.points)
        jobs._open_line(jobs.plan.line(0), ())
        jobs._to_probe[0], probe = jobs._queue.jobs[0].work, jobs._queue.probe

        def meanwhile(work):
            jobs._to_probe.update({} if probed else {0: work})
            probed.append(work.number)
            probe(work)

        monkeypatch.setattr(jobs._queue, "probe", meanwhile)
        next(jobs._dependent_jobs())
    assert probed == [0]


def test_jobs_of_a_line_hold_each_point_once_in_order_however_often_they_are_divided():
    """A part of a probe that was taken lies in the gap that the probe left in another job."""
    costs, work = Costs(64_000, 64_000, 1e-3), LineWork(0, {}, {}, {}, np.arange(0))
    costs.open_line(0, np.arange(64_000))
    queue = PointQueue(costs, ArchiveChunks(64_000, 1000), lambda job: 5)
    queue.open(Job(None, "points", ("", ""), {}, work), np.arange(64_000), 100)
    taken = [queue.take()[0].indices for _ in range(2)]
    for _ in range(2):
        queue.probe(work)
        taken.append(queue.take()[0].indices)
        left = [job.indices for job in queue.jobs]
        assert all((np.diff(indices) > 0).all() for indices in left)
        assert np.array_equal(np.sort(np.concatenate([*taken, *left])), np.arange(64_000))


@pytest.mark.soak
def test_the_time_to_go_of_a_real_run(toy, tell):
    """Toy points, a tenth of which cost twenty times as much as the others."""
    toy.write(STUDY.replace("n = 200", "n = 8000").replace("w_t = [0.0, 0.25]", ""))
    began = time.time()
    toy("run", "toy.toml", TOY_SECONDS="0.004", TOY_COSTLY="0.14 0.16 0.08")
    took, wrong = time.time() - began, []
    for line in Path(sidecar_path(toy, ".events.jsonl")).read_text().splitlines():
        event = json.loads(line)
        if event["event"] == "state" and 0.2 * took < event["time"] - began < 0.7 * took:
            wrong.append(event["eta"] / (began + took - event["time"]) - 1)
    assert len(wrong) > 2 and max(map(abs, wrong)) < 0.25
    tell(
        f"time to go of a run of {took:.0f} s, a tenth of it twenty times as dear: from {min(wrong):+.0%} to"
        f" {max(wrong):+.0%} between 20 and 70 % of the time"
    )


def test_points_too_cheap_to_be_measured_cost_what_their_job_took():
    """All of a probe's time was overhead; the time of a job over several regions is then divided by points."""
    costs = Costs(6400, 6400, 1e-3)
    costs.open_line(0, np.arange(6400))
    costs.add(0, np.arange(100), 0.01, False)
    for probe in costs.probes(0, np.arange(100, 6400))[0]:
        costs.add(0, probe, 0.001, True)
    costs.overhead = 1.0
    costs.add(0, np.arange(200, 400), 0.5, False)
    assert costs.cost_per_point(0)[[2, 3]] == pytest.approx(0.5 / 200) and np.isfinite(costs.seconds_left())


@pytest.mark.parametrize(("slopes", "parts"), [(6400, 1), (6400, 3), (1000, 1), (40, 1)])
def test_slopes_are_divided_where_the_region_changes_and_nowhere_else(slopes, parts):
    costs = Costs(slopes, slopes, 1e-3)
    left = np.flatnonzero(np.arange(slopes) % 7 < 5)
    pieces = costs.by_region(left, parts)
    np.testing.assert_array_equal(np.concatenate(pieces), left)
    regions = [set((piece * parts * 64 // slopes).tolist()) for piece in pieces]
    assert all(len(each) == 1 for each in regions) and len(set.union(*regions)) == len(regions)


def test_points_left_are_counted_while_another_line_is_closed():
    """Jobs are taken in one thread, and recorded in another."""

    class Closing:
        def __getitem__(self, _):
            costs.lines.pop(2, None)
            return np.ones(10)

    costs = Costs(6400, 6400, 1e-3)
    for line in range(3):
        costs.open_line(line, np.arange(10))
    costs.lines[0] = Closing()
    assert costs.open_points() == 30
    assert costs.open_points() == 20
