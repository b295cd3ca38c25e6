"""The tasks `scaling` and `transition`: laws fitted over whole lines of gaits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.tasks.contract.registry import GAITS
from gaitsweep.tasks.contract.tables import Arrays, table
from gaitsweep.tasks.fits import power_law
from gaitsweep.tasks.fits import transition as laws
from gaitsweep.tasks.walkers.resolve import walker_of_line

#: A piece of a branch, by the numbers of both, and those of its points over which the
#: local exponent is constant.
_Run = tuple[tuple[int, int], np.ndarray, np.ndarray]
#: Factor of the smallest abscissa within which a law begins there: the first points of
#: a plateau may be left out.
_NEAR = 2.0
#: Columns of a law that are not called as in `PowerLaw`, and the entries where there is
#: no plateau.
_COLUMNS = {
    "low": "exponent_low",
    "high": "exponent_high",
    "x_from": "from",
    "x_to": "to",
}
_NO_LAW = power_law.PowerLaw(np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, 0)
#: The laws fitted: name, abscissa, ordinate.
_QUANTITIES = (
    ("stance_angle", "slope", "stance_angle"),
    ("speed", "slope", "speed"),
    ("power_speed", "speed", "power"),
)


def scaling(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Fit power laws to both gaits of every line, at vanishing and at larger slopes
    (section 6.2 of the paper).

    Each law is fitted on one piece of one branch, never across branches or folds.

    Parameters
    ----------
    params : mapping
        `lines`.
    inputs : list
        One dict a line: `slope` (n,) [rad]; `stance_angle`, `speed`, `power`, `branch`,
        `piece`, shape (n, gaits), in the walker's units.

    Returns
    -------
    dict
        Table `fits/scaling`, a row per line, gait, quantity and regime, with the branch
        and piece of the fit; where there is no plateau the numbers are NaN, `n` is 0
        and branch and piece are -1.
    """
    rows: list[dict[str, Any]] = []
    for line, data in zip(params["lines"], inputs, strict=True):
        for g, gait in enumerate(GAITS[:2]):
            for quantity, abscissa, ordinate in _QUANTITIES:
                head = {**_coordinates(line), "gait": gait, "quantity": quantity}
                x = data["slope"] if abscissa == "slope" else data[abscissa][:, g]
                y = data[ordinate][:, g]
                good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
                curves = {}
                for key, points in _curves(data, g, good).items():
                    curves[key] = _sort(x[points], y[points])
                rows += _laws(head, curves)

    return table("fits/scaling", rows)


def _curves(
    data: Arrays, g: int, good: np.ndarray
) -> dict[tuple[int, int], np.ndarray]:
    """Masks of a gait's good points on each piece of a branch, by the numbers of branch
    and piece.
    """
    branch, piece = data["branch"][:, g], data["piece"][:, g]
    pairs = np.unique(np.stack([branch, piece], axis=1)[good], axis=0)
    masks = {}
    for b, p in pairs.tolist():
        masks[b, p] = good & (branch == b) & (piece == p)
    return masks


def _sort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(x)
    return x[order], y[order]


def _laws(
    head: dict[str, Any],
    curves: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]],
) -> list[dict[str, Any]]:
    """The law at the smallest abscissae, and that at the largest if it differs, each of
    one curve.
    """
    flatness = power_law.FLATNESS
    small = min(_plateaus(curves, flatness), key=_start, default=None)
    # Above the transition the law only approximates a power, so the tolerance is larger
    # there.
    large = max(_plateaus(curves, 5 * flatness), key=_start, default=None)
    if small and large and _is_one_law(small, large):
        large = None
    first = min((x[0] for x, _ in curves.values()), default=np.nan)
    if large and not small and _start(large) < _NEAR * first:
        # A law that is flat to the larger tolerance only, but holds from the smallest
        # abscissae on.
        small, large = large, None

    regimes = {"small": small, "large": large}
    return [_row(head, regime, run) for regime, run in regimes.items()]


def _is_one_law(small: _Run, large: _Run) -> bool:
    """Whether two plateaus of one curve overlap, or have one exponent."""
    curve, x, y = small
    if curve != large[0]:
        return False
    change = _exponent(*large[1:]) - _exponent(x, y)
    overlap = _start(large) < x[-1]
    return bool(overlap or abs(change) < 0.1)


def _row(head: dict[str, Any], regime: str, run: _Run | None) -> dict[str, Any]:
    """A row of the table: the law fitted over a plateau, if there is one."""
    law = None
    branch, piece = -1, -1
    if run:
        law = power_law.fit(*run[1:])
    if run and law:
        branch, piece = run[0]
    row = {**head, "regime": regime, "branch": branch, "piece": piece}
    for name, value in vars(law or _NO_LAW).items():
        row[_COLUMNS.get(name, name)] = value
    return row


