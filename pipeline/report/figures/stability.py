"""Where a curve of gaits becomes stable or unstable, between the points computed."""

import numpy as np
import pandas as pd
import xarray as xr

#: Points from which a border is interpolated, where stability changes once among them.
_AROUND = 4
#: Products of 1 - λ and 1 + λ over all multipliers, which vanish at folds and flips, by
#: the multiplier there.
TESTS = {"fold_test": 1.0, "flip_test": -1.0}


def add_borders(curve: pd.DataFrame) -> pd.DataFrame:
    """A curve of gaits with a stable point at each place where |λ| passes 1.

    Its columns are polynomials, through the points around, of what vanishes there:
    of a column of `TESTS` that changes its sign, which is smooth where multipliers meet,
    else of ln max |λ|. Those of positive numbers are so by their logarithms: the slope
    of a flip of figure 11 is found to 0.1 %. They have a `border`, and no command reproduces them. A curve without
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
    borders = [_border(computed, _vanishing(curve, int(k)), int(k)) for k in changes]
    return pd.concat([computed, *borders]).sort_index().reset_index(drop=True)


def tests(grid: xr.Dataset) -> dict[str, xr.DataArray]:
    """The columns of `TESTS` of a grid; none if it holds no multipliers."""
    if not {"multiplier_real", "multiplier_imag"} <= set(grid.variables):
        return {}

    multipliers = (grid["multiplier_real"] + 1j * grid["multiplier_imag"]).fillna(0)
    is_gait = grid["spectral_radius"].notnull()

    return {
        name: (1 - sign * multipliers).prod("multiplier").real.where(is_gait)
        for name, sign in TESTS.items()
    }


def _vanishing(curve: pd.DataFrame, k: int) -> np.ndarray:
    """What passes 0 between rows k and k + 1, where stability changes."""
    for name in TESTS:
        values = curve[name].to_numpy() if name in curve else np.ones(len(curve))
        if values[k] * values[k + 1] < 0:
            return values
    return np.log(curve["spectral_radius"].to_numpy(float))


def _border(curve: pd.DataFrame, vanishing: np.ndarray, k: int) -> pd.DataFrame:
    """The row between rows k and k + 1 at which |λ| is 1, and something vanishes."""
    near = _support(vanishing, k)
    weights = _weights_at_zero(vanishing[near])

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


def _support(values: np.ndarray, k: int) -> list[int]:
    """Rows from which a border is interpolated: four whose values rise or fall together,
    else the two beside it.
    """
    first = k - _AROUND // 2 + 1
    wide = list(range(first, first + _AROUND))
    if first >= 0 and wide[-1] < len(values):
        steps = np.diff(values[wide])
        rises = bool((steps > 0).all())
        falls = bool((steps < 0).all())
        if rises or falls:
            return wide

    return [k, k + 1]
