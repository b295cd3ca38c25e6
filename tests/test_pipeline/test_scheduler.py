"""The order of the jobs of several studies."""

import contextlib
import gc
import itertools
import math
import os
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline import serialize
from pipeline.errors import StoppedError, StudyError
from pipeline.execution import progress, worker_process
from pipeline.execution.executors import Engine
from pipeline.execution.scheduler import Scheduler
from pipeline.execution.study_jobs import StudyJobs
from pipeline.plan.missing import Plan
from pipeline.store.journal import Journal
from pipeline.study import parse

TEXT = 'name = "{}"\nkind = "branch"\nwalker = "{}"\n[axes]\nslope = [0.01, 0.02]\n{} = [0.1, 0.2, 0.3]\n'


@pytest.fixture
def scheduler(tmp_path):
    """Of two studies of three lines, with knees and without."""
    engine, studies = Engine(2), []
    with contextlib.ExitStack() as stack:
        for walker, key in (("C", "detuning"), ("E", "foot_mass_ratio")):
            (tmp_path / f"{walker}.toml").write_text(TEXT.format(walker, walker, key))
            study = parse.read(tmp_path / f"{walker}.toml")
            journal = stack.enter_context(contextlib.closing(Journal(tmp_path / walker)))
            studies.append(StudyJobs(Plan(study, journal), engine, lambda *_: None, study.points))
            studies[-1].advance()
        yield Scheduler(studies, engine)


def _walkers(scheduler, n):
    return [request.params["line"]["walker"] for _, request in itertools.islice(scheduler._ready(), n)]


def test_one_worker_compiles_the_equations_of_knees_while_others_do_other_work(scheduler):
    assert scheduler.studies[0].urgency > scheduler.studies[1].urgency
    assert _walkers(scheduler, 3) == ["C", "E", "E"]
    del scheduler.running[0]  # it has compiled them
    assert _walkers(scheduler, 2) == ["C", "C"]
    assert _walkers(scheduler, 9) == ["E"]


def test_a_worker_without_other_work_does_not_wait_for_code(scheduler):
    scheduler.studies = scheduler.studies[:1]
    assert _walkers(scheduler, 9) == ["C", "C", "C"]


@pytest.mark.parametrize("place", ["_record", "_finish"])
def test_a_run_that_is_stopped_is_told_in_no_words_of_a_library(scheduler, monkeypatch, recwarn, place):
    """A signal while a result is recorded, or an archive written, leaves tasks of joblib unfinished."""

    def stop(*_):
        raise StoppedError(15, "Stopped.")

    monkeypatch.setattr(worker_process, "run", lambda request: time.sleep(0.1) or {"seconds": 0.1})
    monkeypatch.setattr(scheduler, place, stop)
    with pytest.raises(StoppedError):
        scheduler.run()
    gc.collect()
    assert not recwarn.list


def _beside(function, *arguments):
    """Call a function in another thread, and wait a moment for its end."""
    thread = threading.Thread(target=function, args=arguments)
    thread.start()
    thread.join(0.3)
    return thread


def test_a_job_that_is_put_back_while_another_is_taken_is_not_lost(scheduler, monkeypatch):
    study, threads, numbers = scheduler.studies[0], [], []
    lost, _ = study.take()
    request = study.request

    def meanwhile(job):
        threads.extend([] if threads else [_beside(study.put_back, lost)])
        return request(job)

    monkeypatch.setattr(study, "request", meanwhile)
    while study.next:
        numbers.append(study.take()[0].work.number)
        threads[0].join()
    assert sorted(numbers) == [0, 1, 2]


def test_a_study_that_ends_while_a_job_is_taken_has_no_other(scheduler):
    study, threads = scheduler.studies[0], []

    def wave(jobs):
        threads.append(_beside(study.fail, StudyError("The disk is full.")))
        yield from jobs

    study._wave = wave(study._wave)
    assert study.take()
    threads[0].join()
    assert study.next is None and study.take() is None


def test_the_urgency_of_a_study_that_ends_meanwhile_is_told(scheduler):
    study = scheduler.studies[0]

    class Ending:
        name = study.next.name

        @property
        def seconds(self):
            study.fail(StudyError("The disk is full."))
            return 1.0

    study.next = Ending()
    assert 1.0 <= study.urgency < math.inf
    assert study.urgency == -math.inf


def test_a_study_that_is_finished_meanwhile_hides_no_other(scheduler):
    class Finished:
        @property
        def next(self):
            scheduler.studies.remove(self)

    scheduler.studies.insert(0, Finished())
    assert _walkers(scheduler, 1) == ["C"]


