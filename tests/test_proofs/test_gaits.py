"""Proved gaits against 25 digits and closed forms, and what must not be proved."""

import math

import numpy as np
import pytest
from flint import arb, arb_mat, ctx

from exact_gaits import GAITS, guess, reference, setting
from gaitsweep.tasks.proofs.body import body
from gaitsweep.tasks.proofs.enclosed_step import dimensions
from gaitsweep.tasks.proofs.enclosure import NotProvedError, Piece
from gaitsweep.tasks.proofs.gait import Proof, prove, solve
from gaitsweep.tasks.proofs.keys import check_written, decimal, double, exact, written
from gaitsweep.tasks.proofs.records import checked, distance, prove_stored, quoted
from gaitsweep.tasks.proofs.signs import zeros
from gaitsweep.tasks.proofs.stability import (
    characteristic,
    multipliers,
    step_derivative,
)
from gaitsweep.tasks.studies import prove_gaits
from gaitsweep.tasks.studies.prove_gaits import prove_one
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import gait, some

NAMES = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "period",
    "kneestrike_time",
)
EACH_STRUCTURE = [
    ("D", "0.009", "long"),
    ("E", "0.01", "short"),
    ("A", "0.01", "long"),
    ("C", "0.01", "short"),
]


def holds(proof, exact_gait):
    """Whether a box holds every number of a gait, whose 25 digits are good to a unit of
    the last.
    """
    for name in NAMES:
        if name in proof.box:
            digits = arb(exact_gait[name])
            ulp = arb(0, 2 * 10.0 ** (math.floor(math.log10(abs(float(digits)))) - 24))
            if not proof.box[name].overlaps(digits + ulp):
                return False
    return True


def check(name, slope, label, accuracy=1e-12):
    known = reference(name, slope, label)
    with ctx.workprec(200):
        proof = prove(setting(name, slope), guess(known), accuracy, label)
        assert proof.proved and proof.first_strike, proof.reason
        assert proof.radius <= accuracy
        assert holds(proof, known)
    assert proof.label == label
    assert proof.stable is (
        max(abs(complex(*map(float, m))) for m in known["multipliers"]) < 1
    )
    kneed = "kneestrike_time" in known
    strikes = [name for name in proof.events if name != "knee_flexes"]
    assert sorted(strikes) == sorted(
        ["legs_pass", *["kneestrike"] * kneed, "heelstrike"]
    )
    assert proof.events[-1] == "heelstrike"
    return proof


@pytest.mark.parametrize(("name", "slope", "label"), EACH_STRUCTURE)
def test_a_gait_of_each_structure_is_proved_to_25_digits(name, slope, label):
    check(name, slope, label)


@pytest.mark.parametrize(
    ("name", "slope", "label"),
    [*EACH_STRUCTURE, ("B", "0.01", "long"), ("C", "0.05", "long")],
)
def test_the_step_maps_derivative_has_the_reference_multipliers(name, slope, label):
    """Coefficients of the characteristic polynomial, every derivative through both
    strikes in them.
    """
    known = reference(name, slope, label)
    solution = solve(setting(name, slope), guess(known), 1e-26)
    values = [complex(*map(float, pair)) for pair in known["multipliers"]]
    m, n = dimensions(solution.body)
    assert all(v == 0 for v in values[m:])
    with ctx.workprec(solution.bits):
        found = characteristic(step_derivative(solution.step.derivative, m, n))
    for coefficient, expected in zip(found, np.poly(values[:m]).real, strict=True):
        assert float(coefficient.rad()) < 1e-12
        assert float(coefficient) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_multipliers_are_enclosed_one_by_one_or_not_at_all():
    with ctx.workprec(106):
        real, upper, lower = multipliers(
            arb_mat([[arb(2, 1e-9), 0, 0], [0, 0, arb(-1, 1e-9)], [0, 1, 0]])
        )
        assert real.real.contains(2) and real.imag == 0
        assert all(
            z.real.contains(0) and (z.imag**2).contains(1) for z in (upper, lower)
        )
        assert float(upper.imag) * float(lower.imag) == pytest.approx(-1)
        assert multipliers(arb_mat([[arb(1, 1e-9), 1], [0, arb(1, 1e-9)]])) == []


