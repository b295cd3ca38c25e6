"""Figures 9 and 10 of the paper as computed tables, and the effect of rounding."""

from __future__ import annotations

from typing import Any

import numpy as np

from gaitsweep.tasks.ledger.claim import NOT_CHECKABLE, Found, claim, found, verdict
from gaitsweep.tasks.ledger.kneed_chaos import chaos
from gaitsweep.tasks.ledger.lines import LONG, SHORT, Paper, memoize
from gaitsweep.tasks.ledger.point_feet import speed_crossing
from gaitsweep.tasks.ledger.rounding_intervals import LANDMARKS, PUBLISHED, interval
from gaitsweep.tasks.ledger.zero_slope import VANISHING
from gaitsweep.tasks.walkers.catalogue import CATALOGUE, DESCRIPTIONS
from gaitsweep.tasks.walkers.statics import statics
from gaitsweep.tasks.walkers.walker import NUMBERS

#: Slopes at which figure 10's laws are read besides vanishing ones: small (above C's
#: last transition), larger.
SMALL, LARGE = 3e-3, 0.05
#: Powers of slope in the stance angle and of speed in the power, by what figure 10
#: prints.
_LAWS = {"P ∝ v⁴, θ* ∝ γ¹ᐟ³": (1 / 3, 4), "P ∝ v², θ* ∝ γ": (1, 2)}
#: Largest deviation of an exponent of the stance angle in a cell that is reproduced.
TOLERANCE = 0.01
#: What an interval says of each parameter.
_OF_PARAMETERS = ("sensitivity", "angle_sensitivity", "half_unit", "contribution")
ROWS = ("D", "E", "F", "A", "B", "C")
#: Slopes of the entries, by the words of figure 10.
_SLOPES = {"vanishing": VANISHING, "small": SMALL, "larger": LARGE}


def figure9(paper: Paper) -> list[dict[str, Any]]:
    """Rows of the tuned walkers' parameters, as used and as printed, in each walker's
    units.

    Each has walker, description, knees, every walker key, and the residuals of the
    static conditions.
    """
    rows = []
    for name in ("A", "A-printed", "B", "C", "C-printed", "D", "E", "F"):
        walker = CATALOGUE[name]
        residual = statics(walker)
        row: dict[str, Any] = {
            "walker": name,
            "description": DESCRIPTIONS[name],
            "knees": int(walker.knees),
        }
        for key in NUMBERS:
            row[key] = float(getattr(walker, key))
        row["leg_offset"] = residual["leg_offset"]
        row["shank_offset"] = residual.get("shank_offset", np.nan)
        rows.append(row)

    return rows


@memoize
def figure10(paper: Paper) -> list[dict[str, Any]]:
    """Rows of figure 10 by walker: exponents of angle in slope and of power in speed,
    the faster gait, and chaos.
    """
    rows = []
    for name in ROWS:
        gaits = paper.line(name)
        row: dict[str, Any] = {
            "walker": name,
            "description": DESCRIPTIONS[name],
            "zero_slope_capable": int((gaits.at([1e-10])["status"][0, :2] == 0).all()),
        }
        for gait, g in (("short", SHORT), ("long", LONG)):
            for when, slope in _SLOPES.items():
                row[f"{gait}_angle_{when}"] = gaits.exponent(g, slope)
                row[f"{gait}_power_{when}"] = gaits.exponent(g, slope, "power", "speed")

        for when in ("vanishing", "larger"):
            speed = gaits.at([_SLOPES[when]])["speed"][0]
            row[f"faster_{when}"] = "short" if speed[SHORT] > speed[LONG] else "long"

        row["crossing_slope"] = speed_crossing(paper, name)
        row["chaotic"], row["chaos"] = chaos(paper, name)
        rows.append(row)

    return rows


