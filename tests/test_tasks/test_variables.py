"""Variables: every one that is wanted is computed, on every road to a gait, and follows
its closed form.
"""

import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.contract.registry import VARIABLES, Variable
from gaitsweep.tasks.studies.solve_points import atlas, points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE

#: Enough slopes for polynomials to give the gaits of a line.
SLOPES = np.geomspace(1e-3, 0.012, 300)
OF_GAITS = tuple(
    v.name
    for v in VARIABLES.values()
    if v.group not in ("proofs", "targets") and v.name not in ("reason", "status")
)
LINE = {"walker": "D", "set": {}}


@pytest.fixture(scope="module")
def lines():
    return {
        name: atlas({"line": {"walker": name, "set": {}}, "coarse": True}, [])
        for name in ("D", "C")
    }


def on_line(lines, name, want, slope, **params):
    line = {"walker": name, "set": {}}
    return points(
        {"line": line, "slope": np.asarray(slope), "want": want, **params},
        [lines[name]],
    )


def features(kneed):
    """What a passive walker's variables may be of."""
    return ("", "knees") if kneed else ("",)


@pytest.mark.parametrize("walker", ["D", "C"])
def test_polynomials_give_each_smooth_variable_that_is_wanted_alone(lines, walker):
    kneed = CATALOGUE[walker].knees
    names = [
        v.name
        for v in VARIABLES.values()
        if v.is_smooth and v.name in OF_GAITS and v.only_of in features(kneed)
    ]
    chosen = (
        names
        if walker == "D"
        else [name for name in names if "knee" in name or "ratio" in name]
    )
    assert chosen
    known = on_line(lines, walker, chosen, SLOPES)
    for name in chosen:
        found = on_line(
            lines, walker, (name,), SLOPES, accuracy=1e-6, interpolated=True
        )
        np.testing.assert_array_equal(np.isnan(found[name]), np.isnan(known[name]))
        if name not in ("error_bound", "multiplier_error_bound"):
            size = np.nanmax(np.abs(known[name][:, 0]))
            np.testing.assert_allclose(
                found[name][:, 0], known[name][:, 0], rtol=1e-5, atol=1e-4 * size
            )


@pytest.mark.parametrize(("walker", "slope"), [("D", 0.016), ("C", 0.08)])
def test_a_gait_of_two_steps_has_every_variable(walker, slope):
    gait = gaitsweep.gaits(walker, slope, steps=2, variables=list(OF_GAITS)).isel(
        gait=0
    )
    kneed = CATALOGUE[walker].knees
    missing = {name for name in OF_GAITS if np.isnan(gait[name].values).any()}
    of_others = {
        name for name in OF_GAITS if VARIABLES[name].only_of not in features(kneed)
    }
    assert missing == of_others


@pytest.mark.parametrize(
    ("is_smooth", "params"),
    [
        (False, {}),
        (True, {"accuracy": 1e-6, "interpolated": True}),
        (False, {"steps": 2}),
    ],
)
def test_a_variable_that_nothing_computes_is_refused(
    monkeypatch, lines, is_smooth, params
):
    monkeypatch.setitem(
        VARIABLES,
        "sway",
        Variable("sway", ("gait",), "number", "no code knows it", is_smooth=is_smooth),
    )
    slope = [0.016] if "steps" in params else SLOPES
    known = [atlas({"line": LINE, **params}, [])] if "steps" in params else [lines["D"]]
    with pytest.raises(LookupError, match="Nothing computes the variable `sway`"):
        points(
            {"line": LINE, "slope": np.asarray(slope), "want": ("sway",), **params},
            known,
        )


@pytest.mark.parametrize(
    ("walker", "slope"), [("A", 0.02), ("B", 0.01), ("physical", 0.036)]
)
def test_step_length_frequency_and_velocity_ratio_follow_from_angle_period_and_rates(
    walker, slope
):
    legs, gait = CATALOGUE[walker], gaitsweep.gaits(walker, slope).sel(gait="long")
    angle, u = float(gait.stance_angle), float(gait.heelstrike_rate_ratio)
    assert gait.step_length.item() == pytest.approx(
        2 * (legs.l * np.sin(angle) + legs.R * angle), rel=1e-14
    )
    assert gait.step_frequency.item() == pytest.approx(
        1 / gait.period.item(), rel=1e-14
    )
    assert (gait.step_length * gait.step_frequency).item() == pytest.approx(
        gait.speed.item(), rel=1e-14
    )
    # Equation 12 of the paper, the sign of its first line corrected.
    ratio = -(legs.R + legs.l * np.cos(angle)) * u / (legs.l * np.sin(angle) * (2 - u))
    assert gait.velocity_ratio.item() == pytest.approx(ratio, rel=1e-13)
    assert {gait[name].units for name in ("step_length", "step_frequency")} == (
        {"1"} if walker == "B" else {"m", "s-1"}
    )


def test_the_length_of_two_steps_is_their_mean():
    gait = gaitsweep.gaits("D", 0.016, steps=2).isel(gait=0)
    state = [
        float(gait[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    angles = gaitsweep.simulate("D", 0.016, state, 2).stance_angle.values
    lengths = np.sin(angles[:-1]) + np.sin(angles[1:])
    assert gait.step_length.item() == pytest.approx(lengths.mean(), rel=1e-9)
    assert gait.step_frequency.item() == pytest.approx(
        2 / gait.period.item(), rel=1e-14
    )
