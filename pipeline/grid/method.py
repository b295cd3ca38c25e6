"""The methods by which gaits of lines are computed, and the variables that they
compute.
"""

from enum import StrEnum

import numpy as np

from gaitsweep.pipeline.study.model import Axis, Study
from gaitsweep.tasks.contract import accuracy
from gaitsweep.tasks.contract.registry import READS, SHORT_LINE, TASKS, VARIABLES


class Method(StrEnum):
    """How the gaits of a line are computed.

    `TASK` is that of studies of another kind than `grid`, whose lines have no points.
    Others name the cost of a point.
    """

    LONG = "long"  # an atlas for each line, from which chunks of its points are solved
    CYCLES = "cycles"  # the same for gaits of several steps
    # From a coarse atlas, by polynomials where these are accurate enough.
    INTERPOLATED = "interpolated"
    SHORT = "short"  # atlases, coarse ones, and points of lines side by side
    # The same for a line by itself, whose atlas is kept for other slopes: in memory.
    ALONE = "alone"
    # Lines side by side, their gaits predicted by charts over a plane of keys.
    PLANE = "plane"
    # Lines side by side, their gaits sought at values of a measure.
    TARGETS = "targets"
    TASK = "task"

    @property
    def is_of_lines(self) -> bool:
        """Whether a job computes several lines side by side, each at all its slopes."""
        return self in (Method.SHORT, Method.PLANE, Method.TARGETS)

    @property
    def is_coarse(self) -> bool:
        """Whether atlases are coarse: too few points are solved from each to pay for a
        fine one.
        """
        return self.is_of_lines or self in (Method.ALONE, Method.INTERPOLATED)


def variables(study: Study) -> tuple[str, ...]:
    """Point variables to compute: those requested, and those that requested fits,
    figures and claims read.
    """
    named = set(study.variables)
    for reader in _readers(study):
        named.update(READS.get(reader, ()))
    return accuracy.computed(named, study.accuracy)


def scaling_axes(study: Study) -> tuple[Axis, ...]:
    """Axes along which the gaits of a grid are solved once, and converted."""
    is_converted = accuracy.is_converted(variables(study), study.accuracy)
    return study.scaling if is_converted else ()


def is_interpolated(study: Study) -> bool:
    """Whether polynomials over slopes, or what else drives, may give the points: a line
    has many, of smooth variables, and they suffice.
    """
    if len(study.values_along) <= SHORT_LINE:
        return False
    return accuracy.is_interpolated(variables(study), study.accuracy)


def is_charted(study: Study, method: Method) -> bool:
    """Whether polynomials over slopes may give the derivatives of gaits."""
    if study.drive:
        return False
    down = study.values_along[study.values_along > 0]
    if method is not Method.LONG or not len(down):
        return False
    return accuracy.is_charted(len(down), span(study))


def span(study: Study) -> float:
    """Range of ln slope of a study, of the slopes that lead down."""
    down = study.values_along[study.values_along > 0]
    return float(np.log(down.max() / down.min()))


def wants_points_alone(study: Study) -> bool:
    """Whether no atlas is read, and no proof wanted."""
    for reader in _readers(study):
        for read in (reader, *READS.get(reader, ())):
            if read in TASKS and read != "points" and "atlas" in TASKS[read].needs:
                return False
    groups = {VARIABLES[name].group for name in study.variables}
    return "proofs" not in groups


def _readers(study: Study) -> tuple[str, ...]:
    """What a study wants that may read tasks: fits, figures and claims."""
    readers = (*study.fits, *study.figures, *study.claims)
    return (*readers, "claims") if study.claims else readers
