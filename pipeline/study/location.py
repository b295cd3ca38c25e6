"""Where in a study something stands, and the errors that say so."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable

from pipeline.errors import StudyError


class Location:
    """Where in a study something stands; makes the errors."""

    def __init__(self, file: str, *keys: str):
        self.file, self.keys = file, keys

    def at(self, *keys: str) -> Location:
        return Location(self.file, *self.keys, *keys)

    def error(self, sentence: str) -> StudyError:
        position = ", ".join(filter(None, (self.file, ".".join(self.keys) if self.file else "")))
        return StudyError(f"{sentence.rstrip('.')} ({position})." if position else f"{sentence.rstrip('.')}.")

    def wrong(self, bound: str, value: object) -> StudyError:
        return self.error(f"`{self.keys[-1]}` {bound}; got {_show(value)}")

    def unknown(self, key: str, known: Iterable[str]) -> StudyError:
        known = list(known)
        near = difflib.get_close_matches(key, known, 1)
        hint = f"did you mean `{near[0]}`?" if near else f"known: {', '.join(known)}"
        return self.error(f"`{clip(key)}` is not known here, {hint}")

    def number(self, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong("must be a number", value)
        if not math.isfinite(value) or abs(value) > 1e300:
            raise self.wrong("must be finite", value)
        return float(value)


def clip(text: str, max_length: int = 60) -> str:
    """Text from elsewhere as an error may show it."""
    text = "".join(c if c.isprintable() else "?" for c in text)
    return text if len(text) <= max_length else text[: max_length - 3] + "..."


def _show(value: object) -> str:
    try:
        return clip(repr(value))
    except (ValueError, RecursionError):
        return "something that cannot be shown"
