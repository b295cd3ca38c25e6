"""The graph is plain data, culled to what is wanted, and its keys name science alone."""

import contextlib
import dataclasses
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from gaitsweep.pipeline import serialize
from gaitsweep.pipeline.archive import write
from gaitsweep.pipeline.errors import StoppedError
from gaitsweep.pipeline.graph import reads
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.keys import task_key
from gaitsweep.pipeline.graph.layers import point_params
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.grid.costs import of_point
from gaitsweep.pipeline.grid.method import variables
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.store.points import Points
from gaitsweep.pipeline.store.record import Record
from gaitsweep.pipeline.store.store import Outcome
from gaitsweep.pipeline.study import parse
from gaitsweep.pipeline.study.model import Lines
from gaitsweep.tasks.contract import registry

ROOT = Path(__file__).parents[2]


@pytest.fixture
def make():
    def make(slope=(0.01, 0.02), **changes):
        table = {
            "name": "s",
            "walker": "E",
            "axes": {"slope": list(slope), "foot_mass_ratio": [0.1, 0.05]},
            **changes,
        }
        return parse.parse(table, "", Path("s.toml"))

    return make


def test_nothing_that_is_not_wanted_is_in_the_graph(make):
    found = make(want={"variables": ["period"]})
    assert list(Graph(found).layers) == ["atlas", "points"]
    assert variables(found) == ("period", *registry.ALWAYS)
    found = make(want={"variables": ["period"], "fits": ["transition"]})
    assert list(Graph(found).layers) == ["atlas", "points", "transition"]
    assert "stance_angle" in variables(found) and "multiplier_real" not in variables(
        found
    )


@pytest.mark.parametrize("kind", ["grid", "branch"])
def test_a_signal_ends_a_plan_between_chunks_and_lines_and_an_archive(
    make, tmp_path, kind
):
    """A million chunks take a minute."""
    study = make(slope=np.linspace(0.001, 0.02, 40_001), kind=kind)
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        plan = Plan(study, store, check=Mock())
        nodes = [node for node in plan.nodes() if node.task != "atlas"]
        assert plan.check.call_count >= len(nodes) >= 2
        plan.check.side_effect = StoppedError(15, "Stopped.")
        with pytest.raises(StoppedError):
            next(plan.nodes())
        if kind == "grid":
            with pytest.raises(StoppedError):
                write.write(plan, tmp_path / "s.nc")
    assert [file.name for file in tmp_path.iterdir()] == ["j"]


def test_a_chunk_that_is_packed_in_another_way_has_another_key(make):
    """The last chunk of a line is as large as the others, padded; that of its slopes
    alone is smaller.
    """
    slopes = np.linspace(0.001, 0.02, 40_001)
    whole = Graph(make(slope=slopes))
    last = whole.grid.chunk(whole.grid.chunks - 1)
    assert last.shape.sizes < last.shape.extent
    alone = Graph(make(slope=slopes[last.slopes]))
    key, other = (
        whole.chunk_node(last).key,
        alone.chunk_node(alone.grid.chunk(alone.grid.chunks - 1)).key,
    )
    assert key != other
    # A dimension more, of one value, moves none.
    both = Graph(make(slope=slopes, walker=["E", "F"]))
    of_e = both.grid.chunk(both.grid.chunks_of_line(1)[-1])
    assert of_e.shape != last.shape and both.chunk_node(of_e).key == key


def test_lines_are_put_together_from_their_walker_and_values(make):
    lines = make(walker=["E", "F"]).lines_at(np.array([3, 0]))
    assert len(lines) == 2
    assert list(lines) == [
        {"walker": "F", "set": {"foot_mass_ratio": 0.05}},
        {"walker": "E", "set": {"foot_mass_ratio": 0.1}},
    ]


def test_a_task_over_the_study_reads_evenly_spaced_slopes(make, tmp_path, monkeypatch):
    monkeypatch.setattr(reads, "_MAX_SLOPES", 1000)
    slopes = np.linspace(0.001, 0.02, 40_001)
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        plan = Plan(make(slope=slopes), store)
        lines, grid = reads._Lines(plan, ["stance_angle"]), plan.graph.grid
        assert len(grid.chunks_of_line(1)) > 1 and slopes.size % lines.step
        monkeypatch.setattr(
            lines,
            "_chunk",
            lambda k: Points(
                {
                    name: np.tile(slopes[grid.chunk(k).slopes][:, None], 4)
                    for name in lines.names
                }
            ),
        )
        found = lines.line(1)
    assert np.array_equal(found["slope"], slopes[:: lines.step])
    assert np.array_equal(found["stance_angle"][:, plan.columns[0]], found["slope"])


