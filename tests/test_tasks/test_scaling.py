"""Walkers that differ only in their units are solved once."""

import tomllib

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.study.parse import parse
from gaitsweep.tasks.contract.accuracy import significant_bits
from gaitsweep.tasks.contract.registry import VARIABLES
from gaitsweep.tasks.mechanics.kernel import FLOWS
from gaitsweep.tasks.studies import solve_planes, solve_points
from gaitsweep.tasks.studies.map_designs import design
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.scaling import scales, scaling

ONE_LINK = {"knees": False, "l": 1.0, "m": 2.0, "c": 0.4, "r": 0.1}
HIPPED = {**ONE_LINK, "m_h": 1.0}
WANT = ["stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period", "speed"]
WANT += ["energy", "multipliers", "violations", "step_length", "power"]


@pytest.mark.parametrize(
    ("walker", "changes", "keys"),
    [
        (
            "C",
            {"g": 3.0},
            ["g"],
        ),
        (
            "C",
            {"g": 3.0, "R": 0.2},
            ["g"],
        ),
        (
            "C",
            {"m_h": 2.0},
            [],
        ),
        (
            "E",
            {"m_t": 0.8, "m_s": 0.2},
            ["m_t", "m_s"],
        ),
        (
            "E",
            {"m_t": 0.8, "m_s": 0.2, "g": 2.0},
            ["m_t", "m_s", "g"],
        ),
        (
            "E",
            {"m_t": 0.8, "m_s": 0.21, "g": 2.0},
            ["g"],
        ),
        (
            "E",
            {"foot_mass_ratio": 0.1, "g": 2.0},
            ["g"],
        ),
        (
            "E",
            {"l_t": 1.5, "l_s": 1.5, "c_s": 1.5},
            ["l_t", "l_s", "c_s"],
        ),
        (
            "E",
            {"l_t": 1.5, "l_s": 1.5, "c_s": 1.4},
            [],
        ),
        (
            "D",
            {"m_t": 3.0},
            ["m_t"],
        ),
        (
            ONE_LINK,
            {"m": 3.0},
            ["m"],
        ),
        (
            ONE_LINK,
            {"l": 3.0, "c": 1.2, "r": 0.3},
            ["l", "c", "r"],
        ),
        (
            ONE_LINK,
            {"l": 3.0, "c": 1.2},
            [],
        ),
        (
            HIPPED,
            {"m": 3.0},
            [],
        ),
        (
            HIPPED,
            {"m": 3.0, "m_h": 1.5},
            ["m", "m_h"],
        ),
    ],
)
def test_keys_that_change_only_units_are_known(walker, changes, keys):
    line = {"walker": walker, "set": changes}
    assert [*scales(walker_of_line(line), line)] == keys


@pytest.mark.parametrize(
    ("walker", "changes", "keys"),
    [
        ("C", {"g": 3.0, "R": 0.2}, ["g"]),
        # Masses that are those of the base at one point of a grid need not be elsewhere.
        ("E", {"m_t": 0.4, "m_s": 0.1}, []),
        ("D", {"m_t": 3.0, "R": 0.1}, ["m_t"]),
        # Where the hip may weigh something, the leg's mass is no unit.
        (ONE_LINK, {"m": 3.0, "m_h": 0.0}, []),
        (ONE_LINK, {"m": 3.0, "g": 2.0, "c": 0.5}, ["m", "g"]),
        (HIPPED, {"m": 2.0}, []),
        ("D", {"foot_mass_ratio": 0.0, "m_t": 3.0}, []),
        ("C", {"g": 3.0, "push_off": 0.0}, []),
    ],
)
def test_axes_that_change_only_units_are_known(walker, changes, keys):
    line = {"walker": walker, "set": changes}
    try:
        own = walker_of_line(line)
    except ValueError:
        own = walker_of_line({**line, "set": {}})
    assert [*scaling(own, line)] == keys


