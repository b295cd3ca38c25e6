"""A study is checked whole before anything runs, and every mistake gets one line that
helps.
"""

import json
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import gaitsweep
from gaitsweep.pipeline.archive.provenance import provenance
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import files, model, parse, toml
from gaitsweep.tasks.contract.registry import CLAIMS, OPTIONS, VARIABLES
from gaitsweep.tasks.walkers.catalogue import CATALOGUE

GOOD = """name = "s"
walker = "E"
[axes]
slope = { from = 1e-4, to = 0.1, n = 7, spacing = "log" }
foot_mass_ratio = [0.1, 0.05]
[want]
variables = ["period", "multipliers"]
[limits]
seconds = 5
memory = "1.5 GiB"
"""

NAMED = "`name` must be up to 100 letters, digits, dots, dashes or underscores, the first a letter or digit"

#: What a user may write instead of a line of the good study, and what is said about it.
WRONG = {
    'name = "s"': {
        'name = "../s"': f"{NAMED}; got '../s' (s.toml, name).",
        'name = "my study"': f"{NAMED}; got 'my study' (s.toml, name).",
        'name = "-s"': f"{NAMED}; got '-s' (s.toml, name).",
        'name = "' + 101 * "s" + '"': NAMED + "; got '" + 56 * "s" + " (s.toml, name).",
        "": "A study needs a `name` (s.toml).",
        'name = "s"\nwalkr = "E"': "Unknown key `walkr`, did you mean `walker`? (s.toml).",
        'name = "s"\nkind = "brunch"': "Unknown name `brunch`, did you mean `branch`? (s.toml, kind).",
        'name = "s"\nkind = 3': f"`kind` must be one of {', '.join(OPTIONS)}; got 3 (s.toml, kind).",
        'name = "s"\ngaits = "long"': "`gaits` must be a list of names; got 'long' (s.toml, gaits).",
        'name = "s"\ngaits = ["longe"]': "Unknown name `longe`, did you mean `long`? (s.toml, gaits).",
    },
    'walker = "E"': {
        "": "A study needs a `walker`: a name, a file, a table, or a list of names (s.toml, walker).",
        'walker = "Q"': "Unknown name `Q`, known: A, B, C, D, E, F, physical, physical-straight, A-printed, C-printed,"
        " or a file FILE.toml (s.toml, walker).",
        'walker = "physicl"': "Unknown name `physicl`, did you mean `physical`? (s.toml, walker).",
        'walker = ["E", "E"]': "`walker` must be a list of different names; got ['E', 'E'] (s.toml, walker).",
        "walker = { l_t = 1.0 }": "`w_t` is missing from the walker; got l_t (s.toml, walker).",
        "walker = 3": "`walker` must be a name, a file, a table, or a list of names; got 3 (s.toml, walker).",
        'walker = "none.toml"': "There is no file none.toml (s.toml, walker).",
        'walker = { base = "E", m_s = -1.0 }': "`m_s` must be >= 0; got -1.0 (s.toml, walker).",
        'walker = { base = "E", c_tt = 1 }': "`c_tt` is not a walker key (did you mean `c_t`?); got 1 (s.toml, walker).",
        'walker = { base = "E", m_h = 1 }': "`m_h` is set by `foot_mass_ratio`, which owns m_t, m_s, m_h; got 1 (s.toml, walker).",
        'walker = "A"': "`foot_mass_ratio` needs a point-foot walker (D, E or F); got 0.05 (s.toml, axes.foot_mass_ratio).",
    },
    "foot_mass_ratio = [0.1, 0.05]": {
        "foot_mass_ratio = [0.7]": "`foot_mass_ratio` must lie in [0, 0.5); got 0.7 (s.toml, axes.foot_mass_ratio).",
        "foot_mass_ratio = [0.1]\nm_h = [0.0, 1.0]": "`m_h` is set by `foot_mass_ratio`, which owns m_t, m_s, m_h; got 0.0 (s.toml, axes.m_h).",
        "foot_mass_ratio = []": "`foot_mass_ratio` must hold at least one value; got [] (s.toml, axes.foot_mass_ratio).",
        f"foot_mass_ratio = [{'9' * 400}]": f"`foot_mass_ratio` must be at most 1e300; got {'9' * 57} (s.toml, axes.foot_mass_ratio).",
        "foot_mass_ratio = [0.1, nan]": "`foot_mass_ratio` must be finite; got nan (s.toml, axes.foot_mass_ratio).",
        "foot_mass_ratio = [0.1, 0.2, 0.1]": "`foot_mass_ratio` must rise or fall throughout; got [0.1, 0.2, 0.1] (s.toml, axes.foot_mass_ratio).",
        "foot_mass_ratio = 0.1": "`foot_mass_ratio` must be a list, or a table of from, to, n and spacing; got 0.1"
        " (s.toml, axes.foot_mass_ratio).",
        "m_left = [1, 2]": "`m_left` is no axis: both legs are equal, and a key is that of either (s.toml, axes).",
        "slopes = [0.1]": "Unknown key `slopes`, did you mean `slope`? (s.toml, axes).",
        "foot_mass_ratio = { from = 0.1, to = 0.05, n = 3 }": "`from` must be less than `to` = 0.05; got 0.1 (s.toml, axes.foot_mass_ratio.from).",
        'foot_mass_ratio = { from = 0, to = 0.1, n = 3, spacing = "log" }': "`from` must be > 0 for log spacing; got 0.0 (s.toml, axes.foot_mass_ratio.from).",
        "foot_mass_ratio = { from = 0, to = 0.1, n = 0 }": "`n` must be a whole number from 1 to 10,000,000; got 0 (s.toml, axes.foot_mass_ratio.n).",
    },
    'slope = { from = 1e-4, to = 0.1, n = 7, spacing = "log" }': {
        "slope = [0.73]": "`slope` must lie in [1e-18, 0.5) rad; got 0.73 (s.toml, axes.slope): degrees? 0.73 degrees are 0.0127409 rad.",
        "slope = [1]": "`slope` must lie in [1e-18, 0.5) rad; got 1.0 (s.toml, axes.slope): degrees? 1 degree is 0.0174533 rad.",
        'slope = ["0.1"]': "`slope` must be a number; got '0.1' (s.toml, axes.slope).",
        "slope = [0.1]\nknees = [true]": "Unknown key `knees`, known: slope, foot_mass_ratio, detuning, l_t, w_t, m_t, r_t, c_t, l_s, w_s, m_s,"
        " r_s, c_s, R, eps_T, m_h, g, push_off, hip_stiffness, hip_damping, hip_rest, hip_torque, l, c, r, m, w (s.toml, axes).",
        "slope = [0.1]\ndetuning = [0.5]": "`detuning` needs walker A or C, or `toward`, another walker; got E (s.toml, axes.detuning).",
        "slope = { start = 0.1, n = 2 }": "Unknown key `start`, known: from, to, n, spacing (s.toml, axes.slope).",
        "slope = { from = 0.01, to = 0.1 }": "`n` is missing (s.toml, axes.slope).",
        'slope = { from = 0.01, to = 0.1, n = 9, spacing = "lgo" }': '`spacing` must be "linear" or "log"; got \'lgo\' (s.toml, axes.slope.spacing).',
        "": "A study needs the axis `slope` (s.toml, axes).",
    },
    'variables = ["period", "multipliers"]': {
        'variables = ["perod"]': "Unknown name `perod`, did you mean `period`? (s.toml, want.variables).",
        "variables = []": "`variables` must be a list of names; got [] (s.toml, want.variables).",
        'fits = ["scalng"]': "Unknown name `scalng`, did you mean `scaling`? (s.toml, want.fits).",
        'fits = ["power_law"]': "Unknown name `power_law`, known: scaling, transition, landmarks, crises (s.toml, want.fits).",
        'figures = ["loglg"]': "Unknown name `loglg`, did you mean `loglog`? (s.toml, want.figures).",
        'fits = ["branch"]': "Unknown name `branch`, known: scaling, transition, landmarks, crises (s.toml, want.fits).",
        'figures = ["locus"]': "`locus` needs a study of kind `branch`; this one is `grid` (s.toml, want.figures).",
        'claims = ["E22"]': "Unknown name `E22`, did you mean `E2`? (s.toml, want.claims).",
    },
    "seconds = 5": {
        "seconds = 0": "`seconds` must be > 0 and at most 1e6 s; got 0 (s.toml, limits.seconds)."
    },
    'memory = "1.5 GiB"': {
        'memory = "2 GB/s"': "`memory` must be at least 64 MiB and at most 1024 TiB, as in \"2 GiB\"; got '2 GB/s' (s.toml, limits.memory).",
        f'memory = "{"9" * 400} GiB"': '`memory` must be at least 64 MiB and at most 1024 TiB, as in "2 GiB";'
        f" got '{'9' * 56} (s.toml, limits.memory).",
        'memory = "2 GiB"\n[options]\nstarts = 3': "Unknown key `starts`, known: violation_limits, steps, tuned (s.toml, options).",
        'memory = "2 GiB"\n[options]\nviolation_limits = { friction = -1 }': "`friction` must be at least 0; got -1"
        " (s.toml, options.violation_limits.friction).",
        'memory = "2 GiB"\n[options]\nviolation_limits = { scuf = 0.1 }': "Unknown violation `scuf`, did you mean `scuff`?"
        " (s.toml, options.violation_limits).",
        'memory = "2 GiB"\n[options]\nviolation_limits = 0.1': "`violation_limits` must be a table of limits by the names of"
        " violations; got 0.1 (s.toml, options.violation_limits).",
    },
}