def test_what_depends_on_a_task_is_in_its_urgency(make):
    study = make(
        want={
            "variables": ["period"],
            "fits": ["scaling", "landmarks"],
            "claims": ["E2"],
        }
    )

    graph = Graph(study)

    after = graph.seconds_after
    seconds = {name: graph.seconds(name) for name in graph.layers}
    assert after["points"] == max(seconds["scaling"], seconds["claims"])
    assert after["claims"] == 0
    assert after["atlas"] == max(
        seconds["points"] + after["points"], seconds["landmarks"]
    )


def expand(study):
    """The graph in Dask's form: key -> task, parameters, keys of inputs."""
    graph = Graph(study)
    nodes = [
        graph.node(name, i) for i in range(study.batches) for name in graph.line_tasks
    ]
    nodes += [graph.chunk_node(graph.grid.chunk(k)) for k in range(graph.grid.chunks)]
    nodes += map(graph.node, graph.study_tasks)
    return {
        node.key: (node.task, graph.params(node), list(node.needs)) for node in nodes
    }


@pytest.mark.parametrize("kind", ["orbit", "basin", "cascade"])
def test_the_motion_over_a_step_does_not_depend_on_how_many_an_orbit_has(make, kind):
    study = make(kind=kind, want={"figures": ["angles"]}, options={"steps": 30})
    nodes = expand(study).values()
    assert {name: parameters.get("steps") for name, parameters, _ in nodes} == {
        "atlas": None,
        kind: 30,
        "trace": None,
    }


def test_a_fit_made_before_an_atlas_was_retried_is_stale(make, tmp_path):
    """As of a run that was killed between the two."""
    study = make(
        want={"variables": ["period"], "fits": ["landmarks"], "claims": ["E2"]}
    )  # of long lines
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        plan = Plan(study, store)
        graph = plan.graph
        keys = graph.study_keys
        for key in (graph.line_keys(0)["atlas"], keys["landmarks"], keys["claims"]):
            store.put_result(key, Outcome("ok", ""), b"")
        assert list(plan.over_study()) == []
        store.put_result(graph.line_keys(0)["atlas"], Outcome("ok", ""), b"")
        stale = dict.fromkeys(["landmarks", "claims"], "its inputs change")
        assert {node.task: node.why for node in plan.over_study()} == stale


def test_a_line_whose_own_result_is_known_needs_no_atlas(make, tmp_path):
    """It is lost with its row of a damaged journal, or another study of the command has
    brought that result.
    """
    study = make(kind="branch")
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        plan = Plan(study, store)
        for k in range(2):
            key, columns = (
                plan.graph.line_keys(k)["branch"],
                {"branches/slope": np.array([0.01])},
            )
            store.put_result(key, Outcome("ok", ""), serialize.dump(columns))
        assert not [*plan.nodes()] and write.write(plan, tmp_path / "s.nc").counts == {
            "converged": 2
        }


def test_a_plan_says_of_tasks_over_the_study_what_runs(make, tmp_path):
    """Landmarks need branches alone: points that are computed again, with another
    variable, do not concern them.
    """
    study = make(
        np.linspace(0.01, 0.02, 300).tolist(),
        want={"variables": ["period"], "fits": ["landmarks", "scaling"]},
    )
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        plan = Plan(study, store)
        graph = plan.graph
        for key in (
            *(graph.line_keys(k)["atlas"] for k in range(2)),
            *graph.study_keys.values(),
        ):
            store.put_result(key, Outcome("ok", ""), serialize.dump({}))
        said = {name for name in graph.study_tasks if summary(plan).todo[name]}
        chunk = graph.chunk_node(graph.grid.chunk(0))
        store.put(chunk.key, Record(b"", b""))
        assert said == {node.task for node in plan.over_study()} == {"scaling"}


PAPER = [
    path
    for path in sorted((ROOT / "data" / "studies" / "paper").glob("*.toml"))
    if "claims" in path.read_text()
]


@pytest.mark.parametrize("path", PAPER, ids=lambda path: path.stem)
def test_the_atlases_of_claims_are_those_that_they_compute_without_a_study(path):
    study = parse.read(path)
    atlases = [
        parameters for task, parameters, _ in expand(study).values() if task == "atlas"
    ]
    assert study.claims and (atlases or study.kind == "census")
    assert not any(parameters["coarse"] for parameters in atlases)
    without = dataclasses.replace(study, claims=())
    assert (Graph(without).method == "short") == (study.kind == "grid")


def test_claims_want_atlases_that_are_not_coarse_whatever_the_accuracy(make):
    long = make(slope=np.geomspace(0.01, 0.02, 300), accuracy=1e-6)
    assert Graph(long).params(Graph(long).node("atlas", 0))["coarse"]
    claimed = dataclasses.replace(long, claims=("E2",))
    assert not Graph(claimed).params(Graph(claimed).node("atlas", 0))["coarse"]


