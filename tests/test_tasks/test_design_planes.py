"""Designs of a plane of keys: what special points predicted over the keys give is what
lines give, or not accepted.
"""

import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq

from gaitsweep.tasks.branches import extremes
from gaitsweep.tasks.branches import passings as module_of_passings
from gaitsweep.tasks.branches.atlas import survey_lines
from gaitsweep.tasks.branches.conditions import (
    CONDITIONS,
    Condition,
    foot_radius,
    is_located,
    log_froude,
)
from gaitsweep.tasks.branches.equations import Equations, newton_step, solve
from gaitsweep.tasks.branches.extremes import Points, Sought, best, find
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.charts import cut as cuts
from gaitsweep.tasks.charts import extension as extensions
from gaitsweep.tasks.charts import landscape as landscapes
from gaitsweep.tasks.charts import manifold_maker
from gaitsweep.tasks.charts.box import Box, Refused, roots
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.cut import Cut
from gaitsweep.tasks.charts.division import divide
from gaitsweep.tasks.charts.extension import Extension
from gaitsweep.tasks.charts.family import Family
from gaitsweep.tasks.charts.landscape import _Surveyor, is_known, make
from gaitsweep.tasks.charts.maker import Maker
from gaitsweep.tasks.charts.manifold import Region
from gaitsweep.tasks.charts.manifold_maker import make_manifold, measured
from gaitsweep.tasks.gaits.step_check import gait_ratio
from gaitsweep.tasks.mechanics.lumped import common_structure
from gaitsweep.tasks.step.lanes import lanes_of
from gaitsweep.tasks.step.problem import Lanes
from gaitsweep.tasks.studies.map_designs import _Rows, _solve, design
from gaitsweep.tasks.walkers.resolve import resolve, resolve_many
from gaitsweep.tasks.walkers.statics import statics

QUANTITIES = ("smallest_slope", "largest_stable_slope", "fastest_stable_speed")
SLOPE = np.array([1e-6, 0.45])
WINDOW = (float(np.log(1e-6)), float(np.log(0.45)))
SOUGHT = Sought(WINDOW)
#: Walker, and ranges of keys: beside a curve on which two flips meet; where fold and
#: flip compete for the largest speed; where gaits continue to vanishing slopes; across
#: a curve on which the smallest slope vanishes; up to faces at which nothing drives
#: beside gravity.
PLANES = {
    "A": ("A", {"detuning": (0.45, 0.65), "m_h": (0.0, 1.0)}),
    "C": ("C", {"detuning": (0.85, 1.0), "m_h": (0.0, 1.0)}),
    "B": ("B", {"R": (0.0, 0.1), "m_s": (0.03, 0.06)}),
    "tuned": ("A", {"R": (0.25, 0.32), "detuning": (0.15, 0.25)}),
    "driven": ("D", {"push_off": (0.0, 0.02), "hip_stiffness": (0.0, 0.2)}),
}


def designs(name, n, seed=0):
    """Parameters of the task for designs drawn in a plane, with and without its cell."""
    walker, keys = PLANES[name]
    draw = np.random.default_rng(seed)
    values = {key: draw.uniform(low, high, n) for key, (low, high) in keys.items()}
    low, high = ([side[i] for side in keys.values()] for i in (0, 1))
    lines = {"line": {"walker": walker, "set": values}, "slope": SLOPE}
    cell = {
        "keys": list(keys),
        "low": low,
        "high": high,
        "log": [False] * len(keys),
        "lines": 900,
    }
    return lines, {**lines, "plane": cell}


def computed(params):
    return {name.removeprefix("design/"): v for name, v in design(params, []).items()}


@pytest.fixture(scope="module")
def made():
    """Landscape, family and designs of a plane, each made once."""
    kept = {}

    def of(name):
        if name not in kept:
            walker, keys = PLANES[name]
            family = Family.of({"walker": walker, "set": {}}, tuple(keys))
            box = Box(
                tuple(keys),
                *(tuple(side) for side in zip(*keys.values(), strict=True)),
                log=True,
            )
            (landscape,) = make(family, box, SOUGHT, 1000)
            kept[name] = family, landscape
        return kept[name]

    return of


@pytest.mark.parametrize("name", PLANES)
def test_both_roads_agree_within_their_bounds(name):
    lines, plane = designs(name, 24)
    one, other = computed(plane), computed(lines)
    assert one["surveyed"].mean() < 0.1 and (other["surveyed"] == 1).all()
    assert np.array_equal(one["smallest_at"], other["smallest_at"])
    assert np.array_equal(one["stability_lost_by"], other["stability_lost_by"])
    for quantity in QUANTITIES:
        a, b, bound = (
            one[quantity],
            other[quantity],
            one[f"{quantity}_error"] + other[f"{quantity}_error"],
        )
        assert np.array_equal(np.isnan(a), np.isnan(b))
        there = np.isfinite(a) & (a > 0)
        assert (np.abs(a[there] / b[there] - 1) <= bound[there]).all()
        assert bound[there].max(initial=0) < 1e-8
    for column in ("stance_angle", "stance_rate", "thigh_rate", "fastest_slope"):
        there = np.isfinite(other[column])
        assert one[column][there] == pytest.approx(other[column][there], rel=1e-7)


