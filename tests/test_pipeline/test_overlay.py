"""The user's own measurements: read, refused in one line, archived, and compared with
the curves.
"""

import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from gaitsweep.pipeline import gaits
from gaitsweep.pipeline.cli import commands
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.report import html_tables, pages
from gaitsweep.pipeline.report.figures import measured
from gaitsweep.pipeline.report.source import read as read_archive
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.studies import solve_measured
from gaitsweep.tasks.studies.solve_at_slope import solve_one

STUDY = """name = "own"
walker = "{walker}"
[axes]
slope = {{ from = 0.02, to = 0.05, n = 61 }}
[figures.overlay]
file = "measured.csv"
[want]
variables = ["stance_angle", "period"]
figures = ["linear"]
"""
HEAD = "slope [rad],period [s]\n"


@pytest.fixture
def refuse(tmp_path):
    """The one line that answers a file of measurements."""

    def ask(text, walker="physical"):
        (tmp_path / "s.toml").write_text(STUDY.format(walker=walker))
        if text is not None:
            (tmp_path / "measured.csv").write_bytes(
                text if isinstance(text, bytes) else text.encode()
            )
        with pytest.raises(StudyError) as caught:
            parse.read(tmp_path / "s.toml")
        assert "\n" not in str(caught.value) and len(str(caught.value)) < 500
        return str(caught.value)

    return ask


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "There is no file measured.csv (s.toml, figures.overlay.file)."),
        ("", "must have a heading and 1 to 20,000 rows; it has 0"),
        (HEAD, "must have a heading and 1 to 20,000 rows; it has 0"),
        (
            HEAD + "0.03,abc\n",
            "`period` must be a number; got 'abc' (measured.csv, row 2)",
        ),
        (HEAD + "0.03,inf\n", "`period` must be a number; got 'inf'"),
        (
            "slope [rad],periode [s]\n0.03,1\n",
            "Unknown column of measured.csv `periode`, did you mean `period`?",
        ),
        (
            "slope [rad],period [s],walker_error\n0.03,1,1\n",
            "Unknown column of measured.csv `walker_error`, did you mean `walker`?",
        ),
        (
            "slope [rad],period [ms]\n0.03,1\n",
            "The column `period [ms]` of measured.csv must be `period [s]`",
        ),
        (
            "slope [rad],stance_angle\n0.03,1\n",
            "column `stance_angle` of measured.csv must be `stance_angle [rad]`",
        ),
        (
            "slope [m],period [s]\n0.03,1\n",
            "The column `slope [m]` of measured.csv must be `slope [rad]`",
        ),
        (
            "slope [rad],period [s],period [s]\n0.03,1,1\n",
            "measured.csv has two columns `period`",
        ),
        (
            "slope [rad],period [s],period_error [s]\n0.03,1,-1\n",
            "`period_error` must be at least 0; got '-1'",
        ),
        (
            "slope [rad],period [s],gait\n0.03,1,medium\n",
            "`gait` must be one of long, short, other1, other2",
        ),
        ("period [s]\n1\n", "needs the column `slope`, an axis with several values"),
        ("slope [rad]\n0.03\n", "has no measured variable"),
        ("slope [rad],period [s],walker\n0.03,1,Z\n", "Unknown walker `Z`"),
        (b"\xff\xfe\x00slope", "measured.csv cannot be read"),
        (b'slope [rad],period [s]\n"0.03,1\n', "measured.csv cannot be read"),
    ],
)
def test_a_wrong_file_is_answered_in_one_line(refuse, text, said):
    assert said in refuse(text)


def test_units_are_those_of_the_walker(refuse):
    said = refuse(HEAD + "0.03,1\n", walker="E")
    assert "must be `period` without a unit, as the walker has none" in said


def test_a_study_may_name_nothing_else_there(tmp_path):
    relative = "`file` must be a path relative to the study"
    wrong = {
        "[figures]\nshade = 1\n": "Unknown key `shade`",
        "[figures.overlay]\nfile = 3\n": relative,
        '[figures.overlay]\nfile = "/etc/passwd"\n': relative,
    }
    for text, said in wrong.items():
        (tmp_path / "s.toml").write_text(
            'name = "s"\nwalker = "E"\n[axes]\nslope = [0.01]\n' + text
        )
        with pytest.raises(StudyError, match=said):
            parse.read(tmp_path / "s.toml")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("own")
    (folder / "own.toml").write_text(STUDY.format(walker="physical"))
    rows = "0.025,0.83,0.02,10.5,long\n0.036,0.756985,,14,\n0.09,0.7,,,\n"
    heading = "slope [rad],period [s],period_error [s],stance_angle [deg],gait\n"
    (folder / "measured.csv").write_text(heading + rows)
    path = folder / "own.nc"
    assert (
        commands.main(
            [
                "run",
                f"{folder}/own.toml",
                "--archive",
                str(path),
                "--jobs",
                "1",
                "--quiet",
            ]
        )
        == 0
    )
    return path


