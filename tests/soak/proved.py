"""The error bound of random gaits beside their proved distance from the true gait."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from gaitsweep.tasks.contract import status
from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.studies import solve_points
from gaitsweep.tasks.walkers.catalogue import CATALOGUE
from gaitsweep.tasks.walkers.walker import Walker
from soak.stress import random_walker

STRAIGHT, KNEED = (
    ("point feet", "round feet", "straight, any", "straight, tuned"),
    ("kneed, near",),
)
LEAST, MOST = 1e-7, 0.3
#: Slopes of one walker.
SLOPES = 12
_NAMES = (
    "stance_angle",
    "stance_rate",
    "thigh_rate",
    "shank_rate",
    "kneestrike_time",
    "period",
    "error_bound",
)


@dataclass
class Proved:
    """Gaits proved: how far each lies from the numbers solved, over its bound (least,
    greatest); refusals by reason.
    """

    nearest: list[float] = field(default_factory=list)
    farthest: list[float] = field(default_factory=list)
    refused: Counter[str] = field(default_factory=Counter)

    @property
    def violations(self) -> int:
        """Gaits whose bound is below their proved distance."""
        return sum(x > 1 for x in self.nearest)

    def __str__(self) -> str:
        worst = (
            f", greatest distance over bound {max(self.farthest):.2g}"
            if self.farthest
            else ""
        )
        refused = (
            ", ".join(f"{n} {reason}" for reason, n in self.refused.items()) or "none"
        )
        return f"{len(self.nearest)} gaits proved, {self.violations} bounds too small{worst}; not proved: {refused}"


def proved(
    gaits: int,
    kneed: bool,
    seed: int = 5,
    jobs: int = 2,
    say: Callable[[str], None] | None = None,
) -> Proved:
    """Prove random gaits, of the catalogue's walkers and of random ones, and compare
    their bounds with the boxes.

    Balls have at least 106 bits, and a box at most a tenth of the bound, so a bound
    that is too small would show.
    """
    outcome = Proved()
    work = Parallel(n_jobs=jobs, return_as="generator", batch_size=4)
    for number, (reason, near, far) in enumerate(
        work(delayed(_compared)(one) for one in _drawn(gaits, kneed, seed)), 1
    ):
        if reason:
            outcome.refused[reason] += 1
        else:
            outcome.nearest.append(near)
            outcome.farthest.append(far)
        if say and number % 500 == 0:
            say(f"{number}: {outcome}")
    return outcome


def _walkers(kneed: bool, seed: int) -> Iterator[Walker]:
    yield from (walker for walker in CATALOGUE.values() if walker.knees == kneed)
    families = KNEED if kneed else STRAIGHT
    number = 1000 * seed
    while True:
        for family in families:
            yield random_walker(family, number)
        number += 1


def _drawn(gaits: int, kneed: bool, seed: int) -> Iterator[dict[str, Any]]:
    """Gaits as the parameters of their proofs."""
    draw, left = np.random.default_rng(seed), gaits
    for walker in _walkers(kneed, seed):
        line = {"walker": walker.table(), "set": {}}
        slope = np.exp(draw.uniform(np.log(LEAST), np.log(MOST), SLOPES))
        out = solve_points.points(
            {"line": line, "slope": slope, "want": _NAMES},
            [solve_points.atlas({"line": line}, [])],
        )
        for i, g in np.argwhere(out["status"] == status.CONVERGED).tolist():
            if not left:
                return
            left -= 1
            yield {
                "walker": walker.table(),
                "slope": float(slope[i]),
                "gait": GAITS[g],
                "accuracy": 1e-12,
                "values": {name: float(out[name][i, g]) for name in _NAMES},
            }


def _compared(params: dict[str, Any]) -> tuple[str, float, float]:
    """Why a gait is not proved, or the least and greatest of its distance over its
    bound.
    """
    from gaitsweep.tasks.proofs.records import distance, proof_of

    _, proof = proof_of(params)
    if not proof.proved:
        return proof.reason.split(":")[0].rstrip("."), 0.0, 0.0
    assert proof.bits >= 106
    assert proof.radius <= params["values"]["error_bound"] / 10
    ratio = distance(proof, params["values"]) / params["values"]["error_bound"]
    return "", float(ratio.lower()), float(ratio.upper())