def test_a_unit_is_that_of_its_kind():
    length, mass, time = 2.0, 3.0, 5.0
    expected = {
        "stance_angle": 1.0,
        "period": time,
        "stance_rate": 1 / time,
        "speed": length / time,
        "loss_normal": mass * length**2 / time**2,
        "power": mass * length**2 / time**3,
        "least_normal_impulse": mass * length / time,
        "unlocking_torque": mass * length**2 / time**2,
        "unlocking_impulse_heelstrike": mass * length**2 / time,
        "scuff_depth": length,
        "froude_speed": 1.0,
    }
    for name, unit in expected.items():
        assert VARIABLES[name].unit(length, mass, time) == pytest.approx(
            unit, rel=1e-15
        )


#: Walkers with keys that only scale them, and the same in tables of their own.
SCALED = [
    (
        "C",
        {"g": 1.62},
    ),
    (
        "physical",
        {"g": 24.79},
    ),
    (
        "E",
        {"m_t": 0.8 * 0.7, "m_s": 0.2 * 0.7, "g": 3.0},
    ),
    (
        "E",
        {"l_t": 1.7, "l_s": 1.7, "c_s": 1.7, "m_t": 1.2, "m_s": 0.3},
    ),
    (
        {"base": "C", "trailing_knee": "locked"},
        {"g": 1.62},
    ),
]


def sentences(found):
    """What is said of each gait of a grid."""
    return found.reason_text.values[found.reason.values]


def assert_alike(name, one, other, bound):
    """Check that values of a variable agree to their bounds, or where these are of
    other variables to nine digits.
    """
    if one.dtype.kind != "f":
        assert (one == other).all(), name
        return
    there = np.isfinite(other)
    assert (np.isfinite(one) == there).all(), name
    if name in ("stance_angle", "period"):
        assert (np.abs(one - other) <= bound * np.abs(other))[there].all(), name
        return
    size = np.abs(other[there]).max(initial=0.0)
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * size)


@pytest.mark.parametrize(("walker", "keys"), SCALED)
def test_converted_gaits_are_those_that_are_solved(walker, keys):
    slopes = [0.02, 0.036, 0.2]
    base = walker
    if isinstance(walker, str):
        base = {"base": walker}

    converted = gaitsweep.gaits(walker, slopes, variables=WANT, **keys)

    solved = gaitsweep.gaits({**base, **keys}, slopes, variables=WANT)
    bound = (converted.error_bound + solved.error_bound).values
    assert np.isfinite(bound).any()
    assert (sentences(converted) == sentences(solved)).all()
    rounding = ("reason", "residual", "energy_imbalance")
    for name in solved.data_vars:
        if name in VARIABLES and name not in rounding:
            assert_alike(name, converted[name].values, solved[name].values, bound)


def equal(one, other):
    """Whether two grids have the same bytes and say the same."""
    if not (sentences(one) == sentences(other)).all():
        return False

    for name in one.data_vars:
        if name in ("reason", "reason_text"):
            continue
        a = one[name].values
        b = other[name].values
        if not np.array_equal(a, b, equal_nan=a.dtype.kind == "f"):
            return False
    return True


def test_a_gait_has_the_same_bytes_alone_and_beside_others():
    slopes = np.geomspace(1e-3, 0.3, 12)
    g = np.linspace(1.6, 25, 12)

    pairs = gaitsweep.gaits("C", slopes, g=g, variables=WANT)
    grid = gaitsweep.gaits("C", slopes[:, None], g=g[None], variables=WANT)

    for i in (0, 5, 11):
        alone = gaitsweep.gaits("C", slopes[i], g=float(g[i]), variables=WANT)
        assert equal(alone, pairs.isel(slope=i))
        assert equal(alone, grid.isel(dim_0=i, dim_1=i))


def test_lines_have_the_same_bytes_alone_and_beside_others_and_python_their_numbers():
    slopes = np.array([0.01, 0.05, 0.3])
    lines = [{"walker": "B", "set": {"R": 0.21, "g": g}} for g in (2.0, 3.0, 4.0)]
    request = {"slope": slopes, "want": WANT}

    beside = solve_points.lines({**request, "lines": lines}, [])
    (alone,) = solve_points.lines({**request, "lines": lines[1:2]}, [])

    atlas = solve_points.atlas({"line": lines[1], "coarse": True}, [])
    by_itself = solve_points.points({**request, "line": lines[1]}, [atlas])
    found = gaitsweep.gaits("B", slopes, R=0.21, g=3.0, variables=WANT)
    own = beside[1][1]
    assert (own["reasons"] == alone[1]["reasons"]).all()
    assert (own["reasons"] == by_itself["reasons"]).all()
    for name, values in own.items():
        if name in ("reasons", "reason"):
            continue
        nan = values.dtype.kind == "f"
        for other in (alone[1][name], by_itself[name]):
            assert np.array_equal(values, other, equal_nan=nan)
        # Few points are solved by other code, which rounds otherwise.
        if name in found and "error" not in name:
            np.testing.assert_allclose(found[name], values, rtol=1e-11, atol=1e-12)