#: Options of a study of another kind, and what is said about them.
WRONG_OPTIONS = [
    (
        "branch",
        "n = 3",
        "Unknown key `n`, known: steps, sensitivities, onsets, violation_limits, tuned "
        "(s.toml, options).",
    ),
    (
        "orbit",
        "stebs = 3",
        "Unknown key `stebs`, did you mean `steps`? (s.toml, options).",
    ),
    (
        "orbit",
        "steps = -3",
        "`steps` must be a whole number from 1 to 1,000,000; got -3 (s.toml, options.steps).",
    ),
    (
        "orbit",
        'gait = "loong"',
        "Unknown name `loong`, did you mean `long`? (s.toml, options.gait).",
    ),
    (
        "orbit",
        'spread = "1e-3"',
        "`spread` must be a number; got '1e-3' (s.toml, options.spread).",
    ),
    (
        "cascade",
        "families = 3",
        "`families` must be a list of whole numbers from 1 to 1,000,000; got 3 (s.toml, options.families).",
    ),
    (
        "basin",
        "stance_rate = [0.2, 0.1]",
        "`stance_rate` must be two increasing numbers; got [0.2, 0.1] (s.toml, options.stance_rate).",
    ),
    (
        "curve",
        'key = "detunning"',
        "Unknown name `detunning`, did you mean `detuning`? (s.toml, options.key).",
    ),
    (
        "curve",
        'key = "R"\nfrom = 0.2\nto = 0.1',
        "`from` must be less than `to` = 0.1; got 0.2 (s.toml, options.from).",
    ),
    (
        "curve",
        'key = "R"\nfrom = 2',
        "`from` must be less than `to` = 1.0; got 2 (s.toml, options.from).",
    ),
    (
        "curve",
        'key = "R"\nfrom = -0.1\nto = 0.1',
        "`R` must be >= 0; got -0.1 (s.toml, options.from).",
    ),
    (
        "curve",
        "to = 0.5",
        "`detuning` needs walker A or C, or `toward`, another walker; got E (s.toml, options.key).",
    ),
    (
        "curve",
        'kinds = ["folds"]',
        "Unknown name `folds`, did you mean `fold`? (s.toml, options.kinds).",
    ),
]


