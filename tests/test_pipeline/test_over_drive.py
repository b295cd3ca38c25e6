"""Branches, cascades, orbits, basins and censuses over what drives on level ground, from
TOML to page.
"""

import json
import re
import shlex
from urllib.parse import parse_qsl

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import gaitsweep
from gaitsweep import simulate, solve, step_map
from gaitsweep.pipeline.archive.diff import diff
from gaitsweep.pipeline.cli.commands import main
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.report import source
from gaitsweep.pipeline.report.figures import over_key
from gaitsweep.pipeline.report.figures.starts import addresses
from gaitsweep.pipeline.study.parse import parse, read
from gaitsweep.tasks.fits.feigenbaum import DELTA

PUSHES = {"from": 1e-3, "to": 0.9, "n": 60}
STATE = ["stance_angle", "stance_rate", "thigh_rate"]


def study(kind, walker="D", slope=(0.0,), push_off=PUSHES, options=None, **more):
    axes = {"slope": list(slope), "push_off": push_off}
    about = {"name": kind, "kind": kind, "walker": walker, "axes": axes}
    return about | ({"options": options} if options else {}) | more


def run(folder, table):
    archive = folder / f"{table['name']}.nc"
    gaitsweep.run(table, jobs=1, archive=archive, quiet=True)
    return archive


def table_of(archive, group):
    with xr.open_dataset(archive, group=group) as rows:
        return rows.load().to_dataframe()


@pytest.fixture(scope="module")
def branches(tmp_path_factory):
    folder = tmp_path_factory.mktemp("branches")
    wanted = {"figures": ["locus"]}
    return run(folder, study("branch", walker=["B", "D"], want=wanted))


def points_of(archive, walker, kind):
    points = table_of(archive, "special_points")
    return points[(points["walker"] == walker) & (points["kind"] == kind)]


@pytest.mark.parametrize("walker", ["B", "D"])
def test_flips_over_the_push_off_are_gaits_with_a_multiplier_of_minus_one(
    branches, walker
):
    """Single gaits are solved at their push-offs, which knows of no flip."""
    flips = points_of(branches, walker, "flip")
    assert len(flips) > 1
    for flip in flips.itertuples():
        found = solve(walker, 0.0, push_off=flip.push_off)
        nearest = (found["stance_angle"] - flip.stance_angle).abs().idxmin()
        gait = found.loc[nearest]
        assert gait["stance_angle"] == pytest.approx(flip.stance_angle, rel=1e-12)
        assert min(abs(m + 1) for m in gait["multipliers"]) < 1e-12


def test_a_curve_over_a_key_is_stable_up_to_its_flips(branches, tmp_path):
    """Drawn from a grid of few values, 0.025 apart."""
    pushes = {
        "from": 0.05,
        "to": 0.75,
        "n": 29,
    }
    wanted = {
        "variables": ["stance_angle", "multipliers"],
        "figures": ["over_key"],
    }
    archive = run(tmp_path, study("grid", push_off=pushes, want=wanted))
    (axes,) = over_key.over_key(source.read(archive)).panels
    thick = [line.get_xydata() for line in axes.lines if line.get_linewidth() == 2.6]
    drawn = [xy[np.isfinite(xy).all(axis=1)] for xy in thick]
    low, high = (xy for xy in drawn if len(xy))

    flips = points_of(branches, "D", "flip").sort_values("push_off")[:2]
    expected = flips[["push_off", "stance_angle"]].to_numpy()
    np.testing.assert_allclose(
        [low[-1], high[0]],
        expected,
        rtol=2e-3,
    )


