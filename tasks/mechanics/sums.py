"""Sums over the leading axes of arrays of lanes, always added in the same order.

The order in which numpy's own reductions and products of matrices add depends on the
number of lanes and on where they lie in memory, and with it the last bits of each; so
does a power with an array of exponents.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable

import numpy as np
from numpy import ndarray

#: Numbers in a term up to which all terms are added by one call, which finds every
#: partial sum and so adds in order too; longer ones are added term by term.
_FEW = 256


def total(terms: Iterable[ndarray]) -> ndarray:
    """Sum of arrays, or of an array over its first axis.

    Parameters
    ----------
    terms : iterable of ndarray
        Of one shape.

    Returns
    -------
    ndarray
        Of that shape.
    """
    if isinstance(terms, ndarray) and terms[0].size <= _FEW:
        return np.add.accumulate(terms, axis=0, dtype=terms.dtype)[-1]
    return functools.reduce(operator.add, terms)


def norm(vectors: ndarray) -> ndarray:
    """Lengths of vectors.

    Parameters
    ----------
    vectors : ndarray, shape (m, ...)

    Returns
    -------
    ndarray, shape (...)
    """
    return np.asarray(np.sqrt(total(vectors * vectors)))


def polynomial(coefficients: ndarray, x: ndarray) -> ndarray:
    """Values of polynomials, the coefficient of the highest power first.

    Parameters
    ----------
    coefficients : ndarray, shape (m, n)
    x : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
    """
    return functools.reduce(
        lambda value, coefficient: value * x + coefficient, coefficients
    )


def matvec(A: ndarray, v: ndarray) -> ndarray:
    """Product A v of every lane.

    Parameters
    ----------
    A : ndarray, shape (i, j, n), or (i, j, 1, n) for a product of matrices
    v : ndarray, shape (j, n), or (j, k, n)

    Returns
    -------
    ndarray, shape (i, n), or (i, k, n)
    """
    if A[:, 0].size * v[0].size <= _FEW * A.shape[-1]:
        terms = A * v
        return np.add.accumulate(terms, axis=1, dtype=terms.dtype)[:, -1].copy()
    return total(A[:, j] * v[j] for j in range(A.shape[1]))
