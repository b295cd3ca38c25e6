"""How many workers one parent can feed: results of 64 workers, recorded once, replayed
as fast as it takes them.
"""

import contextlib
import os
import pickle
import time

import pytest

from answering import Answering
from gaitsweep.pipeline.archive import write
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.loop import run_all
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.store.file import forget
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study import parse

#: Walker, axes and the least number of workers.
STUDIES = {
    "a long line": ("D", "slope = { from = 1e-4, to = 0.02, n = 1000000 }", 16),
    "lines of a point": (
        "E",
        "slope = [0.01]\nR = { from = 0.0, to = 0.2, n = 4096 }",
        25,
    ),
    "lines of 20 points": (
        "E",
        "slope = { from = 1e-3, to = 0.02, n = 20 }\nR = { from = 0.0, to = 0.2, n = 1024 }",
        25,
    ),
}


class Recording:
    """A worker whose answers are kept, and given again."""

    def __init__(self):
        self.answers = {}

    def __call__(self, request):
        place = [request.params.get(name) for name in ("line", "lines", "slope")]
        key = request.function, pickle.dumps(place)
        if key not in self.answers:
            self.answers[key] = worker_process.run(request)
        return self.answers[key]


@pytest.mark.soak
@pytest.mark.parametrize("name", STUDIES)
def test_one_parent_feeds_many_workers(tmp_path, tell, monkeypatch, name):
    walker, axes, least = STUDIES[name]
    monkeypatch.setenv("PYTHONPATH", os.getcwd())
    (tmp_path / "s.toml").write_text(
        f'name = "s"\nwalker = "{walker}"\n[axes]\n{axes}\n[want]\nvariables = ["stance_angle", "period"]\n'
    )
    study, served = parse.read(tmp_path / "s.toml"), []
    for _ in range(3):
        workers, spent = Recording(), []
        for run in range(4):
            with contextlib.closing(Journal(tmp_path / f"{run}")) as store:
                work = Work(Plan(study, store))
                clock = time.process_time()
                run_all([work], Answering(workers, 64))
                recorded = time.process_time()
                write.write(work.plan, tmp_path / f"{run}.nc")
                spent.append((recorded - clock, time.process_time() - recorded))
            bytes_a_point = (tmp_path / f"{run}").stat().st_size / study.points
            forget(tmp_path / f"{run}")
        worker_process.close_all()
        assert len({(tmp_path / f"{run}.nc").read_bytes() for run in range(4)}) == 1
        worker = sum(answer.cpu for answer in workers.answers.values())
        replay = sorted(spent[1:], key=sum)[1]  # the first run computes
        served.append(
            (
                worker / sum(replay),
                *(1e6 * seconds / study.points for seconds in (worker, *replay)),
            )
        )
    # Processors change their speed: replays are compared with the workers just before
    # them, and medians count.
    workers, worker, journal, archive = sorted(served)[1]
    tell(
        f"{name}: {journal:.2f} µs a point for the journal, {archive:.2f} for the archive, {worker:.0f} in a worker:"
        f" one parent feeds {workers:.0f} workers; {bytes_a_point:.0f} byte a point in the journal"
    )
    assert workers > least
