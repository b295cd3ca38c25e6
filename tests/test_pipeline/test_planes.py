"""Studies over a plane of keys: divided into cells, each computed as a whole, whatever
runs them.
"""

import contextlib
import json
import math
import os
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import xarray as xr

import gaitsweep
from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.api import in_memory
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine import worker_process
from gaitsweep.pipeline.engine.request import Answer, Request
from gaitsweep.pipeline.engine.runner import _check_room
from gaitsweep.pipeline.engine.work import Work
from gaitsweep.pipeline.errors import DiskFullError
from gaitsweep.pipeline.graph.graph import Graph, Node, boxes
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid.choose_method import seconds_over_plane
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.store.file import CorruptStoreError
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.store.memory import Memory
from gaitsweep.pipeline.store.record import ChunkCodec
from gaitsweep.pipeline.store.store import Outcome
from gaitsweep.pipeline.study.model import about
from gaitsweep.pipeline.study.parse import parse, read
from gaitsweep.tasks.studies import solve_planes, solve_points

STUDY = """
name = "plane"
walker = "{walker}"
[axes]
slope = [0.008, 0.01]
{axes}
[want]
variables = ["stance_angle", "period", "loss_normal"]
"""
BOTH = ["long", "short"]
AXES = "R = { from = 0.0, to = 0.2, n = 18 }\nm_s = { from = 0.08, to = 0.12, n = 16 }"


def written(folder, text):
    folder.mkdir(exist_ok=True)
    path = folder / "plane.toml"
    path.write_text(text)
    return path


def run(folder, text, **options):
    archive = folder / "plane.nc"
    gaitsweep.run(written(folder, text), archive=archive, quiet=True, **options)
    return archive


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    return run(
        tmp_path_factory.mktemp("one"), STUDY.format(walker="B", axes=AXES), jobs=1
    )


def test_the_lines_of_a_chunk_know_their_charts(tmp_path):
    """Those of each value of a third key, and of each walker, have their own."""
    axes = AXES + "\nw_t = [0.0, 0.01]"
    study = read(
        written(
            tmp_path, STUDY.format(walker="B", axes=axes).replace('"B"', '["B", "E"]')
        )
    )
    assert study.plane.lines == 288 and study.lines == 4 * 288
    graph = Graph(study)
    chunks = [graph.grid.chunk(k) for k in range(graph.grid.chunks)]
    assert sorted(np.concatenate([chunk.numbers for chunk in chunks])) == list(
        range(4 * 288)
    )
    charts = {}
    for chunk in chunks:
        node = graph.chunk_node(chunk)
        params, (line, *_) = graph.params(node), graph.params(node)["lines"]
        (charted,) = graph.charts_of(chunk, lambda _: [])
        made = graph.params(charted)
        assert made["plane"]["keys"] == params["plane"]["keys"] == [
            "R",
            "m_s",
        ] and params["plane"]["high"] == [
            0.2,
            0.12,
        ]
        assert made["line"] == {
            "walker": line["walker"],
            "set": {"w_t": line["set"]["w_t"]},
        }
        assert {(one["walker"], one["set"]["w_t"]) for one in params["lines"]} == {
            (line["walker"], line["set"]["w_t"])
        }
        charts[charted.key] = line["walker"], line["set"]["w_t"]
    assert sorted(charts.values()) == [
        ("B", 0.0),
        ("B", 0.01),
        ("E", 0.0),
        ("E", 0.01),
    ]


def forget(monkeypatch):
    memories = {is_compact: Memory(1 << 30) for is_compact in (True, False)}
    monkeypatch.setattr(in_memory, "_REMEMBERED", memories)


def test_charts_are_made_once_and_kept(tmp_path):
    """For all chunks, for another study of the same plane, and if the points are lost."""
    made = []

    def run_and_count(text):
        run(tmp_path, text, jobs=1)
        with contextlib.closing(
            Journal(Companions(tmp_path / "plane.nc").journal, write=False)
        ) as store:
            made.append(
                sorted(store.number(key) for key in store if key.startswith("charts-"))
            )

    text = STUDY.format(walker="B", axes=AXES)
    run_and_count(text)
    run_and_count(text.replace('"loss_normal"', '"speed"'))
    assert len(made[0]) == 1 and made[1] == made[0]


