"""Slopes of special points lie within their error bounds of the same points in 113
bits.
"""

import heyoka as hy
import numpy as np
import pytest

from exact_special_points import exact_earlier_strike, exact_slope
from gaitsweep.tasks.branches import degenerate_forms
from gaitsweep.tasks.branches.atlas import survey
from gaitsweep.tasks.branches.conditions import CONDITIONS, is_located
from gaitsweep.tasks.branches.refine import COARSE
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.branches.tracking import correct
from gaitsweep.tasks.step.problem import EPS, Problem
from gaitsweep.tasks.studies import follow_curves
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import WalkerError
from lines import _atlas
from soak.missed import neighbour

#: Kinds that equations define, and lines of the long test.
KINDS = {*filter(is_located, CONDITIONS), "end_earlier_strike"} - {
    "window",
    "label",
    "speed",
    "fastest",
    "exponent_two_thirds",
    "foot_at_kneestrike",
    "release_penetration",
}
LINES = 300


def compared(problem, found):
    """Special points of branches, each with the error of its slope over its bound: NaN
    where it is not known.
    """
    points = [point for branch in found for point in special_points(problem, branch)]
    for point in (point for point in points if point["kind"] in KINDS):
        Z = np.array(point["Z"])
        if point["kind"] == "end_earlier_strike":
            exact = exact_earlier_strike(problem, Z)
        else:
            exact = exact_slope(problem, point["kind"], Z)
        slope = hy.real128(point["slope"])
        error = np.nan if exact is None else abs(float((exact - slope) / exact))
        yield point["kind"], exact, error / point["error_bound"]


@pytest.mark.parametrize(
    ("walker", "keys"),
    # Errors of their flips were up to five times their bounds.
    [("D", {}), ("E", {"foot_mass_ratio": 0.08050684536489794})],
)
def test_special_points_lie_within_their_bounds(walker, keys):
    """Flips had the bounds of gaits at a given slope, which leave out how the
    multipliers round.
    """
    problem = Problem(resolve(walker, keys))
    found = list(compared(problem, survey(problem, COARSE)))
    assert "flip" in {kind for kind, *_ in found}
    assert {kind: share for kind, _, share in found if not share < 1} == {}
    if walker == "D":  # by another derivation, in 113 bits too
        assert abs(float(found[0][1] - hy.real128("0.015088437941119463562"))) < 1e-20


@pytest.mark.parametrize(
    ("walker", "key", "low", "high", "kinds"),
    [
        ("D", "R", 0.0, 0.05, ("flip",)),
        ("C", "detuning", 0.69, 0.7, ("fold",)),
        ("physical-straight", "R", 0.2, 0.202, ("end_tangential_heelstrike",)),
    ],
)
def test_slopes_of_curves_lie_within_their_bounds(
    monkeypatch, walker, key, low, high, kinds
):
    shares = []

    def compared(problem, condition, Z):
        kind, bound = condition.name, slope_error(problem, condition, Z)
        exact = exact_slope(problem, kind, Z)
        shares.append(
            (
                kind,
                abs(float((exact - hy.real128(np.exp(Z[-1]))) / exact))
                / (bound + 8 * EPS),
            )
        )
        return bound

    slope_error = degenerate_forms.slope_error
    monkeypatch.setattr(degenerate_forms, "slope_error", compared)
    line = {"walker": walker, "set": {}}
    options = {"key": key, "from": low, "to": high, "kinds": kinds}
    found = follow_curves.curve(
        {"line": line, "slope": np.array([0.005, 0.3]), **options}, [_atlas(walker, ())]
    )
    assert {kind for kind, _ in shares} == set(kinds) and max(
        share for _, share in shares
    ) < 1
    assert (
        len(shares) == len(found["curves/error_bound"])
        and found["curves/error_bound"].max() < 1e-12
    )


