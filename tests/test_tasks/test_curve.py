"""Curves in two parameters: against points located line by line, and where two branches re-pair."""

import itertools

import numpy as np
import pytest

from lines import _atlas
from tasks.curve import curve
from tasks.gait.curves import Curve, follow, turning
from tasks.walkers.parameters import WalkerError, resolve

LINE = {"walker": "C", "set": {}}
WINDOW = {"q": (-6.0, -1.0), "key": (0.6, 0.8)}
#: A fold of C on the way to the machine: similarity coordinates, ln slope, detuning; event times.
FOLD = np.array([-0.76050299, -1.55377883, -0.47724619, -2.05756334, 0.76301856])
TIMES = np.array([1.69557706, 2.31306058])


def test_branches_re_pair_where_the_curve_of_folds_turns():
    folds = Curve("fold", lambda value: resolve("C", {"detuning": value}), FOLD[-1], 1.0)
    key = np.append(np.zeros(4), 1.0)
    points = follow(folds, folds.correct(FOLD, TIMES, key), -1.0, WINDOW)
    found = [p for a, b in itertools.pairwise(points) if (p := turning(folds, a, b, -1)) is not None]
    assert len(found) == 1
    # Branches followed at 0.72 and 0.73 show the two pairings, and a fold at 0.0902 on the far side.
    assert found[0].U[-1] == pytest.approx(0.72386360373, abs=1e-9)
    assert np.exp(found[0].U[-2]) == pytest.approx(0.1001868636, abs=1e-9)
    assert all(p.ok for p in points)
    assert folds.walks(found[0])


def test_flips_agree_with_those_located_line_by_line():
    found = curve({"line": LINE, "slope": np.array([0.01, 0.2]), "key": "detuning", "from": -0.02, "to": 0.22,
                   "kinds": ["flip"]}, [_atlas("C", ())])
    near = np.argsort(np.abs(found["curves/value"] - 0.2))[:5]
    fit = np.polyfit(found["curves/value"][near] - 0.2, found["curves/slope"][near], 4)
    # Brent's method on the branch at detuning 0.2 (test function of the line alone).
    assert fit[-1] == pytest.approx(0.08056144479503541, abs=2e-8)
    assert found["curves/slope"][np.argmin(np.abs(found["curves/value"]))] == pytest.approx(0.0768533651, rel=2e-3)
    assert found["curves/walks"].all()
    # The slope of the flip is least a little off the tuned walker.
    assert found["turnings/turn"].tolist() == ["slope"]
    assert found["turnings/value"][0] == pytest.approx(0.053798, abs=1e-5)


def test_a_range_that_is_none_is_refused():
    with pytest.raises(WalkerError, match="must be less than"):
        curve({"line": LINE, "slope": np.array([0.1]), "from": 1.0, "to": 0.0}, [{}])
    with pytest.raises(WalkerError, match="not a walker key"):
        curve({"line": LINE, "slope": np.array([0.1]), "key": "l_x", "from": 0.0, "to": 1.0}, [{}])
