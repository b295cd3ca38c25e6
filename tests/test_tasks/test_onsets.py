"""Onsets of violations on branches and along curves, against bisections of single
solves.
"""

import numpy as np
import pytest

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.contract.registry import GAITS, VARIABLES, VIOLATIONS
from gaitsweep.tasks.measures.names import measures
from gaitsweep.tasks.measures.onsets import onsets
from gaitsweep.tasks.studies.follow_branches import branch
from gaitsweep.tasks.studies.follow_curves import curve
from gaitsweep.tasks.studies.solve_points import atlas, points
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas

#: Slopes beside an onset, over it, and how often they are drawn together.
_BESIDE, _ROUNDS = 1e-3, 5


def located(walker, violation, limit, window, **more):
    """The onsets of a violation on a line's branches: kinds, slopes and bounds."""
    params = {"line": {"walker": walker, "set": {}}, "n": 2}
    params |= {"slope_from": window[0], "slope_to": window[1]}
    params |= {"onsets": [violation], "violation_limits": {violation: limit}}
    found = branch(params | more, [_atlas(walker, ())])
    own = np.char.startswith(found["special_points/kind"].astype(str), "onset")
    columns = "kind", "slope", "error_bound"
    return [found[f"special_points/{name}"][own] for name in columns]


def bisected(walker, amount, limit, slope, label, **keys):
    """The slopes near one between which the amount of single gaits passes a limit."""
    asked = {"line": {"walker": walker, "set": keys}, "want": (amount,)}
    own = resolve(walker, keys)
    units = own.leg, own.total_mass, own.time_unit
    most = limit * VARIABLES[amount].unit(*units)
    low, high = slope * (1 - _BESIDE), slope * (1 + 2 * _BESIDE)
    for _ in range(_ROUNDS):
        slopes = np.linspace(low, high, 9)
        single = points(
            asked | {"slope": slopes}, [_atlas(walker, tuple(keys.items()))]
        )
        exceeds = single[amount][:, GAITS.index(label)] > most
        (change,) = np.flatnonzero(exceeds[1:] != exceeds[:-1])
        low, high = slopes[change : change + 2]
    return low, high


