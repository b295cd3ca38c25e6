"""Closed branches: a loop of gaits between two folds is followed once, and each of its
gaits is one.
"""

import numpy as np
import pytest

from gaitsweep.tasks.branches.atlas import _loop
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.studies.solve_points import lines
from lines import FAILURES, branches, repeats, solved

#: A loop of gaits between folds at slopes of 0.0032 and 0.0186, apart from the branch
#: of larger steps.
LOOP = {"R": 0.273, "detuning": 0.2}


def test_a_loop_is_one_branch_from_a_fold_to_itself():
    problem, found = branches("C", **LOOP)
    (loop,) = [branch for branch in found if branch.why == ("fold", "fold")]
    assert np.abs(loop.Z[:, 0] - loop.Z[:, -1]).max() < 1e-9
    assert [tuple(np.sign(np.diff(loop.q[[a, b]]))) for a, b in loop.pieces()] in (
        [(1,), (-1,)],
        [(-1,), (1,)],
    )
    turns = [p["slope"] for p in special_points(problem, loop) if p["kind"] == "fold"]
    assert sorted(turns) == pytest.approx(
        [np.exp(loop.q.min()), np.exp(loop.q.max())], rel=1e-12
    )
    for why in ("too many points", "no further point"):
        assert all(why not in branch.why for branch in found)


@pytest.mark.parametrize("many", [False, True])
def test_each_slope_has_the_gaits_of_both_sides_once(many):
    slopes = np.array([0.0035, 0.008, 0.016])
    if many:
        out = solved("C", slopes, **LOOP)
    else:
        asked = {
            "lines": [{"walker": "C", "set": LOOP}],
            "slope": slopes,
            "want": ("stance_angle", "piece"),
        }
        ((_, out),) = lines(asked, [])
    assert not np.isin(out["status"], FAILURES).any()
    angle = out["stance_angle"]
    assert (np.isfinite(angle).sum(axis=1) == 2).all()
    if many:
        for k, slope in enumerate(slopes):
            for g in np.flatnonzero(np.isfinite(angle[k])):
                one = {name: v[k, g] for name, v in out.items() if name != "reasons"}
                assert repeats("C", LOOP, slope, one) < 1e-8, GAITS[g]
    # Beyond the folds there are none of these.
    assert np.isnan(solved("C", np.array([0.003, 0.02]), **LOOP)["stance_angle"]).all()


def test_a_loop_is_cut_where_it_is_no_step_or_else_before_a_fold():
    """Nodes of the track down, joined in reverse: the last point lies beyond the first,
    which is the sixth here.
    """
    rate = np.array([9.0, 1, 1, -1, -1, 1, 7])
    assert _loop(6, np.ones(7, bool), rate).tolist() == [2, 3, 4, 5, 1, 2, 3]
    steps = np.array([True, True, True, True, False, True, True])
    assert _loop(6, steps, rate).tolist() == [4, 5, 1, 2, 3, 4]
