"""What must be computed and kept for a wanted accuracy. Like the registry, it imports
no solver.
"""

import math
from collections.abc import Iterable

from gaitsweep.tasks.contract.registry import (
    ALWAYS,
    COSTLY,
    SENSITIVITIES,
    VARIABLES,
    admit,
)

#: Variables that only integrated steps have: a study with an accuracy names them if it
#: wants them.
OF_INTEGRATION = tuple(
    v.name for v in VARIABLES.values() if not v.is_smooth and v.group not in COSTLY
)
#: Accuracies that may be asked for.
ACCURACIES = (1e-15, 1e-2)
#: Most accurate bound that polynomials reach, with some margin.
INTERPOLATED_FROM = 1e-11
#: Bits of a double after the first.
MANTISSA = 52
#: Nodes of a panel, besides one for each digit wanted.
_NODES = 4
#: Nodes of a panel of derivatives, and how many times as many slopes as gaits are
#: differentiated for their panels lines have that polynomials serve.
DERIVATIVE_NODES, _FEWER = 16, 4


def always(accuracy: float) -> tuple[str, ...]:
    """Variables that are archived whatever a study wants: with an accuracy none that
    would have to be integrated.
    """
    return tuple(name for name in ALWAYS if not (accuracy and name in OF_INTEGRATION))


def computed(names: Iterable[str], accuracy: float) -> tuple[str, ...]:
    """Those of some names that are variables, with those that are archived in any case,
    in the archive's order.
    """
    wanted = {*names, *always(accuracy)}
    admit(wanted)
    return tuple(name for name in VARIABLES if name in wanted)


def nodes_for(accuracy: float) -> int:
    """Number of nodes of a panel; one more gait than that is integrated to check it."""
    return _NODES + round(-math.log10(accuracy))


def is_charted(slopes: int, span: float) -> bool:
    """Whether polynomials may give the derivatives of gaits: a line has several times
    as many slopes as they take.

    Parameters
    ----------
    slopes : int
        Of the line.
    span : float
        Its range of ln slope.
    """
    return slopes >= _FEWER * charted_from(span)


def charted_from(span: float) -> int:
    """Number of slopes of a range of ln slope, of so many gaits, whose derivatives
    polynomials take.
    """
    return (math.ceil(span) + 1) * (2 * DERIVATIVE_NODES + 1)


def significant_bits(accuracy: float) -> int:
    """Bits after the first to which numbers are kept, so that rounding is at most a
    sixteenth of the accuracy.
    """
    return min(MANTISSA, 3 + math.ceil(-math.log2(accuracy))) if accuracy else MANTISSA


def is_converted(want: Iterable[str], accuracy: float) -> bool:
    """Whether the gaits of a walker that differs only in its units give the wanted ones:
    none is proved, differentiated, or measured by another package, or rounded to an accuracy.
    """
    return not accuracy and not any(
        VARIABLES[name].group in ("proofs", SENSITIVITIES) or VARIABLES[name].measure
        for name in want
    )


def is_interpolated(want: Iterable[str], accuracy: float) -> bool:
    """Whether polynomials may give the points: all variables are smooth, and the
    accuracy is within their reach.
    """
    return accuracy >= INTERPOLATED_FROM and all(
        VARIABLES[name].is_smooth for name in want
    )
