"""Studies of gaits that repeat after n steps: grids and branches, from the file to the
page.
"""

import contextlib
import html
import re

import netCDF4
import numpy as np
import pytest

import gaitsweep
from gaitsweep import load
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.graph.graph import Graph
from gaitsweep.pipeline.graph.plan import Plan, summary
from gaitsweep.pipeline.store.journal import Journal
from gaitsweep.pipeline.study.parse import read
from gaitsweep.tasks.branches.atlas import to_arrays
from gaitsweep.tasks.studies.follow_branches import branch
from gaitsweep.tasks.studies.follow_cycles import cycle_branches
from lines import branches as atlas_of

GRID = """name = "two"
walker = "D"
[axes]
slope = { from = 0.014, to = 0.034, n = 6 }
[options]
steps = 2
[want]
fits = ["scaling"]
figures = ["linear", "loglog"]
"""
BRANCH = """name = "three"
kind = "branch"
walker = "D"
[axes]
slope = { from = 0.012, to = 0.016, n = 60 }
[options]
steps = 3
[want]
figures = ["locus"]
"""


def run(folder, text, *options):
    (folder / "s.toml").write_text(text)
    return commands.main(
        [
            "run",
            f"{folder}/s.toml",
            "--archive",
            f"{folder}/s.nc",
            "--jobs",
            "1",
            "--quiet",
            *options,
        ]
    )


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    paths = {}
    for name, text in (("grid", GRID), ("branch", BRANCH)):
        paths[name] = tmp_path_factory.mktemp(name)
        assert run(paths[name], text) == 0
    return paths


def test_a_grid_holds_what_python_solves(archives):
    grid = load(archives["grid"] / "s.nc")
    gaits = gaitsweep.gaits("D", grid.slope.values, steps=2)
    solved = gaits.sel(gait=grid.gait.values)
    np.testing.assert_array_equal(grid.status == "converged", solved.status == 0)
    assert (grid.status == "converged").sum() == 5
    for name in (
        "stance_angle",
        "period",
        "multiplier_real",
        "loss_normal",
        "branch",
    ):
        # Few points are solved by other code, which rounds otherwise.
        np.testing.assert_allclose(grid[name], solved[name], rtol=1e-9)
        assert grid[name].attrs["long_name"] == solved[name].attrs["long_name"]
    assert (
        grid.period.long_name == "duration of 2 steps"
        and grid.attrs["steps"] == 2 == gaits.attrs["steps"]
    )
    assert "2 times iterated step map" in grid.multiplier_real.long_name
    single = load_single(archives)
    assert (
        "steps" not in single.attrs
        and single.period.long_name == "duration of one step"
    )


def load_single(archives):
    folder = archives["grid"].parent
    assert (
        run(folder, GRID.replace("steps = 2", "steps = 1").replace("0.034", "0.015"))
        == 0
    )
    return load(folder / "s.nc")


def test_archives_do_not_depend_on_chunks_and_resume(archives, tmp_path):
    assert run(tmp_path, GRID, "--chunk", "2") == 0
    assert (tmp_path / "s.nc").read_bytes() == (archives["grid"] / "s.nc").read_bytes()
    wider = GRID.replace("n = 6", "n = 11")
    (tmp_path / "s.toml").write_text(wider)
    with contextlib.closing(Journal(Companions(tmp_path / "s.nc").journal)) as journal:
        todo = summary(Plan(read(tmp_path / "s.toml"), journal)).todo
    # Other slopes are other chunks, but the branches are known.
    assert todo["points"] == {"new": 11} and not todo["atlas"]
    assert run(tmp_path, wider) == 0 and len(load(tmp_path / "s.nc").slope) == 11


