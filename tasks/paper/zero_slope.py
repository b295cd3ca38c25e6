"""Walkers that can walk on vanishing slopes (sections 5.3 and 8 of the paper, figure 11)."""

from __future__ import annotations

import functools

import numpy as np
from scipy.optimize import brentq

from tasks.fixed_points.multipliers import multipliers
from tasks.fixed_points.newton import newton
from tasks.paper.claim import ClaimResult, claim, verdict, within
from tasks.paper.lines import LONG, SHORT, line, numbers, root
from tasks.paper.rounding_intervals import interval
from tasks.step.problem import Problem
from tasks.walkers.resolve import resolve

WALKERS = ("A", "B", "C", "D", "E")
#: A slope small enough for the last of the laws, and still far above rounding.
VANISHING = 1e-9


def limits(gait: int) -> dict[str, float]:
    """Exponents of the step length of every tuned walker at a vanishing slope."""
    return {w: line(w).exponent(gait, VANISHING) for w in WALKERS}


@claim(
    "Z1",
    "all of A to E walk on arbitrarily small slopes",
    "section 5.3, 1",
    "figure11/loglog",
    "gaitsweep run data/studies/paper/figure11.toml",
)
def arbitrarily_small() -> ClaimResult:
    least = {w: max(float(np.exp(b.q.min())) for b in line(w).branches) for w in WALKERS}
    both = {w: line(w).at([1e-10])["status"][0, :2] for w in WALKERS}
    return ClaimResult(
        f"both gaits solved at 1e-10, and their branches followed to {max(least.values()):.0e}, where "
        f"double precision ends",
        verdict(all((s == 0).all() for s in both.values()) and max(least.values()) < 1e-12),
        max(least.values()),
    )


@claim(
    "Z2",
    "only D has both step lengths ~ slope^(1/3)",
    "section 5.3, 2",
    "figure11/loglog",
    "gaitsweep run data/studies/paper/figure11.toml",
)
def only_simplest() -> ClaimResult:
    long, short = limits(LONG), limits(SHORT)
    both = [w for w in WALKERS if max(abs(long[w] - 1 / 3), abs(short[w] - 1 / 3)) < 0.01]
    return ClaimResult(
        f"exponents at {VANISHING:g}: long {numbers(long)}; short {numbers(short)}", verdict(both == ["D"]), short["D"]
    )


@claim(
    "Z3",
    "A, B, E: short ~ slope and long ~ slope^(1/3) at the smallest slopes, all ~ slope^(1/3) above 0.01",
    "section 5.3, 3",
    "figure11/loglog",
    "gaitsweep run data/studies/paper/figure11.toml",
)
def two_laws() -> ClaimResult:
    long, short = limits(LONG), limits(SHORT)
    small = all(abs(long[w] - 1 / 3) < 0.01 and abs(short[w] - 1) < 0.01 for w in "ABE")
    at = {s: {w: line(w).exponent(SHORT, s) for w in "ABE"} for s in (0.01, 0.1)}
    above = {w: line(w).exponent(LONG, 0.01) for w in "ABE"}
    off = max(abs(p - 1 / 3) for p in at[0.1].values())
    worst = max(abs(p - 1 / 3) for p in at[0.01].values())
    return ClaimResult(
        f"at {VANISHING:g} long {numbers({w: long[w] for w in 'ABE'})}, short "
        f"{numbers({w: short[w] for w in 'ABE'})}; short at 0.01 {numbers(at[0.01], 3)}, at 0.1 "
        f"{numbers(at[0.1], 3)}; long at 0.01 {numbers(above, 3)}",
        verdict(small and worst < 0.05, small and off < 0.1),
        at[0.01]["E"],
    )


@claim(
    "Z4",
    "C's long step turns linear near slope 0.00015",
    "section 5.3, 4",
    "figure11/loglog",
    "gaitsweep solve --walker C --slope 1.523e-4 --json",
)
def turns_linear() -> ClaimResult:
    found = interval("C exponent 2/3")
    half = knee_half()
    at = {f"{s:g}": line("C").exponent(LONG, s) for s in (1e-6, 1e-5, 1e-4, 1e-3)}
    return ClaimResult(
        f"local exponent passes 2/3, midway between the laws, at {found.value:.4e}; kneestrike takes half "
        f"of the loss at {half:.4e}; exponents at {numbers(at, 3)}",
        within(0.00015, found.low, found.high),
        found.value,
        found.low,
        found.high,
    )


def knee_half() -> float:
    """The slope at which kneestrike takes half of the energy C's long step loses."""
    own, losses = line("C"), ("loss_normal", "loss_tangential", "loss_kneestrike")

    def excess(slope: float) -> float:
        found = own.at([slope], losses)
        return float(2 * found[losses[2]][0, LONG] / sum(found[k][0, LONG] for k in losses) - 1)

    grid = own.grid()
    whole = sum(grid[k][:, LONG] for k in losses)
    return root(excess, grid["slope"], 2 * grid[losses[2]][:, LONG] / whole - 1)


@functools.lru_cache(maxsize=2)
def mass_limit(slope: float = 1e-9) -> float:
    """The heaviest foot, over the total mass, whose long step is stable as the slope vanishes."""
    own, at = line("E"), np.array([np.log(slope)])
    long = [Z for b in own.branches for _, Z, _ in b.guesses(at) if not own.short(Z[0])][0]
    w = np.delete(long, own.problem.m, axis=1).T

    def solved(ratio: float, w: np.ndarray) -> tuple[np.ndarray, float]:
        problem = Problem(resolve("E", {"foot_mass_ratio": ratio}))
        found = newton(problem, w, at).w
        return found, float(np.abs(multipliers(problem.stride(found, at)[0].jacobian, problem.m)).max() - 1)

    # At vanishing slopes Newton's basin is narrow: small steps from E's own foot mass.
    for ratio in np.arange(0.0995, 0.0948, -5e-4):
        w, _ = solved(float(ratio), w)
    return float(brentq(lambda ratio: solved(ratio, w)[1], 0.0947, 0.0953, xtol=1e-9))


def stability_limit(walker: str) -> float:
    """The slope down from which a walker's long step is stable to 1e-8; 0 where it is not."""
    own = line(walker)

    def excess(slope: float) -> float:
        return float(own.at([slope], ("spectral_radius",))["spectral_radius"][0, LONG] - 1)

    grid = own.grid()
    values = grid["spectral_radius"][:, LONG] - 1
    return root(excess, grid["slope"], values) if values[0] < 0 else 0.0


@claim(
    "Z5",
    "every tuned long step is stable below some slope",
    "section 5.3, 5",
    "figure11/linear",
    "gaitsweep solve --walker E --slope 1e-4 --json",
)
def stable_below() -> ClaimResult:
    limit = {name: stability_limit(name) for name in (*WALKERS, "F")}
    unstable = [name for name, slope in limit.items() if not slope > 0]
    said = [
        f"{name} to {slope:.6g}"
        if slope > 0
        else f"{name} nowhere (its largest multiplier is at least "
        f"{line(name).grid()['spectral_radius'][:, LONG].min():.4f})"
        for name, slope in limit.items()
    ]
    return ClaimResult(
        f"stable from 1e-8 up: {', '.join(said)}; as the slope vanishes point feet are stable only below a "
        f"foot mass of {mass_limit():.5f} of the total, and E has 0.1",
        verdict(not unstable),
        mass_limit(),
    )
