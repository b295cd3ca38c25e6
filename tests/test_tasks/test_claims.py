"""The ledger: every claim once, verdicts by one rule, and the numbers PHYSICS pins
down.
"""

import json
import re
import tomllib
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest

from gaitsweep import solve
from gaitsweep.tasks.contract.registry import TASKS
from gaitsweep.tasks.ledger import claim as rule
from gaitsweep.tasks.ledger import kneed_chaos, lines, zero_slope
from gaitsweep.tasks.ledger.check_claims import check, claims
from gaitsweep.tasks.ledger.claim import CLAIMS, VERDICTS, Claim, ClaimResult
from gaitsweep.tasks.ledger.lines import paper_of
from gaitsweep.tasks.ledger.rounding_intervals import (
    HALF_UNITS,
    LANDMARKS,
    changed,
    interval,
    place,
    sensitivities,
)
from gaitsweep.tasks.ledger.zero_slope import mass_limit
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.statics import is_tuned

ROOT = Path(__file__).parents[2]
PAPER = paper_of([], [])
# The search for gaits lets lanes that go astray overflow.
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")

IDS = {
    *(f"D{i}" for i in range(1, 11)),
    *(f"E{i}" for i in range(1, 8)),
    *(f"P{i}" for i in range(1, 9)),
    *(f"T{i}" for i in range(1, 9)),
    *(f"Z{i}" for i in range(1, 7)),
    *(f"M{i}" for i in range(1, 8)),
    "K1",
    "K2",
    "K3",
    "W1",
    "G1",
    "G2",
    *(f"A{i}" for i in range(1, 7)),
    "L1",
    "L2",
}


def test_every_claim_is_entered():
    assert set(CLAIMS) == IDS
    for name, claim in CLAIMS.items():
        assert claim.id == name
        assert claim.printed
        assert claim.source


def test_the_paper_studies_want_every_claim_exactly_once():
    wanted = []
    for path in sorted((ROOT / "data" / "studies" / "paper").glob("*.toml")):
        wanted += tomllib.loads(path.read_text()).get("want", {}).get("claims", [])
    assert sorted(w for w in wanted if w in IDS) == sorted(IDS)


def test_claims_read_the_atlases_of_their_lines():
    assert set(TASKS["claims"].needs) == {"points", "atlas"}


def test_a_claim_is_entered_once_only():
    with pytest.raises(ValueError, match="entered twice"):
        rule.claim("D2")(lambda: ClaimResult("", "reproduced"))


def test_verdicts_follow_from_intervals():
    printed = rule.Printed(0.02, 5e-4)
    assert printed.compare(0.0197, 0.018, 0.0199) == "reproduced"
    assert printed.compare(0.0191, 0.018, 0.0202) == "consistent within rounding"
    assert printed.compare(0.0191, 0.018, 0.0199) == "not reproduced"
    assert printed.compare(0.0191) == "not reproduced"
    assert rule.verdict(False, True) == "approximate"
    assert rule.PRINTED["D2"] == (0.015, 5e-4)
    assert rule.PRINTED["D2"].compare(0.0150884) == "reproduced"
    assert rule.PRINTED["D2"].compare(0.0156) == "not reproduced"
    assert rule.NOT_PRINTED.compare(0.0156) == "not reproduced"
    with pytest.raises(ValueError, match="no verdict"):
        ClaimResult("", "perhaps")


def test_the_sentence_of_a_claim_formats_lists_and_names_value_by_value(monkeypatch):
    monkeypatch.setattr(
        rule,
        "TEXTS",
        {"Q1": {"printed": "", "quotation": "", "source": "", "figure": ""}},
    )
    monkeypatch.setitem(
        rule._SAID,
        "Q1",
        "{value:.1f} of {low:g}-{high:g}: {each:.2g}; {named:.3f}; {named[B][1]:g}",
    )
    monkeypatch.setitem(rule.PRINTED, "Q1", rule.NOT_PRINTED)
    monkeypatch.setattr(rule, "CLAIMS", {})
    named = {"A": 0.5, "B": [1.0, 2.0]}
    rule.claim("Q1")(
        lambda paper: rule.found(
            "reproduced", np.float64(1), 0.5, 2.0, each=np.ones(2) / 3, named=named
        )
    )
    result = rule.CLAIMS["Q1"].find(PAPER)
    assert result == ClaimResult(
        "1.0 of 0.5-2: 0.33, 0.33; A 0.500, B 1.000, 2.000; 2",
        "reproduced",
        1.0,
        0.5,
        2.0,
    )
    assert type(result.value) is float


#: A constant of this module, which a sentence names.
STEEPEST = 3e-8


