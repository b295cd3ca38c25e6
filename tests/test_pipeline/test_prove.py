"""`gaitsweep prove`: its answers, exit codes and errors."""

import importlib.util
import json
import re
from decimal import Decimal
from pathlib import Path

import netCDF4
import pytest

from gaitsweep.pipeline.cli.commands import main
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.walkers.resolve import resolve
from soak import certificates

STUDY = """name = "small"
walker = ["D", "B"]
[axes]
slope = [0.009, 0.012]
[want]
variables = ["stance_angle", "stance_rate", "thigh_rate", "shank_rate", "period"]
"""


def run(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    code = main(["prove", *map(str, arguments)])
    return code, *capsys.readouterr()


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive")
    (folder / "small.toml").write_text(STUDY)
    command = [
        "run",
        folder / "small.toml",
        "--archive",
        folder / "small.nc",
        "--quiet",
        "--jobs",
        1,
    ]
    assert main(list(map(str, command))) == 0
    return folder / "small.nc"


@pytest.fixture
def archive(kept, tmp_path):
    path = tmp_path / "copy.nc"
    path.write_bytes(kept.read_bytes())
    return path


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (
            ("D", "0.009", "other1"),
            "There is no other1 gait at slope 0.009; there are long, short.\n",
        ),
        (
            ("physical", "0.25", "short"),
            "There is no short gait at slope 0.25; there is long.\n",
        ),
    ],
)
def test_of_a_label_that_no_gait_has_it_is_said_which_gaits_there_are(
    capsys, asked, said
):
    walker, slope, label = asked

    code, out, err = run(capsys, "--walker", walker, "--slope", slope, "--gait", label)

    assert (code, out, err) == (1, "", said)


def test_gaits_of_a_walker_are_proved(capsys):
    code, out, _ = run(capsys, "--walker", "D", "--slope", "0.009", "--json")
    gaits = json.loads(out)
    assert code == 0
    assert [(g["gait"], g["proved"], g["stable"]) for g in gaits] == [
        ("long", True, True),
        ("short", True, False),
    ]
    assert set(gaits[0]) == {
        "gait",
        "slope",
        "exact_slope",
        "walker",
        "proved",
        "unique",
        "first_strike",
        "stable",
        "stance_angle",
        "radius",
        "box",
        "multipliers",
        "events",
        "bits",
        "reason",
    }
    assert (gaits[0]["slope"], gaits[0]["exact_slope"]) == (0.009, "0.009")
    assert gaits[0]["radius"] <= 1e-12
    middle, radius = gaits[0]["box"]["stance_angle"]
    assert middle.startswith("0.20031090054424708936016")
    assert float(radius) < 1e-19
    assert gaits[0]["events"] == ["legs_pass", "heelstrike"]


def test_one_gait_can_be_asked_for_in_words(capsys):
    code, out, _ = run(
        capsys,
        "--walker",
        "E",
        "--slope",
        "0.02",
        "--set",
        "m_s=0.11",
        "--gait",
        "short",
    )
    assert code == 0
    assert re.fullmatch(
        r"Short gait, slope 0\.02: proved, unstable\. Stance angle 0\.\d+ \+- \S+ rad, in a box of relative radius"
        r" \S+ that holds exactly one gait; the legs pass, then heelstrike \(\d+ bits\)\.\n",
        out,
    )


@pytest.mark.parametrize("slope", [f"0.01{'0' * 320}1", "0.01" + "0" * 900])
def test_a_slope_may_have_many_digits(capsys, slope):
    code, out, _ = run(
        capsys,
        "--walker",
        "D",
        "--slope",
        slope,
        "--gait",
        "long",
        "--set",
        "m_h=0.000e+00",
        "--json",
    )
    (gait,) = json.loads(out)
    assert (code, gait["proved"], gait["slope"]) == (0, True, 0.01)
    # The double is not the slope of the theorem.
    assert gait["exact_slope"] == (slope.rstrip("0") if slope.endswith("0") else slope)


