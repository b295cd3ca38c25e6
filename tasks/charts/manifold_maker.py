"""Makes manifolds of special points, and the charts of the ends of pieces."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from gaitsweep.tasks.branches.equations import newton_step, solve
from gaitsweep.tasks.branches.pseudo_arclength import Point
from gaitsweep.tasks.charts.box import Box, Refused, tensor_nodes
from gaitsweep.tasks.charts.chart import Chart, fit
from gaitsweep.tasks.charts.cut import cut, vanishing_beside
from gaitsweep.tasks.charts.extension import Extension
from gaitsweep.tasks.charts.maker import Maker
from gaitsweep.tasks.charts.manifold import Manifold, Region

#: First and most nodes along each key, and the error of predictions below which no more
#: are taken.
_FIRST = 5
_MAX_NODES = 48
_GOOD = 2e-7
#: Error of the ends of pieces below which no more nodes are taken.
_GOOD_ENDS = 1e-9
#: Largest error of the predictions of a useful manifold.
_FAIR = 1e-4
#: A chart that is not good costs its designs further Newton steps. So many of these take
#: as long as what follows from a node: charts of more nodes, and derivatives.
_A_NODE = 20
#: Displacements that show how Newton's method converges: where the error of the rows
#: counts, and where the equations bend.
_SHORT, _LONG = 1e-7, 1e-4


def make_manifold(
    extension: Extension, served: Callable[[Region], float] = lambda _: math.inf
) -> Manifold:
    """Return the manifold through a point.

    Parameters
    ----------
    extension : Extension
        Of the point.
    served : callable
        About how many designs have a point of a region.

    Raises
    ------
    Refused
        If it is not smooth enough, ends in the box in another way than along a curve,
        or goes on where no walker is valid.
    """
    region = vanishing_beside(extension)
    first = None
    sizes = (_FIRST,) * extension.d
    if region is None:
        region = Region.whole(extension.d)
        nodes = tensor_nodes(sizes)
        points, there = extension.carried(nodes, region)
        if there.all():
            first = extension.fitted(sizes, region, points.Z, points.rows)
        else:
            region = cut(extension, nodes[~there])

    first = first or extension.chart(region, sizes)
    total = _MAX_NODES**extension.d
    enough = served(region) / _A_NODE
    chart = _fit(extension, region, first, _GOOD, total, enough)
    return measured(extension, region, chart)


def make_ends(
    maker: Maker,
    kind: str,
    unit: np.ndarray,
    Z: np.ndarray,
    total: int,
    target: float = 0.0,
) -> Chart:
    """Return the chart of the special points of a kind through some of them over the
    whole box.

    Parameters
    ----------
    maker : Maker
        Of the box.
    kind : str
    unit : ndarray, shape (1 + 2^d, d)
        Coordinates of keys: inside the box, and near its corners.
    Z : ndarray, shape (c, 1 + 2^d)
    total : int
        Nodes from which on no more are added.
    target : float
        The value that the scalar of the kind's condition has.

    Raises
    ------
    Refused
        If they are not smooth enough, or do not extend over the box.
    """
    extension = Extension(maker, kind, target, unit[0], Z[:, 0])
    region = Region.whole(maker.d)
    rows = extension.gradient(maker.problem(unit), Z)
    between = Chart.of_corners(unit, np.vstack([Z, rows]))
    first = extension.chart(region, (_FIRST,) * maker.d, between)
    chart = _fit(extension, region, first, _GOOD_ENDS, total)

    nodes = tensor_nodes(chart.sizes)
    guess, rows = np.split(chart(nodes), 2)
    solved = solve(extension.equations(maker.problem(nodes)), guess, rows)
    chart = extension.fitted(chart.sizes, region, solved.Z, rows)
    _check(extension, chart, solved)
    return Chart(chart.sizes, chart.coefficients[:, : len(Z)], chart.error)


def _fit(
    extension: Extension,
    region: Region,
    first: Chart,
    good: float,
    total: int,
    enough: float = math.inf,
) -> Chart:
    """Add nodes to a chart until it is good, or has enough, or refuse it."""
    attempt = partial(extension.chart, region)
    d = extension.d
    return fit(first, attempt, (_MAX_NODES,) * d, total, good, _FAIR, d, enough)


def _check(
    extension: Extension,
    chart: Chart,
    solved: Point,
) -> None:
    """Refuse a chart whose predictions err too much, or lose a point."""
    if not (chart.error <= _FAIR and solved.ok.all()):
        kind = extension.kind
        error = chart.error
        raise Refused(f"predictions of a {kind} err by {error:.1g}")


def measured(
    extension: Extension,
    region: Region,
    chart: Chart,
) -> Manifold:
    """Return the manifold of a chart, through points that are solved to rounding, with
    what is measured at random ones.

    Raises
    ------
    Refused
        If predictions err too much.
    """
    nodes = region.unit(tensor_nodes(chart.sizes))
    problem = extension.problem(nodes)
    guess, rows = region.predict(chart, nodes)
    Z = solve(extension.equations(problem), guess, rows).Z
    rows = extension.rough_gradient(problem, Z)
    chart = extension.fitted(chart.sizes, region, Z, rows)

    unit = extension.drawn(region, chart)
    equations = extension.equations(extension.problem(unit))
    guess, rows = region.predict(chart, unit)
    solved = solve(equations, guess, rows)
    _check(extension, chart, solved)

    step = partial(newton_step, equations, rows=rows)
    first = step(guess)
    left = np.abs(first.Z - solved.Z).max(axis=0)
    # What shorter steps leave is rounding, which counts by itself.
    linear = (left / np.maximum(first.last_step, _SHORT)).max()
    linear = max(float(linear), _left(extension.box, step, solved.Z, _SHORT) / _SHORT)
    quadratic = _left(extension.box, step, solved.Z, _LONG) / _LONG**2

    return Manifold(extension.kind, extension.target, region, chart, linear, quadratic)


def _left(
    box: Box,
    step: Callable[[np.ndarray], Point],
    Z: np.ndarray,
    displaced: float,
) -> float:
    """Largest error after a Newton step so far beside points Z (c, n)."""
    signs = np.sign(box.draw(Z.shape[1], len(Z), "displaced")).T
    off = step(Z + displaced * signs).Z - Z
    return float(np.abs(off).max())