def test_the_planes_hold_what_they_are_chosen_for():
    kinds = {name: computed(designs(name, 24)[0]) for name in PLANES}
    assert set(kinds["A"]["stability_lost_by"]) == {"flip", "never stable"}
    faster = kinds["C"]["fastest_slope"] < 0.9 * kinds["C"]["largest_stable_slope"]
    assert 0 < faster.sum() < 24  # a fold's gait is faster than the flip's
    assert set(kinds["B"]["smallest_at"]) == {"any slope"}
    assert set(kinds["tuned"]["smallest_at"]) == {"fold"}


def test_a_corner_where_nothing_drives_has_the_flip_of_the_passive_walker():
    _, plane = designs("driven", 1)
    corner = {"push_off": np.zeros(1), "hip_stiffness": np.zeros(1)}

    found = computed({**plane, "line": {"walker": "D", "set": corner}})

    (slope,), (bound,) = (
        found[f"largest_stable_slope{ending}"] for ending in ("", "_error")
    )
    assert found["surveyed"].tolist() == [0]
    assert abs(slope / 0.015088437941119463562 - 1) <= bound < 1e-9


def test_a_design_does_not_depend_on_its_company():
    _, plane = designs("A", 12)
    together = computed(plane)
    for i in range(12):
        alone = computed(
            {
                **plane,
                "line": {
                    **plane["line"],
                    "set": {k: v[i : i + 1] for k, v in plane["line"]["set"].items()},
                },
            }
        )
        assert all(
            np.array_equal(v, together[k][i : i + 1], equal_nan=v.dtype.kind == "f")
            for k, v in alone.items()
        )


def solved(family, landscape, keys):
    rows = _Rows(len(keys), SOUGHT)
    accepted = _solve(
        family,
        landscape,
        keys,
        np.arange(len(keys)),
        rows,
    )
    return rows, accepted


def assert_accepted_agree(out, other, both):
    for quantity in QUANTITIES:
        one, another = out.at[quantity], other.at[quantity]
        assert np.array_equal(one["kind"][both], another["kind"][both])
        for value, error in (("log_slope", "error"), ("log_froude", "speed_error")):
            off = np.abs(one[value] - another[value])[both]
            bound = (one[error] + another[error])[both]
            assert (off[np.isfinite(off)] <= bound[np.isfinite(off)]).all()


@pytest.mark.parametrize("by", [1e-9, 1e-7, 1e-5, 1e-3])
def test_wrong_polynomials_change_no_accepted_value(made, by):
    family, right = made("A")
    keys = right.box.at(np.random.default_rng(3).uniform(-1, 1, (200, 2)))
    out, accepted = solved(family, right, keys)
    assert accepted.mean() > 0.95
    wrong = copy.deepcopy(right)
    wrong.manifolds = [
        replace(m, chart=replace(m.chart, coefficients=m.chart.coefficients * (1 + by)))
        for m in right.manifolds
    ]
    other, still = solved(family, wrong, keys)
    assert (
        by < 1e-4 or not still.any()
    )  # farther from their predictions than any that was measured
    assert_accepted_agree(out, other, still & accepted)
    # Whatever the distance, the step's own length bounds what is left of it.
    wrong.manifolds = [
        replace(m, chart=replace(m.chart, error=1.0)) for m in wrong.manifolds
    ]
    other, still = solved(family, wrong, keys)
    assert by > 1e-4 or still.mean() > 0.9
    assert_accepted_agree(out, other, still & accepted)


def test_points_are_near_whose_predictions_err_by_less_than_counts(made):
    """Of random designs that measure a chart all may be predicted better than others."""
    family, right = made("A")
    keys = right.box.at(np.random.default_rng(3).uniform(-1, 1, (200, 2)))
    lucky = copy.deepcopy(right)
    lucky.manifolds = [
        replace(m, chart=replace(m.chart, error=0.0)) for m in right.manifolds
    ]
    out, accepted = solved(family, right, keys)
    other, still = solved(family, lucky, keys)
    assert still[accepted].mean() > 0.9
    assert_accepted_agree(out, other, still & accepted)


@pytest.mark.parametrize("by", [1e-7, 5e-7])
def test_what_lies_farther_off_than_was_measured_errs_by_less_than_its_bound(made, by):
    """The rows, too, may err by more than those at which errors were measured."""
    family, right = made("A")
    dice = np.random.default_rng(3)
    unit = dice.uniform(-1, 1, (200, 2))
    problem = Maker(family, right.box, right.structure).problem(unit)

    for manifold in right.manifolds:
        lanes = np.flatnonzero(manifold.region.holds(unit))
        some = problem.some(lanes)
        Z, rows = manifold.predict(unit[lanes])
        exact, _ = manifold.polish(some, Z, rows)
        exact, _ = manifold.polish(some, exact.Z, rows)

        off, turned = dice.normal(size=(2, *Z.shape))
        wrong = Z + by * off / np.abs(off).max(axis=0)
        found, near = manifold.polish(some, wrong, rows * (1 + 1e-3 * turned))

        error = np.abs(found.Z - exact.Z).max(axis=0)
        assert near.mean() > 0.9
        assert (error <= found.error + exact.error)[near].all()


