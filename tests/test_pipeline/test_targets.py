"""Gaits at values of a measure: studies with `at`, and `gaits(at=...)`."""

import numpy as np
import pytest
import xarray as xr

import gaitsweep
from gaitsweep import StudyError
from gaitsweep.pipeline.archive.verify import verify

SPEEDS = [0.1, 0.2, 0.3, 0.9]
STUDY = {
    "name": "targets",
    "walker": "A",
    "at": {"froude_speed": SPEEDS, "vary": "slope"},
    "axes": {"R": [0.1, 0.2]},
}


def run(tmp_path, **changes):
    wanted = {**STUDY, **changes}
    archive = tmp_path / "targets.nc"
    return gaitsweep.run(wanted, jobs=1, archive=archive, quiet=True)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return run(tmp_path_factory.mktemp("targets"))


def test_gaits_of_a_study_have_the_values_asked_for(study):
    assert study.slope.dims == ("R", "froude_speed", "gait")
    assert (study.status.sel(froude_speed=SPEEDS[:3]) == "converged").all()

    for radius in study.R.values:
        for value in SPEEDS[:3]:
            there = study.sel(R=radius, froude_speed=value)
            for gait in ("long", "short"):
                one = there.sel(gait=gait)
                solved = gaitsweep.gaits("A", float(one.slope), R=radius)
                other = solved.sel(gait=gait)
                bound = float(one.error_bound + other.error_bound)
                assert bound < 1e-12
                assert abs(float(other.froude_speed) / value - 1) < 4 * bound
                assert abs(float(other.period / one.period) - 1) < bound


def test_a_value_that_no_gait_has_says_which_there_are(study):
    none = study.sel(froude_speed=0.9, R=0.2)
    assert (none.status == "no_gait").all() and none.slope.isnull().all()
    sentence = str(none.reason.sel(gait="long").values)
    assert sentence.startswith("No long gait has this froude_speed for `slope` from ")
    assert "there are 0.0" in sentence


def test_an_archive_of_targets_is_whole_and_has_a_page(study, tmp_path):
    run(tmp_path, accuracy=1e-9)
    archive = tmp_path / "targets.nc"
    assert not verify(archive)
    page = gaitsweep.report(archive, tmp_path / "pages")
    assert "froude_speed" in page.read_text()


def test_values_may_be_an_axis_of_the_study(study, tmp_path):
    axes = {"R": [0.1, 0.2], "froude_speed": SPEEDS}
    other = run(tmp_path, at={"vary": "slope"}, axes=axes)
    for name in ("slope", "stance_angle", "status"):
        assert other[name].equals(study[name])


def test_arrays_give_what_a_study_gives(study):
    radius = xr.DataArray([0.1, 0.2], dims="R", coords={"R": [0.1, 0.2]})
    speed = xr.DataArray(SPEEDS, dims="froude_speed")
    answer = gaitsweep.gaits("A", at={"froude_speed": speed}, R=radius)
    for name in ("slope", "stance_angle"):
        values = answer[name].transpose("R", "froude_speed", "gait").values[..., :2]
        # By other code, which rounds otherwise.
        np.testing.assert_allclose(values, study[name].values, rtol=1e-11)


def test_a_key_is_varied_over_slopes():
    answer = gaitsweep.gaits(
        "A", [0.01, 0.02], at={"froude_speed": [[0.15], [0.2]]}, vary="m_h"
    )
    assert answer.m_h.dims == ("dim_0", "dim_1", "gait") and "m_h" not in answer.attrs
    found = np.argwhere(np.isfinite(answer.m_h.values)).tolist()
    assert len(found) == 3
    for i, j, g in found:
        one = answer.isel(dim_0=i, dim_1=j, gait=g)
        other = gaitsweep.gaits("A", float(one.slope), m_h=float(one.m_h))
        speeds = other.froude_speed.values
        assert np.nanmin(abs(speeds - float(one.froude_speed))) < 1e-12


