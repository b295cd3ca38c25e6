"""Kinds of special points as far as charts over keys tell them apart, and of the ends
of patches.
"""

from __future__ import annotations

FOLD = "fold"
FLIP = "flip"
SPEED = "speed"
WINDOW = "window"
#: A patch ends at a fold, or is CUT where the piece goes on; its END is where walking
#: ends, and BEYOND that, where the equations go on, walking has ended before.
CUT = "cut"
END = "end"
BEYOND = "beyond"
#: Ends that no equations of their own define.
_UNDEFINED = "end_earlier_strike"
#: Kinds of ends beyond which the equations of a gait go on and its own step tells that
#: it is none.
EVENTS = {
    "end_kneestrike_at_heelstrike",
    "end_tangential_heelstrike",
    "end_tangential_kneestrike",
    _UNDEFINED,
}
#: Kinds at which pieces end that are located over keys.
LOCATED = EVENTS - {_UNDEFINED} | {FOLD, "end_zero_step"}
#: Kinds of points that are followed already where they come near being the best of a
#: line: points of other kinds become the best only where another point changes its
#: flags.
RIVALS = (FOLD, FLIP)


def is_end(kind: str) -> bool:
    """Whether walking ends at points of a kind."""
    return kind.startswith("end_")


def side_of_steps(kind: str) -> int:
    """The side of an end on which gaits are steps, 1 that to which its scalar grows.

    Before it kneestrike precedes heelstrike; the foot falls as it strikes.
    """
    return 1 if "kneestrike_at" in kind else -1