@pytest.mark.parametrize("by", [1e-5, 1e-3])
def test_newton_steps_are_taken_until_little_is_left(made, by):
    family, right = made("A")
    keys = right.box.at(np.random.default_rng(3).uniform(-1, 1, (200, 2)))
    wrong = copy.deepcopy(right)
    for manifold in wrong.manifolds:
        manifold.chart.coefficients[:] *= 1 + by
    wrong.manifolds = [
        replace(m, chart=replace(m.chart, error=1.0)) for m in wrong.manifolds
    ]
    out, accepted = solved(family, wrong, keys)
    assert accepted.mean() > 0.8
    assert np.nanmax(out.at["smallest_slope"]["error"]) < 1e-10


def test_polynomials_that_changed_places_are_not_accepted(made):
    family, right = made("A")
    keys = right.box.at(np.random.default_rng(3).uniform(-1, 1, (50, 2)))
    wrong = copy.deepcopy(right)
    a, b = right.manifolds[:2]
    wrong.manifolds[:2] = [replace(b, kind=a.kind), replace(a, kind=b.kind)]
    assert not solved(family, wrong, keys)[1].any()


def test_designs_unlike_any_surveyed_line_are_not_accepted(made):
    family, right = made("A")
    keys = right.box.at(np.random.default_rng(3).uniform(-1, 1, (50, 2)))
    assert not solved(family, replace(right, patterns=set()), keys)[1].any()
    one = {sorted(right.patterns)[0]}
    accepted = solved(family, replace(right, patterns=one), keys)[1]
    assert 0 < accepted.sum() < len(accepted)


def test_a_dropped_manifold_is_found_again(made):
    family, right = made("A")
    surveyor = _Surveyor(family, right.box, SOUGHT, [], right.box, 1000)
    surveyor.survey(right.box.unit(np.array([[0.46, 0.1], [0.47, 0.9], [0.64, 0.05]])))
    surveyor.manifolds = list(right.manifolds)
    assert not surveyor.add_missing()
    assert surveyor.patterns() <= right.patterns
    for k, dropped in enumerate(right.manifolds[:2]):
        surveyor.manifolds = [m for m in right.manifolds if m is not dropped]
        assert surveyor.add_missing()
        assert surveyor.manifolds[-1].kind == dropped.kind, k


def test_flags_that_no_line_has_are_not_known():
    patterns = {
        np.array([1, 6], np.int8).tobytes(),
        np.array([1, 0], np.int8).tobytes(),
    }
    flags = np.array(
        [
            [1, 6],
            [1, -1],
            [3, -1],
            [1, 2],
            [-1, -1],
        ],
        np.int8,
    )
    assert is_known(flags, patterns).tolist() == [
        True,
        True,
        False,
        False,
        True,
    ]


def test_stability_ends_where_two_flips_meet(made):
    """Just before the curve on which they meet a line has a window of stable gaits,
    just beyond it none.
    """
    _, landscape = made("A")
    (cut,) = [m.region for m in landscape.manifolds if m.region.is_root]
    assert cut.turns and (cut.axis, cut.side) == (0, 1)
    for m_h in (0.1, 0.7):
        unit = landscape.box.unit(np.array([[0.5, m_h]]))
        unit[0, 0] = cut.at(unit)[0]
        at = float(landscape.box.at(unit)[0, 0])
        line = {
            "walker": "A",
            "set": {
                "detuning": np.array([at - 2e-5, at + 2e-5]),
                "m_h": np.full(2, m_h),
            },
        }
        both = computed({"line": line, "slope": SLOPE})
        assert both["stability_lost_by"].tolist() == ["flip", "never stable"]


def tuned_at(detuning):
    """Foot radius at which a leg's centre of mass lies on the line from hip to foot
    centre.
    """
    return brentq(
        lambda R: statics(resolve("A", {"R": R, "detuning": detuning}))["leg_offset"],
        0.2,
        0.4,
        xtol=1e-15,
    )


def test_the_smallest_slope_vanishes_where_the_leg_is_tuned(made):
    """Of a leg whose centre of mass is off by d, a step of angle a loses a^4 and d^2:
    the slope that pays for it, over the step's length, is least where a is of the order
    of d^(1/2), the slope of d^(3/2).
    """
    _, landscape = made("tuned")
    cuts = [m.region for m in landscape.manifolds if m.region.is_root]
    assert sorted(cut.side for cut in cuts) == [-1, 1]
    for cut in cuts:
        assert cut.powers[:5] == (
            1,
            0,
            0,
            0,
            3,
        )
        for detuning in (0.16, 0.21, 0.249):
            at = landscape.box.unit(np.array([[tuned_at(detuning), detuning]]))
            assert at[0, 0] == pytest.approx(cut.at(at)[0], abs=1e-9)


def test_the_smallest_slope_over_one_key_vanishes_at_a_value_of_it():
    family, box = (
        Family.of({"walker": "A", "set": {"detuning": 0.2}}, ("R",)),
        Box(("R",), (0.27,), (0.3,)),
    )
    (landscape,) = make(family, box, SOUGHT, 1000)
    cuts = [m.region for m in landscape.manifolds if m.region.is_root]
    assert [cut.powers[:5] for cut in cuts] == [
        (
            1,
            0,
            0,
            0,
            3,
        )
    ] * 2
    for cut in cuts:
        assert box.at(cut.at(np.zeros((1, 1)))[:, None])[0, 0] == pytest.approx(
            tuned_at(0.2), rel=1e-12
        )