def test_a_walker_file_keeps_every_digit(capsys, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('[walker]\nbase = "E"\nm_s = 0.10000000000000000000001\n')
    code, out, _ = run(
        capsys, "--walker", file, "--slope", "0.01", "--gait", "long", "--json"
    )
    assert code == 0
    assert json.loads(out)[0]["walker"]["m_s"] == "0.10000000000000000000001"


ONE_LINK = "knees = false\nm = 1.0\nc = 0.3\nr = 0.2\nl = 0.8\nR = 0.1\nm_h = 5"


@pytest.mark.parametrize(
    ("keys", "known"),
    [
        (
            'base = "first.toml"\nm_s = 0.1',
            {"m_s": "0.1", "R": "0.10000000000000000000001"},
        ),
        ('base = "E"\nname = "mine"', {"R": "0"}),
        (ONE_LINK, {"l_t": "0.4", "l_s": "0.5", "c_t": "0.3", "w_s": "0", "m_h": "5"}),
        (ONE_LINK.replace("R = 0.1", "R = 0"), {"l_s": "0.4", "R": "0"}),
    ],
)
def test_a_walker_file_that_solve_takes_is_proved(
    capsys, tmp_path, monkeypatch, keys, known
):
    monkeypatch.chdir(tmp_path)
    Path("first.toml").write_text(
        '[walker]\nbase = "E"\nR = 0.10000000000000000000001\n'
    )
    Path("mine.toml").write_text(f"[walker]\n{keys}\n")
    code, out, _ = run(
        capsys, "--walker", "mine.toml", "--slope", "0.01", "--gait", "long", "--json"
    )
    (gait,) = json.loads(out)
    assert code == 0 and gait["proved"]
    assert {key: gait["walker"][key] for key in known} == known
    assert main(["solve", "--walker", "mine.toml", "--slope", "0.01", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["stance_angle"] == pytest.approx(
        gait["stance_angle"], rel=1e-12
    )


def test_no_gait_is_exit_code_1(capsys):
    code, out, err = run(
        capsys, "--walker", "physical-straight", "--slope", "0.015", "--json"
    )
    assert (code, json.loads(out)) == (1, [])
    assert "initial guesses at slope" in err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("--walker", "D", "--slope", "0.6"),
            "`slope` must lie in [1e-18, 0.5) rad; got 0.6",
        ),
        (("--walker", "D", "--slope", "x"), "must be a number; got x"),
        (
            ("--walker", "D", "--slope", "nan"),
            "`slope` must lie in [1e-18, 0.5) rad; got nan",
        ),
        (("--walker", "G", "--slope", "0.01"), "Unknown name `G`, known: "),
        (
            ("--walker", "D", "--slope", "0.01", "--gait", "lnog"),
            "did you mean `long`?",
        ),
        (
            ("--walker", "D", "--slope", "0.01", "--set", "m_z=1"),
            "`m_z` is not a walker key",
        ),
        (
            ("--walker", "D", "--slope", "0.01", "--accuracy", "1e-40"),
            "`accuracy` must lie in [1e-30, 1e-06]; got 1e-40",
        ),
        (
            ("--walker", "D", "--slope", f"0.{'0' * 4400}9"),
            "`slope` must lie in [1e-18, 0.5) rad",
        ),
        (
            ("--walker", "D", "--slope", f"0.01{'0' * 4400}1"),
            "`slope` must have at most 1000 characters; got 0.01000",
        ),
        (
            ("--walker", "E", "--slope", "0.01", "--set", "m_h=1e-1000000000"),
            "`m_h` must be 0 or a number that doubles resolve; got 1e-1000000000",
        ),
        (
            ("--walker", "E", "--slope", "0.01", "--set", "R=0e-1000000000"),
            "`R` must be 0 or a number that doubles",
        ),
        (("--walker", "D"), "Prove either the gaits of an archive"),
        ((), "Prove either the gaits of an archive"),
        (("there-is-none.nc", "--gait", "long"), "`--gait` goes with a `--walker`."),
        (
            ("--walker", "D", "--slope", "0.01", "--sample", "3"),
            "`--sample` goes with an archive.",
        ),
        (("there-is-none.nc",), "There is no archive there-is-none.nc"),
    ],
)
def test_wrong_questions_are_told_in_one_line(capsys, arguments, sentence):
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert sentence in err
    assert err.count("\n") == 1


