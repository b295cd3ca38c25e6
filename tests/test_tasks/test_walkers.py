"""Walkers check themselves; statics and tuning follow from their parameters."""

import itertools
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from heyoka import real128
from scipy.optimize import minimize

from gaitsweep.tasks.measures.losses import velocity_ratio
from gaitsweep.tasks.mechanics.lumped import (
    constants_of,
    lump,
    structure_of,
    structures_of,
)
from gaitsweep.tasks.proofs.body import body
from gaitsweep.tasks.proofs.keys import doubles
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies.solve_at_slope import solve_one
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.describe import describe, drawing
from gaitsweep.tasks.walkers.properties import check
from gaitsweep.tasks.walkers.resolve import (
    from_table,
    owned,
    resolve,
    resolve_many,
    why_no_key,
)
from gaitsweep.tasks.walkers.statics import is_tuned, nearest, statics
from gaitsweep.tasks.walkers.tuning import tune, untuned
from gaitsweep.tasks.walkers.walker import NUMBERS, WalkerError
from gaitsweep.tasks.walkers.walker_array import WalkerArray
from lines import some
from soak.bounds import RANDOM
from soak.stress import random_walker


def test_the_physical_walker_has_the_leg_that_was_settled():
    walker = CATALOGUE["physical"]
    assert walker.l == pytest.approx(0.606136, abs=5e-7)
    assert math.sin(walker.eps_S) * (walker.l_s - walker.R) == pytest.approx(
        walker.l_t * math.sin(walker.eps_T)
    )


def test_exactly_tuned_offsets():
    c = CATALOGUE["C"]
    assert (c.w_s, c.w_t) == (
        pytest.approx(0.0223541, abs=5e-8),
        pytest.approx(-0.0228856, abs=5e-8),
    )
    assert statics(CATALOGUE["C-printed"])["leg_offset"] == pytest.approx(
        -1.85e-4, abs=1e-6
    )


@pytest.mark.parametrize(
    ("name", "tuned"),
    [
        ("A", True),
        ("B", True),
        ("C", True),
        ("D", True),
        ("E", True),
        ("F", True),
        ("physical", False),
        ("C-printed", False),
    ],
)
def test_statics_tell_who_can_walk_at_vanishing_slope(name, tuned):
    assert is_tuned(CATALOGUE[name]) is tuned


@pytest.mark.parametrize("name", ["A", "C", "E", "physical-straight"])
def test_the_step_map_the_proofs_and_the_statics_mean_the_same_walkers_by_tuned(name):
    """Each had a threshold of its own: C with its shank off by 3e-15 of the leg was
    tuned, and has no gait at 1e-17.
    """
    walker, _, found = nearest(
        CATALOGUE[name], ["w_t", "w_s"] if CATALOGUE[name].knees else ["w_s"]
    )
    tuned = replace(
        CATALOGUE[name],
        w_s=float(walker["w_s"][0]),
        w_t=float(walker.get("w_t", [CATALOGUE[name].w_t])[0]),
    )
    offsets = [
        0.0,
        *(sign * 10.0**k for k in np.arange(-17, -13, 0.25) for sign in (-1, 1)),
    ]
    walkers = [replace(tuned, w_s=tuned.w_s + offset * tuned.leg) for offset in offsets]

    by_statics = [is_tuned(one) for one in walkers]
    lumped = [lump(one, real128) for one in walkers]
    by_step_map = [
        all(constants.get(key, 0) == 0 for key in ("S_b_re", "S_c_re"))
        for constants in lumped
    ]
    proved = [body(*doubles(one.table())) for one in walkers]
    links = [(one.thigh, one.shank) if tuned.knees else (one.leg,) for one in proved]
    by_proofs = [all(moment.x.contains(0) for moment, _ in pair) for pair in links]

    assert found.all() and by_statics[0] and not by_statics[-1]
    assert by_statics == by_step_map == by_proofs


def test_a_shank_slightly_off_its_line_is_not_tuned():
    """Maps of designs said of it that it walks at any slope, with error 0."""
    tuned = CATALOGUE["C"]

    slightly = replace(tuned, w_s=tuned.w_s + 3e-15 * tuned.leg)

    assert is_tuned(tuned) and not is_tuned(slightly)


def test_tune_finds_the_exact_offsets_from_the_printed_ones():
    found = tune({"walker": "C-printed", "free": ["w_t", "w_s"]})["walker"]
    assert found["w_t"] == pytest.approx(CATALOGUE["C"].w_t, abs=1e-15)
    assert found["w_s"] == pytest.approx(CATALOGUE["C"].w_s, abs=1e-15)
    assert is_tuned(from_table(found))


@pytest.mark.parametrize("name", ["D", "E", "C"])
def test_a_walker_that_meets_the_conditions_is_left_as_it_is(name):
    found = tune({"walker": name})
    assert found["walker"] == CATALOGUE[name].table() and found["moved"] == {}
    assert found["before"] == found["after"] == statics(CATALOGUE[name])


