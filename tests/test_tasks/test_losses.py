"""Losses keep their digits where a leg weighs next to nothing, and lie within their
bounds.
"""

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

import gaitsweep
from gaitsweep.tasks.measures.losses import contact_mass, heelstrike_losses
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker

WANTED = [
    "loss_normal",
    "loss_tangential",
    "loss_kneestrike",
    "energy_imbalance",
    "heelstrike_rate_ratio",
]
#: Kneed walkers of point masses, whose shank pushes only along the leg as it lands.
POINTS = replace(CATALOGUE["physical"], r_t=0.0, r_s=0.0, w_s=0.0, eps_T=0.0)
WALKERS = {
    **{name: CATALOGUE[name] for name in ("A", "B", "C", "E", "physical")},
    "light feet": resolve("E", {"foot_mass_ratio": 3e-9, "R": 3e-12}),
    "light point feet": resolve("E", {"foot_mass_ratio": 1e-11}),
    "heavy hip": replace(CATALOGUE["A"], m_h=1e10),
    "heavy hip with knees": replace(CATALOGUE["C"], m_h=1e10),
    "no hip": replace(CATALOGUE["B"], m_t=0.0, r_s=0.05),
    "point masses": POINTS,
    "heavy point at the hip": replace(POINTS, m_h=1e9),
}


def exact_losses(
    walker: Walker, angle: float, rates: tuple[float, float]
) -> tuple[mp.matrix, list[mp.mpf]]:
    """Contact mass over the walker's, and losses over weight times leg, by eliminating
    the joints in 80 digits.
    """
    key = {
        name: mp.mpf(value)
        for name, value in walker.table().items()
        if isinstance(value, float)
    }
    below = key["l_s"] - key["R"]
    eps_S = mp.asin(key["l_t"] * mp.sin(key["eps_T"]) / below)
    length = key["l_t"] * mp.cos(key["eps_T"]) + below * mp.cos(eps_S)
    mass = 2 * (key["m_t"] + key["m_s"]) + key["m_h"]

    knee = -1j * key["l_t"] * mp.expj(-key["eps_T"])
    thigh = -mp.mpc(key["w_t"], key["c_t"]) * mp.expj(-key["eps_T"])
    shank = -mp.mpc(key["w_s"], key["c_s"]) * mp.expj(eps_S)
    new, old = mp.expj(mp.mpf(angle)), mp.expj(-mp.mpf(angle))
    hip = 1j * (key["R"] + length * new)
    masses = [key[name] for name in ("m_t", "m_s", "m_h", "m_t", "m_s")]
    # Of each mass by a unit rate of the new leg, the old thigh and the old shank, while
    # the contact stands.
    levers = [
        [hip + thigh * new, hip + (knee + shank) * new, hip, hip, hip],
        [0, 0, 0, thigh * old, knee * old],
        [0, 0, 0, 0, shank * old],
    ]
    moves = mp.matrix(
        [
            [w for lever in row for w in ((1j * lever).real, mp.im(1j * lever))]
            for row in levers
        ]
    )
    weights = mp.diag([m for m in masses for _ in "xy"])
    along = mp.matrix([[1, 0] * 5, [0, 1] * 5])
    turning = [key["m_t"] * key["r_t"] ** 2, key["m_s"] * key["r_s"] ** 2]
    joints = moves * weights * moves.T + mp.diag([sum(turning), *turning])
    coupling = along * weights * moves.T
    if not walker.knees:
        locked = mp.matrix([[1, 0], [0, 1], [0, 1]])
        joints, coupling = locked.T * joints * locked, coupling * locked
    contact = (mass * mp.eye(2) - coupling * joints**-1 * coupling.T) / mass

    leg = length + key["R"]
    first, second = map(mp.mpf, rates)
    x = -(key["R"] + length * mp.cos(angle)) / leg * (first - second)
    velocity = mp.matrix([x, length / leg * mp.sin(angle) * (first + second)])
    values, axes = mp.eigsy(contact)
    normal = int(abs(axes[1, 1]) > abs(axes[1, 0]))
    losses = [
        values[k] * (axes[:, k].T * velocity)[0] ** 2 / 2 for k in (normal, 1 - normal)
    ]
    return contact, losses


@pytest.mark.parametrize("name", WALKERS)
def test_losses_keep_their_digits_however_light_a_leg_is(name):
    walker, angle, rates = WALKERS[name], 1e-3, (-1.1e-3, 2e-4)

    with mp.workdps(80):
        contact, expected = exact_losses(walker, angle, rates)
        exact = np.array(contact.tolist(), float)
        losses = [float(each) for each in expected]

    found = contact_mass(walker, np.array([angle]))[0]
    np.testing.assert_allclose(found, exact, rtol=1e-13, atol=1e-17)
    split = heelstrike_losses(walker, np.array([angle]), np.array(rates)[:, None])
    np.testing.assert_allclose(np.ravel(split), losses, rtol=1e-12)


@pytest.mark.parametrize(
    ("walker", "slope", "keys"),
    [
        pytest.param(
            "E",
            [1e-16, 1e-12],
            {"foot_mass_ratio": 3e-9, "R": 3e-12},
            marks=pytest.mark.thorough,
        ),
        ("E", [1e-9, 1e-3], {"foot_mass_ratio": 1e-10}),
        ("A", [1e-10, 1e-3], {"m_h": 1e10}),
        ("C", [1e-4, 1e-2], {"m_h": 1e8}),
    ],
)
def test_the_energy_balance_of_light_legs_lies_within_its_bound(walker, slope, keys):
    gaits = gaitsweep.gaits(walker, slope, variables=WANTED, **keys)

    assert is_balanced(gaits) >= len(slope)


def is_balanced(gaits) -> int:
    """Check that losses balance the drop within the bound that docs/trust.md states;
    the number of gaits.
    """
    bound = 4 * (1 + np.abs(gaits.heelstrike_rate_ratio)) * gaits.error_bound
    found = gaits.energy_imbalance.notnull()
    assert (np.abs(gaits.energy_imbalance) <= bound).where(found, True).all()
    return int(found.sum())


@pytest.mark.thorough
def test_the_energy_balance_of_random_extreme_walkers_lies_within_its_bound():
    random, count = np.random.default_rng(20261128), 0
    for name, knees in (("E", False), ("B", False), ("A", False), ("C", True)):
        for _ in range(15):
            keys = {"m_h": 10 ** random.uniform(-2, 10)}
            if not knees:
                keys["R"] = 10 ** random.uniform(-12, -0.8)
            if name == "E":
                keys = {
                    "foot_mass_ratio": 10 ** random.uniform(-11, -0.5),
                    "R": keys["R"],
                }
            slope = 10 ** random.uniform(-15, -1.5, 2)

            count += is_balanced(
                gaitsweep.gaits(name, np.sort(slope), variables=WANTED, **keys)
            )
    assert count > 60