@pytest.mark.soak
@pytest.mark.parametrize(
    "known", GAITS, ids=lambda g: f"{g['walker']}-{g['slope']}-{g['gait']}"
)
@pytest.mark.parametrize("accuracy", [1e-12, 1e-20, 1e-30])
def test_every_reference_gait_is_proved(known, accuracy):
    check(known["walker"], known["slope"], known["gait"], accuracy)


def test_more_digits_on_request():
    proof = check("D", "0.009", "long", 1e-30)
    with ctx.workprec(200):
        theta, rate = proof.box["stance_angle"], proof.box["stance_rate"]
        # Garcia et al. 1998: any period-one gait of the simplest walker.
        identity = (
            -2 * (2 * theta).cot() * (theta.sin() * arb(decimal("0.009")).sin()).sqrt()
        )
        assert rate.overlaps(identity)
        assert abs(rate - identity) < 1e-28


@pytest.mark.parametrize(
    "keys", [{"R": "0.1"}, {"R": "0.1", "c_s": "0.4", "r_s": "0.1"}, {"eps_T": "0.1"}]
)
def test_feet_of_vanishing_mass_may_be_round(keys):
    found = prove_one(
        {
            "walker": "D",
            "slope": "0.009",
            "set": keys,
            "gait": "long",
            "accuracy": 1e-12,
        }
    )["gaits"]
    assert [g["proved"] for g in found] == [True], found[0]["reason"]
    # They are the limit of light feet.
    light = prove_one(
        {
            "walker": "D",
            "slope": "0.009",
            "set": {**keys, "m_s": "1e-9"},
            "gait": "long",
            "accuracy": 1e-12,
        }
    )
    assert found[0]["stance_angle"] == pytest.approx(
        light["gaits"][0]["stance_angle"], rel=1e-6
    )


@pytest.mark.parametrize("slope", ["1e-05", "1e-08"])
def test_small_slopes_are_proved(slope):
    check("D", slope, "long")


@pytest.mark.parametrize(("slope", "hyperextends"), [("0.007", True), ("0.009", False)])
def test_release_hyperextension_is_no_strike(slope, hyperextends):
    """Below 0.0079745 the freed knee of C's short step hyperextends first; the
    kneestrike is the return.
    """
    values = gait("C", float(slope), "short")
    proof = prove(setting("C", slope), guess(values), label="short")
    assert proof.proved, proof.reason
    assert (proof.events[0] == "knee_flexes") is hyperextends
    assert proof.events[-2:] == ["kneestrike", "heelstrike"]


@pytest.mark.parametrize(("name", "slope"), [("D", "0.009"), ("C", "0.01")])
def test_a_wrong_approximation_is_refused(name, slope):
    known = guess(reference(name, slope, "long"))
    for k in range(len(known)):
        wrong = [x * (1 + 1e-3 * (i == k)) for i, x in enumerate(known)]
        if name == "D" and k == 2:
            continue  # its thigh's rate follows from the others
        proof = prove(setting(name, slope), wrong)
        assert not proof.proved
        assert "approximation" in proof.reason


@pytest.mark.parametrize(("name", "slope"), [("D", "0.009"), ("C", "0.01")])
def test_numbers_that_are_no_approximation_are_refused(name, slope):
    known = guess(reference(name, slope, "long"))
    for k in range(len(known)):
        for wrong in (math.nan, math.inf, None):
            numbers = [
                wrong if i == k else x for i, x in enumerate(known) if wrong or i != k
            ]
            proof = prove(setting(name, slope), numbers)
            assert not proof.proved and "not made of finite" in proof.reason
    for numbers in (
        [*known[:-1], 0.0],
        [0.0, *known[1:]],
        [known[0], 0.0, 0.0, *known[3:]],
    ):
        proof = prove(setting(name, slope), numbers)
        assert not proof.proved and "is no gait" in proof.reason


def test_a_stored_gait_without_its_kneestrike_is_told_so():
    values = {
        k: v for k, v in stored("C", 0.01, "short").items() if k != "kneestrike_time"
    }
    assert "kneestrike" in ask_stored(values, "C", 0.01, "short")["reason"]