def test_a_map_is_divided_where_walkers_are_tuned_whatever_the_other_key():
    """Within its window the smallest slope vanishes at R = 0.2; the map took thrice as
    long as its lines.
    """
    R, m_h = (
        np.delete(np.linspace(0.02, 0.4, 20), 9),
        np.linspace(0.0, 10.0, 21),
    )  # without tuned walkers
    family = Family.of({"walker": "A"}, ("R", "m_h"))
    window = float(np.log(1e-4)), float(np.log(0.2))
    whole = Box(("R", "m_h"), (0.02, 0.0), (0.4, 10.0), log=True)
    parts = make(family, whole, Sought(window, -0.2), 420)
    assert [part.why for part in parts] == ["", ""] and parts[0].box.high[
        0
    ] == pytest.approx(0.2, rel=1e-12)
    draw = np.random.default_rng(1)
    keys = np.column_stack([draw.choice(R, 12), draw.choice(m_h, 12)])
    for part in parts:
        own = keys[(part.box.low[0] < keys[:, 0]) & (keys[:, 0] < part.box.high[0])]
        rows = _Rows(len(own), Sought(window, -0.2))
        accepted = _solve(
            family,
            part,
            own,
            np.arange(len(own)),
            rows,
        )
        assert accepted.sum() >= 3
        line = {"walker": "A", "set": {"R": own[:, 0], "m_h": own[:, 1]}}
        lines = computed(
            {"line": line, "slope": np.array([1e-4, 0.2]), "at_speed": np.exp(-0.2)}
        )
        for name, column in [(name, name) for name in QUANTITIES[:2]] + [
            ("least_cost", "slope_at_least_cost")
        ]:
            log_slope, error = (
                rows.at[name]["log_slope"],
                rows.at[name]["error"] + lines[f"{name}_error"],
            )
            off = np.abs(np.exp(log_slope) / lines[column] - 1)
            assert (np.isnan(log_slope) == np.isnan(lines[column]))[accepted].all()
            assert (off <= error)[accepted & np.isfinite(off)].all()


def test_parts_that_are_refused_cost_no_more_than_lines(monkeypatch):
    tried = []

    def refuse(self):
        tried.append(self.box)
        raise Refused("always")

    monkeypatch.setattr(_Surveyor, "landscape", refuse)
    family, box = (
        Family.of({"walker": "A"}, ("detuning",)),
        Box(("detuning",), (0.1,), (0.9,)),
    )
    parts = make(family, box, SOUGHT, 800)
    assert len(tried) == 9 and not [part for part in parts if not part.why]


@pytest.mark.parametrize("side", [-1, 1])
def test_designs_beside_vanishing_slopes_are_those_of_lines(made, side):
    family, landscape = made("tuned")
    away = np.array([1e-8, 1e-4, 1e-3, 1e-2])
    keys = np.array([[tuned_at(0.2) + side * d, 0.2] for d in away])
    rows, accepted = solved(family, landscape, keys)
    # Nearest to the curve the smallest slope lies below the window.
    assert accepted.tolist() == [False, False, True, True] or accepted.tolist() == [
        False,
        True,
        True,
        True,
    ]
    line = {"walker": "A", "set": {"R": keys[2:, 0], "detuning": keys[2:, 1]}}
    lines = computed({"line": line, "slope": SLOPE})
    smallest = rows.at["smallest_slope"]
    off = np.abs(np.exp(smallest["log_slope"][2:]) / lines["smallest_slope"] - 1)
    assert (off <= smallest["error"][2:] + lines["smallest_slope_error"]).all()
    # By another power of the root of the distance no prediction is near enough.
    wrong = copy.deepcopy(landscape)
    for k, m in enumerate(wrong.manifolds):
        if powers := m.region.powers:
            wrong.manifolds[k] = replace(
                m, region=replace(m.region, powers=(1.001, *powers[1:]))
            )
    assert not solved(family, wrong, keys)[1].any()


@pytest.mark.parametrize("turns", [False, True])
@pytest.mark.parametrize("side", [-1, 1])
def test_coordinates_of_a_part_are_inverse(turns, side):
    cut = Region(1, side, Chart((2,), np.array([[0.2], [0.1]])), turns)
    own = np.random.default_rng(0).uniform(-1, 1, (9, 2))
    assert cut.smooth(cut.unit(own)) == pytest.approx(own, abs=1e-12)
    ends = cut.unit(np.array([[0.5, -side], [0.5, side]]))
    assert ends[:, 1] == pytest.approx([-side, 0.25])


@pytest.mark.parametrize("d", [1, 2])
def test_a_whole_box_has_its_own_coordinates_border_included(d):
    region, unit = (
        Region.whole(d),
        np.vstack([np.random.default_rng(0).uniform(-1, 1, (9, d)), np.ones((1, d))]),
    )
    assert region.smooth(unit) == pytest.approx(unit, abs=1e-15) and region.unit(
        unit
    ) == pytest.approx(unit, abs=1e-15)
    assert region.holds(unit * (1 + 4e-16)).all() and not region.is_near(unit).any()


def test_boxes_with_logarithms_have_inverse_coordinates():
    box = Box(("detuning", "m_h"), (0.005, 0.0), (1.0, 6.0), log=True)
    unit = np.random.default_rng(0).uniform(-1, 1, (9, 2))
    assert box.unit(box.at(unit)) == pytest.approx(unit, abs=1e-12)
    low, high = box.parts(0)
    assert low.high[0] == high.low[0] == pytest.approx(np.sqrt(0.005))
    assert box.at(np.array([[-1.0, -1.0], [1.0, 1.0]])) == pytest.approx(
        np.array([[0.005, 0.0], [1.0, 6.0]])
    )


