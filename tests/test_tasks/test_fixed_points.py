"""Gaits against 25-digit solutions, published numbers, and their own bounds."""

import tomllib
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from gaitsweep.tasks.branches.atlas import to_arrays
from gaitsweep.tasks.branches.special_points import special_points
from gaitsweep.tasks.contract.registry import ALWAYS, GAITS
from gaitsweep.tasks.gaits import polish
from gaitsweep.tasks.gaits.multipliers import multipliers, other_multipliers
from gaitsweep.tasks.gaits.rounding import rounding
from gaitsweep.tasks.gaits.search import search
from gaitsweep.tasks.measures.losses import heelstrike_losses
from gaitsweep.tasks.step import extended_precision
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.step.verify_step import verify
from gaitsweep.tasks.studies.solve_points import points
from gaitsweep.tasks.walkers.resolve import resolve
from lines import branches, gait, solved
from oracle import Oracle, StepFailed

REFERENCE = Path(__file__).parents[2] / "data" / "reference"
EXTENDED = tomllib.loads((REFERENCE / "extended.toml").read_text())["gaits"]
ANGLES = ("stance_angle", "stance_rate", "thigh_rate", "period")


def relative(value, digits):
    exact = Decimal(digits)
    return abs(float((Decimal(float(value)) - exact) / exact))


@pytest.mark.parametrize(
    "exact", EXTENDED, ids=lambda g: f"{g['walker']}-{g['slope']}-{g['gait']}"
)
def test_a_gait_agrees_with_extended_precision(exact):
    found = gait(exact["walker"], float(exact["slope"]), exact["gait"])
    errors = [relative(found[name], exact[name]) for name in ANGLES]
    # The bound is a promise; 1e-13 is what every slope is to have, by more digits where
    # a double's are too few.
    assert max(errors) <= found["error_bound"]
    assert max(errors) < 1e-13
    values = np.array([complex(float(a), float(b)) for a, b in exact["multipliers"]])
    computed = found["multiplier_real"] + 1j * found["multiplier_imag"]
    for value in values:
        assert np.abs(computed - value).min() < 1e-10


def test_vanishing_slopes_keep_their_digits():
    tau = 3.81209179509297
    for walker in ("D", "E", "B"):
        found = gait(walker, 1e-12, "long")
        assert found["error_bound"] < 1e-12
        assert abs(found["energy_imbalance"]) < 1e-12
    for label, period in (("long", tau), ("short", np.pi)):
        found = gait("D", 1e-12, label)
        # The next term of the series is of order slope^(2/3).
        assert found["stance_angle"] / 1e-4 == pytest.approx(
            np.tanh(period / 2) ** (2 / 3), rel=3e-8
        )
        assert found["period"] == pytest.approx(period, rel=3e-8)


def test_more_digits_are_used_where_newton_does_not_halve_its_steps():
    """With a derivative that is off by a factor, long double has none other and says
    so; 128 bits form their own.
    """
    problem, slope = Problem(resolve("E")), np.array([0.01])
    w, _, _ = search(problem, 0.01)
    exact = polish.settle(problem, polish.unmeasured(problem, w[:, :1], slope))
    stride = exact.stride
    stride.inverse = 0.3 * stride.inverse
    off = exact.y[:, 0] * (1 + 1e-6)
    start = extended_precision.Start(
        problem,
        0,
        stride,
        off,
        exact.times[:, 0],
        float(slope[0]),
        float(exact.scale[0]),
    )
    assert extended_precision.solved(start, 0).error == np.inf
    assert extended_precision.solved(start, 1).error < 1e-15
    gait = extended_precision.refine(start, 1e-11, 1.0)
    assert gait.error < 1e-15
    np.testing.assert_allclose(gait.y, exact.y[:, 0], rtol=1e-13)


@pytest.mark.parametrize("walker", ["D", "C"])
def test_ordinary_gaits_need_no_more_digits(walker, monkeypatch):
    monkeypatch.setattr(extended_precision, "refine", None)
    assert (solved(walker, [0.005, 0.0075, 0.01])["status"][:, :2] == 0).all()


