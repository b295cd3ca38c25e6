"""A special point extended over the keys of a box: carried to other designs, and the
charts through its points there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.branches.equations import Equations, newton_step, solve
from gaitsweep.tasks.branches.joint import evaluate
from gaitsweep.tasks.charts.box import Refused, tensor_nodes
from gaitsweep.tasks.charts.carry import Carried
from gaitsweep.tasks.charts.chart import Chart
from gaitsweep.tasks.charts.maker import Maker
from gaitsweep.tasks.charts.manifold import Region
from gaitsweep.tasks.step.problem import Lanes

#: Random designs at which predictions are checked.
_DRAWN = 24
#: First share of the way in which a point is carried from one design to another, and
#: largest distance from its prediction.
_STRIDE = 0.125
_MAX_STRIDE_ERROR = 0.3
#: Difference by which rough derivatives are taken.
_ONE_SIDED = 3e-7


class Points(Carried):
    """Points Z (c, n) on their way to other designs, with the derivatives of their
    scalars, `rows` (c, n).

    Both are accurate enough to lead to others.
    """

    def __init__(
        self,
        Z: np.ndarray,
        rows: np.ndarray,
        stride: float,
    ):
        super().__init__(Z, stride)
        self.rows = rows.copy()


class Extension:
    """The extension of a point over a box.

    Parameters
    ----------
    maker : Maker
        Of the box.
    kind : str
    target : float
        The value that the scalar of the kind's condition has.
    unit : ndarray, shape (d,)
        Coordinates of keys of the point.
    Z : ndarray, shape (c,)
    """

    def __init__(
        self,
        maker: Maker,
        kind: str,
        target: float,
        unit: np.ndarray,
        Z: np.ndarray,
    ):
        self.maker = maker
        self.problem = maker.problem
        self.box = maker.box
        self.d = maker.d
        self.kind = kind
        self.target = target
        self.condition = CONDITIONS[kind].equal_to(target)
        self.unit = unit
        self.Z = Z

    def equations(self, problem: Lanes) -> Equations:
        """Return the equations of its points at some designs."""
        return Equations(problem, [self.condition])

    def gradient(self, problem: Lanes, Z: np.ndarray) -> np.ndarray:
        """Return the derivatives of its scalar at points Z (c, n) of designs."""
        return self.equations(problem).gradient(self.condition, Z)

    def rough_gradient(self, problem: Lanes, Z: np.ndarray) -> np.ndarray:
        """Return the derivatives as `gradient` does, to about 1e-6 of them: with half as
        many steps, and enough for Newton's method, which errs by its own steps' lengths
        times as much.
        """
        c, n = Z.shape
        moved = np.hstack([np.zeros((c, 1)), _ONE_SIDED * np.eye(c)])
        points = (Z[:, None, :] + moved[:, :, None]).reshape(c, -1)
        lanes = np.tile(np.arange(n), 1 + c)
        at = evaluate(problem.some(lanes), points)
        values = self.condition.residual(at).reshape(1 + c, n)
        return (values[1:] - values[:1]) / _ONE_SIDED

    def correct(
        self,
        points: Points,
        active: np.ndarray,
        problem: Lanes,
        within: float,
        guess: np.ndarray,
        growth: np.ndarray | float = 0.0,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve some points, `active`, at other designs.

        Parameters
        ----------
        points : Points
            Whose rows lead there, and are brought up to date.
        active : ndarray of int, shape (k,)
        problem : Lanes
            Of the designs.
        within : float
            Largest distance from the guess that is accepted.
        guess : ndarray, shape (c, k)
        growth : ndarray, shape (c, k), or float
            What is to be added, as `Region.growth` has it.

        Returns
        -------
        Z : ndarray, shape (c, k)
            Without the growth.
        fair : ndarray of bool, shape (k,)
            Which of them are accepted.
        """
        rows = points.rows[:, active]
        start = guess + growth
        solved = solve(self.equations(problem), start, rows, quick=True)
        Z = solved.Z - growth
        fair = solved.ok & (np.abs(Z - guess).max(axis=0) < within)
        points.rows[:, active[fair]] = solved.rows[:, fair]
        return Z, fair

    def carried(self, nodes: np.ndarray, region: Region) -> tuple[Points, np.ndarray]:
        """Carry the point to designs along straight lines in the coordinates of a
        region.

        Parameters
        ----------
        nodes : ndarray, shape (n, d)
        region : Region

        Returns
        -------
        points : Points
        there : ndarray of bool, shape (n,)
            Which arrived.
        """
        n = len(nodes)
        here = self.unit[None]
        Z = self.Z[:, None]
        start = region.smooth(here)
        ends = region.smooth(nodes)
        row = self.gradient(self.problem(here), Z)
        smooth = Z - region.growth(here)[0]
        points = Points(
            np.repeat(smooth, n, axis=1), np.repeat(row, n, axis=1), _STRIDE
        )

        def correct(
            active: np.ndarray,
            share: np.ndarray,
            guess: np.ndarray,
        ) -> tuple[np.ndarray, np.ndarray]:
            unit = region.unit(start + share[:, None] * (ends[active] - start))
            growth = region.growth(unit)[0]
            problem = self.problem(unit)
            within = _MAX_STRIDE_ERROR
            return self.correct(points, active, problem, within, guess, growth)

        there = points.carry(correct)
        points.Z += region.growth(nodes)[0]
        return points, there

    def predicted(
        self,
        nodes: np.ndarray,
        region: Region,
        before: Chart,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Solve the points at designs (n, d) as a chart predicts them: Z, rows (c, n),
        and which are accepted, (n,).
        """
        guess, rows = region.predict(before, nodes)
        equations = self.equations(self.problem(nodes))
        solved = solve(equations, guess, rows, quick=True)
        near = np.abs(solved.Z - guess).max(axis=0) < _MAX_STRIDE_ERROR
        return solved.Z, solved.rows, solved.ok & near

    def chart(
        self,
        region: Region,
        sizes: tuple[int, ...],
        before: Chart | None = None,
    ) -> Chart:
        """Return the chart over a region through points at its nodes, predicted by the
        chart before, or carried there.

        Parameters
        ----------
        region : Region
        sizes : tuple of int
        before : Chart, optional

        Raises
        ------
        Refused
            If one is lost on its way.
        """
        nodes = region.unit(tensor_nodes(sizes))
        Z, rows = np.zeros((2, len(self.Z), len(nodes)))
        ok = np.zeros(len(nodes), bool)
        if before is not None:
            Z, rows, ok = self.predicted(nodes, region, before)
        if not ok.all():
            carried, there = self.carried(nodes[~ok], region)
            if not there.all():
                lost = np.abs(nodes[~ok][~there] - self.unit)
                why = f"a {self.kind} is lost on its way to {len(lost)} nodes"
                raise Refused(why, int(lost.sum(axis=0).argmax()))
            Z[:, ~ok] = carried.Z
            rows[:, ~ok] = carried.rows

        return self.fitted(sizes, region, Z, rows)

    def fitted(
        self,
        sizes: tuple[int, ...],
        region: Region,
        Z: np.ndarray,
        rows: np.ndarray,
    ) -> Chart:
        """Return the chart over a region through points at its nodes.

        Parameters
        ----------
        sizes : tuple of int
        region : Region
        Z, rows : ndarray, shape (c, n)
            The points, and the derivatives of their scalar.
        """
        growth, factor = region.growth(region.unit(tensor_nodes(sizes)))
        smooth = np.vstack([Z - growth, rows / factor])
        # Nodes are added for the points: it is they that are solved.
        chart = Chart.through(sizes, smooth, np.repeat([1.0, np.inf], len(Z)))
        unit = self.drawn(region, chart)
        equations = self.equations(self.problem(unit))
        step = newton_step(equations, *region.predict(chart, unit))
        return replace(chart, error=float(step.last_step.max()))

    def drawn(self, region: Region, chart: Chart) -> np.ndarray:
        """Return coordinates (n, d) of random designs that have a point of a region."""
        return region.unit(self.box.draw(_DRAWN, self.d, f"{self.kind} {chart.sizes}"))