def test_a_gait_of_the_other_label_is_refused():
    proof = prove(
        setting("D", "0.009"), guess(reference("D", "0.009", "long")), label="short"
    )
    assert not proof.proved
    assert proof.reason == "The gait is a long step, not a short one."
    assert (proof.unique, proof.first_strike) == (True, True)


def test_another_walkers_gait_is_refused():
    for keys in ({"m_s": "0.1001"}, {"R": "0.0001"}, {"g": "1.0001"}):
        assert not prove(
            setting("E", "0.01", **keys), guess(reference("E", "0.01", "long"))
        ).proved


@pytest.mark.parametrize(
    ("slope", "proved"),
    [("0.0153620978", True), ("0.0153620977", False), ("0.0153620977243", None)],
)
def test_the_gaits_beside_a_fold(slope, proved):
    """Above the fold of the physical walker with locked knees there are two gaits,
    below it none.
    """
    near = gait("physical-straight", 0.0153625, "long")
    close = [
        0.0990241,
        *(near[name] for name in ("stance_rate", "thigh_rate", "period")),
    ]
    if proved:
        found = prove_one(
            {
                "walker": "physical-straight",
                "slope": slope,
                "gait": "long",
                "accuracy": 1e-12,
            }
        )["gaits"]
        assert [g["proved"] for g in found] == [True]
        return
    assert not prove(setting("physical-straight", slope), close).proved
    if proved is False:
        found = prove_one(
            {
                "walker": "physical-straight",
                "slope": slope,
                "gait": "long",
                "accuracy": 1e-12,
            }
        )["gaits"]
        assert found == []


def test_a_heelstrike_that_all_but_grazes_is_refused_or_right():
    asked = {
        "walker": "physical-straight",
        "slope": "0.0561178",
        "gait": "short",
        "accuracy": 1e-12,
    }
    for g in some(prove_one(asked)["gaits"]):
        assert g["proved"] or "Grazing" in g["reason"] or "Krawczyk" in g["reason"]
        assert g["first_strike"] is g["proved"]
        assert g["unique"] or "Grazing" not in g["reason"]


def test_a_heelstrike_that_grazes_to_all_digits_is_refused():
    """Where the short gait of the physical walker with locked knees ends, its guard's
    rate vanishes.
    """
    known = [
        0.23646155774809144,
        -1.30528579088519,
        -1.109374200723139,
        0.4941851223201976,
    ]
    proof = prove(setting("physical-straight", "0.05611778087370382414527911"), known)
    assert (proof.unique, proof.first_strike, proof.stable) == (True, False, None)
    assert "Grazing" in proof.reason


def cubic(*roots, h=4.0):
    """A motion whose first angle is a cubic of the time with given roots, and its rate."""
    a, b, c = (arb(r) for r in roots)
    q = [-a * b * c, a * b + a * c + b * c, -(a + b + c), arb(1)]
    w = [q[1], 2 * q[2], 3 * q[3]]
    return [(arb(0), [Piece(arb(0), arb(h), [q, [arb(0)] * 4, w, [arb(0)] * 3])])]


def test_zeros_are_counted_with_their_directions():
    sign, found = zeros(cubic(1, 2, 3), (1, 0), "test", 0)
    assert sign == "-"
    assert [z.rises for z in found] == [True, False, True]
    assert all(z.low <= k <= z.high for k, z in enumerate(found, 1))
    assert zeros(cubic(1, 5, 7), (1, 0), "test", 0)[1][0].rises


def test_a_zero_at_the_very_end_is_not_overlooked():
    """Only a strike is known to vanish there: the legs that pass a second time just
    before it were not counted.
    """
    for h in (4.0, 4.0 + 1e-6):
        with pytest.raises(
            NotProvedError, match="at the end of the step is not decided"
        ):
            zeros(cubic(1, 4, 9, h=h), (1, 0), "test", 0)


@pytest.mark.parametrize("roots", [(1, 1, 5), (2, 3, 3)])
def test_a_double_zero_grazes(roots):
    with pytest.raises(NotProvedError, match="Grazing"):
        zeros(cubic(*roots), (1, 0), "test", 0)


def test_a_zero_at_the_start_is_divided_out():
    phases = cubic(0, 1, 3, h=2.0)
    phases[0][1][0].series[0][0] = arb(0, 1e-20)
    sign, found = zeros(phases, (1, 0), "test", 1)
    assert sign == "+"
    assert [z.rises for z in found] == [False]
    with pytest.raises(NotProvedError, match="Grazing"):
        zeros(phases, (1, 0), "test", 0)