def test_results_of_one_step_are_kept_when_steps_is_written_out(tmp_path):
    studies = []
    for k, text in enumerate(
        (
            GRID.replace("steps = 2", "steps = 1"),
            GRID.replace("[options]\nsteps = 2\n", ""),
        )
    ):
        (tmp_path / f"{k}.toml").write_text(text)
        studies.append(read(tmp_path / f"{k}.toml"))
    keys = [Graph(study).line_keys(0) for study in studies]
    assert keys[0] == keys[1] and Graph(studies[0]).method == "short"
    (tmp_path / "2.toml").write_text(GRID)
    two = read(tmp_path / "2.toml")
    assert Graph(two).method == "cycles"
    assert not set(keys[0].values()) & set(Graph(two).line_keys(0).values())


def test_a_branch_is_followed_through_its_fold_and_flips_as_the_cascade_has_them(
    archives, tmp_path
):
    """The period-three gaits of the simplest walker begin at a fold at 0.0122808."""
    text = BRANCH.replace('"branch"', '"cascade"').replace(
        "steps = 3", "families = [3]\nperiods = 3\nsteps = 0"
    )
    assert run(tmp_path, text.replace('figures = ["locus"]', "")) == 0
    cascade = load(tmp_path / "s.nc", "cascade")
    points, branch = (
        load(archives["branch"] / "s.nc", name)
        for name in ("special_points", "branches")
    )
    points = points.sort_values("slope", ignore_index=True)
    assert points["kind"].tolist() == ["fold", "flip", "window", "window"]
    returns("D", points, 3)
    points = points[points["kind"] != "window"]
    np.testing.assert_allclose(points["slope"], cascade["slope"], rtol=1e-11)
    np.testing.assert_allclose(
        points["stance_angle"], cascade["stance_angle"], rtol=1e-6
    )
    for table in (points, cascade):
        returns("D", table, 3)
    assert points["slope"][0] == pytest.approx(0.0122808, abs=1e-7)
    assert len(branch) >= 60 and branch["slope"].between(0.012, 0.016).all()
    # One curve through the fold, with both edges of the window; stable between fold and
    # flip only.
    assert branch["slope"].iloc[[0, -1]].tolist() == pytest.approx(
        [0.016, 0.016], rel=1e-14
    )
    turn = int(branch["slope"].argmin())
    assert (np.diff(branch["slope"])[:turn] < 0).all() and (
        np.diff(branch["slope"])[turn:] > 0
    ).all()
    stable = branch["stable"] == 1
    low, high = points["slope"] * (1 + np.array([-1, 1]) * points["error_bound"])
    assert branch["slope"][stable].between(low, high).all() and stable.any()
    one = gaitsweep.gaits("D", 0.016, steps=3)
    np.testing.assert_allclose(
        sorted(branch["stance_angle"].iloc[[0, -1]]), sorted(one.stance_angle[[0, 2]])
    )
    assert branch.attrs["units"]["period"] == "1"
    with netCDF4.Dataset(archives["branch"] / "s.nc") as file:
        assert (
            file["branches/period"].long_name == "duration of 3 steps"
            and file.steps == 3
        )


def returns(walker, table, steps=1, rtol=1e-6):
    """Check that the states of a table's rows return after some steps."""
    assert len(table)
    for row in table.to_dict("records"):
        start = [row[name] for name in ("stance_angle", "stance_rate", "thigh_rate")]
        state = start
        for _ in range(steps):
            state = gaitsweep.step_map(walker, row["slope"], state).state
        np.testing.assert_allclose(state, start, rtol=rtol)


@pytest.mark.parametrize("walker", ["D", "C"])
def test_special_points_have_the_whole_state(tmp_path, walker):
    text = (
        BRANCH.replace("steps = 3", "")
        .replace('"D"', f'"{walker}"')
        .replace("0.016", "0.3")
    )
    assert run(tmp_path, text) == 0
    points = load(tmp_path / "s.nc", "special_points")
    assert "flip" in set(points["kind"])
    returns(walker, points[points["kind"] == "flip"])
    # The shank is locked to the thigh until heelstrike, and then free.
    assert (points["shank_rate"] == points["thigh_rate"]).all() == (walker == "D")
    assert points.attrs["units"]["shank_rate"] == {"D": "1", "C": "rad s-1"}[walker]


