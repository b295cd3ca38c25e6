"""Planes of keys to a wanted accuracy: gaits from polynomials over slope and keys, where they reach it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tasks.families.box import tensor_nodes
from tasks.families.cell import Cell, Family
from tasks.families.panels import Sampled, value_bounds
from tasks.families.patch import Patch, along, coordinate, evaluate, side_of_fold, tails
from tasks.fixed_points.polish import UNKNOWN, Guesses, Polished, settle
from tasks.interpolate_points import SHARE, TIE, has_one_label
from tasks.measures.gaits import Arrays, Part, describe
from tasks.measures.smooth import Smooth
from tasks.step.problem import Lanes

#: How far Newton's method may move a prediction, in units of the largest error that was measured.
PREDICTED_WITHIN = 8.0
#: By how much the Lipschitz constant may exceed that at the nearest places where it was measured.
_LIPSCHITZ_SAFETY = 4.0
#: Most nodes of a polynomial along the piece and along each key, and points drawn to check it.
_MAX_NODES, _DRAWN = 13, 64


def patch_guesses(patch: Patch, w: np.ndarray, node: np.ndarray, slope: np.ndarray) -> Guesses:
    """Guesses of gaits by a patch.

    Parameters
    ----------
    patch : Patch
    w : ndarray, shape (m + k, n)
    node : ndarray of int, shape (n,)
        As `Patch.predict` gives them.
    slope : ndarray, shape (n,) [rad]
    """
    last = len(patch.lipschitz) - 1
    around = [np.clip(node + i, 0, last) for i in (-1, 0, 1)]
    lipschitz = _LIPSCHITZ_SAFETY * np.max([patch.lipschitz[k] for k in around], axis=0)
    std = np.max([patch.rounding_std[k] for k in around], axis=0).T
    gradient = np.moveaxis(patch.gradient[node], 0, -1)
    return Guesses(w, slope, lipschitz, gradient, std, np.full(len(slope), UNKNOWN))


def similarity(at: Polished) -> np.ndarray:
    """Similarity coordinates of gaits.

    Parameters
    ----------
    at : Polished
        Of n lanes.

    Returns
    -------
    ndarray, shape (m + k, n)
    """
    return np.vstack([np.log(at.y[:1] * at.scale), at.y[1:] / at.y[0], at.times])


def are_predicted(at: Polished, guesses: Guesses, error: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Whether gaits are converged steps as near their predictions as they should be, on the right side of a fold.

    Parameters
    ----------
    at : Polished
        Of n lanes.
    guesses : Guesses
    error, side : ndarray, shape (n,)
        Those of the gaits' patches.

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    with np.errstate(invalid="ignore"):
        moved = np.abs(similarity(at) - guesses.w).max(axis=0)
    fine = at.converged & at.step & (moved < PREDICTED_WITHIN * error)
    return np.asarray(fine & (side_of_fold(at.stride) == side))


@dataclass(frozen=True)
class Sheet:
    """Polynomials of smooth quantities over the domain of a patch.

    Attributes
    ----------
    patch : Patch
    names : tuple of str
        Of the quantities.
    sizes : tuple of int
        Nodes along the piece and along each key.
    coefficients : ndarray, shape (product of sizes, c)
    error : float
        Bound of their errors, each relative to the size of its quantity.
    passes : int
        How often the legs pass.
    """

    patch: Patch
    names: tuple[str, ...]
    sizes: tuple[int, ...]
    coefficients: np.ndarray
    error: float
    passes: int

    def ratio_range(self) -> tuple[float, float]:
        """Bounds of the gait ratio."""
        return value_bounds(self.coefficients[:, self.names.index("heelstrike_rate_ratio")])


def sheets(family: Family, cell: Cell, want: Sequence[str], accuracy: float, points: int) -> list[Sheet]:
    """Fit polynomials to the gaits of every patch of a cell.

    Parameters
    ----------
    family : Family
    cell : Cell
    want : sequence of str
        Names of variables.
    accuracy : float
    points : int
        How many points of the study the cell has.

    Returns
    -------
    list of Sheet
        Empty where a patch has none that reaches the accuracy with fewer gaits than points.
    """
    fitted = []
    for patch in cell.patches:
        sheet = _sheet(family, cell, patch, want, accuracy, points)
        if sheet is None:
            return []
        fitted.append(sheet)
    return fitted


def _sheet(family: Family, cell: Cell, patch: Patch, want: Sequence[str], accuracy: float, points: int) -> Sheet | None:
    sizes, d = patch.sizes, len(family.keys)
    drawn = cell.box.draw(_DRAWN, 1 + d, f"sheet {patch.numbers[0]}")
    while math.prod(sizes) + _DRAWN < points:
        names, sampled = _sampled(family, cell, patch, np.vstack([tensor_nodes(sizes), drawn]), want, accuracy)
        if not sampled.good:
            return None
        coefficients, off = sampled.fit(drawn, sizes)
        tail = tails(coefficients / sampled.size.min(axis=0), sizes)
        error = float(off + tail.sum() + sampled.bound)
        if error <= SHARE * accuracy:
            sheet = Sheet(patch, names, sizes, coefficients, error, sampled.passes)
            return sheet if has_one_label(*sheet.ratio_range(), error) else None
        grow = tail > 0.1 * accuracy / len(tail)
        grow |= not grow.any()
        # A piece that ends may begin with more.
        larger = tuple(max(n, min(n + 2 * int(more), _MAX_NODES)) for n, more in zip(sizes, grow, strict=True))
        if larger == sizes:
            return None
        sizes = larger
    return None


def _sampled(
    family: Family, cell: Cell, patch: Patch, points: np.ndarray, want: Sequence[str], accuracy: float
) -> tuple[tuple[str, ...], Sampled]:
    """Names of quantities, and what was solved at points (n, 1 + d) of a patch."""
    unit = points[:, 1:]
    ends = patch.ends_at(unit)
    q = ends[:, 0] + along(0.5 * (1 + points[:, 0]), patch.folds, patch.vanishing) * (ends[:, 1] - ends[:, 0])
    w, node = patch.predict(unit, q, ends)
    walkers = family.walkers(cell.box.at(unit))
    problem, slope = Lanes(walkers, cell.structure), np.exp(q)
    guesses = patch_guesses(patch, w, node, slope)
    at = settle(problem, guesses, sampled=True, accuracy=accuracy)
    fine = are_predicted(at, guesses, np.full(len(q), patch.error), np.full(len(q), patch.side))
    solved = describe(problem, walkers, at, slope, want)
    smooth = Smooth.of(walkers, want, problem.m)
    values, size = smooth.columns(slope, solved, at.stride.jacobian)
    passes = solved["passes"]
    good = bool(fine.all() and np.isfinite(values).all() and (passes == passes[0]).all())
    return smooth.names, Sampled(values, size, float(solved["error_bound"].max()), int(passes[0]), good)


def interpolate(
    family: Family,
    cell: Cell,
    made: Sequence[Sheet],
    keys: np.ndarray,
    slope: np.ndarray,
    want: Sequence[str],
    accuracy: float,
) -> tuple[list[Part], np.ndarray]:
    """Gaits of lines in a cell by its polynomials.

    Parameters
    ----------
    family : Family
    cell : Cell
    made : sequence of Sheet
    keys : ndarray, shape (n, d)
    slope : ndarray, shape (s,) [rad]
    want : sequence of str
    accuracy : float

    Returns
    -------
    parts : list of Part
        With indices into the n s points.
    sure : ndarray of bool, shape (n,)
        Lines whose labels and stability do not depend on errors, and of which no step nearly vanishes; the others are
        to be integrated.
    """
    n, s = len(keys), len(slope)
    unit, q = cell.box.unit(keys), np.log(slope)
    sure, parts = np.ones(n, bool), []
    walkers = family.walkers(keys)
    for sheet in made:
        patch = sheet.patch
        ends = patch.ends_at(unit)
        inside = (ends[:, :1] <= q) & (q <= ends[:, 1:])
        index = np.flatnonzero(inside)
        if sheet.passes != 1 or not len(index):
            continue
        line = index // s
        low, high = ends[line].T
        np.logical_and.at(sure, line, patch.reaches(q[index % s], ends[line]))
        x = 2 * coordinate((q[index % s] - low) / (high - low), patch.folds, patch.vanishing) - 1
        own = walkers.some(line)
        smooth = Smooth.of(own, want, cell.structure.dimension)
        needed = sorted({*smooth.needed(want), 0})
        values = evaluate(np.column_stack([x, unit[line]]), sheet.sizes, sheet.coefficients[:, needed])
        columns: Arrays = {smooth.names[k]: value for k, value in zip(needed, values.T, strict=True)}
        if smooth.entries:
            columns |= smooth.multipliers(columns, sheet.error)
            near = np.abs(columns["spectral_radius"] - 1) <= columns["multiplier_error_bound"]
            np.logical_and.at(sure, line, ~near)
        solved = smooth.gaits(slope[index % s], columns, want, sheet.error, *patch.numbers_at(unit[line]).T)
        ratio = np.full(len(index), np.mean(sheet.ratio_range()))
        parts.append(Part(index, columns["stance_angle"], ratio, solved))
    for one, other in combinations(parts, 2):
        if (one.ratio[0] < 0.5) == (other.ratio[0] < 0.5):
            both, a, b = np.intersect1d(one.index, other.index, assume_unique=True, return_indices=True)
            sure[both[np.abs(one.angle[a] - other.angle[b]) <= TIE * accuracy] // s] = False
    return parts, sure