def test_a_key_that_only_changes_units_changes_no_froude_speed():
    answer = gaitsweep.gaits("A", 0.02, at={"froude_speed": 0.2}, vary="g")
    assert (answer.status == 1).all()
    assert "froude_speed does not change with `g`" in str(answer.reason_text.values)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"at": {"vary": "slope"}},
            "`at` must name one measure, here or among the axes; got 'none' ",
        ),
        (
            {"at": {"speed": 0.3}, "axes": {"period": [0.3], "R": [0.2]}},
            "`at` must name one measure, here or among the axes; got 'speed, axes.per",
        ),
        (
            {"at": {"speed": 0.3}, "axes": {"slope": [0.01]}},
            "`slope` is varied until gaits have the value of `at`, and can be no axis",
        ),
        (
            {"at": {"speed": 0.3, "vary": "R"}},
            "`R` is varied until gaits have the value of `at`, and can be no axis",
        ),
        (
            {"at": {"speed": 0.3, "vary": "m_h"}},
            "A study needs the axis `slope`",
        ),
        ({"at": {"sped": 0.3}}, "Unknown measure `sped`, did you mean `speed`?"),
        (
            {"at": {"kneestrike_time": 0.3}},
            "`at` must be a measure of its gaits: stance_angle, ",
        ),
        ({"at": {"speed": "fast"}}, "`speed` must be a number; got 'fast'"),
        ({"at": {"speed": 0.3, "between": [0.2, 0.1]}}, "`between` must be two incr"),
        (
            {"at": {"speed": 0.3, "between": [0.0, 0.1]}},
            "`between` must be slopes above 0, as nothing but gravity drives the walker",
        ),
        (
            {
                "at": {"speed": 0.3, "vary": "R", "between": [-1.0, 0.3]},
                "axes": {"slope": [0.01]},
            },
            "`R` must be >= 0; got -1.0 (study, at.between).",
        ),
        (
            {
                "at": {"speed": 0.3, "vary": "l_s", "between": [0.19, 0.5]},
                "axes": {"slope": [0.01]},
            },
            "`between` leaves no walker at `l_s` = 0.19: `eps_T` must satisfy ",
        ),
        (
            {
                "at": {"speed": 0.3, "vary": "w_t"},
                "axes": {"slope": [0.01], "detuning": [0.0, 0.1]},
            },
            "`w_t` is set by `detuning`, which owns w_t, r_t, c_t, w_s, r_s; got ",
        ),
        (
            {"kind": "optimum", "axes": {"slope": [0.01, 0.02]}},
            "`at` is of the gaits of a grid; this study is a `optimum` (study, at).",
        ),
        (
            {"want": {"figures": ["loglog"]}},
            "`loglog` is of gaits at slopes, and `at` seeks them at values",
        ),
        (
            {"want": {"variables": ["proofs"]}},
            "`proved` is of gaits at slopes, and `at` seeks them at values",
        ),
        ({"kind": "branch"}, "`at` is of the gaits of a grid; this study is a"),
        ({"want": {"variables": ["varied"]}}, "Unknown name `varied`"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_line(tmp_path, changes, sentence):
    with pytest.raises(StudyError) as refused:
        run(tmp_path, **changes)
    assert str(refused.value).startswith(sentence)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ({}, "`slope` is needed, or `at` with values of a measure."),
        ({"at": {"speed": 1.0, "period": 1.0}}, "`at` must be a table of one measure"),
        ({"at": {"speed": np.nan}}, "`speed` must be finite; got nan."),
        ({"at": {"speed": 0.3}, "slope": 0.1}, "`slope` is varied and cannot be set"),
        ({"at": {"speed": 0.3}, "vary": "R"}, "`slope` is needed where a key is vari"),
        (
            {"at": {"speed": 0.3}, "vary": "R", "slope": 0.01, "R": 0.2},
            "`R` is varied and cannot be set too; got 0.2.",
        ),
        (
            {"at": {"speed": 0.3}, "between": (-0.1, 0.1), "steps": 2},
            "`steps` must be 1 where `between` has slopes of 0 or below; got 2.",
        ),
        (
            {"at": {"speed": 0.3}, "vary": "R", "slope": 0.7},
            "`slope` must lie in [1e-18, 0.5) rad; got 0.7",
        ),
    ],
)
def test_arguments_that_cannot_be_are_refused_in_a_line(asked, sentence):
    with pytest.raises(StudyError) as refused:
        gaitsweep.gaits("A", **asked)
    assert str(refused.value).startswith(sentence)


