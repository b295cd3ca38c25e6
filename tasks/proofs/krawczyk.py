"""Krawczyk's operator: existence and uniqueness of a zero of a gait's equations in a box."""

from __future__ import annotations

from collections.abc import Sequence

from flint import arb, arb_mat

from gaitsweep.tasks.proofs.enclosure import NotProvedError


def approximate_inverse(matrix: arb_mat) -> arb_mat:
    """Inverse of a matrix's middle, without its radii: any matrix does, a good one proves.

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
        raise NotProvedError("The equations' derivative is singular, as at a fold.") from None


def image(middle: Sequence[arb], box: Sequence[arb], defect: Sequence[arb], derivative: arb_mat) -> list[arb]:
    """K = c - Y F(c) + (1 - Y F'(X)) (X - c): it holds every zero of F in X, and if it lies inside X there is just one.

    Parameters
    ----------
    middle, box : sequence of arb
        c, exact, and X, which holds it.
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
    n = len(middle)
    inverse = approximate_inverse(derivative)
    unit = arb_mat([[int(i == j) for j in range(n)] for i in range(n)])
    away = arb_mat(n, 1, [x - c for x, c in zip(box, middle, strict=True)])
    step = (unit - inverse * derivative) * away - inverse * arb_mat(n, 1, list(defect))
    return [c + s for c, s in zip(middle, step.entries(), strict=True)]


def contained(image: Sequence[arb], box: Sequence[arb]) -> bool:
    """True where a box lies in another's interior.

    Parameters
    ----------
    image, box : sequence of arb
    """
    return all(x.contains_interior(k) for k, x in zip(image, box, strict=True))
