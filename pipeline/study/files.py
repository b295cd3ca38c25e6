"""The TOML files of studies and walkers."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pipeline import dispatch
from pipeline.errors import StudyError
from pipeline.study.location import Location, clip

_MAX_BYTES = 1 << 20


def read_toml(path: Path, shown: str) -> tuple[str, dict[str, Any]]:
    """Read a TOML file and return its text and table; errors call it `shown`.

    Raises
    ------
    StudyError
        If it is missing, too large or not TOML.
    """
    shown = clip(shown, 200)
    try:
        if not path.is_file():
            raise StudyError(f"{shown} is not a file." if path.exists() else f"There is no file {shown}.")
        if path.stat().st_size > _MAX_BYTES:
            raise StudyError(f"{shown} is larger than 1 MiB.")
        text = path.read_text(encoding="utf-8")
        return text, tomllib.loads(text)
    except (OSError, ValueError) as error:
        # A TOML error may quote control characters or a path with a null byte.
        detail = error.strerror if isinstance(error, OSError) else str(error).splitlines()[0]
        raise StudyError(f"{shown} cannot be read: {clip(str(detail), 120)}.") from error
    except RecursionError as error:
        raise StudyError(f"{shown} is nested too deeply.") from error


def walker(value: str | dict[str, Any], folder: Path, location: Location | None = None) -> str | dict[str, Any]:
    """Name of a catalogue walker, or the table of a walker.

    Parameters
    ----------
    value : str or dict
        A name, a file relative to `folder`, or a table.
    folder : Path
    location : Location, optional
        Place of the value in a study.

    Raises
    ------
    StudyError
        If the name is unknown or the file is not a walker.
    """
    location = location or Location("", "walker")
    if isinstance(value, dict):
        return value
    if not value.endswith(".toml"):
        catalogue = dispatch.resolve("tasks.walkers.catalogue:CATALOGUE")
        if value not in catalogue:
            raise location.unknown(value, [*catalogue, "or a file FILE.toml"])
        return value
    if location.file and Path(value).is_absolute():
        raise location.wrong("must be a path relative to the study", value)
    try:
        _, table = read_toml(folder / value, value)
    except StudyError as error:
        raise location.error(str(error)) from error
    if not isinstance(table.get("walker"), dict):
        raise location.error(f"{clip(value)} has no [walker] table")
    return table["walker"]
