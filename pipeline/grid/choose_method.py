"""By which method the gaits of a study's lines are computed: decided here, once."""

import math

from gaitsweep.pipeline.grid import costs
from gaitsweep.pipeline.grid.method import (
    Method,
    is_interpolated,
    scaling_axes,
    wants_points_alone,
)
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract.registry import SHORT_LINE, TASKS


def method_of(study: Study, in_memory: bool = False) -> Method:
    """Method of a study, whose results are kept in a file or in memory.

    Claims read the nodes of atlases: theirs are those that `gaitsweep claims` computes,
    whatever the study's slopes.
    """
    if study.kind != "grid":
        return Method.TASK
    if study.at:
        return Method.TARGETS
    if study.steps > 1:
        return Method.CYCLES
    if study.claims:
        return Method.LONG

    by_charts, by_lines = seconds_over_plane(study)
    return Method.PLANE if by_charts < by_lines else _by_lines(study, in_memory)


def seconds_over_plane(study: Study) -> tuple[float, float]:
    """Processor time of a grid by charts over its plane of keys, and line by line [s],
    without converting gaits to other units; infinite where there is none.
    """
    is_possible = (
        study.kind == "grid"
        and study.steps == 1
        and TASKS["atlas"].over_plane
        and wants_points_alone(study)
        and study.values_along.max() > 0
    )
    if not study.plane or not is_possible:
        return math.inf, math.inf

    alike = math.prod(map(len, scaling_axes(study)))

    def seconds(method: Method, *tasks: str) -> float:
        of_line = sum(costs.seconds(study, name, method, alike) for name in tasks)
        of_points = len(study.values_along) * costs.of_point(study, method) / alike
        return study.lines * (of_line + of_points)

    return seconds(Method.PLANE, "charts", "atlas"), seconds(_by_lines(study), "atlas")


def _by_lines(study: Study, in_memory: bool = False) -> Method:
    """Method of a study whose lines are computed without charts."""
    if is_interpolated(study):
        return Method.INTERPOLATED
    if len(study.values_along) > SHORT_LINE or not TASKS["atlas"].side_by_side:
        return Method.LONG
    return Method.ALONE if in_memory else Method.SHORT