def test_legs_that_pass_three_times_are_no_gait():
    from gaitsweep.tasks.proofs.sequence import _legs

    ((begin, (piece,)),) = cubic(1, 2, 3)
    falling = Piece(piece.start, piece.h, [[-x for x in s] for s in piece.series])
    with pytest.raises(NotProvedError, match="the legs pass 3 times"):
        _legs([(begin, [falling])])


def stored(name="D", slope=0.009, label="long"):
    return {
        k: float(v)
        for k, v in gait(name, slope, label).items()
        if k in (*NAMES, "error_bound")
    }


def ask_stored(values, name="D", slope=0.009, label="long"):
    return prove_stored(
        {
            "walker": name,
            "slope": slope,
            "gait": label,
            "accuracy": 1e-12,
            "values": values,
        }
    )


def test_numbers_of_an_archive_are_proved_within_their_bound():
    values = stored()
    found = ask_stored(values)
    assert found["proved"], found["reason"]
    assert found["radius"] <= values["error_bound"] / 10
    assert found["walker"]["l_t"] == "0.5"


@pytest.mark.parametrize(
    "name", ["stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period"]
)
def test_altered_numbers_are_refused(name):
    values = stored()
    for digit in (1e-3, 3 * values["error_bound"]):
        assert not ask_stored({**values, name: values[name] * (1 + digit)})["proved"]
    # In the very last bit a number may change, if it stays within its bound; the box
    # does not move.
    last = ask_stored({**values, name: math.nextafter(values[name], 0)})
    assert (
        last["box"] == ask_stored(values)["box"]
        if last["proved"]
        else "error_bound" in last["reason"]
    )


def test_the_time_of_kneestrike_is_under_no_bound():
    """A gait whose knee strikes almost at once was not proved: `error_bound` does not
    promise so short a time.
    """
    box = {
        name: arb(1)
        for name in (
            "stance_angle",
            "stance_rate",
            "thigh_rate",
            "shank_rate",
            "period",
        )
    }
    proof = Proof(True, box={**box, "kneestrike_time": arb(2e-6)})
    values = {**dict.fromkeys(box, 1.0), "kneestrike_time": 2e-6 + 1e-16}
    assert checked(proof, values, 1e-14).proved
    assert not checked(proof, {**values, "period": 1 + 1e-13}, 1e-14).proved


def test_a_bound_below_the_proved_distance_is_refused():
    values = stored()
    proof = prove(setting("D", "0.009"), guess(reference("D", "0.009", "long")), 1e-20)
    far = distance(
        proof, {k: values[k] * (1 + 1e-10) for k in NAMES if not math.isnan(values[k])}
    )
    assert 9e-11 < float(far) < 2e-10
    assert checked(proof, values, 1e-9).proved
    assert (
        checked(proof, {**values, "period": values["period"] + 1e-8}, 1e-9).proved
        is False
    )


@pytest.mark.parametrize("bound", [0.0, -1e-12, math.nan])
def test_values_without_a_bound_are_refused(bound):
    values = stored()
    moved = {**values, "period": values["period"] * (1 + 1e-7), "error_bound": bound}
    found = ask_stored(moved)
    assert found["unique"] and not found["proved"]
    assert "`error_bound` says" in found["reason"]


@pytest.mark.timeout(60)
def test_a_bound_of_too_many_digits_is_refused_at_once():
    found = ask_stored({**stored(), "error_bound": 1e-300})
    assert found["unique"] and not found["proved"]
    assert found["bits"] < 300
    assert "`error_bound` says 1e-300" in found["reason"]


def test_a_value_that_is_no_number_is_refused():
    found = ask_stored({**stored(), "shank_rate": math.nan})
    assert found["unique"] and not found["proved"]


