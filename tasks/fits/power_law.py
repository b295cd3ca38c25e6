"""Power laws y = a x^p, fitted over the range where the local exponent is constant to a
tolerance.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

#: Range of the local exponent allowed on a plateau, and the decades and points that a
#: plateau must span.
FLATNESS, MIN_DECADES, MIN_POINTS = 0.01, 1.0, 5


@dataclass(frozen=True)
class PowerLaw:
    """A fitted law: exponent with its interval, amplitude, and the range and number of
    points of the fit.

    The interval joins the 95 % confidence interval of the regression with the range of
    local exponents on the plateau: for computed data the curvature of the function, not
    scatter, is the error.
    """

    exponent: float
    low: float
    high: float
    amplitude: float
    x_from: float
    x_to: float
    n: int


def local_exponents(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Compute d ln y / d ln x between neighbouring points.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Positive.

    Returns
    -------
    ndarray, shape (n - 1,)
    """
    return np.diff(np.log(y)) / np.diff(np.log(x))


def fit(x: np.ndarray, y: np.ndarray) -> PowerLaw | None:
    """Fit ln y to ln x by least squares.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Positive, x increasing.

    Returns
    -------
    PowerLaw or None
        None below three points.
    """
    # `scipy.stats` has regression too, but takes longer to import than most fits to
    # compute, points included.
    from scipy.special import stdtrit

    if len(x) < 3:
        return None

    log_x, log_y = np.log(x), np.log(y)
    from_mean = log_x - log_x.mean()
    slope = float(from_mean @ (log_y - log_y.mean()) / (from_mean @ from_mean))
    intercept = log_y.mean() - slope * log_x.mean()
    local = local_exponents(x, y)
    # From the residuals: computed from 1 - r^2 the error of a good fit is lost to
    # rounding.
    residual = log_y - (intercept + slope * log_x)
    error = np.sqrt(residual @ residual / (len(x) - 2) / (from_mean @ from_mean))
    half_width = float(stdtrit(len(x) - 2, 0.975) * error)

    return PowerLaw(
        slope,
        min(slope - half_width, local.min()),
        max(slope + half_width, local.max()),
        float(np.exp(intercept)),
        float(x[0]),
        float(x[-1]),
        len(x),
    )


def plateaus(
    x: np.ndarray, y: np.ndarray, flatness: float = FLATNESS
) -> list[tuple[int, int]]:
    """Find the runs of points over which the local exponent changes by less than
    `flatness`, in order of x.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Positive, x increasing.
    flatness : float
        Allowed range of the local exponent.

    Returns
    -------
    list of (first, last)
        Inclusive indices; runs shorter than a decade or five points are no plateau.
    """
    p = local_exponents(x, y)
    runs, start = [], 0
    # Monotonic queues: indices of the run's largest and smallest exponents and of those
    # that may succeed them.
    high: deque[int] = deque()
    low: deque[int] = deque()
    for i, value in enumerate(p):
        while high and p[high[-1]] <= value:
            high.pop()
        while low and p[low[-1]] >= value:
            low.pop()
        high.append(i)
        low.append(i)
        if p[high[0]] - p[low[0]] >= flatness:
            runs.append((start, i))
        # The next run extends back over points that agree with it.
        while p[high[0]] - p[low[0]] >= flatness:
            start += 1
            for extremes in (high, low):
                if extremes[0] < start:
                    extremes.popleft()

    runs.append((start, len(p)))

    return [
        (a, b)
        for a, b in runs
        if b - a + 1 >= MIN_POINTS and np.log10(x[b] / x[a]) >= MIN_DECADES
    ]
