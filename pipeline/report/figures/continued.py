"""Curves through the gaits at the values of a key, which a label may leave."""

import numpy as np
import pandas as pd
import xarray as xr

from gaitsweep.pipeline.report.figures.stability import add_borders


def goes_on(angle: xr.DataArray, key: str) -> np.ndarray:
    """Whether the gait at the next value of a key is on the curve of each.

    Each must be the nearest to where the other leads. A label may pass to another curve.

    Parameters
    ----------
    angle : DataArray, dims key and gait [rad]
        Stance angles; NaN where there is no gait.
    key : str

    Returns
    -------
    ndarray of bool
        In the order of the rows of a DataFrame.
    """
    values = np.log(angle.transpose(key, "gait").values)
    at = np.asarray(angle[key].values, float)
    apart = _apart(values, at)

    own = np.arange(values.shape[1])
    nearest_after = apart.argmin(axis=2)
    nearest_before = apart.argmin(axis=1)
    has_both = (nearest_after == own) & (nearest_before == own)
    none_follows = np.zeros((1, len(own)), bool)
    going_on = np.concatenate([has_both, none_follows])

    table = xr.DataArray(
        going_on,
        dims=(key, "gait"),
    )
    rows = table.transpose(*angle.dims)
    return np.asarray(rows).ravel()


def _apart(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """How far each gait at a value of a key is from where each of those at the value
    before leads, or those from where it does, whichever is less.

    A gait leads on by the slope of its label on its other side, where there is one.

    Parameters
    ----------
    values : ndarray, shape (n, gaits)
    at : ndarray, shape (n,)
        Values of the key; where all are positive, their logarithms count.

    Returns
    -------
    ndarray, shape (n - 1, gaits, gaits)
        By the gait before and the gait after; infinite where there is none.
    """
    scale = np.log(at) if min(at) > 0 else at
    width = np.diff(scale)[:, None]
    steps = np.diff(values, axis=0)
    slope = np.nan_to_num(steps / width)
    still = np.zeros_like(slope[:1])

    slope_before = np.concatenate(
        [
            still,
            slope[:-1],
        ]
    )
    slope_after = np.concatenate(
        [
            slope[1:],
            still,
        ]
    )
    before, after = values[:-1], values[1:]
    forward = before + width * slope_before
    backward = after - width * slope_after

    ahead = after[:, None] - forward[:, :, None]
    back = backward[:, None] - before[:, :, None]
    nearer = np.fmin(
        np.abs(ahead),
        np.abs(back),
    )
    return np.nan_to_num(nearer, nan=np.inf)


def parts(curve: pd.DataFrame) -> pd.DataFrame:
    """A curve with the gaits at which its stability changes, and with a row without an
    angle after each gait that is its part's last.
    """
    is_last = ~curve["goes_on"].astype(bool)
    number = is_last.shift(fill_value=False).cumsum()
    rows = []

    for _, part in curve.groupby(number):
        gap = part.tail(1).assign(
            stance_angle=np.nan,
            stable=0.0,
        )
        whole = add_borders(part)
        rows += [
            whole.drop(columns="border", errors="ignore"),
            gap,
        ]

    return pd.concat(
        rows,
        ignore_index=True,
    )