def test_points_without_charts_are_solved_line_by_line(tmp_path):
    text = STUDY.format(walker="B", axes="m_s = { from = 0.08, to = 0.12, n = 40 }")
    graph = Graph(read(written(tmp_path, text)))
    assert graph.method is Method.PLANE
    companions = Companions(tmp_path / "plane.nc")
    companions.make_folder()
    with contextlib.closing(Journal(companions.journal)) as store:
        store.put_result(
            graph.line_keys(0)["charts"], Outcome("raised", "It raised."), b""
        )
    archive = run(tmp_path, text, jobs=1)
    assert (gaitsweep.load(archive).status.sel(gait=BOTH) == "converged").all()
    # Told once, not by each of the lines that share them.
    failed = xr.load_dataset(archive, group="failed_tasks")
    assert failed.task.values.tolist() == [
        "charts"
    ] and failed.reason.values.tolist() == ["It raised."]


def test_the_key_of_a_chunk_tells_its_plane_and_slopes(tmp_path):
    """Its charts depend on the sides of the plane and about how many lines it has; a
    line has all its slopes.
    """
    assert [about(n) for n in (1, 181, 182, 362, 363)] == [1, 128, 256, 256, 512]
    spread = AXES.replace("n = 16", 'n = 16, spacing = "log"')
    planes = {
        "one": (STUDY, AXES),
        "other sides": (STUDY, AXES.replace("to = 0.2", "to = 0.22")),
        "other lines": (STUDY, AXES.replace("n = 18", "n = 35")),
        "fewer slopes": (STUDY.replace("[0.008, 0.01]", "[0.01]"), AXES),
        "spread": (STUDY, spread),
    }
    keys = set()
    for name, (text, axes) in planes.items():
        study = read(written(tmp_path / name, text.format(walker="B", axes=axes)))
        graph = Graph(study)
        assert graph.method is Method.PLANE
        keys.add(graph.chunk_key(graph.grid.chunk(0)))
    assert len(keys) == len(planes)


@pytest.mark.parametrize(
    ("m_h", "R", "slopes", "lines"),
    [
        (40, 20, 12, 64),
        (20, 15, 1, 300),
        (100, 100, 1, 25**2),
        (1000, 1000, 1, 2048),
        (60, 20, 100, 20),
    ],
)
def test_a_plane_has_chunks_enough_for_its_workers_and_its_first_charts(
    m_h, R, slopes, lines
):
    """As many lines as fill registers, and points as pay for a job; no more than take an
    eighth of a second.
    """
    axes = {
        "slope": np.linspace(0.01, 0.02, slopes).tolist(),
        "m_h": np.linspace(0, 5, m_h).tolist(),
    }
    study = parse(
        {
            "name": "plane",
            "walker": "A",
            "axes": {**axes, "R": np.linspace(0.1, 0.3, R).tolist()},
        },
        "",
        Path(),
    )
    grid = Graph(study).grid
    each = [len(grid.chunk(k).numbers) for k in range(grid.chunks)]
    assert sum(each) == m_h * R and max(each) == pytest.approx(lines, rel=0.07)


def test_a_grid_with_a_few_other_lines_keeps_its_charts(tmp_path):
    archive = run(tmp_path, STUDY.format(walker="B", axes=AXES), jobs=1)
    journal = Companions(archive).journal
    refined = STUDY.format(walker="B", axes=AXES.replace("n = 18", "n = 21"))
    todo = summary(
        Plan(read(written(tmp_path, refined)), Journal(journal, write=False))
    ).todo
    assert not todo["charts"] and todo["points"] == {"new": 2 * 16 * 21}


@pytest.mark.parametrize(
    "axes",
    ["R = { from = 0.0, to = 0.2, n = 11 }\nm_s = { from = 0.08, to = 0.12, n = 9 }"],
)
def test_few_lines_are_no_plane(tmp_path, axes):
    assert read(written(tmp_path, STUDY.format(walker="B", axes=axes))).plane is None


HALVED = """
name = "plane"
walker = "A"
[axes]
slope = [0.03, 0.04, 0.05]
detuning = { from = -0.05, to = 0.5, n = 200 }
[want]
variables = ["stance_angle", "period"]
"""


