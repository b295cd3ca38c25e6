"""Tolerances of keys: what a study may say of them, and what follows for gaits."""

import itertools
import re

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.report.figures import FIGURES
from gaitsweep.pipeline.report.source import read

SLOPES = [0.01, 0.02]
#: Of B, by which its gaits change most.
KEYS = {"R": 0.2, "m_s": 0.1}


def _study(tolerances, **others):
    return {
        "name": "study",
        "walker": "C",
        "axes": {"slope": SLOPES},
        "want": {"variables": ["stance_angle", "multipliers", "sensitivities"]},
        "figures": {"tolerances": tolerances},
        **others,
    }


@pytest.mark.parametrize(
    ("tolerances", "others", "error"),
    [
        ({"w_x": 1e-3}, {}, "Unknown key `w_x`, did you mean `w_"),
        ({"detuning": 0.1}, {}, "Unknown key `detuning`, known: slope, l_t, w_t"),
        ({"w_t": -1e-3}, {}, "`w_t` must be a number above 0, or a percentage"),
        ({"w_t": 0}, {}, "`w_t` must be a number above 0"),
        ({"w_t": "1 mm"}, {}, "or a percentage, as \"1%\"; got '1 mm'"),
        ({"w_t": "0%"}, {}, "`w_t` must be a number above 0"),
        ({"w_t": True}, {}, "`w_t` must be a number"),
        ({"w_t": float("nan")}, {}, "`w_t` must be finite"),
        ([1e-3], {}, "`tolerances` must be a table of tolerances"),
        ({"m_h": "1%"}, {}, "`m_h` = '1%' is a percentage of 0: give a number"),
        (
            {"m_h": "1%"},
            {"axes": {"slope": SLOPES, "m_h": [-0.1, 0.0, 0.1][1:]}},
            "is a percentage of 0",
        ),
        ({"push_off": 0.1}, {}, "No walker of this study has a `push_off`"),
        ({"w_t": 1e-3}, {"want": {}}, "add `sensitivities` to the `variables`"),
        (
            {"w_t": 1e-3},
            {"kind": "branch", "want": {}},
            "add `sensitivities = true` to `[options]`",
        ),
        (
            {"slope": 1e-3},
            {"kind": "branch", "want": {}, "options": {"sensitivities": True}},
            "Special points have slopes",
        ),
        (
            {"w_t": 1e-3},
            {"kind": "census", "want": {}},
            "this study is a `census`",
        ),
    ],
)
def test_a_tolerance_that_makes_no_sense_is_named(tmp_path, tolerances, others, error):
    study = _study(tolerances, **others)

    with pytest.raises(StudyError, match=re.escape(error)):
        gaitsweep.run(study, jobs=1, archive=tmp_path / "study.nc", quiet=True)


@pytest.mark.parametrize("share", [1e-2, 1e-3])
def test_a_band_is_that_of_gaits_solved_with_keys_off_to_first_order(tmp_path, share):
    off = {key: share * abs(value) for key, value in KEYS.items()}
    given = {"R": off["R"], "m_s": f"{100 * share:g}%"}
    archive = tmp_path / "study.nc"
    study = _study(given, walker="B")
    gaitsweep.run(study, jobs=1, archive=archive, quiet=True)

    data = FIGURES["linear"](read(archive)).data
    own = data[data["gait"] == "long"].sort_values("slope")
    signs = np.array(list(itertools.product((-1, 1), repeat=2)))
    corners = {
        key: (value + signs[:, k] * off[key])[:, None]
        for k, (key, value) in enumerate(KEYS.items())
    }
    beside = gaitsweep.gaits("B", SLOPES, **corners, variables=["stance_angle"])
    angles = beside.stance_angle.sel(gait="long").values
    farthest = np.abs(angles - own["stance_angle"].to_numpy()).max(axis=0)

    ratio = farthest / own["stance_angle_half_width"].to_numpy()
    np.testing.assert_allclose(ratio, 1, atol=3 * share)
