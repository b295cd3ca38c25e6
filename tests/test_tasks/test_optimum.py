"""The best walker: against dense scans, curves of special points, what the literature
has, and the derivatives that Lagrange's multipliers are.
"""

import itertools
import re
from types import SimpleNamespace

import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.measures.programme import STABLE
from gaitsweep.tasks.studies.map_designs import design
from gaitsweep.tasks.studies.optimise_walker import optimum
from gaitsweep.tasks.studies.pose_optimum import Box, Question, candidates
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import branches

WINDOW = [1e-3, 0.2]


def solved(walker, slope, gaits=("long", "short"), **options):
    """The tables of a question, by group and column."""
    params = {
        "line": {
            "walker": walker,
            "set": {},
        },
        "slope": slope,
        "gaits": gaits,
    }
    tables = {}
    for name, values in optimum(
        {
            **params,
            "starts": 4,
            **options,
        },
        [],
    ).items():
        group, _, column = name.rpartition("/")
        tables.setdefault(group, {})[column] = values
    return tables


def limits(tables):
    """Limits with their multipliers, by what limits."""
    own = tables.get(
        "optimum_limits",
        {
            "limited_by": np.array([]),
            "multiplier": [],
        },
    )
    return dict(zip(own["limited_by"].tolist(), own["multiplier"], strict=True))


def slopes_of(kind, walker, **keys):
    """Slopes of a walker's special points of a kind."""
    problem, every = branches(walker, **keys)
    points = itertools.chain.from_iterable(
        special_points(problem, branch) for branch in every
    )
    return [point["slope"] for point in points if point["kind"] == kind]


@pytest.fixture(scope="module")
def fastest():
    return solved(
        "B",
        WINDOW,
        maximise="froude_speed",
        free={
            "R": [0.1, 0.5],
            "m_h": [0, 2],
        },
    )


def test_the_optimum_of_one_key_is_that_of_a_dense_scan():
    found = solved(
        "B",
        [0.01],
        maximise="froude_speed",
        free={"c_t": [0.05, 0.6]},
    )

    centre = np.append(np.linspace(0.05, 0.6, 45), np.linspace(0.2, 0.214, 29))
    scanned = gaitsweep.gaits(
        "B",
        0.01,
        c_t=centre,
    )
    is_stable = scanned.spectral_radius < 1
    speed = scanned.froude_speed.where(is_stable).max("gait").values

    best = found["optimum"]
    assert best["froude_speed"][0] >= np.nanmax(speed)
    assert best["froude_speed"][0] == pytest.approx(
        np.nanmax(speed),
        rel=1e-6,
    )
    assert best["c_t"][0] == pytest.approx(
        centre[np.nanargmax(speed)],
        abs=5e-4,
    )
    assert not limits(found)


def test_the_optimum_is_a_gait_that_solve_finds(fastest):
    best = {name: values[0] for name, values in fastest["optimum"].items()}

    alone = gaitsweep.gaits(
        "B",
        best["slope"],
        R=best["R"],
        m_h=best["m_h"],
    )

    nearest = np.nanmin(np.abs(alone.stance_angle - best["stance_angle"]))
    assert nearest <= 1e-12
    assert 0 < best["error_bound"] < 1e-12 and 0 < best["slope_error"] < 1e-12


def test_all_starts_lead_to_one_optimum_whose_limits_are_named(fastest):
    best = fastest["optimum"]

    assert best["hits"][0] == best["begun"][0] == 4
    assert set(fastest["searches"]["outcome"]) == {"the optimum"}
    assert set(limits(fastest)) == {"flip", "R", "m_h"}
    assert best["spectral_radius"][0] == pytest.approx(
        1,
        abs=1e-8,
    )
    assert best["stationarity"][0] < 1e-6


def test_the_fastest_gait_is_that_of_the_map_of_designs(fastest):
    best = {name: values[0] for name, values in fastest["optimum"].items()}
    keys = {name: np.array([best[name]]) for name in ("R", "m_h")}
    line = {"walker": "B", "set": keys}

    mapped = design({"line": line, "slope": np.array(WINDOW)}, [])

    speed = mapped["design/fastest_stable_speed"][0]
    assert best["speed"] == pytest.approx(speed, rel=1e-10)


def test_the_largest_stable_slope_is_the_flip_of_its_walker():
    found = solved(
        "B",
        WINDOW,
        maximise="slope",
        free={"R": [0.0, 0.3]},
    )

    slope, R = found["optimum"]["slope"][0], found["optimum"]["R"][0]
    flips = slopes_of("flip", "B", R=float(R))
    assert min(abs(slope / flip - 1) for flip in flips) < 1e-10
    assert set(limits(found)) == {"flip", "R"}


