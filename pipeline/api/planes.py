"""Gaits over planes of keys in memory, predicted by polynomials in the cells that a study over the same axes has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline import dispatch
from pipeline.graph import layers
from pipeline.grid.method import Method, method_of
from pipeline.study import model
from tasks.registry import GAITS, TASKS

#: Most points per call.
_MAX_POINTS = 8192


def plane_of(
    walker: str | dict[str, Any],
    fixed: Mapping[str, Any],
    keys: Mapping[str, np.ndarray],
    slopes: np.ndarray,
    wanted: tuple[str, ...],
    accuracy: float,
    limits: Mapping[str, float],
) -> model.Study | None:
    """Return the study over a plane of keys that some lines make up, each once.

    Parameters
    ----------
    walker : str or dict
        Name or table.
    fixed : mapping
        Values of keys that all lines share.
    keys : mapping
        Values of the keys that vary, each of shape (n,), for n lines.
    slopes : ndarray, shape (s,) [rad]
        Of every line, rising.
    wanted : tuple of str
        Names of variables.
    accuracy : float
        Largest error bound wanted; 0 for as good as doubles give.
    limits : mapping
        Limits of violations that are not the registry's.

    Returns
    -------
    Study or None
        Its axes are the keys, in their order, with rising values. None where the lines are no grid of all these values,
        or a study of them interpolates no gaits over keys.
    """
    axes = tuple(model.Axis(name, np.unique(values)) for name, values in keys.items())
    count = len(next(iter(keys.values()), ()))
    if count != np.prod([len(axis) for axis in axes]):
        return None
    last = {**fixed, **{axis.name: axis.values[-1].item() for axis in axes}}
    check = dispatch.ask("check_walker", {"walker": walker, "set": last})
    axes = (model.Axis("slope", slopes), *axes)
    study = model.Study("", "", "grid", (walker,), GAITS, axes, wanted, checks=(check,), accuracy=accuracy)
    study = replace(study, options={"violation_limits": limits}) if limits else study
    return study if method_of(study) is Method.PLANE else None


def cells(
    study: model.Study, keys: Mapping[str, np.ndarray], lines: Sequence[dict[str, Any]]
) -> Iterator[tuple[np.ndarray, dict[str, np.ndarray]]]:
    """Solve the gaits of the lines of a plane, cell by cell.

    Parameters
    ----------
    study : Study
        Of `plane_of`.
    keys : mapping
        As for `plane_of`.
    lines : sequence of dict
        The n lines.

    Yields
    ------
    numbers : ndarray of int, shape (k,)
        Of some lines.
    result : dict of ndarray
        What `tasks.solve_planes.lines` gives of them, the slopes of one line after those of another.
    """
    assert study.plane
    places = [np.searchsorted(axis.values, keys[axis.name]) for axis in study.line_axes]
    order = np.argsort(np.ravel_multi_index(places, study.line_shape[1:]))
    most = max(1, _MAX_POINTS // len(study.slope))
    solve = dispatch.resolve(TASKS["atlas"].over_plane)
    shared = {"slope": study.slope, "want": study.variables, **layers.point_params(study, Method.PLANE)}
    for cell in study.cells():
        bounds = study.plane.cell(study.line(int(cell[0]))["set"])
        for part in np.array_split(order[cell], -(-len(cell) // most)):
            params = {**shared, "lines": [lines[k] for k in part.tolist()], "cell": bounds}
            ((_, result),) = solve(params, [])
            yield part, result