def _plateaus(
    curves: Mapping[tuple[int, int], tuple[np.ndarray, np.ndarray]], flatness: float
) -> Iterator[_Run]:
    for key, (x, y) in curves.items():
        for first, last in power_law.plateaus(x, y, flatness):
            yield key, x[first : last + 1], y[first : last + 1]


def _start(run: _Run) -> float:
    return float(run[1][0])


def _exponent(
    x: Sequence[float] | np.ndarray, y: Sequence[float] | np.ndarray
) -> float:
    return float(np.log(y[-1] / y[0]) / np.log(x[-1] / x[0]))


def transition(params: Mapping[str, Any], inputs: list[Arrays]) -> Arrays:
    """Locate the transition of light feet's short step from slope to slope^(1/3), as a
    function of foot mass.

    Parameters
    ----------
    params : mapping
        `lines`, each with a `foot_mass_ratio` (or walkers E and F).
    inputs : list
        One dict a line: `slope` (n,) [rad]; `stance_angle` [rad], `branch`, `piece`,
        shape (n, gaits).

    Returns
    -------
    dict
        Table `fits/transition`, a row per ratio, heaviest first, from the piece of a
        branch that reaches the smallest slope: numbers of branch and piece, amplitude
        of the linear law, crossing of the exact asymptotes, crossing of fitted lines,
        the asymptotic formula, and the local exponent d ln slope_transition / d ln
        ratio towards the next lighter foot. With ratios 0.1 and 0.05, table
        `fits/transition_ratio` compares them.

    Notes
    -----
    Paper, sections 4.1 and 6.3.
    """
    rows = []
    for line, data in zip(params["lines"], inputs, strict=True):
        walker = walker_of_line(line)
        ratio = line["set"].get("foot_mass_ratio", walker.m_s / walker.total_mass)
        if walker.point_foot and ratio > 0:
            rows += _transition_of(ratio, data)

    rows.sort(key=lambda row: -row["foot_mass_ratio"])
    _add_exponents(rows, "local_exponent", "slope_transition")
    _add_exponents(rows, "local_exponent_fitted", "slope_transition_fitted")

    found = table("fits/transition", rows)
    by_ratio = {round(row["foot_mass_ratio"], 12): row for row in rows}
    if 0.1 in by_ratio and 0.05 in by_ratio:
        compared = _compared(by_ratio[0.1], by_ratio[0.05])
        found |= table("fits/transition_ratio", [compared])

    return found


def _transition_of(ratio: float, data: Arrays) -> list[dict[str, Any]]:
    """The row of a line, none where it has too few short gaits on the piece of a branch
    that reaches the smallest slope.
    """
    short = GAITS.index("short")
    angles = data["stance_angle"][:, short]
    curves = _curves(data, short, np.isfinite(angles))
    if not curves:
        return []

    (branch, piece), points = min(
        curves.items(), key=lambda curve: data["slope"][curve[1]].min()
    )
    slope, angle = _sort(data["slope"][points], angles[points])
    if len(slope) < 4:
        return []

    linear, error, to, n = laws.linear_amplitude(slope, angle)
    exact = laws.crossing(linear, laws.CUBE_ROOT)
    fitted = vars(laws.fitted_lines(slope, angle, exact))
    row = {
        "foot_mass_ratio": ratio,
        "branch": branch,
        "piece": piece,
        "amplitude_linear": linear,
        "amplitude_linear_error": error,
        "linear_to": to,
        "n": n,
        "amplitude_cube_root": laws.CUBE_ROOT,
        "slope_transition": exact,
        "slope_transition_fitted": fitted["slope"],
    }
    for name, value in fitted.items():
        if name != "slope":
            row[f"fitted_{name}"] = value

    row["asymptotic"] = float(laws.asymptotic(np.array(ratio)))
    return [row]


def _add_exponents(rows: list[dict[str, Any]], name: str, quantity: str) -> None:
    """Add to rows, heaviest foot first, the exponent of a quantity's law in the ratio
    towards the next lighter foot.
    """
    for row in rows:
        ratio = row["foot_mass_ratio"]
        lighter = (other for other in rows if other["foot_mass_ratio"] < ratio)
        other = next(lighter, None)
        row[name] = np.nan
        if other:
            x = [other["foot_mass_ratio"], ratio]
            row[name] = _exponent(x, [other[quantity], row[quantity]])


def _compared(heavy: dict[str, Any], light: dict[str, Any]) -> dict[str, Any]:
    """Transitions of feet of 0.1 and 0.05 of the mass, compared."""
    exact, fitted = "slope_transition", "slope_transition_fitted"
    return {
        "pair": "E / F",
        "foot_mass_ratios": "0.1 / 0.05",
        "predicted": 2**1.5,
        "exact_asymptotes": heavy[exact] / light[exact],
        "fitted_lines": heavy[fitted] / light[fitted],
    }


def _coordinates(line: Mapping[str, Any]) -> dict[str, Any]:
    return {"walker": line.get("name", line["walker"]), **line["set"]}