@pytest.fixture
def write(tmp_path):
    def write(text):
        (tmp_path / "s.toml").write_text(text)
        return tmp_path / "s.toml"

    return write


def test_a_law_of_gaits_that_are_not_wanted_is_refused(write):
    text = 'name = "s"\nwalker = "E"\ngaits = ["long"]\n[axes]\nslope = [0.01, 0.02]\n[want]\nfits = ["transition"]\n'
    with pytest.raises(StudyError) as error:
        parse.read(write(text))
    assert (
        str(error.value)
        == "`transition` is a law of short gaits, which `gaits` leaves out (s.toml, gaits)."
    )
    assert parse.read(write(text.replace("long", "short"))).fits == ("transition",)


def test_a_good_study_is_read(write):
    found = parse.read(write(GOOD))
    assert found.points == 14 and found.lines == 2
    np.testing.assert_allclose(found.values_along[[0, -1]], [1e-4, 0.1])
    assert found.line(1) == {"walker": "E", "set": {"foot_mass_ratio": 0.05}}
    assert (
        found.variables[:2] == ("period", "multiplier_real")
        and "status" in found.variables
    )
    assert found.limits == model.Limits(5.0, 3 << 29)
    assert found.gaits == ("long", "short", "other1", "other2")


@pytest.mark.parametrize(
    ("line", "wrong", "said"),
    [
        (line, wrong, said)
        for line, cases in WRONG.items()
        for wrong, said in cases.items()
    ],
)
def test_a_wrong_study_is_answered_in_one_helpful_line(write, line, wrong, said):
    assert line in GOOD
    with pytest.raises(StudyError) as error:
        parse.read(write(GOOD.replace(line, wrong)))
    assert str(error.value) == said