@pytest.mark.parametrize("follow", [Maker.problem, Maker.static_moment])
def test_special_points_that_go_on_where_no_walker_can_be_are_refused(follow):
    family, box = (
        Family.of({"walker": "B", "set": {}}, ("m_h",)),
        Box(("m_h",), (0.1,), (0.2,)),
    )
    maker = Maker(family, box, common_structure(family.walkers(box.nodes(3))))
    with pytest.raises(
        Refused, match=r"are followed to where `m_h` must be >= 0; got -0\.(1|09)\d*\."
    ):
        follow(maker, np.array([[-5.0]]))


def test_a_box_that_is_refused_is_left_to_lines(monkeypatch):
    walker, keys = PLANES["B"]
    family = Family.of({"walker": walker, "set": {}}, tuple(keys))
    box = Box(tuple(keys), (0.05, 0.05), (0.06, 0.06))
    assert [part.why for part in make(family, box, SOUGHT, 10)] == ["few walkers"]

    def refuse(self):
        raise Refused("no reason", 1)

    monkeypatch.setattr(landscapes._Surveyor, "landscape", refuse)
    parts = make(
        family,
        box,
        SOUGHT,
        1000,
        splits=1,
    )
    assert [part.why for part in parts] == ["no reason", "no reason"]
    assert parts[0].box.high[1] == parts[1].box.low[1]


def test_a_cut_is_smooth_where_the_last_coefficients_of_its_curve_vanish(monkeypatch):
    two_keys = SimpleNamespace(
        maker=SimpleNamespace(d=2), kind="fold", problem=None, target=0.0
    )
    cut = Cut(two_keys, 1, 1)
    curve = Chart(
        (6,),
        np.array(
            [
                [
                    0.2,
                    0.1,
                    0.05,
                    1e-2,
                    1e-7,
                    1e-7,
                ]
            ]
        ).T,
    )
    monkeypatch.setattr(Cut, "at_places", lambda *_: Region(1, 1, curve, True))
    assert cut.region().curve is curve
    curve.coefficients[-2] = 1e-5
    with pytest.raises(Refused, match="a fold turns along a curve that is not smooth"):
        cut.region()


@pytest.mark.parametrize(
    ("walker", "keys", "axis"), [("B", ("R", "m_s"), 0), ("A", ("detuning", "m_h"), 1)]
)
def test_there_is_no_curve_of_vanishing_slopes_that_no_key_reaches(walker, keys, axis):
    """Legs of B are tuned whatever their keys; a mass at the hip does not tune those of
    A.
    """
    family, box = (
        Family.of({"walker": walker, "set": {}}, keys),
        Box(keys, (0.05, 0.05), (0.2, 0.1)),
    )
    maker = Maker(family, box, common_structure(family.walkers(box.nodes(3))))
    cut = Cut(
        Extension(
            maker,
            "fold",
            0.0,
            np.zeros(2),
            np.zeros(5),
        ),
        axis,
        1,
    )
    assert not np.isfinite(cut.vanishing(np.zeros((3, 2)))).any()
    assert cut.powers(np.zeros((5, 3)), np.zeros((3, 2))) == ()


def test_a_box_is_halved_along_both_keys():
    """Halves along one key alone never leave a diagonal."""

    def make_part(box, why):
        if not why and box.low[0] < box.high[1] and box.low[1] < box.high[0]:
            raise Refused("on the diagonal", 0)
        return box

    parts = divide(
        Box(("a", "b"), (0.0, 0.0), (1.0, 1.0)), make_part, lambda box: True, 8
    )
    on = [box for box in parts if box.low[0] < box.high[1] and box.low[1] < box.high[0]]
    area = sum((b.high[0] - b.low[0]) * (b.high[1] - b.low[1]) for b in on)
    assert area < 0.2
    assert max((b.high[1] - b.low[1]) / (b.high[0] - b.low[0]) for b in parts) <= 4


def test_lower_halves_stand_before_upper_ones_however_often_they_are_halved():
    def make_part(box, why):
        if not why and box.low[0] == 0.0:
            raise Refused("at zero", 0)
        return box

    parts = divide(Box(("a",), (0.0,), (1.0,)), make_part, lambda box: True, 3)
    assert [box.low[0] for box in parts] == [0.0, 0.125, 0.25, 0.5]


def at_slope(problem, log_slope):
    return Equations(problem, [CONDITIONS["window"].equal_to(log_slope)])


def lanes(walker, **keys):
    return Lanes(
        resolve_many(walker, {key: np.array([value]) for key, value in keys.items()})
    )


