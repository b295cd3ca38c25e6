"""Special points have the state just after heelstrike, in the walker's units."""

import numpy as np
import pytest

from gaitsweep.tasks.continuation.atlas import survey, to_arrays
from gaitsweep.tasks.follow_branches import branch
from gaitsweep.tasks.map_step import map_step
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import resolve

RATES = ("stance_rate", "thigh_rate", "shank_rate")


@pytest.fixture(scope="module")
def tables():
    """What the task gives for the physical walker with knees and without, each in SI units."""

    def follow(walker):
        params = {"line": {"walker": walker}, "slope_from": 0.015, "slope_to": 0.06, "n": 60}
        return branch(params, [to_arrays(survey(Problem(resolve(walker))))])

    return {walker: follow(walker) for walker in ("physical", "physical-straight")}


@pytest.mark.parametrize("walker", ["physical", "physical-straight"])
def test_a_step_maps_the_state_of_a_fold_or_flip_onto_itself(tables, walker):
    found = {name.partition("/")[2]: v for name, v in tables[walker].items() if name.startswith("special_points/")}
    inside = np.flatnonzero(np.isin(found["kind"], ["fold", "flip"]))
    assert len(inside) >= (4 if walker == "physical" else 1)
    for k in inside:
        state = [found[name][k] for name in ("stance_angle", "stance_rate", "thigh_rate")]
        mapped = map_step({"walker": walker, "slope": found["slope"][k], "state": state})
        np.testing.assert_allclose(mapped["state"], state, rtol=1e-8)
        np.testing.assert_allclose(mapped["heelstrike_time"], found["period"][k], rtol=1e-8)


@pytest.mark.parametrize("walker", ["physical", "physical-straight"])
def test_an_end_has_the_state_of_the_last_gait_of_its_branch(tables, walker):
    table = tables[walker]
    ends = np.flatnonzero(np.char.startswith(table["special_points/kind"].astype(str), "end_"))
    assert len(ends) >= 2
    for k in ends:
        near = np.abs(table["branches/stance_angle"] / table["special_points/stance_angle"][k] - 1).argmin()
        for name in RATES:
            np.testing.assert_allclose(table[f"special_points/{name}"][k], table[f"branches/{name}"][near], rtol=1e-9)
