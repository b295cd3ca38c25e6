"""Special points have the state just after heelstrike, in the walker's units."""

import numpy as np
import pytest

from gaitsweep.tasks.branches.atlas import survey, to_arrays
from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.special_points import passings
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.follow_branches import DERIVATIVES, branch
from gaitsweep.tasks.studies.map_step import map_step
from gaitsweep.tasks.studies.solve_points import atlas
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import KEYS
from lines import branches

FLIP = CONDITIONS["flip"]
RATES = ("stance_rate", "thigh_rate", "shank_rate")


@pytest.fixture(scope="module")
def tables():
    """What the task gives for the physical walker with knees and without, each in SI
    units.
    """

    def follow(walker):
        params = {
            "line": {"walker": walker},
            "slope_from": 0.015,
            "slope_to": 0.06,
            "n": 60,
        }
        return branch(params, [to_arrays(survey(Problem(resolve(walker))))])

    return {walker: follow(walker) for walker in ("physical", "physical-straight")}


@pytest.mark.parametrize("walker", ["physical", "physical-straight"])
def test_a_step_maps_the_state_of_a_fold_or_flip_onto_itself(tables, walker):
    found = {
        name.partition("/")[2]: v
        for name, v in tables[walker].items()
        if name.startswith("special_points/")
    }
    inside = np.flatnonzero(np.isin(found["kind"], ["fold", "flip"]))
    assert len(inside) >= (4 if walker == "physical" else 1)
    for k in inside:
        state = [
            found[name][k] for name in ("stance_angle", "stance_rate", "thigh_rate")
        ]
        mapped = map_step(
            {"walker": walker, "slope": found["slope"][k], "state": state}
        )
        np.testing.assert_allclose(mapped["state"], state, rtol=1e-8)
        np.testing.assert_allclose(
            mapped["heelstrike_time"], found["period"][k], rtol=1e-8
        )


@pytest.mark.parametrize("walker", ["physical", "physical-straight"])
def test_an_end_has_the_state_of_the_last_gait_of_its_branch(tables, walker):
    table = tables[walker]
    ends = np.flatnonzero(
        np.char.startswith(table["special_points/kind"].astype(str), "end_")
    )
    assert len(ends) >= 2
    for k in ends:
        near = np.abs(
            table["branches/stance_angle"] / table["special_points/stance_angle"][k] - 1
        ).argmin()
        for name in RATES:
            np.testing.assert_allclose(
                table[f"special_points/{name}"][k],
                table[f"branches/{name}"][near],
                rtol=1e-9,
            )


@pytest.mark.parametrize(
    ("walker", "steps", "low", "high"), [("C", 1, 0.01, 0.06), ("D", 3, 0.0121, 0.016)]
)
def test_a_branch_that_leaves_its_window_has_a_row_there(walker, steps, low, high):
    line = {"walker": walker}
    inputs = [atlas({"line": line, "slope": np.array([low, high]), "steps": steps}, [])]

    found = branch(
        {"line": line, "slope_from": low, "slope_to": high, "n": 20, "steps": steps},
        inputs,
    )

    rows = np.flatnonzero(found["special_points/kind"] == "window")
    # Both gaits of C at both edges; those of three steps of D begin at a fold within.
    assert sorted(found["special_points/slope"][rows]) == (
        [low, low] if steps == 1 else []
    ) + [high, high]
    assert (found["special_points/error_bound"][rows] < 1e-14).all()
    for k in rows:
        of_branch = found["branches/branch"] == found["special_points/branch"][k]
        at_edge = of_branch & np.isclose(
            found["branches/slope"], found["special_points/slope"][k], rtol=1e-12
        )
        for name in ("stance_angle", *RATES, "period"):
            nearest = np.abs(
                found[f"branches/{name}"][at_edge] / found[f"special_points/{name}"][k]
                - 1
            ).min()
            assert nearest < 1e-9, name


def test_a_branch_that_ends_within_its_window_has_no_row_at_its_edges(tables):
    for walker, table in tables.items():
        kinds = table["special_points/kind"].astype(str)
        assert ("window" in kinds) == (walker == "physical-straight")


