"""Period-n gaits: the scaling of the logistic map, D's published flip, C's, and the
families of other periods.
"""

from dataclasses import replace

import numpy as np
import pytest

from gaitsweep.tasks.branches import passings
from gaitsweep.tasks.branches.atlas import from_arrays, survey, to_arrays
from gaitsweep.tasks.branches.special_points import flips as flips_of
from gaitsweep.tasks.contract import columns
from gaitsweep.tasks.contract.registry import OPTIONS
from gaitsweep.tasks.fits.feigenbaum import DELTA, accumulation, ratios
from gaitsweep.tasks.orbits import crisis
from gaitsweep.tasks.orbits.crisis import surviving_slopes
from gaitsweep.tasks.orbits.initial_states import gaits_at
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies import locate_cascade
from gaitsweep.tasks.studies.followed import followed_over
from gaitsweep.tasks.studies.locate_cascade import cascade
from gaitsweep.tasks.walkers.resolve import resolve
from lines import _atlas

#: Period doublings of x -> r x (1 - x), and where they accumulate.
LOGISTIC = [
    3.0,
    3.449489742783178,
    3.544090359551923,
    3.564407266095433,
    3.568759419543826,
    3.569691609801374,
]


def doublings(walker, low, high, n=2, **options):
    line = {"walker": walker, "set": {}}
    return cascade(
        {"line": line, "slope": np.linspace(low, high, n), **options},
        [_atlas(walker, ())],
    )


def test_scaling_of_the_logistic_map():
    value, low, high = accumulation(np.array(LOGISTIC))
    assert low < 3.569945671870944 < high
    assert value == pytest.approx(3.569945671870944, abs=2e-6)
    assert ratios(np.array(LOGISTIC))[-1] == pytest.approx(4.6692, abs=0.01)
    assert np.isnan(accumulation(np.array(LOGISTIC[:2]))).all()


def test_the_cascade_of_d():
    found = doublings("D", 0.0145, 0.0195, periods=64)
    slopes = found["cascade/slope"]
    assert found["cascade/period"].tolist() == [1, 2, 4, 8, 16, 32, 64]
    assert slopes[0] == pytest.approx(0.015088437941119463562, rel=1e-13)
    # Published by Garcia et al. (1998) as 0.017 and on, chaos to 0.019.
    assert slopes[1] == pytest.approx(0.0176693748625, rel=1e-10)
    assert found["cascade/ratio"][-1] == pytest.approx(DELTA, abs=0.05)
    assert (found["cascade/error_bound"] < 1e-10).all()
    assert (
        columns.table_columns()["cascade/error_bound"][1]
        == "largest relative error of the slope"
    )
    assert found["cascade/walks"].all()
    assert found["accumulation/slope"] == pytest.approx(0.018293397965, abs=2e-10)
    assert found["accumulation/high"] - found["accumulation/low"] < 1e-9
    assert found["accumulation/stopped"].tolist() == [
        "The longest period of the search, 64, is reached."
    ]
    # Orbits from a thousandth around the gait, 200 of them at each of 11 slopes: lost
    # from 0.019040 to 0.019045.
    assert 0.01903 < found["lost/low"][0] < found["lost/high"][0] < 0.01906


def test_a_cascade_tells_why_it_stopped():
    found = doublings("D", 0.0145, 0.0171, periods=8, steps=0)
    assert found["cascade/period"].tolist() == [1] and found[
        "cascade/family"
    ].tolist() == ["1"]
    (stopped,) = found["accumulation/stopped"]
    assert "nothing/reason" not in found
    assert (
        stopped
        == "No flip of period 2: the next one lies outside the window, at a slope of 0.0176694."
    )
    (none,) = doublings("D", 0.0100, 0.0120, periods=8, steps=0)["accumulation/stopped"]
    assert none.startswith(
        "No flip of period 1: the branch leaves the window at a slope of 0.012."
    )


def test_a_flip_that_does_not_lie_between_its_points_is_not_taken(monkeypatch):
    solve = passings.solve

    def astray(*asked):
        point = solve(*asked)
        point.Z[1] += 0.4
        return point

    monkeypatch.setattr(passings, "solve", astray)

    found = doublings("D", 0.0145, 0.0171, periods=8, steps=0)

    assert found["accumulation/stopped"][0].startswith(
        "No flip of period 1: the next one could not be located"
    )


