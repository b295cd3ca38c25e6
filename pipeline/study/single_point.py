"""The gaits of a walker at one slope, asked for without a study."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.dispatch import ask
from pipeline.study import files
from pipeline.study.location import Location


def solve(definition: str | dict[str, Any], slope: float, keys: Mapping[str, float], every: bool) -> dict[str, Any]:
    """Gaits of a walker (a name, a file or a table) at one slope [rad]: `gaits`, and `search`, how they were sought.

    Raises
    ------
    StudyError
        If there is no such walker, key or slope.
    """
    if not 0 < slope < 0.5:
        raise Location("", "slope").wrong("must lie in (0, 0.5) rad", slope)
    return ask("solve", {"walker": files.walker(definition, Path()), "slope": slope, "set": dict(keys), "all": every})