def test_what_would_have_been_known_is_listed_once_each(write):
    text = 'name = "s"\nwalker = "E"\n[axes]\nslope = [0.01]\n[want]\nvariables = ["qqqqqq"]\n'

    with pytest.raises(StudyError) as error:
        parse.read(write(text))

    known = str(error.value).partition("known: ")[2].partition(" (")[0].split(", ")
    assert "energy" in known and len(known) == len(set(known))


def test_adaptive_slopes_are_those_of_branches(write):
    adaptive = "slope = { from = 0.01, to = 0.1, adaptive = 1e-3 }"
    text = f'name = "s"\nkind = "orbit"\nwalker = "E"\n[axes]\n{adaptive}\n'
    parse.read(write(text.replace("orbit", "branch")))
    with pytest.raises(StudyError) as error:
        parse.read(write(text))
    assert str(error.value) == (
        '`adaptive` is for studies of kind "branch", whose points follow the gaits'
        " (s.toml, axes.slope.adaptive)."
    )


def test_a_window_has_two_ends(write):
    text = 'name = "s"\nkind = "cascade"\nwalker = "E"\n[axes]\nslope = [0.01]\n'
    with pytest.raises(StudyError) as error:
        parse.read(write(text))
    assert str(error.value) == (
        "The slopes of a `cascade` are a window: give at least two; got 0.01"
        " (s.toml, axes.slope)."
    )


@pytest.mark.parametrize(("kind", "option", "said"), WRONG_OPTIONS)
def test_a_wrong_option_is_answered_in_one_helpful_line(write, kind, option, said):
    with pytest.raises(StudyError) as error:
        parse.read(
            write(
                f'name = "s"\nkind = "{kind}"\nwalker = "E"\n[axes]\nslope = [0.01, 0.02]\n[options]\n{option}\n'
            )
        )
    assert str(error.value) == said


@pytest.mark.parametrize(
    ("kind", "want", "said"),
    [
        ("branch", 'fits = ["scaling"]', "`scaling` needs a study of kind `grid`; this one is `branch` (s.toml, want.fits)."),
        ("orbit", 'fits = ["transition"]', "`transition` needs a study of kind `grid`; this one is `orbit` (s.toml, want.fits)."),
        ("design", 'fits = ["landmarks"]', "`landmarks` needs a study of another kind than `design` (s.toml, want.fits)."),
        ("design", 'figures = ["angles"]', "`angles` needs a study of another kind than `design` (s.toml, want.figures)."),
        ("design", 'claims = ["K2"]', "`K2` needs a study of another kind than `design` (s.toml, want.claims)."),
    ],
)  # fmt: skip
def test_what_a_kind_of_study_cannot_show_is_refused(write, kind, want, said):
    with pytest.raises(StudyError) as error:
        parse.read(
            write(
                f'name = "s"\nkind = "{kind}"\nwalker = "D"\n[axes]\nslope = [0.01, 0.02]\n[want]\n{want}\n'
            )
        )
    assert str(error.value) == said


