"""Each lemma of docs/proofs.md: what an enclosure must hold, it holds."""

import random

import mpmath as mp
import numpy as np
import pytest
from flint import arb, arb_mat, ctx

import extended
from exact_gaits import (
    SLOPE,
    STATE,
    check_durations,
    check_remainder,
    coarse,
    fine,
    state,
    walker,
)
from gaitsweep.tasks.proofs import enclosure as flows
from gaitsweep.tasks.proofs.collisions import heelstrike, kneestrike
from gaitsweep.tasks.proofs.enclosed_step import Region, step
from gaitsweep.tasks.proofs.enclosure import Accuracy, enclose, enclose_derivative
from gaitsweep.tasks.proofs.keys import (
    check_written,
    decimal,
    exact,
    in_doubles,
    written,
)
from gaitsweep.tasks.proofs.krawczyk import contained, image
from gaitsweep.tasks.proofs.motion import Motion, Variation, evaluate, velocity
from gaitsweep.tasks.proofs.stability import is_stable, step_derivative
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from oracle import Oracle, SimplestWalker

PHASES = [("D", 2), ("E", 2), ("B", 2), ("A", 2), ("C", 3), ("C", 2), ("physical", 3)]


@pytest.fixture(autouse=True)
def precision():
    with ctx.workprec(106):
        yield


def oracle(name):
    return SimplestWalker() if name == "D" else Oracle(CATALOGUE[name].table())


def doubles(values):
    return np.array([float(x) for x in values])


@pytest.mark.parametrize(("name", "links"), PHASES)
def test_the_equations_of_motion_are_those_of_the_second_derivation(name, links):
    found = doubles(velocity(walker(name), arb(SLOPE), state(links))[links:])
    q, w = (np.array([*x[:links], *[x[links - 1]] * (3 - links)]) for x in STATE)
    expected = oracle(name).accelerations(np.concatenate([q, w]), SLOPE, links == 2)[
        :links
    ]
    assert found == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", ["D", "E", "B", "A", "C", "physical"])
def test_heelstrike_is_that_of_the_second_derivation(name):
    angle, rates = -0.23, np.array([-0.8, 0.35])
    before = np.array([angle, -angle, -angle, rates[0], rates[1], rates[1]])
    found = np.array(heelstrike(walker(name), arb(angle))[0].tolist(), float) @ rates
    assert found == pytest.approx(
        oracle(name).heelstrike(before)[0][3 : 3 + len(found)], rel=1e-12
    )


@pytest.mark.parametrize("name", ["C", "physical"])
def test_kneestrike_is_that_of_the_second_derivation(name):
    angles, rates = np.array([0.1, -0.25, -0.25]), np.array(STATE[1])
    found = (
        np.array(kneestrike(walker(name), arb(0.1), arb(-0.25))[0].tolist(), float)
        @ rates
    )
    assert found == pytest.approx(
        oracle(name).kneestrike(np.concatenate([angles, rates]))[0][3:5], rel=1e-12
    )


@pytest.mark.parametrize("which", [0, 1, 2])
def test_an_impacts_derivative_is_the_limit_of_its_differences(which):
    ctx.prec = 400
    body, h = walker("C"), arb(2) ** -100
    if which == 2:
        value, slope = (
            (heelstrike(body, arb(-0.2) + k * h)[0] for k in (-1, 1)),
            heelstrike(body, arb(-0.2))[1],
        )
    else:
        at = [arb(0.1), arb(-0.3)]
        value = (
            kneestrike(body, *[x + k * h * (i == which) for i, x in enumerate(at)])[0]
            for k in (-1, 1)
        )
        slope = kneestrike(body, *at)[1 + which]
    low, high = value
    away = (high - low) * (1 / (2 * h)) - slope
    assert max(float(x.abs_upper()) for x in away.entries()) < 1e-55


