"""Walkers between which detuning leads, as words and as text; loads nothing of `tasks`, so that a report may use it."""

import json
from collections.abc import Mapping, Sequence
from typing import Any


def ends(ways: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    """The walkers between which detuning leads, in words."""
    starts, others = ({str(way[key]): None for way in ways} for key in ("start", "end"))
    return (
        next(iter(starts)) if len(starts) == 1 else "each walker",
        next(iter(others)) if len(others) == 1 else "the one it leads to",
    )


def inline(table: dict[str, Any]) -> str:
    """The text of a table, on one line, from which `pipeline.study.files.other` reads it."""
    texts = (repr(value) if isinstance(value, float) else json.dumps(value) for value in table.values())
    return "{ " + ", ".join(f"{key} = {text}" for key, text in zip(table, texts, strict=True)) + " }"
