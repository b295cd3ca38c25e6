"""Claims give located points, not the nodes beside them, and the same number with a
study and without.
"""

import functools
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.pipeline.graph.layers import line_params
from gaitsweep.pipeline.grid.method import Method
from gaitsweep.pipeline.study import parse
from gaitsweep.tasks.contract.registry import options
from gaitsweep.tasks.ledger import kneed_chaos
from gaitsweep.tasks.ledger.check_claims import claims
from gaitsweep.tasks.ledger.claim import CLAIMS
from gaitsweep.tasks.ledger.lines import Paper, paper_of
from gaitsweep.tasks.studies.solve_points import atlas
from gaitsweep.tasks.studies.trace_motion import trace

# The search for gaits lets lanes that go astray overflow.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")
PAPER = paper_of([], [])
STUDIES = Path(__file__).parents[2] / "data" / "studies" / "paper"
#: Slope and stance angle at which the released knee first moves against its stop.
POINT_3 = 0.021541606125377, 0.0193795


def gait_of_point_3():
    """The gait solved at point 3's slope, whatever the nodes of its branch."""
    found = PAPER.line("physical").at(
        [POINT_3[0]], ("stance_angle", "period", "kneestrike_time", "speed")
    )
    (k,) = np.flatnonzero(np.isclose(found["stance_angle"][0], POINT_3[1], rtol=1e-5))
    return {
        name: float(values[0, k])
        for name, values in found.items()
        if name != "slope" and values.ndim == 2
    }


def test_kneestrike_at_point_3_is_that_of_the_gait_solved_there():
    gait, found = gait_of_point_3(), CLAIMS["P8"].find(PAPER)
    # The slope has 14 digits.
    assert found.value == pytest.approx(
        gait["kneestrike_time"] / gait["period"], rel=1e-10
    )
    assert (
        found.computed
        == "from 42.17 % of the step at point 3 to 100.00 % at point 1, rising throughout"
    )


def test_the_slowest_gaits_are_those_of_points_3_and_4():
    found = CLAIMS["P7"].find(PAPER)
    assert (found.verdict, found.value) == (
        "reproduced",
        pytest.approx(gait_of_point_3()["speed"], rel=1e-10),
    )
    assert "at point 3, slope 0.02154161 rad, " in found.computed
    # The slope of vanishing steps as computed independently.
    assert "vanishes at point 4, slope 0.02110135 rad, " in found.computed
    assert "at slope 0.02110135 rad; point 3" in CLAIMS["P6"].find(PAPER).computed


def test_the_kneed_walker_is_stable_between_the_located_points_and_nowhere_else():
    bounds = [0.01912287969, 0.05303710636, 0.1637224804, 0.1987944555]
    found = PAPER.line("physical").stable()
    assert [p["slope"] for part in found for p in part] == pytest.approx(
        bounds, rel=1e-9
    )
    assert [p["kind"] for part in found for p in part] == [
        "fold",
        "fold",
        "fold",
        "flip",
    ]
    near = np.array([x * (1 + side * 1e-5) for x in bounds for side in (-1, 1)])
    radius = PAPER.line("physical").at(near, ("spectral_radius",))["spectral_radius"]
    assert (radius < 1).any(axis=1).tolist() == [
        False,
        True,
        True,
        False,
        False,
        True,
        True,
        False,
    ]
    said = CLAIMS["P2"].find(PAPER).computed
    assert (
        "kneed: stable from the fold at slope 0.01912288 rad to the fold at 0.05303711 rad and "
        in said
    )
    assert said.endswith(
        " from the fold at slope 0.1637225 rad to the flip at 0.1987945 rad"
    )


def test_a_change_of_stability_between_special_points_is_noticed(monkeypatch):
    kneed = PAPER.line("physical")
    known = [p for p in kneed.special if p["kind"] != "flip"]
    monkeypatch.setitem(kneed.__dict__, "special", known)
    with pytest.raises(ValueError, match="differ in stability"):
        kneed.stable()


