"""Questions answered at once, in this process: the gaits at one point, a walker's statics, the nearest tuned one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline import study, worker
from pipeline.errors import StudyError
from pipeline.place import Place


def ask(call: str, params: dict[str, Any]) -> Any:
    """Answer of one of the calls `tasks` offers.

    Raises
    ------
    StudyError
        If it finds the walker or another parameter wrong.
    """
    try:
        return worker.call(call, params)
    except ValueError as error:
        if not hasattr(error, "bound"):
            raise
        raise StudyError(str(error)) from error


def solve(one: str | dict[str, Any], slope: float, keys: Mapping[str, float], every: bool) -> dict[str, Any]:
    """Gaits of a walker (a name, a file or a table) at one slope [rad]: `gaits`, and `search`, how they were sought.

    Raises
    ------
    StudyError
        If there is no such walker, key or slope.
    """
    if not 0 < slope < 0.5:
        raise Place("", "slope").wrong("must lie in (0, 0.5) rad", slope)
    return ask("solve", {"walker": study.walker(one, Path()), "slope": slope, "set": dict(keys), "all": every})
