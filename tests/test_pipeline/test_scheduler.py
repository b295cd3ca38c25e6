"""The order of the jobs of several studies."""

import contextlib
import gc
import itertools
import os
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.engine import progress, worker_process
from gaitsweep.pipeline.engine.executors import Engine
from gaitsweep.pipeline.engine.jobs import Jobs
from gaitsweep.pipeline.engine.request import Request
from gaitsweep.pipeline.engine.scheduler import Scheduler
from gaitsweep.pipeline.engine.signals import Signals
from gaitsweep.pipeline.errors import StoppedError, StudyError
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.store.record import Packing, Points, pack, unpacked
from gaitsweep.pipeline.store.store import Outcome, Store
from gaitsweep.pipeline.study import parse

TEXT = 'name = "{}"\nkind = "branch"\nwalker = "{}"\n[axes]\nslope = [0.01, 0.02]\n{} = [0.1, 0.2, 0.3]\n'


@pytest.fixture
def scheduler(tmp_path):
    """Of two studies of three lines, with knees and without."""
    engine, studies = Engine(2), []
    with contextlib.ExitStack() as stack:
        for walker, key in (("C", "detuning"), ("E", "foot_mass_ratio")):
            (tmp_path / f"{walker}.toml").write_text(TEXT.format(walker, walker, key))
            study = parse.read(tmp_path / f"{walker}.toml")
            journal = stack.enter_context(contextlib.closing(Store(tmp_path / walker)))
            studies.append(Jobs(Plan(study, journal), engine, lambda *_: None))
        yield Scheduler(studies, engine, Signals())


def _walkers(scheduler, n):
    return [
        request.params["line"]["walker"]
        for _, request in itertools.islice(iter(scheduler._next, None), n)
    ]


def test_one_worker_compiles_the_equations_of_knees_while_others_do_other_work(
    scheduler,
):
    kneed, straight = (study.seconds(study.peek()) for study in scheduler.studies)
    assert kneed > straight
    assert _walkers(scheduler, 3) == ["C", "E", "E"]
    del scheduler.running[0]  # it has compiled them
    assert _walkers(scheduler, 2) == ["C", "C"]
    assert _walkers(scheduler, 9) == ["E"]


def test_a_worker_without_other_work_does_not_wait_for_code(scheduler):
    scheduler.studies = scheduler.studies[:1]
    assert _walkers(scheduler, 9) == ["C", "C", "C"]


@pytest.mark.parametrize("place", ["_record", "_finish"])
def test_a_run_that_is_stopped_is_told_in_no_words_of_a_library(
    scheduler, monkeypatch, recwarn, place
):
    """A signal while a result is recorded, or an archive written, leaves tasks of
    joblib unfinished.
    """

    def stop(*_):
        raise StoppedError(15, "Stopped.")

    monkeypatch.setattr(
        worker_process,
        "run",
        lambda number, request: time.sleep(0.1) or (number, {"seconds": 0.1}),
    )
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


FAILED = {"outcome": "raised", "reason": "It raised.", "data": b"", "seconds": 0.1}


def _meanwhile(monkeypatch, study, function, *arguments):
    """Call a function in another thread while a job of a study is taken, the first
    time.
    """
    request, threads = study._request, []

    def meanwhile(node):
        threads.extend([] if threads else [_beside(function, *arguments)])
        return request(node)

    monkeypatch.setattr(study, "_request", meanwhile)
    return threads


def test_a_study_is_not_over_while_its_last_job_is_taken(scheduler, monkeypatch):
    """Another thread took it between two looks at the study, which was archived without
    it.
    """
    del scheduler.studies[1]
    (study,), ended = scheduler.studies, []
    monkeypatch.setattr(scheduler, "finish", ended.append)
    for _ in range(2):
        scheduler._record(scheduler._next()[0], FAILED)
    threads = _meanwhile(monkeypatch, study, scheduler._finish)
    number, _ = scheduler._next()
    threads[0].join()
    assert not ended and scheduler.studies == [study]
    scheduler._record(number, FAILED)
    assert ended == [study]


