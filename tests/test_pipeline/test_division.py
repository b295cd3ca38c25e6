"""A chunk that fails is divided, down to the line or the point responsible."""

import numpy as np
import pytest

from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.request import Request
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.store.record import ChunkCodec

#: Lines of which some cannot be computed; each call notes how many it was asked for.
TASKS = """
import numpy as np
from pathlib import Path

def lines(params, inputs):
    numbers = [line["number"] for line in params["lines"]]
    with open(Path(__file__).with_name("asked"), "a") as file:
        print(len(numbers), file=file)
    if {{*numbers}} & {trouble}:
        raise ValueError("trouble")
    return [({{}}, solved(len(params["slope"]))) for _ in numbers]

def atlas(params, inputs):
    return {{}}

def points(params, inputs):
    raise ValueError("trouble")

def solved(n):
    status = np.zeros((n, 4), np.int8)
    period = np.ones(status.shape)
    return {{"status": status, "reason": status, "reasons": [""], "period": period}}
"""


@pytest.fixture
def divided(tmp_path, monkeypatch):
    """Computes lines of two slopes of which some fail: the points, the atlases, and how
    many lines were asked for at a time.
    """
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def divided(n, trouble):
        (tmp_path / "lines_in_trouble.py").write_text(
            TASKS.format(trouble=trouble or "set()")
        )
        functions = (f"lines_in_trouble:{name}" for name in ("atlas", "points"))
        params = {
            "lines": [{"number": k} for k in range(n)],
            "slope": np.array([0.01, 0.02]),
            "want": ["period"],
            "gaits": ["long"],
            "atlases": True,
        }
        request = Request(
            "lines_in_trouble:lines",
            params,
            [],
            60.0,
            1 << 30,
            codec=ChunkCodec(Shape((n, 2), (n, 2), 1), 3, ["long"]),
            alone=tuple(functions),
        )
        answer = worker_process.run(request)
        asked = list(map(int, (tmp_path / "asked").read_text().split()))
        return ChunkCodec.decode(answer.record), answer.atlases, asked

    yield divided
    worker_process.close_all()


@pytest.mark.parametrize("trouble", [{3, 7}, set(), set(range(20))])
def test_lines_that_fail_are_divided_until_the_bad_ones_are_alone(divided, trouble):
    points, atlases, asked = divided(20, trouble)

    failed = points.values["status"][:, 0].reshape(20, 2) != 0
    assert set(np.flatnonzero(failed.any(axis=1)).tolist()) == trouble
    assert [atlas.place for atlas in atlases] == list(range(20))
    assert asked[0] == 20 and sum(asked[1:]) <= (40 if trouble else 0)


def test_lines_of_which_one_fails_are_not_all_computed_one_by_one(divided):
    points, _, asked = divided(64, {40})

    assert np.flatnonzero(points.values["status"][:, 0]).tolist() == [80, 81]
    assert sorted(asked) == [1] * 4 + [4] * 16 + [64]
