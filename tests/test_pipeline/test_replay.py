"""How many workers one parent can feed: results of 64 workers, recorded once, replayed
as fast as it takes them.
"""

import contextlib
import os
import pickle
import time

import pytest

from gaitsweep.pipeline.archive import write
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.executors import Engine
from gaitsweep.pipeline.engine.jobs import Jobs
from gaitsweep.pipeline.engine.scheduler import Scheduler
from gaitsweep.pipeline.engine.signals import Signals
from gaitsweep.pipeline.graph.plan import Plan
from gaitsweep.pipeline.store.file import forget
from gaitsweep.pipeline.store.store import Store
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


class Recording(Engine):
    """64 workers, one after the other in one process; keeps their results."""

    results = None

    @contextlib.contextmanager
    def parallel(self):
        self.results = {} if self.results is None else self.results

        def parallel(is_there, take):
            while is_there() and (taken := take()):
                number, request = taken
                place = [
                    request.params.get(name) for name in ("line", "lines", "slope")
                ]
                key = request.function, pickle.dumps(place)  # as joblib sends it
                if key not in self.results:
                    self.results[key] = worker_process.run(0, request)[1]
                yield number, self.results[key]

        yield parallel


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
        engine, spent = Recording(64), []
        for run in range(4):
            with contextlib.closing(Store(tmp_path / f"{run}")) as store:
                jobs = Jobs(Plan(study, store), engine, lambda *_: None)
                clock = time.process_time()
                Scheduler([jobs], engine, Signals()).run()
                recorded = time.process_time()
                write.write(jobs.plan, tmp_path / f"{run}.nc")
                spent.append((recorded - clock, time.process_time() - recorded))
            bytes_a_point = (tmp_path / f"{run}").stat().st_size / study.points
            forget(tmp_path / f"{run}")
        worker_process.close_all()
        assert len({(tmp_path / f"{run}.nc").read_bytes() for run in range(4)}) == 1
        worker = sum(result["cpu"] for result in engine.results.values())
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