@pytest.mark.parametrize("seed", [26, 31])
def test_ends_by_an_earlier_strike_lie_within_their_bounds(seed):
    """Where the foot is on the ground at kneestrike, errors were up to 1.6 times the
    bound of a gait at its slope.
    """
    problem = Problem(drawn(seed))
    found = [b for b in survey(problem, COARSE) if "end_earlier_strike" in b.why]
    shares = [
        share
        for kind, _, share in compared(problem, found)
        if kind == "end_earlier_strike"
    ]
    assert shares and max(shares) < 1


def limit_of_shorter_steps(problem, branch, end):
    """Slope at which steps vanish, from a polynomial through points of steps shorter
    than those of the branch.
    """
    Z = branch.Z if end == 0 else branch.Z[:, ::-1]
    k = 1 + int(np.abs(Z[1 : problem.m, 0]).argmax())
    share = 1 / np.abs(Z[k, :40])
    points = [(x, np.exp(q)) for x, q in zip(share, Z[-1], strict=False) if x < 0.05]
    before, last = Z[:, 1], Z[:, 0]
    for _ in range(60):
        # In the rate over the angle, whose inverse vanishes with the steps.
        guess = last + (last - before) * (last[k] / 0.97 - last[k]) / (
            last[k] - before[k]
        )
        point = correct(problem, guess[:, None], np.eye(len(guess))[:, [k]])
        if not point.ok[0]:
            break
        before, last = last, point.Z[:, 0]
        points.append((1 / abs(last[k]), np.exp(last[-1])))
    x, y = np.array(points).T
    first, other = (
        np.polynomial.Polynomial.fit(x, y, degree)(0.0) for degree in (7, 8)
    )
    assert x.min() < 0.7 * share[0] and abs(other / first - 1) < 1e-11
    return first


@pytest.mark.parametrize("seed", [14, 30, 69])
def test_slopes_at_which_steps_vanish_lie_within_their_bounds(seed):
    """Errors were up to 0.9 of their bounds, by the rounding that extrapolation
    enlarges.
    """
    problem, shares = Problem(drawn(seed)), []
    for branch in survey(problem):
        for end in (i for i in (0, -1) if branch.why[i] == "end_zero_step"):
            place = 0 if end == 0 else len(branch.q) - 1
            (point,) = [
                p for p in special_points(problem, branch) if p["place"] == place
            ]
            error = abs(
                limit_of_shorter_steps(problem, branch, end) / point["slope"] - 1
            )
            shares.append(error / point["error_bound"])
    assert shares and max(shares) < 0.5


def drawn(seed):
    """A walker near one of the catalogue; of every third line another key moves too."""
    name, keys, _ = neighbour(seed)
    random = np.random.default_rng(seed)
    if seed % 3 == 0:
        keys |= (
            {"R": random.uniform(0, 0.3)}
            if name == "E"
            else {"m_h": random.uniform(0, 3)}
        )
    return resolve(name, keys)


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_special_points_of_random_walkers_lie_within_their_bounds(resumed, tell):
    """Of each kind: their number, those that are not found again, and the largest error
    over its bound.
    """
    largest = {}
    for seed in resumed(LINES):
        try:
            problem = Problem(drawn(seed))
        except WalkerError:
            continue
        for kind, _, share in compared(problem, survey(problem, COARSE)):
            resumed.found[kind] += 1
            resumed.found[f"{kind}, unknown"] += int(np.isnan(share))
            resumed.found[f"{kind}, beyond"] += int(share > 1)
            largest[kind] = np.fmax(largest.get(kind, 0.0), share)
            tell(f"{resumed.state} lines; {dict(resumed.found)}; largest {largest}")
    counts = resumed.found
    assert counts["flip"] and not sum(counts[f"{kind}, beyond"] for kind in KINDS)
    assert sum(counts[f"{kind}, unknown"] for kind in KINDS) < 0.01 * sum(
        counts[kind] for kind in KINDS
    )
