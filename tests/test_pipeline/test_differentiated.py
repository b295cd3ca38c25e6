"""The group `sensitivities` of archives: derivatives of measures by slope and keys."""

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.archive.verify import verify

SLOPES = [0.01, 0.02, 0.03]


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """The archive of a study of two slopes of C with derivatives, and its ranking."""
    path = tmp_path_factory.mktemp("differentiated") / "study.nc"
    wanted = {
        "variables": ["speed", "stance_angle", "period", "sensitivities"],
        "figures": ["sensitivities"],
    }
    study = {
        "name": "study",
        "walker": "C",
        "axes": {"slope": SLOPES},
        "want": wanted,
    }
    gaitsweep.run(study, jobs=1, archive=path, quiet=True)
    return path


def test_an_archive_has_the_derivatives_that_python_has(archive):
    study = gaitsweep.load(archive)
    assert study.speed_by_key.dims == ("slope", "gait", "key")
    assert not verify(archive)

    other = gaitsweep.sensitivities("C", SLOPES, variables=["speed", "period"])
    assert study.key.values.tolist() == other.key.values.tolist()
    assert study.key_units.values.tolist() == other.key_units.values.tolist()
    for name in ("speed", "period"):
        own = study[f"{name}_by_key"].values
        np.testing.assert_allclose(own, other[name].values[:, :2], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("key", "value", "step"),
    [
        ("w_t", -0.02288564296411127, 1e-6),
        ("m_h", 1e-5, 1e-5),
        ("R", 0.2, 1e-6),
        ("slope", 0.02, 1e-7),
    ],
)
def test_derivatives_are_those_of_gaits_beside(archive, key, value, step):
    speeds = []
    for beside in (value - step, value + step):
        at = {"slope": 0.02, key: beside}
        gaits = gaitsweep.gaits("C", variables=["speed"], **at)
        speeds.append(float(gaits.speed.sel(gait="long")))

    rate = (speeds[1] - speeds[0]) / (2 * step)
    study = gaitsweep.load(archive)
    own = study.speed_by_key.sel(slope=0.02, gait="long", key=key)
    assert float(own) == pytest.approx(rate, rel=2e-4)


def test_gaits_in_memory_have_them_too(archive):
    study = gaitsweep.load(archive)
    answer = gaitsweep.gaits("C", SLOPES, variables=["speed", "sensitivities"])
    assert "period_by_key" not in answer
    own = answer.speed_by_key.isel(gait=slice(2)).values
    # By other code, which rounds otherwise.
    np.testing.assert_allclose(own, study.speed_by_key.values, rtol=1e-7, atol=1e-9)


def test_keys_are_ranked_on_the_page(archive, tmp_path):
    """The paper, section 8: walkers depend hugely on the fore-aft distribution of mass."""
    page = gaitsweep.report(archive, tmp_path)
    text = page.read_text(encoding="utf-8")
    assert "Most of all on w_t: " in text and "for 0.5 mm in w_t." in text
    assert "measures of the long and short gaits of C change" in text