def test_the_stable_slopes_of_the_simplest_walker_end_where_the_literature_has_it():
    """Garcia et al. (1998): the long gait is stable up to 0.0151 rad, for feet of
    vanishing mass; and the multiplier tells how that grows with their mass.
    """
    light = solved(
        "E",
        WINDOW,
        maximise="slope",
        free={"foot_mass_ratio": [1e-4, 0.1]},
    )

    massless = {"foot_mass_ratio": [0.0, 0.1]}
    lightest = solved("E", WINDOW, maximise="slope", free=massless)

    slope = light["optimum"]["slope"][0]
    by_mass = limits(light)["foot_mass_ratio"]
    assert slope == pytest.approx(
        0.0151,
        abs=5e-5,
    )
    flip = min(slopes_of("flip", "D"))
    assert slope - 1e-4 * by_mass == pytest.approx(
        flip,
        abs=1e-6,
    )
    assert lightest["optimum"]["slope"][0] == pytest.approx(
        flip,
        rel=1e-10,
    )


def test_the_smallest_slope_is_the_fold_of_its_walker():
    free = {"detuning": [0.2, 1.0]}
    found = solved(
        "A",
        [1e-6, 0.2],
        minimise="slope",
        free=free,
        stable=False,
    )

    fold = min(slopes_of("fold", "A", detuning=0.2))
    assert found["optimum"]["slope"][0] == pytest.approx(
        fold,
        rel=1e-10,
    )
    assert np.isnan(found["optimum"]["error_bound"][0])
    assert found["optimum"]["slope_error"][0] < 1e-11


def fastest_over_two_keys():
    """The programme of a fastest gait of A at a slope, and the unknowns of one gait."""
    options = registry.options(
        "optimum",
        {
            "maximise": "speed",
            "stable": False,
            "starts": 2,
        },
    )
    free = {
        "R": (0.1, 0.3),
        "m_h": (0.0, 2.0),
    }
    box = Box(
        {
            "walker": "A",
            "set": {},
        },
        free,
    )
    slope = np.array([0.02])
    question = Question(box, slope, options, ("long", "short"))
    return question.programme({}), candidates(question)[0][:, 0]


def without_residual(programme, X, unknowns):
    """A gait near a point, by Newton's method on its first unknowns."""
    X = X.copy()
    for _ in range(8):
        at = programme.linear(X)
        by_gait = at.derivative[:unknowns, :unknowns]
        X[:unknowns] -= np.linalg.solve(by_gait, at.rows[:unknowns])
    return X


def by_difference(keys, name, angle):
    """Derivative of the speed by a key: that of gaits solved beside one."""
    step = 1e-4
    values = keys[name] + step * np.array([-1, 1])
    beside = gaitsweep.gaits(
        "A",
        0.02,
        variables=["speed", "stance_angle"],
        **{
            **keys,
            name: values,
        },
    )
    chosen = np.abs(beside.stance_angle - angle).argmin("gait")
    slow, fast = beside.speed.isel(gait=chosen).values
    return (fast - slow) / (2 * step)


def test_derivatives_are_those_of_gaits_solved_beside():
    """Along the gaits of a slope, by the implicit function theorem."""
    programme, guess = fastest_over_two_keys()
    n = len(guess) - 2
    X = without_residual(programme, guess, n)

    at = programme.linear(X)
    by_gait, by_key = np.split(at.derivative[:n], [n], axis=1)
    moved = -np.linalg.solve(by_gait, by_key)
    by_keys = at.gradient[n:] + at.gradient[:n] @ moved

    scale = programme.equations.keys.scale
    keys = dict(zip(("R", "m_h"), scale * X[n:], strict=True))
    angle = np.exp(X[0])
    for place, name in enumerate(keys):
        difference = by_difference(keys, name, angle)
        assert -by_keys[place] / scale[place] == pytest.approx(
            difference,
            rel=1e-6,
        )


def test_multipliers_are_derivatives_by_the_limits(fastest):
    def fastest_within(most):
        free = {
            "R": [0.1, most],
            "m_h": [0, 2],
        }
        found = solved(
            "B",
            WINDOW,
            maximise="froude_speed",
            free=free,
            starts=1,
        )
        return found["optimum"]["froude_speed"][0]

    difference = (fastest_within(0.501) - fastest_within(0.499)) / 0.002

    assert limits(fastest)["R"] == pytest.approx(
        difference,
        rel=1e-4,
    )