def test_a_fold_over_the_push_off_is_where_its_derivative_vanishes(tmp_path):
    """At a fold the step map, flown from the state alone, has a multiplier of 1; gaits
    lie on one side of it.
    """
    archive = run(tmp_path, study("branch", "E", [-0.01]))
    points = table_of(archive, "special_points")
    folds = points[points["kind"] == "fold"]
    assert len(folds) == 4
    fold = folds.iloc[folds["push_off"].argmin()]
    assert fold["error_bound"] < 1e-12

    push = float(fold["push_off"])
    state = [float(fold[name]) for name in STATE]
    at = step_map("E", -0.01, state, push_off=push)
    assert min(abs(at.eigenvalues - 1)) < 1e-9
    assert len(solve("E", -0.01, push_off=push * (1 + 1e-6))) == 2
    assert len(solve("E", -0.01, push_off=push * (1 - 1e-6))) == 0


def test_short_steps_vanish_at_a_finite_push_off(branches):
    """Squares of the angles of gaits beside that impulse lead to it on a line."""
    (limit,) = points_of(branches, "B", "end_zero_step")["push_off"]
    beside = limit * (1 + np.array([1e-6, 2e-6]))
    squares = []
    for push in beside:
        found = solve("B", 0.0, push_off=push)
        squares.append(found["stance_angle"].min() ** 2)
    rate = (squares[1] - squares[0]) / (beside[1] - beside[0])
    assert beside[0] - squares[0] / rate == pytest.approx(limit, rel=1e-9)
    assert table_of(branches, "special_points")["kind"].eq("fold").sum() == 0


@pytest.mark.parametrize("walker", ["B", "D"])
def test_branches_cross_within_the_bounds_of_both(branches, walker):
    """The long and the short gait of level ground become one: each branch has its own
    equations there, which are singular.
    """
    points = points_of(branches, walker, "branch_point")
    first, second = points.itertuples()
    allowed = first.push_off * (first.error_bound + second.error_bound)
    assert abs(first.push_off - second.push_off) < allowed < 1e-6


def test_contact_is_lost_where_the_least_force_vanishes(branches):
    for lost in points_of(branches, "D", "end_contact_lost").itertuples():
        found = solve("D", 0.0, push_off=lost.push_off)
        nearest = (found["stance_angle"] - lost.stance_angle).abs().idxmin()
        assert abs(found["least_normal_force"][nearest]) < 1e-9


