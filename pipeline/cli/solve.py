"""`gaitsweep solve`: all gaits at one point."""

import argparse
import json
import math
from collections.abc import Iterable, Iterator
from typing import Any

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.study.single_point import solve
from gaitsweep.tasks.registry import VARIABLES

#: Units in degrees for those in radians; a rate of a walker in consistent units has the unit 1.
_DEGREES = {"rad": "deg", "rad s-1": "deg s-1", "1": "deg per unit of time"}


def run(options: argparse.Namespace) -> int:
    """Print the gaits; the exit code is 1 if one is not converged."""
    slope = math.radians(options.slope) if options.degrees else options.slope
    asked = options.all, options.steps, options.accuracy, options.limit, options.tuned
    answer = solve(options.walker, slope, options.set, *asked)
    for line in answer.get("search", []):
        terminal.say(line)
    if options.degrees and answer.get("search"):
        terminal.say("Slopes in the lines above are in rad.")
    if options.json:
        # JSON has no infinite numbers; `float` reads the word.
        gaits = [{k: "inf" if v == math.inf else v for k, v in gait.items()} for gait in answer["gaits"]]
        print(json.dumps(gaits, allow_nan=False))
    else:
        print("\n".join(_lines(answer["gaits"], answer["units"], options.degrees)))
    return int(any(gait["status"] != "converged" for gait in answer["gaits"]))


def _lines(all_gaits: Iterable[dict[str, Any]], units: dict[str, str], in_degrees: bool = False) -> Iterator[str]:
    """Gaits at one point, a paragraph each, with units; angles and rates in degrees if asked."""
    is_empty, has_others = True, False
    for gait in all_gaits:
        is_empty = False
        width = max(16, *(len(key) for key, value in gait.items() if value is not None))
        yield f"{gait['gait']} ({'stable' if gait['stable'] else 'unstable'}, {gait['status']})"
        for key, value in gait.items():
            if key in ("gait", "stable", "status", "contact_mass_matrix") or value is None:
                continue
            if key == "multipliers":
                value = ", ".join(f"{re:.12g}{im:+.12g}j" if im else f"{re:.12g}" for re, im in value)
            elif isinstance(value, float):
                unit = units.get(key, "1")
                if in_degrees and (key == "slope" or (key in VARIABLES and VARIABLES[key].kind in ("angle", "rate"))):
                    value, unit = math.degrees(value), _DEGREES[unit]
                value = f"{value:.15g} {unit}".removesuffix(" 1")
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            yield f"  {key:<{width}} {value}"
        has_others = has_others or str(gait["gait"]).startswith("other")
    if has_others:
        yield "Of several gaits under one label that of the largest stance angle has it; others are other1, other2, ..."
    if is_empty:
        yield "no gait"