@pytest.mark.parametrize("keys", [{"R": "0.2"}, {"c_t": "0.1"}])
def test_the_foot_mass_ratio_of_a_table_is_that_of_its_base(keys):
    """Where the table moved the thigh's centre off the hip, proofs were of another
    walker than gaits.
    """
    found, kneed = exact({"base": "E", "foot_mass_ratio": "0.02", **keys})
    walker = resolve(
        {"base": "E", "foot_mass_ratio": 0.02, **{k: float(v) for k, v in keys.items()}}
    )
    assert not kneed
    assert {k: int(v.p) / int(v.q) for k, v in found.items()} == pytest.approx(
        {k: getattr(walker, k) for k in found}
    )
    assert found == exact("E", {"foot_mass_ratio": "0.02", **keys})[0]


def test_keys_are_the_decimals_written():
    assert written(decimal(0.1)) == "0.1"
    assert written(decimal("1e-5")) == "0.00001"
    assert (
        written(double(0.1))
        == "0.1000000000000000055511151231257827021181583404541015625"
    )
    keys, kneed = exact("C")
    assert kneed
    known = "0.022354072433519882669165546566419483143357690937022"
    with ctx.workprec(400):
        assert keys["w_s"].overlaps(arb(known) + arb(0, 1e-50))
        assert keys["w_s"].rad() < 1e-200
        mixed, _ = exact("C", {"detuning": "0.25"})
        assert mixed["w_s"].overlaps(arb(3) / 4 * keys["w_s"] + arb("0.025") / 4)
    light, _ = exact("E", {"foot_mass_ratio": "0.05"})
    assert (written(light["m_s"]), written(light["m_t"])) == ("0.05", "0.45")


@pytest.mark.parametrize(
    "x",
    [("0.1", 0), (3, 0), (0, 1e-5), (-2.5, 1e-30), (1e-7, 1e-20), (12345.678, 1e-12)],
)
def test_printed_intervals_hold_the_ball(x):
    with ctx.workprec(106):
        ball = arb(*x)
        middle, radius = quoted(ball)
    with ctx.workprec(800):
        assert (arb(middle) + arb(0, 1) * arb(radius)).contains(ball)
        assert float(arb(radius)) <= 1.2 * float(ball.rad()) + 1e-3 * abs(float(ball))


@pytest.mark.parametrize("name", ["A", "C"])
def test_doubles_of_a_tuned_walker_stand_for_it(name):
    """At small slopes the rounding of its offsets alone would move the gait by more
    than its bound.
    """
    from gaitsweep.tasks.proofs.keys import doubles
    from gaitsweep.tasks.walkers.catalogue import CATALOGUE

    table = CATALOGUE[name].table()
    keys, kneed = doubles(table)
    with ctx.workprec(400):
        assert body(keys, kneed).leg[0].x.contains(0)
        assert abs(body(keys, kneed).leg[0].x) < 1e-80
        others, _ = doubles({**table, "w_t": table["w_t"] * (1 + 1e-13)})
        assert not body(others, kneed).leg[0].x.contains(0)
        # Whatever the mass of the thigh.
        w_t = -math.tan(table["eps_T"]) * (table["c_t"] + table["m_s"] * table["l_t"])
        keys, _ = doubles({**table, "m_t": 1.0, "w_t": w_t})
        assert keys["w_t"].rad() > 0 and body(keys, kneed).leg[0].x.contains(0)
    values = stored(name, 1e-6, "short")
    found = prove_stored(
        {
            "walker": name,
            "slope": 1e-6,
            "gait": "short",
            "accuracy": 1e-12,
            "values": values,
        }
    )
    assert found["proved"], found["reason"]


def test_only_numbers_are_checked_to_be_written_out():
    check_written(
        {
            "base": "C",
            "name": "nan",
            "units": "SI",
            "m_t": "1e-5",
            "R": 0.1,
            "w_t": "-0.00",
        }
    )
    for text in ("1e-9999", "0." + "0" * 999 + "1", "0e123456"):
        with pytest.raises(WalkerError, match="`w_t` must"):
            check_written({"base": "C", "w_t": text})


def test_a_gait_is_proved_under_its_label(monkeypatch):
    labels = []
    monkeypatch.setattr(
        prove_gaits,
        "prove",
        lambda setting, guess, accuracy, label: labels.append(label),
    )
    monkeypatch.setattr(prove_gaits, "record", lambda *_: {})
    prove_one({"walker": "D", "slope": 0.009, "accuracy": 1e-12})
    assert labels == ["long", "short"]
