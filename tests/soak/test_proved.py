"""Error bounds of random gaits against proved boxes."""

import pytest

from gaitsweep.tasks.studies import solve_points
from soak.proved import _NAMES, Proved, _compared, proved


def check(gaits, kneed, share, tell, jobs=1):
    found = proved(
        gaits, kneed, jobs=jobs
    )  # by default in this process: idle workers of earlier tests may just end
    tell(str(found))
    assert found.violations == 0
    assert len(found.nearest) >= share * gaits
    return found


def test_no_bound_of_random_gaits_is_below_the_proved_distance(tell):
    check(8, False, 1.0, tell)


def test_no_bound_of_random_kneed_gaits_is_below_the_proved_distance(tell):
    check(2, True, 1.0, tell)


@pytest.mark.soak
@pytest.mark.timeout(14400)
@pytest.mark.parametrize(("gaits", "kneed"), [(10_000, False), (500, True)])
def test_no_bound_of_many_gaits_is_below_the_proved_distance(gaits, kneed, tell):
    check(gaits, kneed, 0.99, tell, jobs=2)


def test_a_bound_too_small_is_counted():
    assert Proved([0.5, 1.5, 1.0], [0.6, 1.6, 1.1]).violations == 1


#: Tuned as exactly as doubles can; the rounding of `w_s` is a larger part of `w_t`,
#: which is small.
NEARLY_TUNED = {
    **{
        "l_t": 0.1755482680081406,
        "w_t": -0.004832696788584788,
        "m_t": 0.00988250479278844,
        "r_t": 0.4721522693143795,
    },
    **{
        "c_t": -0.032220415808110636,
        "l_s": 0.8244517319918594,
        "w_s": 0.13349620719140573,
    },
    **{
        "m_s": 0.00988250479278844,
        "r_s": 0.21048505632749562,
        "c_s": 0.7831525437340903,
        "R": 0.7892466108128148,
    },
    **{
        "eps_T": 0.033705009529321414,
        "m_h": 1.6200552710065272e-06,
        "g": 1.0,
        "knees": False,
    },
}


def test_solver_and_proof_agree_on_what_is_tuned():
    line, slope = {"walker": NEARLY_TUNED, "set": {}}, 2.1268508600261344e-07
    out = solve_points.points(
        {"line": line, "slope": [slope], "want": _NAMES},
        [solve_points.atlas({"line": line}, [])],
    )
    values = {name: float(out[name][0, 1]) for name in _NAMES}
    asked = {
        "walker": NEARLY_TUNED,
        "slope": slope,
        "gait": "short",
        "accuracy": 1e-12,
        "values": values,
    }
    reason, _, ratio = _compared(asked)
    assert (reason, ratio < 1) == ("", True)