def test_the_halves_of_a_plane_are_jobs_of_their_own(tmp_path):
    """A is tuned within: its plane is halved there without a survey, and a chunk waits
    for the boxes that it meets.
    """
    archive = run(tmp_path, HALVED, jobs=2)
    events = [
        json.loads(line) for line in Companions(archive).events.read_text().splitlines()
    ]
    charted = [event["charted"] for event in events if event.get("task") == "charts"]
    assert charted[0] == 0 and len(charted) == 2 * charted.count(0) + 1
    state = next(event for event in reversed(events) if event["event"] == "state")
    stage = state["stages"]["charts"]
    assert stage["done"] == stage["todo"] == sum(charted) == 200 and stage["eta"] == 0
    with contextlib.closing(Journal(Companions(archive).journal)) as store:
        graph = Graph(read(tmp_path / "plane.toml"))
        needed = [
            [
                node.key
                for node in graph.charts_of(
                    graph.grid.chunk(k), partial(halves_in, store)
                )
            ]
            for k in range(graph.grid.chunks)
        ]
        assert set().union(*needed) == {
            key for key in store if key.startswith("charts-")
        }
    assert (
        min(map(len, needed)) < len(charted) and len({keys[0] for keys in needed}) == 1
    )
    # In memory they are made one after the other.
    with xr.open_dataset(archive) as stored:
        found = gaitsweep.gaits(
            "A",
            slope=stored.slope,
            detuning=stored.detuning,
            variables=["stance_angle", "period"],
        )
        for name in ("stance_angle", "period", "status"):
            own = found[name].sel(gait=stored.gait).transpose(*stored[name].dims)
            np.testing.assert_array_equal(own, stored[name])


def test_a_plan_knows_which_halves_of_a_plane_are_missing(tmp_path):
    """Those of a run that was interrupted, and of them only what chunks that are
    missing need.
    """
    text = HALVED.replace("-0.05", "0.0").replace("n = 200", "n = 201")
    low, high = {"low": [0.0], "high": [0.25]}, {"low": [0.25], "high": [0.5]}
    graph, parts = Graph(read(written(tmp_path, text))), dict[str, Node]()
    for chunk in map(graph.grid.chunk, range(graph.grid.chunks)):
        for node in graph.charts_of(
            chunk, lambda node: [] if node.box else [low, high]
        ):
            parts[
                "plane"
                if node.box is None
                else "low"
                if node.box["low"] == [0.0]
                else "high"
            ] = node
    plane, first, second = (parts[name] for name in ("plane", "low", "high"))
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        halved = {f"halves/{name}": np.array([low[name], high[name]]) for name in low}
        store.put_result(plane.key, Outcome("ok", ""), serialize.dump(halved))
        store.put_result(first.key, Outcome("ok", ""), serialize.dump({}))
        plan = Plan(graph.study, store)
        counts, charts = (
            summary(plan),
            [node for node in plan.nodes() if node.task == "charts"],
        )
    assert [node.key for node in charts] == [second.key] and graph.charted(
        first
    ) + 1 == graph.charted(second) == 101
    assert counts.todo["charts"] == {"new": 101} and counts.cached["charts"] == 100


def test_charts_that_were_never_packed_are_damage(tmp_path):
    """Whatever their checksum: the run repairs its journal."""
    graph = Graph(read(written(tmp_path, HALVED)))
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        charts = graph.node("charts", 0)
        store.put_result(charts.key, Outcome("ok", ""), b"\xff" * 20)
        with pytest.raises(CorruptStoreError):
            Plan(graph.study, store).boxes(charts, "halves")


def test_damage_met_when_a_result_is_copied_ends_that_study_alone(tmp_path):
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        work = Work(Plan(read(written(tmp_path, HALVED)), store))
        assert work.peek().task == "charts"
        work.copy(work.take(), Answer(data=b"\xff" * 20))
        assert isinstance(work.error, CorruptStoreError) and work.is_over


def halves_in(store, node):
    return boxes(store.result(node.key), "halves")


def test_gaits_of_several_steps_have_no_charts(tmp_path):
    text = STUDY.format(walker="B", axes=AXES).replace(', "loss_normal"', "")
    assert max(seconds_over_plane(read(written(tmp_path, text)))) < math.inf
    assert seconds_over_plane(
        read(written(tmp_path, text + "[options]\nsteps = 2\n"))
    ) == (math.inf, math.inf)


def test_a_plane_that_no_disk_holds_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("gaitsweep.pipeline.engine.runner._MIN_BYTES", 10**12)
    with pytest.raises(
        DiskFullError,
        match=r"^576 points need 5,184,000.0 GB at least; in \S+ [\d,.]+ are free\.$",
    ):
        run(tmp_path, STUDY.format(walker="B", axes=AXES))
    assert not (tmp_path / "plane.nc").exists()


