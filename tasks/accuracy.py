"""What an accuracy leaves to do and to keep. Like the registry, it imports no solver."""

import math
from collections.abc import Iterable

from tasks.registry import ALWAYS, COSTLY, VARIABLES

#: What is known only of steps that are integrated: a study of an accuracy names them if it wants them.
OF_INTEGRATION = ("residual", "energy_imbalance")


def always(accuracy: float) -> tuple[str, ...]:
    """Variables that are archived whatever a study wants: with an accuracy none that would have to be integrated."""
    return tuple(name for name in ALWAYS if not (accuracy and name in OF_INTEGRATION))


#: Accuracies that may be asked for; most accurate bound that polynomials reach, with some margin.
ACCURACIES, INTERPOLATED_FROM = (1e-15, 1e-2), 1e-11


#: Bits of a double after the first.
MANTISSA = 52


def significant_bits(accuracy: float) -> int:
    """Bits after the first that numbers of an accuracy keep: rounding to them is at most a sixteenth of it."""
    return min(MANTISSA, 3 + math.ceil(-math.log2(accuracy))) if accuracy else MANTISSA


def is_interpolated(want: Iterable[str], accuracy: float) -> bool:
    """Whether polynomials may give points of long lines: wanted variables are smooth, and the accuracy in reach."""
    want = set(want)
    flown = {VARIABLES[name].group for name in want} & set(COSTLY) or want & set(OF_INTEGRATION)
    return accuracy >= INTERPOLATED_FROM and not flown
