"""Studies of level ground, from TOML to page."""

import json
import re

import numpy as np
import pytest
import xarray as xr

import gaitsweep
from conftest import ROOT
from gaitsweep import gaits, solve
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study.parse import read
from gaitsweep.tasks.contract.registry import VIOLATIONS

LEVEL = """
name = "level"
walker = "B"
[axes]
slope = [-0.001, 0.0, 0.01]
push_off = [0.05, 0.1, 0.2]
[want]
variables = ["stance_angle", "period", "cost_of_transport", "multipliers", "energy", "violations"]
figures = ["over_key"]
"""


@pytest.fixture(scope="module")
def level(tmp_path_factory):
    folder = tmp_path_factory.mktemp("level")
    (folder / "level.toml").write_text(LEVEL)
    archive = folder / "level.nc"
    assert gaitsweep.run(folder / "level.toml", archive=archive) is not None
    return archive


def test_an_archive_of_level_ground_holds_single_solves(level):
    with xr.open_dataset(level, decode_times=False) as ds:
        ds = ds.load()
    assert (
        np.abs(ds["energy_imbalance"].values[ds["status"].values == 0]) < 1e-12
    ).all()
    for slope, push in ((0.0, 0.1), (-0.001, 0.2), (0.01, 0.05)):
        point = ds.sel(slope=slope, push_off=push)
        found = solve("B", slope, push_off=push)
        stored = point["stance_angle"].values[: len(found)]
        # By other code, which rounds otherwise.
        np.testing.assert_allclose(stored, found["stance_angle"], rtol=1e-12)
        single = found["push_off_work"]
        np.testing.assert_allclose(point["push_off_work"].values[: len(found)], single)


def test_bits_of_violations_are_named_up_to_those_of_the_push_off(level):
    with xr.open_dataset(level) as ds:
        attributes = ds["violations"].attrs
    names = attributes["flag_meanings"].split()
    assert names == [*VIOLATIONS]
    assert attributes["flag_masks"].tolist() == [1 << bit for bit in range(len(names))]


def test_a_page_of_level_ground_draws_and_starts_its_gaits(level, tmp_path):
    gaitsweep.report(level, tmp_path)
    page = (tmp_path / "level.html").read_text()
    assert "Gaits over push_off" in page
    lines = json.loads(re.search(r'id="lines">(.*?)</script>', page, re.S)[1])
    assert {line["keys"]["push_off"] for line in lines} == {0.05, 0.1, 0.2}
    assert len(lines[0]["keys"]["violation_limits"]) == 10


def test_arrays_of_what_nothing_drives_say_what_would():
    found = gaits("D", [0.0, 0.01], variables=["period"])
    said = found["reason_text"].values.astype(str)[int(found["reason"][0, 0])]
    assert "a walker needs a `push_off` or a `hip_torque`" in said
    with pytest.raises(StudyError, match="a walker needs a `push_off` or a `hip_torq"):
        gaits("D", 0.0)


def test_arrays_of_level_ground_are_the_studys():
    found = gaits("B", 0.0, push_off=[0.05, 0.1], variables=["stance_angle"])
    single = [solve("B", 0.0, push_off=push)["stance_angle"][0] for push in (0.05, 0.1)]
    np.testing.assert_array_equal(found["stance_angle"].sel(gait="long"), single)


def test_each_point_has_the_sentence_of_its_own_slope():
    found = gaits("D", [-0.005, 0.01], push_off=0.0005, variables=["period"])
    uphill, down = found["reason"].sel(gait="long").values.tolist()
    sentences = found["reason_text"].values.astype(str).tolist()
    assert "at this push_off" in sentences[uphill]
    assert sentences[down].startswith("Converged")


def test_a_spring_that_rests_at_an_angle_drives_as_a_torque():
    spring = {"hip_stiffness": 0.01, "hip_rest": 0.1}
    torque = {"hip_stiffness": 0.01, "hip_torque": 0.001}
    by_spring, by_torque = (
        solve("B", 0.0, **keys)["stance_angle"][0] for keys in (spring, torque)
    )
    assert by_spring == pytest.approx(by_torque, rel=1e-13)


def test_a_study_has_the_variables_of_what_any_of_its_lines_has(tmp_path):
    path = tmp_path / "s.toml"
    text = 'name = "s"\nwalker = "B"\n[axes]\nslope = [0.01]\n'
    path.write_text(text + "hip_stiffness = [-0.01, 0.0]\n")
    assert "hip_torque_work" in read(path).variables