def test_what_the_disk_can_hold_is_not_refused(tmp_path, monkeypatch):
    """Of a coarse sweep 8,157,867 bytes were measured, of which its slopes take 8e6;
    windows have no points.
    """
    monkeypatch.setattr(
        "gaitsweep.pipeline.engine.runner.shutil.disk_usage",
        lambda path: SimpleNamespace(free=8_200_000),
    )
    million = 'name = "s"\nwalker = "D"\ngaits = ["long"]\n[axes]\nslope = { from = 0.001, to = 0.01, n = 1000000 }\n'
    branches = (
        'kind = "branch"\n' + million + "R = { from = 0.0, to = 0.1, n = 1000 }\n"
    )
    for text in (
        "accuracy = 1e-2\n" + million + '[want]\nvariables = ["period"]\n',
        branches,
    ):
        _check_room(read(written(tmp_path, text)), tmp_path / "s.nc")
    with pytest.raises(DiskFullError, match="^1,000,000,000 points need"):
        _check_room(
            read(written(tmp_path, branches.replace("branch", "grid"))),
            tmp_path / "s.nc",
        )


def test_two_workers_write_the_same_bytes(archive, tmp_path):
    other = run(tmp_path, STUDY.format(walker="B", axes=AXES), jobs=2)
    assert other.read_bytes() == archive.read_bytes()


#: In place of a plane's task: more than a hundred points kill the worker, more than one
#: of some lines raise an error.
DEADLY = """
import os, signal
from gaitsweep.tasks.studies import solve_planes

def lines(params, inputs):
    points = len(params["lines"]) * len(params["slope"])
    if points > 100:
        os.kill(os.getpid(), signal.SIGKILL)
    if points > 1 and params["lines"][0]["set"]["detuning"] < 0.22:
        raise ValueError("too many points")
    return solve_planes.lines(params, inputs)
"""


@pytest.fixture(scope="module")
def whole_chunk(tmp_path_factory):
    """The request of a chunk of a plane, and its record."""
    text = STUDY.format(walker="A", axes="detuning = { from = 0.2, to = 0.4, n = 40 }")
    text = text.replace("[0.008, 0.01]", "{ from = 0.001, to = 0.05, n = 9 }").replace(
        "loss_normal", "multipliers"
    )
    study = read(written(tmp_path_factory.mktemp("whole"), text))
    graph = Graph(study)
    node = graph.chunk_node(graph.grid.chunk(0))
    (charted,) = graph.charts_of(node.chunk, lambda _: [])
    asked = graph.params(charted)
    charts = solve_planes.charts(
        {**asked, "plane": {**asked["plane"], "lines": 100}}, []
    )
    assert not len(charts["alone/low"])

    codec = ChunkCodec(node.chunk.shape, graph.grid.multipliers, study.gaits)
    data = [serialize.dump(charts)]
    request = Request(
        graph.function(node), graph.params(node), data, 60.0, 2 << 30, codec=codec
    )
    answer = worker_process.run(request)
    yield request, answer.record
    worker_process.close_all()


@pytest.mark.parametrize("most", [7, 30, 150])
def test_a_plane_that_is_divided_keeps_its_charts_and_its_bits(whole_chunk, most):
    request, whole = whole_chunk

    answer = worker_process.run(replace(request, most=most))

    assert answer.record == whole


def test_a_plane_whose_parts_die_twice_keeps_its_charts_and_its_bits(
    whole_chunk, tmp_path, monkeypatch
):
    request, whole = whole_chunk
    (tmp_path / "deadly.py").write_text(DEADLY)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    worker_process.close_all()

    answer = worker_process.run(replace(request, function="deadly:lines"))

    assert answer.record == whole


def test_a_plane_holds_what_its_lines_hold(archive):
    plane = gaitsweep.load(archive)
    for i, k in ((0, 0), (5, 3), (6, 15), (17, 5)):
        one = gaitsweep.gaits(
            "B", plane.slope.values, R=float(plane.R[i]), m_s=float(plane.m_s[k])
        ).sel(gait=BOTH)
        other = plane.isel(R=i, m_s=k).sel(gait=BOTH)
        for name in ("stance_angle", "period"):
            bound = other.error_bound.values + one.error_bound.values
            assert (np.abs(other[name].values / one[name].values - 1) <= bound).all()
        assert other.loss_normal.values == pytest.approx(
            one.loss_normal.values, rel=1e-11
        )
    assert (plane.status.sel(gait=BOTH) == "converged").all()