def test_the_least_cost_at_a_speed_is_that_of_its_slope():
    free = {
        "R": [0.1, 0.5],
        "m_h": [0, 2],
        "c_t": [0.05, 0.6],
        "r_t": [0.05, 0.4],
    }
    within = {"froude_speed": [0.2, 0.2]}
    found = solved(
        "B",
        [1e-4, 0.2],
        minimise="cost_of_transport",
        free=free,
        within=within,
    )

    best = {name: values[0] for name, values in found["optimum"].items()}
    assert best["froude_speed"] == pytest.approx(
        0.2,
        rel=1e-10,
    )
    assert best["cost_of_transport"] == pytest.approx(
        np.sin(best["slope"]),
        rel=1e-12,
    )
    # Rounder feet lose less, and the centre of mass has its best height.
    assert best["R"] == 0.5 and 0.05 < best["c_t"] < 0.6
    assert best["spectral_radius"] < 1 and best["stationarity"] < 1e-6


def test_a_trade_off_is_made_of_optima():
    free = {"R": [0.1, 0.5]}
    asked = {
        "minimise": "cost_of_transport",
        "free": free,
    }
    speeds = [0.1, 0.15, 0.2]

    traded = solved(
        "B",
        WINDOW,
        **asked,
        tradeoff={"froude_speed": speeds},
    )
    alone = solved(
        "B",
        WINDOW,
        **asked,
        within={"froude_speed": [0.15, 0.15]},
    )

    costs = traded["optimum"]["cost_of_transport"]
    assert traded["optimum"]["case"].tolist() == [0, 1, 2]
    assert traded["optimum"]["froude_speed"] == pytest.approx(
        speeds,
        rel=1e-9,
    )
    assert (np.diff(costs) > 0).all()
    assert costs[1] == pytest.approx(
        alone["optimum"]["cost_of_transport"][0],
        rel=1e-9,
    )


def test_a_violation_that_is_ruled_out_stays_within_its_limit():
    asked = {
        "maximise": "froude_speed",
        "free": {"R": [0.1, 0.3]},
        "starts": 2,
    }

    free = solved(
        "A",
        [0.01, 0.04],
        **asked,
        within={"friction_demand": [0, 10]},
    )
    demand = free["optimum"]["friction_demand"][0]
    limited = solved(
        "A",
        [0.01, 0.04],
        **asked,
        without=["friction"],
        violation_limits={"friction": 0.8 * demand},
    )

    assert limited["optimum"]["friction_demand"][0] <= 0.8 * demand * (1 + 1e-7)
    # With more of it allowed the walker would be faster.
    assert limits(limited)["friction_demand"] > 0
    assert limited["optimum"]["froude_speed"][0] < free["optimum"]["froude_speed"][0]


def test_all_starts_lead_to_an_optimum_that_is_0():
    """They had to end at one last digit."""
    found = solved(
        "B",
        [0.005, 0.1],
        minimise="m_h",
        free={"m_h": [0.0, 2.0]},
        stable=False,
    )

    assert found["optimum"]["m_h"][0] == 0
    assert found["optimum"]["hits"][0] == found["optimum"]["begun"][0] == 4


def test_short_gaits_are_found_where_only_those_are_wanted():
    asked = {
        "maximise": "froude_speed",
        "free": {"R": [0.1, 0.3]},
        "stable": False,
    }

    every = solved(
        "A",
        [0.01],
        **asked,
    )
    short = solved(
        "A",
        [0.01],
        gaits=("short",),
        **asked,
    )

    # The fastest gait is long, and the fastest short one all but long.
    assert "label" not in limits(every) and limits(short)["label"] < 0
    gaits = gaitsweep.gaits(
        "A",
        0.01,
        R=float(short["optimum"]["R"][0]),
    )
    ratio = gaits.heelstrike_rate_ratio.values
    assert np.nanmin(np.abs(ratio - 0.5)) < 1e-9
    fastest_of_all = every["optimum"]["froude_speed"][0]
    assert short["optimum"]["froude_speed"][0] < fastest_of_all


def test_a_search_that_stops_at_a_kink_is_no_optimum_and_says_so():
    """Where two multipliers are the largest, their size has no derivative."""
    found = solved(
        "B",
        [1e-3, 0.1],
        minimise="spectral_radius",
        free={"R": [0.05, 0.4], "c_t": [0.05, 0.5]},
    )

    best = found["optimum"]
    assert best["stationarity"][0] > 1e-4
    assert "the best found, stopped before an optimum" in found["searches"]["outcome"]