def test_the_sentence_of_a_claim_says_the_constants_of_its_module(monkeypatch):
    """They stood in the sentence as well, and could differ from those that were used."""
    monkeypatch.setattr(
        rule,
        "TEXTS",
        {"Q1": {"printed": "", "quotation": "", "source": "", "figure": ""}},
    )
    monkeypatch.setitem(
        rule._SAID, "Q1", "up to {STEEPEST:plain}, beyond {GRID[1]:plain}"
    )
    monkeypatch.setitem(rule.PRINTED, "Q1", rule.NOT_PRINTED)
    monkeypatch.setattr(rule, "CLAIMS", {})
    rule.claim("Q1")(lambda paper: rule.found("reproduced"))
    assert rule.CLAIMS["Q1"].find(PAPER).computed == "up to 3e-8, beyond 0.2"


NUMBER = r"-?\d[\d.]*(?:e-?\d+)?"


def kept_ledger():
    """The claims as they are computed, which another test compares."""
    path = ROOT / "data" / "reference" / "ledger.json"
    return json.loads(path.read_text(encoding="utf-8"))


def digits_of(number):
    """Number of significant digits of a number in words."""
    return len(number.partition("e")[0].replace(".", "").strip("-0"))


def test_numbers_of_the_ledgers_sentences_have_few_digits():
    for claim in kept_ledger():
        # What is proved has all the digits that are.
        said = claim["computed"].partition("; proved: ")[0]
        for number in re.findall(NUMBER, f"{said} {claim['interval']}"):
            assert digits_of(number) <= 9, (claim["id"], number)


def test_slopes_of_the_ledgers_sentences_have_a_unit():
    slopes = re.compile(rf"\bslopes? (?:from )?{NUMBER}(?:(?:,| to| and) {NUMBER})*")
    for claim in kept_ledger():
        said = claim["computed"].partition("; proved: ")[0]
        for found in slopes.finditer(said):
            assert said[found.end() :].startswith(" rad"), (claim["id"], found[0])


def test_an_interval_has_as_many_digits_as_its_width_tells():
    allowed = [claim for claim in kept_ledger() if claim["interval"]]
    assert len(allowed) > 5
    for claim in allowed:
        ends = np.array(claim["interval"].split(" to "), float)
        exact = np.array([claim["interval_low"], claim["interval_high"]])
        assert abs(ends - exact).max() < 1e-2 * np.ptp(exact)
        assert max(map(digits_of, claim["interval"].split(" to "))) <= 5


def test_no_sentence_repeats_a_constant():
    said = rule._SAID
    assert not [
        id
        for id, sentence in said.items()
        if "1e-09" in sentence or "1e-8 to" in sentence
    ]
    assert (
        "{VANISHING:plain}" in said["M3"]
        and "{GRID[0]:plain}" in said["D1"]
        and "{TOLERANCE:g}" in said["Z6"]
    )


def test_an_unknown_claim_is_named():
    with pytest.raises(ValueError, match="no claim X9"):
        claims({"lines": [], "ids": ["D2", "X9"]}, [])


def test_a_claim_whose_gaits_are_lost_is_not_checkable(monkeypatch):
    def lost(paper):
        raise ValueError("no such gait")

    monkeypatch.setitem(
        CLAIMS, "Q1", Claim("Q1", "a thing", "A thing.", "nowhere", "", lost)
    )
    table = claims({"lines": [], "ids": ["Q1"]}, [])
    assert table["claims/verdict"][0] == "not checkable"
    assert "no such gait" in table["claims/computed"][0]


def test_half_units_are_those_of_the_reference():
    reference = tomllib.loads(
        (ROOT / "data" / "reference" / "published.toml").read_text()
    )["parameters"]
    for name in ("physical", "physical-straight", "A-printed", "C-printed"):
        assert HALF_UNITS[name] == {
            k: v for k, v in reference[name]["half_unit"].items() if v
        }


def test_exact_walkers_stay_tuned_as_their_keys_move():
    for key in HALF_UNITS["C"]:
        assert is_tuned(changed("C", CATALOGUE["C"], {key: 1e-3}))


@pytest.mark.parametrize(
    ("name", "verdict", "value", "tolerance"),
    [
        ("D2", "reproduced", 0.015088437941119463, 1e-12),
        ("D6", "reproduced", 4.0, 1e-4),
        ("D4", "reproduced", -1.0, 1e-5),
        ("E2", "reproduced", 1 / 3, 1e-6),
        ("E5", "approximate", 1.0677, 1e-4),
        ("Z3", "approximate", 0.54, 0.01),
        ("M1", "reproduced", 1.0, 1e-9),
    ],
)
def test_straight_legged_claims(name, verdict, value, tolerance):
    found = CLAIMS[name].find(PAPER)
    assert (found.verdict, found.value) == (
        verdict,
        pytest.approx(value, abs=tolerance),
    )


