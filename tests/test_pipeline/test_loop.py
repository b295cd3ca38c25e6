"""The loop: what is computed when, for whom, and what becomes of what fails."""

import collections
import contextlib
import threading
import time

import numpy as np
import pytest

from answering import Answering, ok, work_of
from gaitsweep.pipeline import dispatch, serialize
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.engine import Engine
from gaitsweep.pipeline.engine.listener import Listener
from gaitsweep.pipeline.engine.loop import Loop, run_all
from gaitsweep.pipeline.engine.places import LONG, Inline, Workers
from gaitsweep.pipeline.engine.request import Answer, Request
from gaitsweep.pipeline.errors import StoppedError, StudyError, WorkerError
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.points import Points
from gaitsweep.pipeline.store.store import Outcome

#: Three lines, of each an atlas and its branches.
LINES = """
name = "{}"
kind = "branch"
walker = "E"
[axes]
slope = [0.01, 0.02]
foot_mass_ratio = [0.1, 0.2, 0.3]
"""
#: 300 lines over two keys, whose gaits charts predict.
PLANE = """
name = "{}"
walker = "A"
[axes]
slope = {{ from = 0.01, to = 0.02, n = 16 }}
m_h = {{ from = 0.0, to = 10.0, n = 20 }}
R = {{ from = 0.1, to = 0.4, n = 15 }}
"""
FAILED = Answer("raised", "It raised.")


def asked(place):
    """Task and line of each request."""
    return [
        (
            request.function.rpartition(":")[2],
            request.params["line"]["set"]["foot_mass_ratio"],
        )
        for request in place.asked
    ]


def statuses(work):
    """How the tasks of a study ended, by their number."""
    store = work.plan.store
    return collections.Counter(store.outcome(key).status for key in store)


class Told(Listener):
    """Remembers what became of which tasks, and of how many points."""

    def __init__(self):
        self.nodes = collections.Counter()
        self.points = collections.Counter()

    def finished(self, done):
        self.nodes[done.node.task, done.status] += 1

    def dropped(self, node, status):
        self.nodes[node.task, f"not computed: {status}"] += 1
        self.points[status] += node.points


# Nodes of one study


def test_a_task_waits_for_what_it_needs(tmp_path):
    work = work_of(LINES.format("s"))
    atlases = []
    while work.peek():
        atlases.append(work.take())
    assert [node.task for node in atlases] == ["atlas"] * 3 and not work.is_over

    work.record(atlases[1], Answer())

    branch = work.peek()
    assert (branch.task, branch.line) == ("branch", atlases[1].line)
    assert branch.needs == (atlases[1].key,)


def test_what_needs_a_task_that_failed_is_dropped(tmp_path):
    work = work_of(LINES.format("s"))

    run_all([work], Answering(lambda request: FAILED))

    assert work.is_over and not work.error
    assert statuses(work) == {"raised": 3}
    assert not any(key.startswith("branch-") for key in work.plan.store)


def test_points_are_lost_with_what_they_need():
    """Of a long line, whose points are in several chunks."""
    text = LINES.replace('kind = "branch"\n', "").replace(
        "[0.01, 0.02]", "{{ from = 0.001, to = 0.02, n = 40001 }}"
    )
    told, work = Told(), work_of(text.format("s"))
    work.listeners = [told]

    run_all([work], Answering(lambda request: FAILED))

    assert told.points == {"raised": 3 * 40_001}
    assert told.nodes["atlas", "raised"] == 3
    assert told.nodes["points", "not computed: raised"] == 3 * 3


def test_what_has_become_ready_goes_first():
    """Results of a line are seen before those of all lines are there."""
    work = work_of(LINES.format("s"))
    assert work.peek().task == "atlas"
    first = work.take()
    assert work.peek().task == "atlas"

    work.record(first, Answer())

    assert (work.peek().task, work.peek().line) == ("branch", first.line)
    place = Answering(ok, slots=1)
    run_all([work_of(LINES.format("s"))], place)
    assert [name for name, _ in asked(place)] == ["atlas", "branch"] * 3