@pytest.mark.parametrize(("name", "links"), PHASES)
def test_the_variations_are_the_limit_of_differences(name, links):
    """Taylor coefficients of derivatives, of the slope's too, against differences of
    coefficients.
    """
    ctx.prec = 400
    body, h, order = walker(name), arb(2) ** -100, 7
    x = state(links)
    random.seed(links)
    direction = [arb(random.uniform(-1, 1)) for _ in range(2 * links + 1)]

    def moved(k):
        shifted = [start + k * h * d for start, d in zip(x, direction, strict=False)]
        motion = Motion(body, arb(SLOPE) + k * h * direction[-1], shifted, order)
        return [s[order] for s in motion.series]

    motion = Motion(body, arb(SLOPE), x, order)
    change = Variation(
        motion,
        arb_mat([[d] for d in direction[:-1]]),
        arb_mat([[direction[-1]]]),
        order,
    )
    for low, high, found in zip(
        moved(-1), moved(1), change.terms[order].entries(), strict=True
    ):
        assert abs((high - low) / (2 * h) - found) < 1e-50


@pytest.mark.parametrize(("name", "links"), PHASES)
def test_a_poor_enclosure_holds_the_motion_to_512_bits(name, links):
    check_remainder(name, links)


@pytest.mark.parametrize(("name", "links"), [("B", 2), ("C", 3)])
def test_an_enclosure_holds_the_motions_of_the_first_reference(name, links):
    """The other reference derives its equations by machine and integrates in 113 bits."""
    time = float(0.6 * walker(name).time_unit)
    found = coarse(name, links, 0.0, order=26, tolerance=1e-21)
    keys, kneed = exact(name)
    table = {k: written(v).strip("[]").split(" ")[0] for k, v in keys.items()}
    reference = extended.Walker({**table, "knees": kneed}, str(SLOPE))
    q, w = STATE
    carry = reference.two_link if links == 2 else reference.three_link
    end = carry([*q[:links], *w[:links]], mp.mpf(time))
    for x, ball in zip(end, found.middle, strict=True):
        assert abs(arb(str(x)) - ball) < 1e-18


@pytest.mark.parametrize(("name", "links"), [("D", 2), ("A", 2), ("C", 3)])
def test_a_box_of_starts_ends_in_the_enclosure(name, links):
    """Corners and inner points of a box of starts, and the derivative by a difference
    of two of them.
    """
    spread, random_state = 1e-5, random.Random(7)
    found = coarse(name, links, spread, order=12, tolerance=1e-9)
    ends = []
    for _ in range(3):
        offset = [
            random_state.choice((-1, 1, 0.3)) * 0.999 * spread for _ in range(2 * links)
        ]
        start = [x + arb(o) for x, o in zip(state(links), offset, strict=True)]
        end = fine(name, start, float(0.6 * walker(name).time_unit))
        ends.append((offset, end))
        for x, ball in zip(end, found.state, strict=True):
            assert ball.contains(x)
    (one, end), (other, end_2), _ = ends
    along = (
        found.derivative * arb_mat([[a - b] for a, b in zip(one, other, strict=True)])
    ).entries()
    assert all(
        ball.overlaps(x - y) for ball, x, y in zip(along, end, end_2, strict=True)
    )
    # Mean value: a difference of ends is some derivative in the enclosure times the
    # difference of starts.
    assert all(
        ball.contains((x - y).mid())
        for ball, x, y in zip(along, end, end_2, strict=True)
    )


def test_the_first_box_holds_the_motion_all_along():
    body, h = walker("C"), 0.1
    x = state(3)
    time = arb(h * body.time_unit)
    box = enclose(body, arb(SLOPE), x, time)
    motion, wide = Motion(body, arb(SLOPE), x), Motion(body, arb(SLOPE), box, 1)
    start = arb_mat([[int(i == j) for j in range(6)] for i in range(6)])
    all_along = enclose_derivative(Variation(wide, start), time)
    change = Variation(motion, start)
    for _ in range(25):
        motion.grow()
        change.grow()
    for k in range(0, 101, 5):
        t = time * k / 100
        now = [evaluate(s, t) for s in motion.series]
        assert all(b.contains(x.mid()) for b, x in zip(box, now, strict=True))
        assert all(
            b.contains(x.mid())
            for b, x in zip(
                all_along.entries(), evaluate(change.terms, t).entries(), strict=True
            )
        )


