"""Derivatives of gaits by slope and keys on long lines: polynomials over panels of the
line's branches, where these reach the accuracy that derivatives have.

A panel's polynomials depend on its line's atlas alone. Beside a fold derivatives grow
as the inverse of the distance from it along the branch, over which they are multiplied
before polynomials go through them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from gaitsweep.tasks.branches.branch import Branch
from gaitsweep.tasks.branches.equations import Equations
from gaitsweep.tasks.charts.pieces import Piece, pieces_of
from gaitsweep.tasks.charts.sheet import Asked, Sampled, Sheet
from gaitsweep.tasks.contract.accuracy import DERIVATIVE_NODES
from gaitsweep.tasks.contract.variables import BY_KEY
from gaitsweep.tasks.gaits.polish import Polished, settle
from gaitsweep.tasks.measures.sensitivities import (
    Measured,
    Rows,
    by_all_keys,
    differentiated,
    measures_among,
    not_differentiated,
    sizes_of_keys,
)
from gaitsweep.tasks.step.lanes import join_lanes, lanes_of
from gaitsweep.tasks.step.problem import Problem
from gaitsweep.tasks.studies.interpolate import fit_panels, on_sheets
from gaitsweep.tasks.studies.solve_guesses import Differentiate
from gaitsweep.tasks.walkers.walker import DIFFERENTIATED

#: Largest bound of the errors of derivatives that polynomials give, over the larger of
#: the derivative and the measure over the size of the key.
_GOOD = 1e-8
#: Nodes of a panel, and its narrowest part: what is not smooth there is differentiated
#: gait by gait.
_NODES = DERIVATIVE_NODES
_NARROWEST = 1 / 4
#: Least size of a measure over which errors count.
_TINY = 1e-300


@dataclass(frozen=True)
class _Some:
    """Some gaits: their lanes, slopes, unknowns Z (c, n) and derivatives of the step
    map (m, m, n).
    """

    lanes: np.ndarray
    slope: np.ndarray
    Z: np.ndarray
    jacobian: np.ndarray

    @classmethod
    def of(cls, at: Polished, slope: np.ndarray, lanes: np.ndarray) -> _Some:
        """Return some lanes of gaits at slopes (n,)."""
        own = slope[lanes]
        Z = np.vstack([at.w[:, lanes], np.log(own)])
        return cls(lanes, own, Z, at.stride.jacobian[..., lanes])

    def differentiated(
        self, problem: Problem, names: Sequence[str], keys: np.ndarray
    ) -> Measured:
        """Derivatives (keys, n) of some measures by numbered keys."""
        rows = Rows(tuple(names))
        by_keys = by_all_keys(problem, self.Z, rows, [DIFFERENTIATED[k] for k in keys])
        return rows.named(by_keys, self.jacobian)


class ChartedDerivatives:
    """Derivatives of the gaits of one line.

    Parameters
    ----------
    problem : Problem
        Of one walker, over slopes.
    branches : list of Branch
    want : sequence of str
        Names of variables; those of the group `sensitivities` are computed.
    slope : ndarray, shape (n,) [rad]
        All slopes for which panels are to be made.
    """

    def __init__(
        self,
        problem: Problem,
        branches: list[Branch],
        want: Sequence[str],
        slope: np.ndarray,
    ):
        self.problem = problem
        self.rows = Rows(measures_among(want, problem.walker))
        self.pieces = pieces_of(branches)
        #: Which keys there are derivatives by, anywhere among the first samples: they
        #: are of all pieces.
        self.has = np.zeros(len(DIFFERENTIATED), bool)
        # Walkers may have none of the measures.
        q = np.log(slope) if self.rows.names else np.empty(0)
        self.sheets = fit_panels(
            self.pieces,
            q,
            self._solve,
            _NODES,
            _GOOD,
            _NARROWEST,
            by_value=True,
        )

    def _solve(
        self, asked: Sequence[Asked], points: Sequence[np.ndarray]
    ) -> Iterator[Sampled]:
        """Differentiate the samples of panels, all side by side."""
        of_panels, q = [], []
        for panel, x in zip(asked, points, strict=True):
            q.append(panel.span.log_slope(x))
            of_panels.append(self.pieces[panel.number].guesses(q[-1]))

        at = settle(self.problem, join_lanes(of_panels))
        values, size = self._columns(np.vstack([at.w, np.concatenate(q)]))
        is_gait = at.converged & at.step

        lanes = np.split(np.arange(len(is_gait)), len(asked))
        for panel, x, own in zip(asked, points, lanes, strict=True):
            weight = panel.span.from_folds(x)
            bound = 0.0 if is_gait[own].all() else np.inf
            yield Sampled(values[:, own] * weight, size[:, own] * weight, bound, 1)

    def _columns(self, Z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of measures over the sizes of keys, and the sizes over which
        their errors count, (columns, n).
        """
        keys = sizes_of_keys(self.problem.walker, np.exp(Z[-1]))
        values = by_all_keys(self.problem, Z, self.rows) * keys
        if not self.has.any():
            self.has = ~np.isnan(values).all(axis=(0, 2))
        values = values[:, self.has]

        of_gaits = self.rows.at(Equations(self.problem).evaluate(Z))
        own = self.rows.sizes(of_gaits)[:, None]
        size = np.maximum(self.rows.sizes(values), own)
        n = Z.shape[1]
        return values.reshape(-1, n), np.maximum(size, _TINY).reshape(-1, n)

    def of(self, groups: Sequence[tuple[Piece, int]]) -> Differentiate:
        """Return what differentiates gaits of several pieces, so many of each, one
        after another.
        """
        places = {(piece.number, piece.first): k for k, piece in enumerate(self.pieces)}
        numbers = [places[piece.number, piece.first] for piece, _ in groups]
        of_lanes = np.repeat(numbers, [n for _, n in groups])
        return partial(self._differentiated, of_lanes)

    def _differentiated(
        self,
        piece: np.ndarray,
        problem: Problem,
        at: Polished,
        slope: np.ndarray,
        want: Sequence[str],
    ) -> Measured:
        """Derivatives of gaits on numbered pieces (n,), as `differentiated` has them."""
        found = not_differentiated(want, len(slope))
        is_left = at.converged & at.step
        for number in np.unique(piece).tolist():
            lanes = np.flatnonzero((piece == number) & is_left)
            q = np.log(slope[lanes])
            for sheet, some, values in self._on_piece(self.sheets[number], q):
                each = lanes[some]
                is_left[each] = False
                self._put(found, _Some.of(at, slope, each), sheet, values)

        left = np.flatnonzero(is_left)
        alone = differentiated(problem, lanes_of(at, left), slope[left], want)
        for name, values in alone.items():
            found[name][left] = values
        return found

    def _put(
        self, found: Measured, gaits: _Some, sheet: Sheet, values: np.ndarray
    ) -> None:
        """Put derivatives of some gaits where they belong: columns (columns, k) of a
        sheet and, of those that it does not serve, what single gaits have.
        """
        sizes = sizes_of_keys(self.problem.walker, gaits.slope)[self.has]
        by_sizes = values.reshape(-1, *sizes.shape)
        served = np.ones(by_sizes.shape[:2], bool)
        if sheet.served is not None:
            served = sheet.served.reshape(served.shape)

        keys = np.flatnonzero(self.has)
        is_served = self.rows.of_names(served)
        named = self.rows.named(by_sizes / sizes, gaits.jacobian)
        for name, by_keys in named.items():
            own = is_served[name]
            found[name + BY_KEY][np.ix_(gaits.lanes, keys[own])] = by_keys[own].T

        self._put_others(found, gaits, keys, is_served)

    def _put_others(
        self,
        found: Measured,
        gaits: _Some,
        keys: np.ndarray,
        is_served: Mapping[str, np.ndarray],
    ) -> None:
        """Put derivatives of single gaits by numbered keys, of measures and keys that no
        polynomials serve.
        """
        others = [name for name, own in is_served.items() if not own.all()]
        if not others:
            return

        lacks = ~np.all([is_served[name] for name in others], axis=0)
        alone = gaits.differentiated(self.problem, others, keys[lacks])
        for name, by_keys in alone.items():
            own = ~is_served[name][lacks]
            at = np.ix_(gaits.lanes, keys[lacks][own])
            found[name + BY_KEY][at] = by_keys[own].T

    def _on_piece(
        self, sheets: Sequence[Sheet], q: np.ndarray
    ) -> Iterator[tuple[Sheet, np.ndarray, np.ndarray]]:
        """Sheets with the numbers of those ln slopes (n,) of a piece that each serves,
        and its columns (columns, k) there.
        """
        if not sheets:
            return
        for sheet, some in on_sheets(sheets, q):
            points = sheet.span.points(q[some])
            # Parts that are too narrow, or hold few slopes, have no sheets.
            low, high = sheet.span.bounds
            is_inside = (q[some] >= low) & (q[some] <= high)
            is_known = sheet.is_measured(points) & is_inside
            if sheet.chart is not None and is_known.any():
                points = points[is_known]
                values = sheet.chart(points) / sheet.span.from_folds(points)
                yield sheet, some[is_known], values