def test_the_loss_of_walking_is_located_once_for_studies_of_different_kinds(make):
    """Chaos, its cascade and the claims on it read the same tables."""
    studies = [
        make(
            kind="orbit",
            walker=["C", "C-printed"],
            axes={"slope": [0.07, 0.08, 0.1]},
            want={"fits": ["crises"]},
        ),
        make(
            kind="cascade",
            walker=["C-printed"],
            axes={"slope": [0.07, 0.1]},
            want={"claims": ["K1", "K2"]},
        ),
    ]
    keys = [
        {key for key in expand(study) if not key.startswith(("crises", "claims"))}
        for study in studies
    ]
    assert sorted(key.partition("-")[0] for key in keys[0] & keys[1]) == [
        "atlas",
        "cascade",
        "corners",
    ]
    assert {key.partition("-")[0] for key in keys[0] - keys[1]} == {
        "atlas",
        "orbit",
        "cascade",
        "corners",
    }
    others = expand(make(want={"fits": ["crises"]})).values()
    assert [
        len(parameters["slope"]) for name, parameters, _ in others if name == "cascade"
    ] == [0, 0]


def test_the_graph_is_plain_data_and_whole(make):
    nodes = expand(make(want={"fits": ["scaling", "transition"]}))
    assert [key.split("-")[0] for key in nodes] == ["points", "scaling", "transition"]
    for task, params, needs in nodes.values():
        plain = {
            name: vars(value) if isinstance(value, Lines) else value
            for name, value in params.items()
        }
        serialize.dump([task, plain, needs])
    for _, _, inputs in nodes.values():
        assert set(inputs) <= set(nodes)


def test_keys_depend_on_slopes_where_points_do_and_on_no_wishes(make):
    long = np.linspace(0.01, 0.1, 300)
    one = expand(make(slope=long))
    two = expand(
        make(slope=long, want={"variables": ["period"]}, limits={"seconds": 3})
    )
    assert set(one) == set(two) and len(one) == 4
    three = expand(make(slope=long + 1e-3))
    assert {key.split("-")[0] for key in set(one) & set(three)} == {"atlas"}
    fitted, other = (
        expand(make(want={"fits": ["scaling"]}, slope=s))
        for s in ((0.01, 0.02), (0.01, 0.03))
    )
    assert not set(fitted) & set(
        other
    )  # of lines side by side, the points are all that is kept


def test_a_version_is_in_the_keys_of_its_dependents(make, monkeypatch):
    before = expand(make(want={"fits": ["scaling"]}))
    monkeypatch.setitem(
        registry.TASKS,
        "points",
        dataclasses.replace(registry.TASKS["points"], version=99),
    )
    after = expand(make(want={"fits": ["scaling"]}))
    assert {key.split("-")[0] for key in set(before) - set(after)} == {
        "points",
        "scaling",
    }


@pytest.mark.parametrize("n", [2, 40_001])
def test_a_plan_says_that_a_task_has_another_version(make, monkeypatch, tmp_path, n):
    """Of lines side by side, and of a long line."""
    study = make(slope=np.linspace(0.001, 0.02, n))
    with contextlib.closing(Journal(tmp_path / "j")) as store:
        before = Plan(study, store)
        reasons = [{node.why for node in before.nodes()}]
        before.set_notes()
        for name in ("points", "atlas"):
            bumped = dataclasses.replace(registry.TASKS[name], version=99)
            monkeypatch.setitem(registry.TASKS, name, bumped)
            nodes = Plan(study, store).nodes()
            reasons.append({node.why for node in nodes if node.task == "points"})
    assert reasons == [{"new"}, {"changed"}, {"changed"}]


def test_keys_hold_the_exact_numbers():
    task = registry.TASKS["atlas"]
    one, two = (
        {"line": {"walker": "E", "set": {"R": value}}}
        for value in (0.1, np.nextafter(0.1, 1))
    )
    assert task_key(task, one) != task_key(task, two)
    key = task_key(task, one)
    assert key.startswith("atlas-") and len(key) == 70
    backwards = {"line": dict(reversed(one["line"].items()))}
    assert task_key(task, one) == task_key(task, backwards)


def test_polynomials_give_derivatives_where_a_line_has_far_more_slopes_than_they_take(
    make,
):
    def asked(n, **keys):
        axes = {"slope": {"from": 0.001, "to": 0.05, "n": n}}
        want = {"variables": ["period", "sensitivities"]}
        study = make(axes=axes, want=want, **keys)
        method = Graph(study).method
        seconds = n * of_point(study, method)
        return point_params(study, method)["charted"], seconds

    few, of_few = asked(400)
    many, of_many = asked(1000)
    to_accuracy, _ = asked(1000, accuracy=1e-8)

    assert (few, many, to_accuracy) == (False, True, True)
    assert of_many < of_few