def test_a_block_that_failed_is_counted_once_the_next_is_laid_out(tmp_path, monkeypatch):
    """The number of points on lines that are not open is changed by both."""
    (tmp_path / "s.toml").write_text(TEXT.replace('kind = "branch"\n', "").format("s", "E", "w_t").split("w_t")[0])
    with open(tmp_path / "s.toml", "a") as file:
        file.write("w_t = { from = 0, to = 0.1, n = 60 }\n")
    study, order = parse.read(tmp_path / "s.toml"), []
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        jobs = StudyJobs(Plan(study, journal), Engine(1), lambda *_: None, study.points)
        open_line, reopen = jobs.costs.open_line, jobs.costs.reopen
        jobs.advance()
        job, request = jobs.take()
        n = len(job.block.lines)
        states = worker_process._failed_states(2 * n, "not_attempted", "") | {"lines": request.params["digests"]}
        row = np.tile(study.slope, n).tobytes(), serialize.dump(states), serialize.dump({})
        result = {"rows": [row], "atlases": [], "failed": list(range(n)), "seconds": 0.1}

        def opening(*arguments):
            order.append("a block begins to be laid out")
            threads.append(_beside(jobs.record, job, result))
            open_line(*arguments)
            order.append("it is laid out")

        def reopening(*arguments):
            order.append("another is reopened")
            reopen(*arguments)

        threads = []
        monkeypatch.setattr(jobs.costs, "open_line", opening)
        monkeypatch.setattr(jobs.costs, "reopen", reopening)
        assert jobs.take()
        threads[0].join()
    assert not jobs.error
    assert order == ["a block begins to be laid out", "it is laid out", "another is reopened"]


def test_a_block_that_fails_is_divided_until_its_bad_lines_are_alone(monkeypatch):
    asked = []

    def ask(request, params):
        asked.append(len(params["lines"]))
        parts = [None, b"values", b"states", *params["lines"]]
        return ("raised", "trouble") if {3, 7} & set(params["lines"]) else ("ok", parts)

    monkeypatch.setattr(worker_process, "_ask", ask)
    lines, digests = np.arange(20), np.arange(20, dtype=np.uint64)
    params = {"lines": lines.tolist(), "digests": digests, "slope": np.array([0.01, 0.02])}
    answer = worker_process._run_lines(SimpleNamespace(params=params), 0, 20)
    assert answer["failed"] == [3, 7] and answer["atlases"] == [(k, k) for k in range(20) if k not in (3, 7)]
    assert asked[0] == 20 and sum(asked[1:]) < 40
    assert sum(len(np.frombuffer(row[0])) for row in answer["rows"]) == 40


def test_a_thread_keeps_its_worker_process_while_it_lives(monkeypatch):
    alive, made = [], []

    def start():
        worker = SimpleNamespace(lock=threading.Lock(), ask=lambda *_: ("ok", len(made)))
        made.append(worker)
        alive.append(worker)
        return worker

    monkeypatch.setattr(worker_process, "WorkerProcess", start)
    monkeypatch.setattr(worker_process, "_workers", alive)
    monkeypatch.setattr(worker_process, "_local", SimpleNamespace(used=[0.0, 0.0]))
    request = SimpleNamespace(function="f", divided="", memory=1, inputs=[], seconds=1.0)
    asked = [worker_process._ask(request, {})[1] for _ in range(2)]
    alive.clear()
    assert [*asked, worker_process._ask(request, {})[1]] == [1, 1, 2]


@pytest.mark.parametrize(("is_terminal", "columns"), [(False, 80), (True, 80), (True, 0)])
def test_the_progress_of_all_studies_is_one_line(monkeypatch, is_terminal, columns):
    """However narrow the terminal is; one may not know its width."""
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(fileno=lambda: 2))
    monkeypatch.setattr(os, "get_terminal_size", lambda number: os.terminal_size((columns, 24)))
    said, waits = [], iter([False, True])
    display = progress.Display([], quiet=False)
    display.is_terminal, display.stopped = is_terminal, SimpleNamespace(wait=lambda _: next(waits))
    for name, value in (("_FAST", 0.0), ("_SLOW", 0.0), ("total", list), ("sentence", lambda _: "3 of 9 points" * 10)):
        monkeypatch.setattr(progress, name, value)
    monkeypatch.setattr(progress.terminal, "say", lambda text, end="\n": said.append((text, end)))
    display._tick()
    (line,) = said
    shown = ("3 of 9 points" * 10)[: 79 if columns else 118]
    assert line == (("\r\033[K" + shown, "") if is_terminal else ("3 of 9 points" * 10, "\n"))