def test_transition_of_light_feet():
    found = CLAIMS["E4"].find(PAPER)
    assert found.verdict == "approximate"
    assert 2.83 < found.value < 3.69
    assert "3.691" in found.computed
    assert "1.500" in found.computed


def test_light_feet_alone_are_stable_at_vanishing_slope():
    # As the slope vanishes: 0.0950 of the total mass.
    assert mass_limit(PAPER) == pytest.approx(0.0950, abs=5e-5)


def test_a_step_that_newton_loses_is_no_limit_of_stability(monkeypatch):
    """Whatever Newton's method ended with counted as the long step."""

    def lost(problem, guess, log_slope):
        return guess, np.zeros(guess.shape[1], bool)

    monkeypatch.setattr(zero_slope, "newton", lost)
    forgotten = {
        key: value
        for key, value in PAPER.memory.items()
        if key[0].__name__ != "mass_limit"
    }
    monkeypatch.setattr(PAPER, "memory", forgotten)

    with pytest.raises(
        ArithmeticError, match="does not converge at a foot mass ratio of 0.0995"
    ):
        mass_limit(PAPER)


@pytest.mark.parametrize(
    ("name", "slope", "angle", "tolerance"),
    [
        ("smallest slope, kneed", 0.0191, None, 5e-5),
        ("smallest slope, straight", 0.0154, None, 5e-5),
        ("point 1", 0.0364, 0.1488, 5e-5),
        ("point 2", 0.0561, 0.2365, 5e-5),
        ("point 3", 0.02154, 0.0194, 5e-5),
        ("C exponent 2/3", 1.523e-4, None, 5e-8),
        ("C release, long", 2.2077e-4, None, 5e-9),
        ("C release, short", 0.0079745, None, 5e-8),
        ("C flip", 0.0769, None, 5e-5),
        ("C-printed flip", 0.0786, None, 5e-5),
    ],
)
def test_landmarks_are_where_they_were_computed_before(name, slope, angle, tolerance):
    found = interval(PAPER, name)
    assert found.value == pytest.approx(slope, abs=tolerance)
    assert angle is None or found.angle == pytest.approx(angle, abs=5e-5)
    assert found.low < found.value < found.high
    assert found.high - found.value == pytest.approx(sum(found.contribution.values()))


def test_printed_landmarks_lie_in_their_intervals():
    verdicts = {
        name: mark.printed.compare(found.value, found.low, found.high)
        for name, mark in LANDMARKS.items()
        if mark.printed != rule.NOT_PRINTED and (found := interval(PAPER, name))
    }
    assert verdicts == {
        "smallest slope, kneed": "consistent within rounding",
        "smallest slope, straight": "consistent within rounding",
        "C flip": "not reproduced",
        "C-printed flip": "consistent within rounding",
        "C exponent 2/3": "reproduced",
    }


def test_the_flip_moves_with_the_offsets_as_found_before():
    # +0.0027 for -0.0005 in w_t, +0.0015 for -0.0005 in w_s, +0.0024 for +0.005 in R.
    found = interval(PAPER, "C-printed flip").sensitivity
    assert -5e-4 * found["w_t"] == pytest.approx(0.0027, abs=5e-5)
    assert -5e-4 * found["w_s"] == pytest.approx(0.0015, abs=5e-5)
    assert 5e-3 * found["R"] == pytest.approx(0.0024, abs=5e-5)


@pytest.mark.parametrize("name", list(LANDMARKS))
def test_sensitivities_do_not_depend_on_the_step(name):
    mark = LANDMARKS[name]
    found = PAPER.line(mark.walker)
    Z, keys = place(found, mark), list(HALF_UNITS[mark.walker])
    by = [sensitivities(mark, Z, found.walker, keys, step)[-1] for step in (1e-5, 4e-5)]
    # Rounding over the step, and the third derivative times its square.
    np.testing.assert_allclose(by[0], by[1], rtol=2e-5, atol=2e-6 * np.abs(by[0]).max())


def test_sensitivity_of_a_fold_is_that_of_the_fold_found_again():
    h = 2e-5
    moved = [
        min(
            float(np.exp(b.q.min()))
            for b in PAPER.line("physical-straight", w_t=w).branches
        )
        for w in (h, -h)
    ]
    # Central difference of relocated folds: error of order (h/leg)^2.
    again = (moved[0] - moved[1]) / (2 * h)
    assert interval(PAPER, "smallest slope, straight").sensitivity[
        "w_t"
    ] == pytest.approx(again, rel=1e-5)