def test_a_study_says_how_long_it_searched_in_the_walkers_own_time():
    request = {"slope": np.array([0.3]), "want": ["period"]}
    line = {"walker": "B", "set": {"R": 0.21, "g": 3.0}}
    table = {"walker": {"base": "B", "R": 0.21, "g": 3.0}, "set": {}}

    ((_, converted),) = solve_points.lines({**request, "lines": [line]}, [])

    ((_, solved),) = solve_points.lines({**request, "lines": [table]}, [])
    assert (converted["reasons"] == solved["reasons"]).all()
    ((_, other),) = solve_points.lines(
        {**request, "lines": [{**line, "set": {"R": 0.21}}]}, []
    )
    assert (converted["reasons"] != other["reasons"]).any()


def work(call):
    """Steps that a call integrates."""
    before = sum(flow.evaluations for flow in FLOWS.values())
    call()
    return sum(flow.evaluations for flow in FLOWS.values()) - before


@pytest.mark.parametrize("walker", ["B", "C"])
def test_an_axis_of_g_costs_no_step(walker):
    slopes = np.geomspace(1e-3, 0.07, 40)
    g = np.linspace(1.6, 25, 40)
    # Of no other test, so that no branches of theirs are known yet.
    radii = iter(0.213 + np.pi * 1e-6 * np.arange(1, 9))

    def solved(slopes, **keys):
        return work(lambda: gaitsweep.gaits(walker, slopes, R=next(radii), **keys))

    of_slopes = solved(slopes)
    of_one = solved(0.02)

    assert of_slopes > of_one > 0
    assert solved(slopes, g=g) < 1.01 * of_slopes
    assert solved(slopes[:, None], g=g[None]) < 1.01 * of_slopes
    assert solved(0.02, g=g) < 1.01 * of_one


def test_an_axis_of_g_over_many_slopes_costs_no_step():
    """Lines of a study that are solved one by one, and the bytes of one alone."""
    slopes = np.geomspace(1e-3, 0.07, 400)
    atlas = solve_points.atlas({"line": {"walker": "B", "set": {}}}, [])
    request = {"slope": slopes, "want": WANT}
    lines = [{"walker": "B", "set": {"g": g}} for g in (2.0, 3.0, 5.0, 9.0)]

    def points(line):
        return solve_points.points({**request, "line": line}, [atlas])

    solve_points._solved.clear()
    of_one = work(lambda: points(lines[0]))
    of_others = work(lambda: [points(line) for line in lines[1:]])
    beside = points(lines[2])
    solve_points._solved.clear()
    alone = points(lines[2])

    assert of_one > 0 and of_others == 0
    for name, values in alone.items():
        nan = values.dtype.kind == "f"
        assert np.array_equal(beside[name], values, equal_nan=nan), name


def test_points_of_other_branches_are_not_taken_for_a_lines():
    """A coarse atlas has gaits to other last digits than a fine one."""
    line = {"walker": "B", "set": {"g": 3.0}}
    fine, coarse = (
        solve_points.atlas({"line": line, "coarse": is_coarse}, [])
        for is_coarse in (False, True)
    )
    request = {"slope": np.array([0.01, 0.02]), "want": ["period"], "line": line}

    solve_points._solved.clear()
    for atlas in (fine, coarse, fine):
        solve_points.points(request, [atlas])

    assert len(solve_points._solved) == 2