@pytest.mark.parametrize(
    ("walker", "keys", "kinds"),
    [
        (
            "C",
            {"detuning": 0.85, "m_h": 0.0},
            "flip neimark_sacker fastest fold end_kneestrike_at_heelstrike",
        ),
        ("A", {"detuning": 0.3}, "flip fold end_zero_step"),
        ("E", {"foot_mass_ratio": 0.3}, "flip neimark_sacker"),
    ],
)
def test_every_kind_of_point_is_found_under_its_name(walker, keys, kinds):
    problem = lanes(walker, **keys)
    surveyed = survey_lines(problem, COARSE)
    points = find(problem, surveyed, SOUGHT)
    ends = "any slope" if walker == "E" else "end_tangential_heelstrike"
    assert set(points.kind) == {*kinds.split(), "label", "window", ends}
    # Where the ratio has a pole its sign changes too, but no step's label.
    changes = 0
    for branch in surveyed[0]:
        before, after = branch.ratio[:-1], branch.ratio[1:]
        passes = (after - 0.5) * (before - 0.5) < 0
        changes += int((passes & (after * before > 0)).sum())
    is_label = points.kind == "label"
    ratios = gait_ratio(evaluate(problem, points.Z[:, is_label]).stride)
    is_changed = np.abs(ratios - 0.5) < 1e-9
    assert is_changed.sum() == changes
    assert is_changed[points.walks[is_label]].all()


def test_the_scalars_vanish_at_points_known_otherwise():
    """A flip and a fold have the multipliers -1 and 1; where the speed is greatest that
    of both neighbours is less.
    """
    problem = lanes("C", detuning=0.85, m_h=0.0)
    points = find(problem, survey_lines(problem, COARSE), SOUGHT)
    assert {
        "fold",
        "flip",
        "neimark_sacker",
        "fastest",
        "end_kneestrike_at_heelstrike",
    } <= set(points.kind)
    value = {"flip": -1.0, "fold": 1.0}
    for k in np.flatnonzero(points.walks):
        kind, Z = str(points.kind[k]), points.Z[:, [k]]
        at = evaluate(problem, Z)
        if (
            is_located(kind)
            and kind != "window"
            and np.isfinite(at.stride.jacobian).all()
        ):
            assert (
                abs(CONDITIONS[kind].residual(at)[0])
                < 1e-9 * np.abs(points.rows[:, k]).max()
            )
        values = (
            np.linalg.eigvals(at.jacobians[0])
            if kind in (*value, "neimark_sacker")
            else np.zeros(0)
        )
        if kind in value:
            assert np.abs(values - value[kind]).min() < (
                1e-9 if kind == "flip" else 1e-5
            )
        if kind == "neimark_sacker":
            pairs = [values[i] * values[j] for i in range(3) for j in range(i)]
            assert np.abs(np.array(pairs) - 1).min() < 1e-9
        if kind == "fastest":
            step = 1e-4
            others = [
                solve(at_slope(problem, Z[-1, 0] + sign * step), Z).Z
                for sign in (-1, 1)
            ]
            v = [
                log_froude(each, foot_radius(problem))[0]
                for each in (others[0], Z, others[1])
            ]
            assert abs(v[2] - v[0]) < 5e-3 * abs(v[0] - 2 * v[1] + v[2])


def test_a_row_of_differences_is_the_derivative():
    problem = lanes("A", detuning=0.3, m_h=0.5)
    Z = np.array(
        [
            [np.log(0.3)],
            [-0.9],
            [-0.5],
            [2.0],
            [np.log(0.03)],
        ]
    )
    move = 1e-4 * np.random.default_rng(0).normal(size=(5, 1))
    for kind in (
        "flip",
        "fold",
        "neimark_sacker",
        "fastest",
        "end_tangential_heelstrike",
        "speed",
    ):
        condition = CONDITIONS[kind]
        there, here = (
            condition.residual(evaluate(problem, Z + sign * move))[0]
            for sign in (1, -1)
        )
        row = Equations(problem).gradient(condition, Z)[:, 0]
        assert there - here == pytest.approx(2 * float(row @ move[:, 0]), rel=1e-4)


def test_rough_rows_are_the_derivatives_with_half_as_many_steps(extension):
    problem, Z = extension.problem(np.zeros((1, 1))), extension.Z[:, None]
    exact, rough = extension.gradient(problem, Z), extension.rough_gradient(problem, Z)
    np.testing.assert_allclose(rough, exact, rtol=0, atol=1e-5 * np.abs(exact).max())


def test_designs_count_that_have_a_point_of_a_region(made):
    family, right = made("A")
    surveyor = _Surveyor(family, right.box, SOUGHT, [], right.box, 800)
    half = Region(0, 1, Chart((1,), np.zeros((1, 1))))
    assert surveyor.designs_in(Region.whole(2)) == 800
    assert surveyor.designs_in(half) == pytest.approx(400, rel=0.1)


def test_a_manifold_for_few_designs_need_only_be_useful(extension):
    many, few = make_manifold(extension), make_manifold(extension, lambda _: 40.0)
    assert few.chart.sizes < many.chart.sizes
    assert many.chart.error < 2e-7 < few.chart.error < 1e-4


def test_a_stale_row_is_brought_up_to_date_without_differences(monkeypatch):
    problem = lanes("A", detuning=0.3, m_h=0.5)
    points = find(problem, survey_lines(problem, COARSE), SOUGHT)
    flip = lanes_of(points, np.flatnonzero((points.kind == "flip") & points.walks)[:1])
    differences = []
    monkeypatch.setattr(Equations, "gradient", lambda *_: differences.append(1))
    equations = Equations(problem, [CONDITIONS["flip"]])
    solved = solve(equations, flip.Z + 1e-4, rows=1.2 * flip.rows)
    assert solved.ok.all() and not differences
    assert np.abs(solved.Z - flip.Z).max() <= (solved.error + flip.error)[0]


