"""What a task returns for a chunk, as its points."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pipeline.store.record import Points, joined, rows_of


def points_of(
    function: Callable[..., Any], params: Mapping[str, Any], inputs: list[Any]
) -> tuple[Points, list[dict[str, Any]]]:
    """Compute the points of a chunk.

    Parameters
    ----------
    function : callable
        Task over the points of a line, or over lines side by side.
    params, inputs
        Of the task, as `Graph.params` gives them.

    Returns
    -------
    points : Points
        Line by line.
    atlases : list of dict
        Atlas of each of the lines side by side; those of a plane, which are computed cell by cell, have none.

    Raises
    ------
    ValueError
        If the result has not the shape of the points.
    """
    want, n = params["want"], len(params["slope"])
    if "lines" not in params:
        return Points.of_result(function(params, inputs), want, n), []
    cells: dict[int, list[int]] = {}
    for k, line in enumerate(params["lines"]):
        cells.setdefault(line.get("cell", 0), []).append(k)
    parts, atlases = [], [dict[str, Any]()] * len(params["lines"])
    for cell, places in cells.items():
        lines = [{key: params["lines"][k][key] for key in ("walker", "set")} for k in places]
        own = {"cell": params["cells"][cell]} if "cells" in params else {}
        pairs = function({**params, "lines": lines, **own}, inputs)
        parts += [Points.of_result(result, want, len(result["status"])) for _, result in pairs]
        for k, (atlas, _) in zip(places, pairs, strict=False):
            atlases[k] = atlas
    order, points = np.argsort(np.concatenate(list(cells.values()))), joined(parts)
    if len(points) != n * len(order):
        raise ValueError(f"{len(points)} points are returned of {len(order)} lines of {n}")
    return points.take(rows_of(order, n)), atlases