def test_an_archive_over_the_push_off_holds_it_by_its_name(branches, capsys):
    with xr.open_dataset(branches) as whole:
        assert whole.attrs["along"] == "push_off"
        assert dict(whole.sizes)["slope"] == 1
    rows = table_of(branches, "branches")
    assert rows["push_off"].between(1e-3, 0.9 + 1e-15).all()
    assert (rows["slope"] == 0).all()
    one = rows.iloc[len(rows) // 3]
    found = solve(one["walker"], 0.0, push_off=float(one["push_off"]))
    assert (found["stance_angle"] / one["stance_angle"] - 1).abs().min() < 1e-12
    assert main(["verify", str(branches)]) == 0
    assert main(["diff", str(branches), str(branches)]) == 0
    capsys.readouterr()


def test_a_page_draws_branches_over_the_push_off(branches, tmp_path):
    gaitsweep.report(branches, tmp_path)
    page = (tmp_path / "branch.html").read_text()
    assert "against push off along branches" in page
    assert "--set push_off=" in page
    figure = gaitsweep.figure(branches, "locus")
    assert figure.get_supxlabel() == "push off"


#: A walker of 3 kg with legs of 2 m, and its unit of impulses.
LARGE = {"base": "D", "m_t": 1.5, "l_t": 1.0, "l_s": 1.0, "c_s": 1.0, "g": 9.81}
SIZE = 3 * (2 * 9.81) ** 0.5


def test_branches_say_where_they_are_followed_no_further(tmp_path):
    """Beyond 2 mass sqrt(g leg) they go on, in any units; gaits are found there, too."""
    pushes, size = {"from": 1.9 * SIZE, "to": 9 * SIZE, "n": 9}, SIZE
    table = study("branch", LARGE, push_off=pushes, want={"figures": ["locus"]})
    archive = run(tmp_path, table)
    points = table_of(archive, "special_points")
    edges = points[points["kind"] == "window"]
    by_branch = edges.groupby("branch")["push_off"]
    assert by_branch.min().to_numpy() == pytest.approx([1.9 * size] * 2)
    assert by_branch.max().to_numpy() == pytest.approx([2 * size] * 2, rel=1e-14)
    assert table_of(archive, "branches")["push_off"].max() <= 2 * size * (1 + 1e-14)
    gaitsweep.report(archive, tmp_path)
    said = f"Beyond push off {2 * size:.4g} branches go on, and are not followed."
    assert said in (tmp_path / "branch.html").read_text()


def test_branches_beyond_their_reach_say_how_far_they_are_followed(tmp_path):
    table = study("branch", LARGE, push_off=[3 * SIZE, 4 * SIZE])
    archive = run(tmp_path, table)
    assert table_of(archive, "branches").empty
    with xr.open_dataset(archive) as whole:
        (said,) = whole["reason_text"].values.astype(str)
    assert f"Branches are followed over `push_off` from {1e-12 * SIZE:.6g}" in said


def commands_of(page):
    """The commands of the marks and maps of a page, as its script completes them."""
    for text in re.findall(r'class="marks">(.*?)</script>', page, re.S):
        for curve in json.loads(text):
            assert curve["command"].endswith("=")
            yield from (f"{curve['command']}{row[2]!r}" for row in curve["rows"])
    for text in re.findall(r'class="panels">(.*?)</script>', page, re.S):
        for panel in json.loads(text):
            yield f"{panel['command']} --slope {panel['slope']!r}"


SMALL = {
    "branch": ("locus", {"from": 0.05, "to": 0.2, "n": 8}, {}),
    "cascade": ("cascade", [0.05, 0.3], {"periods": 8, "steps": 0}),
    "orbit": ("bifurcation", [0.13, 0.15], {"starts": 1, "transient": 20, "steps": 4}),
    "basin": ("basin", [0.1, 0.12], {"size": 8, "steps": 10}),
    "census": ("census", [0.1, 0.2], {"starts": 300}),
}


@pytest.mark.parametrize("kind", SMALL)
@pytest.mark.parametrize(
    "is_file", [False, pytest.param(True, marks=pytest.mark.thorough)]
)
def test_commands_of_pages_run_where_the_walker_itself_has_what_drives(
    kind, is_file, tmp_path, capsys, monkeypatch
):
    """Given on the command line, or as the study's file, which the pages offer."""
    name, pushes, options = SMALL[kind]
    walker = {"base": "D", "push_off": 0.1} | ({"knees": False} if is_file else {})
    wanted = {"want": {"figures": [name]}, "options": options}
    archive = run(tmp_path, study(kind, walker, push_off=pushes, **wanted))
    gaitsweep.report(archive, tmp_path)
    commands = [*commands_of((tmp_path / f"{kind}.html").read_text())]
    assert len(commands) > 1 - (kind == "basin")

    monkeypatch.chdir(tmp_path)
    own = '[walker]\nbase = "D"\npush_off = 0.1\nknees = false\n'
    (tmp_path / f"{kind}.toml").write_text(own)
    for command in commands[:: max(1, len(commands) // 2)]:
        words = shlex.split(command)
        assert words[:2] == ["gaitsweep", "solve"]
        assert (f"{kind}.toml" in words) == is_file
        assert main(words[1:]) == 0, command
        capsys.readouterr()


def test_a_figure_of_a_cascade_names_the_only_line_with_flips(tmp_path):
    options = {"periods": 8, "steps": 0}
    table = study("cascade", slope=[0.0, -0.02], push_off=[0.05, 0.162])
    table |= {"options": options, "want": {"figures": ["cascade"]}}
    archive = run(tmp_path, table)
    (slope,) = table_of(archive, "cascade")["slope"].unique()
    assert slope == 0
    gaitsweep.report(archive, tmp_path)
    assert '"label":"γ = 0, period 1"' in (tmp_path / "cascade.html").read_text()


def test_a_cascade_over_the_push_off_follows_feigenbaum(tmp_path, branches):
    options = {"periods": 32, "steps": 0}
    archive = run(tmp_path, study("cascade", push_off=[0.05, 0.3], options=options))
    events = table_of(archive, "cascade")
    flips = events[events["kind"] == "flip"]["push_off"].to_numpy()
    assert len(flips) == 6
    ratios = np.diff(flips)[:-1] / np.diff(flips)[1:]
    assert ratios[-1] == pytest.approx(DELTA, rel=3e-3)

    # The first is that of the branch, located by other equations.
    first = points_of(branches, "D", "flip")["push_off"].min()
    assert flips[0] == pytest.approx(first, rel=1e-12)
    limit = table_of(archive, "accumulation").iloc[0]
    assert limit["low"] < limit["push_off"] < limit["high"]


@pytest.fixture(scope="module")
def orbits(tmp_path_factory):
    folder = tmp_path_factory.mktemp("orbits")
    pushes = {"from": 0.13, "to": 0.15, "n": 6}
    options = {"starts": 2, "transient": 300, "steps": 40, "shown": 4}
    wanted = {"figures": ["bifurcation", "exponents"]}
    return run(folder, study("orbit", push_off=pushes, options=options, want=wanted))


def test_orbits_over_the_push_off_double_at_the_flip(orbits, branches):
    with xr.open_dataset(orbits, group="orbits") as found:
        angles = found["stance_angle"].load()
    assert dict(angles.sizes) == {"slope": 1, "push_off": 6, "start": 2, "step": 4}
    spread = np.ptp(angles.values, axis=-1).max(axis=(0, 2))
    flip = points_of(branches, "D", "flip")["push_off"].min()
    is_single = angles["push_off"].values < flip
    assert 0 < is_single.sum() < 6
    assert (spread[is_single] < 1e-4).all()
    assert (spread[~is_single] > 1e-3).all()


def test_steps_of_orbits_over_the_push_off_are_those_of_a_simulation(orbits):
    with xr.open_dataset(orbits, group="orbits") as found:
        at = found.isel(slope=0, push_off=4, start=1).load()
    state = [float(at[name][0]) for name in STATE]
    flown = simulate("D", 0.0, state, 3, push_off=float(at["push_off"]))
    np.testing.assert_allclose(
        flown["stance_angle"].values[:3], at["stance_angle"].values[:3], rtol=1e-9
    )


def test_pages_of_orbits_over_the_push_off_name_it(orbits, tmp_path):
    gaitsweep.report(orbits, tmp_path)
    page = (tmp_path / "orbit.html").read_text()
    assert "stance angles against push off from 0.13 to 0.15" in page
    assert '"along":"push_off"' in page
    assert "steps of initial conditions that fall" not in page


def test_archives_over_other_push_offs_are_compared_at_those_they_share(
    orbits, tmp_path
):
    pushes = [0.13, 0.134, 0.138]
    options = {"starts": 2, "transient": 300, "steps": 40, "shown": 4}
    other = run(tmp_path, study("orbit", push_off=pushes, options=options))
    said = [*diff(orbits, other)]
    assert any("`orbits/push_off` are only in" in each for each in said)
    assert not any("stance_angle" in each for each in said)


@pytest.mark.thorough
def test_an_orbit_of_a_walker_with_a_drive_is_on_any_slope(tmp_path):
    """Level ground and uphill beside slopes that lead down."""
    table = study("orbit", {"base": "D", "push_off": 0.1}, [-0.001, 0.0, 0.001])
    del table["axes"]["push_off"]
    table["options"] = {"starts": 1, "transient": 300, "steps": 8, "shown": 2}
    archive = run(tmp_path, table)
    with xr.open_dataset(archive, group="orbits") as found:
        angles = found["stance_angle"].load()
    assert table_of(archive, "lyapunov")["slope"].is_monotonic_increasing
    for slope in (-0.001, 0.0, 0.001):
        single = solve("D", slope, push_off=0.1).set_index("gait").loc["long"]
        stored = angles.sel(slope=slope).values.ravel()
        np.testing.assert_allclose(stored, single["stance_angle"], rtol=1e-7)


def test_basins_over_the_push_off_hold_its_gaits(tmp_path):
    options = {"size": 12, "steps": 20}
    table = study("basin", push_off=[0.1, 0.12], options=options)
    archive = run(tmp_path, table | {"want": {"figures": ["basin"]}})
    gaits = table_of(archive, "fixed_points")
    for push in (0.1, 0.12):
        own = gaits[(gaits["push_off"] == push) & (gaits["gait"] == "long")]
        single = solve("D", 0.0, push_off=push).set_index("gait").loc["long"]
        assert float(own["stance_angle"].iloc[0]) == pytest.approx(
            single["stance_angle"], rel=1e-12
        )
    gaitsweep.report(archive, tmp_path)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("walker", "axis", "values", "slopes"),
    [
        ("A", "push_off", {"from": 1.0, "to": 40.0, "adaptive": 1e-3}, [0.0]),
        ("B", "push_off", {"from": 1e-6, "to": 1.0, "n": 20}, [0.01]),
        ({"base": "B", "push_off": 0.1}, "hip_torque", [1e-5, 0.05], [0.0, -0.005]),
    ],
)
def test_gaits_of_branches_over_a_drive_are_single_gaits(
    walker, axis, values, slopes, tmp_path
):
    """In SI, over a torque, on slopes that lead down; thinly or by what they look like."""
    table = study("branch", walker, slopes)
    table["axes"] = {"slope": slopes, axis: values}
    rows = table_of(run(tmp_path, table), "branches")
    rng = np.random.default_rng(32)
    keys = {} if isinstance(walker, str) else {"push_off": walker["push_off"]}
    name = walker if isinstance(walker, str) else walker["base"]
    for row in rows.iloc[rng.choice(len(rows), 4)].itertuples():
        drive = {axis: getattr(row, axis)}
        found = solve(name, row.slope, **keys | drive)
        assert (found["stance_angle"] / row.stance_angle - 1).abs().min() < 1e-10


@pytest.fixture(scope="module")
def census(tmp_path_factory):
    table = study("census", "B", push_off=[0.05, 0.1], options={"starts": 300})
    table["want"] = {"figures": ["census"]}
    return run(tmp_path_factory.mktemp("census"), table)


def test_a_census_on_level_ground_finds_the_gaits_of_each_push_off(census):
    """Those of the branches over the push-off, in which no census has a part."""
    found = table_of(census, "census")
    coverage = table_of(census, "coverage")

    assert coverage["push_off"].tolist() == [0.05, 0.1]
    for push, gaits in found.groupby("push_off"):
        solved = solve("B", 0.0, push_off=push).sort_values("stance_angle")
        gaits = gaits.sort_values("stance_angle")
        assert len(gaits) == len(solved) == 2
        for name in (*STATE, "period"):
            np.testing.assert_allclose(gaits[name], solved[name], rtol=1e-10)


def test_the_page_of_a_census_walks_its_gaits_along_the_push_off(census, tmp_path):
    gaitsweep.report(census, tmp_path)

    page = (tmp_path / "census.html").read_text()

    assert "against push off, and the largest share" in page
    assert "for any walker at any push off;" in page
    (marks,) = re.findall(r'class="marks">(.*?)</script>', page, re.S)
    (states,) = re.findall(r'id="states">(.*?)</script>', page, re.S)
    for found in json.loads(marks):
        assert found["names"][0] == "push off"
        assert len(found["starts"]) == len(found["rows"]) == 4
    assert all(len(state) == 4 for state in json.loads(states))
    command = next(commands_of(page))
    assert command.startswith("gaitsweep solve --walker B --slope 0.0 --set push_off=")


def test_addresses_along_the_push_off_name_what_the_table_has(census):
    of_census = source.read(census)
    gaits = of_census.table("census")

    (first, *_) = addresses(of_census, gaits.drop(columns="stance_rate"))

    named = dict(parse_qsl(first))
    assert "stance_rate" not in named
    assert float(named["thigh_rate"]) == pytest.approx(gaits["thigh_rate"].iloc[0])


@pytest.mark.thorough
def test_gaits_of_two_steps_are_followed_over_the_push_off(tmp_path):
    table = study("branch", push_off=[0.13, 0.16], options={"steps": 2})
    rows = table_of(run(tmp_path, table), "branches")
    row = rows.iloc[len(rows) // 2]
    found = solve("D", 0.0, push_off=float(row["push_off"]), steps=2)
    assert (found["stance_angle"] / row["stance_angle"] - 1).abs().min() < 1e-10


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"push_off": [0.0, 0.2]},
            "`push_off` must be > 0 where gaits are followed over it; got 0.0 "
            "(s.toml, axes.push_off).",
        ),
        (
            {"push_off": [0.1]},
            "The values of `push_off` of a `branch` are a window: give at least two; "
            "got 0.1 (s.toml, axes.push_off).",
        ),
        (
            {"slope": [-0.01, 0.01]},
            "Slopes must be all <= 0 where gaits are followed over `push_off`, or all > 0; "
            "got -0.01 and 0.01 (s.toml, axes.slope).",
        ),
        (
            {"kind": "design"},
            "`slope` must lie in [1e-18, 0.5) rad in studies of kind `design`; got 0: on "
            "level ground and uphill folds, flips and ends over `push_off` or "
            "`hip_torque` and another key are followed in studies of kind `curve` with a "
            "`plane` (s.toml, axes.slope).",
        ),
        (
            {"want": {"claims": ["E2"]}},
            "`E2` is of gaits over slopes, and these are followed over `push_off`",
        ),
        (
            {"want": {"figures": ["angles"]}},
            "`angles` is of gaits over slopes, and these are followed over `push_off`",
        ),
        (
            {"push_off": {"from": 0.1, "to": 0.2, "n": 5, "adaptive": 1e-3}},
            "leave out either `n` or `adaptive`; got n = 5 and adaptive = 0.001 "
            "(s.toml, axes.push_off.n).",
        ),
        (
            {"kind": "orbit", "push_off": {"from": 0.1, "to": 0.2, "adaptive": 1e-3}},
            '`adaptive` is for studies of kind "branch"',
        ),
        (
            {
                "slope": [0.01, 0.02],
                "push_off": {"from": 0.1, "to": 0.2, "adaptive": 1e-3},
            },
            "`adaptive` is of the axis along which gaits are followed, `slope` "
            "(s.toml, axes.push_off.adaptive).",
        ),
    ],
)
def test_wrong_studies_over_a_drive_are_refused_in_a_line(changes, said, tmp_path):
    more = {key: changes[key] for key in ("slope", "push_off") if key in changes}
    table = study(changes.get("kind", "branch"), **more)
    table |= {key: changes[key] for key in changes if key == "want"}
    with pytest.raises(StudyError, match=re.escape(said)) as raised:
        parse(table, "", tmp_path / "s.toml")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("slopes", [[0.0], [0.01]])