def test_a_study_is_over_when_nothing_is_taken_either():
    work = work_of(LINES.format("s"))
    nodes = []
    while not work.is_over and work.peek():
        nodes.append(work.take())
    assert not work.is_over
    for node in nodes:
        work.record(node, FAILED)
    assert work.is_over


def test_a_study_that_ends_with_an_error_has_no_other_job():
    work = work_of(LINES.format("s"))
    work.peek()
    node = work.take()

    work.fail(StudyError("The disk is full."))

    assert work.peek() is None and not work.is_over
    work.record(node, Answer())
    assert work.is_over and not work.plan.store


def test_a_store_that_is_full_ends_its_study_and_no_other():
    class Full(Memory):
        def put(self, key, record):
            raise StudyError("The disk is full.")

    one, other = work_of(LINES.format("a"), Full()), work_of(LINES.format("b"))

    run_all([one, other], Answering(ok))

    assert str(one.error) == "The disk is full."
    assert other.error is None and statuses(other) == {"ok": 6}


# Several studies


def test_a_result_that_two_studies_want_is_computed_once():
    works = [work_of(LINES.format(name)) for name in "ab"]
    place = Answering(ok)

    run_all(works, place)

    assert len(asked(place)) == len(set(asked(place))) == 6
    assert [statuses(work) for work in works] == [{"ok": 6}] * 2


def test_what_failed_for_one_study_the_other_tries_itself():
    """Limits of studies differ."""
    works = [work_of(LINES.format(name)) for name in "ab"]
    answers = iter([Answer("timed_out", "It took longer.")])
    place = Answering(lambda request: next(answers, Answer()))

    run_all(works, place)

    assert len(asked(place)) == len(set(asked(place))) + 1 == 7
    found = sorted(sum(statuses(work).values()) for work in works)
    assert found == [5, 6]


def test_a_result_is_kept_for_a_study_that_begins_later():
    """Few studies are open at a time: an atlas that the first has made is not made
    again.
    """
    place, opened = Answering(ok), []
    waiting = [work_of(LINES.format(n)) for n in range(6)]

    def begin():
        opened.append(sum(not work.is_over for work in running.works))
        return waiting.pop() if waiting else None

    running = Loop(place, lambda: None, begin, most_open=2)
    running.run()

    assert len(asked(place)) == len(set(asked(place))) == 6 and max(opened) < 2


def test_the_longest_chain_goes_first():
    """A study of dear lines beside one of cheap ones."""
    cheap = LINES.format("cheap")
    dear = cheap.replace('"branch"', '"basin"').replace("0.01, 0.02", "0.009")
    place = Answering(ok, slots=1)

    run_all([work_of(cheap), work_of(dear)], place)

    names = [name for name, _ in asked(place)]
    assert names == ["atlas", "basin"] * 3 + ["branch"] * 3


# Planes


def _box(low, high):
    return {
        "low": low,
        "high": high,
        "origin": [0.0, 0.0],
        "halved": [0, 0],
        "lines": 128.0,
        "surveyed": 0.0,
    }


LOW, HIGH = _box([0.1, 0.0], [0.4, 5.0]), _box([0.1, 5.0], [0.4, 10.0])
HALVED = serialize.dump(
    {f"halves/{name}": np.array([LOW[name], HIGH[name]]) for name in LOW}
)


def _answer_of_a_plane(request, halves=None):
    """Its charts are two halves, which are `halves`; its points are none."""
    if request.codec:
        n = len(request.params["lines"]) * len(request.params["slope"])
        points = Points.of_ending(n, "raised", "", request.params["want"])
        return Answer(record=request.codec.encode(points))
    if "halved" in request.params["plane"]:
        return halves or Answer(data=serialize.dump({}))
    return Answer(data=HALVED)


