"""The equations of a gait, linearised in similarity coordinates, ln slope and the durations of the phases."""

from __future__ import annotations

import numpy as np

from gaitsweep.tasks.step.problem import EPS
from gaitsweep.tasks.step.several_steps import AnyStride
from gaitsweep.tasks.step.step_map import matvec


def joint(stride: AnyStride, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual and derivative of the joint equations of state and event times, both over the stance angle.

    Parameters
    ----------
    stride : Stride
        Differentiated by the slope too.
    X : ndarray, shape (m + 1, n)
        Where it was evaluated.

    Returns
    -------
    residual : ndarray, shape (n, m + k)
    derivative : ndarray, shape (n, m + k, m + 1 + k)
        By X and the durations of the phases.
    """
    derivative = joint_by_X(stride.derivative, stride, X)
    return (stride.residual / stride.y[0]).T, (derivative / stride.y[0]).transpose(2, 0, 1)


def joint_by_X(by: np.ndarray, stride: AnyStride, X: np.ndarray) -> np.ndarray:
    """Return derivatives by X and the durations of what has the derivatives `by` y, the durations and the slope.

    Parameters
    ----------
    by : ndarray, shape (i, m + k + 1, n)
    stride : Stride
    X : ndarray, shape (m + 1, n)

    Returns
    -------
    ndarray, shape (i, m + 1 + k, n)
    """
    m = len(stride.y)
    return np.concatenate([_by_X(by[:, :m], by[:, -1], stride, X), by[:, m:-1]], axis=1)


def _by_X(by_y: np.ndarray, by_slope: np.ndarray, stride: AnyStride, X: np.ndarray) -> np.ndarray:
    """Derivatives by X, shape (i, m + 1, n), of what has the derivatives by y, (i, m, n), and by the slope, (i, n)."""
    y, slope = stride.y, np.exp(X[len(stride.y)])
    return np.concatenate([matvec(by_y, y)[:, None], by_y[:, 1:] * y[0], (by_slope * slope)[:, None]], axis=1)


def determinants(matrices: np.ndarray) -> np.ndarray:
    """Return determinants.

    Parameters
    ----------
    matrices : ndarray, shape (n, i, i)

    Returns
    -------
    ndarray, shape (n,)
        NaN where a matrix is not finite.
    """
    finite = np.isfinite(matrices).all(axis=(1, 2))
    out = np.full(len(matrices), np.nan)
    out[finite] = np.linalg.det(matrices[finite])
    return out


def rounding_step(matrix: np.ndarray, stride: AnyStride) -> np.ndarray:
    """Size of a bordered Newton step that rounding alone makes.

    Parameters
    ----------
    matrix : ndarray, shape (n, m + 1 + k, m + 1 + k)
        Of the joint equations, and the border.
    stride : Stride

    Returns
    -------
    ndarray, shape (n,)
    """
    m, y = len(stride.y), np.abs(stride.y) / stride.y[0]
    inverse = np.linalg.inv(matrix)[:, : m + 1]
    error = np.abs(inverse) @ np.vstack([y, np.ones((matrix.shape[1] - m, y.shape[1]))]).T[..., None]
    # Rounding of the start, carried through the step; the inverse takes back most of what the step amplifies.
    carried = stride.derivative[:, :m].transpose(2, 0, 1) + np.eye(len(stride.derivative), m)
    error = error + np.abs(inverse[..., :-1] @ carried) @ y.T[..., None]
    return 6 * EPS * np.nan_to_num(error).max(axis=(1, 2))