@pytest.mark.thorough
def test_gaits_of_two_steps_are_those_of_single_solves(tmp_path):
    """In Python, by the command and in a study."""
    asked = {"between": (0.0152, 0.03), "steps": 2}

    found = gaitsweep.gaits("D", at={"speed": 0.128}, **asked)

    (slope,) = found.slope.values[np.isfinite(found.slope.values)].tolist()
    single = gaitsweep.solve("D", at={"speed": 0.128}, **asked)
    assert single["slope"].tolist() == [slope]
    there = gaitsweep.gaits("D", slope, steps=2).sel(gait="long")
    assert there.speed.item() == pytest.approx(0.128, rel=1e-12)
    assert there.period.item() == pytest.approx(single["period"][0], rel=1e-12)

    at = {"speed": 0.128, "between": [0.0152, 0.03]}
    changed = {"walker": "D", "at": at, "axes": {}, "options": {"steps": 2}}
    archive = run(tmp_path, **changed)
    assert np.nanmax(archive.slope.values) == pytest.approx(slope, rel=1e-14)


@pytest.mark.thorough
def test_keys_of_gaits_of_two_steps_are_those_of_single_solves(tmp_path):
    """In Python, by the command and in a study."""
    asked = {"vary": "R", "between": (0.0, 0.1), "steps": 2}
    target = {"speed": 0.125}

    found = gaitsweep.gaits("D", 0.016, at=target, **asked)

    (radius,) = found.R.values[np.isfinite(found.R.values)].tolist()
    single = gaitsweep.solve("D", 0.016, at=target, **asked)
    assert single["R"].tolist() == [radius]
    there = gaitsweep.gaits("D", 0.016, R=radius, steps=2).sel(gait="long")
    assert there.speed.item() == pytest.approx(0.125, rel=1e-12)
    assert there.period.item() == pytest.approx(single["period"][0], rel=1e-12)

    at = {**target, "vary": "R", "between": [0.0, 0.1]}
    axes = {"slope": [0.016]}
    changed = {"walker": "D", "at": at, "axes": axes, "options": {"steps": 2}}
    archive = run(tmp_path, **changed)
    assert np.nanmax(archive.R.values) == pytest.approx(radius, rel=1e-13)


@pytest.mark.parametrize("ask", [gaitsweep.solve, gaitsweep.gaits])
@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"vary": "R"}, "`vary` needs `at`, a measure with its value; got 'R'."),
        (
            {"between": (0.1, 0.2)},
            "`between` needs `at`, a measure with its value; got (0.1, 0.2).",
        ),
        (
            {"between": np.array([0.1, 0.2])},
            "`between` needs `at`, a measure with its value; got array([0.1, 0.2]).",
        ),
    ],
)
def test_what_varies_for_no_measure_is_refused(ask, given, sentence):
    with pytest.raises(StudyError) as refused:
        ask("A", 0.01, **given)

    assert str(refused.value) == sentence


@pytest.mark.parametrize(
    ("vary", "slope", "range_of"),
    [
        ("slope", 0.0232, (0.5, 1.0)),
        ("slope", 0.0232, (1.0, 2.0)),
        ("slope", 0.00646, (0.5, 1.0)),
        ("slope", 0.00646, (1.0, 2.0)),
        pytest.param("R", 0.0179801092413528, (0.5, 1.0), marks=pytest.mark.thorough),
        pytest.param("R", 0.03, (1.0, 2.0), marks=pytest.mark.thorough),
    ],
)
def test_a_gait_at_an_end_of_the_range_is_found(vary, slope, range_of):
    """By rounding its value, or what is varied, may lie beyond."""
    own = {"slope": slope, "R": 0.2}
    speed = float(gaitsweep.gaits("A", slope).froude_speed.sel(gait="long"))
    between = [share * own[vary] for share in range_of]
    asked = {} if vary == "slope" else {"slope": slope}

    found = gaitsweep.solve(
        "A", at={"froude_speed": speed}, vary=vary, between=between, **asked
    )

    assert np.abs(found[vary] / own[vary] - 1).min() < 1e-10
    assert (found["error_bound"] < 1e-9).all()
