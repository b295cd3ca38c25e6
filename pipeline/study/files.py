"""The TOML files of studies and walkers."""

import difflib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from gaitsweep import extensions
from gaitsweep.pipeline import dispatch
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.study import toml
from gaitsweep.pipeline.study.location import Location, clip
from gaitsweep.pipeline.study.model import Definition

#: Reads the decimals of a file.
Reader: TypeAlias = Callable[[str], Any]
_MAX_BASES = 8
#: What the package brings: studies in folders, and walkers.
_STUDIES, _WALKERS = (
    Path(__file__).parents[2] / "data" / name for name in ("studies", "walkers")
)


def read_text(path: Path, shown: str, most: int = 1) -> str:
    """Read a text file of at most so many MiB; errors call it `shown`.

    Raises
    ------
    StudyError
        If it is missing, too large or no text.
    """
    try:
        if not path.is_file():
            if path.exists():
                raise StudyError(f"{shown} is not a file.")
            raise StudyError(f"There is no file {shown}.")

        if path.suffix == ".nc":
            raise StudyError(f"{shown} is an archive; a file NAME.toml is wanted.")
        if path.stat().st_size > most << 20:
            raise StudyError(f"{shown} is larger than {most} MiB.")

        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        raise unreadable(shown, error) from error


def studies(name: Path) -> list[Path]:
    """Files of the studies that a name means.

    Parameters
    ----------
    name : Path
        A file, a folder of studies, or, where there is neither, a folder that the
        package brings (`paper`, `examples`) or one study of it (`paper/figure5`).

    Returns
    -------
    list of Path
        At least one.

    Raises
    ------
    StudyError
        If a folder has none, or the name is near to one that the package brings.
    """
    if os.path.isdir(name):
        found = sorted(name.glob("*.toml"))
        if not found:
            raise StudyError(
                f"There is no study (*.toml) in the folder {clip(str(name), 200)}."
            )
        return found

    if os.path.lexists(name):  # unlike `Path.exists`, no error if it is too long
        return [name]
    if os.path.isfile(f"{name}.toml"):
        raise StudyError(
            f"There is no file {clip(str(name), 200)}; did you mean `{clip(name.name, 200)}.toml`?"
        )

    shipped: dict[str, list[Path]] = {}
    for file in sorted(_STUDIES.glob("*/*.toml")):
        for known in (file.parent, file.with_suffix("")):
            shipped.setdefault(known.relative_to(_STUDIES).as_posix(), []).append(file)

    if str(name) in shipped:
        return shipped[str(name)]

    near = difflib.get_close_matches(str(name), shipped, 1)
    if near:
        raise StudyError(
            f"There is no file {clip(str(name), 200)}; did you mean `{near[0]}`?"
        )

    return [name]


def unreadable(shown: str, error: Exception) -> StudyError:
    """Error for a file that cannot be read; what caused it may quote control
    characters, or a path with a null byte.
    """
    detail = (
        error.strerror if isinstance(error, OSError) else str(error).splitlines()[0]
    )
    return StudyError(f"{shown} cannot be read: {clip(str(detail), 120)}.")


def read_toml(
    path: Path, shown: str, number: Reader = float
) -> tuple[str, dict[str, Any]]:
    """Read a TOML file and return its text and table, with decimals read by `number`;
    errors call it `shown`.

    Raises
    ------
    StudyError
        If it is missing, too large or not TOML.
    """
    text = read_text(path, shown := clip(shown, 200))
    try:
        return text, toml.read(text, number)
    except ValueError as error:
        wrong = unreadable(shown, error)
        toml.note_place(wrong, text, error)
        raise wrong from error


def walker(
    value: Definition,
    folder: Path,
    location: Location | None = None,
    number: Reader = float,
    is_end: bool = False,
) -> Definition:
    """Name of a catalogue walker, or the table of a walker.

    Parameters
    ----------
    value : str or dict
        A name, a file (relative to `folder`, or absolute; where there is none, of that
        name among the walkers that the package brings), or a table, whose `base` and
        `toward` may be files too.
    folder : Path
    location : Location, optional
        Place of the value in a study.
    number : callable
        Reads the decimals of files.
    is_end : bool
        It is the walker that another leads to, and leads to none itself.

    Raises
    ------
    StudyError
        If the name is unknown or a file is not a walker.
    """
    location = location or Location("", "walker")
    catalogue = dispatch.resolve("gaitsweep.tasks.walkers.catalogue:CATALOGUE")
    table, overrides = value, dict[str, Any]()
    for _ in range(_MAX_BASES):
        if isinstance(table, dict):
            base = table.get("base")
            if "toward" in table and "toward" not in overrides:
                place = location.at("toward")
                if is_end:
                    raise location.error(
                        "The walker that `toward` names has a `toward` itself"
                    )
                table = {
                    **table,
                    "toward": other(table["toward"], folder, place, number),
                }

            overrides = {**table, **overrides}
            if not isinstance(base, str) or base in catalogue:
                return overrides

            del overrides["base"]
            table = base

        if table in catalogue:
            return table
        if table.endswith(".toml"):
            table, folder = _walker_file(table, folder, location, number)
        else:
            found = location.blamed(extensions.find, "walkers", table, dict)
            if found is None:
                raise location.unknown(table, [*catalogue, "or a file FILE.toml"])
            table = found

    raise location.error(
        f"{clip(str(table))} is based on more than {_MAX_BASES} other files"
    )


def more_walkers() -> list[tuple[str, str]]:
    """Names of walkers beside the catalogue, and where each is from."""
    brought = [
        (file.name, "a file that comes with gaitsweep")
        for file in sorted(_WALKERS.glob("*.toml"))
    ]
    return [
        *brought,
        *((name, "of another package") for name in extensions.names("walkers")),
    ]


def other(
    value: object, folder: Path, location: Location, number: Reader = float
) -> Definition:
    """The walker `toward` which `detuning` leads: a name, a file, a table, or the text
    of a table.

    Raises
    ------
    StudyError
        If it is none of these, or no walker.
    """
    if isinstance(value, str) and value.lstrip().startswith("{"):
        try:
            value = toml.read(f"toward = {value}", number)["toward"]
        except ValueError as error:
            raise location.wrong("must be a name, a file or a table", value) from error

    if not isinstance(value, str | dict):
        raise location.wrong("must be a name, a file or a table", value)

    return walker(value, folder, location, number, is_end=True)


def changed(
    value: Definition, toward: Definition | None = None, tuned: str | Sequence[str] = ()
) -> Definition:
    """A walker with the one, if any, toward which `detuning` leads it, and with keys
    that are `tuned`.

    These are changed by least so that it meets the static conditions.
    """
    keys: dict[str, Any] = {} if toward is None else {"toward": toward}
    if tuned:
        keys["tuned"] = [tuned] if isinstance(tuned, str) else list(tuned)
    if not keys:
        return value
    base = {"base": value} if isinstance(value, str) else value
    return {**base, **keys}


def _walker_file(
    name: str, folder: Path, location: Location, number: Reader
) -> tuple[dict[str, Any], Path]:
    """The [walker] table of a file, and the folder to which its own `base` is relative."""
    path = folder / name
    if not os.path.lexists(path) and name in (
        file.name for file in _WALKERS.glob("*.toml")
    ):
        path = _WALKERS / name

    _, table = location.blamed(read_toml, path, name, number)
    if not isinstance(table.get("walker"), dict):
        raise location.error(f"{clip(name)} has no [walker] table")

    return table["walker"], path.parent