def _twins(tmp_path, stack, listen=lambda *_: None):
    """Jobs of two studies of the same three lines."""
    tmp_path.mkdir(exist_ok=True)
    for name in "ab":
        (tmp_path / f"{name}.toml").write_text(
            TEXT.format(name, "E", "foot_mass_ratio")
        )
        store = stack.enter_context(contextlib.closing(Store(tmp_path / name)))
        yield Jobs(
            Plan(parse.read(tmp_path / f"{name}.toml"), store), Engine(2), listen
        )


def test_a_result_that_comes_while_another_study_takes_its_job_is_counted_once(
    tmp_path, monkeypatch
):
    """It was copied to that study, which computed it as well: the progress of a run
    told of seven cascades of six.
    """
    with contextlib.ExitStack() as stack:
        told = []
        one, other = _twins(
            tmp_path, stack, lambda event, details: told.append(details["task"])
        )
        scheduler = Scheduler([one, other], one.engine, Signals())
        first, *_ = [scheduler._next()[0] for _ in range(3)]
        threads = _meanwhile(
            monkeypatch, other, scheduler._record, first, {**FAILED, "outcome": "ok"}
        )
        assert (
            scheduler._next() is None
        )  # all jobs of the other study wait for those of the first
        threads[0].join()
        assert told == ["atlas"] * 2 and (one.running, other.running) == (2, 2)


def test_a_study_gets_no_result_that_it_does_not_lack(tmp_path):
    """Where an atlas has failed, what stands on it is not to come."""
    with contextlib.ExitStack() as stack:
        study, _ = _twins(tmp_path, stack)
        node, _ = study.take()
        study.record(node, FAILED)
        again = Jobs(Plan(study.study, study.store), study.engine, lambda *_: None)
        keys = study.graph.line_keys(node.line)
        assert len(set(study.wanted())) == 4 and not {
            key.key for key in keys.values()
        } & set(again.wanted())


def test_a_study_that_ends_has_no_other_job(scheduler):
    study = scheduler.studies[0]
    study.fail(StudyError("The disk is full."))
    assert study.peek() is None and study.take() is None and study.is_over


def test_a_task_waits_for_what_it_needs_and_is_dropped_with_it(scheduler):
    study = scheduler.studies[0]
    atlases = [study.take()[0] for _ in range(3)]
    assert (
        {node.task for node in atlases} == {"atlas"}
        and study.peek() is None
        and not study.is_over
    )
    result = {"outcome": "ok", "reason": "", "data": b"", "seconds": 0.1}
    study.record(atlases[0], result)
    branch = study.peek()
    assert (branch.task, branch.line, branch.needs) == (
        "branch",
        atlases[0].line,
        (atlases[0].key.key,),
    )
    for node in atlases[1:]:
        study.record(node, {**result, "outcome": "raised", "reason": "It raised."})
    study.record(study.take()[0], result)
    assert study.is_over and not study.error
    lost = study.graph.line_keys(atlases[1].line)["branch"]
    # Another study has it, but here it has nothing to stand on.
    study.copy(study.graph.node("branch", atlases[1].line), b"")
    assert lost.key not in study.store


def test_what_waits_for_a_result_goes_to_the_worker_that_brought_it(scheduler):
    del scheduler.studies[1]
    taken, brought, ended = [], threading.Event(), threading.Event()

    def work():
        taken.append(scheduler._next())
        assert scheduler._has_jobs()  # as joblib asks
        brought.set()
        taken.append(scheduler._next())
        ended.set()

    thread = threading.Thread(target=work)
    thread.start()
    assert brought.wait(9) and not ended.wait(0.1)
    scheduler._record(taken[0][0], {**FAILED, "outcome": "ok"})
    thread.join()
    assert [request.function.rpartition(":")[2] for _, request in taken] == [
        "atlas",
        "branch",
    ]