@pytest.mark.parametrize("studies", ["a", "ab"])
def test_the_charts_of_a_plane_are_made_once_for_all_that_read_them(studies):
    place = Answering(_answer_of_a_plane)

    run_all([work_of(PLANE.format(name)) for name in studies], place)

    charts = [request for request in place.asked if not request.codec]
    highs = [request.params["plane"]["high"] for request in charts]
    assert sorted(highs) == [LOW["high"], HIGH["high"], HIGH["high"]]
    for request in place.asked:
        if request.codec:
            m_h = [line["set"]["m_h"] for line in request.params["lines"]]
            assert len(request.inputs) == 1 + (min(m_h) <= 5) + (max(m_h) >= 5)


def test_a_half_that_failed_is_not_made_again_and_its_lines_do_without():
    text = PLANE.format("s") + "w_t = [0.0, 0.01]\n"
    place = Answering(lambda request: _answer_of_a_plane(request, FAILED))
    work = work_of(text, retry=True)

    run_all([work], place)

    charts = [request for request in place.asked if not request.codec]
    assert len(charts) == 6 and not work.error
    assert all(len(request.inputs) == 1 for request in place.asked if request.codec)
    assert statuses_of_charts(work) == {"ok": 2, "raised": 4}


def statuses_of_charts(work):
    store = work.plan.store
    keys = (key for key in store if key.startswith("charts-"))
    return collections.Counter(store.outcome(key).status for key in keys)


@pytest.mark.parametrize("has_failed", ["plane", "half"])
def test_charts_that_failed_are_tried_again_with_their_halves(has_failed):
    """What was stored of them before is none of their halves."""
    store, failed = Memory(), Outcome("raised", "It raised.")
    plan = work_of(PLANE.format("s"), store, retry=True).plan
    plane, half, *_ = plan.graph.charts_of(
        plan.graph.grid.chunk(0), lambda node: [] if node.box else [LOW]
    )
    if has_failed == "half":
        store.put_result(plane.key, Outcome("ok", ""), HALVED)
    store.put_result((half if has_failed == "half" else plane).key, failed, b"")
    place = Answering(_answer_of_a_plane)

    run_all([work_of(PLANE.format("s"), store, retry=True)], place)

    charts = [request.params["plane"] for request in place.asked if not request.codec]
    assert [box["high"] for box in charts if "halved" in box].count(LOW["high"]) == 1
    assert len(charts) == (2 if has_failed == "half" else 3)


# Places


REQUEST = Request("os:getpid", {}, [], 1.0, 1)


@contextlib.contextmanager
def guarded(monkeypatch, run, slots=3):
    """Guards whose worker processes are a function."""
    monkeypatch.setattr(worker_process, "run", run)
    with Workers(slots) as place:
        yield place


def test_no_answer_is_lost(monkeypatch):
    """Thousands of them, brought by guards of different haste."""

    def run(request):
        time.sleep(request.seconds)
        return Answer(reason=str(request.memory))

    dice, found = np.random.default_rng(1), {}
    with guarded(monkeypatch, run) as place:
        submitted = {}
        while len(found) < 3000:
            while place.has_room() and len(submitted) < 3000:
                number = len(submitted)
                seconds = float(dice.choice([0.0, 1e-4, 1e-3]))
                request = Request("", {}, [], seconds, number)
                submitted[place.submit(request)] = number
            found.update(place.completed(1.0))
    assert {ticket: int(answer.reason) for ticket, answer in found.items()} == submitted


def test_what_takes_long_is_submitted_when_a_worker_waits(monkeypatch):
    """What becomes ready meanwhile may be more urgent; short jobs wait in a queue."""
    hold = threading.Event()

    def run(request):
        hold.wait()
        return Answer()

    with guarded(monkeypatch, run, 1) as place:
        assert place.has_room(9.0)
        place.submit(Request("", {}, [], 1.0, 1))
        assert place.has_room(0.1) and not place.has_room(9.0)
        hold.set()