@pytest.mark.parametrize(
    ("axes", "named"),
    [
        (
            {},
            "Gaits are followed over `hip_torque` where the swing leg has an inertia ",
        ),
        ({"m_s": [0.0, 0.1]}, "about the hip; that of `walker` is 0 (s.toml, axes"),
    ],
)
def test_a_torque_is_followed_between_legs_with_mass_only(
    slopes, axes, named, tmp_path
):
    """Whatever else drives them; at a corner of the axes is enough."""
    table = study("branch", {"base": "D", "push_off": 0.1}, slopes)
    del table["axes"]["push_off"]
    table["axes"] |= {"hip_torque": [0.001, 0.05], **axes}
    with pytest.raises(StudyError, match=re.escape(named)):
        parse(table, "", tmp_path / "s.toml")
    table["axes"].pop("m_s", None)
    assert parse(table | {"walker": "B"}, "", tmp_path / "s.toml").drive


def test_of_two_that_drive_the_one_with_a_range_is_followed(tmp_path):
    table = study("branch", "B", push_off=[0.1])
    table["axes"]["hip_torque"] = [0.001, 0.01]
    assert parse(table, "", tmp_path / "s.toml").along == "hip_torque"
    table["axes"]["push_off"] = [0.1, 0.2]
    assert parse(table, "", tmp_path / "s.toml").along == "push_off"


