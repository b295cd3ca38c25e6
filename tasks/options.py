"""Options of each kind of study: what each holds, its default and its meaning.

Like the registry, this module imports nothing but the variables.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

#: Longest period of gaits, in steps.
MAX_STEPS = 64


@dataclass(frozen=True)
class Option:
    """One option of a kind of study: what it holds, its default, and its meaning.

    `holds` is "number", "positive", "count" (a whole number from 1), "count or 0", "counts" (a list of them),
    "steps" (from 1 to MAX_STEPS), "slope" (above 0 and below 0.5), "share" (from 0 to 0.5), "range" (two rising
    numbers), "gait" (a label), "key" (of a walker), "keys" (a list of them, not derived), "kinds" (of special points)
    or "limits" (of violations, by name).
    """

    holds: str
    default: Any
    meaning: str


_TUNED = Option("keys", [], "keys changed by least on every line, so that walkers meet the static conditions")
_STEPS = Option("steps", 1, f"steps after which a gait repeats, at most {MAX_STEPS}")

#: Options of each kind of study; the parser, `gaitsweep plan --help`, the tasks and the docs read them here.
OPTIONS: dict[str, dict[str, Option]] = {
    "grid": {
        "violation_limits": Option("limits", {}, "limits above which violations are flagged, by name"),
        "steps": _STEPS,
    },
    "branch": {"steps": _STEPS},
    "orbit": {
        "gait": Option("gait", "long", "label of the gait that the initial states are near"),
        "starts": Option("count", 8, "initial states"),
        "spread": Option("number", 1e-3, "relative distance of the initial states from the gait"),
        "transient": Option("count", 400, "steps before the orbit is kept"),
        "steps": Option("count", 240, "steps over which Lyapunov exponents are averaged"),
        "shown": Option("count", 120, "last steps kept in the archive"),
    },
    "cascade": {
        "periods": Option("count", 64, "largest period to which doublings are followed"),
        "families": Option("counts", [1], "periods of the gaits at which cascades begin"),
        "starts": Option("count", 400, "initial states of the search for families of other periods than one"),
        "steps": Option("count or 0", 200, "steps that walking must last; 0 leaves the loss of walking out"),
    },
    "basin": {
        "size": Option("count", 160, "initial states along each axis"),
        "steps": Option("count", 200, "steps each initial state is followed"),
        "stance_angle": Option("range", None, "stance angles of the initial states [rad]; by default around the gaits"),
        "stance_rate": Option("range", None, "stance rates of the initial states; by default around the gaits"),
    },
    "curve": {
        "key": Option("key", "detuning", "key that varies along the curve beside the slope"),
        "from": Option("number", 0.0, "least value of the key"),
        "to": Option("number", 1.0, "largest value of the key"),
        "kinds": Option("kinds", ("fold", "flip"), "special points whose curves are followed"),
    },
    "census": {"starts": Option("count", 2000, "initial guesses at each slope")},
    "design": {
        "at_slope": Option("slope", None, "slope at which attractors are found [rad]"),
        "at_speed": Option("positive", None, "speed at which the least cost is found, in the walker's units"),
        "ground": Option("share", 0.0, "largest step of the ground tried at `at_slope`, over the leg; 0: none"),
    },
}

for _each in OPTIONS.values():
    _each["tuned"] = _TUNED


def options(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Options of a kind of study: those given, and the defaults of the others."""
    return {name: given.get(name, option.default) for name, option in OPTIONS[kind].items()}


#: Points whose curves a study of kind `curve` follows.
FOLLOWED = ("fold", "flip", "end_kneestrike_at_heelstrike", "end_tangential_heelstrike")