def test_the_derivative_holds_for_every_duration_of_the_bracket():
    check_durations()


def test_the_derivative_along_a_tangent_is_the_matrix_times_it():
    body = walker("C")
    gait = [
        arb(x)
        for x in (
            0.2119341535619156,
            -0.9289954532878475,
            -0.7597477869493247,
            0.4823169469398292,
            0.7909041462861649,
            0.01,
        )
    ]
    tangent = [arb(x) for x in (1.5, -2.0, 0.3, 0.7, -1.1, 1.0)]
    offsets = [arb(0, 1e-15)] * 6
    found = step(body, Region(gait, offsets, tangent, arb(1e-15)), Accuracy(24, 1e-18))
    product = (found.derivative * arb_mat([[t] for t in tangent])).entries()
    for ball, other in zip(found.along, product, strict=True):
        assert ball.overlaps(other)
        assert abs(ball - other) < 1e-7


def test_krawczyk_finds_one_zero_and_refuses_two():
    def box(middle, size):
        c, x = arb(middle), arb(middle, size)
        return [x], [c + k for k in image([x - c], [c * c - 2], arb_mat([[2 * x]]))]

    x, K = box(1.414, 1e-3)
    assert contained(K, x)
    assert K[0].contains(arb(2).sqrt().mid())
    x, K = box(1.3, 1e-3)
    assert not contained(K, x)
    x, K = box(0.001, 2.0)
    assert not contained(K, x)


@pytest.mark.parametrize("size", [2, 3])
def test_jury_agrees_with_eigenvalues(size):
    draw = np.random.default_rng(size)
    seen = set()
    for _ in range(300):
        A = draw.normal(size=(size, size)) * 0.7
        radius = np.abs(np.linalg.eigvals(A)).max()
        assert is_stable(arb_mat(A.tolist())) is bool(radius < 1)
        seen.add(radius < 1)
        wide = arb_mat([[arb(x, 10.0) for x in row] for row in A.tolist()])
        assert is_stable(wide) is None
    assert len(seen) == 2


def test_a_multiplier_on_the_circle_is_not_judged():
    for on_circle in (
        [[1, 0], [0, 0.5]],
        [[-1, 0], [0, 0.5]],
        [[0.6, 0.8], [-0.8, 0.6]],
    ):
        assert (
            is_stable(arb_mat([[arb(x, 1e-15) for x in row] for row in on_circle]))
            is None
        )


def test_event_times_are_eliminated_from_the_derivative():
    # Guard x + 2 t, image 3 x + 5 t: the map's derivative is 3 - 5 / 2.
    assert step_derivative(arb_mat([[1, 2], [3, 5]]), 1, 1)[0, 0].contains(arb(0.5))


def test_an_enclosure_that_grows_too_wide_is_given_up():
    with pytest.raises(flows.NotProvedError, match="Taylor|box"):
        coarse("C", 3, 0.3, time=3.0)


@pytest.mark.parametrize("read", [str, float])
def test_a_leg_of_one_link_is_exactly_that_which_is_solved(read):
    """Its lengths are the decimals written, and its shank has its centre."""
    one = {
        "m": read("0.1"),
        "c": read("0.7"),
        "r": read("0.2"),
        "l": read("0.9"),
        "R": read("0.1"),
    }
    keys, _ = exact({"knees": False, **one})
    assert (keys["c_t"], keys["c_s"], keys["r_s"], keys["l_s"]) == tuple(
        map(decimal, ("0.7", "0.25", "0.2", "0.55"))
    )