def test_points_that_are_remembered_have_a_limit(monkeypatch):
    atlas = solve_points.atlas({"line": {"walker": "B", "set": {}}}, [])
    line = {"walker": "B", "set": {"g": 3.0}}

    def points(low):
        slopes = np.geomspace(low, 0.07, 400)
        return solve_points.points(
            {"slope": slopes, "want": ["period"], "line": line}, [atlas]
        )

    solve_points._solved.clear()
    size = sum(values.nbytes for values in points(1e-3).values())
    monkeypatch.setattr(solve_points, "_MAX_BYTES", int(2.5 * size))
    for low in (2e-3, 3e-3, 4e-3):
        points(low)

    assert len(solve_points._solved) == 2


def test_two_axes_that_only_scale_cost_no_step():
    masses = np.linspace(1.0, 3.0, 12)[:, None]
    g = np.linspace(2.0, 9.0, 12)[None]
    walkers = iter({**ONE_LINK, "c": 0.41 + 1e-6 * k} for k in range(2))

    one = work(lambda: gaitsweep.gaits(next(walkers), 0.01))
    many = work(lambda: gaitsweep.gaits(next(walkers), 0.01, m=masses, g=g))

    assert 0 < many < 1.05 * one


def test_a_g_that_cannot_be_costs_its_points_alone():
    g = np.array([9.81, -1.0, np.nan, 2.0, 0.0, np.inf])
    found = gaitsweep.gaits("B", 0.02, g=g)
    is_there = np.isfinite(found.stance_angle[:, 0].values)
    assert is_there.tolist() == [True, False, False, True, False, False]
    said = [str(found.reason_text[k].values) for k in found.reason[:, 0].values]
    assert said[1].startswith("`g` must be > 0")
    assert said[2].startswith("`g` must be finite")


def test_lines_that_differ_in_g_read_one_atlas(tmp_path):
    text = 'name = "s"\nwalker = "C"\naxes.g = [2.0, 3.0]\naxes.R = [0.2, 0.21]\n'
    text += "axes.slope = { from = 0.01, to = 0.05, n = 300 }\n"

    graph = Graph(parse(tomllib.loads(text), text, tmp_path / "s.toml"))
    keys = [graph.line_keys(k)["atlas"] for k in range(4)]
    assert keys[0] == keys[2] != keys[1] == keys[3]
    points = {graph.line_keys(k)["points"] for k in range(4)}
    assert len(points) == 4


def test_gaits_to_an_accuracy_are_not_converted_but_right():
    g = np.array([1.62, 9.81])
    found = gaitsweep.gaits("A", 0.02, g=g, accuracy=1e-6)
    exact = gaitsweep.gaits("A", 0.02, g=g)
    apart = np.abs(found.period / exact.period - 1).values
    assert np.nanmax(apart) < 1e-6
    # Rounded to the bits that the accuracy leaves, which a conversion would undo.
    mantissa, _ = np.frexp(found.period.values[:, 0])
    scaled = mantissa * 2.0 ** (significant_bits(1e-6) + 1)
    assert (scaled == np.round(scaled)).all()


#: Walkers over a plane of keys at two slopes, with values of `g`.
RADII = {"keys": ["R"], "low": [0.2], "high": [0.25], "log": [False], "lines": 16}
OVER_RADII = {"slope": np.array([0.02, 0.03]), "want": WANT, "plane": RADII}


@pytest.fixture(scope="module")
def charts():
    window = {"slope_from": 0.02, "slope_to": 0.03, "slopes": 2, "want": ()}
    line = {"walker": "B", "set": {}}
    return solve_planes.charts({"line": line, "plane": RADII, **window}, [])


def over_radii(charts, lines):
    ((_, points),) = solve_planes.lines({**OVER_RADII, "lines": lines}, [charts])
    return points


def test_planes_over_g_cost_no_step_and_are_those_that_are_solved(charts):
    radii = np.linspace(0.2, 0.25, 4).tolist()
    one = [{"walker": "B", "set": {"R": R}} for R in radii]
    many = [
        {"walker": "B", "set": {"g": g, "R": R}} for g in (2.0, 9.81) for R in radii
    ]
    other = {"base": "B", "g": 9.81}
    table = [{"walker": other, "set": {"R": R}} for R in radii]

    of_one = work(lambda: over_radii(charts, one))
    of_many = work(lambda: over_radii(charts, many))
    converted = over_radii(charts, many)
    solved = over_radii(charts, table)

    assert 0 < of_many <= of_one
    n = len(radii) * 2
    bound = converted["error_bound"][n:] + solved["error_bound"]
    for name, values in solved.items():
        if name not in ("reasons", "residual", "energy_imbalance"):
            assert_alike(name, converted[name][n:], values, bound)