@pytest.mark.parametrize("walker", ["E", "C"])
def test_guesses_that_are_gaits_already_are_verified_as_others_are(walker):
    """Their motion is not sampled on the way."""
    problem, slopes = Problem(resolve(walker)), np.array([0.03, 0.03])
    w, _, _ = search(problem, 0.03)
    far = np.stack([w[:, 0], w[:, 0] * (1 + 1e-7)], axis=1)
    first = polish.settle(
        problem, polish.unmeasured(problem, far, slopes), sampled=True
    )
    again = polish.settle(
        problem, polish.unmeasured(problem, first.w, slopes), sampled=True
    )
    assert np.isnan(again.stride.motion[-1]).all()
    for at in (first, again):
        assert (
            at.step.all()
            and at.converged.all()
            and (at.leg_passes == first.leg_passes[0]).all()
        )


def test_zero_multipliers_are_exact():
    for walker, zeros in (("D", 1), ("E", 1), ("C", 1), ("B", 0)):
        found = gait(walker, 0.01, "long")
        assert (
            np.hypot(found["multiplier_real"], found["multiplier_imag"]) == 0
        ).sum() == zeros


def test_period_one_gaits_of_d_keep_their_identity():
    slopes = np.geomspace(1e-4, 0.2, 25)
    out = solved("D", slopes)
    for g in (0, 1):
        theta = out["stance_angle"][:, g]
        expected = -2 / np.tan(2 * theta) * np.sqrt(np.sin(theta) * np.sin(slopes))
        np.testing.assert_allclose(out["stance_rate"][:, g], expected, rtol=1e-11)


def test_small_slopes_follow_the_linear_theory():
    tau = 3.81209179509297
    assert np.tan(tau / 2) == pytest.approx(-3 * np.tanh(tau / 2), rel=1e-10)
    for label, period in (("long", tau), ("short", np.pi)):
        found = gait("D", 1e-8, label)
        assert found["period"] == pytest.approx(period, rel=1e-5)
        assert found["stance_angle"] / 1e-8 ** (1 / 3) == pytest.approx(
            np.tanh(period / 2) ** (2 / 3), rel=1e-5
        )


@pytest.mark.parametrize("walker", ["D", "E", "F"])
def test_no_hole_from_1e_8_to_02(walker):
    out = solved(walker, np.geomspace(1e-8, 0.2, 120))
    assert (out["status"][:, :2] == 0).all()
    assert (out["status"][:, 2:] == 1).all()
    assert np.isfinite(out["error_bound"][:, :2]).all()


def test_points_lean_on_nothing_but_the_atlas():
    slopes = np.geomspace(1e-4, 0.15, 41)
    whole = solved("E", slopes)
    order = np.random.default_rng(3).permutation(len(slopes))
    shuffled = solved("E", slopes[order])
    for name in whole:
        if name != "reasons":
            assert np.array_equal(whole[name][order], shuffled[name], equal_nan=True), (
                name
            )
    alone = solved("E", slopes[17:18])
    assert np.array_equal(
        alone["multiplier_real"][0], whole["multiplier_real"][17], equal_nan=True
    )


def test_only_what_is_wanted_is_returned():
    out = solved("E", [0.01], want=("period",))
    assert set(out) == {"period", *ALWAYS, "reasons"}


def test_a_slope_without_gait_says_why():
    out = solved("physical", [0.01])
    assert (out["status"] == 1).all()
    assert "0.0191229" in out["reasons"][out["reason"][0, 0]]


@pytest.mark.parametrize("walker", ["B", "A", "C"])
def test_losses_balance_the_drop(walker):
    out = solved(walker, np.geomspace(1e-6, 0.1, 30))
    assert np.nanmax(np.abs(out["energy_imbalance"][:, :2])) < 1e-12
    good = out["status"][:, 0] == 0
    assert (out["loss_normal"][good, 0] > 0).all()