def test_the_table_of_claims_is_whole():
    table = claims({"lines": [], "ids": ["D10", "D2", "P1"]}, [])
    assert list(table["claims/id"]) == ["D2", "D10", "P1"]
    assert set(table["claims/verdict"]) <= set(VERDICTS)
    assert len({len(v) for k, v in table.items() if k.startswith("claims/")}) == 1
    most = table["rounding/matters_most"].astype(bool)
    assert sorted(set(table["rounding/landmark"])) == sorted(
        table["rounding/landmark"][most]
    )


def read(name, walker, settings=None, **tables):
    """A claim as a study wants it whose own task gave these tables."""
    lines = [{"walker": walker, "set": settings or {}}]
    found = claims(
        {"lines": lines, "ids": [name]},
        [{k.replace("__", "/"): np.array(v) for k, v in tables.items()}],
    )
    return {
        k.removeprefix("claims/"): v[0]
        for k, v in found.items()
        if k.startswith("claims/")
    }


def test_the_count_of_gaits_is_read_from_the_study(monkeypatch):
    monkeypatch.setattr(kneed_chaos, "WALKERS", ("E",))
    for most, said in ((2, "reproduced"), (3, "not reproduced")):
        found = read(
            "G1",
            "E",
            coverage__slope=[0.01],
            coverage__starts=[100],
            coverage__anthropomorphic=[most],
            coverage__converged=[9],
            coverage__unseen=[0.1],
            coverage__non_anthropomorphic=[1],
            coverage__found_deflated=[0],
        )
        assert (found["verdict"], found["value"]) == (said, most)


def cascade_of_d(end=0.01904, fold=0.0122808):
    """Tables of D's cascade as its study gives them, in short."""
    return {
        "cascade__family": ["1"] * 3 + ["3"] * 4,
        "cascade__kind": ["flip"] * 3 + ["fold"] + ["flip"] * 3,
        "cascade__slope": [
            0.0150884,
            0.0176694,
            0.01816,
            fold,
            0.012635,
            0.0127555,
            0.0127829,
        ],
        "accumulation__family": ["1", "3"],
        "accumulation__slope": [0.0182934, 0.0127904],
        "accumulation__ratio": [4.67, 4.66],
        "accumulation__low": [0.0182934, 0.01279],
        "accumulation__high": [0.0182934, 0.01279],
        "lost__family": ["1", "3"],
        "lost__low": [end, 0.012923],
        "lost__high": [end + 5e-6, 0.012926],
    }


@pytest.mark.parametrize(
    ("name", "changed", "verdict"),
    [
        ("D8", {}, "reproduced"),
        ("D8", {"end": 0.0196}, "not reproduced"),
        ("D9", {}, "reproduced"),
        ("D9", {"fold": 0.0126}, "not reproduced"),
    ],
)
def test_doublings_are_read_from_the_study(name, changed, verdict):
    assert read(name, "D", **cascade_of_d(**changed))["verdict"] == verdict


def test_a_second_study_in_one_process_gets_the_row_of_a_fresh_one():
    first = read("D9", "D", **cascade_of_d())
    read("D9", "D", **cascade_of_d(fold=0.0126))
    again = read("D9", "D", **cascade_of_d())
    assert {k: v.tobytes() for k, v in again.items()} == {
        k: v.tobytes() for k, v in first.items()
    }


def test_tables_that_no_study_gave_are_made_once_and_are_not_those_of_the_study_before():
    made = []

    def make():
        made.append(1)
        return {"toy/x": np.arange(3), "toy/y": np.arange(3)}

    of_study = [{"walker": "D", "set": {}}, {"walker": "D", "set": {"g": 2.0}}]
    paper = paper_of(of_study, [{"toy/x": np.zeros(1)}, {"toy/x": np.ones(1)}])
    # Of the walker as it is: those of lines that change it were taken for its own.
    assert paper.table("toy", "D", make)["x"].tolist() == [0]
    assert paper.table("toy", "D", make, g=2.0)["x"].tolist() == [1]
    for _ in range(2):
        paper = paper_of([], [])
        assert paper.table("toy", "D", make)["x"].tolist() == [0, 1, 2]
    assert len(made) == 1
    # A study's table stands for itself: columns that were made have rows of another
    # length.
    assert list(
        paper_of(of_study[:1], [{"toy/x": np.zeros(1)}]).table("toy", "D", make)
    ) == ["x"]


