"""Onsets of violations as conditions on gaits: where the amount by which a gait violates
an assumption of the model has just its limit.

An amount that may only be 0 or more does not tell how far a gait is from violating an
assumption. Where its limit is 0, what passes 0 there takes its place: the least height of
the foot, and the rates with which a knee or a foot that is released begins to move.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.branches.conditions import CONDITIONS, Condition, Scalar
from gaitsweep.tasks.branches.joint import Evaluation
from gaitsweep.tasks.contract.registry import VARIABLES, VIOLATIONS
from gaitsweep.tasks.measures.levels import Measures, level
from gaitsweep.tasks.measures.names import measures
from gaitsweep.tasks.walkers.walker import Walker

#: How tables call conditions of this module.
ONSET = "onset"
#: Conditions at which amounts that are never below 0 begin.
_BEGINS = {
    "scuff_depth": level("foot_clearance", 0.0),
    "hyperextension": CONDITIONS["release_hyperextension"],
    "penetration_depth": CONDITIONS["release_penetration"],
    "trailing_impulse": CONDITIONS["release_penetration"],
}


def onsets(
    names: Sequence[str], walker: Walker, limits: Mapping[str, float]
) -> dict[str, Condition]:
    """Return the conditions at which violations begin, by what tables call them: one for
    each amount that gaits of a walker have.

    Parameters
    ----------
    names : sequence of str
        Of violations, or `all`.
    walker : Walker
    limits : mapping
        Limits other than the registry's, by the names of violations.
    """
    wanted = [*VIOLATIONS] if "all" in names else names
    return {
        f"{ONSET}_of_{amount}": condition
        for amount, condition in _of_amounts(wanted, walker, limits)
    }


def _of_amounts(
    names: Sequence[str], walker: Walker, limits: Mapping[str, float]
) -> Iterator[tuple[str, Condition]]:
    """Amounts of violations that a walker has, and the conditions that they begin."""
    limited = [*limited_amounts(names, walker, limits)]
    taken = Measures([amount for amount, _, _ in limited])
    for amount, limit, _ in limited:
        if limit == 0 and amount in _BEGINS:
            yield amount, replace(_BEGINS[amount], name=ONSET)
            continue

        scalar = over_size(taken.scalar(amount), amount)
        yield amount, Condition(ONSET, scalar, target=limit)


def limited_amounts(
    names: Iterable[str], walker: Walker, limits: Mapping[str, float]
) -> Iterator[tuple[str, float, int]]:
    """Yield the amounts of violations that gaits of a walker have, the limit of each,
    and on which side of it gaits are without the violation: 1 above it, -1 below.

    Parameters
    ----------
    names : iterable of str
        Of violations.
    walker : Walker
    limits : mapping
        Limits other than the registry's, by the names of violations.
    """
    known = measures(walker)
    for name in names:
        violation = VIOLATIONS[name]
        limit = limits.get(name, violation.limit)
        signed, side = (-limit, 1) if violation.is_least else (limit, -1)
        for amount in violation.amounts:
            if amount in known:
                yield amount, signed, side


def over_size(scalar: Scalar, amount: str) -> Scalar:
    """Return an amount of a violation over the leg, the mass and g of its walker, as its
    limit is counted.

    Parameters
    ----------
    scalar : callable
        The amount of gaits that are evaluated, shape (n,) [the walker's units].
    amount : str
    """

    def measured(at: Evaluation) -> ndarray:
        walkers = at.problem.every_walker
        units = walkers.leg, walkers.total_mass, walkers.time_unit
        return np.asarray(scalar(at) / VARIABLES[amount].unit(*units))

    return measured