def test_nothing_less_urgent_overtakes_what_takes_long():
    """Short jobs of another study filled the place for ever, as one came after another."""
    works = [work_of(LINES.format("s")), work_of(LINES.format("t"))]
    urgent = works[0]
    urgent.seconds, urgent.seconds_of_chain = lambda node: 9.0, lambda node: 99.0
    place = Answering(ok)
    place.has_room = lambda seconds: seconds < LONG
    loop = Loop(place, lambda: None, lambda: works.pop(0) if works else None)
    loop._open_and_close()

    assert loop._submit_most_urgent(place) == 0 and not place.asked


def threads_beyond(number):
    """Threads that are left after some seconds, beyond so many."""
    end = time.monotonic() + 5
    while threading.active_count() > number and time.monotonic() < end:
        time.sleep(0.01)
    return max(0, threading.active_count() - number)


def test_what_a_guard_raises_ends_the_loop(monkeypatch):
    def run(request):
        raise WorkerError("A worker cannot begin its task: OSError.")

    before = threading.active_count()
    monkeypatch.setattr(worker_process, "run", run)
    with pytest.raises(WorkerError, match="cannot begin its task"):
        run_all([work_of(LINES.format("s"))], Engine(2))
    worker_process.close_all()
    assert threads_beyond(before) == 0


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_run_that_is_stopped_waits_for_no_job_and_is_told_in_no_words_of_a_library(
    monkeypatch, recwarn, jobs
):
    """A signal while answers are recorded; workers are killed, and their guards end."""
    ended, before = threading.Event(), threading.active_count()
    monkeypatch.setattr(worker_process, "stop", ended.set)
    monkeypatch.setattr(worker_process, "run", lambda request: ended.wait() and FAILED)
    looks = iter(range(9))

    def check():
        if next(looks) == 3:
            raise StoppedError(15, "Stopped.")

    works = [work_of(LINES.format("s"))]
    with pytest.raises(StoppedError):
        Loop(Engine(jobs), check, lambda: works.pop() if works else None).run()

    assert threads_beyond(before) == 0 and not recwarn.list


def test_a_place_in_this_process_answers_what_a_task_raises():
    place = Inline()
    ticket = place.submit(Request("json:loads", {}, [], 1.0, 1))
    assert not place.has_room()

    ((answered, answer),) = place.completed(0.0)

    assert answered == ticket and answer.status == "raised"
    assert answer.reason.startswith("It raised TypeError: ") and place.has_room()


def test_only_requests_that_share_all_but_their_lines_are_computed_together(
    monkeypatch,
):
    slope = np.linspace(0.01, 0.02, 2000)  # of which a printed array shows the ends
    other = np.where(np.arange(2000) == 1000, 0.0, slope)

    def beside(params, inputs):
        return [({"lines": len(params["lines"])}, {}) for _ in params["lines"]]

    functions = {"alone": lambda params, inputs: {"lines": 1}, "beside": beside}
    monkeypatch.setattr(dispatch, "resolve", functions.get)
    place = Inline(room=3)
    for values in (slope, other, slope):
        params = {"line": {}, "values": values}
        place.submit(Request("alone", params, [], 1.0, 1, together="beside"))

    answers = dict(place.completed(0.0))

    lines = [serialize.load(answers[ticket].data)["lines"] for ticket in range(3)]
    assert lines == [2, 1, 2]


def test_a_guard_keeps_its_worker_process_while_it_lives(tmp_path, monkeypatch):
    (tmp_path / "who.py").write_text(
        "import os\ndef am_i(params, inputs): return {'pid': os.getpid()}\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    request = Request("who:am_i", {}, [], 60.0, 1 << 30)

    def pid():
        return serialize.load(worker_process.run(request).data)["pid"]

    first, second = pid(), pid()
    worker_process.close_all()
    assert first == second != pid()
    worker_process.close_all()
