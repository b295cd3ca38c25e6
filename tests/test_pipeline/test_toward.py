"""Detuning toward another walker: studies, archives, pages, the command line and Python
agree and name both.
"""

import json
import math
import shlex
import tomllib

import numpy as np
import pytest
import xarray as xr

import gaitsweep
from gaitsweep.pipeline.archive import verify
from gaitsweep.pipeline.archive.attributes import of_axis
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.report.source import Source, read
from gaitsweep.pipeline.study import corners, parse, toml
from gaitsweep.tasks.walkers.resolve import resolve

ROUND = {"base": "E", "R": 0.3}
STUDY = """name = "way"
{kind}
walker = {walker}
[axes]
slope = {slope}
{axes}
[want]
variables = ["stance_angle", "period", "stance_rate", "thigh_rate", "multipliers"]
{more}
"""
AXES = 'foot_mass_ratio = [0.02, 0.1]\ndetuning = { toward = "parts/round.toml", from = 0.0, to = 1.0, n = 3 }'


def written(folder, walker='"E"', axes=AXES, kind="", more="", slope=(0.005, 0.02)):
    folder.mkdir(exist_ok=True)
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "parts" / "round.toml").write_text(
        '[walker]\nbase = "point.toml"\nR = 0.3\n'
    )
    (folder / "parts" / "point.toml").write_text('[walker]\nbase = "E"\n')
    path = folder / "way.toml"
    path.write_text(
        STUDY.format(walker=walker, axes=axes, kind=kind, more=more, slope=list(slope))
    )
    return path


def run(folder, *args, **options):
    path = folder / "way.nc"
    gaitsweep.run(written(folder, *args, **options), archive=path, quiet=True, jobs=1)
    return path


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    return run(tmp_path_factory.mktemp("way"), more='figures = ["linear"]')


def test_an_archive_holds_both_walkers_and_what_moves_between_them(archive):
    found = xr.load_dataset(archive)
    assert verify.verify(archive) == []
    assert found["R"].dims == ("detuning",) and found["R"].values.tolist() == [
        0.0,
        0.15,
        0.3,
    ]
    assert (
        found["m_s"].dims == ("foot_mass_ratio",)
        and found.attrs["c_s"] == 0.5
        and "m_t" not in found.attrs
    )
    about = found["detuning"].attrs
    assert about["long_name"] == "mixture of E (0) and E with R = 0.3 (1)"
    for at, walker in enumerate(("E", ROUND)):
        assert json.loads(about[f"walker_at_{at}"]) == resolve(walker).table()
    ways = json.loads(found.attrs["provenance"])["ways"]
    assert [way["tables"] for way in ways] == [
        [resolve(walker).table() for walker in ("E", ROUND)]
    ]