def test_halves_of_a_box_keep_its_surveyed_lines(monkeypatch):
    surveyed = []
    monkeypatch.setattr(
        landscapes,
        "survey_lines",
        lambda problem, _: surveyed.append(len(problem.lanes)),
    )
    monkeypatch.setattr(
        landscapes, "find", lambda problem, *_: extremes.nothing(problem)
    )
    walker, keys = PLANES["A"]
    family = Family.of({"walker": walker, "set": {}}, tuple(keys))
    box, lines = Box(tuple(keys), *zip(*keys.values(), strict=True), log=True), []
    _Surveyor(family, box, SOUGHT, lines, box, 1000).begin()
    for half in box.parts(0):
        surveyor = _Surveyor(family, half, SOUGHT, lines, half, 500)
        surveyor.begin()
        assert len(surveyor.unit) >= 11 and len(set(surveyor.nodes.tolist())) == 9
        assert np.abs(surveyor.unit[surveyor.nodes]).max() <= 1 + 1e-12
    assert surveyed[0] == 11 and len(surveyed) == 3 and max(surveyed[1:]) <= 5


def test_a_point_that_is_lost_is_refused():
    family = Family.of({"walker": "A", "set": {}}, ("detuning",))
    box = Box(("detuning",), (0.3,), (0.5,))
    maker = Maker(family, box, common_structure(family.walkers(box.nodes(3))))
    Z = np.array(
        [
            np.log(0.4),
            -0.9,
            -0.5,
            np.log(0.3),
            2.0,
        ]
    )
    with pytest.raises(Refused):
        make_manifold(
            Extension(
                maker,
                "flip",
                0.0,
                np.zeros(1),
                Z,
            )
        )


@pytest.fixture(scope="module")
def extension():
    """That of the flip of A at the middle of a range of detuning, and its point in
    another design.
    """
    family, box = (
        Family.of({"walker": "A", "set": {}}, ("detuning",)),
        Box(("detuning",), (0.2,), (0.5,)),
    )
    maker = Maker(family, box, common_structure(family.walkers(box.nodes(3))))
    problem = maker.problem(np.zeros((1, 1)))
    points = find(problem, survey_lines(problem, COARSE), SOUGHT)
    (k, *_) = np.flatnonzero((points.kind == "flip") & points.walks)
    return Extension(
        maker,
        "flip",
        0.0,
        np.zeros(1),
        points.Z[:, k],
    )


def test_points_at_nodes_of_a_manifold_are_solved_to_rounding_and_rows_ask_for_no_nodes(
    extension,
):
    manifold = make_manifold(extension)
    nodes = manifold.region.unit(roots(manifold.chart.sizes[0])[:, None])
    problem, (Z, rows) = extension.problem(nodes), manifold.predict(nodes)
    equations = Equations(problem, [CONDITIONS["flip"]])
    assert newton_step(equations, Z, rows).last_step.max() < 1e-11
    by_differences = equations.gradient(CONDITIONS["flip"], Z)
    np.testing.assert_allclose(
        rows, by_differences, rtol=1e-5, atol=1e-5 * np.abs(rows).max()
    )
    c = len(Z)
    assert (manifold.chart.tails()[:, c:] == 0).all() and (
        manifold.chart.tails()[:, :c] > 0
    ).any()


def test_a_point_is_carried_no_farther_than_its_predictions_hold(
    extension, monkeypatch
):
    nodes, region = np.array([[-0.9], [0.9]]), Region.whole(1)
    points, there = extension.carried(nodes, region)
    assert there.all()
    usual = solve

    def jumps(problem, kind, guess, *args, **options):
        found = usual(problem, kind, guess, *args, **options)
        found.Z[:, -1] = guess[:, -1] + 0.4  # the other sheet, say
        found.ok[-1] = True
        return found

    monkeypatch.setattr(extensions, "solve", jumps)
    assert extension.carried(nodes, region)[1].tolist() == [True, False]
    # A coarse chart leads there too: such points are carried, and these are lost.
    with pytest.raises(Refused, match="is lost on its way to 1 nodes"):
        extension.chart(
            region, (5,), Chart.through((2,), np.vstack([points.Z, points.rows]))
        )


def test_points_are_followed_until_none_beside_them_is_stable_any_more(
    extension, monkeypatch
):
    radius = iter([2.0, 0.5, 2.0])
    monkeypatch.setattr(
        cuts, "other_multipliers", lambda kind, jacobian: np.array([next(radius)])
    )
    cut = Cut(extension, 0, -1)
    _, (ends,), turned = cut.followed(extension.Z[:, None], np.zeros((1, 1)))
    assert ends == pytest.approx([-0.02 * (1 + 1.5 + 1.5**2)]) and not turned.any()


def test_a_manifold_is_kept_beyond_all_places_at_which_it_counts_no_more(monkeypatch):
    x = roots(13)
    ends = 0.3 + 0.1 * x + 1e-3 * np.cos(6 * np.arccos(x))
    unit, nowhere = np.column_stack([ends, x]), np.zeros(13, bool)
    points = SimpleNamespace(Z=np.zeros((5, 13)))
    extension = SimpleNamespace(
        maker=SimpleNamespace(d=2),
        kind="fold",
        problem=None,
        target=0.0,
        carried=lambda *_: (points, ~nowhere),
    )
    monkeypatch.setattr(Cut, "followed", lambda *_: (points.Z, unit, nowhere))
    for side in (-1, 1):
        region = Cut(extension, 0, side).at_places((13,))
        beyond = side * (region.at(np.column_stack([0 * x, x])) - ends)
        assert region.curve.sizes == (5,) and not region.is_root
        assert beyond.min() == pytest.approx(0.1, abs=1e-4) and beyond.max() < 0.103


