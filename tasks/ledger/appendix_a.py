"""Appendix A of the paper: the assumptions of the model, and by how much the simulated
gaits violate them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gaitsweep.tasks.contract.registry import VARIABLES, VIOLATIONS
from gaitsweep.tasks.ledger.claim import REPRODUCED, Found, claim, found, verdict
from gaitsweep.tasks.ledger.lines import BOTH, LONG, SHORT, Arrays, Paper, memoize
from gaitsweep.tasks.ledger.rounding_intervals import interval

_WANT = ("stance_angle", *(v for v in VARIABLES if VARIABLES[v].group == "violations"))
#: Walkers and slopes of the paper's figures, whose gaits are examined.
_WALKERS = ("A", "B", "C", "D", "E", "physical", "physical-straight")
_SLOPES = (1e-5, 1e-4, 1e-3, 0.01, 0.02, 0.025, 0.03, 0.036, 0.045, 0.06, 0.1)
_STRAIGHT = ("A", "B", "D", "E", "physical-straight")
_KNEED = ("C", "physical")


@memoize
def _measure(paper: Paper, walker: str, slopes: tuple[float, ...]) -> Arrays:
    return paper.line(walker).at(list(slopes), _WANT)


def _of_figure_3(paper: Paper) -> dict[str, float]:
    """Violations of the gait of figure 3."""
    gait = _measure(paper, "physical", (0.036,))
    return {name: float(v[0, LONG]) for name, v in gait.items() if v.ndim == 2}


def _flags(gaits: Arrays, name: str) -> np.ndarray:
    """Whether each existing gait violates an assumption at all, by however little,
    shape (n,).
    """
    exists = np.isfinite(gaits["stance_angle"])
    violation = VIOLATIONS[name]
    of_gaits = [gaits[amount][exists] for amount in violation.amounts]
    amounts = np.array(of_gaits)
    violated = amounts < 0 if violation.is_least else amounts > 0
    return np.asarray(violated.any(axis=0))


def _flags_of(paper: Paper, walkers: tuple[str, ...], name: str) -> np.ndarray:
    """The same of the gaits of some walkers."""
    flags = [_flags(_measure(paper, walker, _SLOPES), name) for walker in walkers]
    return np.concatenate(flags)


@claim("A1")
def scuffing(paper: Paper) -> Found:
    """Count the gaits whose swing foot scuffs."""
    straight = _flags_of(paper, _STRAIGHT, "scuff")
    kneed = _flags_of(paper, _KNEED, "scuff")
    depth = _of_figure_3(paper)["scuff_depth"]

    return found(
        verdict(straight.all() and not kneed.all()),
        depth,
        depth=1e3 * depth,
        straight=(straight.sum(), len(straight)),
        kneed=(kneed.sum(), len(kneed)),
    )


@claim("A2")
def unlocking(paper: Paper) -> Found:
    """Evaluate impulses and torque on the stance knee of the gait of figure 3."""
    amounts = _of_figure_3(paper)
    impulse = amounts["unlocking_impulse_kneestrike"]
    torque = amounts["unlocking_torque"]
    return found(verdict(impulse > 0 and torque < 0, impulse > 0), impulse, **amounts)


@claim("A3")
def tension(paper: Paper) -> Found:
    """Evaluate the least normal force and the friction that gaits demand."""
    walkers = (*_STRAIGHT, *_KNEED)
    gaits = [_measure(paper, walker, _SLOPES) for walker in walkers]
    least = min(np.nanmin(gait["least_normal_force"]) for gait in gaits)
    tense = _flags_of(paper, walkers, "contact_tension").sum()
    holds = verdict(least > 0 and not tense, least > 0)
    amounts = _of_figure_3(paper)
    return found(holds, least, names=[*walkers], tense=tense, **amounts)


@claim("A4")
def hyperextension(paper: Paper) -> Found:
    """Locate the slopes at which the released knee begins to hyperextend."""
    release = paper.line("physical").special_of("release_hyperextension")[0]
    tuned = {
        f"{label} step": interval(paper, f"C release, {label}").value for label in BOTH
    }
    bent = _measure(paper, "C", (1e-4,))["hyperextension"]

    return found(
        REPRODUCED,
        release["slope"],
        release=release,
        tuned=tuned,
        deep=bent[0, [LONG, SHORT]],
    )


def _count(paper: Paper, name: str) -> dict[str, Any]:
    """Number of gaits that violate an assumption, number of all gaits, and both by
    walker in words.
    """
    by_walker = {}
    for walker in _WALKERS:
        flags = _flags_of(paper, (walker,), name)
        by_walker[walker] = f"{flags.sum()} of {len(flags)}"
    flags = _flags_of(paper, _WALKERS, name)
    return {"count": flags.sum(), "total": len(flags), "by_walker": by_walker}


@claim("A5")
def penetration(paper: Paper) -> Found:
    """Count the gaits whose released foot penetrates the ground."""
    counts = _count(paper, "release_penetrates")
    at_steep = _measure(paper, "physical-straight", (0.3,))
    steep = 1e3 * np.nanmax(at_steep["penetration_depth"])
    holds = verdict(counts["count"] > 0)
    return found(holds, counts["count"], steep=steep, **counts)


@claim("A6")
def trailing_foot(paper: Paper) -> Found:
    """Count the gaits in which simultaneous contact of both feet would push the
    trailing foot.
    """
    counts = _count(paper, "trailing_foot_pulls")
    count = counts["count"]
    at_steep = _measure(paper, "physical-straight", (0.3,))
    steep = np.nanmax(at_steep["trailing_impulse"])
    holds = verdict(count == 0, count < counts["total"] / 10)
    return found(holds, count, steep=steep, **counts)
