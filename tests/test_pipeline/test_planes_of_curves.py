"""Curves over two keys at fixed slopes: `plane` of kind `curve`."""

import numpy as np
import pytest

import gaitsweep
from gaitsweep import StudyError
from gaitsweep.pipeline.archive.verify import verify

STUDY = {
    "name": "plane",
    "kind": "curve",
    "walker": "A",
    "axes": {"slope": [0.02]},
    "options": {
        "plane": {"R": [0.05, 0.3], "m_h": [0.0, 2.0]},
        "kinds": ["fold"],
        "levels": {"froude_speed": 0.2, "spectral_radius": 1.0},
    },
    "want": {"figures": ["curves"]},
}


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """The archive of curves of A over the radius of its feet and the mass at its hip."""
    path = tmp_path_factory.mktemp("plane") / "plane.nc"
    gaitsweep.run(STUDY, jobs=1, archive=path, quiet=True)
    return path


@pytest.fixture(scope="module")
def curves(archive):
    return gaitsweep.load(archive, "curves")


def test_curves_lead_from_border_to_border_of_the_plane(archive, curves):
    assert not verify(archive)
    assert (curves["key"] == "R").all() and (curves["other_key"] == "m_h").all()
    assert curves.attrs["units"]["other_value"] == "kg"

    speeds = curves[curves["kind"] == "froude_speed = 0.2"]
    assert speeds["curve"].nunique() == 2  # of long and of short gaits
    for _, curve in speeds.groupby("curve"):
        assert curve["other_value"].iloc[[0, -1]].tolist() == [0.0, 2.0]
        assert curve["stopped"].iloc[[0, -1]].tolist() == ["border", "border"]


def test_gaits_of_a_curve_have_the_value_by_single_solves(curves):
    speeds = curves[curves["kind"] == "froude_speed = 0.2"]
    for _, row in speeds.iloc[::7].iterrows():
        keys = {"R": row["value"], "m_h": row["other_value"]}
        gaits = gaitsweep.gaits("A", 0.02, **keys, variables=["froude_speed"])
        nearest = np.nanmin(np.abs(gaits.froude_speed.values - 0.2))
        assert nearest < 1e-11


def test_a_fold_of_a_plane_is_a_fold_of_its_line(curves, tmp_path):
    folds = curves[curves["kind"] == "fold"]
    row = folds.iloc[len(folds) // 2]
    walker = {"base": "A", "R": float(row["value"]), "m_h": float(row["other_value"])}
    study = {
        "name": "line",
        "kind": "branch",
        "walker": walker,
        "axes": {"slope": {"from": 0.01, "to": 0.04, "n": 3}},
    }
    line = tmp_path / "line.nc"
    gaitsweep.run(study, jobs=1, archive=line, quiet=True)

    points = gaitsweep.load(line, "special_points")
    slopes = points[points["kind"] == "fold"]["slope"]
    assert np.abs(slopes / 0.02 - 1).min() < 1e-10

    # At a fold a multiplier is one, so its curve is that of a radius of one.
    radius = curves[curves["kind"] == "spectral_radius = 1"]
    for column in ("value", "other_value"):
        ends = radius[column].iloc[[0, -1]].to_numpy()
        np.testing.assert_allclose(folds[column].iloc[[0, -1]], ends, rtol=1e-9)


def test_curves_on_which_both_conditions_hold_meet_nowhere(archive):
    """Rounding alone would tell where folds meet points of a spectral radius of 1."""
    assert gaitsweep.load(archive, "meetings").empty


def test_the_page_has_the_plane(archive, tmp_path):
    text = gaitsweep.report(archive, tmp_path).read_text(encoding="utf-8")
    assert "over m_h at slope 0.02 rad and R" in text


@pytest.mark.parametrize(
    ("options", "axes", "sentence"),
    [
        (
            {"plane": {"R": [0.1, 0.2]}},
            {},
            "`plane` must be a table of the ranges of two keys; got ",
        ),
        (
            {"plane": {"R": [0.1, 0.2], "m_h": [1.0, 0.0]}},
            {},
            "`m_h` must be two increasing numbers; got [1.0, 0.0]",
        ),
        (
            {"plane": {"R": [0.1, 0.2], "mh": [0.0, 1.0]}},
            {},
            "Unknown key `mh`, did you mean `m_h`?",
        ),
        (
            {"plane": {"R": [0.1, 0.2], "m_h": [0.0, 1.0]}, "key": "l_t"},
            {},
            "`key` is of curves over the slope and a key, and `plane` is set",
        ),
        (
            {"plane": {"R": [0.1, 0.2], "m_h": [0.0, 1.0]}},
            {"R": [0.1, 0.2]},
            "`R` is a key of `plane`, and can be no axis",
        ),
        (
            {
                "plane": {"R": [0.1, 0.2], "m_h": [0.0, 1.0]},
                "levels": {"kneestrike_time": 0.1},
            },
            {},
            "`levels` must be a measure of its gaits: stance_angle, ",
        ),
        (
            {"plane": {"R": [0.1, 0.2], "m_h": [-1.0, 1.0]}},
            {},
            "R = 0.1, m_h = -1.0 leave no walker: `m_h`",
        ),
    ],
)
def test_planes_that_cannot_be_are_refused_in_a_line(options, axes, sentence, tmp_path):
    study = {
        **STUDY,
        "axes": {"slope": [0.02], **axes},
        "options": options,
    }
    with pytest.raises(StudyError) as refused:
        gaitsweep.run(study, archive=tmp_path / "s.nc", quiet=True)
    assert str(refused.value).startswith(sentence)