@pytest.mark.parametrize(
    ("walker", "axes", "place"),
    [
        ('"A"', "detuning = [-50.0, 50.0]", "axes.detuning"),
        ('"A"', "m_h = [0.0, 1.0]\ndetuning = [0.0, 50.0]", "axes.detuning"),
        # Only both together take the hip below the foot's centre.
        ('{ base = "B", R = 0.3 }', "l_t = [0.1, 0.5]\nl_s = [0.1, 0.5]", "axes"),
        ('{ base = "B", R = 3.0 }', "l_t = [0.1, 0.5]", "walker"),
    ],
)
def test_a_walker_that_cannot_be_is_wrong_where_it_is_made_so(
    write, walker, axes, place
):
    with pytest.raises(StudyError) as error:
        parse.read(
            write(f'name = "s"\nwalker = {walker}\n[axes]\nslope = [0.01]\n{axes}\n')
        )
    assert str(error.value).endswith(f" (s.toml, {place}).")


def test_a_key_that_leaves_no_walker_to_follow_is_refused(write):
    options = '[options]\nkey = "c_s"\nfrom = -0.5\nto = 0.4\n'
    with pytest.raises(StudyError) as error:
        parse.read(
            write(
                f'name = "s"\nkind = "curve"\nwalker = "D"\n[axes]\nslope = [0.001, 0.1]\n{options}'
            )
        )
    assert str(error.value) == (
        "`c_s` = -0.5 leaves no walker: `m_s` may vanish only off the hip: the swing leg has no"
        " inertia; got 0.0 (s.toml, options.from)."
    )


def test_a_byte_order_mark_is_no_part_of_a_study(write, tmp_path):
    (tmp_path / "mine.toml").write_text('[walker]\nbase = "E"\n', encoding="utf-8-sig")
    text = GOOD.replace('"E"', '"mine.toml"')
    write(text).write_text(text, encoding="utf-8-sig")
    found = parse.read(tmp_path / "s.toml")
    assert found.text == text and found.walkers == ({"base": "E"},)


def axis(write, text, name="R"):
    study = parse.read(
        write(f'name = "s"\nwalker = "E"\n[axes]\nslope = [0.01]\n{name} = {text}\n')
    )
    return next(a.values for a in study.axes if a.name == name)


def test_equal_steps_are_the_decimals_that_one_would_write(write):
    assert axis(write, "{ from = 0.0, to = 0.5, n = 6 }").tolist() == [
        0.0,
        0.1,
        0.2,
        0.3,
        0.4,
        0.5,
    ]
    assert axis(write, "{ from = -0.07, to = 0.105, n = 36 }", "c_t").tolist() == [
        float(f"{k * 5 - 70}e-3") for k in range(36)
    ]
    assert axis(write, "{ from = 1e-3, to = 2e-3, n = 5 }").tolist() == [
        1e-3,
        1.25e-3,
        1.5e-3,
        1.75e-3,
        2e-3,
    ]
    assert axis(write, "{ from = 0.05, to = 0.25, n = 3 }").tolist() == [
        0.05,
        0.15,
        0.25,
    ]
    # Thirds are no short decimals; neither are numbers of seventeen digits.
    for text, values in (
        ("{ from = 0.0, to = 0.1, n = 4 }", np.linspace(0.0, 0.1, 4)),
        (
            "{ from = 0.01234567890123456, to = 0.1, n = 5 }",
            np.linspace(0.01234567890123456, 0.1, 5),
        ),
        ("{ from = 0.1, to = 0.4, n = 1 }", [0.1]),
    ):
        np.testing.assert_array_equal(axis(write, text), values)