def test_two_flips_between_two_nodes_are_both_located():
    """Between the nodes the scalar changes its sign twice: neither was seen."""
    problem, found = branches("A", detuning=0.6, m_h=0.5)
    (doubling,) = [each for each in found if passings(problem, each, FLIP)]
    flips = [place for place, _ in passings(problem, doubling, FLIP)]
    outside = np.r_[: int(flips[0]) + 1, int(flips[1]) + 1 : len(doubling.q)]

    located = passings(problem, doubling.part(outside), FLIP)

    slopes = sorted(float(np.exp(point.at.q[0])) for _, point in located)
    assert slopes == pytest.approx([0.0085101, 0.0098504], rel=2e-3)
    places = [place for place, _ in located]
    assert int(places[0]) == int(places[1]) == int(flips[0])


def _special(walker, window, **keys):
    """Slopes of special points by kind, in their order along branches; and their
    derivatives by kind and key.
    """
    line = {"walker": walker, "set": keys}
    params = {"line": line, "slope_from": window[0], "slope_to": window[1], "n": 2}
    tables = branch({**params, "sensitivities": True}, [atlas(params, [])])
    rows = [tables[f"special_sensitivities/{name}"] for name in DERIVATIVES]
    slopes, by_key = {}, {}
    for _, kind, slope, key, _, value in zip(*rows, strict=True):
        slopes.setdefault(kind, []).append(slope)
        by_key.setdefault((kind, key), []).append(value)
    return {kind: [*dict.fromkeys(every)] for kind, every in slopes.items()}, by_key


def test_derivatives_of_special_points_have_units_and_none_where_limits_are_singular():
    """Massless legs with round feet have no derivative by what would be their only
    inertia; gaits' tables tell why.
    """
    line = {"walker": "D", "set": {"R": 0.1}}
    params = {"line": line, "slope_from": 0.005, "slope_to": 0.1, "n": 2}
    tables = branch({**params, "sensitivities": True}, [atlas(params, [])])

    values = tables["special_sensitivities/slope_by_key"]
    keys = set(tables["special_sensitivities/key"].tolist())
    assert len(values) and np.isfinite(values).all()
    assert {"m_s", "w_s", "R"} <= keys and not keys & {"r_t", "c_t", "w_t"}
    assert set(tables["special_sensitivities/key_units"].tolist()) == {"1", "rad"}


#: The walker, the window, kinds, and keys with their steps; one key has its least value.
MOVED = [
    (
        "physical-straight",
        (0.01, 0.1),
        {"fold", "end_tangential_heelstrike"},
        {"w_t": 1e-5, "R": 1e-5, "m_h": 1e-3},
    ),
    pytest.param(
        "physical",
        (0.015, 0.06),
        {"fold", "flip", "end_kneestrike_at_heelstrike", "release_hyperextension"},
        {"w_t": 1e-6, "c_s": 1e-6, "m_h": 1e-4},
        marks=pytest.mark.thorough,
    ),
]


@pytest.mark.thorough
@pytest.mark.parametrize(("walker", "window", "kinds", "steps"), MOVED)
def test_slopes_of_special_points_move_as_those_located_again(
    walker, window, kinds, steps
):
    slopes, by_key = _special(walker, window)
    assert kinds <= set(slopes)

    for key, step in steps.items():
        value = getattr(resolve(walker), key)
        lower = value if value < step else value - step
        middle = 2 * value + step if value < step else value
        below, _ = _special(walker, window, **{key: lower})
        above, _ = _special(walker, window, **{key: value + step})
        for kind in kinds:
            difference = np.subtract(above[kind], below[kind]) / (value + step - lower)
            # On one side the quotient is that in the middle.
            within = 1e-4 if middle == value else 2e-2
            np.testing.assert_allclose(by_key[kind, key], difference, rtol=within)


@pytest.mark.parametrize(("walker", "window", "kinds", "steps"), MOVED)
def test_slopes_of_special_points_have_no_units(walker, window, kinds, steps):
    """Euler's theorem: of a slope the sum of p d/dp over lengths, or masses, is 0."""
    _, by_key = _special(walker, window)

    for kind in kinds:
        for quantity in ("length", "mass"):
            terms = [
                getattr(resolve(walker), key) * np.array(by_key[kind, key])
                for key, of_key in KEYS.items()
                if of_key == quantity
            ]
            size = np.abs(terms).sum(axis=0)
            assert (np.abs(np.sum(terms, axis=0)) < 1e-6 * size).all(), kind
        assert (np.abs(by_key[kind, "g"]) < 1e-9).all()
