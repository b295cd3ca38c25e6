"""Random walkers far beyond the paper's: every try ends in a status, no wrong gait is
accepted, every bound holds.
"""

import math

import numpy as np
import pytest

import oracle
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.studies.solve_points import atlas, points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import from_table
from gaitsweep.tasks.walkers.walker import NUMBERS, WalkerError
from soak import stress
from soak.bounds import bounds
from soak.stress import random_walker


def off(gait):
    """How far one step of the second derivation, with scipy's events, lands from an
    accepted gait, relative.
    """
    model = (
        oracle.SimplestWalker()
        if gait.family == "massless foot"
        else oracle.Oracle(gait.walker.table())
    )
    rates = np.array(gait.rates if model.knees else gait.rates[:2])
    try:
        step = model.step(
            gait.angle, rates, gait.slope, rtol=1e-8, atol=1e-9 * gait.angle
        )
    except oracle.StepFailed:  # a heelstrike that all but grazes is seen closely only
        model.longest_step = 0.002
        step = model.step(
            gait.angle, rates, gait.slope, rtol=1e-12, atol=1e-13 * gait.angle
        )
    size = np.abs(gait.rates).max()
    moved = np.abs(step.rates[: len(rates)] - rates).max() / size
    return max(
        abs(step.theta / gait.angle - 1), moved, abs(step.period / gait.period - 1)
    )


def sample(found, count):
    """Accepted gaits, as many of each family; the second derivation adds angles of one
    to a step's.
    """
    random = np.random.default_rng(0)
    families = list(dict.fromkeys(gait.family for gait in found.accepted))
    chosen = []
    for family in families:
        of = [
            gait
            for gait in found.accepted
            if gait.family == family and gait.angle > 1e-8
        ]
        chosen += [
            of[i] for i in random.permutation(len(of))[: max(1, count // len(families))]
        ]
    return chosen


def judge(found, count):
    print(found.text())
    assert not found.wrong, found.wrong[:3]
    for gait in sample(found, count):
        # The oracle's tolerance, carried over a stride by its derivative, and its
        # rounding: its mass matrices hold bodies a hundred million times lighter than
        # others.
        light = (
            min(m for m in (gait.walker.m_s, gait.walker.m_t, 1.0) if m)
            / gait.walker.total_mass
        )
        assert off(gait) < (1e-6 + 1e-14 / light) * max(1.0, gait.multiplier), gait


@pytest.mark.parametrize(
    ("count", "checked"),
    [(700, 5), pytest.param(1_000_000, 300, marks=pytest.mark.soak)],
)
def test_random_lanes_end_in_a_status_and_no_wrong_gait_is_accepted(count, checked):
    found = stress.lanes(count)
    assert found.tries == sum(
        round(share * count) for share, _ in stress.FAMILIES.values()
    )
    # Bounded work: Newton's most iterations, the polish, the verdicts and the Lipschitz
    # estimate.
    assert found.strides < 60 * found.tries
    judge(found, checked)


@pytest.mark.soak
def test_random_lines_end_in_a_status_and_no_wrong_gait_is_accepted():
    judge(stress.lines(2000), 100)


def test_a_random_line_of_the_product_says_what_became_of_every_point():
    walker = random_walker("round feet", 5)
    line = {"walker": walker.table(), "set": {}}
    slope = np.geomspace(1e-12, 0.3, 9)
    found = points(
        {"line": line, "slope": slope, "want": ("stance_angle",)},
        [atlas({"line": line}, [])],
    )
    assert (np.isfinite(found["stance_angle"]) == (found["status"] == 0)).all()


@pytest.mark.parametrize(
    ("each", "walkers"),
    [
        (
            24,
            [
                ("D", CATALOGUE["D"]),
                ("B", CATALOGUE["B"]),
                ("tuned", random_walker("straight, tuned", 34)),
            ],
        ),
        pytest.param(2300, None, marks=pytest.mark.soak),
    ],
)
def test_every_bound_holds_and_is_no_hundred_times_too_wide(each, walkers):
    found = bounds(each, walkers=walkers)
    for row in found.rows():
        print(row)
    assert found.violations == 0
    assert np.median(found.bound / np.maximum(found.error, 1e-18)) < 100
    if walkers is None:
        assert len(found.error) > 1e5
    # Where slopes vanish more digits are used by themselves.
    assert {0, 1, 2} <= set(found.tier)
    assert found.error[found.slope < 1e-7].max() < 1e-12


def test_no_bound_is_shown_to_hold_by_a_reference_that_did_not_converge(monkeypatch):
    solved = extended_precision.solved

    def lost(*args):
        return solved(*args)._replace(error=math.inf)

    monkeypatch.setattr(extended_precision, "solved", lost)
    found = bounds(6, walkers=[("D", CATALOGUE["D"])])
    assert found.violations == len(found.error) > 0


@pytest.mark.parametrize("name", ["D", "E", "B", "C"])
def test_a_degenerate_walker_is_refused_in_one_line_or_has_finite_constants(name):
    from gaitsweep.tasks.mechanics.lumped import lump

    odd = (
        0.0,
        -0.0,
        5e-324,
        1e-310,
        1e-160,
        1e-49,
        1e-8,
        -1.0,
        1e8,
        1e49,
        1e160,
        1e308,
        math.inf,
        -math.inf,
        math.nan,
        True,
        None,
        "x",
        10**400,
    )
    for key in NUMBERS:
        for value in odd:
            try:
                walker = from_table({**CATALOGUE[name].table(), key: value})
            except WalkerError as refused:
                assert (
                    refused.key in NUMBERS
                    and len(str(refused).splitlines()) == 1
                    and len(str(refused)) < 200
                )
            else:
                assert all(map(math.isfinite, lump(walker).values())), (key, value)


def test_a_leg_without_inertia_is_refused():
    with pytest.raises(WalkerError, match="inertia about the hip"):
        from_table({**CATALOGUE["B"].table(), "m_t": 0.0, "m_h": 1.0, "c_s": -0.5})