def test_a_cascade_tells_what_it_could_not_begin_with():
    absent = doublings("physical-straight", 0.005, 0.01, steps=0)
    assert absent["accumulation/stopped"].tolist() == [
        "No long gait at slopes from 0.005 to 0.01."
    ]
    assert (absent["accumulation/family"][0], absent["accumulation/flips"][0]) == (
        "1",
        0,
    )
    assert absent["nothing/reason"].tolist() == absent["accumulation/stopped"].tolist()
    assert (
        "families of other periods" in OPTIONS["cascade"]["starts"].meaning
    )  # to which `starts` belongs
    absent = doublings("D", 0.001, 0.002, families=[5], periods=20, starts=20, steps=0)
    assert absent["accumulation/stopped"].tolist() == [
        "No gait of period 5 was found at slopes from 0.001 to 0.002."
    ]


@pytest.mark.parametrize("sign", [1, -1])
def test_the_loss_of_walking_is_searched_beyond_the_doublings_and_in_the_window(
    monkeypatch, sign
):
    """Of doublings towards smaller slopes it was searched down to negative ones, and
    its ends were exchanged.
    """
    flips = 0.1 + sign * 0.04 * (1 - DELTA ** -np.arange(4.0))
    problem, searched = Problem(resolve("D")), []
    (gait,) = (
        flip
        for branch in from_arrays(_atlas("D", ()))
        for flip in flips_of(problem, branch)
    )
    gaits = [replace(gait, Z=np.vstack([gait.w, [[q]]])) for q in np.log(flips)]

    def lost(problem, attractors, strides):
        ((_, low, high),) = attractors
        searched.append((low, high))
        return [(low + 0.25 * (high - low), low + 0.5 * (high - low))]

    monkeypatch.setattr(locate_cascade, "_first_gaits", lambda *_: [None])
    events = [locate_cascade._Event("flip", gait, 0.0) for gait in gaits]
    family = locate_cascade._Family(events, "")
    monkeypatch.setattr(locate_cascade, "_follow_family", lambda *_: family)
    monkeypatch.setattr(locate_cascade, "lost", lost)
    found = cascade(
        {"line": {"walker": "D", "set": {}}, "slope": np.array([0.04, 0.16])}, [{}]
    )
    assert searched == [pytest.approx((0.1 + sign * 0.04, 0.1 + sign * 0.06))]
    ends = sorted((0.1 + sign * 0.045, 0.1 + sign * 0.05))
    assert [found["lost/low"][0], found["lost/high"][0]] == pytest.approx(ends)


def test_a_cascade_begins_where_its_branch_does():
    """Where the window begins below the branch, nothing was located, and nothing said."""
    line, own = (
        {"walker": "A", "set": {"detuning": 0.2}},
        _atlas("A", (("detuning", 0.2),)),
    )
    low, high = (
        cascade(
            {"line": line, "slope": np.array([begin, 0.1]), "periods": 1, "steps": 0},
            [own],
        )
        for begin in (1e-4, 0.02)
    )
    assert low["cascade/kind"].tolist() == high["cascade/kind"].tolist() == ["flip"]
    assert low["cascade/slope"] == pytest.approx(high["cascade/slope"], rel=1e-12)


def test_the_first_flips_of_c():
    found = doublings("C", 0.07, 0.1, periods=8, steps=0)
    assert found["cascade/slope"][0] == pytest.approx(0.0769, abs=5e-5)
    assert found["cascade/ratio"][-1] == pytest.approx(DELTA, abs=0.1)


def test_the_period_three_family_near_0_0125():
    found = doublings(
        "D", 0.0122, 0.0130, n=3, families=[3], periods=12, starts=200, steps=60
    )
    assert found["cascade/kind"].tolist() == ["fold", "flip", "flip", "flip"]
    assert found["cascade/slope"][:2] == pytest.approx(
        [0.0122808216, 0.0126349598], abs=1e-9
    )
    assert found["cascade/walks"].all()
    # Of 600 starts of a lattice some stay at 0.01292 and all leave for period one at
    # 0.01294.
    assert 0.01290 < found["lost/low"][0] < found["lost/high"][0] < 0.01294


def test_guesses_of_a_search_are_corrected_side_by_side(monkeypatch):
    """Each of sixty was corrected by itself; the exact map takes but distinct gaits."""
    problem, corrected, newton = Problem(resolve("D")), [], locate_cascade.newton
    monkeypatch.setattr(
        locate_cascade,
        "newton",
        lambda *a, **k: corrected.append(a[1].shape[1]) or newton(*a, **k),
    )
    branches = from_arrays(_atlas("D", ()))
    orbits = locate_cascade.Orbits(problem, branches, np.array([0.0126]), 3, 200)
    found = orbits.cycles(3)
    assert [gait.at.stride.steps for gait in found] == [3, 3]  # of both sides of a fold
    coarsely, exactly = corrected
    assert coarsely > exactly == len(found)