@pytest.mark.parametrize(
    ("walker", "low", "high", "flip"),
    [("D", 0.012, 0.016, 0.0150884), ("C", 0.07, 0.08, 0.0768534)],
)
def test_a_branch_that_a_flip_begins_starts_there(tmp_path, walker, low, high, flip):
    """The paper, sections 3 and 7: period doubling of the simplest walker at 0.0151; of
    the kneed one see claim K1.
    """
    text = (
        BRANCH.replace("steps = 3", "steps = 2")
        .replace('"D"', f'"{walker}"')
        .replace("0.012", f"{low}")
    )
    assert run(tmp_path, text.replace("0.016", f"{high}")) == 0
    points, branch = (
        load(tmp_path / "s.nc", name) for name in ("special_points", "branches")
    )
    assert (
        points["kind"].tolist() == ["branch_point", "window"]
        and points["slope"][1] == high
    )
    assert branch["slope"][0] == points["slope"][0]
    assert (
        points["slope"][0] == pytest.approx(flip, abs=1e-7)
        and points["error_bound"][0] < 1e-12
    )
    one, two = (
        gaitsweep.gaits(walker, [flip, high], steps=n).isel(gait=0) for n in (1, 2)
    )
    assert points["period"][0] == pytest.approx(2 * one.period[0].item(), rel=1e-6)
    for name in ("stance_angle", "period", "kneestrike_time", "spectral_radius"):
        assert branch[name].iloc[-1] == pytest.approx(
            two[name][1].item(), rel=1e-9, nan_ok=True
        ), name
    assert branch["gait"].iloc[-1] == "long" and branch["stable"].iloc[-1] == 1


def test_pages_say_how_many_steps_and_their_commands_work(archives, capsys):
    for name, steps in (("grid", 2), ("branch", 3)):
        folder = archives[name]
        assert commands.main(["report", f"{folder}/s.nc", "-o", f"{folder}/pages"]) == 0
        (page,) = [
            p
            for p in (folder / "pages").glob("*.html")
            if p.stem not in ("index", "ledger")
        ]
        text = html.unescape(page.read_text())
        assert f"The gaits repeat after {steps} steps, not sooner." in text
        assert f"gaitsweep solve --walker D --steps {steps}" in text
    scaling = load(archives["grid"] / "s.nc", "fits/scaling")
    assert set(scaling.columns) > {"quantity", "exponent"}


def test_an_archive_of_longer_gaits_is_not_proved(archives, capsys):
    pytest.importorskip("flint")
    path = archives["grid"] / "s.nc"
    assert commands.main(["prove", str(path)]) == 2
    assert capsys.readouterr().err == (
        f"gaitsweep: {path} holds gaits of 2 steps; proofs are of gaits of one step.\n"
    )


WRONG = [
    (
        "steps = 0",
        "`steps` must be a whole number from 1 to 64; got 0 (s.toml, options.steps).",
    ),
    (
        "steps = 65",
        "`steps` must be a whole number from 1 to 64; got 65 (s.toml, options.steps).",
    ),
    (
        "steps = 2.0",
        "`steps` must be a whole number from 1 to 64; got 2.0 (s.toml, options.steps).",
    ),
    (
        "steps = true",
        "`steps` must be a whole number from 1 to 64; got True (s.toml, options.steps).",
    ),
    (
        'steps = "2"',
        "`steps` must be a whole number from 1 to 64; got '2' (s.toml, options.steps).",
    ),
    ("strides = 2", "Unknown key `strides`"),
    ("step = 2", "Unknown key `step`, did you mean `steps`? (s.toml, options)."),
]


