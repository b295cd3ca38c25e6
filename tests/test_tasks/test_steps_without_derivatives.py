"""Steps that are evaluated without derivatives, and what is differentiated by them."""

import functools

import numpy as np
import pytest

from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.measures.sensitivities import Rows, by_all_keys
from gaitsweep.tasks.mechanics.kernel import FLOWS
from gaitsweep.tasks.studies.differentiate_gaits import _grounds
from gaitsweep.tasks.walkers.resolve import resolve

SLOPES = np.array([0.01, 0.02])


@functools.cache
def _found(walker):
    return next(_grounds(resolve(walker), SLOPES))


def _gaits(walker):
    problem, Z, _ = _found(walker)
    return problem, Z.copy()


@pytest.mark.parametrize("walker", ["D", "C"])
def test_residuals_without_derivatives_are_those_with_them(walker):
    """Beside gaits, whose own residuals vanish."""
    problem, Z = _gaits(walker)
    Z[1] += 1e-3
    equations = Equations(problem)

    full = evaluate(problem, Z)
    alone = equations.evaluate_values(Z, samples=8)

    assert np.abs(full.residual).max() > 1e-5
    assert np.allclose(alone.residual, full.residual, rtol=0, atol=1e-13)
    assert np.isnan(alone.derivative).all()
    assert np.isnan(alone.jacobians).all()
    assert all(len(phase) == 9 for phase in alone.stride.motion)


def test_steps_in_a_row_are_evaluated_without_derivatives():
    problem, Z = _gaits("C")
    twice = problem.of_steps(2)
    m = problem.m
    first = Z[:m].copy()
    first[1] *= 1.001
    ratio = np.ones_like(Z[:1])
    second = Z[1:m]
    times = Z[m:-1]
    slopes = Z[-1:]
    of_two = np.vstack([first, ratio, second, times, times + times[-1], slopes])

    full = evaluate(twice, of_two)
    alone = Equations(twice).evaluate_values(of_two)

    assert np.abs(full.residual).max() > 1e-5
    assert np.allclose(alone.residual, full.residual, rtol=0, atol=1e-13)


def test_rates_at_impacts_without_derivatives_are_those_of_the_gait():
    problem, Z = _gaits("C")

    full = evaluate(problem, Z).stride
    alone = Equations(problem).evaluate_values(Z).stride

    for name in ("impact", "knee"):
        of_gait = getattr(full, name)
        off = np.abs(getattr(alone, name) - of_gait)
        assert off.max() < 1e-12 * np.abs(of_gait).max()


@pytest.mark.parametrize("name", ["period", "loss_normal"])
def test_differences_of_measures_carry_no_directions(name):
    """Only the gaits themselves are evaluated with them."""
    problem, Z = _gaits("C")
    by_all_keys(problem, Z[:, :1], Rows((name,)))
    before = _flown_with_directions()

    by_all_keys(problem, Z, Rows((name,)))

    phases = 2
    assert _flown_with_directions() - before == phases * Z.shape[1]


def _flown_with_directions():
    return sum(flow.evaluations for key, flow in FLOWS.items() if key[1])
