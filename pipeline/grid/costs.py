"""How long the points and tasks of a study take, before any of them is measured."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from gaitsweep.pipeline.grid.method import (
    Method,
    is_charted,
    is_interpolated,
    scaling_axes,
    span,
    variables,
)
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.accuracy import charted_from, nodes_for
from gaitsweep.tasks.contract.costs import (
    ALONE,
    COSTS,
    FEW,
    OTHERS,
    POINTS,
    STARTING,
    Cost,
)
from gaitsweep.tasks.contract.registry import OPTIONS, SENSITIVITIES, VARIABLES


def starting(study: Study) -> float:
    """Processor time of a run that has anything to do, beside its tasks [s]."""
    return _total(study, STARTING)


def seconds(study: Study, name: str, method: Method, alike: int = 1) -> float:
    """Processor time of a task over one line, or over the study, of a mean walker of
    the study; of `points`, of one.

    Over a plane few lines have an atlas, and the time of charts is shared by its lines;
    of lines that differ only in their units one is solved: these are means over all
    lines.

    Parameters
    ----------
    study : Study
    name : str
        Task.
    method : Method
        Of the study's lines.
    alike : int
        Lines that differ only in their units of which one is solved.

    Returns
    -------
    float [s]
    """
    if name == "points":
        converted = _total(study, [POINTS["converted"]]) if alike > 1 else 0.0
        return of_point(study, method) / alike + converted
    if name == "atlas":
        return _of_atlas(study, method) / alike
    if name == "charts" and study.plane:
        lines = study.plane.lines * math.prod(map(len, scaling_axes(study)))
        return len(study.plane.axes) * _total(study, COSTS["charts"]) / lines
    if name == "design":
        designs = study.lines / study.alike / study.batches
        cells = int(study.plane is not None)
        own = _total(study, COSTS["design of a plane" if cells else "design"])
        return own * designs + cells * _total(study, COSTS["plane of designs"])

    return _total(study, COSTS.get(name, OTHERS), name)


def _of_atlas(study: Study, method: Method) -> float:
    """Processor time of the atlas of a line [s]; over a plane few lines have one."""
    if method is Method.PLANE:
        return ALONE * _of_line_alone(study)
    return _total(study, COSTS[_atlas_of(study, method)], "atlas")


def _atlas_of(study: Study, method: Method) -> str:
    """The name of the cost of an atlas of a line."""
    if method is Method.TARGETS and study.at:
        is_of_key = study.at["vary"] != "slope"
        return "atlas at values by a key" if is_of_key else "atlas at values"
    is_beside = method.is_of_lines and study.lines > 1
    if is_beside or method is Method.INTERPOLATED:
        return "atlas of what drives" if study.is_driven else "atlas side by side"
    return "atlas"


def integrated(study: Study, points: int, method: Method) -> int:
    """About how many of some points of a grid are integrated; the others come from
    polynomials over slopes.
    """
    if method is not Method.INTERPOLATED:
        return points
    panels = math.ceil(span(study)) + 1
    return min(points, study.lines * panels * (2 * nodes_for(study.accuracy) + 1))


def of_point(study: Study, method: Method) -> float:
    """Processor time of a point of a study [s], whose lines are computed by that
    method.
    """
    way = Method.SHORT if method in (Method.TASK, Method.ALONE) else method
    if method is Method.PLANE and is_interpolated(study):
        way = Method.INTERPOLATED
    groups = {VARIABLES[name].group for name in variables(study)}
    dear = sorted(groups & {"violations", "proofs"})
    seconds = _total(study, [POINTS[group] for group in (way, *dear)])
    return seconds + _of_derivatives(study, method)


def _of_derivatives(study: Study, method: Method) -> float:
    """Processor time of the derivatives of a point [s]: by polynomials, or of single
    gaits, which with violations are measured as often.
    """
    groups = {VARIABLES[name].group for name in variables(study)}
    if SENSITIVITIES not in groups:
        return 0.0

    single = [POINTS["sensitivities"]]
    if "violations" in groups:
        single.append(POINTS["violations differentiated"])
    if not is_charted(study, method):
        return _total(study, single)

    sampled = charted_from(span(study)) / len(study.values_along)
    return sampled * _total(study, single) + _total(study, [POINTS["charted"]])


def _of_line_alone(study: Study) -> float:
    """Processor time of a line of a plane that charts do not describe [s], with its
    points.
    """
    of_atlas = _total(study, COSTS["atlas side by side"])
    return FEW * (of_atlas + len(study.values_along) * of_point(study, Method.SHORT))


def _total(study: Study, costs: Iterable[Cost], name: str = "") -> float:
    """Sum of costs over the mean of the study's walkers, for one point, and one line or
    study.

    A task of another kind of study than this, as fits read it, has the defaults of its
    options.
    """
    is_foreign = name in OPTIONS and name != study.kind
    kind, given = (name, {}) if is_foreign else (study.kind, study.options)
    options = registry.options(kind, given) if kind in OPTIONS else {}
    sizes: dict[str, Any] = {
        **options,
        "slopes": len(study.values_along),
        "points": 1,
        "gait_steps": study.steps,
        "searches": _searches(study.steps),
    }
    for option, value in options.items():
        if isinstance(value, list | tuple):
            sizes[option] = len(value)

    with_knees = sum(check["multipliers"] > 3 for check in study.checks)
    kneed = with_knees / max(1, len(study.checks))
    total = 0.0
    for cost in costs:
        each = cost.straight * (1 - kneed) + cost.kneed * kneed
        total += each * _times(cost, sizes)

    return total


def _searches(steps: int) -> float:
    """How often gaits of so many steps are searched for: those of 2 begin at flips;
    every further doubling, and an odd period, is searched for as well.
    """
    doublings = [k for k in range(6) if steps // 2**k > 2 and steps % 2**k == 0]
    return len(doublings) + 0.2 * (steps > 1)


def _times(cost: Cost, sizes: Mapping[str, Any]) -> float:
    """How often a cost is paid: the product of the sums of sizes that it names."""
    factors = []
    for factor in cost.of:
        factors.append(sum(sizes[part] for part in factor.split("+")))
    return math.prod(factors)