def test_tune_says_what_moved():
    found = tune({"walker": "C-printed", "free": ["w_t", "w_s", "w_t"]})
    assert found["moved"] == {
        k: [getattr(CATALOGUE["C-printed"], k), found["walker"][k]]
        for k in ("w_t", "w_s")
    }
    assert found["before"] == statics(CATALOGUE["C-printed"])
    assert (
        max(map(abs, found["after"].values()))
        < 1e-15
        < min(map(abs, found["before"].values()))
    )


def test_a_table_is_tuned_as_the_walker_of_its_numbers():
    assert tune({"walker": CATALOGUE["C-printed"].table()}) == tune(
        {"walker": "C-printed"}
    )


def test_a_study_is_told_which_key_moves_which():
    moved = check({"walker": "E", "set": {"foot_mass_ratio": 0.05, "R": 0.0}})["varied"]
    assert moved == {
        **dict.fromkeys(("m_t", "m_s", "m_h"), ("foot_mass_ratio",)),
        "R": ("R",),
    }


def test_tune_says_when_freed_keys_cannot_and_which_can():
    with pytest.raises(WalkerError, match="free two other keys"):
        tune({"walker": "physical", "free": ["m_h"]})

    with pytest.raises(WalkerError, match="keys that can: beside it w_t; "):
        tune({"walker": "physical", "free": ["R"]})
    assert {*tune({"walker": "physical", "free": ["R", "w_t"]})["moved"]} == {
        "R",
        "w_t",
    }


RETUNED = {"base": "A", "tuned": ["w_t"]}


def test_a_walker_is_retuned_by_the_least_change():
    """As SLSQP finds it, from derivatives of its own."""
    walker, free = (
        resolve("physical", {"R": 0.14, "m_t": 1.5}),
        ["w_t", "w_s", "c_t", "eps_T"],
    )
    scale = np.array([abs(getattr(walker, key)) or walker.leg for key in free])

    def residuals(change):
        moved = {
            key: float(getattr(walker, key) + s * c)
            for key, s, c in zip(free, scale, change, strict=True)
        }
        return np.array([*statics(replace(walker, **moved)).values()])

    values, change, found = nearest(walker, free)
    least = minimize(
        lambda change: change @ change,
        np.zeros(4),
        constraints={"type": "eq", "fun": residuals},
        method="SLSQP",
        options={"ftol": 1e-15},
    )
    assert found.tolist() == [True] and np.abs(least.x).min() > 1e-5
    np.testing.assert_allclose(change[:, 0], least.x, atol=1e-6)
    assert is_tuned(
        replace(walker, **{key: float(value[0]) for key, value in values.items()})
    )


def test_a_retuned_leg_has_no_offset_that_doubles_see():
    for R in (0.05, 0.13, 0.31, 0.4):
        constants = lump(resolve(RETUNED, {"R": R, "m_s": 0.7}))
        assert {
            name: value
            for name, value in constants.items()
            if name.startswith("S_b") and not value
        }
        assert untuned({"walker": "A", "set": {"R": R}}) and not untuned(
            {"walker": RETUNED, "set": {"R": R}}
        )
    assert resolve(RETUNED, {"R": 0.2}) == resolve("A")


def test_many_walkers_are_retuned_as_each_alone():
    keys = {"R": np.linspace(0.05, 0.4, 9), "m_t": np.linspace(3, 1, 9)}
    for walker in (RETUNED, {"base": "C", "tuned": ["w_t", "w_s", "c_s"]}):
        many = resolve_many(walker, keys | {"m_h": 0.5})
        each = [
            {"m_h": 0.5, **{key: float(v[k]) for key, v in keys.items()}}
            for k in range(9)
        ]
        assert [many[k] for k in range(9)] == [
            resolve(walker, values) for values in each
        ]
    assert len({walker.w_t for walker in (many[k] for k in range(9))}) == 9
    # What moves no condition leaves the offset.
    assert resolve_many(RETUNED, {"m_h": np.array([0.0, 1.0])})[1] == resolve(
        "A", {"m_h": 1.0}
    )


def test_of_many_walkers_those_that_cannot_be_tuned_have_no_numbers():
    kneed = {"base": "C", "tuned": ["w_t"]}
    many = resolve_many(kneed, {"R": np.array([0.2, 0.3])})
    assert many.w_t[0] == CATALOGUE["C"].w_t and np.isnan(many.w_t[1])
    with pytest.raises(WalkerError, match="`tuned` cannot meet the static conditions"):
        resolve_many(kneed, {"R": np.array([0.25, 0.3])})


@pytest.mark.parametrize(
    ("tuned", "changes", "said"),
    [
        (
            ["m_h"],
            {"R": 0.3},
            "`tuned` cannot meet the static conditions of vanishing slopes; add a key; got m_h.",
        ),
        (["w"], {}, "`tuned` must be a list of keys of a walker"),
        ("w_t", {}, "`tuned` must be a list of keys of a walker"),
        (
            ["w_t"],
            {"w_t": 0.1},
            "`w_t` is set by `tuned`, which changes it so that the walker is tuned; got 0.1.",
        ),
    ],
)
def test_a_walker_that_cannot_be_tuned_says_why(tuned, changes, said):
    with pytest.raises(WalkerError) as refused:
        resolve({"base": "A", "tuned": tuned}, changes)
    assert str(refused.value).startswith(said)


