"""Numbers of all cells of a map in few bytes, for the page's script.

A quantity is smooth over a map but for a few curves. Cells are predicted from those
around them, on ever finer lattices, by polynomials of degree seven, and only what a
prediction misses is written: whole numbers, most of them zero. So a map of 40,000 cells
has 8 digits of a number in some 8 kilobytes (read by scripts/address.js).
"""

import itertools
import math
from collections.abc import Mapping
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
    """What predictions miss, in the order in which the script reads them."""
    m, n = exact.shape
    held, s, out = np.zeros((m, n)), 1, []
    absent = ~np.isfinite(exact)
    while 8 * s < max(m, n):
        s *= 2
    for i, j in itertools.product(range(0, m, 2 * s), range(0, n, 2 * s)):
        before = held[i, j - 2 * s] if j else held[i - 2 * s, 0] if i else 0.0
        held[i, j] = before if absent[i, j] else np.floor(exact[i, j] + 0.5)
        out.append(held[i, j : j + 1] - before)

    def settle(part: Any, predicted: np.ndarray, error: float) -> None:
        missed = ~absent[part] & (np.abs(exact[part] - predicted) > error)
        held[part] = np.where(missed, np.floor(exact[part] + 0.5), predicted)
        out.append(held[part] - predicted)

    while s >= 1:
        error = max(0.5, _ERROR / s)
        for j in range(s, n, 2 * s):
            rows = slice(0, m, 2 * s)
            settle(
                (rows, j),
                _predict([held[rows, a] for a in range(0, n, 2 * s)], j, s),
                error,
            )
        for i in range(s, m, 2 * s):
            columns = slice(0, n, s)
            settle(
                (i, columns),
                _predict([held[a, columns] for a in range(0, m, 2 * s)], i, s),
                1.5 * error,
            )
        s //= 2
    return np.concatenate(out).astype(np.int64)


def _predict(known: list[np.ndarray], x: int, s: int) -> np.ndarray:
    """Value at place x of the polynomial through the nearest of known values at 0, 2 s,
    4 s …, to a whole number.
    """
    first = max(0, min(max(0, x // (2 * s) - _WIDTH // 2 + 1), len(known) - _WIDTH))
    at = range(first, min(first + _WIDTH, len(known)))
    total: Any = 0.0
    for k in at:
        weight = math.prod(
            (x - 2 * s * b) / (2 * s * k - 2 * s * b) for b in at if b != k
        )
        total = total + known[k] * weight
    return np.asarray(np.floor(total + 0.5))


def _packed(residuals: np.ndarray) -> str:
    """Whole numbers as text: zeros by their count, others with their sign in the last
    bit.
    """
    parts = []
    for is_zero, run in itertools.groupby(
        residuals.tolist(), key=lambda value: value == 0
    ):
        if is_zero:
            parts.append("0" + _digits(len(list(run)) - 1))
        else:
            parts += [
                _digits(2 * value - 1 if value > 0 else -2 * value) for value in run
            ]
    return "".join(parts)


def _digits(value: int) -> str:
    """A whole number from 0 in base 32, the least digit first."""
    text = ""
    while value > 31:
        text += _DIGITS[32 + value % 32]
        value //= 32
    return text + _DIGITS[value]