def test_of_a_fold_one_side_is_followed(monkeypatch):
    """Both were, through all their doublings, and one was dropped."""
    followed, switch = [], locate_cascade.doubled
    monkeypatch.setattr(
        locate_cascade,
        "doubled",
        lambda *a: followed.append(a[0].problem.steps) or switch(*a),
    )
    found = doublings(
        "D", 0.0122, 0.0128, n=4, families=[3], periods=6, steps=0, starts=200
    )
    assert found["cascade/kind"].tolist() == ["fold", "flip", "flip"] and followed == [
        3
    ]


def test_events_are_located_in_few_evaluations(monkeypatch):
    """A dozen corrections were made for each, of four or five evaluations: from the far
    ends, and of these anew.
    """
    problem = Problem(resolve("D"))
    (start,) = locate_cascade._first_gaits(
        problem, problem, _atlas("D", ()), np.array([0.0145, 0.016]), 1, 1
    )
    begun = (start, np.array([0.0, 0.0, 0.0, 1.0]), 0.02)
    evaluated, solve = [], passings.solve

    def counted(equations, guess):
        stride = Problem.stride
        with monkeypatch.context() as patched:
            patched.setattr(
                Problem,
                "stride",
                lambda *a, **more: evaluated.append(1) or stride(*a, **more),
            )
            return solve(equations, guess)

    monkeypatch.setattr(passings, "solve", counted)
    window = np.log(0.0145), np.log(0.016)
    event, _ = locate_cascade._first_event(problem, begun, "flip", window)
    assert event.slope == pytest.approx(0.015088437941119463562, rel=1e-13)
    assert 0 < len(evaluated) < 8


def test_an_event_that_is_not_located_is_told(monkeypatch):
    solve = passings.solve
    monkeypatch.setattr(
        passings,
        "solve",
        lambda *of: replace(found := solve(*of), ok=np.zeros_like(found.ok)),
    )
    (stopped,) = doublings("D", 0.0145, 0.0195, periods=2, steps=0)[
        "accumulation/stopped"
    ]
    assert stopped.startswith(
        "No flip of period 1: the next one could not be located, near a slope of 0.01"
    )


def test_a_walkers_cascade_begins_at_a_neighbours_gait():
    """Corners of a walker's rounding had atlases of their own."""
    line = {"walker": "E", "set": {"foot_mass_ratio": 3e-3}}
    options = {"slope": np.array([0.0135, 0.018]), "periods": 1, "steps": 0}
    own = cascade(
        {"line": line, **options}, [_atlas("E", (("foot_mass_ratio", 3e-3),))]
    )
    near = cascade(
        {"line": line, "near": {"walker": "D", "set": {}}, **options}, [_atlas("D", ())]
    )
    assert own["cascade/kind"].tolist() == near["cascade/kind"].tolist() == ["flip"]
    assert near["cascade/slope"] == pytest.approx(own["cascade/slope"], rel=1e-12)


def test_first_intervals_far_from_the_law_are_no_hindrance():
    """B's period two lasts over a factor of twenty in slope, its period four over a
    tenth.
    """
    found = doublings("B", 3e-4, 0.03, periods=4, steps=0)
    assert found["cascade/period"].tolist() == [1, 2, 4]
    assert found["cascade/slope"] == pytest.approx(
        [0.000490856, 0.0104758, 0.0116164], rel=1e-5
    )


def test_orbits_last_below_the_end_of_walking_and_not_above():
    problem = Problem(resolve("D"))
    slopes = np.array([0.012, 0.0165, 0.0185, 0.0193])
    _, gaits = gaits_at(problem, from_arrays(_atlas("D", ())), slopes, "long")
    spread = 1 + 1e-3 * np.linspace(-1, 1, 16)
    trials = [(gaits[:, [k]] * spread, slopes[[k]]) for k in range(4)]
    last = np.concatenate(surviving_slopes(problem, trials, 120)).tolist()
    # At 0.012 they settle on period one, which is no attractor of a cascade beyond its
    # doublings.
    assert last == [False, True, True, False]
    trial = gaits[:, [2]] * spread, slopes
    (alone,) = surviving_slopes(problem, [trial], 120)
    assert alone.tolist()[2:] == [True, False]