def test_a_detuned_walker_is_retuned_where_asked():
    walker = resolve({"base": "A", "tuned": ["w_t"]}, {"detuning": 0.5})
    assert is_tuned(walker) and walker.r_t == resolve("A", {"detuning": 0.5}).r_t


def test_a_study_is_told_which_keys_are_tuned_and_along_what():
    found = check({"walker": RETUNED, "set": {"R": 0.3, "m_h": 1.0, "m_s": 0.9}})
    assert found["tuned"] == ("w_t",) and found["varied"]["w_t"] == ("R", "m_s")
    assert check({"walker": RETUNED, "set": {"m_h": 1.0}})["varied"] == {
        "m_h": ("m_h",)
    }


ONE = {"knees": False, "l": 1.0, "m": 1.0, "c": 0.4, "m_h": 5.0}


def test_keys_of_a_leg_of_one_link_mean_what_they_mean_in_its_table():
    changes = {"l": 0.8, "c": 0.3, "r": 0.1, "w": 0.02, "m": 2.0, "m_h": 3.0}
    walker = resolve({**ONE, "R": 0.2}, changes)
    assert walker == from_table(
        {**ONE, "R": 0.2, **changes}
    ) and walker.leg == pytest.approx(1.0)
    # Another radius keeps the length to the bottom of the foot.
    assert resolve({**ONE, "R": 0.2}, {**changes, "R": 0.3}) == replace(walker, R=0.3)
    arrays = {
        key: np.array([0.7 * value, value])
        for key, value in changes.items()
        if key != "w"
    }
    many = resolve_many(ONE, arrays | {"w": 0.02})
    each = [
        {key: float(value[k]) for key, value in arrays.items()} | {"w": 0.02}
        for k in range(2)
    ]
    assert [many[0], many[1]] == [resolve(ONE, own) for own in each]
    moved = check({"walker": ONE, "set": changes})["varied"]
    assert (
        moved["c_s"] == ("l", "c") and moved["l_s"] == ("l",) and moved["m_t"] == ("m",)
    )
    assert check({"walker": ONE, "set": {"m": 2.0, "r": 0.1}})["smooth"] == ("m", "r")


@pytest.mark.parametrize("key", ["l", "c", "r", "m", "w"])
def test_keys_of_a_leg_of_one_link_are_none_of_two(key):
    for walker in ("E", {"base": "A", "m_h": 1.0}):
        with pytest.raises(WalkerError, match=f"`{key}` is a key of a leg of one link"):
            resolve(walker, {key: 0.3})


def test_detuning_runs_from_tuned_to_physical():
    assert resolve("C", {"detuning": 0.0}) == CATALOGUE["C"]
    assert resolve("C", {"detuning": 1.0}).table() == pytest.approx(
        CATALOGUE["physical"].table()
    )
    assert resolve("A", {"detuning": 0.5}).r_t == pytest.approx((0.1882 + 0.099) / 2)


def test_a_derived_key_moves_its_own_keys_only():
    assert (
        owned("detuning", "A")
        == owned("detuning", "C")
        == ("w_t", "r_t", "c_t", "w_s", "r_s")
    )
    assert set(owned("foot_mass_ratio", "E")) == {"m_t", "m_s", "m_h"}
    heavy = {"base": "C", "m_h": 2.0}
    for found in (
        resolve(heavy, {"detuning": 0.5}),
        resolve("C", {"detuning": 0.5, "m_h": 2.0}),
    ):
        assert found == replace(resolve("C", {"detuning": 0.5}), m_h=2.0)
    assert resolve("C", {"detuning": 0.1}).l_t == CATALOGUE["C"].l_t


#: Walkers with others to which they lead, and keys of a line that combine with
#: `detuning`.
WAYS = {
    "A": ("A", "physical-straight", {"m_h": 2.0, "R": 0.25}),
    "round feet": ("E", {"base": "E", "R": 0.3}, {"foot_mass_ratio": 0.03, "c_t": 0.1}),
    "a light foot": ("E", {"base": "E", "foot_mass_ratio": 0.01}, {"R": 0.2}),
    "half of C": (
        {"base": "C", "m_h": 2.0},
        {"base": "C", "detuning": 0.5, "eps_T": 0.09, "m_h": 1.5},
        {"m_s": 1.2},
    ),
    "one link": (ONE, {**ONE, "c": 0.5, "R": 0.1, "l": 0.9}, {"m": 1.5, "m_h": 4.0}),
}


def leading(start, end):
    return {**({"base": start} if isinstance(start, str) else start), "toward": end}


