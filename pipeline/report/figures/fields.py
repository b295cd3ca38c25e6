"""Numbers of all cells of a map in few bytes, for the page's script.

A quantity is smooth over a map but for a few curves. Cells are predicted from those
around them, on ever finer lattices, by polynomials of degree seven, and only what a
prediction misses is written: whole numbers, most of them zero. So a map of 40,000 cells
has 8 digits of a number in some 8 kilobytes (read by scripts/address.js).
"""

import itertools
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

#: Characters of numbers, five bits each; the second half says that more follow.
_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ-_"
#: Cells that a prediction uses, along a row or a column.
_WIDTH = 8
#: Error allowed on the finest lattice [steps]; coarser ones, whose errors are carried
#: on to it, are held more closely.
_ERROR = 8.0


def numbers(values: np.ndarray, step: float, log: bool = False) -> dict[str, Any]:
    """Encode numbers to within 12 steps.

    Parameters
    ----------
    values : ndarray, shape (m, n)
        NaN where there is none; what is read there means nothing.
    step : float
        Resolution, of the logarithm of the values with `log`.
    log : bool
        Encode logarithms.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = (np.log(values) if log else np.asarray(values, float)) / step
    return {"text": _packed(_residuals(exact)), "step": step, "log": log}


def words(values: np.ndarray) -> dict[str, Any]:
    """Encode words, or truth values, of shape (m, n), as runs of equal ones."""
    flat = values.ravel().tolist()
    known = sorted(set(flat))
    runs = [
        (known.index(word), len(list(run))) for word, run in itertools.groupby(flat)
    ]

    return {
        "text": "".join(_digits(word) + _digits(length - 1) for word, length in runs),
        "words": known,
    }


def fitting(
    columns: Mapping[str, tuple[np.ndarray, float, bool]], room: int
) -> dict[str, dict[str, Any]]:
    """Encode columns (values, step, log) in at most `room` characters, if need be with
    fewer digits.
    """
    for coarser in (1, 10, 100, 1000, 10_000):
        fields = {
            name: numbers(values, step * coarser, log)
            for name, (values, step, log) in columns.items()
        }
        if sum(len(field["text"]) for field in fields.values()) <= room:
            return fields

    return {}


def _residuals(exact: np.ndarray) -> np.ndarray:
    """What predictions miss, in the order in which the script reads them: a coarse grid,
    each value from the one before, then what halves the grid's steps, columns and rows.
    """
    held = _Held(exact)
    step = 1
    while 8 * step < max(exact.shape):
        step *= 2
    _hold_coarse(held, 2 * step)
    while step >= 1:
        _hold_finer(held, step)
        step //= 2

    return np.concatenate(held.residuals).astype(np.int64)


def _hold_coarse(held: "_Held", step: int) -> None:
    """Hold every so many values, each as the whole number that it is."""
    m, n = held.values.shape
    for i, j in itertools.product(range(0, m, step), range(0, n, step)):
        before = 0.0
        if j:
            before = held.values[i, j - step]
        elif i:
            before = held.values[i - step, 0]
        held.settle((i, slice(j, j + 1)), np.array([before]), 0.0)


def _hold_finer(held: "_Held", step: int) -> None:
    """Hold the values between those at twice a step: columns, then rows."""
    m, n = held.values.shape
    error = max(0.5, _ERROR / step)
    every_other = slice(0, None, 2 * step)
    between = slice(step, None, 2 * step)

    known = held.values[every_other, every_other].T
    columns = _predict(known, range(step, n, 2 * step), step).T
    held.settle((every_other, between), columns, error, by_columns=True)

    held_so_far = slice(0, None, step)
    known = held.values[every_other, held_so_far]
    rows = _predict(known, range(step, m, 2 * step), step)
    held.settle((between, held_so_far), rows, 1.5 * error)


class _Held:
    """Values (m, n) as the script will hold them, and by what each missed its
    prediction, 0 where that is as near as wanted.
    """

    def __init__(self, exact: np.ndarray):
        self.exact, self.absent = exact, ~np.isfinite(exact)
        self.values = np.zeros_like(exact, float)
        self.residuals = list[np.ndarray]()

    def settle(
        self, part: Any, predicted: np.ndarray, error: float, by_columns: bool = False
    ) -> None:
        """Hold a part as predicted, or to a whole number where that errs by more; it is
        read by rows or by columns.
        """
        exact = self.exact[part]
        missed = ~self.absent[part] & (np.abs(exact - predicted) > error)
        self.values[part] = np.where(missed, np.floor(exact + 0.5), predicted)
        residuals = self.values[part] - predicted
        self.residuals.append(residuals.ravel(order="F" if by_columns else "C"))


def _predict(known: np.ndarray, places: Sequence[int], s: int) -> np.ndarray:
    """Values at some places of the polynomials through the nearest of the rows of known
    values at 0, 2 s, 4 s …, to a whole number.
    """
    total = np.zeros((len(places), known.shape[1]))
    if not len(places):
        return total

    # One term after the other, as the script adds them: sums round alike.
    terms = zip(*(_weights(len(known), x, s) for x in places), strict=True)
    for term in terms:
        rows, weights = zip(*term, strict=True)
        total += known[list(rows)] * np.array(weights)[:, None]

    return np.asarray(np.floor(total + 0.5))


@lru_cache(4096)
def _weights(count: int, x: int, s: int) -> list[tuple[int, float]]:
    """Numbers of the nearest of some nodes at 0, 2 s, 4 s …, and weights of their values
    in that of their polynomial at place x (Lagrange): those of all fields of a map.
    """
    apart = 2 * s
    first = x // apart - _WIDTH // 2 + 1
    first = max(0, min(first, count - _WIDTH))
    last = min(first + _WIDTH, count)
    nodes = range(first, last)

    weights = []
    for k in nodes:
        weight = 1.0
        for other in nodes:
            if other != k:
                weight *= (x - apart * other) / (apart * k - apart * other)
        weights.append((k, weight))

    return weights


def _packed(residuals: np.ndarray) -> str:
    """Whole numbers as text: zeros by their count, others with their sign in the last
    bit.
    """
    places = np.flatnonzero(residuals)
    values = residuals[places]
    zeros = np.diff(places, prepend=-1, append=len(residuals)) - 1
    signed = np.where(values > 0, 2 * values - 1, -2 * values)

    parts = []
    for before, value in itertools.zip_longest(zeros.tolist(), signed.tolist()):
        if before:
            parts.append("0" + _digits(before - 1))
        if value is not None:
            parts.append(_digits(value))

    return "".join(parts)


def _digits(value: int) -> str:
    """A whole number from 0 in base 32, the least digit first."""
    text = ""
    while value > 31:
        text += _DIGITS[32 + value % 32]
        value //= 32
    return text + _DIGITS[value]