def test_a_study_says_along_what_its_gaits_are_followed(tmp_path):
    path = tmp_path / "s.toml"
    for kind, slope, key, along in (
        ("branch", "[0.0]", "push_off", "push_off"),
        ("branch", "[0.0, -0.01]", "push_off", "push_off"),
        ("branch", "[0.01]", "push_off", "push_off"),
        ("branch", "[0.01, 0.02]", "push_off", "slope"),
        ("orbit", "[0.0]", "hip_torque", "hip_torque"),
        ("orbit", "[0.01]", "push_off", "slope"),
        ("grid", "[0.0]", "push_off", "push_off"),
        ("grid", "[0.01]", "push_off", "slope"),
    ):
        head = f'name = "s"\nkind = "{kind}"\nwalker = "B"\n[axes]\nslope = {slope}\n'
        path.write_text(f"{head}{key} = [0.01, 0.02]\n")
        assert read(path).along == along


@pytest.mark.parametrize("keys", [{"hip_torque": -0.01}, {"hip_stiffness": 0.1}])
def test_what_only_brakes_is_no_drive(keys, tmp_path):
    with pytest.raises(StudyError, match="a walker needs a `push_off` or a `hip_torq"):
        solve("B", 0.0, **keys)
    table = study("grid", {"base": "B", **keys})
    del table["axes"]["push_off"]
    with pytest.raises(StudyError, match="for passive walkers; got 0: on level ground"):
        parse(table, "", tmp_path / "s.toml")


