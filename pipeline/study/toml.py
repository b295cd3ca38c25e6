"""Values as TOML, which the standard library reads and does not write; loads nothing of `tasks`."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gaitsweep.pipeline.errors import StudyError


def written(value: Any, key: str = "") -> str:
    """A value as TOML, on one line; mappings become inline tables, arrays of other packages lists.

    Raises
    ------
    StudyError
        If TOML has no such value; it is called by its `key`.
    """
    if hasattr(value, "__array__"):
        value = np.asarray(value).tolist()
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(str(k))} = {written(v, key)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple | range):
        return "[" + ", ".join(written(v, key) for v in value) + "]"
    if isinstance(value, str | Path):
        # TOML has neither surrogate pairs nor a bare DEL. Half a pair stays escaped, and the text is refused.
        text = json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
        return text.encode(errors="backslashreplace").decode()
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, bool | int):
        return json.dumps(value)
    raise StudyError(f"`{key}` must be a number, a text, a list or a mapping; got {type(value).__name__}.")


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else written(name)
