"""Lines computed side by side: the same bits as alone, and the same gaits by either
road.
"""

import numpy as np
import pytest

from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.mechanics.kernel import LANES
from gaitsweep.tasks.step.problem import Lanes, Problem
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.studies.solve_points import atlas, lines, points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from lines import WANT

SLOPES = np.geomspace(1e-3, 0.15, 12)
FAMILIES = {
    "E": ("foot_mass_ratio", 0.02, 0.45),
    "A": ("detuning", -0.3, 1.3),
    "C": ("detuning", -0.3, 1.3),
}


def block(members, slopes=SLOPES):
    return lines({"lines": members, "slope": slopes, "want": WANT, "gaits": GAITS}, [])


def drawn(name, count):
    key, low, high = FAMILIES[name]
    return [
        {"walker": name, "set": {key: float(v)}}
        for v in np.random.default_rng(3).uniform(low, high, count)
    ]


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        assert a.keys() == b.keys()
        for name in a:
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)


def assert_independent(members, sizes):
    whole = block(members)
    for size in sizes:
        order = np.random.default_rng(size).permutation(len(members))
        for k in range(0, len(order), size):
            part = order[k : k + size]
            for i, alone in zip(part, block([members[i] for i in part]), strict=True):
                assert_same(alone, whole[i])


@pytest.mark.parametrize("name", FAMILIES)
def test_a_line_does_not_depend_on_its_company(name):
    assert_independent(drawn(name, 6), [1, 4])


@pytest.mark.soak
@pytest.mark.parametrize("name", FAMILIES)
def test_a_line_does_not_depend_on_its_company_in_large_blocks(name):
    assert_independent(drawn(name, 64), [1, 7, 64])


def test_lines_that_a_process_has_surveyed_are_not_surveyed_again(monkeypatch):
    """In a block of other lines and of another study, they keep their bits."""
    surveyed, survey = [], solve_points.atlases.survey_lines
    monkeypatch.setattr(solve_points, "_MAX_SURVEYED", 3)
    monkeypatch.setattr(
        solve_points.atlases,
        "survey_lines",
        lambda p, t: surveyed.append(len(p.walkers)) or survey(p, t),
    )
    a, b, c, d = drawn("E", 4)
    first, later = block([a, b]), block([b, c], SLOPES[:5])
    assert surveyed == [2, 1]
    assert_same(later[0][:1], first[1][:1])
    (alone,) = block([b], SLOPES[:5])
    assert_same(alone, later[0])
    fine = atlas({"line": b}, [])
    assert surveyed == [2, 1, 1] and fine["Z"].shape[1] != alone[0]["Z"].shape[1]
    block([d])  # of four lines the earliest is forgotten
    assert len(solve_points._surveyed) == 3
    solve_points._surveyed.clear()
    assert_same(block([b], SLOPES[:5])[0], alone)


def test_a_block_holds_lines_of_any_structure():
    """Where a key passes a value at which constants vanish, the compiled code is
    another.
    """
    members = [
        *({"walker": "E", "set": {"foot_mass_ratio": v}} for v in (0.0, 1e-6, 0.1)),
        *({"walker": "A", "set": {"detuning": v}} for v in (0.0, 1e-9, 0.2)),
        {"walker": "D", "set": {}},
        {"walker": "C", "set": {}},
    ]
    for member, together in zip(members, block(members), strict=True):
        assert_same(block([member])[0], together)
    limit, near = (together[1]["stance_angle"][:, 0] for together in block(members[:2]))
    np.testing.assert_allclose(limit, near, rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "value"), [("E", 0.15), ("A", 0.3), ("A", 1.2), ("C", 0.3), ("C", 1 / 9)]
)
def test_both_roads_agree_within_their_bounds(name, value):
    line = {"walker": name, "set": {FAMILIES[name][0]: value}}
    fine = atlas({"line": line}, [])
    long_road = points(
        {"line": line, "slope": SLOPES, "want": WANT, "gaits": GAITS}, [fine]
    )
    _, short_road = block([line])[0]
    for name in ("status", "branch", "piece"):
        np.testing.assert_array_equal(long_road[name], short_road[name])
    bound = long_road["error_bound"] + short_road["error_bound"]
    solved = long_road["status"] == 0
    rates = np.max(
        np.abs(
            [long_road[n][solved] for n in ("stance_rate", "thigh_rate", "shank_rate")]
        ),
        axis=0,
    )
    farthest = 0.0
    for name in ("stance_angle", "period", "thigh_rate"):
        size = rates if name == "thigh_rate" else long_road[name][solved]
        apart = np.abs(long_road[name] - short_road[name])[solved] / size
        assert (apart <= bound[solved]).all()
        farthest = max(farthest, float(apart.max()))
    assert farthest > 0


def test_a_block_of_lines_without_gaits():
    """Detuned walkers have none at slopes far below those of their smallest steps."""
    members = [{"walker": "A", "set": {"detuning": v}} for v in (0.5, 0.8, 1.1)]
    for _, found in block(members, np.array([1e-6, 2e-6])):
        assert (found["status"] == 1).all()
        assert all("searched" in sentence for sentence in found["reasons"][1:2])


@pytest.mark.parametrize("name", ["D", "A", "C"])
@pytest.mark.parametrize("trouble", [np.nan, 1e3])
def test_a_lost_neighbour_changes_no_bit(name, trouble):
    """A register's sines are computed in another way where one of its arguments is not
    finite, or large.
    """
    problem = Problem(CATALOGUE[name])
    (branches, _) = block([{"walker": name, "set": {}}], np.array([0.01]))[0]
    Z = branches["Z"][:, :: max(1, branches["Z"].shape[1] // (2 * LANES))][
        :, : 2 * LANES
    ]
    w, q = Z[:-1], Z[-1]
    alone, _ = problem.stride(w, q, by_drive=True, samples=4)
    lost = w.copy()
    lost[1, ::3] = trouble
    beside, _ = problem.stride(lost, q, by_drive=True, samples=4)
    intact = np.arange(len(q)) % 3 > 0
    for field in (
        "image",
        "jacobian",
        "by_drive",
        "inverse",
        "newton",
        "times",
        "impact",
        "start",
    ):
        np.testing.assert_array_equal(
            getattr(alone, field)[..., intact], getattr(beside, field)[..., intact]
        )
    for a, b in zip(alone.motion, beside.motion, strict=True):
        np.testing.assert_array_equal(a[..., intact], b[..., intact])


def test_lanes_have_the_walkers_they_are_given():
    walkers = [CATALOGUE["C"], CATALOGUE["physical"], CATALOGUE["C-printed"]]
    some = Lanes(walkers).some(np.array([2, 0, 2])).some(np.array([1, 2]))
    assert [some.walker_of(i) for i in range(2)] == [walkers[0], walkers[2]]
    one = np.ones(2)
    np.testing.assert_array_equal(
        some.parameters(one, one)[2:, 1],
        Problem(walkers[2]).parameters(one, one)[2:, 0],
    )