def test_points_and_derivatives_grow_towards_vanishing_steps_as_their_powers_say():
    region = Region(0, 1, Chart((), np.array([[0.5]])), powers=(1.0, 3.0, -2.0))
    constant = Chart((1,), np.array([[4.0, 5.0, 6.0, 7.0]]))
    Z, rows = region.predict(
        constant, np.array([[0.5 - 1.5 * 0.04]])
    )  # at 0.04 of the way
    np.testing.assert_allclose(Z[:, 0], [4 + np.log(0.2), 5 + 3 * np.log(0.2)])
    np.testing.assert_allclose(rows[:, 0], np.array([6.0, 7.0]) / 0.2**2)


@pytest.mark.parametrize(("lane", "why"), [(0, "err by"), (None, None)])
def test_a_manifold_whose_drawn_points_are_lost_is_refused(
    extension, lane, why, monkeypatch
):
    region = Region.whole(1)
    chart = make_manifold(extension).chart
    usual = solve

    def lost(problem, kind, guess, *args, **options):
        found = usual(problem, kind, guess, *args, **options)
        if lane is not None and guess.shape[1] == 24:
            found.ok[lane] = False
        return found

    monkeypatch.setattr(manifold_maker, "solve", lost)
    if why is None:
        assert measured(extension, region, chart).quadratic > 0
    else:
        with pytest.raises(Refused, match=why):
            measured(extension, region, chart)


def test_a_manifold_over_one_key_ends_where_it_turns():
    family = Family.of({"walker": "A", "set": {}}, ("detuning",))
    box = Box(("detuning",), (0.4,), (0.7,))
    (landscape,) = make(family, box, SOUGHT, 1000)
    assert not landscape.why
    (cut,) = [m.region for m in landscape.manifolds if m.region.is_root]
    assert cut.turns and cut.curve.sizes == ()
    at = float(box.at(cut.curve.coefficients)[0, 0])
    line = {"walker": "A", "set": {"detuning": np.array([at - 2e-5, at + 2e-5])}}
    assert computed({"line": line, "slope": SLOPE})["stability_lost_by"].tolist() == [
        "flip",
        "never stable",
    ]


def test_a_line_without_a_point_of_a_role_has_none():
    """Of three lines the first has two folds of long gaits, and the last one of a short
    gait that is not stable.
    """
    n, yes = 3, np.ones(3, bool)
    points = Points(
        line=np.array([0, 0, 2]),
        kind=np.full(n, "fold"),
        Z=np.vstack([np.zeros((3, n)), [-3.0, -4.0, -5.0]]),
        rows=np.zeros((4, n)),
        error=np.zeros(n),
        log_froude=np.array([-1.0, -2.0, -3.0]),
        speed_error=np.zeros(n),
        walks=yes,
        long=np.array([True, True, False]),
        stable=~yes,
        faster=yes,
    )
    assert best(points, 3, WINDOW)["smallest_slope"].tolist() == [1, -1, -1]


def test_a_flip_between_a_stable_and_an_unstable_node_is_located(monkeypatch):
    """The multiplier crosses -1 between nodes 1 and 2, of which only the first is
    stable.
    """
    nodes = SimpleNamespace(
        values={"flip": 3.074 - 2.0 * np.arange(4)},
        branch=np.zeros(4, int),
        line=np.zeros(4, int),
        stable=np.array([False, True, False, False]),
        interpolate=lambda node, share: np.array([node + share]),
    )
    monkeypatch.setattr(module_of_passings, "evaluate", lambda problem, Z: Z[0])
    flip = Condition("flip", lambda at: 3.074 - 2 * at)
    problem = SimpleNamespace(some=lambda lanes: None)
    found = module_of_passings.guess_passings(problem, nodes, flip, True)
    assert (found.kind, found.node.tolist()) == ("flip", [1])
    assert found.Z[0] == pytest.approx([1.537])


def test_a_point_that_wanders_off_is_another_one_even_if_it_comes_back():
    """An iterate lies beyond, the last one near the guess again: a node of a manifold
    was wrong.
    """
    table = {
        "base": "A",
        "w_t": -0.015206657089326378,
        "m_t": 2.345,
        "r_t": 0.1582700766369134,
    }
    table |= {
        "c_t": 0.08634876080203595,
        "w_s": 0.023241879712544863,
        "m_s": 1.013,
        "r_s": 0.14756397195306775,
    }
    family = Family.of({"walker": table, "set": {}}, ("m_h",))
    walkers = family.walkers(np.array([[1.230461021906968]]))
    guess = np.array(
        [
            -0.9349689,
            -1.0331377,
            -0.5184508,
            2.9497147,
            -2.9689430,
        ]
    )[:, None]
    rows = np.array(
        [
            1.0282389,
            -5.7727299,
            -1.9885476,
            -7.1496630,
            0.5656257,
        ]
    )[:, None]
    problem = Lanes(walkers, common_structure(walkers))
    found = solve(Equations(problem, [CONDITIONS["flip"]]), guess, rows=rows)
    assert (
        not found.ok.any()
        and np.isinf(found.error).all()
        and np.array_equal(found.Z, guess)
    )