def test_the_short_step_ends_at_small_detuning_where_the_foot_meets_the_ground_at_kneestrike():
    """Not as heelstrike becomes tangential: that is how long steps end."""
    gaits = PAPER.line("C", detuning=0.05)
    assert "slope of the end (rad), by detuning: 0.05: 0.00245, 0.2: 0.0088, " in (
        said := CLAIMS["T5"].find(PAPER).computed
    )
    assert (
        "; its stance angle (rad): 0.05: 0.01615, " in said
        and said.count("at kneestrike, at 95.7") == 1
    )
    (end,) = gaits.special_of("end_earlier_strike")
    assert gaits.curves[end["branch"]]["short"].all()
    slope = np.array([end["slope"] * (1 + end["error_bound"])])
    motion = trace(
        {**gaits.params, "slope": slope, "gaits": ("short",)}, [gaits.arrays]
    )
    height = motion["trace/theta_st"] + motion["trace/theta_th"]
    locked = np.flatnonzero(motion["trace/theta_th"] == motion["trace/theta_sh"])
    # Both phases hold the instant of kneestrike; whether the first ends with equal
    # angles, rounding decides.
    knee = np.flatnonzero(
        motion["trace/time"] == motion["trace/time"][locked[locked > 0][0]]
    )[-1]
    assert abs(height[knee]) < 1e-9 < height[knee + 1 : -1].min()
    share = motion["trace/time"][knee] / motion["trace/time"][-1]
    assert f"{100 * share:.2f} %" in said


def test_claims_do_not_depend_on_the_nodes_of_the_branches():
    """Coarse branches have other nodes, too few to extrapolate the slope of vanishing
    steps, point 4.
    """
    names = ("physical", "physical-straight")
    lines = [{"walker": name, "set": {}} for name in names]
    ids = ["P2", "P4", "P7", "P8"]
    tables = [
        claims(
            {"lines": lines, "ids": ids},
            [atlas({"line": each, "coarse": coarse}, []) for each in lines],
        )
        for coarse in (False, True)
    ]
    given = [atlas({"line": each, "coarse": True}, []) for each in lines]
    assert len(paper_of(lines, given).line("physical").branches[0].Z) < 200
    fine, coarse = (
        [said.partition(" at point 4")[0] for said in table["claims/computed"]]
        for table in tables
    )
    assert fine == coarse
    np.testing.assert_allclose(
        tables[0]["claims/value"], tables[1]["claims/value"], rtol=1e-9
    )


def test_what_claims_compute_themselves_is_what_their_studies_compute(monkeypatch):
    asked = []

    def record(kind):
        def task(params, _):
            asked.append((kind, params))
            raise LookupError

        return task

    for kind, name in (
        ("cascade", "cascade"),
        ("curve", "curve"),
        ("census", "census"),
    ):
        monkeypatch.setattr(kneed_chaos, name, record(kind))
    paper = Paper({})
    finders = [
        *(
            functools.partial(kneed_chaos.crisis, walker=name, family="1")
            for name in ("C", "C-printed", "D")
        ),
        kneed_chaos.re_pairing,
        kneed_chaos.never_more,
    ]
    for find in finders:
        with pytest.raises(LookupError):
            find(paper)
    studies = [
        parse.read(STUDIES / f"{name}.toml")
        for name in ("cascade-kneed", "cascade", "touching-branches", "census")
    ]
    wanted = [
        (s.kind, line_params(s, Method.TASK, s.kind, s.line(i)))
        for s in studies
        for i in range(s.lines)
    ][: len(asked)]
    assert [kind for kind, _ in asked] == ["cascade"] * 3 + ["curve", "census"]
    for (kind, params), (study_kind, others) in zip(asked, wanted, strict=True):
        assert kind == study_kind and params["line"] == others["line"]
        np.testing.assert_array_equal(params["slope"], others["slope"])
        both = [
            {k: np.array(v).tolist() for k, v in options(kind, each).items()}
            for each in (params, others)
        ]
        assert both[0] == both[1]
