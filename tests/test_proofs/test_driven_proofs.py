"""Gaits of walkers that more than gravity drives are proved from the same keys."""

import pytest

from gaitsweep import gaits, solve
from gaitsweep.tasks.studies.prove_gaits import prove_one

WALKERS = [
    ("D", "0", {"push_off": "0.05"}),
    ("B", "0", {"hip_torque": "0.01", "hip_stiffness": "0.05"}),
    ("B", "0.01", {"hip_stiffness": "0.05", "hip_damping": "0.001", "hip_rest": "0.1"}),
    pytest.param(
        *("C", "0.03", {"push_off": "0.05", "hip_torque": "0.01"}),
        marks=pytest.mark.thorough,
    ),
    pytest.param(
        *("C", "0.03", {"push_off": "0.05", "trailing_knee": "locked"}),
        marks=pytest.mark.thorough,
    ),
]


@pytest.mark.parametrize(("walker", "slope", "keys"), WALKERS)
def test_gaits_are_proved_where_they_are_solved(walker, slope, keys):
    """In balls the equations are written a second time, from the keys on."""
    request = {"walker": walker, "slope": slope, "set": keys, "accuracy": 1e-12}
    proved = prove_one(request)["gaits"]
    numbers = {
        key: value if key == "trailing_knee" else float(value)
        for key, value in keys.items()
    }
    found = solve(walker, float(slope), **numbers)

    assert len(proved) == len(found) > 0
    for proof, gait in zip(proved, found.itertuples(), strict=True):
        assert proof["proved"], proof["reason"]
        assert proof["stable"] == gait.stable
        bound = 2 * gait.error_bound
        for name in ("stance_angle", "period"):
            value = float(proof["box"][name][0])
            assert value == pytest.approx(getattr(gait, name), rel=bound)
        assert {*keys} <= {*proof["walker"]}


def test_a_grid_on_level_ground_is_proved():
    found = gaits("D", 0.0, push_off=[0.02, 0.05], variables=["proved", "error_bound"])
    assert (found["proved"].sel(gait=["long", "short"]) == 1).all()