@pytest.mark.parametrize(
    ("walker", "violation", "limit", "window", "amount", "label"),
    [
        ("A", "scuff", 0.001, (0.02, 0.06), "scuff_depth", "long"),
        pytest.param(
            *("physical", "scuff", 0.0, (0.03, 0.06), "scuff_depth", "short"),
            marks=pytest.mark.thorough,
        ),
        pytest.param(
            *("C", "release_hyperextends", 0.0, (5e-3, 0.1)),
            *("hyperextension", "short"),
            marks=pytest.mark.thorough,
        ),
        ("C", "friction", 0.3, (0.09, 0.1), "friction_demand", "short"),
        pytest.param(
            *("physical-straight", "release_penetrates", 0.0, (0.2, 0.34)),
            *("penetration_depth", "long"),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_amounts_of_single_gaits_pass_their_limit_at_an_onset(
    walker, violation, limit, window, amount, label
):
    kinds, slopes, errors = located(walker, violation, limit, window)

    assert kinds.tolist() == [f"onset_of_{amount}"]
    low, high = bisected(walker, amount, limit, slopes[0], label)
    # The grid's own width, and rounding where amounts begin as a square.
    assert high - low < 1e-7 * slopes[0]
    assert low - 1e-7 * low < slopes[0] < high + 1e-7 * high
    assert errors[0] < 1e-11


@pytest.mark.parametrize(
    ("walker", "violation", "limit", "window", "key", "ends", "amount", "label"),
    [
        # The limit is counted over the leg, which changes with the radius of the foot.
        (
            *("A", "scuff", 0.001, (0.02, 0.06)),
            *("R", (0.19, 0.21), "scuff_depth", "long"),
        ),
        # Begun at the end of the key's range.
        pytest.param(
            *("C", "friction", 0.3, (0.09, 0.1)),
            *("m_h", (0.3, 0.7), "friction_demand", "short"),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_an_onset_on_a_curve_is_that_of_its_walker(
    walker, violation, limit, window, key, ends, amount, label
):
    params = {"line": {"walker": walker, "set": {}}, "slope": np.array(window)}
    params |= {"key": key, "from": ends[0], "to": ends[1], "kinds": []}
    params |= {"onsets": [violation], "violation_limits": {violation: limit}}

    found = curve(params, [_atlas(walker, ())])

    own = found["curves/kind"] == f"onset_of_{amount}"
    assert own.any()
    assert found["curves/walks"][own].all()
    assert found["curves/error_bound"].max() < 1e-11
    row = own.sum() // 3
    slope, value = found["curves/slope"][own][row], found["curves/value"][own][row]
    low, high = bisected(walker, amount, limit, slope, label, **{key: value})
    assert low < slope < high


def test_amounts_that_tell_no_distance_begin_where_what_is_below_them_does():
    """Those that are 0 wherever there is none have conditions of their own."""
    walker = resolve("C")
    limits = dict.fromkeys(VIOLATIONS, 0.0)

    begin = onsets(["all"], walker, limits)

    by_kind = {
        "hyperextension": "release_hyperextension",
        "penetration_depth": "release_penetration",
        "trailing_impulse": "release_penetration",
    }
    for amount, kind in by_kind.items():
        assert begin[f"onset_of_{amount}"].value is CONDITIONS[kind].value
    assert {each.name for each in begin.values()} == {"onset"}
    amounts = [amount for each in VIOLATIONS.values() for amount in each.amounts]
    known = {*amounts} & {*measures(walker)}
    assert {*begin} == {f"onset_of_{amount}" for amount in known}


def test_walkers_without_knees_have_no_onsets_of_these():
    assert [*onsets(["release_hyperextends"], resolve("A"), {})] == []


@pytest.mark.parametrize(
    ("violation", "told"),
    [
        (
            "release_hyperextends",
            ["`release_hyperextends` begins nowhere: gaits of this wa"],
        ),
        ("scuff", []),
    ],
)
def test_of_violations_that_a_walker_cannot_have_branches_say_so(violation, told):
    params = {"line": {"walker": "D", "set": {}}, "n": 2, "onsets": [violation]}
    params |= {"slope_from": 0.005, "slope_to": 0.01}

    found = branch(params, [_atlas("D", ())])

    reasons = found.get("partly/reason", np.array([])).tolist()
    assert [reason[:55] for reason in reasons] == told


#: Of a push-off, which the walker itself has not: what drives it may violate.
OF_PUSH = {"onsets": ["push_off_slips"], "violation_limits": {"push_off_slips": 0.15}}


def friction_of(push_off, m_h):
    """Friction that the push-offs of gaits on level ground demand."""
    line = {"walker": "B", "set": {"m_h": m_h, "push_off": push_off}, "slope": 0.0}
    asked = {"line": line, "slope": np.array([0.0])}
    asked |= {"want": ("friction_demand_push_off",)}
    return points(asked, [_atlas("B", ())])["friction_demand_push_off"][0]


def test_violations_by_a_push_off_begin_on_branches_over_it():
    line = {"walker": "B", "set": {"m_h": 1.0}, "slope": 0.0}
    params = {"line": line, "along": "push_off", "n": 2, **OF_PUSH}
    params |= {"slope_from": 0.02, "slope_to": 0.1}

    found = branch(params, [atlas({"line": line, "along": "push_off"}, [])])

    assert "partly/reason" not in found
    kinds = found["special_points/kind"].astype(str)
    own = kinds == "onset_of_friction_demand_push_off"
    assert own.any()
    for push_off in found["special_points/push_off"][own]:
        nearest = np.nanmin(np.abs(friction_of(push_off, 1.0) - 0.15))
        assert nearest < 1e-9


@pytest.mark.thorough
def test_violations_by_a_push_off_begin_along_curves_over_it_and_a_key():
    line = {"walker": "B", "set": {}}
    params = {"line": line, "slope": np.array([0.0]), "kinds": [], **OF_PUSH}
    params |= {"plane": {"push_off": [0.03, 0.1], "m_h": [0.8, 1.2]}}

    found = curve(params, [{}])

    assert set(found["curves/kind"]) == {"onset_of_friction_demand_push_off"}
    middle = len(found["curves/value"]) // 2
    keys = found["curves/value"][middle], found["curves/other_value"][middle]
    nearest = np.nanmin(np.abs(friction_of(*keys) - 0.15))
    assert nearest < 1e-9
