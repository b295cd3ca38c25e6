"""The layers of a study's graph, each one task over every line or over the whole study:
parameters and keys.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.pipeline.grid.method import Method, is_charted, variables
from gaitsweep.pipeline.study import overlay
from gaitsweep.pipeline.study.model import Study, about
from gaitsweep.tasks.contract.registry import (
    GAITS,
    LOSS_WINDOWS,
    READ_BY_CLAIMS,
    READS,
    SENSITIVITIES,
    TASKS,
    VARIABLES,
    Task,
)


@dataclass(frozen=True)
class Layer:
    """One task over each line, or once over the study; `needs` names the layers it
    reads.
    """

    task: Task
    per_line: bool
    needs: tuple[str, ...]


def layers(study: Study, method: Method) -> dict[str, Layer]:
    """Layers that a study needs, inputs first."""
    needed: dict[str, Layer] = {}

    def add(name: str, per_line: bool) -> None:
        if name in needed:
            return
        task = TASKS[name]
        needs = tuple(need for need in task.needs if need in TASKS)
        for need in needs:
            add(need, per_line or need == "points" or _over_lines(need))
        needed[name] = Layer(task, per_line, needs)

    main = _main(study)
    if method is Method.PLANE:
        add("charts", True)
    add(main, True)
    for name in (*study.figures, *study.claims):
        for read in READS.get(name, ()):
            if read in TASKS:
                add(read, _over_lines(read))

    for name in study.fits:
        add(name, False)
    if study.overlay:
        add("measured", False)
    if study.claims and "claims" in TASKS:
        # Claims read the main results of the study, its points or the tables of its
        # task, and their atlas.
        others = _read_by_claims(study)
        for name in others:
            add(name, True)
        read = (main, *TASKS[main].needs, *others)
        needed["claims"] = Layer(TASKS["claims"], False, read)

    return needed


def _main(study: Study) -> str:
    """The layer of a study's main results."""
    if study.kind == "grid":
        return "points"
    return study.kind


def _read_by_claims(study: Study) -> tuple[str, ...]:
    """Tasks over each line that a study's claims read."""
    names: dict[str, None] = {}
    for claim in study.claims:
        names |= dict.fromkeys(READ_BY_CLAIMS.get(claim, ()))
    return tuple(names)


def _over_lines(name: str) -> bool:
    """Whether a task is over each line: the points are, and what reads neither these
    nor a task over the study.
    """
    if name == "points":
        return True
    needs = TASKS[name].needs
    return "points" not in needs and all(map(_over_lines, needs))


def point_params(study: Study, method: Method) -> dict[str, Any]:
    """Parameters of points on which their values depend, besides their line and slopes."""
    given: dict[str, Any] = {}
    if study.accuracy:
        given["accuracy"] = study.accuracy
        given["interpolated"] = method is Method.INTERPOLATED

    names = variables(study)
    if any(VARIABLES[name].group == SENSITIVITIES for name in names):
        given["charted"] = is_charted(study, method)
    if study.drive:
        given["along"] = study.drive
    measures = _versions(names)
    if measures:
        given["measures"] = measures
    return {**study.options, **given}


def _versions(names: Iterable[str]) -> dict[str, Any]:
    """Versions of those among some variables that are measures."""
    measures = {}
    for name in names:
        if VARIABLES[name].measure:
            measures[name] = VARIABLES[name].version
    return measures


def line_params(
    study: Study,
    method: Method,
    name: str,
    line: Mapping[str, Any],
    box: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Parameters of a task over one line, or of charts over its plane or a box, except
    the slopes of a chunk.
    """
    if name == "atlas":
        return _atlas_params(study, method, line)
    if name == "points":
        return {"line": line, **point_params(study, method)}
    if name == "corners":
        return {"line": line}
    if name == "charts":
        return _charts_params(study, line, box)
    if name == "cascade" != study.kind:  # for the fit `crises`
        window: Iterable[float] = ()
        if isinstance(line["walker"], str) and not line["set"]:
            window = LOSS_WINDOWS.get(line["walker"], ())
        slopes = np.array(window, float)
        return {"line": line, "slope": slopes, "gaits": GAITS}

    along = _along(study)
    if name == "branch":
        ends = _ends(study.values_along)
        n = len(study.values_along)
        return {"line": line, **along, **ends, "n": n, **study.options}

    params = {"line": line, **along, "slope": study.values_along, "gaits": study.gaits}
    if name != "trace":  # `steps` may be those of orbits
        params |= study.options
    if name == "design" and study.plane:
        params["plane"] = study.plane.region
    return params


def _atlas_params(
    study: Study, method: Method, line: Mapping[str, Any]
) -> dict[str, Any]:
    """Parameters of the atlas of a line."""
    params: dict[str, Any] = {"line": line, **_along(study)}
    if study.steps > 1:
        params["steps"] = study.steps
    if study.drive:
        if method.is_coarse:
            params["coarse"] = True
        return params

    params["coarse"] = method.is_coarse
    if "drive" not in study.features:
        params["line"] = _without_g(line)
    if study.is_level:
        # What drives walkers there, branches over slope do not tell.
        params["level"] = True

    return params


def _along(study: Study) -> dict[str, Any]:
    """Parameter that names what gaits are followed over where it is not the slope."""
    if not study.drive:
        return {}
    return {"along": study.drive}


def _charts_params(
    study: Study, line: Mapping[str, Any], box: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Parameters of charts over the plane of a line, or a box."""
    assert study.plane
    varied = [*study.plane.region["keys"]]
    varied += [axis.name for axis in study.scaling]
    fixed = {key: value for key, value in line["set"].items() if key not in varied}
    leads = study.values_along[study.values_along > 0]
    window = {**_ends(leads), "slopes": about(len(leads))}
    of_plane = {**line, "set": fixed}
    plane = {"plane": box or study.plane.region, **_along(study), **window}
    if study.accuracy:
        wanted = {"want": variables(study), "accuracy": study.accuracy}
        return {"line": of_plane, **plane, **wanted}

    if "drive" not in study.features:
        of_plane = _without_g(of_plane)
    return {"line": of_plane, **plane, "want": ()}


def _without_g(line: Mapping[str, Any]) -> dict[str, Any]:
    """A line without `g`, which changes nothing but units: branches and charts are in
    the walker's own.
    """
    others = {key: value for key, value in line["set"].items() if key != "g"}
    return {**line, "set": others}


def _ends(values: np.ndarray) -> dict[str, float]:
    """The least and the largest value along lines, as parameters of a task."""
    return {"slope_from": float(values.min()), "slope_to": float(values.max())}


def study_params(study: Study, name: str) -> dict[str, Any]:
    """Parameters of a task over the whole study."""
    if name == "measured":
        return _measured_params(study)

    lines = enumerate(study.lines_at(np.arange(study.lines)))
    params: dict[str, Any] = {
        "lines": [{**line, "name": study.name_of(number)} for number, line in lines]
    }
    if name == "claims":
        params["ids"] = list(study.claims)
    return params


def _measured_params(study: Study) -> dict[str, Any]:
    """Parameters of the gaits at the points of the user's measurements."""
    points = overlay.points(study)
    measures = _versions(points["values"])
    labels = study.gaits if study.kind == "grid" else GAITS
    return {**points, "gaits": labels, "steps": study.steps, "measures": measures}