def test_measurements_are_archived_with_units(archive):
    with xr.open_dataset(archive, group="overlay") as overlay:
        assert (
            overlay["period"].attrs["units"]
            == overlay["period_error"].attrs["units"]
            == "s"
        )
        assert overlay["stance_angle"].attrs["units"] == "rad"
        assert overlay["stance_angle"].values[0] == pytest.approx(np.radians(10.5))
        assert list(overlay["gait"].values) == ["long", "", ""] and np.isnan(
            overlay["stance_angle"].values[2]
        )
    assert commands.main(["verify", str(archive)]) == 0


def test_measurements_that_change_are_archived_though_nothing_is_solved(
    archive, tmp_path
):
    for name in ("own.toml", "measured.csv", "own.nc"):
        shutil.copy(archive.with_name(name), tmp_path)
    shutil.copytree(Companions(archive).folder, tmp_path / ".gaitsweep")
    (tmp_path / "measured.csv").write_text(HEAD + "0.03,0.8\n")
    path = str(tmp_path / "own.nc")
    assert (
        commands.main(
            ["run", f"{tmp_path}/own.toml", "--archive", path, "--jobs", "1", "--quiet"]
        )
        == 0
    )
    with xr.open_dataset(path, group="overlay") as overlay:
        assert overlay["period"].values.tolist() == [0.8]


def test_residuals_are_those_from_the_nearest_gait_or_the_one_named(archive):
    left = measured.residuals(read_archive(archive))
    period = left[left["variable"] == "period (s)"].set_index("slope")
    assert list(period.index) == [0.025, 0.036, 0.09]
    # The period of figure 3's gait has proved digits.
    proved = 0.7569820059513526958
    assert period.loc[0.036, "residual"] == pytest.approx(0.756985 - proved, abs=1e-13)
    assert period.loc[0.025, "residual"] == pytest.approx(
        0.83 - period.loc[0.025, "computed"]
    )
    assert period.loc[0.025, "over_error"] == pytest.approx(
        period.loc[0.025, "residual"] / 0.02
    )
    assert list(period["gait"]) == ["long", "long", ""]
    assert np.isnan(period.loc[0.09, "computed"])
    assert np.isnan(period.loc[0.09, "residual"])
    assert period.loc[0.09, "reason"].startswith("No long gait at this slope")
    assert len(left) == 5


def test_the_page_shows_measurements_and_residuals(archive, tmp_path):
    pages.write([archive], tmp_path)
    text = (tmp_path / "own.html").read_text()
    assert (
        "Residuals of the measurements" in text
        and ">measured<" in text
        and 'id="measured"' in text
    )
    assert "<code>measured.csv</code>" in text  # to be saved beside the study
    largest = (
        measured.residuals(read_archive(archive))
        .groupby("variable")["residual"]
        .agg(lambda r: r.abs().max())
    )
    assert (
        f">The largest residual of period (s) is {largest['period (s)']:.3g}; the largest"
        in text
        and ">γ (rad)" in text
    )


def solved(walker, slope, gait="long", **keys):
    """The gait of a label at one point, solved by itself."""
    found = gaits(walker, slope, **keys).sel(gait=gait)
    return {name: float(found[name]) for name in ("stance_angle", "period", "speed")}


def _archived(tmp_path, study, measurements):
    """Archive of a study with these measurements."""
    (tmp_path / "s.toml").write_text(study + '[figures.overlay]\nfile = "m.csv"\n')
    (tmp_path / "m.csv").write_text(measurements)
    path = tmp_path / "s.nc"
    assert (
        commands.main(
            [
                "run",
                f"{tmp_path}/s.toml",
                "--archive",
                str(path),
                "--jobs",
                "1",
                "--quiet",
            ]
        )
        == 0
    )
    return path


