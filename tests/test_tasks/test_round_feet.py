"""Round feet of vanishing mass: the limit of feet with mass, and the closed form of
their heelstrike.
"""

import numpy as np
import pytest

import gaitsweep
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.tasks.mechanics.contact import Chain
from gaitsweep.tasks.walkers.resolve import resolve

SLOPES = np.array([0.002, 0.009, 0.02])
COMPARED = (
    *(
        "stance_angle",
        "stance_rate",
        "thigh_rate",
        "period",
        "speed",
        "multiplier_real",
        "multiplier_imag",
    ),
    *(
        "loss_normal",
        "loss_tangential",
        "scuff_depth",
        "least_normal_force",
        "friction_demand",
    ),
    *("friction_demand_heelstrike", "penetration_depth"),
)
WANT = [
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "period",
    "speed",
    "multipliers",
    "energy",
    "violations",
]


def feet(walker, radius, centre, **keys):
    """Gaits with the feet's mass at their lowest points, or at their centres."""
    keys |= {"c_s": 0.5 - radius} if centre else {}
    return gaitsweep.gaits(walker, SLOPES, R=radius, variables=WANT, **keys).isel(
        gait=slice(2)
    )


@pytest.mark.parametrize(
    ("radius", "centre", "keys"),
    [
        (0.1, False, {}),
        (0.3, False, {}),
        (0.3, True, {}),
        (0.5, True, {}),
        (0.3, False, {"r_s": 0.2, "w_s": 0.01}),
    ],
)
def test_it_is_the_limit_of_feet_with_mass(radius, centre, keys):
    limit = feet("D", radius, centre, **keys)
    assert (limit.status == 0).all() and limit.multiplier.size == 3
    far, near = (
        feet("E", radius, centre, foot_mass_ratio=ratio, **keys)
        for ratio in (1e-6, 1e-9)
    )
    for name in COMPARED:
        apart = [np.abs(feet[name] - limit[name]).max().item() for feet in (far, near)]
        # The difference is proportional to the mass, to the rounding of its own.
        assert apart[0] < 1e-4 and apart[1] <= 1.01e-3 * apart[0] + 3e-13, name
    assert (
        np.abs(limit.energy_imbalance).max() < 1e-13 and limit.error_bound.max() < 1e-13
    )
    # A heelstrike leaves two coordinates: one multiplier is zero but for rounding.
    assert np.abs(limit.multiplier_real.isel(multiplier=2)).max() < 1e-13


@pytest.mark.parametrize("radius", [0.0, 0.05, 0.3])
def test_the_loss_is_that_of_a_hip_redirected_between_two_rolling_contacts(radius):
    """Adamczyk, Collins & Kuo (J. Exp. Biol. 209 (2006) 3953-3963): the hip's velocity
    turns by 2 b, where tan b = l sin a/(R + l cos a), which for short steps is (1 - R)
    a; so feet of radius R lose (1 - R)^2 as much.
    """
    gaits = feet("D", radius, False)
    a, l = gaits.stance_angle, 1 - radius
    turn = 2 * np.arctan2(l * np.sin(a), radius + l * np.cos(a))
    hip = gaits.stance_rate * np.hypot(l * np.sin(a), radius + l * np.cos(a))
    np.testing.assert_allclose(
        gaits.loss_normal, 0.5 * (hip * np.tan(turn)) ** 2, rtol=1e-12
    )
    np.testing.assert_array_equal(gaits.loss_tangential, 0.0)
    # The impulse goes through the hip.
    np.testing.assert_allclose(
        gaits.friction_demand_heelstrike, np.tan(turn / 2), rtol=1e-12
    )


def test_the_radius_vanishes_as_smoothly_as_the_mass():
    point, small = feet("D", 0.0, False), feet("D", 1e-9, False)
    for name in COMPARED[:5]:
        np.testing.assert_allclose(small[name], point[name], rtol=1e-7)


def test_the_swing_leg_accelerates_as_one_with_mass():
    """The motion of the released foot is measured with the forces' own equations."""
    q, rate = np.array([0.2, 0.2, -0.3, -0.3]), np.array([-0.9, -0.9, 0.4, 0.4])
    keys = {"R": 0.3, "r_s": 0.2, "w_s": 0.05}
    limit, light = (
        Chain(resolve(name, {**keys, **more})).accelerations(
            q, rate, np.array(0.01), False
        )
        for name, more in (("D", {}), ("E", {"foot_mass_ratio": 1e-10}))
    )
    assert limit == pytest.approx(light, rel=1e-8)


def test_a_vanishing_mass_needs_a_place_off_the_hip():
    with pytest.raises(
        StudyError,
        match="`m_s` may vanish only off the hip: the swing leg has no inertia; got 0.0",
    ):
        gaitsweep.gaits("D", 0.01, c_s=-0.5)


def test_steps_are_mapped_and_simulated():
    gait = gaitsweep.gaits("D", 0.009, R=0.3).isel(gait=0)
    state = [
        float(gait[name]) for name in ("stance_angle", "stance_rate", "thigh_rate")
    ]
    mapped = gaitsweep.step_map("D", 0.009, state, R=0.3)
    assert (
        mapped.state == pytest.approx(state, rel=1e-12) and mapped.eigenvalues[2] == 0
    )
    assert mapped.eigenvalues[0] == pytest.approx(
        complex(gait.multiplier_real[0], gait.multiplier_imag[0]), rel=1e-10
    )
    assert gaitsweep.simulate("D", 0.009, state, 20, R=0.3).outcome == "walks"