@pytest.mark.parametrize(("line", "sentence"), WRONG)
@pytest.mark.parametrize("text", [GRID, BRANCH])
def test_steps_that_cannot_be_are_one_line(tmp_path, text, line, sentence):
    (tmp_path / "s.toml").write_text(re.sub(r"steps = \d", line, text))
    with pytest.raises(StudyError) as error:
        read(tmp_path / "s.toml")
    assert sentence in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "value", "name"),
    [
        ("claims", '["D1"]', "D1"),
        ("fits", '["transition"]', "transition"),
        ("fits", '["landmarks"]', "landmarks"),
        ("figures", '["angles"]', "angles"),
        ("variables", '["proofs"]', "proved"),
    ],
)
def test_what_is_of_one_step_is_refused(tmp_path, key, value, name):
    text = GRID.split("[want]")[0] + f"[want]\n{key} = {value}\n"
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(
        StudyError, match=f"`{name}` is of gaits of one step, and `steps` is 2"
    ):
        read(tmp_path / "s.toml")


def test_adaptive_points_are_of_one_step(tmp_path):
    (tmp_path / "s.toml").write_text(BRANCH.replace("n = 60", "adaptive = 1e-3"))
    with pytest.raises(
        StudyError, match="`adaptive` is for gaits of one step, and `steps` is 3"
    ):
        read(tmp_path / "s.toml")


def sampled(steps, low, high, least):
    """Branches of the simplest walker's gaits of several steps, and their table over a
    window of slopes.
    """
    followed = cycle_branches(*atlas_of("D"), steps)
    window = {"slope_from": low, "slope_to": high, "n": least}
    line = {"walker": "D", "set": {}}
    return followed, branch(
        {"line": line, "steps": steps, **window}, [to_arrays(followed)]
    )


@pytest.mark.parametrize(
    ("low", "high"),
    [(0.016, 0.01602), (0.016, 0.0164), (0.015, 0.01509), (0.016, 0.03)],
)
def test_a_window_between_two_gaits_of_a_branch_has_as_many_points_as_are_asked_for(
    low, high
):
    branches, table = sampled(2, low, high, 20)
    slope = table["branches/slope"]
    assert len(slope) >= 20 and (np.diff(slope) > 0).all()
    assert slope[0] == pytest.approx(
        max(low, np.exp(branches[0].q[0])), rel=1e-14
    ) and slope[-1] == pytest.approx(high, rel=1e-14)
    # Rows hold the whole state: two steps from it lead back to it.
    state = [
        table[f"branches/{name}"][10]
        for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    assert table["branches/shank_rate"][10] == state[2]
    walk = gaitsweep.simulate("D", slope[10], state, 2)
    assert [
        walk[name].values[2] for name in ("stance_angle", "stance_rate", "thigh_rate")
    ] == pytest.approx(state)


def test_a_gait_of_the_branch_on_the_edge_of_a_window_is_listed_once():
    branches, _ = sampled(2, 0.016, 0.017, 2)
    low, high = np.exp(branches[0].q[[3, 8]])
    slope = sampled(2, low, high, 20)[1]["branches/slope"]
    assert (slope[0], slope[-1]) == pytest.approx((low, high), rel=1e-14) and (
        np.diff(slope) > 1e-12
    ).all()


def test_a_branch_that_leaves_its_window_and_comes_back_is_not_sampled_outside():
    """Beyond the fold of the gaits of three steps, at 0.01228."""
    _, table = sampled(3, 0.0125, 0.0126, 40)
    slope = table["branches/slope"]
    turn = np.flatnonzero(np.diff(slope) > 0)[0]
    assert len(slope) >= 40 and (slope.min(), slope.max()) == pytest.approx(
        (0.0125, 0.0126), rel=1e-14
    )
    assert (np.diff(slope[: turn + 1]) <= 0).all() and (
        np.diff(slope[turn:]) >= 0
    ).all()