def test_a_measurement_between_the_values_of_an_axis_is_compared_with_a_gait_there(
    tmp_path,
):
    study = (
        'name = "s"\nwalker = "E"\n[axes]\nslope = [0.001, 0.002]\nfoot_mass_ratio = [0.01, 0.02]\n'
        '[want]\nvariables = ["stance_angle", "period"]\n'
    )
    # The period is measured nowhere: a column of empty cells.
    heading = "slope [rad],foot_mass_ratio,stance_angle [rad],period\n"
    path = _archived(
        tmp_path, study, heading + "0.002,0.01,0.126,\n0.002,0.015,0.127,\n"
    )
    left = measured.residuals(read_archive(path))
    assert left["foot_mass_ratio"].tolist() == [0.01, 0.015]
    between = solved("E", 0.002, foot_mass_ratio=0.015)
    assert abs(left["computed"][1] - between["stance_angle"]) < 1e-13
    pages.write([_archived(tmp_path, study, heading + "0.002,0.01,,\n")], tmp_path)
    assert "own measurements" in (tmp_path / "s.html").read_text()


def test_residuals_of_published_gaits_are_those_of_their_own_digits(tmp_path):
    """Gaits between the slopes of a study, printed with nine digits, differ from those
    computed there by less than these digits.
    """
    slopes = np.array([0.0029003, 0.00712345, 0.0131])
    rows = [solved("E", slope) for slope in slopes]
    text = "".join(
        f"{slope},{row['stance_angle']:.9f},{row['period']:.9f},{row['speed']:.9f}\n"
        for slope, row in zip(slopes, rows, strict=True)
    )
    study = (
        'name = "s"\nwalker = "E"\n[axes]\nslope = { from = 0.002, to = 0.02, n = 9 }\n'
    )
    path = _archived(
        tmp_path, study, "slope [rad],stance_angle [rad],period,speed\n" + text
    )

    left = measured.residuals(read_archive(path))
    assert (left["residual"].abs() <= 0.6e-9).all()
    assert len(left) == 9 and "reason" not in left
    with xr.open_dataset(path, group="measured_gaits") as computed:
        for name in ("stance_angle", "period", "speed"):
            alone = np.array([row[name] for row in rows])
            bound = computed[f"{name}_error"].values
            assert (bound < 1e-12).all() and (bound > 0).all()
            assert (np.abs(computed[name].values - alone) <= 2 * bound).all()
    assert (left["error"] > 0).all() and left["over_error"].isna().all()


def test_gaits_of_two_steps_are_compared_at_their_own_slopes(tmp_path):
    study = (
        'name = "s"\nwalker = "D"\n[axes]\nslope = [0.0155, 0.0165]\n'
        "[options]\nsteps = 2\n"
    )
    gait = gaits("D", 0.0161, steps=2).sel(gait="long")
    angle, period = float(gait["stance_angle"]), float(gait["period"])
    heading = "slope [rad],stance_angle [rad],period\n"
    path = _archived(tmp_path, study, f"{heading}0.0161,{angle:.9f},{period:.9f}\n")
    left = measured.residuals(read_archive(path))
    assert (left["residual"].abs() <= 0.6e-9).all()


def test_a_measurement_without_a_gait_says_why(tmp_path):
    study = (
        'name = "s"\nwalker = "E"\n[axes]\nslope = [0.001, 0.002]\nm_h = [0.0, 0.5]\n'
    )
    rows = (
        "0.9,0,0.1\n",
        ",0,0.1\n",
        "0.001,,0.1\n",
        "0.001,-1,0.1\n",
        "0.001,0,0.1\n",
    )
    heading = "slope [rad],m_h,stance_angle [rad]\n"
    path = _archived(tmp_path, study, heading + "".join(rows))

    left = measured.residuals(read_archive(path))
    assert left["reason"].tolist() == [
        "`slope` must lie in [1e-18, 0.5) rad; got 0.9.",
        "`slope` is not given.",
        "`m_h` is not given.",
        "`m_h` must be >= 0; got -1.0.",
        "",
    ]
    assert left["computed"].isna().tolist() == [True, True, True, True, False]