def test_arrays_over_a_plane_give_what_a_study_over_it_gives(archive, monkeypatch):
    """Through the same cells, in whatever order the values come, and beside a slope
    that cannot be.
    """
    monkeypatch.setattr(solve_points, "atlas", None)  # no line is surveyed by itself
    monkeypatch.setattr(solve_points, "lines", None)
    plane = xr.load_dataset(archive).transpose("R", "m_s", "slope", ...)
    R, m_s = plane.R.values[::-1, None, None], plane.m_s.values[:, None]
    answer = gaitsweep.gaits(
        "B",
        [0.01, 0.7, 0.008],
        R=R,
        m_s=m_s,
        variables=["stance_angle", "period", "loss_normal"],
    )
    assert (answer.status.values[:, :, 1] == ALL_STATUSES["raised"]).all()
    answer = answer.isel(
        dim_0=slice(None, None, -1), slope=[2, 0], gait=slice(plane.sizes["gait"])
    )
    for name in (
        "stance_angle",
        "period",
        "loss_normal",
        "error_bound",
        "status",
        "branch",
        "piece",
    ):
        np.testing.assert_array_equal(answer[name].values, plane[name].values)
    words = (data.reason_text.values[data.reason.values] for data in (answer, plane))
    np.testing.assert_array_equal(*words)


def test_charts_are_made_once_for_all_that_is_asked_of_a_plane(monkeypatch):
    forget(monkeypatch)
    made = Mock(side_effect=solve_planes.charts)
    monkeypatch.setattr(solve_planes, "charts", made)
    m_s, slopes = np.linspace(0.08, 0.12, 64)[:, None], np.array([0.008, 0.009, 0.01])
    first = gaitsweep.gaits("B", slopes, m_s=m_s, variables=["period"])
    assert made.call_count == 1
    more = gaitsweep.gaits("B", slopes, m_s=m_s, variables=["period", "speed"])
    assert made.call_count == 1
    np.testing.assert_array_equal(more.period.values, first.period.values)


def test_a_half_of_a_plane_that_fails_leaves_the_other_its_charts(monkeypatch):
    forget(monkeypatch)
    charts, lines, given = solve_planes.charts, solve_planes.lines, []
    low, high = {"low": [0.08], "high": [0.1]}, {"low": [0.1], "high": [0.12]}

    def halved(params, inputs):
        if params["plane"]["high"] == [0.1]:
            raise FloatingPointError
        is_whole = params["plane"]["low"] == [0.08]
        return (
            {f"halves/{name}": np.array([low[name], high[name]]) for name in low}
            if is_whole
            else charts(params, [])
        )

    monkeypatch.setattr(solve_planes, "charts", halved)
    monkeypatch.setattr(
        solve_planes,
        "lines",
        lambda params, inputs: given.append(inputs) or lines(params, inputs),
    )
    answer = gaitsweep.gaits(
        "B",
        [0.008, 0.009],
        m_s=np.linspace(0.08, 0.12, 64)[:, None],
        variables=["period"],
    )
    assert (answer.status.sel(gait=BOTH) == 0).all()
    (of_chunk,) = given
    assert [("halves/low" in charts) for charts in of_chunk] == [True, False]


def test_arrays_that_are_no_plane_are_solved_line_by_line(monkeypatch):
    monkeypatch.setattr("gaitsweep.tasks.studies.solve_planes.lines", None)
    m_s = np.linspace(0.08, 0.12, 70)
    R = np.where(np.arange(70) < 69, 0.1, 0.2)
    assert (
        gaitsweep.gaits("B", 0.01, R=R, m_s=m_s, variables=["period"]).status.sel(
            gait=BOTH
        )
        == 0
    ).all()


def test_lines_of_a_plane_that_fail_together_are_solved_one_by_one(monkeypatch):
    """As in a run."""
    lines = solve_planes.lines

    def fail(params, inputs):
        if len(params["lines"]) > 1:
            raise FloatingPointError
        return lines(params, inputs)

    forget(monkeypatch)
    monkeypatch.setattr(solve_planes, "lines", fail)
    answer = gaitsweep.gaits(
        "B", 0.01, m_s=np.linspace(0.08, 0.12, 64), variables=["period"]
    )
    assert (answer.status.sel(gait=BOTH) == 0).all()