def test_gravity_scales_no_driven_walker():
    """Stiffness and impulses do not scale with g: these walkers are not one."""
    slopes, keys = [0.01], {"hip_stiffness": 0.05}
    for g in (1.0, 2.0):
        one = solve("B", 0.01, g=g, **keys)["stance_angle"][0]
        many = gaits("B", slopes, g=[[1.0], [2.0]], variables=["stance_angle"], **keys)
        of_g = many["stance_angle"].values[int(g) - 1, 0, 0]
        assert of_g == pytest.approx(one, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("push_off = [0.05, 0.1, 0.2]", ""),
        ("R = [0.1, 0.2]", "for passive walkers; got -0.001"),
        ("push_off = [-0.1, 0.2]", "`push_off` must be >= 0"),
    ],
)
def test_a_study_that_nothing_drives_is_refused(text, said, tmp_path):
    study = LEVEL.replace("push_off = [0.05, 0.1, 0.2]", text)
    path = tmp_path / "s.toml"
    path.write_text(study)
    if not said:
        read(path)
        return
    with pytest.raises(StudyError, match=re.escape(said)):
        read(path)


def test_a_study_finds_the_push_off_of_a_speed(tmp_path):
    study = {
        "name": "speeds",
        "walker": "D",
        "at": {"froude_speed": [0.15, 0.2], "vary": "push_off"},
        "axes": {"slope": [0.0]},
    }
    found = gaitsweep.run(study, jobs=1, archive=tmp_path / "s.nc", quiet=True)

    assert (found.status == "converged").all()
    for value in (0.15, 0.2):
        for gait in ("long", "short"):
            one = found.sel(slope=0.0, froude_speed=value, gait=gait)
            other = solve("D", 0.0, push_off=float(one.push_off))
            other = other.set_index("gait").loc[gait]
            assert other["froude_speed"] == pytest.approx(value, rel=1e-12)
            assert float(one.error_bound) < 1e-12


def test_a_study_at_values_on_level_ground_needs_a_drive(tmp_path):
    path = tmp_path / "s.toml"
    text = 'name = "s"\nwalker = "B"\nat = { speed = 0.2, vary = "m_h" }\n'
    path.write_text(text + "[axes]\nslope = [0.0]\n")
    with pytest.raises(StudyError, match="for passive walkers; got 0"):
        read(path)
    with pytest.raises(StudyError, match="needs a `push_off` or a `hip_torque`"):
        solve("B", 0.0, at={"speed": 0.2}, vary="m_h")


MEASURED = """slope [rad],push_off,period,gait
0.0,0.1,3.0,long
-0.001,0.2,3.0,
0.0,0.0,3.0,
-0.6,0.1,3.0,
"""


@pytest.mark.thorough
def test_measurements_on_level_ground_have_residuals(tmp_path):
    (tmp_path / "m.csv").write_text(MEASURED)
    path = tmp_path / "m.toml"
    path.write_text(LEVEL + '[figures.overlay]\nfile = "m.csv"\n')
    archive = tmp_path / "m.nc"
    gaitsweep.run(path, jobs=1, archive=archive, quiet=True)

    with xr.open_dataset(archive, group="measured_gaits") as rows:
        period, reason = rows["period"].values, rows["reason"].values.astype(str)
        error = rows["period_error"].values
    single = solve("B", 0.0, push_off=0.1).set_index("gait").loc["long"]
    assert period[0] == pytest.approx(single["period"], rel=1e-13)
    assert (error[:2] < 1e-12).all()
    assert "nothing drives the walker there" in reason[2]
    assert reason[3].startswith("`slope` must lie in [1e-18, 0.5) rad, or in (-0.5, 0]")


def test_a_study_of_curves_over_the_push_off_is_read(tmp_path):
    """It is refused without a key that drives."""
    path = tmp_path / "s.toml"
    text = 'name = "s"\nkind = "curve"\nwalker = "D"\n[axes]\nslope = [0.0]\n'
    plane = "[options]\nplane = { push_off = [0.1, 0.2], R = [0.0, 0.2] }\n"
    path.write_text(text + plane)
    assert [*read(path).options["plane"]["push_off"]] == [0.1, 0.2]
    path.write_text(text + plane.replace("push_off", "m_h"))
    with pytest.raises(StudyError, match="for passive walkers; got 0"):
        read(path)


def test_a_study_of_branches_on_level_ground_is_over_what_drives(tmp_path):
    path = tmp_path / "s.toml"
    text = 'name = "s"\nkind = "branch"\n[walker]\nbase = "B"\npush_off = 0.1\n'
    path.write_text(text + "[axes]\nslope = [-0.01, 0.01]\n")
    with pytest.raises(StudyError, match="give an axis `push_off` or `hip_torque`"):
        read(path)