def test_bounds_of_measured_variables_follow_from_that_of_the_gait():
    """The angle, the period and what is made of them, the rates over the largest one,
    the multipliers; none is known of the others.
    """
    line = {"walker": "D", "set": {}}
    names = ("stance_angle", "period", "thigh_rate", "speed", "step_length")
    names += ("spectral_radius", "scuff_depth")
    values = {name: np.array([0.2]) for name in names}
    found = solve_measured.measured(
        {"lines": [line], "slope": [0.009], "gait": ["long"], "values": values}, []
    )
    columns = {name.split("/")[1]: column[0] for name, column in found.items()}
    gait, _ = solve_one({**line, "slope": 0.009})["gaits"]
    bound = gait["error_bound"]
    largest = max(abs(gait["stance_rate"]), abs(gait["thigh_rate"]))
    assert columns["stance_angle_error"] == bound * columns["stance_angle"]
    assert columns["thigh_rate_error"] == bound * largest
    assert largest > 1.05 * abs(columns["thigh_rate"])
    assert columns["speed_error"] == 2 * bound * columns["speed"]
    assert columns["spectral_radius_error"] == gait["multiplier_error_bound"]
    assert np.isnan(columns["scuff_depth_error"]) and columns["scuff_depth"] > 0


@pytest.mark.parametrize("named", ["long", "short"])
def test_a_measurement_that_names_its_gait_is_compared_with_it(named):
    near = solved("D", 0.009)
    found = solve_measured.measured(
        {
            "lines": [{"walker": "D", "set": {}}],
            "slope": [0.009],
            "gait": [named],
            "values": {"stance_angle": np.array([near["stance_angle"]])},
        },
        [],
    )
    assert found["measured_gaits/gait"].tolist() == [named]


def test_a_branch_study_compares_between_folds(tmp_path):
    study = (
        'name = "b"\nkind = "branch"\nwalker = "physical"\n[axes]\nslope = { from = 0.015, to = 0.06, n = 60 }\n'
        '[want]\nfigures = ["locus"]\n'
    )
    path = _archived(
        tmp_path, study, "slope [rad],stance_angle [rad]\n0.045,0.28\n0.045,0.22\n"
    )
    computed = measured.residuals(read_archive(path))["computed"].to_numpy()
    assert (
        computed[0] > 0.27 and computed[1] < 0.24
    )  # on either side of the fold at 0.053


def test_a_measurement_on_a_line_without_branches_is_not_compared_with_another_line(
    tmp_path,
):
    """Walker A detuned to the physical one does not walk on slopes as small as these."""
    study = (
        'name = "b"\nkind = "branch"\nwalker = "A"\n[axes]\nslope = { from = 0.0015, to = 0.003, n = 8 }\n'
        "detuning = [0.0, 1.0]\n"
    )
    measurements = (
        "slope [rad],detuning,stance_angle [rad]\n0.002,0.0,0.126\n0.002,1.0,0.126\n"
    )
    path = _archived(tmp_path, study, measurements)
    computed = measured.residuals(read_archive(path)).set_index("detuning")["computed"]
    assert computed[0.0] == pytest.approx(0.1256, rel=1e-3) and np.isnan(computed[1.0])


def test_measurements_of_walkers_that_differ_by_little_are_told_apart(tmp_path):
    study = (
        'name = "s"\nwalker = "E"\n[axes]\nslope = [0.001, 0.002]\nfoot_mass_ratio = [0.0, 1e-9, 2e-9]\n'
        '[want]\nvariables = ["stance_angle"]\n'
    )
    heading = "slope [rad],foot_mass_ratio,stance_angle [rad]\n"
    path = _archived(
        tmp_path,
        study,
        heading + "0.002,1e-9,0.126\n0.002,2e-9,0.127\n0.002,0.0,0.128\n",
    )
    left = measured.residuals(read_archive(path))
    assert left["foot_mass_ratio"].tolist() == [1e-9, 2e-9, 0.0]
    for ratio, computed in zip(left["foot_mass_ratio"], left["computed"], strict=True):
        gait = solved("E", 0.002, foot_mass_ratio=ratio)
        assert abs(computed - gait["stance_angle"]) < 1e-14


def test_rows_that_a_page_leaves_out_are_counted(monkeypatch):
    rows = pd.DataFrame({"task": ["trace"] * 130, "residual": np.zeros(130)})
    monkeypatch.setattr(measured, "residuals", lambda source: rows)
    assert html_tables.residuals(None)[0].note.endswith(
        "118 more rows are in the CSV file."
    )
    failed = html_tables.failed_tasks(
        SimpleNamespace(table=lambda name: {"failed_tasks": rows}.get(name))
    )
    assert len(failed.rows) == 12 and failed.note == "118 more rows are in the archive."