@pytest.mark.parametrize(
    ("name", "amount"),
    [
        *itertools.product(WAYS, (0.0, 0.37, 1.0)),
        *itertools.product(("A", "half of C"), (-0.3, 1.2)),
    ],
)
def test_detuning_mixes_every_key_in_which_two_walkers_differ(name, amount):
    start, end, beside = WAYS[name]
    own, others = resolve(start), resolve(end)
    found = resolve(leading(start, end), {"detuning": amount})
    differ = [key for key in NUMBERS if getattr(own, key) != getattr(others, key)]
    assert differ and owned("detuning", leading(start, end)) == tuple(differ)
    for key in NUMBERS:
        low, high = Fraction(getattr(own, key)), Fraction(getattr(others, key))
        exactly = low + Fraction(amount) * (high - low)
        # Two products and a sum, each rounded once.
        assert abs(Fraction(getattr(found, key)) - exactly) <= 2**-51 * max(
            abs(low), abs(high)
        ), key
    if amount in (0.0, 1.0):
        assert found == (own, others)[int(amount)]
    both = resolve(leading(start, end), {"detuning": amount, **beside})
    assert all(getattr(both, key) == getattr(found, key) for key in differ)
    assert all(
        getattr(both, key) == getattr(resolve(start, beside), key)
        for key in NUMBERS
        if key not in differ
    )


@pytest.mark.parametrize("name", WAYS)
def test_many_detuned_walkers_are_those_made_one_by_one(name):
    start, end, beside = WAYS[name]
    walker, amounts = leading(start, end), np.array([0.0, 0.37, 1.0])
    arrays = {key: np.array([0.9, 1.0, 1.1]) * value for key, value in beside.items()}
    many = resolve_many(walker, {"detuning": amounts, **arrays})
    each = [
        {"detuning": float(amounts[k])}
        | {key: float(own[k]) for key, own in arrays.items()}
        for k in range(3)
    ]
    assert [many[k] for k in range(3)] == [resolve(walker, own) for own in each]
    # Beside a number, or an amount in the walker's own table.
    one = resolve_many(walker, {"detuning": 0.37, **arrays})
    assert one[1] == resolve_many({**walker, "detuning": 0.37}, arrays)[1] == many[1]


@pytest.mark.parametrize(
    ("name", "partner"), [("A", "physical-straight"), ("C", "physical")]
)
def test_the_tuned_walkers_lead_to_the_physical_ones_bit_for_bit(name, partner):
    amounts = np.linspace(-0.5, 1.5, 41)
    named = resolve_many(leading(name, partner), {"detuning": amounts})
    without = resolve_many(name, {"detuning": amounts})
    assert [named[k] for k in range(41)] == [without[k] for k in range(41)]
    assert named[7] == resolve(name, {"detuning": float(amounts[7])})


def test_a_walker_is_itself_where_it_is_not_detuned():
    walker = leading("E", {"base": "E", "R": 0.3})
    assert resolve(walker) == CATALOGUE["E"] and resolve(walker, {"R": 0.1}) == resolve(
        "E", {"R": 0.1}
    )
    assert resolve({**walker, "detuning": 0.5}) == resolve("E", {"R": 0.15})
    found = check({"walker": walker, "set": {"detuning": 0.5, "foot_mass_ratio": 0.02}})
    masses = dict.fromkeys(("m_t", "m_s", "m_h"), ("foot_mass_ratio",))
    assert found["varied"] == {"R": ("detuning",), **masses} and found["smooth"] == (
        "detuning",
        "foot_mass_ratio",
    )
    tables = [CATALOGUE["E"].table(), resolve("E", {"R": 0.3}).table()]
    assert found["way"] == {"start": "E", "end": "E with R = 0.3", "tables": tables}
    assert "way" not in check({"walker": "A", "set": {"m_h": 1.0}})
    assert (
        check({"walker": "A", "set": {"detuning": 0.5}})["way"]["end"]
        == "the physical one"
    )


def test_the_feet_of_a_walker_without_a_base_keep_their_share_along_a_way():
    """Feet that detuning makes round were refused."""
    whole = CATALOGUE["E"].table()
    walker = leading(whole, {**whole, "R": 0.3})
    assert resolve(walker, {"detuning": 0.5, "foot_mass_ratio": 0.02}) == resolve(
        "E", {"R": 0.15, "foot_mass_ratio": 0.02}
    )


@pytest.mark.parametrize(
    ("start", "end", "changes", "said"),
    [
        ("E", "C", {}, "`toward` must have straight legs, as the walker has; got C."),
        ("C", "A", {}, "`toward` must have knees, as the walker has; got A."),
        ("E", "A", {}, '`toward` must have `units` = "1", as the walker has; got A.'),
        ("E", "E", {}, "`toward` must differ from the walker in a key; got E."),
        (
            "E",
            {"base": "E", "R": 0.0},
            {},
            "`toward` must differ from the walker in a key; got E with R = 0.0.",
        ),
        (
            "E",
            "Q",
            {},
            "`toward` must be a walker, and its `base` is not a known walker; got Q.",
        ),
        (
            "E",
            {"base": "E", "m_s": -1.0},
            {},
            "`toward` must be a walker, and its `m_s` must be >= 0; got -1.0.",
        ),
        (
            "E",
            {"base": "E", "q": 1.0},
            {},
            "`toward` must be a walker, and its `q` is not a walker key (keys: l_t",
        ),
        ("E", 3, {}, "`toward` must be the name or the table of a walker; got 3."),
        (
            *("E", {"base": "E", "toward": "D"}, {}),
            "`toward` must be a walker that has no `toward` itself; got E.",
        ),
        ("E", "F", {"detuning": -9.0}, "`m_t` must be >= 0; got -0.049"),
        (
            "E",
            {"base": "E", "R": 0.3},
            {"detuning": 4.0},
            "`R` must leave the hip above the foot's centre; got 1.2.",
        ),
        (
            "E",
            {"base": "E", "R": 0.3},
            {"R": 0.1},
            "`R` is set by `detuning`, which owns R; got 0.1.",
        ),
        (
            "E",
            "F",
            {"foot_mass_ratio": 0.1},
            "`foot_mass_ratio` sets m_t, and so does `detuning`; got 0.1.",
        ),
        (
            ONE,
            {**ONE, "c": 0.5},
            {"l": 0.9},
            "`l` is set by `detuning`, which owns c_t, c_s; got 0.9.",
        ),
    ],
)
def test_ways_that_cannot_be_say_why_in_one_line(start, end, changes, said):
    one = {"detuning": 0.5, **changes}
    for made, overrides in (
        (resolve, one),
        (resolve_many, {key: np.array([value]) for key, value in one.items()}),
    ):
        with pytest.raises(WalkerError) as refused:
            made(leading(start, end), overrides)
        assert str(refused.value).startswith(said) and "\n" not in str(refused.value)


