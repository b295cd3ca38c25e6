"""Fits over whole lines of gaits: scaling laws and the transition."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tasks.fits import power_law
from tasks.fits import transition as laws
from tasks.registry import GAITS

Arrays = dict[str, np.ndarray]
#: How the fitted quantities depend on each other: name, abscissa, ordinate.
QUANTITIES = (("stance_angle", "slope", "stance_angle"), ("speed", "slope", "speed"), ("power_speed", "speed", "power"))


def scaling(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Power laws of both gaits of every line, at vanishing and at larger slopes (section 6.2 of the paper).

    Parameters
    ----------
    params : mapping
        `lines`.
    inputs : list
        One dict a line: `slope` (n,), `stance_angle`, `speed`, `power` (n, gaits).

    Returns
    -------
    dict
        Table `fits/scaling`, a row per line, gait, quantity and regime; where there is no plateau the numbers are
        NaN and `n` is 0.
    """
    rows: list[dict[str, Any]] = []
    for line, data in zip(params["lines"], inputs):
        for g, gait in enumerate(GAITS[:2]):
            for quantity, abscissa, ordinate in QUANTITIES:
                x = data["slope"] if abscissa == "slope" else data[abscissa][:, g]
                y = data[ordinate][:, g]
                good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
                order = np.argsort(x[good])
                rows += _laws(line, gait, quantity, x[good][order], y[good][order])
    return _table("fits/scaling", rows)


def _laws(line: Mapping[str, Any], gait: str, quantity: str, x: np.ndarray, y: np.ndarray) -> list[dict[str, Any]]:
    """The law at the smallest abscissae, and the one at the largest if it is another."""
    head = {**_coordinates(line), "gait": gait, "quantity": quantity}
    runs = power_law.plateaus(x, y) if len(x) > power_law.LEAST_POINTS else []
    small = min(runs, default=None)
    # Above the transition the law only comes close to a power, so the rule is looser there.
    loose = power_law.plateaus(x, y, 5 * power_law.FLATNESS) if len(x) > power_law.LEAST_POINTS else []
    large = max(loose, default=None)
    if small and large and (large[0] < small[1] or abs(_exponent(x, y, large) - _exponent(x, y, small)) < 0.1):
        large = None
    rows = []
    for regime, run in (("small", small), ("large", large)):
        law = power_law.fit(x[run[0]:run[1] + 1], y[run[0]:run[1] + 1]) if run else None
        if law is None:
            rows.append({**head, "regime": regime, **dict.fromkeys(("exponent", "exponent_low", "exponent_high", "amplitude", "from", "to"), np.nan), "n": 0})
        else:
            rows.append({**head, "regime": regime, "exponent": law.exponent, "exponent_low": law.low,
                         "exponent_high": law.high, "amplitude": law.amplitude, "from": law.x_from, "to": law.x_to,
                         "n": law.n})
    return rows


def _exponent(x: np.ndarray, y: np.ndarray, run: tuple[int, int]) -> float:
    return float(np.log(y[run[1]] / y[run[0]]) / np.log(x[run[1]] / x[run[0]]))


def transition(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Where the short step of light feet turns from slope to slope^(1/3), and how that moves with the foot's mass.

    Parameters
    ----------
    params : mapping
        `lines`, each with a `foot_mass_ratio` (or walkers E and F).
    inputs : list
        One dict a line: `slope` (n,), `stance_angle` (n, gaits).

    Returns
    -------
    dict
        Table `fits/transition`, a row per ratio, heaviest first: amplitude of the linear law, crossing of the exact
        asymptotes, crossing of fitted lines, the asymptotic formula, and the local exponent
        d ln slope_transition / d ln ratio towards the next lighter foot.
    """
    g = GAITS.index("short")
    rows = []
    for line, data in zip(params["lines"], inputs):
        ratio = line["set"].get("foot_mass_ratio", {"E": 0.1, "F": 0.05}.get(line["walker"], np.nan))
        if not ratio > 0:
            continue
        good = np.isfinite(data["stance_angle"][:, g])
        order = np.argsort(data["slope"][good])
        slope, angle = data["slope"][good][order], data["stance_angle"][good, g][order]
        if len(slope) < 4:
            continue
        linear, error, to, n = laws.linear_amplitude(slope, angle)
        exact = laws.crossing(linear, laws.CUBE_ROOT)
        fitted, low, high = laws.fitted_crossing(slope, angle, exact)
        rows.append({"foot_mass_ratio": ratio, "amplitude_linear": linear, "amplitude_linear_error": error,
                     "linear_to": to, "n": n, "amplitude_cube_root": laws.CUBE_ROOT, "slope_transition": exact,
                     "slope_transition_fitted": fitted, "fitted_below": low, "fitted_above": high,
                     "asymptotic": float(laws.asymptotic(np.array(ratio)))})
    rows.sort(key=lambda r: -r["foot_mass_ratio"])
    for name, key in (("local_exponent", "slope_transition"), ("local_exponent_fitted", "slope_transition_fitted")):
        for row, after in zip(rows, [*rows[1:], None]):
            row[name] = np.nan if after is None else float(
                np.log(row[key] / after[key]) / np.log(row["foot_mass_ratio"] / after["foot_mass_ratio"]))
    table = _table("fits/transition", rows)
    by_ratio = {round(r["foot_mass_ratio"], 12): r for r in rows}
    if 0.1 in by_ratio and 0.05 in by_ratio:
        heavy, light = by_ratio[0.1], by_ratio[0.05]
        table |= _table("fits/transition_ratio", [{
            "pair": "E / F", "foot_mass_ratios": "0.1 / 0.05", "predicted": 2**1.5,
            "exact_asymptotes": heavy["slope_transition"] / light["slope_transition"],
            "fitted_lines": heavy["slope_transition_fitted"] / light["slope_transition_fitted"]}])
    return table


def _coordinates(line: Mapping[str, Any]) -> dict[str, Any]:
    return {"walker": line.get("name", line["walker"]), **line["set"]}


def _table(group: str, rows: list[dict[str, Any]]) -> Arrays:
    """Rows as the columns of one group."""
    return {f"{group}/{k}": np.array([r[k] for r in rows]) for k in (rows[0] if rows else {})}
