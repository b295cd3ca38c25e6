"""Points that are not integrated: gaits to a wanted accuracy from polynomials over panels of their branches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tasks import status
from tasks.accuracy import nodes_for
from tasks.continuation.branch import Branch
from tasks.families.panels import Panel, Sampled, fit_panels, panels_over
from tasks.families.pieces import Piece, pieces_of
from tasks.fixed_points.newton import curvature
from tasks.fixed_points.polish import Guesses, join, settle
from tasks.fixed_points.rounding import rounding_std
from tasks.measures.gaits import Arrays, Part, describe
from tasks.measures.smooth import Smooth
from tasks.step.problem import Problem

#: Share of the accuracy that polynomials may use; numbers are also rounded.
SHARE = 0.9
#: Gaits nearer an end of their branch in ln slope are integrated, and so are those whose errors reach it.
_NEAR_END, _END_SAFETY = 1e-9, 8.0
#: Gaits of one label whose angles differ by fewer accuracies are integrated, and those with ratios as near 1/2.
TIE = 4.0
#: Samples of a panel at which rounding and Lipschitz constants are measured, where the atlas has none, and the factor
#: on the largest of these constants.
_MEASURED = 3
_LIPSCHITZ_SAFETY = 2.0


def has_one_label(low: float, high: float, error: float) -> bool:
    """Whether gaits have the same label wherever between two bounds their ratio lies, whatever the error."""
    return low > 0.5 + TIE * error or high < 0.5 - TIE * error


def _margins(piece: Piece) -> tuple[float, float]:
    """How far from both ends of a piece gaits are given by polynomials, in ln slope; at a fold anywhere."""
    low, high = (
        0.0 if is_fold else _NEAR_END + _END_SAFETY * error
        for is_fold, error in zip(piece.folds, piece.end_errors, strict=True)
    )
    return low, high


class Interpolation:
    """Gaits of one line to an accuracy, from polynomials where they reach it.

    Parameters
    ----------
    problem : Problem
    branches : list of Branch
    want : sequence of str
        Names of variables.
    accuracy : float
    slope : ndarray, shape (n,) [rad]
        All slopes for which panels are to be made.
    """

    def __init__(
        self, problem: Problem, branches: list[Branch], want: Sequence[str], accuracy: float, slope: np.ndarray
    ):
        self.problem, self.accuracy, self.want = problem, accuracy, want
        self.smooth = Smooth.of(problem.walker, want, problem.m)
        self.pieces = pieces_of(branches)
        q = np.sort(np.log(slope))
        roots = [
            panel
            for k, piece in enumerate(self.pieces)
            for panel in panels_over(k, *piece.q, piece.folds, q[piece.branch.covered(piece.first, piece.last, q)])
        ]

        def is_needed(panel: Panel) -> bool:
            low, high = panel.bounds
            return bool(np.searchsorted(q, high, side="right") > np.searchsorted(q, low))

        fitted = fit_panels(roots, nodes_for(accuracy), SHARE * accuracy, self._solve, is_needed)
        self.panels = [[panel for panel in fitted if panel.piece == k] for k in range(len(self.pieces))]

    def _solve(self, panels: list[Panel], slopes: list[np.ndarray]) -> list[Sampled]:
        """Solve the samples of panels, all side by side."""
        problem, samples = self.problem, len(slopes[0])
        q = np.concatenate(slopes)
        slope = np.exp(q)
        guesses = join([self.pieces[p.piece].guesses(each) for p, each in zip(panels, slopes, strict=True)])
        if np.isnan(guesses.rounding_std).any():
            guesses = self._measured(guesses, q, samples)
        at = settle(problem, guesses, accuracy=self.accuracy)
        solved = describe(problem, problem.walker, at, slope, self.want)
        values, size = self.smooth.columns(slope, solved, at.stride.jacobian)
        good = np.isin(solved["status"], status.SOLVED) & np.isfinite(values).all(axis=1)
        results = []
        for k in range(len(panels)):
            part = slice(k * samples, (k + 1) * samples)
            passes = solved["passes"][part]
            alike = bool(good[part].all() and (passes == passes[0]).all())
            bound = float(solved["error_bound"][part].max()) if alike else np.inf
            results.append(Sampled(values[part], size[part], bound, int(passes[0]), alike))
        return results

    def _measured(self, guesses: Guesses, q: np.ndarray, samples: int) -> Guesses:
        """Guesses with rounding and Lipschitz constants that are measured at a few of the samples of each panel."""
        lanes = (np.arange(0, len(q), samples)[:, None] + np.linspace(0, samples - 1, _MEASURED).astype(int)).ravel()
        w, m = guesses.w[:, lanes], self.problem.m
        lipschitz, gradient = curvature(self.problem, np.vstack([w[:m], q[lanes]]), w[m:])
        lipschitz = lipschitz.reshape(-1, _MEASURED).max(axis=1)
        gradient = gradient.reshape(*gradient.shape[:2], -1, _MEASURED).mean(axis=-1)
        variance = rounding_std(self.problem, w, q[lanes]).reshape(len(guesses.rounding_std), -1, _MEASURED) ** 2
        return replace(
            guesses,
            lipschitz=np.repeat(_LIPSCHITZ_SAFETY * lipschitz, samples),
            gradient=np.repeat(gradient, samples, axis=-1),
            rounding_std=np.repeat(np.sqrt(variance.mean(axis=2)), samples, axis=1),
        )

    def parts(self, slope: np.ndarray) -> tuple[list[Part], dict[tuple[int, int], np.ndarray]]:
        """Gaits of the polynomials, and which gaits are to be integrated.

        Parameters
        ----------
        slope : ndarray, shape (n,) [rad]
            Of those for which panels were made.

        Returns
        -------
        parts : list of Part
            Without those that are to be integrated.
        integrated : dict of ndarray of int
            Indices of their slopes, by numbers of the branches and of the first nodes of their pieces.
        """
        q = np.log(slope)
        gaits: list[_PanelGaits] = []
        integrated: list[list[np.ndarray]] = []
        for k, piece in enumerate(self.pieces):
            index = piece.branch.covered(piece.first, piece.last, q)
            (low, high), margins = piece.q, _margins(piece)
            inside = (q[index] - low > margins[0]) & (high - q[index] > margins[1])
            integrated.append([index[~inside]])
            index, panels = index[inside], self.panels[k]
            which = np.searchsorted([panel.bounds[0] for panel in panels], q[index], side="right") - 1
            which = np.maximum(which, 0)
            for number in range(which.min(initial=len(panels)), which.max(initial=-1) + 1):
                panel, own = panels[number], index[which == number]
                if not len(panel.coefficients):
                    integrated[k].append(own)
                    continue
                x = panel.point(q[own])
                measured = panel.is_measured(x)
                integrated[k].append(own[~measured])
                if panel.passes == 1:
                    one = self._evaluate(k, panel, own[measured], x[measured])
                    integrated[k].append(one.index[one.uncertain])
                    gaits.append(one)
        tied = self._ties(gaits, len(slope))
        for one in gaits:
            integrated[one.piece].append(one.index[tied[one.index]])
        parts = [self._part(one, slope, ~(one.uncertain | tied[one.index])) for one in gaits]
        keys = [(piece.number, piece.first) for piece in self.pieces]
        return parts, {key: np.unique(np.concatenate(each)) for key, each in zip(keys, integrated, strict=True)}

    def _evaluate(self, piece: int, panel: Panel, index: np.ndarray, x: np.ndarray) -> _PanelGaits:
        """Gaits of a panel, with what their labels need."""
        names = self.smooth.names
        ratio = names.index("heelstrike_rate_ratio")
        low, high = panel.range_of(ratio)
        columns = {"stance_angle": panel.evaluate(x, names.index("stance_angle"))}
        if has_one_label(low, high, panel.error):
            ratios = np.full(len(x), 0.5 * (low + high))
        else:
            ratios = columns["heelstrike_rate_ratio"] = panel.evaluate(x, ratio)
        uncertain = np.abs(ratios - 0.5) <= TIE * panel.error
        if self.smooth.entries:
            for name in self.smooth.entries:
                columns[name] = panel.evaluate(x, names.index(name))
            columns |= self.smooth.multipliers(columns, panel.error)
            # Whether a gait is stable does not depend on the accuracy.
            largest = columns["spectral_radius"]
            uncertain |= np.abs(largest - 1) <= columns["multiplier_error_bound"]
        return _PanelGaits(piece, panel, index, x, columns, ratios, uncertain)

    def _ties(self, gaits: list[_PanelGaits], n: int) -> np.ndarray:
        """Whether gaits of one label at a slope are so near each other that errors may order them, shape (n,)."""
        tied = np.zeros(n, bool)
        for label in (True, False):
            angles = np.full((len(gaits), n), np.nan)
            for row, one in zip(angles, gaits, strict=True):
                row[one.index] = np.where((one.ratio < 0.5) == label, one.columns["stance_angle"], np.nan)
            crowded = np.flatnonzero(np.isfinite(angles).sum(axis=0) > 1)
            if len(crowded):
                gaps = np.diff(np.sort(angles[:, crowded], axis=0), axis=0)
                tied[crowded] |= (gaps <= TIE * self.accuracy).any(axis=0)
        return tied

    def _part(self, one: _PanelGaits, slope: np.ndarray, keep: np.ndarray) -> Part:
        """Variables of gaits of a panel."""
        index, x = (one.index, one.x) if keep.all() else (one.index[keep], one.x[keep])
        columns = {name: value if keep.all() else value[keep] for name, value in one.columns.items()}
        names, panel = self.smooth.names, one.panel
        for k in self.smooth.needed(self.want):
            if names[k] not in columns:
                columns[names[k]] = panel.evaluate(x, k)
        piece = self.pieces[one.piece]
        solved = self.smooth.gaits(slope[index], columns, self.want, panel.error, piece.number, piece.place)
        return Part(index, columns["stance_angle"], one.ratio if keep.all() else one.ratio[keep], solved)


@dataclass(frozen=True)
class _PanelGaits:
    """Gaits of a panel: indices of their slopes, their points, what was evaluated, their ratios.

    `uncertain` is whether errors could change their label or stability.
    """

    piece: int
    panel: Panel
    index: np.ndarray
    x: np.ndarray
    columns: Arrays
    ratio: np.ndarray
    uncertain: np.ndarray