def test_a_way_is_checked_though_nothing_goes_it():
    with pytest.raises(WalkerError, match="`toward` must have straight legs"):
        resolve(leading("E", "C"), {"R": 0.1})


@pytest.mark.parametrize(
    ("walker", "overrides", "key", "owner"),
    [
        ("E", {"foot_mass_ratio": 0.1, "m_h": 1.0}, "m_h", "foot_mass_ratio"),
        ("E", {"m_s": 0.2, "foot_mass_ratio": 0.0}, "m_s", "foot_mass_ratio"),
        ({"base": "E", "m_h": 1.0}, {"foot_mass_ratio": 0.1}, "m_h", "foot_mass_ratio"),
        ("C", {"detuning": 0.0, "w_t": 0.1}, "w_t", "detuning"),
        ({"base": "A", "r_s": 0.1}, {"detuning": 0.5}, "r_s", "detuning"),
    ],
)
def test_a_key_that_a_derived_one_owns_is_refused(walker, overrides, key, owner):
    value = {**(walker if isinstance(walker, dict) else {}), **overrides}[key]
    with pytest.raises(
        WalkerError,
        match=rf"^`{key}` is set by `{owner}`, which owns .*{key}.*; got {value}\.$",
    ):
        resolve(walker, overrides)


def test_a_table_may_hold_derived_keys():
    assert resolve({"base": "E", "foot_mass_ratio": 0.02}) == resolve(
        "E", {"foot_mass_ratio": 0.02}
    )
    assert resolve({"base": "C", "detuning": 0.5, "m_h": 1.0}) == resolve(
        "C", {"detuning": 0.5, "m_h": 1.0}
    )
    round_feet = resolve("E", {"foot_mass_ratio": 0.02, "R": 0.2})
    assert resolve({"base": "E", "R": 0.2, "foot_mass_ratio": 0.02}) == round_feet
    assert resolve({"base": "E", "R": 0.2}, {"foot_mass_ratio": 0.02}) == round_feet
    assert (
        resolve_many({"base": "E", "R": 0.2}, {"foot_mass_ratio": np.array([0.02])})[0]
        == round_feet
    )
    assert resolve({"base": "E", "c_t": 0.1, "foot_mass_ratio": 0.02}) == replace(
        round_feet, c_t=0.1, R=0.0
    )
    # An axis over the same key has the last word, as over any other.
    assert resolve(
        {"base": "E", "foot_mass_ratio": 0.02}, {"foot_mass_ratio": 0.1}
    ) == resolve("E")
    assert (
        describe({"walker": {"base": "A", "detuning": 1.0}})["walkers"][0][
            "parameters"
        ]["w_t"]
        == 0.0
    )
    with pytest.raises(
        WalkerError,
        match="`m_h` is set by `foot_mass_ratio`, which owns m_t, m_s, m_h; got 1.0",
    ):
        resolve({"base": "E", "foot_mass_ratio": 0.02, "m_h": 1.0})
    with pytest.raises(WalkerError, match="`detuning` must be a number; got 'half'"):
        resolve({"base": "C", "detuning": "half"})


def test_a_table_over_point_feet_may_change_other_keys():
    """Round feet in a table with a foot mass ratio were refused, beside it they were
    not.
    """
    for keys in (
        {"R": 0.2},
        {"R": 0.2, "c_s": 0.3},
        {"c_t": 0.1},
        {"g": 9.81, "units": "SI", "name": "mine"},
    ):
        beside = {
            key: value for key, value in keys.items() if key not in ("units", "name")
        }
        expected = replace(
            resolve("E", {"foot_mass_ratio": 0.02, **beside}),
            units=keys.get("units", "1"),
        )
        assert resolve({"base": "E", "foot_mass_ratio": 0.02, **keys}) == expected
        assert resolve({"base": "E", **keys}, {"foot_mass_ratio": 0.02}) == expected
        many = resolve_many(
            {"base": "E", **keys}, {"foot_mass_ratio": np.array([0.0, 0.02])}
        )
        assert many[1] == expected
    with pytest.raises(WalkerError, match="needs a point-foot walker"):
        resolve({"base": "B", "g": 2.0}, {"foot_mass_ratio": 0.02})


