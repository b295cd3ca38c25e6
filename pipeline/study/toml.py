"""Reading and writing of TOML: the standard library takes any depth, and does not
write. Loads nothing of `tasks`.
"""

import json
import re
import tomllib
import unicodedata
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.errors import StudyError

_MOST_LEVELS = 32
_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
#: A key of more parts, where keys can begin; tomllib's time grows with the square of
#: their number.
_LONG_KEY = re.compile(
    rf"(?:^|(?<=[\s\[{{,])){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{_MOST_LEVELS}}}"
)
#: Where an error of tomllib says that it arose.
_PLACE = re.compile(
    r"\(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)$"
)
#: Characters that are shown on either side of such a place.
_AROUND = 60


def read(text: str, number: Callable[[str], Any] = float) -> dict[str, Any]:
    """Table of a TOML text, with decimals read by `number`.

    Raises
    ------
    ValueError
        If it is not TOML, or tables and lists are nested too deeply for those who read
        them.
    """
    too_deep = f"Tables and lists are nested more than {_MOST_LEVELS} deep"
    if _LONG_KEY.search(text):
        raise ValueError(too_deep)

    try:
        table = tomllib.loads(text, parse_float=number)
    except RecursionError:
        raise ValueError(too_deep) from None

    level: list[Any] = [table]
    for _ in range(_MOST_LEVELS):
        values = (
            value
            for each in level
            for value in (each.values() if isinstance(each, dict) else each)
        )
        level = [value for value in values if isinstance(value, dict | list)]

    if level:
        raise ValueError(too_deep)

    return table


def note_place(error: Exception, text: str, cause: Exception) -> None:
    """Add to an error the line of a TOML text at which its `cause` arose, with a caret
    below the column, as a note; none where that has no place.
    """
    place = _PLACE.search(str(cause))
    if not place:
        return

    lines = text.split("\n")
    if place["line"]:
        number, column = int(place["line"]), int(place["column"])
    else:  # at the end of the document
        number = len(text.rstrip().split("\n"))
        column = len(lines[number - 1].rstrip()) + 1

    first = max(0, column - 1 - _AROUND)
    shown = lines[number - 1][first : column - 1 + _AROUND]
    plain = "".join(c if c.isprintable() else " " for c in shown)
    head = f"  {number} | "
    caret = " " * _columns(plain[: column - 1 - first]) + "^"
    error.add_note(f"{head}{plain.rstrip()}\n{'| ':>{len(head)}}{caret}")


def _columns(text: str) -> int:
    """Columns of a terminal that a text takes: of wide letters two each, of marks that
    combine with the letter before them none.
    """
    wide = sum(unicodedata.east_asian_width(letter) in "WF" for letter in text)
    combined = sum(unicodedata.combining(letter) > 0 for letter in text)
    return len(text) + wide - combined


def written(value: Any, key: str = "") -> str:
    """A value as TOML, on one line; mappings become inline tables, arrays of other
    packages lists.

    Raises
    ------
    StudyError
        If TOML has no such value; it is called by its `key`.
    """
    if hasattr(value, "__array__"):
        value = np.asarray(value).tolist()
    if isinstance(value, Mapping):
        return (
            "{ "
            + ", ".join(f"{_key(str(k))} = {written(v, key)}" for k, v in value.items())
            + " }"
        )
    if isinstance(value, list | tuple | range):
        return "[" + ", ".join(written(v, key) for v in value) + "]"
    if isinstance(value, str | Path):
        # TOML has neither surrogate pairs nor a bare DEL. Half a pair stays escaped,
        # and the text is refused.
        text = json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
        return text.encode(errors="backslashreplace").decode()

    if isinstance(value, float):
        return repr(value)
    if isinstance(value, bool | int):
        return json.dumps(value)

    raise StudyError(
        f"`{key}` must be a number, a text, a list or a mapping; got {type(value).__name__}."
    )


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else written(name)