@pytest.mark.thorough
def test_archives_differentiate_by_what_drives(tmp_path):
    """The dimension `key` names what drives where any walker has it; the derivatives are
    those of differences between gaits.
    """
    hip = {"hip_stiffness": 0.05, "hip_rest": 0.1, "hip_torque": 0.002}
    study = {
        "name": "keys",
        "walker": {"base": "B", **hip},
        "gaits": ["long"],
        "axes": {"slope": [0.0, 0.01]},
        "want": {"variables": ["stance_angle", "sensitivities"]},
    }
    found = gaitsweep.run(study, jobs=1, archive=tmp_path / "k.nc", quiet=True)
    by_key = found["stance_angle_by_key"].sel(gait="long")
    assert np.isnan(by_key.sel(key=["push_off", "hip_damping"])).all()
    single = gaitsweep.sensitivities(
        "B", [0.0, 0.01], variables=["stance_angle"], **hip
    )
    for key in ("slope", "R", *hip):
        own = single["stance_angle"].sel(gait="long", key=key)
        np.testing.assert_allclose(by_key.sel(key=key), own, rtol=1e-9)

    ends = hip["hip_rest"] * np.array([1 - 1e-4, 1 + 1e-4])
    angles = [
        solve("B", 0.0, **hip | {"hip_rest": end})["stance_angle"][0] for end in ends
    ]
    difference = np.diff(angles) / np.diff(ends)
    assert float(by_key.sel(slope=0.0, key="hip_rest")) == pytest.approx(
        difference[0], rel=1e-6
    )
    units = found["key_units"].values[list(found["key"].values).index("hip_rest")]
    assert units == "rad"


@pytest.mark.thorough
def test_archives_of_passive_walkers_differentiate_by_no_drive():
    passive = gaits("D", 0.01, variables=["sensitivities"])
    assert "push_off" not in passive["key"]


def test_archives_differentiate_by_a_push_off(tmp_path):
    study = {
        "name": "pushes",
        "walker": "D",
        "gaits": ["long"],
        "axes": {"slope": [0.0], "push_off": [0.0, 0.1]},
        "want": {"variables": ["stance_angle", "sensitivities"]},
    }
    found = gaitsweep.run(study, jobs=1, archive=tmp_path / "p.nc", quiet=True)
    by_push = found["stance_angle_by_key"].sel(slope=0.0, gait="long", key="push_off")
    ends = 0.1 + np.array([-1e-5, 1e-5])
    angles = [solve("D", 0.0, push_off=end)["stance_angle"][0] for end in ends]
    assert np.isnan(by_push[0])
    assert float(by_push[1]) == pytest.approx(np.ptp(angles) / 2e-5, rel=1e-8)


def test_a_page_tells_by_which_law_a_push_off_gives_step_lengths(tmp_path):
    """Short steps of the simplest walker lengthen with the root of the push-off."""
    study = {
        "name": "lengths",
        "walker": "D",
        "gaits": ["long"],
        "at": {"step_length": [0.001, 0.0011, 0.0012], "vary": "push_off"},
        "axes": {"slope": [0.0]},
        "want": {"variables": ["cost_of_transport"], "figures": ["sought"]},
    }
    archive = tmp_path / "l.nc"
    gaitsweep.run(study, jobs=1, archive=archive, quiet=True)
    gaitsweep.report(archive, tmp_path)
    page = (tmp_path / "lengths.html").read_text()
    assert "as the power 2 of the step length." in page
    assert "--at step_length=0.001 --vary push_off --slope 0.0" in page
    figure = gaitsweep.figure(archive, "sought")
    assert "step length" in {axes.get_xlabel() for axes in figure.axes}

    del study["at"]
    with pytest.raises(StudyError, match="`sought` is of gaits at values of a measure"):
        gaitsweep.run(study, archive=tmp_path / "m.nc", quiet=True)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "name",
    [
        "level-ground",
        "pushing-off",
        "cheapest-on-level-ground",
        "census-on-level-ground",
        "mass-on-level-ground",
    ],
)
def test_the_studies_of_level_ground_run_and_are_shown(name, tmp_path):
    example = ROOT / "data" / "studies" / "examples" / f"{name}.toml"
    archive = tmp_path / f"{name}.nc"

    assert gaitsweep.run(example, archive=archive, quiet=True) is not None
    gaitsweep.report(archive, tmp_path)

    page = (tmp_path / f"{name}.html").read_text()
    assert "is missing" not in page
    assert page.count("<figure") >= 1