def test_a_result_that_two_studies_want_is_computed_once(tmp_path):
    engine, asked = Engine(2), []
    with contextlib.ExitStack() as stack:
        studies = list(_twins(tmp_path, stack))

        @contextlib.contextmanager
        def parallel():
            def run(_, take):
                for number, request in iter(take, None):
                    asked.append(
                        (
                            request.function,
                            request.params["line"]["set"]["foot_mass_ratio"],
                        )
                    )
                    # The first attempt fails: limits of studies differ, so the other
                    # one tries by itself.
                    outcome = "timed_out" if len(asked) == 1 else "ok"
                    yield (
                        number,
                        {"outcome": outcome, "reason": "", "data": b"", "seconds": 0.1},
                    )

            yield run

        engine.parallel = parallel
        Scheduler(studies, engine, Signals()).run()
        found = [
            {key: study.store.outcome(key).status for key in study.store}
            for study in studies
        ]
    assert len(asked) == len(set(asked)) + 1 == 7
    assert (
        sorted(map(len, found)) == [5, 6]
        and sum(list(f.values()).count("timed_out") for f in found) == 1
    )


def test_a_result_is_kept_for_a_study_that_begins_later(tmp_path, monkeypatch):
    """Few studies are open at a time: an atlas that the first has made is not made
    again.
    """
    monkeypatch.setattr("gaitsweep.pipeline.engine.scheduler.MOST_OPEN", 2)
    engine, asked, opened = Engine(2), [], []

    @contextlib.contextmanager
    def parallel():
        def run(_, take):
            for number, request in iter(take, None):
                asked.append(
                    (request.function, request.params["line"]["set"]["foot_mass_ratio"])
                )
                yield (
                    number,
                    {"outcome": "ok", "reason": "", "data": b"", "seconds": 0.1},
                )

        yield run

    engine.parallel = parallel
    with contextlib.ExitStack() as stack:
        waiting = [jobs for n in range(3) for jobs in _twins(tmp_path / f"{n}", stack)]

        def begin():
            opened.append(sum(not study.is_over for study in scheduler.studies))
            return waiting.pop() if waiting else None

        scheduler = Scheduler([], engine, Signals(), begin=begin)
        scheduler.run()

    assert len(asked) == len(set(asked)) == 6 and max(opened) < 2


def _divided(monkeypatch, n, trouble):
    """A chunk of n lines of two slopes of which some fail: its points, atlases, and the
    lines of each request.
    """
    asked = []

    def ask(request, *again):
        params = request.params
        if "lines" not in params:  # alone: first the atlas, then the points
            return (
                ("ok", [b"atlas"])
                if request.function == "atlas"
                else ("raised", "trouble")
            )
        numbers = [line["number"] for line in params["lines"]]
        asked.append(len(numbers))
        if trouble & set(numbers):
            return "raised", "trouble"
        status = np.zeros((2 * len(numbers), 4), np.int8)
        result = {
            "status": status,
            "reason": status,
            "reasons": [""],
            "period": np.ones(status.shape),
        }
        points = Points.of_task(result, {"want": ["period"], "slope": status})
        return "ok", [
            *pack(points, request.packing),
            *(b"%d" % number for number in numbers),
        ]

    monkeypatch.setattr(worker_process, "_ask", ask)
    params = {
        "lines": [{"number": k} for k in range(n)],
        "slope": np.array([0.01, 0.02]),
        "want": ["period"],
        "gaits": ["long"],
    }
    packing = Packing(Shape((n, 2), (n, 2), 1), 3, ["long"])
    request = Request(
        "f", params, [], 1.0, 1 << 30, packing=packing, alone=("atlas", "points")
    )
    _, answer = worker_process.run(0, request)
    return unpacked(*answer["record"]), answer["atlases"], asked


