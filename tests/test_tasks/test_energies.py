"""The equations of motion are Lagrange's equations of the energies of figure 1."""

import heyoka as hy
import numpy as np
import pytest

from gaitsweep.tasks.mechanics.energies import energies, hip_forces
from gaitsweep.tasks.mechanics.equations import Motion, Solver, Symbols
from gaitsweep.tasks.mechanics.lumped import general_structure_of, lump
from gaitsweep.tasks.walkers.resolve import resolve

SLOPE = 0.07
HIP = {"hip_stiffness": 0.4, "hip_rest": 0.2, "hip_damping": 0.3, "hip_torque": 0.1}
STATES = np.random.default_rng(1).uniform(-0.5, 0.5, (6, 20))


def variables(links):
    """Angles and rates as symbols."""
    q = [f"q{i}" for i in range(links)]
    rate = [f"v{i}" for i in range(links)]

    return list(hy.make_vars(*q)), list(hy.make_vars(*rate))


def accelerations_by_lagrange(walker, links):
    """Accelerations (links, n) over g/leg at states with rates in sqrt(g/leg)."""
    q, rate = variables(links)
    kinetic, potential = energies(walker, q, rate, hy.expression(SLOPE))
    equations = hy.lagrangian(kinetic - potential, q, rate)
    accelerations = [right for _, right in equations[links:]]

    if walker.has_hip_torque:
        gained = added(kinetic, rate, hip_forces(walker, rate))
        accelerations = [a + b for a, b in zip(accelerations, gained, strict=True)]
    function = hy.cfunc(accelerations, vars=[*q, *rate])

    time = walker.time_unit
    states = STATES[: 2 * links].copy()
    states[links:] /= time

    return function(states) * time**2


def added(kinetic, rate, forces):
    """Accelerations that generalised forces add, by the mass matrix of an energy."""
    momenta = [hy.diff(kinetic, v) for v in rate]
    matrix = [[hy.diff(momentum, v) for v in rate] for momentum in momenta]

    return Solver(matrix)(forces)


def accelerations_as_integrated(walker, links):
    """The same by the lumped equations from which flows are compiled."""
    structure = general_structure_of(walker)
    p = Symbols(structure)
    q, rate = variables(links)
    motion = Motion(p, q, rate, free_knee=links == 3)
    accelerations = Solver(motion.M)(motion.f)
    function = hy.cfunc(accelerations, vars=[*q, *rate, *p.variables])

    known = {"slope": SLOPE, "scale": 1.0, **lump(walker)}
    lanes = STATES.shape[1]
    parameters = [np.full(lanes, known[name]) for name in structure.parameters]

    return function(np.vstack([STATES[: 2 * links], *parameters]))


@pytest.mark.parametrize(
    ("name", "changes", "links"),
    [
        ("physical", {}, 3),
        ("physical", {"m_h": 3.0, "eps_T": 0.25, "w_t": 0.01}, 3),
        ("C", {}, 2),
        ("A", {"w_s": 0.03}, 2),
        ("B", {"R": 0.3}, 2),
        ("B", HIP, 2),
        ("C", HIP, 3),
        ("physical", {**HIP, "trailing_knee": "locked", "push_off": 0.1}, 3),
    ],
)
def test_the_motion_that_is_integrated_is_that_of_the_energies(name, changes, links):
    walker = resolve(name, changes)

    by_lagrange = accelerations_by_lagrange(walker, links)
    integrated = accelerations_as_integrated(walker, links)

    largest = np.abs(by_lagrange).max()
    np.testing.assert_allclose(
        integrated,
        by_lagrange,
        rtol=0,
        atol=1e-12 * largest,
    )