def test_the_swing_foot_moves_forward_and_down_where_the_ratio_of_velocities_is_negative():
    """The ratio had the other sign. Its velocities, from those of the foot's lowest
    point, by differences.
    """
    walker, angle, rates = CATALOGUE["B"], 0.2, np.array([-1.1, -0.3])

    def foot(stance, swing):
        hip = -walker.R * stance + 1j * walker.l * np.exp(1j * stance)
        centre = hip - 1j * walker.l * np.exp(1j * swing)
        return (
            centre + walker.R * swing
        )  # the material point at the bottom moves on by the radius

    t = 1e-6 * rates
    velocity = (
        foot(-angle + t[0], angle + t[1]) - foot(-angle - t[0], angle - t[1])
    ) / 2e-6
    assert velocity.real > 0 > velocity.imag
    u = (rates[1] - rates[0]) / abs(rates[0])
    ratio = velocity_ratio(walker, np.array([angle]), np.array([u]))
    assert ratio == pytest.approx(velocity.real / velocity.imag, rel=1e-8)


def test_foot_mass_ratio_keeps_the_total_mass():
    light = resolve("E", {"foot_mass_ratio": 0.01})
    assert light.total_mass == pytest.approx(1.0, abs=1e-15)
    assert light.m_s == pytest.approx(0.01)
    assert resolve("E", {"foot_mass_ratio": 0.0}) == CATALOGUE["D"]


def test_the_papers_infinite_hip_is_the_limit():
    assert (
        from_table({**CATALOGUE["D"].table(), "m_t": math.inf, "m_s": 1.0})
        == CATALOGUE["D"]
    )


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"base": "C", "detuning": 10**400},
            "`detuning` must be 0 or of a size from 1e-50 to 1e.50; got a number of",
        ),
        (
            {"base": "E", "foot_mass_ratio": 10**400},
            "`foot_mass_ratio` must be 0 or of a size",
        ),
        (
            {"knees": False, "m": 1.0, "c": 0.5, "l": 10**400},
            "`l` must be 0 or of a size",
        ),
        (
            {"knees": False, "m": 1.0, "c": math.inf, "l": 1.0},
            "`c` must be finite; got inf",
        ),
        ({"base": "C", "detuning": math.inf}, "`detuning` must be finite; got inf"),
    ],
)
def test_numbers_that_no_walker_can_have_are_told_by_the_key_that_holds_them(
    table, message
):
    with pytest.raises(WalkerError, match=f"^{message}"):
        resolve(table)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"base": "C", "eps_t": 0.1},
            r"`eps_t` is not a walker key \(did you mean `eps_T`\?\); got 0.1",
        ),
        (
            {"base": "C", "x" * 9999: "y" * 9999},
            r"^`x{60}\.{3}` is not a walker key \(keys: l_t, .*\); got y{60}\.{3}",
        ),
        ({"base": "C", "m_s": -1.0}, r"`m_s` must be >= 0; got -1.0"),
        (
            {"base": "C", "eps_T": 0.9},
            r"`eps_T` must satisfy \|l_t sin eps_T\| <= \|l_s - R\| = 0.26",
        ),
        ({"base": "E", "R": 1.0}, r"`R` must leave the hip above the foot's centre"),
        ({"base": "E", "l_t": math.nan}, r"`l_t` must be finite; got nan"),
        ({"base": "Z"}, r"`walker` is not a known walker"),
        ({"l_t": 1.0}, r"`w_t` is missing from the walker"),
        (
            {"knees": False, "l": 1.0, "c": 0.5, "m_inner": 1.0},
            r"`m_inner` is not a walker key \(both legs are equal, .*; keys: l, c, r, m, w",
        ),
        (
            {"knees": False, "l": 1.0, "m": 0.5},
            r"`c` is missing from the walker; got knees, l, m",
        ),
        (
            {"base": "E", "knees": True, "m_s": 0.0},
            r"`m_s` must be > 0 with a free knee",
        ),
        ({"base": "E", "units": "imperial"}, r'`units` must be "SI" or "1"'),
    ],
)
def test_a_walker_that_cannot_be_is_told_in_one_line(table, message):
    with pytest.raises(WalkerError, match=message) as caught:
        from_table(table)
    assert "\n" not in str(caught.value)


def test_the_catalogue_describes_itself():
    found = {w["name"]: w for w in describe({})["walkers"]}
    assert set(found) == set(CATALOGUE)
    assert "hip" in found["C"]["drawing"]
    assert check({"walker": "C"})["multipliers"] == 4


def test_one_walker_is_described_by_its_name_or_its_table():
    (named,) = describe({"name": "physical"})["walkers"]
    (own,) = describe({"walker": CATALOGUE["B"].table()})["walkers"]
    assert (named["name"], named["parameters"]) == (
        "physical",
        CATALOGUE["physical"].table(),
    )
    assert named["geometry"] == {
        "l": CATALOGUE["physical"].l,
        "eps_S": CATALOGUE["physical"].eps_S,
        "leg": CATALOGUE["physical"].leg,
        "total_mass": CATALOGUE["physical"].total_mass,
    }
    assert (own["name"], own["parameters"]) == ("custom", CATALOGUE["B"].table())