def test_the_gaits_are_those_of_the_walkers_on_the_way(archive):
    """By the study, by arrays in memory, by `solve`, and of the same walkers by their
    own keys.
    """
    study, walker = xr.load_dataset(archive), {"base": "E", "toward": ROUND}
    arrays = {name: study[name] for name in ("slope", "foot_mass_ratio", "detuning")}
    memory = gaitsweep.gaits(walker, **arrays)
    assert memory["detuning"].attrs == study["detuning"].attrs
    own = gaitsweep.gaits(
        "E", arrays["slope"], foot_mass_ratio=arrays["foot_mass_ratio"], R=study["R"]
    )
    for name in ("stance_angle", "period"):
        for other_way in (memory, own):
            values = (
                other_way[name]
                .sel(gait=study["gait"])
                .transpose(*study[name].dims)
                .values
            )
            np.testing.assert_allclose(
                values, study[name].values, rtol=1e-12, err_msg=name
            )
    at = {"foot_mass_ratio": 0.02, "detuning": 0.5}
    long = gaitsweep.solve(walker, 0.02, **at).set_index("gait").loc["long"]
    there = study.sel(slope=0.02, gait="long", **at)
    assert long["stance_angle"] == pytest.approx(
        float(there["stance_angle"]), rel=1e-12
    )
    state = [
        float(there[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    assert gaitsweep.step_map(walker, 0.02, state, **at).state == pytest.approx(
        state, rel=1e-9
    )
    assert int(gaitsweep.simulate(walker, 0.02, state, 2, **at)["steps_taken"]) == 2


@pytest.mark.parametrize(
    "walker",
    ['"E"', '["E", "F"]', '{ base = "E", c_t = 0.01 }', '{ base = "E", toward = "D" }'],
)
@pytest.mark.parametrize(
    "toward", ['"parts/round.toml"', '{ base = "E", R = 0.3, c_t = 0.02 }']
)
def test_the_command_of_a_page_gives_its_gait(
    tmp_path, monkeypatch, capsys, walker, toward
):
    axes = f"detuning = {{ toward = {toward}, from = 0.25, to = 0.5, n = 2 }}"
    source = read(run(tmp_path, walker, axes))
    monkeypatch.chdir(tmp_path)
    line = source.lines[-1]
    assert (
        isinstance(source, Source)
        and "--set detuning=0.5 --set " in line.command
        and "toward=" in line.command
    )
    assert (
        commands.main([*shlex.split(line.command)[1:], "--slope", "0.02", "--json"])
        == 0
    )
    gaits = {gait["gait"]: gait for gait in json.loads(capsys.readouterr().out)}
    stored = line.data.sel(slope=0.02, gait="long")
    assert gaits["long"]["stance_angle"] == pytest.approx(
        float(stored["stance_angle"]), rel=1e-12
    )
    assert gaits["long"]["period"] == pytest.approx(float(stored["period"]), rel=1e-12)
    named = "parts/round.toml" in source.named_files
    assert named == (toward == '"parts/round.toml"')


def test_a_page_names_the_walkers_of_a_map(tmp_path):
    axes = 'detuning = { toward = "parts/round.toml", from = 0.0, to = 1.0, n = 3 }\nc_t = [0.0, 0.02, 0.04]'
    page = run(
        tmp_path / "map",
        '"E"',
        axes,
        kind='kind = "design"',
        more='figures = ["design"]',
    )
    table = xr.load_dataset(page, group="design")
    assert (
        table["detuning"].attrs["long_name"]
        == "mixture of E (0) and E with R = 0.3 (1)"
    )
    assert np.isfinite(table["smallest_slope"].values).sum() >= 6
    # A design is the walker of its keys: the extremes of one, solved by these.
    one = table.to_dataframe().query("detuning == 0.5 and c_t == 0.02").iloc[0]
    own = run(
        tmp_path / "one", '"E"', "R = [0.15]\nc_t = [0.02]", kind='kind = "design"'
    )
    same = xr.load_dataset(own, group="design").to_dataframe().iloc[0]
    for name in ("largest_stable_slope", "fastest_froude_speed"):
        assert one[name] == pytest.approx(same[name], rel=1e-9, nan_ok=True)
    assert (
        commands.main(
            ["report", str(page.parent / "way.nc"), "-o", str(page.parent / "reports")]
        )
        == 0
    )
    text = (page.parent / "reports" / "way.html").read_text()
    assert (
        "Circles: E (detuning 0) and E with R = 0.3 (1)." in text
        and "tuned walker" not in text
    )


def test_curves_follow_a_way(tmp_path):
    """A curve of flips over `detuning` toward round feet is that over their radius."""
    options = '[options]\nkey = "{key}"\nfrom = {low}\nto = {high}\nkinds = ["flip"]\n'
    ways = {
        "detuning": ('{ base = "E", toward = { base = "E", R = 0.3 } }', 0.5, 1.0),
        "R": ('"E"', 0.15, 0.3),
    }
    found = {}
    for key, (walker, low, high) in ways.items():
        more = options.format(key=key, low=low, high=high)
        path = run(
            tmp_path / key,
            walker,
            "",
            kind='kind = "curve"',
            more=more,
            slope=(1e-4, 0.2),
        )
        found[key] = (
            xr.load_dataset(path, group="curves").to_dataframe().sort_values("value")
        )
    over, by = found["detuning"], found["R"]
    assert len(over) > 4 and len(by) > 4
    slopes = np.interp(0.3 * over["value"], by["value"], by["slope"])
    assert over["slope"].to_numpy() == pytest.approx(slopes, rel=2e-3)


WAY = "detuning = {{ toward = {}, from = 0.0, to = 1.0, n = 3 }}"
TABLE = '{{ base = "E", toward = {} }}'


@pytest.mark.parametrize(
    ("walker", "axes", "said"),
    [
        ('"E"', WAY.format('"C"'), "`toward` must have straight legs, as the walker has; got C (way.toml, {})."),
        ('"E"', WAY.format('"A"'), "`toward` must have `units` = \"1\", as the walker has; got A (way.toml, {})."),
        ('"E"', WAY.format('"E"'), "`toward` must differ from the walker in a key; got E (way.toml, {})."),
        ('"E"', WAY.format('"physicl"'), "Unknown name `physicl`, did you mean `physical`? (way.toml, {})."),
        ('"E"', WAY.format('"none.toml"'), "There is no file none.toml (way.toml, {})."),
        ('"E"', WAY.format("3"), "`toward` must be a name, a file or a table; got 3 (way.toml, {})."),
        (
            '"E"', WAY.format('{ base = "E", m_s = -1.0 }'),
            "`toward` must be a walker, and its `m_s` must be >= 0; got -1.0 (way.toml, {}).",
        ),
        (
            '"E"', WAY.format('{ base = "E", toward = "D" }'),
            "The walker that `toward` names has a `toward` itself (way.toml, {}).",
        ),
        ('"E"', 'detuning = { toward = "F", values = [0.1] }',
         "Unknown key `values`, known: from, to, n, spacing (way.toml, axes.detuning)."),
        ('"E"', WAY.format('"parts/round.toml"') + "\nR = [0.1]",
         "`R` is set by `detuning`, which owns R; got 0.1 (way.toml, axes.R)."),
        ('"E"', WAY.format('"F"') + "\nfoot_mass_ratio = [0.1]",
         "`foot_mass_ratio` sets m_t, and so does `detuning`; got 0.1 (way.toml, axes.foot_mass_ratio)."),
        ('"E"', 'detuning = { toward = "parts/round.toml", from = 0.0, to = 4.0, n = 3 }',
         "`R` must leave the hip above the foot's centre; got 1.2 (way.toml, axes.detuning)."),
        (TABLE.format('"C"'), "detuning = [0.0, 1.0]",
         "`toward` must have straight legs, as the walker has; got C (way.toml, walker.toward)."),
        (TABLE.format('"C"'), "",
         "`toward` must have straight legs, as the walker has; got C (way.toml, walker.toward)."),
        (TABLE.format("[1]"), "", "`toward` must be a name, a file or a table; got [1] (way.toml, walker.toward)."),
        ('"E"', "detuning = [0.0, 1.0]",
         "`detuning` needs walker A or C, or `toward`, another walker; got E (way.toml, axes.detuning)."),
    ],
)  # fmt: skip
def test_a_way_that_cannot_be_is_said_in_one_line(tmp_path, walker, axes, said):
    with pytest.raises(StudyError) as refused:
        parse.read(written(tmp_path, walker, axes))
    assert str(refused.value) == said.replace("{}", "axes.detuning.toward")


def test_walkers_of_a_study_are_led_each_from_itself(tmp_path):
    about = of_axis(
        "detuning",
        parse.read(written(tmp_path, '["E", "F"]', WAY.format('"D"'))).checks,
    )
    assert about["long_name"] == "mixture of each walker (0) and D (1)"
    assert json.loads(about["walker_at_0"]) == [resolve(name).table() for name in "EF"]
    for name in "EF":
        (tmp_path / f"{name}.toml").write_text(
            f'[walker]\nbase = "{name}"\ntoward = {{ base = "{name}", R = 0.2 }}\n'
        )
    about = of_axis(
        "detuning",
        parse.read(
            written(tmp_path, '["E.toml", "F.toml"]', "detuning = [0.5]")
        ).checks,
    )
    assert (
        about["long_name"] == "mixture of each walker (0) and the one it leads to (1)"
    )


def test_files_that_lead_to_each_other_are_refused(tmp_path):
    for one, another in ("ab", "ba"):
        (tmp_path / f"{one}.toml").write_text(
            f'[walker]\nbase = "E"\nR = 0.{ord(one)}\ntoward = "{another}.toml"\n'
        )
    with pytest.raises(
        StudyError, match="The walker that `toward` names has a `toward` itself"
    ):
        parse.read(written(tmp_path, '"a.toml"', "detuning = [0.1]"))


def test_a_walker_between_two_that_cannot_be_fails_alone():
    """In the middle of this way the shank does not reach the line from the hip to the
    foot's centre.
    """
    ends = [
        {"base": "E", "l_t": 0.4, "eps_T": 1.4},
        {"base": "E", "l_t": 4.0, "eps_T": 0.1},
    ]
    walker = {**ends[0], "toward": ends[1]}
    found = gaitsweep.gaits(
        walker, 0.01, detuning=np.array([0.0, 0.5, 1.0]), variables=["stance_angle"]
    )
    status = found["status"].values.max(axis=-1)
    sentence = str(found["reason_text"].values[found["reason"].values[1, 0]])
    assert status[1] != status[0] == status[2] and sentence.startswith(
        "`eps_T` must satisfy"
    )


def test_a_way_that_nothing_goes_is_told(tmp_path):
    study = parse.read(written(tmp_path, TABLE.format('"D"'), ""))
    assert corners.notes(study) == [
        "`toward` changes nothing without `detuning`: the walker is E."
    ]
    assert corners.notes(parse.read(written(tmp_path))) == []
    table = '{ base = "E", toward = "D", detuning = 0.5 }'
    assert corners.notes(parse.read(written(tmp_path, table, ""))) == []
    assert study.checks[0]["parameters"] == resolve("E").table()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            ["detuning=0.5"],
            "`detuning` needs walker A or C, or `toward`, another walker; got E.",
        ),
        (
            ["toward=F"],
            "`toward` needs `detuning`, which says how far the walker is led; got 'F'.",
        ),
        (
            ["toward=C", "detuning=0.5"],
            "`toward` must have straight legs, as the walker has; got C.",
        ),
        (["toward=Z.toml", "detuning=0.5"], "There is no file Z.toml."),
        (
            ["toward={ base", "detuning=0.5"],
            "`toward` must be a name, a file or a table; got '{ base'.",
        ),
        (
            ["toward={base='E',R=0.3}", "detuning=0.5", "R=0.1"],
            "`R` is set by `detuning`, which owns R; got 0.1.",
        ),
    ],
)
def test_the_command_line_says_what_is_wrong_with_a_way(capsys, settings, said):
    words = [word for each in settings for word in ("--set", each)]
    assert commands.main(["solve", "--walker", "E", "--slope", "0.01", *words]) == 2
    assert capsys.readouterr().err == f"gaitsweep: {said}\n"
    assert commands.main(["prove", "--walker", "E", "--slope", "0.01", *words]) == 2
    assert capsys.readouterr().err == f"gaitsweep: {said}\n"