@pytest.mark.parametrize(
    ("value", "verdict"), [(0.72386360373, "reproduced"), (0.76, "not reproduced")]
)
def test_branches_touch_where_folds_are_on_one_side_only(value, verdict):
    """At detuning 0.76 lines on both sides have two folds beside the slope."""
    found = read(
        "T6",
        "C",
        {"detuning": 1.0},
        turnings__value=[value],
        turnings__slope=[0.1001868636],
        turnings__turn=["key"],
        turnings__kind=["fold"],
        turnings__stance_angle=[0.426],
        turnings__error_bound=[1e-9],
    )
    assert (found["verdict"], found["value"]) == (verdict, value)


def test_feet_too_heavy_for_a_stable_gait_come_to_chaos_all_the_same():
    """Walker E, not checked by the paper: its gait of period two is stable, doubles,
    and its orbits part.
    """
    chaotic, said = kneed_chaos.chaos(PAPER, "E")
    assert chaotic == 1
    assert "period 2 from 0.0055" in said


def test_the_corners_of_a_rounding_move_every_key_the_way_that_moves_the_flip(
    monkeypatch,
):
    asked = []

    def lost(params, atlases):
        asked.append(params)
        return {
            "lost/low": np.array([0.1 * len(asked)]),
            "lost/high": np.array([0.1 * len(asked) + 0.01]),
        }

    monkeypatch.setattr(kneed_chaos, "cascade", lost)
    paper = MagicMock()
    paper.table = lambda _group, _walker, make: {k[8:]: v for k, v in make().items()}
    monkeypatch.setattr(
        kneed_chaos, "interval", lambda _paper, name: interval(PAPER, name)
    )
    assert np.allclose(
        kneed_chaos.corner_crises(paper, "C-printed"), [(0.1, 0.11), (0.2, 0.21)]
    )
    sensitivity = interval(PAPER, "C-printed flip").sensitivity
    lower, upper = (each["line"]["walker"] for each in asked)
    for key, half in HALF_UNITS["C-printed"].items():
        sign = np.sign(sensitivity[key])
        printed = getattr(CATALOGUE["C-printed"], key)
        assert (lower[key], upper[key]) == pytest.approx(
            (printed - sign * half, printed + sign * half), abs=1e-15
        )


def test_what_is_said_of_chaos_is_not_said_of_a_stable_gait():
    value, error, slope = kneed_chaos.exponent(PAPER, "D", np.array([0.012, 0.016]), 4)
    assert value < -4 * error
    assert slope in (0.012, 0.016)


def test_an_exponent_is_not_taken_across_two_curves():
    # The machine's short step lies on one side of its fold at 0.0475 and on the other
    # at 0.0525.
    with pytest.raises(
        ValueError, match="short gaits around slope 0.05 lie on two curves"
    ):
        PAPER.line("physical").exponent(lines.SHORT, 0.05)
    assert PAPER.line("physical").exponent(lines.LONG, 0.04) > 0


def test_every_claim_is_quoted_and_no_quotation_is_left_over():
    assert {*rule.TEXTS} == {*CLAIMS}
    assert all(20 < len(about.quotation) < 500 for about in CLAIMS.values())


def test_a_number_allowed_by_rounding_only_is_consistent_not_reproduced():
    found = CLAIMS["Z4"].find(PAPER)
    assert (found.verdict, rule.PRINTED["Z4"].number) == ("reproduced", 0.00015)
    kneed, printed = CLAIMS["P1"].find(PAPER), rule.PRINTED["P1"]
    assert kneed.verdict == "consistent within rounding"
    assert (
        kneed.low < printed.number < kneed.high
        and abs(kneed.value - printed.number) > printed.half_unit
    )


def test_a_push_off_avoids_three_quarters_of_the_loss_and_a_torque_replaces_a_collision():
    pushing, retarding = check({"ids": ["L1", "L2"]})
    assert pushing["verdict"] == "approximate"
    # Collisions after a push-off and before one, of small steps of one length.
    assert pushing["value"] == pytest.approx(4, rel=1e-4)
    assert "B long 4.0000" in pushing["computed"]
    assert "speed^p with p = long 4.000" in pushing["computed"]

    assert retarding["verdict"] == "reproduced"
    found = solve("E", 0.05, hip_torque=-0.002).set_index("gait").loc["short"]
    passive = solve("E", 0.05).set_index("gait").loc["short"]
    saved = passive["loss_tangential"] - found["loss_tangential"]
    ratio = saved / -found["hip_torque_work"]
    assert retarding["value"] == pytest.approx(ratio, rel=1e-9)