def test_the_massless_foot_loses_nothing_sideways():
    out = solved("D", np.geomspace(1e-6, 0.1, 20))
    assert (out["loss_tangential"][:, :2] == 0).all()
    assert np.abs(out["energy_imbalance"][:, :2]).max() < 1e-12


def _losses(slow, struck):
    """Losses at heelstrike, normal and tangential, by the second derivation.

    The contact mass matrix turns the foot's velocity into the ground's impulse; two
    impacts give it.
    """
    velocities, impulses = [], []
    for before in (struck, struck * np.array([1, 1, 1, 0.5, 1, 1])):
        rows, _ = slow._constraints(slow._links(before[:3]), np.zeros(4), 1, ())
        velocities.append(rows[8:10] @ slow.velocities(before))
        impulses.append(-slow.heelstrike(before)[1])
    mass, axes = np.linalg.eigh(
        np.transpose(impulses) @ np.linalg.inv(np.transpose(velocities))
    )
    losses = 0.5 * mass * (axes.T @ velocities[0]) ** 2
    normal = np.abs(axes[1]).argmax()
    return losses[normal], losses[1 - normal]


@pytest.mark.parametrize(
    ("walker", "slope", "label"),
    [("B", 0.01, "long"), ("E", 0.01, "short"), ("C", 0.03, "long")],
)
def test_losses_lie_on_the_axes_of_the_contact_mass(walker, slope, label):
    found, slow = gait(walker, slope, label), Oracle(resolve(walker).table())
    rates = [found["stance_rate"], found["thigh_rate"], found["shank_rate"]]
    losses = _losses(
        slow, slow.step(found["stance_angle"], rates, slope).before_heelstrike
    )
    assert [found["loss_normal"], found["loss_tangential"]] == pytest.approx(
        losses, rel=1e-7
    )


@pytest.mark.parametrize("angle", [0.7, 0.9])
def test_a_leg_more_flat_than_upright_loses_most_along_the_ground(angle):
    """The axis of the larger contact mass lies along the leg: past 45 degrees it is the
    tangential one.
    """
    walker, rates = resolve("E"), np.array([-1.0, 0.3])
    losses = heelstrike_losses(walker, np.array([angle]), rates[:, None])
    slow = Oracle(walker.table())
    expected = _losses(
        slow,
        np.array(
            [-angle, angle, angle, *rates / slow.time_unit, rates[1] / slow.time_unit]
        ),
    )
    weight_times_leg = walker.total_mass * walker.g * walker.leg
    assert np.ravel(losses) * weight_times_leg == pytest.approx(expected, rel=1e-9)
    assert (losses[1] > losses[0]) == (angle > np.pi / 4)


def test_near_a_fold_rounding_moves_a_gait_by_the_inverse_root_of_the_distance():
    """There I - DP is singular, its smallest eigenvalue proportional to the distance in
    stance angle.
    """
    problem, found = branches("physical-straight")
    ((branch, fold),) = [
        (b, p) for b in found for p in special_points(problem, b) if p["kind"] == "fold"
    ]
    estimates = []
    for distance in (1e-5, 1e-7):
        q = np.log(fold["slope"]) + np.array([distance])
        for index, Z, _ in branch.guesses(q):
            stride, _ = problem.stride(Z[:-1], q[index])
            estimates.append(rounding(stride)[:, 0])
    far, near = estimates[:2], estimates[2:]
    assert len(near) == 2
    np.testing.assert_allclose(np.divide(near, far), 10, rtol=0.05)


def test_a_doubt_is_what_a_chord_between_samples_could_hide():
    """A guard with a minimum between samples differs from its chord there by h^2 g''/8;
    twice that is allowed for.
    """
    time, bend = np.linspace(0, 1, 41), 0.1
    h, behind = time[1], 0.3 - 0.6 * time
    for lowest, doubt in ((0.24, True), (0.26, False)):
        from_minimum = time - time[30] - h / 2
        guard, rate = bend * (lowest * h**2 + from_minimum**2), 2 * bend * from_minimum
        motion = np.stack(
            [behind, guard - behind, np.full(41, -0.6), rate + 0.6], axis=1
        )[:, :, None]
        check = verify([motion], np.array([-1.0]), np.ones((1, 1)))
        assert check.anthropomorphic[0] and check.doubt[0] == doubt