def test_a_walker_may_be_based_on_a_file(write, tmp_path):
    (tmp_path / "walkers").mkdir()
    (tmp_path / "walkers" / "first.toml").write_text(
        '[walker]\nbase = "C"\nm_h = 1.0\nR = 0.21\n'
    )
    (tmp_path / "walkers" / "second.toml").write_text(
        '[walker]\nbase = "first.toml"\nR = 0.22\n'
    )

    def read(text):
        (walker,) = parse.read(
            write(f'name = "s"\nwalker = {text}\n[axes]\nslope = [0.01]\n')
        ).walkers
        return walker

    assert read('{ base = "walkers/second.toml", w_t = 0.0 }') == {
        "base": "C",
        "m_h": 1.0,
        "R": 0.22,
        "w_t": 0.0,
    }
    assert (
        read('"walkers/first.toml"')
        == read(f'"{tmp_path}/walkers/first.toml"')
        == {"base": "C", "m_h": 1.0, "R": 0.21}
    )
    (tmp_path / "walkers" / "first.toml").write_text('[walker]\nbase = "second.toml"\n')
    with pytest.raises(StudyError, match="is based on more than 8 other files"):
        read('"walkers/first.toml"')
    with pytest.raises(
        StudyError, match=r"^There is no file none.toml \(s.toml, walker\).$"
    ):
        read('{ base = "none.toml" }')


def test_the_registry_names_every_claim_and_curve_of_the_tasks():
    from gaitsweep.pipeline.dispatch import resolve
    from gaitsweep.tasks.contract import registry

    assert set(registry.CLAIMS) == set(resolve("gaitsweep.tasks.ledger.claim:CLAIMS"))
    assert set(registry.FOLLOWED) < set(
        resolve("gaitsweep.tasks.branches.conditions:CONDITIONS")
    )


def test_a_list_of_allowed_names_is_whole(write):
    hidden = "targets", "sensitivities"
    names = {v.name for v in VARIABLES.values() if v.group not in hidden}
    for line, wrong, known in (
        ('variables = ["period", "multipliers"]', 'variables = ["qqqq"]', names),
        ('variables = ["period", "multipliers"]', 'claims = ["qqqq"]', CLAIMS),
    ):
        with pytest.raises(StudyError) as error:
            parse.read(write(GOOD.replace(line, wrong)))
        assert set(known) <= set(
            str(error.value)
            .partition("known: ")[2]
            .partition(" (s.toml")[0]
            .split(", ")
        )


def test_a_study_that_is_no_toml_is_shown_its_line(write):
    with pytest.raises(
        StudyError,
        match=r"s\.toml cannot be read: Expected ']' .* \(at line 2, column 6\)\.",
    ):
        parse.read(write('name = "s"\n[axes\nslope = [0.1]\n'))


@pytest.mark.parametrize(
    ("text", "line", "caret"),
    [
        ('"歩行" = 1 2', '  1 | "歩行" = 1 2', "    |            ^"),
        ('"e\u0301" = 1 2', '  1 | "e\u0301" = 1 2', "    |         ^"),
        ('name = "s"\n[axes\nslope = [0.1]\n', "  2 | [axes", "    |      ^"),
        ('name = "s"\r\n\twalker = E\r\n', "  2 |  walker = E", "    |           ^"),
        ('name = "s"\nx = [1, 2\n\n', "  2 | x = [1, 2", "    |          ^"),
        ('name = "s"\nx = 1\nx = 2\n', "  3 | x = 2", "    |      ^"),
        ("x = 1 " + "#" * 200 + "\ny = " + "1" * 200 + "z", "  2 | " + "1" * 60 + "z", "    | " + " " * 60 + "^"),
    ],
)  # fmt: skip
def test_below_the_error_of_a_toml_a_caret_shows_its_place(write, text, line, caret):
    with pytest.raises(StudyError, match=r"s\.toml cannot be read: ") as error:
        parse.read(write(text))
    (note,) = error.value.__notes__
    assert note.split("\n") == [line, caret]


def test_what_is_no_error_of_a_place_shows_none(write):
    with pytest.raises(StudyError) as error:
        parse.read(write('name = "s"\n' + DEEP["header"]))
    assert not hasattr(error.value, "__notes__")


