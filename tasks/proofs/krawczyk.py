"""Krawczyk's operator: existence and uniqueness of a zero of a gait's equations in a
box.
"""

from __future__ import annotations

from collections.abc import Sequence

from flint import arb, arb_mat

from gaitsweep.tasks.proofs.enclosure import NotProvedError


def approximate_inverse(matrix: arb_mat) -> arb_mat:
    """Inverse of a matrix's middle, without its radii: any matrix does, a good one
    proves.

    Parameters
    ----------
    matrix : arb_mat, shape (n, n)

    Returns
    -------
    arb_mat, shape (n, n)

    Raises
    ------
    NotProvedError
        If there is none.
    """
    try:
        return matrix.mid().inv().mid()
    except ZeroDivisionError:
        raise NotProvedError(
            "The equations' derivative is singular, as at a fold."
        ) from None


def image(away: Sequence[arb], defect: Sequence[arb], derivative: arb_mat) -> list[arb]:
    """K = -Y F(c) + (1 - Y F'(X)) W: zeros of F in X = c + W lie in c + K, and if K
    lies inside W there is just one.

    Parameters
    ----------
    away : sequence of arb
        W, how far the points of X lie from its middle c, which is exact.
    defect : sequence of arb
        F(c).
    derivative : arb_mat
        F'(X), the derivatives of F at every point of X.

    Returns
    -------
    list of arb

    Raises
    ------
    NotProvedError
        If F' has no approximate inverse.
    """
    n = len(away)
    inverse = approximate_inverse(derivative)
    unit = arb_mat([[int(i == j) for j in range(n)] for i in range(n)])
    step = (unit - inverse * derivative) * arb_mat(
        n, 1, list(away)
    ) - inverse * arb_mat(n, 1, list(defect))
    return list(step.entries())


def contained(image: Sequence[arb], box: Sequence[arb]) -> bool:
    """True where a box lies in another's interior.

    Parameters
    ----------
    image, box : sequence of arb
    """
    return all(x.contains_interior(k) for k, x in zip(image, box, strict=True))