@pytest.mark.parametrize(
    ("change", "slope"), [({}, 0.3), ({"r_s": 0.06}, 0.05)], ids=["foot", "knee"]
)
def test_a_fixed_point_whose_foot_or_knee_strikes_earlier_is_no_step(change, slope):
    """The second derivation stops at the first strikes: steps are the fixed points
    whose strikes these are.
    """
    walker = resolve("physical", change)
    slow, time_unit = Oracle(walker.table()), np.sqrt(walker.leg / walker.g)
    w, stride, verdict = search(Problem(walker), slope)
    first = []
    for lane, angle in enumerate(np.exp(w[0])):
        start = stride.start[:, lane] / stride.start[0, lane] * angle
        try:
            step = slow.step(angle, start[3:] / time_unit, slope)
        except StepFailed:
            first.append(False)
        else:
            first.append(
                np.allclose(
                    w[3:, lane] * time_unit,
                    [step.kneestrike_time, step.period],
                    rtol=1e-6,
                )
            )
    assert verdict.step.tolist() == first
    assert any(first) and not all(first)


@pytest.mark.parametrize("walker", ["D", "B"])
def test_a_bound_holds_from_however_far_newton_comes(walker, monkeypatch):
    """One step of Newton from a coarse start leaves an error that the bound covers, or
    more digits remove.
    """
    slopes, angles = np.geomspace(1e-3, 0.03, 4), (*ANGLES, "error_bound")
    _, found = branches(walker)
    arrays = to_arrays(found)
    line = {"line": {"walker": walker, "set": {}}, "slope": slopes, "want": angles}
    exact = points(line, [arrays])
    monkeypatch.setattr(polish, "MAX_STEPS", 0)
    for far in (1e-8, 1e-7, 1e-5):
        coarse = arrays["Z"] * (1 + far)
        coarse[-1] = arrays["Z"][-1]
        coarse = points(line, [{**arrays, "Z": coarse}])
        assert (coarse["status"][:, 0] == 0).all()
        for name in ANGLES:
            error = np.abs(coarse[name] / exact[name] - 1)[:, 0]
            assert (
                error <= (coarse["error_bound"] + exact["error_bound"])[:, 0]
            ).all(), (far, name)


def test_labels_follow_the_contract():
    out = solved("A", np.geomspace(1e-3, 0.1, 10))
    u = out["heelstrike_rate_ratio"]
    assert (u[:, GAITS.index("long")] < 0.25).all()
    assert (u[:, GAITS.index("short")] > 0.9).all()


@pytest.mark.parametrize("large", [0.7, -0.7, 1.8, -1.8])
def test_a_multiplier_near_zero_loses_no_digits(large):
    found = multipliers(np.array([[large, 0.0], [1.0, 1e-13]])[..., None], 2)[0]
    np.testing.assert_allclose(found.real, [large, 1e-13], rtol=1e-14)


def test_multipliers_beside_those_of_a_special_point():
    """Beside a pair on the unit circle all others count; a pair that is real is none."""
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 0.3]])
    jacobian = np.stack(
        [turn, np.diag([0.5, -0.4, 0.2]), np.full((3, 3), np.nan)], axis=-1
    )
    assert other_multipliers("neimark_sacker", jacobian) == pytest.approx(
        [0.3, np.inf, np.inf]
    )
    jacobian = np.stack(
        [np.diag([-1.0, 0.4, -0.7]), np.diag([1.0, -0.9, 0.2])], axis=-1
    )
    assert other_multipliers("flip", jacobian) == pytest.approx([0.7, 1.0])
    assert other_multipliers("fold", jacobian) == pytest.approx([1.0, 0.9])