def test_a_line_of_a_plane_over_g_has_the_same_bytes_alone(charts):
    lines = [
        {"walker": "B", "set": {"g": g, "R": R}}
        for R in (0.2, 0.217, 0.25)
        for g in (2.0, 3.0, 9.81)
    ]

    beside = over_radii(charts, lines)
    alone = over_radii(charts, lines[4:5])

    for name, values in alone.items():
        if name not in ("reasons", "reason"):
            nan = values.dtype.kind == "f"
            assert np.array_equal(beside[name][8:10], values, equal_nan=nan), name


def test_a_g_of_a_plane_that_cannot_be_is_refused(charts):
    lines = [{"walker": "B", "set": {"g": g, "R": 0.21}} for g in (2.0, -1.0)]
    with pytest.raises(ValueError, match="`g` must be > 0"):
        over_radii(charts, lines)


def test_a_chunk_of_a_plane_has_all_values_of_g(tmp_path):
    text = 'name = "s"\nwalker = "B"\naxes.slope = [0.02, 0.03]\n'
    text += "axes.R = { from = 0.2, to = 0.25, n = 40 }\n"
    text += "axes.g = { from = 1, to = 9, n = 20 }\n"
    text += "axes.m_h = { from = 0.1, to = 0.2, n = 30 }\n"

    graph = Graph(parse(tomllib.loads(text), text, tmp_path / "s.toml"))

    assert graph.study.plane.region["keys"] == ["R", "m_h"]
    chunks = [graph.grid.chunk(k) for k in range(graph.grid.chunks)]
    numbers = np.concatenate([chunk.numbers for chunk in chunks])
    assert sorted(numbers.tolist()) == [*range(24000)]
    assert all(chunk.spans["g"] == slice(0, 20) for chunk in chunks)
    assert len({graph.line_keys(k)["charts"] for k in (0, 30, 23999)}) == 1


def designs(walker, at, **options):
    line = {"walker": walker, "set": {key: np.array(each) for key, each in at.items()}}
    return design({"line": line, "slope": np.array([1e-4, 0.3]), **options}, [])


def test_designs_that_differ_in_units_are_solved_once():
    g = [1.0, 4.0, -1.0, 9.81]
    mass = [1.0, 1.0, 1.0, 5.0]

    of_one = work(lambda: designs("D", {"g": [1.0]}, at_slope=0.009, ground=0.01))
    found = {}
    of_all = work(
        lambda: found.update(
            designs("D", {"g": g, "m_t": mass}, at_slope=0.009, ground=0.01)
        )
    )
    other = {"base": "D", "g": 9.81, "m_t": 5.0}
    solved = designs(other, {}, at_slope=0.009, ground=0.01)

    assert 0 < of_all < 1.05 * of_one
    assert found["design/smallest_at"][2] == "no walker"
    for name, (value,) in solved.items():
        if value.dtype.kind != "f":
            assert found[name][3] == value, name
        elif not name.endswith("_error"):
            np.testing.assert_allclose(found[name][3], value, rtol=1e-9, err_msg=name)


def test_designs_of_a_job_differ_in_units(tmp_path):
    text = 'name = "s"\nkind = "design"\nwalker = "B"\naxes.slope = [1e-5, 0.4]\n'
    text += "axes.g = { from = 1, to = 9, n = 20 }\naxes.R = { from = 0.1, to = 0.2, n = {n} }\n"
    for n, lines in ((30, None), (500, 500)):
        own = text.replace("{n}", str(n))

        study = parse(tomllib.loads(own), own, tmp_path / "s.toml")

        assert (study.plane.lines if study.plane else None) == lines
        assert study.batches == 1
        line = study.batch_line(0)["set"]
        assert len(np.unique(line["R"])) == n and len(line["g"]) == 20 * n
