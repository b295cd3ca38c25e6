"""By which method the gaits of a study's lines are computed: decided here, once."""

import math
from enum import StrEnum

from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks import accuracy
from gaitsweep.tasks.costs import ALONE, COSTS, FEW, POINTS, Cost
from gaitsweep.tasks.registry import READS, SHORT_LINE, TASKS, VARIABLES


class Method(StrEnum):
    """How the gaits of a line are computed.

    `TASK` is that of studies of another kind than `grid`, whose lines have no points. Others name the cost of a point.
    """

    LONG = "long"  # an atlas for each line, from which chunks of its points are solved
    CYCLES = "cycles"  # the same for gaits of several steps
    INTERPOLATED = "interpolated"  # from a coarse atlas, by polynomials where these are accurate enough
    SHORT = "short"  # atlases, coarse ones, and points of lines side by side
    ALONE = "alone"  # the same for a line by itself, whose atlas is kept for other slopes: in memory
    PLANE = "plane"  # lines side by side, their gaits predicted by charts over a plane of keys
    TASK = "task"

    @property
    def is_of_lines(self) -> bool:
        """Whether a job computes several lines side by side, each at all its slopes."""
        return self in (Method.SHORT, Method.PLANE)

    @property
    def is_coarse(self) -> bool:
        """Whether atlases are coarse: too few points are solved from each to pay for a fine one."""
        return self.is_of_lines or self in (Method.ALONE, Method.INTERPOLATED)


def method_of(study: Study, in_memory: bool = False) -> Method:
    """Method of a study, whose results are kept in a file or in memory.

    Claims read the nodes of atlases: theirs are those that `gaitsweep claims` computes, whatever the study's slopes.
    """
    if study.kind != "grid":
        return Method.TASK
    if study.steps > 1:
        return Method.CYCLES
    if study.claims:
        return Method.LONG
    by_charts, by_lines = seconds_over_plane(study)
    if by_charts < by_lines:
        return Method.PLANE
    if len(study.slope) > SHORT_LINE or not TASKS["atlas"].side_by_side:
        is_smooth = accuracy.is_interpolated(variables(study), study.accuracy)
        return Method.INTERPOLATED if is_smooth and len(study.slope) > SHORT_LINE else Method.LONG
    return Method.ALONE if in_memory else Method.SHORT


def seconds_over_plane(study: Study) -> tuple[float, float]:
    """Processor time of a grid by charts over its plane of keys, and line by line [s]; infinite where there is none."""
    plane, slopes = study.plane, len(study.slope)
    if (
        study.kind != "grid"
        or study.steps > 1
        or not plane
        or not TASKS["atlas"].over_plane
        or not _wants_points_alone(study)
    ):
        return math.inf, math.inf
    kneed = sum(check["multipliers"] > 3 for check in study.checks) / len(study.checks)

    def each(cost: Cost) -> float:
        return cost.straight * (1 - kneed) + cost.kneed * kneed

    is_long, is_smooth = slopes > SHORT_LINE, accuracy.is_interpolated(variables(study), study.accuracy)
    line, point = (COSTS["atlas"], "long") if is_long and not is_smooth else (COSTS["atlas side by side"], "short")
    alone, charted = ("interpolated",) * 2 if is_smooth and is_long else (point, "plane")
    charts = study.planes * len(plane.axes) * each(COSTS["charts"][0])
    undescribed = ALONE * FEW * (each(COSTS["atlas side by side"][0]) + slopes * each(POINTS["short"]))
    by_charts = charts + study.lines * (undescribed + slopes * each(POINTS[charted]))
    return by_charts, study.lines * (each(line[0]) + slopes * each(POINTS[alone]))


def variables(study: Study) -> tuple[str, ...]:
    """Point variables to compute: those requested, and those that requested fits, figures and claims read."""
    read = (name for reader in _readers(study) for name in READS.get(reader, ()))
    return accuracy.computed({*study.variables, *read}, study.accuracy)


def _wants_points_alone(study: Study) -> bool:
    """Whether no atlas is read, and no proof wanted."""
    reads = [read for name in _readers(study) for read in (name, *READS.get(name, ()))]
    reads_atlas = any(read in TASKS and read != "points" and "atlas" in TASKS[read].needs for read in reads)
    return not reads_atlas and not any(VARIABLES[name].group == "proofs" for name in study.variables)


def _readers(study: Study) -> tuple[str, ...]:
    return (*study.fits, *study.figures, *study.claims, *(("claims",) if study.claims else ()))