def test_the_masses_beside_a_thigh_without_mass_are_those_of_the_walker_solved():
    thigh = {"m_t": 0.0, "c_t": 0.2, "m_h": 0.8}
    own = {**CATALOGUE["E"].table(), **thigh}
    keys, _ = exact(own, {"foot_mass_ratio": "0.05"})
    solved = resolve(own, {"foot_mass_ratio": 0.05})
    assert [float(keys[k].p) / float(keys[k].q) for k in ("m_t", "m_s", "m_h")] == [
        solved.m_t,
        solved.m_s,
        solved.m_h,
    ]


def test_a_table_may_hold_derived_keys():
    for name, key, value in (
        ("E", "foot_mass_ratio", "0.02"),
        ("C", "detuning", "0.5"),
    ):
        table, line = exact({"base": name, key: value})[0], exact(name, {key: value})[0]
        assert all(written(table[k]) == written(line[k]) for k in line)
    changed = {"foot_mass_ratio": "0.02", "R": "0.2", "c_t": "0.1"}
    table, line = exact({"base": "E", **changed})[0], exact("E", changed)[0]
    assert all(written(table[k]) == written(line[k]) for k in line)


@pytest.mark.parametrize("beside", [{}, {"foot_mass_ratio": "0.03"}, {"g": "2"}])
@pytest.mark.parametrize(
    "end",
    [
        "D",
        {"base": "E", "R": "0.3"},
        {"base": "E", "foot_mass_ratio": "0.01", "c_t": "0.1"},
    ],
)
def test_a_way_between_two_walkers_is_exact(end, beside):
    """Each key on the way is the decimal that is meant; where feet have a share, no
    other mass may move.
    """
    if "foot_mass_ratio" in beside and (end == "D" or "foot_mass_ratio" in end):
        with pytest.raises(ValueError, match="and so does `detuning`"):
            resolve({"base": "E", "toward": in_doubles(end) if isinstance(end, dict) else end, "detuning": 0.1},
                    in_doubles(beside))  # fmt: skip
        return
    table = {"base": "E", "toward": end}
    check_written(table)
    with pytest.raises(
        ValueError, match="`R` must be 0 or a number that doubles resolve"
    ):
        check_written({"toward": {"R": "1e-400"}})
    keys, _ = exact(table, {"detuning": "0.3", **beside})
    solved = resolve(in_doubles(table), {"detuning": 0.3, **in_doubles(beside)}).table()
    assert {k: float(arb(v)) for k, v in keys.items()} == pytest.approx(
        {k: solved[k] for k in keys}, rel=1e-15
    )
    if "R" in end:
        assert written(keys["R"]) == "0.09"
    tuned, _ = exact({**table, "tuned": ["w_t"]}, {"detuning": "0.3", **beside})
    assert {k: float(arb(v)) for k, v in tuned.items()} == pytest.approx(
        {k: solved[k] for k in tuned}, rel=1e-15
    )


def test_a_way_from_a_tuned_walker_begins_at_its_exact_offsets():
    named = exact({"base": "A", "toward": "physical-straight"}, {"detuning": "0.3"})[0]
    without = exact("A", {"detuning": "0.3"})[0]
    assert {key: written(value) for key, value in named.items()} == {
        key: written(without[key]) for key in named
    }


@pytest.mark.parametrize("changes", [{"R": "0.2000001"}, {"g": "4", "m_h": "2"}])
def test_detuning_leaves_the_keys_that_it_does_not_set(changes):
    """A table of `detuning` and of keys that it does not own is the walker that is
    solved.
    """
    known = resolve(
        {"base": "C", "detuning": 0.5, **{k: float(v) for k, v in changes.items()}}
    ).table()
    keys, _ = exact({"base": "C", "detuning": "0.5", **changes})
    assert {k: float(arb(v)) for k, v in keys.items()} == pytest.approx(
        {k: known[k] for k in keys}, rel=1e-15
    )
    assert {k: written(keys[k]) for k in changes} == changes