def test_a_drawing_shows_knees_and_feet():
    round_feet, points, kneed = (
        drawing(CATALOGUE[name]).splitlines() for name in ("B", "D", "C")
    )
    assert [len(rows) for rows in (round_feet, points, kneed)] == [5, 5, 5]
    assert all(
        "hip" in rows[0] and "feet" in rows[-1] for rows in (round_feet, points, kneed)
    )
    assert [rows[-1].count("(_)") for rows in (round_feet, points, kneed)] == [2, 0, 2]
    assert points[-1].count("*") == 2
    assert [
        any("knee" in row for row in rows) for rows in (round_feet, points, kneed)
    ] == [False, False, True]


def test_straight_legs_need_not_name_what_is_zero():
    short = {
        "knees": False,
        "l_t": 0.5,
        "m_t": 0.4,
        "r_t": 0.0,
        "c_t": 0.0,
        "l_s": 0.5,
        "m_s": 0.1,
        "r_s": 0.0,
        "c_s": 0.5,
    }
    walker = from_table({**short, "R": 0.0, "name": "mine"})
    assert walker == CATALOGUE["E"]
    with pytest.raises(WalkerError, match="`w_t` is missing"):
        from_table({**short, "R": 0.0, "eps_T": 0.0, "knees": True})


def test_a_leg_of_one_link_walks_as_the_same_leg_in_two():
    one = {"knees": False, "m": 1.0, "c": 0.3, "r": 0.2, "l": 0.8, "R": 0.1, "m_h": 5.0}
    walker = from_table(one)
    assert (walker.l, walker.leg, walker.total_mass) == pytest.approx((0.8, 0.9, 7.0))
    halves = {
        "m_t": 0.5,
        "m_s": 0.5,
        "c_t": 0.3,
        "c_s": -0.1,
        "r_t": 0.2,
        "r_s": 0.2,
        "l_t": 0.4,
        "l_s": 0.5,
    }
    two = {"knees": False, "R": 0.1, "m_h": 5.0, **halves}
    for a, b in zip(
        *(solve_one({"walker": w, "slope": 0.01})["gaits"] for w in (one, two)),
        strict=True,
    ):
        assert (a["stance_angle"], a["period"]) == pytest.approx(
            (b["stance_angle"], b["period"]), rel=1e-12
        )
    with pytest.raises(WalkerError, match="`l_t` does not go with `l`"):
        from_table({**one, "l_t": 0.4})
    with pytest.raises(WalkerError, match="`m` is not a walker key"):
        from_table({**one, "knees": True})


@pytest.mark.parametrize(("c", "r"), [(1.0, 0.0), (0.7, 0.2)])
def test_the_mass_of_a_leg_of_one_link_vanishes_where_it_is(c, r):
    """Not in the middle of the leg, where its links meet."""
    gaits = [
        solve_one(
            {
                "walker": {
                    "knees": False,
                    "m": m,
                    "c": c,
                    "r": r,
                    "l": 1.0,
                    "m_h": 1.0,
                },
                "slope": 0.009,
            }
        )["gaits"]
        for m in (0.0, 1e-9)
    ]
    for a, b in zip(*gaits, strict=True):
        assert (a["stance_angle"], a["period"]) == pytest.approx(
            (b["stance_angle"], b["period"]), rel=1e-8
        )
    if c == 1.0:
        assert gaits[0][0]["stance_angle"] == pytest.approx(
            0.2003109005442471, rel=1e-13
        )
    with pytest.raises(WalkerError, match="`c` must be a number"):
        from_table({"knees": False, "m": 0.0, "c": "1", "r": r, "l": 1.0})


def test_the_hip_of_point_feet_carries_the_rest_whatever_a_thigh_without_mass_is_like():
    thigh = {"m_t": 0.0, "c_t": 0.2, "w_t": 0.01, "r_t": 0.1}
    own = {**CATALOGUE["E"].table(), **thigh, "m_h": 0.8}
    for ratio in (0.05, 0.0):
        expected = lump(resolve("E", {"foot_mass_ratio": ratio}))
        assert lump(resolve(own, {"foot_mass_ratio": ratio})) == pytest.approx(
            expected, rel=1e-14
        )
        many = resolve_many(own, {"foot_mass_ratio": np.array([ratio, ratio])})
        assert lump(many[1]) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("offset", [0.0, 0.01])
def test_balanced_legs_do_not_walk(offset):
    """Without a moment about the hip, or with one of level arm, the swing leg does not
    come forward.
    """
    legs = {"m_t": 0.3, "c_t": -0.5, "r_t": 0.3, "w_t": offset, "l_t": 0.5}
    walker = {
        "knees": False,
        **legs,
        "l_s": 0.5,
        "m_s": 0.15,
        "c_s": 0.5,
        "r_s": 0.0,
        "R": 0.0,
        "m_h": 0.8,
    }
    assert lump(from_table(walker))["S_b_im"] == 0
    assert solve_one({"walker": walker, "slope": 0.01})["gaits"] == []