DEEP = {
    "header": "[" + "a." * 100_000 + "a]\n",
    "header of a walker": "[walker." + "a." * 1500 + "a]\n",
    "header of tables": "[[" + "a . " * 100_000 + "a]]\n",
    "key": "a." * 100_000 + "a = 1\n",
    "quoted key": """"a.\\"," .'b, c'.""" * 50_000 + "a = 1\n",
    "key in a table": "x = { y = 1, " + "a." * 100_000 + "a = 1 }\n",
    "keys upon keys": "[a." + "b." * 25 + "c]\n" + "d." * 25 + "e = 1\n",
    "lists": "a = " + "[" * 200 + "]" * 200 + "\n",
    "many lists": "a = " + "[" * 100_000 + "\n",
    "tables": "a = " + "{ a = " * 200 + "1" + " }" * 200 + "\n",
    "many tables": "a = " + "{ a = " * 100_000 + "\n",
}


@pytest.mark.parametrize("text", DEEP.values(), ids=DEEP)
def test_a_file_that_is_nested_deeply_is_refused_at_once(write, tmp_path, text):
    """A header of 100,000 parts took half a minute, one of 1,500 ended in an internal
    error.
    """
    (tmp_path / "deep.toml").write_text(text)
    start = time.process_time()

    for read in (
        lambda: parse.read(write(text)),
        lambda: parse.read(write(GOOD.replace('"E"', '"deep.toml"', 1))),
        lambda: files.walker("deep.toml", tmp_path),
        lambda: gaitsweep.run(f"{text}x = 1\n"),
    ):
        with pytest.raises(
            StudyError,
            match=r"cannot be read: Tables and lists are nested more than 32 deep",
        ) as error:
            read()
        assert "\n" not in str(error.value)

    assert time.process_time() - start < 2


def test_dots_in_texts_numbers_and_comments_nest_nothing():
    words = "A word. " * 99 + "." * 99 + "1.5, 2.5, " * 99

    found = toml.read(
        f'# {words}\na = "{words}"\nb = [{"1.5, " * 99}]\n{"c." * 31}c = 1\n'
    )

    assert found["a"] == words and found["b"] == [1.5] * 99 and found["c"]


def test_a_walker_file_in_place_of_a_study_says_so(write):
    with pytest.raises(
        StudyError, match=r"^This file holds a walker and no study; .* \(s.toml\)\.$"
    ):
        parse.read(write('[walker]\nbase = "E"\n'))


def test_a_study_without_axes_says_so(write):
    with pytest.raises(
        StudyError, match=r"^A study needs axes, at least `slope` \(s.toml, axes\)\.$"
    ):
        parse.read(write('name = "s"\nwalker = "E"\n'))


def test_a_walker_file_is_read_beside_the_study(write, tmp_path):
    (tmp_path / "mine.toml").write_text('[walker]\nbase = "E"\nR = 0.1\n')
    found = parse.read(
        write(
            GOOD.replace('"E"', '"mine.toml"').replace(
                "foot_mass_ratio = [0.1, 0.05]", ""
            )
        )
    )
    assert found.walkers == ({"base": "E", "R": 0.1},)
    assert found.checks[0]["table"]["R"] == 0.1


def test_a_walker_is_archived_as_it_is_before_axes_move_it(write):
    axes = "slope = [0.01]\ndetuning = [0.0, 1.0]\nm_h = [1.0, 2.0]"
    found = parse.read(write(f'name = "s"\nwalker = ["C", "A"]\n[axes]\n{axes}\n'))
    about = json.loads(
        provenance(SimpleNamespace(study=found, graph=SimpleNamespace(layers={})))
    )
    assert about["walkers"] == [CATALOGUE[name].table() for name in "CA"]
    detuned = {key: ["detuning"] for key in ("w_t", "r_t", "c_t", "w_s", "r_s")}
    assert about["varied"] == {"m_h": ["m_h"], **detuned} and about["tuned"] == []


TUNED = 'name = "s"\nwalker = ["A", "C"]\n[axes]\nslope = [0.01]\nR = [0.2, 0.3]\n[options]\ntuned = {}\n'