@pytest.fixture
def no_flint(monkeypatch):
    there = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util,
        "find_spec",
        lambda name, *a: None if name == "flint" else there(name, *a),
    )


def test_without_the_extra_one_line_says_what_to_install(capsys, no_flint):
    code, out, err = run(capsys, "--walker", "D", "--slope", "0.01")
    assert (code, out) == (2, "")
    assert (
        err
        == "gaitsweep: Proofs need the extra `proof` (python-flint): pip install 'gaitsweep[proof]'.\n"
    )


def test_gaits_of_an_archive_are_proved(capsys, archive):
    code, out, _ = run(capsys, archive, "--json", "--jobs", "1")
    gaits = json.loads(out)
    assert code == 0
    assert len(gaits) == 8
    assert all(g["proved"] for g in gaits)
    assert gaits[0]["at"] == {"walker": "D", "slope": 0.009, "gait": "long"}
    # The stored doubles are the walker: a tenth is not the double nearest to it.
    assert (
        gaits[-1]["walker"]["m_s"]
        == "0.1000000000000000055511151231257827021181583404541015625"
    )
    few = [
        json.loads(run(capsys, archive, "--sample", 3, "--json", "--jobs", n)[1])
        for n in (1, 2)
    ]
    assert few[0] == few[1]
    assert len(few[0]) == 3
    assert all(g in gaits for g in few[0])


def proved_at_all_points(tmp_path, capsys, walker, axes="slope = [0.01]", accuracy=""):
    """The proofs of the gaits of a study of all variables that are archived by default."""
    (tmp_path / "all.toml").write_text(
        f'name = "all"\n{accuracy}\nwalker = {walker}\n[axes]\n{axes}\n'
    )
    out = tmp_path / "all.nc"
    assert (
        main(
            [
                "run",
                str(tmp_path / "all.toml"),
                "--archive",
                str(out),
                "--quiet",
                "--jobs",
                "1",
            ]
        )
        == 0
    )
    code, printed, _ = run(capsys, out, "--json", "--jobs", "1")
    gaits = json.loads(printed)
    assert code == 0
    assert all(gait["proved"] for gait in gaits)
    return gaits


def test_straight_legs_have_no_time_of_kneestrike(tmp_path, capsys):
    gaits = proved_at_all_points(tmp_path, capsys, '"E"')
    assert [gait["events"] for gait in gaits] == [["legs_pass", "heelstrike"]] * 2


@pytest.mark.parametrize("accuracy", ["1e-2", "1e-4"])
def test_gaits_of_few_digits_are_proved(tmp_path, capsys, accuracy):
    """They are looked for as far away as their bound."""
    gaits = proved_at_all_points(
        tmp_path, capsys, '"E"', "slope = [0.01, 0.012]", f"accuracy = {accuracy}"
    )
    assert len(gaits) == 4
    assert all(gait["radius"] < 1e-12 for gait in gaits)


@pytest.mark.parametrize(
    ("walker", "key"), [('["A"]', "detuning"), ('"D"', "foot_mass_ratio"), ('"B"', "R")]
)
def test_gaits_along_an_axis_of_any_key_are_proved(tmp_path, capsys, walker, key):
    gaits = proved_at_all_points(
        tmp_path, capsys, walker, f"slope = [0.01]\n{key} = [0.01]"
    )
    meant = resolve("".join(json.loads(walker)), {key: 0.01}).table()
    assert {gait["at"][key] for gait in gaits} == {0.01}
    for gait in gaits:
        assert all(
            float(Decimal(gait["walker"][name])) == meant[name]
            for name in ("R", "m_s", "m_t", "c_t", "r_s")
        )


def alter(path, name, change):
    with netCDF4.Dataset(path, "a") as file:
        file[name][0, 0, 0] = change(float(file[name][0, 0, 0]))


def test_an_altered_archive_is_not_proved(capsys, archive):
    alter(archive, "period", lambda x: x * (1 + 1e-3))
    code, out, _ = run(capsys, archive, "--jobs", "1")
    lines = out.splitlines()
    assert code == 1
    assert lines[0].startswith("Long gait, walker D, slope 0.009: not proved. ")
    assert all("not proved" not in line for line in lines[1:])


