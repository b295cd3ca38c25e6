"""`gaitsweep solve`: all gaits at one point."""

import argparse
import json
import math
from collections.abc import Iterable, Iterator
from typing import Any

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import slopes
from gaitsweep.pipeline.study.single_point import solve, solve_at
from gaitsweep.tasks.contract.registry import SLOPES, VARIABLES

#: Rows of a gait unless all variables are asked for.
_FIRST = (
    *(
        "stance_angle",
        "stance_rate",
        "thigh_rate",
        "shank_rate",
        "period",
        "speed",
        "cost_of_transport",
    ),
    *("multipliers", "violations", "error_bound"),
)
#: Units in degrees for those in radians; a rate of a walker in consistent units has the
#: unit 1.
_DEGREES = {"rad": "deg", "rad s-1": "deg s-1", "1": "deg per unit of time"}


def run(options: argparse.Namespace) -> int:
    """Print the gaits; the exit code is 1 if one is not converged."""
    slope = _slope(options)
    if options.at:
        between = _between(options)
        asked = options.vary, between, slope, options.set, options.limit, options.tuned
        answer = solve_at(options.walker, options.at, *asked)
    elif slope is None:
        raise StudyError("`slope` is needed, or `at` with the value of a measure.")
    else:
        accuracy, limits = options.accuracy, options.limit
        chosen = options.all, options.steps, accuracy, limits, options.tuned
        answer = solve(options.walker, slope, options.set, *chosen)
    for line in answer.get("search", []):
        terminal.say(line)
    if options.degrees and answer.get("search"):
        terminal.say("Slopes in the lines above are in rad.")
    if options.json:
        # JSON has no infinite numbers; `float` reads the word.
        gaits = [
            {k: "inf" if v == math.inf else v for k, v in gait.items()}
            for gait in answer["gaits"]
        ]
        print(json.dumps(gaits, allow_nan=False))
    else:
        print(
            "\n".join(
                [*_lines(answer["gaits"], answer["units"], options), *answer["absent"]]
            )
            or "no gait"
        )
    return int(any(gait["status"] != "converged" for gait in answer["gaits"]))


def _rows(options: argparse.Namespace) -> set[str]:
    """Variables that are shown unless all are asked for: what was varied to reach the
    value of a measure is an answer, too.
    """
    rows = {*_FIRST, *options.at}
    if options.at:
        rows |= {"slope", options.vary}
    return rows


def _slope(options: argparse.Namespace) -> float | None:
    """The slope that is asked for [rad]."""
    if options.slope is None or not options.degrees:
        return options.slope
    slope = math.radians(options.slope)
    if not slopes.is_slope(slope):
        low, high = map(math.degrees, SLOPES)
        raise StudyError(
            f"`slope` must lie in [{low:.3g}, {high:.4g}) degrees; got {options.slope:g}."
        )
    return slope


def _between(options: argparse.Namespace) -> list[float] | None:
    """The range of what is varied, slopes in rad."""
    if options.between is None or not options.degrees or options.vary != "slope":
        return options.between
    return [math.radians(end) for end in options.between]


def _lines(
    all_gaits: Iterable[dict[str, Any]],
    units: dict[str, str],
    options: argparse.Namespace,
) -> Iterator[str]:
    """Gaits at one point, a paragraph each, with units; angles and rates in degrees if
    asked.
    """
    every = options.all_variables
    digits, of_multipliers = (15, 12) if every else (6, 6)
    shown = _rows(options)
    has_others = False
    for gait in all_gaits:
        left_out = {
            "gait",
            "stable",
            "status",
            "contact_mass_matrix",
            *(() if every else gait.keys() - shown),
        }
        rows = {
            key: value
            for key, value in gait.items()
            if value is not None and key not in left_out
        }
        width = max(16, *map(len, rows))
        yield f"{gait['gait']} ({'stable' if gait['stable'] else 'unstable'}, {gait['status']})"
        for key, value in rows.items():
            if key == "multipliers":
                value = ", ".join(
                    _multiplier(re, im, of_multipliers) for re, im in value
                )
            elif isinstance(value, float):
                unit = units.get(key, "1")
                if options.degrees and (
                    key == "slope"
                    or (key in VARIABLES and VARIABLES[key].kind in ("angle", "rate"))
                ):
                    value, unit = math.degrees(value), _DEGREES[unit]
                value = f"{value:.{digits}g} {unit}".removesuffix(" 1")
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            yield f"  {key:<{width}} {value}"
        has_others = has_others or str(gait["gait"]).startswith("other")
    if has_others:
        yield "Of several gaits under one label that of the largest stance angle has it; others are other1, other2, ..."


def _multiplier(real: float, imaginary: float, digits: int) -> str:
    """A number, real if no digit that is shown says otherwise."""
    is_real = abs(imaginary) < 10.0**-digits * abs(real) or not imaginary
    return (
        f"{real:.{digits}g}"
        if is_real
        else f"{real:.{digits}g}{imaginary:+.{digits}g}j"
    )