@pytest.mark.parametrize(
    ("walker", "slope"), [("E", 1e-6), ("E", 0.01), ("A", 1e-3), ("physical", 0.036)]
)
def test_the_velocity_ratio_is_that_of_the_losses(walker, slope):
    """Each loss is half of an eigenvalue of the contact mass times the velocity along
    its eigenvector, squared.
    """
    for gait in some(solve_one({"walker": walker, "slope": slope})["gaits"]):
        values, vectors = np.linalg.eigh(np.array(gait["contact_mass_matrix"]))
        normal = int(np.argmax(np.abs(vectors[1])))
        losses = [
            gait["loss_normal"] if k == normal else gait["loss_tangential"]
            for k in (0, 1)
        ]
        along = np.sqrt(2 * np.array(losses) / values)
        velocities = [vectors @ (along * [1, sign]) for sign in (1, -1)]
        ratios = [abs(v[0] / v[1]) for v in velocities]
        assert min(abs(r / abs(gait["velocity_ratio"]) - 1) for r in ratios) < 1e-6
        total = np.array(gait["contact_mass_matrix"]).max()
        assert total == pytest.approx(resolve(walker).total_mass, rel=0.2)
        assert gait["cost_of_transport"] == pytest.approx(np.sin(slope), rel=1e-3)
        legs, angle = resolve(walker), gait["stance_angle"]
        assert gait["step_length"] == pytest.approx(
            2 * (legs.l * np.sin(angle) + legs.R * angle), rel=1e-9
        )


def test_constants_of_several_walkers_are_those_of_each():
    """In arrays as by numbers, to the last bit; their structures too."""
    drawn = [random_walker(family, seed) for family in RANDOM for seed in range(12)]
    walkers = [
        *CATALOGUE.values(),
        *drawn,
        *(resolve("A", {"detuning": v}) for v in (0.0, 1e-9, 1.2)),
    ]
    # A shank whose centre of mass lies in the thigh's direction, almost.
    k = CATALOGUE["physical"]
    eps_s = np.arcsin(k.l_t * np.sin(k.eps_T) / (k.l_s - k.R))
    walkers.append(
        resolve(
            "physical", {"w_s": float(k.c_s * np.tan(eps_s + k.eps_T) * (1 + 1e-9))}
        )
    )
    structures = structures_of(walkers)
    assert structures == [structure_of(walker) for walker in walkers]
    for structure in dict.fromkeys(structures):
        alike = [
            walker
            for walker, other in zip(walkers, structures, strict=True)
            if other == structure
        ]
        constants = constants_of(WalkerArray.of(alike), structure)
        np.testing.assert_array_equal(
            constants,
            np.hstack(
                [constants_of(WalkerArray.of([walker]), structure) for walker in alike]
            ),
        )
        # Once rounded.
        exact = [lump(walker, real128) for walker in alike]
        expected = np.reshape(
            [[float(lumped[name]) for lumped in exact] for name in structure.constants],
            constants.shape,
        )
        np.testing.assert_allclose(constants, expected, rtol=2.3e-16, atol=0)
        lanes = Lanes(alike, structure).some(np.arange(len(alike))[::-1])
        one = np.ones(1)
        for i, walker in enumerate(reversed(alike)):
            np.testing.assert_array_equal(
                lanes.alone(i).parameters(one, one),
                Problem(walker).parameters(one, one),
            )


def test_light_legs_off_their_line_are_not_taken_for_tuned():
    # Of the whole walker the legs are so small a part that their offset looks like
    # rounding beside the hip.
    walker = resolve("E", {"foot_mass_ratio": 1e-9, "w_s": 1e-8})
    exact = -2e-9 * 1e-8 / 2  # a foot's share of the whole mass times its offset
    assert lump(walker)["S_a_re"] == pytest.approx(exact, rel=1e-6, abs=0)


@pytest.mark.parametrize(
    "key", ["m_left", "right", "l2", "m_t1", "leg2", "legs", "R_inner", "swing_leg"]
)
def test_who_asks_for_two_legs_or_a_wheel_is_told(key):
    asked = {"key": key}
    assert why_no_key(asked) == "both legs are equal, and a key is that of either"
    said = rf"`{key}` is not a walker key \(both legs are equal, and a key is that"
    with pytest.raises(WalkerError, match=said):
        resolve("D", {key: 1.0})
    assert why_no_key({"key": "n_spokes"}).startswith("a wheel is no walker")
    for other in ("m_q", "length", "trail", "c_tt"):
        assert why_no_key({"key": other}) == ""


@pytest.mark.parametrize("value", [[1.0, 1.1], (1.0, 1.1)])
def test_two_numbers_are_no_value_of_both_legs(value):
    with pytest.raises(WalkerError, match="`m` must be one number, that of both legs"):
        from_table({"knees": False, "l": 1.0, "c": 0.5, "m": value})


def test_no_units_are_consistent_ones():
    named = from_table({"base": "D", "units": "none"})

    assert named == from_table({"base": "D", "units": "1"})
