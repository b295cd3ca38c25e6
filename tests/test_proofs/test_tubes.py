"""Branches over intervals: tubes, flips and folds, and the certificates kept of them."""

import itertools
import json
from pathlib import Path

import pytest
from flint import arb, ctx, fmpq

from exact_gaits import GAITS, REFERENCE, guess, reference
from gaitsweep.tasks.ledger import write_certificates
from gaitsweep.tasks.proofs import covers, crossings, tubes
from gaitsweep.tasks.proofs.enclosure import NotProvedError
from gaitsweep.tasks.proofs.keys import decimal, exact
from gaitsweep.tasks.studies.prove_gaits import prove_one

KEPT = {
    path.stem: json.loads(path.read_text())
    for path in sorted((REFERENCE / "proofs").glob("*.json"))
}
#: First flip of the simplest walker, to 20 digits at 256 bits.
FLIP = "0.015088437941119463562"


def interval(middle, radius):
    with ctx.workprec(400):
        return arb(middle) + arb(0, 1) * arb(radius)


def simplest(slope=0.015):
    keys, kneed = exact("D")
    close = guess(reference("D", "0.009", "long"))
    found = prove_one(
        {"walker": "D", "slope": str(slope), "gait": "long", "accuracy": 1e-12}
    )["gaits"][0]["box"]
    start = (
        [found[name][0] for name in ("stance_angle", "stance_rate", "period")]
        if slope != 0.009
        else close
    )
    return tubes.Family(keys, kneed, tubes.BY_SLOPE), [arb(x) for x in (*start, slope)]


def test_the_first_flip_of_the_simplest_walker_is_an_interval():
    family, start = simplest(0.015088)
    found = crossings.bracketed(family, start, 1e-12, crossings.KINDS["flip"][1])
    with ctx.workprec(200):
        assert found.slope.contains(arb(FLIP).mid())
        assert found.slope.rad() < 2e-12
        assert found.bits > 64 and found.values[0] > 0 > found.values[1]
    with pytest.raises(NotProvedError, match="zero of the test function"):
        crossings.bracketed(family, start, 1e-12, lambda t: arb(1))


def test_the_fold_of_the_physical_walker_with_locked_knees_is_an_interval():
    keys, kneed = exact("physical-straight")
    start = write_certificates._start("physical-straight", "long", 0.0153621)
    parameter, function = crossings.KINDS["fold"]
    found = crossings.bracketed(
        tubes.Family(keys, kneed, parameter), start, 1e-6, function
    )
    kept = interval(*KEPT["physical-straight-fold"]["slope"])
    with ctx.workprec(200):
        assert found.slope.overlaps(kept)
        assert 0.0153 < found.slope < 0.0155
        # The slope is least there: it falls, then rises with the angle.
        assert found.values[0] < 0 < found.values[1]


def test_a_tube_holds_the_gaits_proved_one_by_one():
    family, start = simplest(0.012)
    with ctx.workprec(128):
        tube = tubes.tube(family, tubes.point(family, start, 1e-18), arb(2e-7))
        assert tube.events().label == "long"
        for shift in (-1.9e-7, 0.7e-7, 2e-7):
            at = [
                c + t * arb(shift)
                for c, t in zip(tube.middle, tube.tangent, strict=True)
            ]
            gait = tubes.point(family, at, 1e-18)
            assert tube.holds(gait)
            # The derivative of the step map over the whole tube holds that of each
            # gait.
            pairs = zip(
                tube.step_derivative().entries(),
                gait.step_derivative().entries(),
                strict=True,
            )
            assert all(wide.contains(thin.mid()) for wide, thin in pairs)
        beyond = tubes.point(
            family,
            [c + t * arb(3e-7) for c, t in zip(tube.middle, tube.tangent, strict=True)],
            1e-18,
        )
        assert not tube.holds(beyond)


def test_stable_tubes_cover_an_interval_without_gaps():
    family, start = simplest(0.012)
    low, high = decimal("0.012"), decimal("0.012004")
    found = covers.stable_over(family, start, (low, high))
    with ctx.workprec(200):
        ends = [(t.middle[-1] - t.half, t.middle[-1] + t.half) for t in found]
        assert ends[0][0] <= arb(low)
        assert ends[-1][1] >= arb(high)
        assert all(one[1] >= other[0] for one, other in itertools.pairwise(ends))


def test_no_stable_tube_passes_the_flip():
    family, start = simplest(0.0150884)
    with pytest.raises(NotProvedError, match="stable"):
        covers.stable_over(family, start, (decimal("0.0150884"), decimal("0.0150885")))


def test_certificates_are_those_the_project_states():
    assert set(KEPT) == set(write_certificates.names())
    with ctx.workprec(200):
        assert interval(*KEPT["D-flip"]["slope"]).contains(arb(FLIP).mid())
    assert all(
        not KEPT[f"E-long-{s}"]["stable"]
        for s in ("0.01", "0.003", "0.001", "0.0003", "0.0001")
    )
    tube = KEPT["D-long-tube"]
    ends = [
        (
            fmpq(*m.as_integer_ratio()) - fmpq(*h.as_integer_ratio()),
            fmpq(*m.as_integer_ratio()) + fmpq(*h.as_integer_ratio()),
        )
        for m, h in tube["tubes"]
    ]
    assert ends[0][0] <= decimal("0.009")
    assert ends[-1][1] >= decimal("0.0150")
    assert all(one[1] >= other[0] for one, other in itertools.pairwise(ends))


@pytest.mark.parametrize(
    "name", ["D-long-0.009", "B-short-0.01", "A-long-0.01", "C-long-0.01"]
)
def test_a_certificate_of_each_structure_is_proved_again(name):
    prove_again(name)


@pytest.mark.soak
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", write_certificates.names())
def test_every_certificate_is_proved_again(name):
    prove_again(name)


def prove_again(name):
    found, kept = write_certificates.certify({"name": name}), KEPT[name]
    assert set(found) == set(kept)
    for key in ("statement", "walker", "kind", "gait", "events", "stable"):
        assert found.get(key) == kept.get(key)
    with ctx.workprec(400):
        for key, x in kept.get("box", {}).items():
            assert interval(*x).overlaps(interval(*found["box"][key]))


def test_certificates_are_read_by_people():
    for path in (REFERENCE / "proofs").glob("*.json"):
        assert max(map(len, path.read_text().splitlines())) < 400 or "tube" in path.stem
        assert Path(path).stat().st_size < 100_000


@pytest.mark.parametrize(
    "name", [name for name, kept in KEPT.items() if kept["kind"] == "gait"]
)
def test_a_certificates_box_holds_the_reference_gait(name):
    """The references come from other equations, integrated in 113 and 256 bits."""
    kept = KEPT[name]
    walker = name[: -len(f"-{kept['gait']}-{kept['slope']}")]
    known = [
        g
        for g in GAITS
        if (g["walker"], g["gait"], g["slope"]) == (walker, kept["gait"], kept["slope"])
    ]
    if walker in ("D", "B", "A", "C"):
        assert known
    with ctx.workprec(400):
        for g in known:
            for key, x in kept["box"].items():
                digits = arb(g[key])
                assert interval(*x).overlaps(digits + abs(digits) * arb(0, 2e-24))
            assert kept["stable"] is all(
                abs(complex(float(a), float(b))) < 1 for a, b in g["multipliers"]
            )