def test_where_no_gait_is_stable_the_reason_is_told():
    found = solved(
        "A",
        [0.3, 0.4],
        maximise="speed",
        free={"R": [0.1, 0.3]},
        starts=2,
    )

    (reason,) = found["nothing"]["reason"]
    assert reason.startswith("No stable gait within the ranges and limits was found")
    assert "`spectral_radius` must be at most 1: it is " in reason
    assert "optimum" not in found or not len(found["optimum"])


@pytest.mark.parametrize(
    ("label", "bound"), [("long", "at most"), ("short", "at least")]
)
def test_a_label_that_is_missed_is_told_by_its_measure(label, bound):
    options = registry.options(
        "optimum", {"minimise": "slope", "free": {"R": [0.1, 0.3]}}
    )
    box = Box({"walker": "A", "set": {}}, options["free"])
    question = Question(box, np.array(WINDOW), options, (label,))
    programme = question.programme({})
    (missed,) = [each for each in programme.constraints if each.name == "label"]

    asked = question.asked_by(missed)

    assert asked.name == "heelstrike_rate_ratio"
    assert asked.bound == f"{bound} 0.5"
    # Of a gait, that measure and not how far it is from the limit.
    problem, (branch, *_) = branches("A")
    gait = evaluate(problem, branch.Z[:, [len(branch.q) // 2]])
    (ratio,) = asked.scalar(gait)
    assert ratio == pytest.approx(gait_ratio(gait.stride)[0], rel=1e-12)


def test_constraints_that_contradict_each_other_are_named():
    free, within = {"R": [0.1, 0.3]}, {"froude_speed": [3.0, 3.0]}
    found = solved(
        "A",
        WINDOW,
        minimise="slope",
        free=free,
        within=within,
        starts=2,
    )

    (reason,) = found["nothing"]["reason"]
    assert "`froude_speed` is not met. `froude_speed` must be equal to 3: it" in reason
    # What there is, of the gaits that the starts' walkers have in the window.
    low, high = map(float, re.findall(r"it is (\S+) to (\S+) at", reason)[0])
    assert 0 < low < 0.1 and 0.3 < high < 3


def test_a_key_that_changes_nothing_is_an_error():
    free = {
        "R": [0.1, 0.3],
        "g": [1.0, 10.0],
    }

    with pytest.raises(
        WalkerError, match="^`free` must hold keys that change more than units; got g"
    ):
        solved(
            "A",
            [0.01, 0.04],
            maximise="froude_speed",
            free=free,
            starts=1,
        )


def test_knees_have_optima_too():
    free = {
        "R": [0.1, 0.3],
        "m_h": [0.0, 2.0],
    }
    found = solved(
        "C",
        WINDOW,
        maximise="froude_speed",
        free=free,
        starts=2,
    )

    best = {name: values[0] for name, values in found["optimum"].items()}
    assert set(limits(found)) == {"flip", "R", "m_h"}
    alone = gaitsweep.gaits(
        "C",
        best["slope"],
        R=best["R"],
        m_h=best["m_h"],
    )
    speed = float(alone.froude_speed.sel(gait="long"))
    assert best["froude_speed"] == pytest.approx(
        speed,
        rel=1e-12,
    )


@pytest.mark.parametrize("walker", ["A", "B", "C", "D", "physical"])
def test_gaits_are_stable_where_no_multiplier_has_crossed_the_circle(walker):
    problem, every = branches(walker)
    radii, missed = [], []
    for branch in every:
        at = Equations(problem).evaluate(branch.Z)
        radii.append(np.abs(at.multipliers).max(axis=1))
        missed.append(np.max([each.missed(at) for each in STABLE], axis=0))

    radius, beyond = np.concatenate(radii), np.concatenate(missed)
    is_clear = np.abs(radius - 1) > 1e-6
    assert ((radius < 1) == (beyond == 0))[is_clear].all()
    assert (beyond > 0).any()


def test_pairs_that_leave_the_circle_are_told_apart_from_flips_and_folds():
    """A stride map that turns by a right angle and grows, and one that shrinks."""
    growing, shrinking = (
        size * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
        for size in (1.1, 0.9)
    )
    at = SimpleNamespace(jacobians=np.array([growing, shrinking]))

    outside, inside = zip(*(each.missed(at) > 0 for each in STABLE), strict=True)

    assert outside == (False, False, True)
    assert inside == (False, False, False)
