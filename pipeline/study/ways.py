"""Walkers between which detuning leads, in words; loads nothing of `tasks`, so that a
report may use it.
"""

from collections.abc import Mapping, Sequence
from typing import Any


def ends(ways: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """The walkers between which detuning leads, in words."""
    starts, others = ({str(way[key]): None for way in ways} for key in ("start", "end"))
    return (
        next(iter(starts)) if len(starts) == 1 else "each walker",
        next(iter(others)) if len(others) == 1 else "the one it leads to",
    )