def test_a_study_may_have_keys_tuned(write):
    found = parse.read(write(TUNED.format('["w_t", "w_s"]')))
    assert found.walkers == tuple(
        {"base": name, "tuned": ["w_t", "w_s"]} for name in "AC"
    )
    assert found.names == ("A", "C") and "tuned" not in found.options
    assert parse.read(write(TUNED.format("[]"))).walkers == ("A", "C")


@pytest.mark.parametrize(
    ("tuned", "said"),
    [
        (
            '"w_t"',
            "`tuned` must be a list of keys of a walker; got 'w_t' (s.toml, options.tuned).",
        ),
        ('["w_q"]', "Unknown name `w_q`, did you mean `w_t`? (s.toml, options.tuned)."),
        (
            '["w_t"]',
            "`tuned` cannot meet the static conditions of vanishing slopes; add a key; got w_t (s.toml, axes.R).",
        ),
        (
            '["w_t", "R"]',
            "`R` is set by `tuned`, which changes it so that the walker is tuned; got 0.2 (s.toml, axes.R).",
        ),
        ('["detuning"]', "`tuned` must be a list of keys of a walker"),
    ],
)
def test_what_cannot_be_tuned_is_said_before_a_study_runs(write, tuned, said):
    with pytest.raises(StudyError) as refused:
        parse.read(write(TUNED.format(tuned)))
    assert str(refused.value).startswith(said.rstrip("."))


def test_a_list_of_walkers_is_a_dimension(write):
    found = parse.read(write(GOOD.replace('"E"', '["E", "F"]')))
    assert found.walker_axis and found.line_shape == (2, 2)
    assert [found.line(i)["walker"] for i in range(4)] == ["E", "E", "F", "F"]


def _survives(path, text):
    path.write_bytes(text)
    try:
        parse.read(path)
    except StudyError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000


_VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.sampled_from(
        ["E", "A", "log", "slope", "long", "period", "../x.toml", "2 GiB", "nan"]
    ),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                [
                    "from",
                    "to",
                    "n",
                    "spacing",
                    "base",
                    "slope",
                    "m_s",
                    "seconds",
                    "variables",
                ]
            )
            | st.text(max_size=4),
            inner,
            max_size=4,
        )
    ),
    max_leaves=8,
)
_STUDIES = st.fixed_dictionaries(
    {},
    optional=dict.fromkeys(
        ("name", "kind", "walker", "gaits", "axes", "want", "limits", "options", "x"),
        _VALUES,
    ),
)


def _fuzz(path, table):
    good = {"name": "s", "walker": "E", "axes": {"slope": [0.01]}}
    try:
        parse.parse({**good, **table}, "", path)
    except StudyError as error:
        assert "\n" not in str(error)


@settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(table=_STUDIES)
@example(table={"walker": {"\n": None}})
def test_no_table_gets_past_the_reader_as_a_traceback(tmp_path, table):
    _fuzz(tmp_path / "s.toml", table)


@settings(
    max_examples=200,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(at=st.integers(0, len(GOOD)), junk=st.binary(max_size=8), cut=st.integers(0, 20))
def test_no_text_gets_past_the_reader_as_a_traceback(tmp_path, at, junk, cut):
    _survives(
        tmp_path / "s.toml", GOOD.encode()[:at] + junk + GOOD.encode()[at + cut :]
    )


@pytest.mark.soak
@settings(max_examples=100_000, deadline=None, suppress_health_check=list(HealthCheck))
@given(table=_STUDIES)
def test_a_hundred_thousand_tables(tmp_path, table):
    _fuzz(tmp_path / "s.toml", table)


def test_a_study_has_at_most_a_trillion_points_or_designs():
    """The slopes of designs are a window: they do not count."""
    million = {"from": 0.1, "to": 0.2, "n": 1_000_000}
    table = {
        "name": "large",
        "walker": "B",
        "axes": {"slope": [0.01, 0.02], "m_s": million, "R": million},
    }
    with pytest.raises(StudyError, match=r"2e\+12 points, more than 1e\+12"):
        parse.parse(table, "", Path("large.toml"))
    assert (
        parse.parse({**table, "kind": "design"}, "", Path("large.toml")).lines == 10**12
    )