def test_an_archive_of_another_version_is_refused(capsys, archive):
    with netCDF4.Dataset(archive, "a") as file:
        file.gaitsweep_schema = file.gaitsweep_schema + 1
    code, out, err = run(capsys, archive)
    assert (code, out) == (2, "")
    assert "is not an archive of gaitsweep" in err


def test_an_archive_without_states_is_refused(capsys, archive):
    with netCDF4.Dataset(archive, "a") as file:
        file.renameVariable("thigh_rate", "other_rate")
    code, _, err = run(capsys, archive)
    assert code == 2
    assert "it has no thigh_rate" in err


def test_an_archive_of_knees_without_their_strikes_is_refused(capsys, archive):
    """It was said of every gait that the approximation is not finite."""
    with netCDF4.Dataset(archive, "a") as file:
        provenance = json.loads(file.provenance)
        provenance["walkers"] = [
            {**walker, "knees": True} for walker in provenance["walkers"]
        ]
        file.provenance = json.dumps(provenance)
        if "kneestrike_time" in file.variables:
            file.renameVariable("kneestrike_time", "other_time")
    code, _, err = run(capsys, archive)
    assert (code, err.count("\n")) == (
        2,
        1,
    ) and "with knees it needs kneestrike_time" in err


def of_walkers(walkers):
    """A change of the walkers that an archive names."""

    def change(file):
        file.provenance = json.dumps(
            {**json.loads(file.provenance), "walkers": walkers}
        )

    return change


def name_steps(file):
    file.steps = "two"


def lose_a_slope(file):
    file["slope"][0] = float("nan")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        *(
            (of_walkers(w), "does not say which walker it is of")
            for w in ([], ["D"], {"D": {}}, [1, 2])
        ),
        (name_steps, "holds gaits of two steps"),
        (lose_a_slope, "has a slope that is no number"),
    ],
)
def test_a_strange_archive_is_refused_in_one_line(capsys, archive, change, sentence):
    with netCDF4.Dataset(archive, "a") as file:
        change(file)
    code, out, err = run(capsys, archive)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert sentence in err


def test_certificates_are_written_one_a_file(tmp_path):
    (path,) = certificates.write(tmp_path, ["D-long-0.009"], jobs=1)
    assert path == tmp_path / "D-long-0.009.json"
    found = json.loads(path.read_text())
    assert found["stable"] is True
    assert found["statement"].startswith(
        "On the slope 0.009 the walker has exactly one period-one gait in the box."
    )


def test_a_study_may_want_proofs(tmp_path, capsys):
    wanted = STUDY.replace('["D", "B"]', '"D"').replace(
        '"shank_rate", "period"', '"proofs"'
    )
    (tmp_path / "small.toml").write_text(wanted)
    out = tmp_path / "small.nc"
    assert (
        main(["run", str(tmp_path / "small.toml"), "--archive", str(out), "--quiet"])
        == 0
    )
    with netCDF4.Dataset(out) as file:
        assert file["proved"][...].tolist() == [[1, 1], [1, 1]]
        assert file["proved"].flag_meanings == "not_attempted proved not_proved"
        assert file["proved"].dtype == "i1"
        assert (file["proved_radius"][...] <= file["error_bound"][...] / 10).all()
    assert main(["verify", str(out)]) == 0
    capsys.readouterr()


def test_no_study_proves_by_default():
    wanted = parse.parse(
        {"name": "a", "walker": "D", "axes": {"slope": [0.01]}}, "", Path("a.toml")
    ).variables
    assert "stance_angle" in wanted
    assert not {"proved", "proved_radius"} & set(wanted)


def test_a_study_that_wants_proofs_needs_the_extra(tmp_path, capsys, no_flint):
    (tmp_path / "small.toml").write_text(STUDY.replace('"period"', '"proved"'))
    assert main(["plan", str(tmp_path / "small.toml")]) == 2
    assert "Proofs need the extra `proof`" in capsys.readouterr().err