def rounding(paper: Paper) -> list[dict[str, Any]]:
    """Rows of every landmark by every printed parameter.

    Each has landmark, walker, kind, slope, stance_angle, slope_low, slope_high and
    printed [rad]; parameter, its sensitivity, angle_sensitivity and half_unit, its
    contribution to the interval [rad], and matters_most.
    """
    rows = []
    for name, mark in LANDMARKS.items():
        bounds = interval(paper, name)
        rows += [
            {
                "landmark": name,
                "walker": mark.walker,
                "kind": mark.kind,
                "slope": bounds.value,
                "stance_angle": bounds.angle,
                "slope_low": bounds.low,
                "slope_high": bounds.high,
                "printed": mark.printed.number,
                "parameter": key,
                **{name: getattr(bounds, name)[key] for name in _OF_PARAMETERS},
                "matters_most": int(key == bounds.most),
            }
            for key in bounds.sensitivity
        ]

    return rows


def _cells(paper: Paper) -> list[dict[str, Any]]:
    """Every cell of figure 10, in the order of its rows: columns of its table, and how
    far both entries differ.

    `deviation` is in the exponent of the stance angle, or a tenth of that of the power;
    NaN without an entry.
    """
    rows = {row["walker"]: row for row in figure10(paper)}
    cells = []
    for name, column, when, printed in PUBLISHED["figure10"]:
        if printed in _LAWS:
            computed, deviation = _law(rows[name], column, when, printed)
        else:
            computed = _word(rows[name], column, when)
            deviation = float(computed != printed)
            if printed == "not checked":
                deviation = np.nan

        said = NOT_CHECKABLE
        if not np.isnan(deviation):
            said = verdict(deviation < TOLERANCE, deviation < 10 * TOLERANCE)
        cell = {
            "walker": name,
            "column": column,
            "slopes": when,
            "printed": printed,
            "computed": computed,
            "verdict": said,
            "deviation": deviation,
        }
        cells.append(cell)

    return cells


def _law(
    row: dict[str, Any], column: str, when: str, printed: str
) -> tuple[str, float]:
    """The law of a gait that is computed, and how far that printed is from it."""
    gait = column.removesuffix("-step scaling")
    of_slope, of_speed = _LAWS[printed]
    angle = row[f"{gait}_angle_{when}"]
    power = row[f"{gait}_power_{when}"]
    computed = f"P ∝ v^{power:.3f}, θ* ∝ γ^{angle:.4f}"
    return computed, max(abs(angle - of_slope), abs(power - of_speed) / 10)


def _word(row: dict[str, Any], column: str, when: str) -> str:
    """The computed entry of a cell that holds a word."""
    is_yes = {"zero-slope capable": "zero_slope_capable", "chaos": "chaotic"}
    if column in is_yes:
        return "yes" if row[is_yes[column]] else "no"
    return str(row[f"faster_{when}"])


def figure10_cells(paper: Paper) -> list[dict[str, Any]]:
    """Rows of the cells of figure 10: walker, column, slopes, printed, computed,
    verdict.
    """
    return [
        {name: value for name, value in cell.items() if name != "deviation"}
        for cell in _cells(paper)
    ]


@claim("Z6")
def whole_table(paper: Paper) -> Found:
    """Compare every cell of figure 10 with the computed exponents."""
    cells = [cell for cell in _cells(paper) if not np.isnan(cell["deviation"])]
    deviations = np.array([cell["deviation"] for cell in cells])
    strict = int((deviations < TOLERANCE).sum())
    loose = int((deviations < 10 * TOLERANCE).sum())
    total = len(cells)
    worst = max(cells, key=lambda cell: cell["deviation"])
    rows = {row["walker"]: row for row in figure10(paper)}
    # A semicolon ends a part of a claim's answer.
    unchecked = "; ".join(
        f"{name}: {rows[name]['chaos'].replace('; ', ', ')}" for name in ("E", "A", "B")
    )
    holds = verdict(strict == total, loose == total)

    return found(
        holds,
        strict,
        strict=strict,
        total=total,
        loose=loose,
        worst=worst,
        unchecked=unchecked,
    )
