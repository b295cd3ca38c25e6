"""Walkers that can walk on vanishing slopes (sections 5.3 and 8 of the paper, figure
11).
"""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.branches.root import bracketed_root
from gaitsweep.tasks.gaits.multipliers import multipliers
from gaitsweep.tasks.gaits.newton import newton
from gaitsweep.tasks.ledger.claim import PRINTED, Found, claim, farthest, found, verdict
from gaitsweep.tasks.ledger.lines import LONG, SHORT, Arrays, Paper, memoize
from gaitsweep.tasks.ledger.rounding_intervals import interval
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.walkers.resolve import resolve

#: Walkers of figure 11.
WALKERS = ("A", "B", "C", "D", "E")
#: A slope [rad] small enough for the limiting laws, and still far above rounding.
VANISHING = 1e-9


@claim("Z1")
def arbitrarily_small(paper: Paper) -> Found:
    """Solve both gaits at the smallest slopes that double precision resolves."""
    least = max(paper.line(w).reaches[0].max() for w in WALKERS)
    solved = [(paper.line(w).at([1e-10])["status"][0, :2] == 0).all() for w in WALKERS]
    return found(verdict(all(solved) and least < 1e-12), least)


@claim("Z2")
def only_simplest(paper: Paper) -> Found:
    """Compute the exponents of both gaits at a vanishing slope."""
    long, short = (paper.exponents(WALKERS, gait, VANISHING) for gait in (LONG, SHORT))
    both = [w for w in WALKERS if farthest([long[w], short[w]], 1 / 3) < 0.01]
    return found(verdict(both == ["D"]), short["D"], long=long, short=short)


@claim("Z3")
def two_laws(paper: Paper) -> Found:
    """Compute the exponents of A, B and E at vanishing and at larger slopes."""
    long, short = (paper.exponents("ABE", gait, VANISHING) for gait in (LONG, SHORT))
    small = all(abs(long[w] - 1 / 3) < 0.01 and abs(short[w] - 1) < 0.01 for w in "ABE")
    middle, large = (paper.exponents("ABE", SHORT, slope) for slope in (0.01, 0.1))
    above = paper.exponents("ABE", LONG, 0.01)
    at_middle = farthest(middle.values(), 1 / 3)
    at_large = farthest(large.values(), 1 / 3)
    holds = verdict(small and at_middle < 0.05, small and at_large < 0.1)

    return found(
        holds,
        middle["E"],
        long=long,
        short=short,
        middle=middle,
        large=large,
        above=above,
    )


@claim("Z4")
def turns_linear(paper: Paper) -> Found:
    """Locate the slope at which the local exponent of C's long step is midway between
    both laws.
    """
    mark = interval(paper, "C exponent 2/3")
    at = {f"{s:g}": paper.line("C").exponent(LONG, s) for s in (1e-6, 1e-5, 1e-4, 1e-3)}
    return found(
        PRINTED["Z4"].compare(*mark.bounds),
        *mark.bounds,
        half=_half_knee_loss(paper),
        at=at,
    )


def _half_knee_loss(paper: Paper) -> float:
    """Slope at which kneestrike accounts for half of the energy that C's long step
    loses [rad].
    """
    losses = ("loss_normal", "loss_tangential", "loss_kneestrike")

    def excess(gaits: Arrays) -> np.ndarray:
        return (
            2
            * gaits["loss_kneestrike"][:, LONG]
            / sum(gaits[k][:, LONG] for k in losses)
            - 1
        )

    return paper.line("C").crossing(excess, losses)


@memoize
def mass_limit(paper: Paper) -> float:
    """Find the largest foot mass ratio whose long step is stable at a vanishing slope.

    Raises
    ------
    ArithmeticError
        If Newton's method loses that step.
    """
    gaits, q = paper.line("E"), np.array([np.log(VANISHING)])
    long = next(
        Z
        for b in gaits.branches
        for _, Z, _ in b.guesses(q)
        if not gaits.is_short(Z[:, 0])
    )
    w = long[:-1]

    def solve(ratio: float, guess: np.ndarray) -> tuple[np.ndarray, float]:
        problem = Problem(resolve("E", {"foot_mass_ratio": ratio}))
        solution, converged = newton(problem, guess, q)
        if not converged.all():
            raise ArithmeticError(
                f"Newton's method does not converge at a foot mass ratio of {ratio:g}"
            )

        return solution, float(
            np.abs(
                multipliers(problem.stride(solution, q)[0].jacobian, problem.m)
            ).max()
            - 1
        )

    # At vanishing slopes Newton's basin is narrow: small steps from E's own foot mass.
    for ratio in np.arange(0.0995, 0.0948, -5e-4):
        w, _ = solve(float(ratio), w)
    return bracketed_root(lambda ratio: solve(ratio, w)[1], 0.0947, 0.0953, 1e-9)


def _stability_limit(paper: Paper, walker: str) -> float:
    """Slope below which a walker's long step is stable, down to 1e-8; 0 where it is not
    stable there [rad].
    """

    def excess(gaits: Arrays) -> np.ndarray:
        return np.asarray(gaits["spectral_radius"][:, LONG] - 1)

    gaits = paper.line(walker)
    return (
        gaits.crossing(excess, ("spectral_radius",))
        if excess(gaits.grid())[0] < 0
        else 0.0
    )


@claim("Z5")
def stable_below(paper: Paper) -> Found:
    """Locate the slope at which each long step loses stability, and the foot mass that
    allows it any.
    """
    limit = {name: _stability_limit(paper, name) for name in (*WALKERS, "F")}
    unstable = [name for name, slope in limit.items() if not slope > 0]
    least = {
        name: paper.line(name).grid()["spectral_radius"][:, LONG].min()
        for name in unstable
    }
    ranges = [
        f"{name} to {slope:.6g} rad"
        if slope > 0
        else f"{name} nowhere (spectral radius at least {least[name]:.4f})"
        for name, slope in limit.items()
    ]
    return found(verdict(not unstable), mass_limit(paper), ranges=ranges)
