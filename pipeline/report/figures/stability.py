"""Where a curve of gaits becomes stable or unstable, between the points computed."""

import numpy as np
import pandas as pd

#: Points from which a border is interpolated, where stability changes once among them.
_AROUND = 4


def add_borders(curve: pd.DataFrame) -> pd.DataFrame:
    """A curve of gaits with a stable point at each place where |λ| passes 1.

    Its columns are polynomials of ln max |λ| through the points around, those of
    positive numbers by their logarithms: the slope of a flip of figure 11 is found to
    0.1 %. They have a `border`, and no command reproduces them. A curve without
    spectral radii, or with the same stability everywhere, stays as it is.
    """
    if not {"spectral_radius", "stable"} <= set(curve.columns):
        return curve

    radius = np.log(curve["spectral_radius"].to_numpy(float))
    stable = curve["stable"].to_numpy(float)
    is_known = np.isfinite(radius[1:]) & np.isfinite(radius[:-1])
    changes = np.flatnonzero(is_known & (stable[1:] != stable[:-1]))
    if not len(changes):
        return curve

    computed = curve.reset_index(drop=True).assign(border=False)
    borders = [_border(computed, radius, int(k)) for k in changes]
    return pd.concat([computed, *borders]).sort_index().reset_index(drop=True)


def _border(curve: pd.DataFrame, radius: np.ndarray, k: int) -> pd.DataFrame:
    """The row between rows k and k + 1 at which |λ| is 1."""
    near = _support(radius, k)
    weights = _weights_at_zero(radius[near])

    row = curve.iloc[[k]].copy()
    for name in curve.columns:
        values = curve[name].to_numpy()[near]
        if values.dtype.kind != "f":
            continue
        if (values > 0).all():
            row[name] = np.exp(weights @ np.log(values))
        else:
            row[name] = weights @ values

    row["stable"] = 1.0
    row["spectral_radius"] = 1.0
    row["border"] = True
    row.index = pd.Index([k + 0.5])
    return row


def _weights_at_zero(points: np.ndarray) -> np.ndarray:
    """Weights of values at some points in their polynomial at 0 (Lagrange)."""
    weights = []
    for own in points:
        others = points[points != own]
        weights.append(np.prod(others / (others - own)))
    return np.array(weights)


def _support(radius: np.ndarray, k: int) -> list[int]:
    """Rows from which a border is interpolated: four whose radii rise or fall together,
    else the two beside it.
    """
    first = k - _AROUND // 2 + 1
    wide = list(range(first, first + _AROUND))
    if first >= 0 and wide[-1] < len(radius):
        steps = np.diff(radius[wide])
        rises = bool((steps > 0).all())
        falls = bool((steps < 0).all())
        if rises or falls:
            return wide
    return [k, k + 1]