@pytest.mark.parametrize("trouble", [{3, 7}, set(), set(range(20))])
def test_lines_that_fail_are_divided_until_the_bad_ones_are_alone(monkeypatch, trouble):
    points, atlases, asked = _divided(monkeypatch, 20, trouble)
    failed = points.values["status"][:, 0].reshape(20, 2) != 0
    assert set(np.flatnonzero(failed.any(axis=1)).tolist()) == trouble
    assert [place for place, _, _, _ in atlases] == list(range(20))
    assert asked[0] == 20 and sum(asked[1:]) <= (40 if trouble else 0)


def test_lines_of_which_one_fails_are_not_all_computed_one_by_one(monkeypatch):
    points, _, asked = _divided(monkeypatch, 64, {40})
    assert np.flatnonzero(points.values["status"][:, 0]).tolist() == [80, 81]
    assert sorted(asked) == [1] * 4 + [4] * 16 + [64]


def test_a_thread_keeps_its_worker_process_while_it_lives(monkeypatch):
    alive, made = [], []

    def start():
        worker = SimpleNamespace(
            ask=lambda _: ("ok", len(made)),
            used=(0.0, 0.0),
            process=SimpleNamespace(poll=lambda: None),
        )
        made.append(worker)
        alive.append(worker)
        return worker

    monkeypatch.setattr(worker_process, "WorkerProcess", start)
    monkeypatch.setattr(worker_process, "_workers", alive)
    monkeypatch.setattr(worker_process, "_local", SimpleNamespace(used=[0.0, 0.0]))
    request = Request("f", {}, [], 1.0, 1)
    asked = [worker_process._ask(request)[1] for _ in range(2)]
    alive.clear()
    assert [*asked, worker_process._ask(request)[1]] == [1, 1, 2]


@pytest.mark.parametrize(
    ("is_terminal", "columns"), [(False, 80), (True, 80), (True, 0)]
)
def test_the_progress_of_all_studies_is_one_line(monkeypatch, is_terminal, columns):
    """However narrow the terminal is; one may not know its width."""
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(fileno=lambda: 2))
    monkeypatch.setattr(
        os, "get_terminal_size", lambda number: os.terminal_size((columns, 24))
    )
    said, waits = [], iter([False, True])
    display = progress.Display([9], quiet=False)
    display.begin(SimpleNamespace(state=dict, log_state=lambda: None))
    display.is_terminal, display.stopped = (
        is_terminal,
        SimpleNamespace(wait=lambda _: next(waits)),
    )
    for name, value in (
        ("_FAST", 0.0),
        ("_SLOW", 0.0),
        ("total", list),
        ("sentence", lambda _: "3 of 9 points" * 10),
    ):
        monkeypatch.setattr(progress, name, value)
    monkeypatch.setattr(
        progress.terminal, "say", lambda text, end="\n": said.append((text, end))
    )
    display._tick()
    (line,) = said
    shown = ("3 of 9 points" * 10)[: 79 if columns else 118]
    assert line == (
        ("\r\033[K" + shown, "") if is_terminal else ("3 of 9 points" * 10, "\n")
    )


PLANE = """
name = "{}"
walker = "A"
[axes]
slope = {{ from = 0.01, to = 0.02, n = 16 }}
m_h = {{ from = 0.0, to = 10.0, n = 20 }}
R = {{ from = 0.1, to = 0.4, n = 15 }}
"""


def _box(low, high, lines):
    return {
        "low": low,
        "high": high,
        "origin": [0.0, 0.0],
        "halved": [0, 0],
        "lines": lines,
        "surveyed": 0.0,
    }