def spring_curves():
    plane = {"hip_rest": [0.0, 0.3], "hip_stiffness": [0.0, 0.2]}
    options = {"kinds": [], "levels": {"froude_speed": 0.15}, "plane": plane}
    table = study("curve", "B", options=options)
    del table["axes"]["push_off"]
    return table


def test_curves_over_a_spring_that_rests_at_an_angle_are_of_a_driven_walker(tmp_path):
    assert parse(spring_curves(), "", tmp_path / "s.toml").is_driven


@pytest.mark.thorough
def test_a_spring_that_rests_at_an_angle_drives_curves_on_level_ground(tmp_path):
    table = spring_curves()
    rows = table_of(run(tmp_path, table), "curves")
    row = rows.iloc[len(rows) // 2]
    keys = {row[f"{name}key"]: float(row[f"{name}value"]) for name in ("", "other_")}
    found = solve("B", 0.0, **keys)
    nearest = (found["stance_angle"] - row["stance_angle"]).abs().idxmin()
    assert found["froude_speed"][nearest] == pytest.approx(0.15, rel=1e-9)


def test_a_slope_that_was_rounded_to_0_is_one(tmp_path):
    gait = solve("B", 4e-4).set_index("gait").loc["long"]
    file = tmp_path / "s.csv"
    row = ",".join(f"{gait[name]:.3f}" for name in ["slope", *STATE])
    file.write_text(f"slope,{','.join(STATE)}\n{row}\n")
    (judged,) = gaitsweep.check(file, "B").itertuples()
    assert judged.is_gait
    assert "its slope, 0, which may have been 0.0004" in judged.reason
    with pytest.raises(StudyError, match="a walker needs a `push_off` or a `hip_torq"):
        gaitsweep.check(pd.read_csv(file)[STATE], "B", slope=0.0)
