"""What a task returns for a chunk, as its points."""

from collections.abc import Callable, Mapping
from typing import Any

from gaitsweep.pipeline.store.record import Points, joined


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
        Atlas of each of the lines side by side; those of a plane have none.

    Raises
    ------
    ValueError
        If the result has not the shape of the points.
    """
    want, n = params["want"], len(params["slope"])
    if "lines" not in params:
        return Points.of_result(function(params, inputs), want, n), []
    pairs = function(params, inputs)
    points = joined([Points.of_result(result, want, len(result["status"])) for _, result in pairs])
    count = len(params["lines"])
    if len(points) != n * count:
        raise ValueError(f"{len(points)} points are returned of {count} lines of {n}")
    return points, [atlas for atlas, _ in pairs]
