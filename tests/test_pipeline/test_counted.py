"""Work that is counted: nothing is computed that a study does not want, and no more
than it takes.
"""

import itertools
from pathlib import Path

import numpy as np
import pytest

from benchmarks.counted import STUDIES, work
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.runner import Options, run
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.grid.method import variables
from gaitsweep.pipeline.study.parse import read
from gaitsweep.tasks.contract.registry import ALWAYS
from gaitsweep.tasks.studies.solve_points import atlas


@pytest.fixture(scope="module", params=["D", "B"])
def counts(request):
    found = atlas({"line": {"walker": request.param, "set": {}}}, [])
    slopes = np.geomspace(1e-3, 0.1, 300)
    return {
        name: work(request.param, found, slopes, want, gaits)
        for name, want, gaits in STUDIES
    }


def test_a_gait_takes_one_newton_step_and_leaves_few_lanes_idle(counts):
    for name, of in counts.items():
        assert of["gaits"] == (300 if "long" in name else 600)
        # One stride is one Newton step; the polynomials of the atlas leave no more to
        # do.
        assert (
            of["strides"] - of["event checks"] - of["strides for violations"]
            <= 1.02 * of["gaits"]
        )
        assert of["event checks"] <= 0.1 * of["gaits"]
        # A call fills its last groups of lanes: there are as many calls as branches,
        # and those for what is in doubt.
        assert of["idle lanes"] < 0.2 * of["gaits"]
        assert of["more digits"] == 0


def test_what_is_not_wanted_is_not_computed(counts):
    rows = list(counts.values())
    for key in ("strides", "eigenvalue problems", "strides for violations", "bytes"):
        assert all(more[key] >= less[key] for more, less in itertools.pairwise(rows)), (
            key
        )
    everything, most, multipliers, angle, long = rows
    assert (
        everything["strides for violations"] == 600
        and most["strides for violations"] == 0
    )
    assert (
        multipliers["eigenvalue problems"] == 600 and angle["eigenvalue problems"] == 0
    )
    assert long["strides"] < 0.6 * angle["strides"]
    assert angle["bytes"] < 0.3 * most["bytes"] < 0.3 * everything["bytes"]


STUDY = """name = "one"
walker = "E"
[axes]
slope = { from = 0.01, to = 0.02, n = 4 }
[want]
variables = ["stance_angle"]
figures = ["loglog"]
"""


def test_one_figure_asks_for_its_inputs_alone(tmp_path):
    (tmp_path / "one.toml").write_text(STUDY)
    study = read(tmp_path / "one.toml")
    assert set(Graph(study).layers) == {"atlas", "points"}
    start = {
        "stance_angle",
        "stance_rate",
        "thigh_rate",
        "shank_rate",
    }  # with which a page lets a gait walk
    assert set(variables(study)) == {*start, "spectral_radius", *ALWAYS}


def test_a_cached_rerun_starts_no_worker_and_so_integrates_nothing(
    tmp_path, monkeypatch
):
    # Workers find the packages where this process does.
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    (tmp_path / "one.toml").write_text(STUDY)
    study, archive = read(tmp_path / "one.toml"), tmp_path / "one.nc"
    assert [
        end.code for end in run([(study, archive)], Options(jobs=1, quiet=True))
    ] == [0]
    before = archive.read_bytes()

    def refuse(*_):
        raise AssertionError("a worker was started")

    monkeypatch.setattr(worker_process.WorkerProcess, "__init__", refuse)
    assert [
        end.code for end in run([(study, archive)], Options(jobs=1, quiet=True))
    ] == [0]
    assert archive.read_bytes() == before
    # One more slope wants a worker again: the guard above does guard.
    (tmp_path / "one.toml").write_text(STUDY.replace("n = 4", "n = 5"))
    with pytest.raises(Exception, match="a worker was started"):
        run([(read(tmp_path / "one.toml"), archive)], Options(jobs=1, quiet=True))