@pytest.mark.parametrize("studies", ["a", "ab"])
def test_the_boxes_of_a_plane_are_made_once_for_all_chunks_that_meet_them(
    tmp_path, studies
):
    """Whatever studies of a command want them; what is left is told by their lines: of
    20 values of m_h 10 are each.
    """
    low, high = (
        _box([0.1, 0.0], [0.4, 5.0], 128.0),
        _box([0.1, 5.0], [0.4, 10.0], 128.0),
    )
    halved = {f"halves/{name}": np.array([low[name], high[name]]) for name in low}
    alone = {"alone/low": np.array([[0.1, 7.5]]), "alone/high": np.array([[0.4, 10.0]])}
    engine, made, eta, inputs = Engine(2), [], [], set()
    with contextlib.ExitStack() as stack:
        jobs = []
        for name in studies:
            (tmp_path / f"{name}.toml").write_text(PLANE.format(name))
            store = stack.enter_context(contextlib.closing(Store(tmp_path / name)))
            plan = Plan(parse.read(tmp_path / f"{name}.toml"), store)
            jobs.append(
                Jobs(
                    plan,
                    engine,
                    progress.Progress(
                        plan, summary(plan), tmp_path / "log", engine, True
                    ),
                )
            )
        scheduler = Scheduler(jobs, engine, Signals())
        told = jobs[0].listen
        while taken := scheduler._next():
            number, request = taken
            answer = {"seconds": 4.0, "atlases": []}
            if request.packing:
                m_h = [line["set"]["m_h"] for line in request.params["lines"]]
                assert len(request.inputs) == 1 + (min(m_h) <= 5) + (max(m_h) >= 5)
                inputs.add(len(request.inputs))
                n = len(request.params["lines"]) * 16
                points = Points.of_ending(n, "raised", "", request.params["want"])
                answer["record"] = pack(points, request.packing)
            else:
                plane = request.params["plane"]
                made.append(plane)
                answer |= {"outcome": "ok", "reason": ""}
                answer["data"] = serialize.dump((halved, {}, alone)[len(made) - 1])
                planned = told._stages()["charts"]["eta"]
            scheduler._record(number, answer)
            if not request.packing:
                eta.append((planned, told._stages()["charts"]))
        assert 2 in inputs and [box["high"] for box in made] == [
            [0.4, 10.0],
            low["high"],
            high["high"],
        ]
        assert [stage["done"] for _, stage in eta] == [0, 150, 300] and eta[2][1][
            "eta"
        ] == 0
        cost = jobs[0].graph.seconds("charts")
        assert 2 * eta[0][0] == pytest.approx(300 * cost, abs=0.1)  # on two workers
        # As if half the plane had been measured as planned.
        for (_, stage), spent, done in zip(eta[:2], (4.0, 8.0), (0, 150), strict=True):
            each = (spent + 150 * cost) / (done + 150)
            assert stage["eta"] == pytest.approx(each * (300 - done) / 2, abs=0.06)
        # Of the lines above m_h = 7.5, 75, some are in chunks of others.
        for study in jobs:
            atlas = study.listen._stages()["atlas"]
            assert atlas == {"done": 75, "todo": 75, "eta": 0.0}
            assert study.listen._stages()["charts"] == {
                "done": 300,
                "todo": 300,
                "eta": 0.0,
            }
            study.listen.close(True)


@pytest.mark.parametrize("fails", [False, True])
def test_a_half_that_is_being_made_or_has_failed_is_not_made_again(tmp_path, fails):
    """Other chunks of its plane need it, too, which come after those of another plane."""
    low, high = (
        _box([0.1, 0.0], [0.4, 5.0], 128.0),
        _box([0.1, 5.0], [0.4, 10.0], 128.0),
    )
    halved = serialize.dump(
        {f"halves/{name}": np.array([low[name], high[name]]) for name in low}
    )
    (tmp_path / "a.toml").write_text(PLANE.format("a") + "g = [1.0, 2.0]\n")
    with contextlib.closing(Store(tmp_path / "a")) as store:
        plan = Plan(parse.read(tmp_path / "a.toml"), store, retry=True)
        jobs, taken = Jobs(plan, Engine(2), lambda *_: None), []
        while job := jobs.take():
            taken.append(job[0])
            jobs.peek()
            if job[0].task == "charts" and (fails or job[0].box is None):
                answer = {
                    "seconds": 1.0,
                    "outcome": "raised",
                    "reason": "It raised.",
                    "data": b"",
                }
                is_half = job[0].box is not None
                jobs.record(
                    job[0],
                    answer
                    if is_half
                    else answer | {"outcome": "ok", "reason": "", "data": halved},
                )
        made = [node for node in taken if node.task == "charts"]
        assert len({node.key.key for node in made}) == len(made) == 6
        boxes = plan.boxes(made[-1], "alone")  # all of one that failed
        assert [box["lines"] for box in boxes] == ([128] if fails else [])


