"""`gaitsweep solve`: all gaits at one point."""

import argparse
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import slopes, target
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
#: What is no row of its own.
_IN_ITS_TITLE = {"gait", "stable", "status", "contact_mass_matrix"}
#: Units in degrees for those in radians; a rate of a walker in consistent units has the
#: unit 1.
_DEGREES = {"rad": "deg", "rad s-1": "deg s-1", "1": "deg per unit of time"}


def run(options: argparse.Namespace) -> int:
    """Print the gaits; the exit code is 1 if one is not converged."""
    answer = _answer(options)
    for line in answer.get("search", []):
        terminal.say(line)
    if options.degrees and answer.get("search"):
        terminal.say("Slopes in the lines above are in rad.")
    if options.json:
        for line in answer["absent"]:
            terminal.say(line)
        gaits = [_for_json(gait) for gait in answer["gaits"]]
        print(json.dumps(gaits, allow_nan=False))
    else:
        lines = _lines(answer["gaits"], answer["units"], options)
        print("\n".join([*lines, *answer["absent"]]))

    return int(any(gait["status"] != "converged" for gait in answer["gaits"]))


def _answer(options: argparse.Namespace) -> dict[str, Any]:
    """The gaits that are asked for."""
    slope = _slope(options)
    if options.at:
        between = _between(options)
        asked = options.vary, between, slope, options.set, options.limit, options.tuned
        return solve_at(options.walker, options.at, *asked, options.steps)

    target.check_is_asked(options.vary, options.between)
    if slope is None:
        raise StudyError("`slope` is needed, or `at` with the value of a measure.")
    accuracy, limits = options.accuracy, options.limit
    chosen = options.all, options.steps, accuracy, limits, options.tuned
    return solve(options.walker, slope, options.set, *chosen)


def _for_json(gait: Mapping[str, Any]) -> dict[str, Any]:
    """A gait without infinite numbers, which JSON has not; `float` reads the word."""
    shown = dict(gait)
    for name, value in gait.items():
        if value == math.inf:
            shown[name] = "inf"
    return shown


def _slope(options: argparse.Namespace) -> float | None:
    """The slope that is asked for [rad]."""
    if options.slope is None or not options.degrees:
        return options.slope

    slope = math.radians(options.slope)
    if not (slopes.is_slope(slope) or slopes.is_level(slope)):
        low, high = map(math.degrees, SLOPES)
        bound = f"must lie in [{low:.3g}, {high:.4g}) degrees"
        if slope <= 0:
            bound += f", or in (-{high:.4g}, 0]"
        raise StudyError(f"`slope` {bound}; got {options.slope:g}.")

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
    has_others = False
    for gait in all_gaits:
        rows = _rows(gait, options)
        width = max(16, *map(len, rows))
        stability = "stable" if gait["stable"] else "unstable"
        yield f"{gait['gait']} ({stability}, {gait['status']})"
        for key, value in rows.items():
            yield f"  {key:<{width}} {_told(key, value, units.get(key, '1'), options)}"
        has_others = has_others or str(gait["gait"]).startswith("other")

    if has_others:
        yield "Of several gaits under one label that of the largest stance angle has it; others are other1, other2, ..."


def _rows(gait: dict[str, Any], options: argparse.Namespace) -> dict[str, Any]:
    """What is shown of a gait: all of its variables, or the first ones and, since what
    was varied to reach the value of a measure is an answer, these.
    """
    shown = {*_FIRST, *options.at}
    if options.at:
        shown |= {"slope", options.vary}
    if options.all_variables:
        shown = set(gait)
    shown -= _IN_ITS_TITLE

    return {
        key: value for key, value in gait.items() if value is not None and key in shown
    }


def _told(key: str, value: Any, unit: str, options: argparse.Namespace) -> str:
    """The value of a variable, with its unit."""
    every = options.all_variables
    if key == "multipliers":
        return ", ".join(_multiplier(re, im, 12 if every else 6) for re, im in value)
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    if not isinstance(value, float):
        return str(value)
    if options.degrees and _is_angular(key):
        value, unit = math.degrees(value), _DEGREES[unit]
    return f"{value:.{15 if every else 6}g} {unit}".removesuffix(" 1")


def _is_angular(key: str) -> bool:
    """Whether a variable is an angle or a rate."""
    if key == "slope":
        return True
    return key in VARIABLES and VARIABLES[key].kind in ("angle", "rate")


def _multiplier(real: float, imaginary: float, digits: int) -> str:
    """A number, real if no digit that is shown says otherwise."""
    shown = f"{real:.{digits}g}"
    if abs(imaginary) < 10.0**-digits * abs(real) or not imaginary:
        return shown
    return f"{shown}{imaginary:+.{digits}g}j"