def test_a_gait_on_a_way_is_proved_with_every_digit(capsys):
    toward = "toward={ base = 'E', R = 0.30000000000000000000001 }"
    words = ["--set", toward, "--set", "detuning=0.5", "--gait", "long", "--json"]
    assert commands.main(["prove", "--walker", "E", "--slope", "0.01", *words]) == 0
    (proof,) = json.loads(capsys.readouterr().out)
    own = gaitsweep.solve("E", 0.01, R=0.15).set_index("gait").loc["long"]
    assert proof["proved"] and proof["walker"]["R"] == "0.150000000000000000000005"
    assert proof["stance_angle"] == pytest.approx(own["stance_angle"], rel=1e-12)


@pytest.mark.parametrize(
    "table",
    [ROUND, {"base": 'a "b".toml', "m_t": math.inf, "knees": False, "tuned": ["w_t"]}],
)
def test_a_table_on_one_line_is_read_as_it_was(table):
    assert tomllib.loads(f"toward = {toml.written(table)}") == {"toward": table}


def test_python_is_told_where_toward_stands():
    for call in (gaitsweep.solve, gaitsweep.gaits):
        with pytest.raises(
            StudyError, match="`toward` stands in the table of the walker"
        ):
            call("E", 0.01, detuning=0.5, toward="F")


def test_a_way_may_hold_paths_and_numbers_of_numpy(tmp_path):
    (tmp_path / "point.toml").write_text('[walker]\nbase = "E"\n')
    walker = {
        "base": "E",
        "toward": {"base": tmp_path / "point.toml", "R": np.float64(0.3)},
    }
    found, own = (
        gaitsweep.solve(walker, 0.01, detuning=0.5),
        gaitsweep.solve("E", 0.01, R=0.15),
    )
    assert found["stance_angle"].tolist() == own["stance_angle"].tolist()
