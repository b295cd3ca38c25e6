"""The graph is plain data, culled to what is wanted, and its keys name science alone."""

import contextlib
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.plan import costs, graph
from pipeline.plan.missing import Plan
from pipeline.store.journal import Journal
from pipeline.store.rows import Result
from pipeline.study import parse
from tasks import registry

ROOT = Path(__file__).parents[2]


@pytest.fixture
def make():
    def make(slope=(0.01, 0.02), **changes):
        table = {"name": "s", "walker": "E", "axes": {"slope": list(slope), "foot_mass_ratio": [0.1, 0.05]}, **changes}
        return parse.parse(table, "", Path("s.toml"))

    return make


def test_nothing_that_is_not_wanted_is_in_the_graph(make):
    found = make(want={"variables": ["period"]})
    assert list(graph.layers(found)) == ["atlas", "points"]
    assert graph.variables(found) == ("period", *registry.ALWAYS)
    found = make(want={"variables": ["period"], "fits": ["transition"]})
    assert list(graph.layers(found)) == ["atlas", "points", "transition"]
    assert "stance_angle" in graph.variables(found) and "multiplier_real" not in graph.variables(found)


def test_what_depends_on_a_task_is_in_its_depth_and_urgency(make):
    study = make(want={"variables": ["period"], "fits": ["scaling", "landmarks"], "claims": ["E2"]})
    layers = graph.layers(study)
    assert graph.depths(layers) == {"atlas": 0, "points": 1, "scaling": 2, "landmarks": 1, "claims": 2}
    after = costs.seconds_after(study, layers)
    seconds = {name: costs.seconds(study, name) for name in layers}
    assert after["points"] == max(seconds["scaling"], seconds["claims"]) and after["claims"] == 0
    assert after["atlas"] == max(seconds["points"] + after["points"], seconds["landmarks"])


@pytest.mark.parametrize("kind", ["orbit", "basin", "cascade"])
def test_the_motion_over_a_step_does_not_depend_on_how_many_an_orbit_has(make, kind):
    study = make(kind=kind, want={"figures": ["angles"]}, options={"steps": 30})
    nodes = graph.expand(study).values()
    assert {name: parameters.get("steps") for name, parameters, _ in nodes} == {"atlas": None, kind: 30, "trace": None}


def test_claims_wait_for_the_task_of_their_study_though_that_needs_no_atlas(make):
    layers = graph.layers(make(kind="census", walker="D", axes={"slope": [0.01]}, want={"claims": ["G1"]}))
    assert graph.depths(layers) == {"census": 1, "claims": 2}


def test_a_fit_made_before_an_atlas_was_retried_is_stale(make, tmp_path):
    """As of a run that was killed between the two."""
    study = make(want={"variables": ["period"], "fits": ["landmarks"], "claims": ["E2"]})  # of long lines
    with contextlib.closing(Journal(tmp_path / "j")) as journal:
        plan = Plan(study, journal)
        keys = plan.study_keys()
        for key in (plan.line_keys(0)["atlas"], keys["landmarks"], keys["claims"]):
            journal.add_result(*key, Result("ok", "", 0, b""), 0.1)
        assert plan.over_study(False) == {}
        journal.add_result(*plan.line_keys(0)["atlas"], Result("ok", "", 0, b""), 0.1)
        todo = {name: why for name, (_, why) in plan.over_study(False).items()}
    assert todo == dict.fromkeys(["landmarks", "claims"], "its inputs change")


PAPER = [path for path in sorted((ROOT / "data" / "studies" / "paper").glob("*.toml")) if "claims" in path.read_text()]


@pytest.mark.parametrize("path", PAPER, ids=lambda path: path.stem)
def test_the_atlases_of_claims_are_those_that_they_compute_without_a_study(path):
    study = parse.read(path)
    atlases = [parameters for task, parameters, _ in graph.expand(study).values() if task == "atlas"]
    assert study.claims and (atlases or study.kind == "census")
    assert not any(parameters["coarse"] for parameters in atlases)
    without = dataclasses.replace(study, claims=())
    assert graph.is_short(without) == (study.kind == "grid")


def test_claims_want_atlases_that_are_not_coarse_whatever_the_accuracy(make):
    long = make(slope=np.geomspace(0.01, 0.02, 300), accuracy=1e-6)
    assert graph.line_params(long, "atlas", long.line(0))["coarse"]
    claimed = dataclasses.replace(long, claims=("E2",))
    assert not graph.line_params(claimed, "atlas", claimed.line(0))["coarse"]


def test_the_loss_of_walking_is_located_once_for_studies_of_different_kinds(make):
    """Chaos, its cascade and the claims on it read the same tables."""
    studies = [
        make(kind="orbit", walker=["C", "C-printed"], axes={"slope": [0.07, 0.08, 0.1]}, want={"fits": ["crises"]}),
        make(kind="cascade", walker=["C-printed"], axes={"slope": [0.07, 0.1]}, want={"claims": ["K1", "K2"]}),
    ]
    keys = [{key for key in graph.expand(study) if not key.startswith(("crises", "claims"))} for study in studies]
    assert sorted(key.partition("-")[0] for key in keys[0] & keys[1]) == ["atlas", "cascade", "corners"]
    assert {key.partition("-")[0] for key in keys[0] - keys[1]} == {"atlas", "orbit", "cascade", "corners"}
    others = graph.expand(make(want={"fits": ["crises"]})).values()
    assert [len(parameters["slope"]) for name, parameters, _ in others if name == "cascade"] == [0, 0]


def test_the_graph_is_plain_data_and_whole(make):
    nodes = graph.expand(make(want={"fits": ["scaling", "transition"]}))
    assert [key.split("-")[0] for key in nodes] == ["atlas", "points"] * 2 + ["scaling", "transition"]
    json.dumps(nodes)
    for _, _, inputs in nodes.values():
        assert set(inputs) <= set(nodes)


def test_keys_do_not_depend_on_slopes_and_wishes(make):
    one = graph.expand(make())
    two = graph.expand(make(slope=np.linspace(0.01, 0.1, 9), want={"variables": ["period"]}, limits={"seconds": 3}))
    assert set(one) == set(two)
    three = graph.expand(make(want={"fits": ["scaling"]}))
    four = graph.expand(make(want={"fits": ["scaling"]}, slope=(0.01, 0.03)))
    assert len(set(three) & set(four)) == 4 and len(set(three) - set(four)) == 1


def test_a_version_is_in_the_keys_of_its_dependents(make, monkeypatch):
    before = graph.expand(make(want={"fits": ["scaling"]}))
    monkeypatch.setitem(registry.TASKS, "points", dataclasses.replace(registry.TASKS["points"], version=99))
    after = graph.expand(make(want={"fits": ["scaling"]}))
    assert {key.split("-")[0] for key in set(before) & set(after)} == {"atlas"}


def test_keys_hold_the_exact_numbers():
    task = registry.TASKS["atlas"]
    one, two = ({"line": {"walker": "E", "set": {"R": value}}} for value in (0.1, np.nextafter(0.1, 1)))
    assert graph.key(task, one)[0] != graph.key(task, two)[0]
    assert graph.key(task, one)[0] == ("atlas-" + graph.key(task, one)[0][6:]) and len(graph.key(task, one)[0]) == 70
    backwards = {"line": dict(reversed(one["line"].items()))}
    assert graph.key(task, one) == graph.key(task, backwards)