#: Orbits of a bracket, whatever they are.
MANY = np.zeros((3, 640))


def bracket_where(monkeypatch, survives, low, high):
    """The bracket of a loss, by which slopes orbits survive at."""

    def side_by_side(problem, trials, strides):
        return [survives(*trial) for trial in trials]

    monkeypatch.setattr(crisis, "surviving_slopes", side_by_side)
    (found,) = crisis.lost(None, [(MANY, low, high)], 50)
    return found


def test_a_bracket_of_a_few_orbits_is_begun_anew_where_more_are_lost(monkeypatch):
    def survives(starts, slope):
        return slope < (0.0131 if starts.shape[1] > crisis._FEW else 0.0137)

    low, high = bracket_where(monkeypatch, survives, 0.01, 0.02)
    assert low < 0.0131 < high < 0.0137 and high - low < 1e-4


@pytest.mark.thorough
def test_brackets_of_one_loss_over_the_push_off_overlap():
    """Studies to other periods begin their orbits elsewhere; 3000 steps of 32 of them
    told the same to all (brackets of 200 steps were disjoint).
    """
    line = {"walker": "D", "set": {}, "slope": 0.0}
    params = {"line": line, "along": "push_off", "slope": np.array([0.05, 0.3])}
    problem, _ = followed_over(params)
    atlas = to_arrays(survey(problem))
    lows, highs = [], []
    for periods in (8, 16, 32):
        found = cascade(params | {"periods": periods, "steps": 200}, [atlas])
        lows.append(found["lost/low"][0])
        highs.append(found["lost/high"][0])
    assert max(lows) < min(highs)
    assert 0.1636 < max(lows) < min(highs) < 0.1643


def test_the_bracket_of_a_lost_attractor_is_narrowed_where_it_is_lost(monkeypatch):
    asked = []

    def survives(starts, slope):
        asked.append(slope.tolist())
        return slope < 0.0137

    monkeypatch.setattr(crisis, "_ROUNDS", 2)
    low, high = bracket_where(monkeypatch, survives, 0.01, 0.02)
    assert (low, high) == pytest.approx((0.0136, 0.014)) and low < 0.0137 < high
    assert asked[0] == pytest.approx([0.01, 0.012, 0.014, 0.016, 0.018, 0.02])
    assert asked[1] == pytest.approx([0.0124, 0.0128, 0.0132, 0.0136])
    assert bracket_where(monkeypatch, survives, 0.001, 0.002)[0] == 0.002
    assert bracket_where(monkeypatch, survives, 0.014, 0.02)[1] == 0.014


def test_attractors_are_lost_side_by_side_where_each_is_lost_alone(monkeypatch):
    """Searches of other lengths: that of a few orbits alone, one that begins anew, and
    one that ends at once.
    """
    monkeypatch.setattr(crisis, "_ROUNDS", 2)
    monkeypatch.setattr(crisis, "_TRANSIENT", 4)
    monkeypatch.setattr(crisis, "_FEW", 4)
    problem = Problem(resolve("D"))
    slopes = np.array([0.0165, 0.0185, 0.0193])
    _, gaits = gaits_at(problem, from_arrays(_atlas("D", ())), slopes, "long")
    spread = 1 + 1e-3 * np.linspace(-1, 1, 16)
    attractors = [
        (gaits[:, [k]] * spread, low, high)
        for k, low, high in (
            (0, 0.0165, 0.0185),
            (1, 0.0185, 0.0195),
            (2, 0.0195, 0.02),
            (1, 0.018, 0.02),
        )
    ]
    together = crisis.lost(problem, attractors, 40)
    alone = [crisis.lost(problem, [each], 40)[0] for each in attractors]
    assert repr(together) == repr(alone)
    assert len(set(map(repr, alone))) == 4


def test_a_loss_without_a_slope_says_why(monkeypatch):
    """Orbits that persist to the end of the search had NaN, unexplained."""
    for bracket, sentence in (
        ((0.02, np.nan), "Orbits persist to slope "),
        ((np.nan, 0.02), "Orbits are lost at the accumulation point already"),
        ((0.02, 0.03), ""),
    ):
        monkeypatch.setattr(locate_cascade, "lost", lambda *_, found=bracket: [found])
        found = doublings("D", 0.014, 0.0195, periods=8, steps=5)
        assert found["lost/reason"][0].startswith(sentence) and bool(
            found["lost/reason"][0]
        ) == bool(sentence)