def test_lines_that_charts_leave_alone_are_expected_as_often_as_they_were_seen(
    tmp_path,
):
    """Half of those of a plane count as seen, a usual share of them alone, and times
    are fitted to those of chunks.
    """
    (tmp_path / "a.toml").write_text(PLANE.format("a"))
    study = parse.read(tmp_path / "a.toml")
    lines = progress._LinesAlone(study, 150)
    usual = Graph(study).seconds("atlas") / costs.of_line_alone(study)
    assert lines.expected(300) == round(300 * usual)
    lines.add({"charted": 150, "alone": 60})
    assert (
        lines.expected(300) == round(60 + (150 * usual + 60) / 300 * 150)
        and lines.expected(3) == 3
    )
    # Of a run whose charts are stored only chunks tell.
    stored = progress._LinesAlone(study, 150)
    stored.add({"lines": 150, "alone": 60, "points": 2400, "seconds": 1.0})
    assert stored.expected(300) == lines.expected(300)
    for points, alone in ((1000, 0), (2000, 10), (3000, 60)):
        lines.add(
            {
                "lines": 60,
                "alone": alone,
                "points": points,
                "seconds": 2e-3 * points + 0.7 * alone,
            }
        )
    assert lines.seconds("points") == pytest.approx(2e-3, rel=1e-2)
    assert lines.seconds("atlas") == pytest.approx(0.7, rel=1e-2)


@pytest.mark.parametrize("has_failed", ["plane", "half"])
def test_charts_that_failed_are_tried_again_with_their_halves(tmp_path, has_failed):
    """Another worker looks for jobs while they are: what was stored of them then is
    none of their halves.
    """
    low, high = (
        _box([0.1, 0.0], [0.4, 5.0], 128.0),
        _box([0.1, 5.0], [0.4, 10.0], 128.0),
    )
    halved = serialize.dump(
        {f"halves/{name}": np.array([low[name], high[name]]) for name in low}
    )
    (tmp_path / "a.toml").write_text(PLANE.format("a"))
    failed, made = Outcome("raised", "It raised."), []
    with contextlib.closing(Store(tmp_path / "a")) as store:
        plan = Plan(parse.read(tmp_path / "a.toml"), store, retry=True)
        box = {**plan.study.plane.region, **low}
        plane, half, *_ = plan.graph.charts_of(
            plan.graph.grid.chunk(0), lambda node: [] if node.box else [low]
        )
        assert half.box == box
        if has_failed == "half":
            store.put_result(plane.key, Outcome("ok", ""), halved)
        store.put_result((half if has_failed == "half" else plane).key, failed, b"")
        scheduler = Scheduler(
            [Jobs(plan, Engine(2), lambda *_: None)], Engine(2), Signals()
        )
        while taken := scheduler._next():
            scheduler._has_jobs()
            number, request = taken
            if request.packing:
                break
            made.append(request.params["plane"]["high"])
            data = serialize.dump({}) if "halved" in request.params["plane"] else halved
            scheduler._record(
                number, {"seconds": 1.0, "outcome": "ok", "reason": "", "data": data}
            )
    assert made[-1] == low["high"] and len(made) == 1 + (has_failed == "plane")
