"""Kinds of arguments of the command line, each says in one line what is wrong; and
output for machines.
"""

import json
from argparse import Action, ArgumentError, ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Iterable
from pathlib import Path
from typing import Any


def count(text: str, most: int = 10**9) -> int:
    """A whole number from 1."""
    if (
        not (text.isascii() and text.isdecimal())
        or len(text) > 10
        or not 1 <= int(text) <= most
    ):
        raise ArgumentTypeError(
            f"must be a whole number from 1 to {most:,}; got {text[:60]}"
        )
    return int(text)


def jobs(text: str) -> int:
    """A number of processes on one computer."""
    from gaitsweep.pipeline.engine.places import MAX_JOBS

    return count(text, MAX_JOBS)


def file(text: str) -> Path:
    """Path of a file to write."""
    if not Path(text).name or not text.isprintable():
        raise ArgumentTypeError(f"must name a file; got {text!a}")
    return Path(text)


def archive(text: str) -> Path:
    """Path of an archive."""
    path = file(text)
    if path.suffix != ".nc":
        raise ArgumentTypeError(f"must be a name that ends in .nc; got {text}")
    return path


def steps(text: str) -> int:
    """Steps after which a gait repeats."""
    from gaitsweep.tasks.contract.registry import MAX_STEPS

    return count(text, MAX_STEPS)


def steps_of_states(text: str) -> int:
    """Steps after which the states of a table are held to repeat."""
    from gaitsweep.tasks.contract.registry import MAX_STEPS_OF_STATES

    return count(text, MAX_STEPS_OF_STATES)


def number(text: str, key: str = "") -> float:
    """A number, that of a key if one is given."""
    try:
        if not text.isascii() or "_" in text:  # which Python reads
            raise ValueError
        return float(text)
    except ValueError:
        raise ArgumentTypeError(f"{_of(key)}must be a number; got {text}") from None


def _of(key: str) -> str:
    return f"`{key}` " if key else ""


def interval(text: str) -> float:
    """A time between two events."""
    if not number(text) >= 0:  # nan
        raise ArgumentTypeError(f"must be at least 0 s; got {text}")
    return float(text)


def tolerance(text: str) -> tuple[str, float]:
    """A relative tolerance, of all variables or of one."""
    name, _, value = text.rpartition("=")
    if not 0 <= (rtol := number(value, name)) < 1:
        raise ArgumentTypeError(f"{_of(name)}must lie in [0, 1); got {value}")
    return name, rtol


def setting(text: str) -> tuple[str, float | bool | str]:
    """A walker key and its value; that of `toward` and `trailing_knee` is a text."""
    key, _, value = text.partition("=")
    if not key or not value:
        raise ArgumentTypeError(f"must be KEY=VALUE; got {text}")
    if key == "knees" and value not in ("true", "false"):
        raise ArgumentTypeError(f"`knees` must be true or false; got {value}")
    if key in ("toward", "trailing_knee"):
        return key, value
    if value.lstrip().startswith("["):
        raise ArgumentTypeError(
            f"`{key}` must be one number, that of both legs; got {value}"
        )
    if value in ("true", "false"):
        return key, value == "true"

    return key, number(value, key)


def column(text: str) -> tuple[str, str]:
    """A column of a table and the name that it stands for."""
    name, _, meaning = text.rpartition("=")
    if not name or not meaning:
        raise ArgumentTypeError(f"must be COLUMN=NAME; got {text}")
    return name, meaning


def limit(text: str) -> tuple[str, float]:
    """A violation and its limit."""
    return _named_number(text, "VIOLATION")


def target(text: str) -> tuple[str, float]:
    """A measure and the value that it is to have."""
    return _named_number(text, "MEASURE")


def _named_number(text: str, what: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    if not name or not value:
        raise ArgumentTypeError(f"must be {what}=VALUE; got {text}")
    return name, number(value, name)


def decimal(text: str) -> str:
    """A number as it is written, with all its digits."""
    number(text)
    return text


def decimal_setting(text: str) -> tuple[str, str | bool]:
    """A walker key and its value, with all its digits."""
    key, value = setting(text)
    return key, value if isinstance(value, bool) else text.partition("=")[2]


class Studies(Action):
    """Collects the files of studies: of those named, of folders, and of those that the
    package brings.
    """

    def __call__(
        self, parser: ArgumentParser, options: Namespace, names: Any, *_: Any
    ) -> None:
        """Set the files."""
        from gaitsweep.pipeline.study import files

        setattr(
            options, self.dest, [file for name in names for file in files.studies(name)]
        )


class Settings(Action):
    """Collects names, of walker keys or violations, and their values."""

    def __call__(
        self, parser: ArgumentParser, options: Namespace, setting: Any, *_: Any
    ) -> None:
        """Add a name that is not there yet."""
        (key, value), known = setting, getattr(options, self.dest)
        if key in known:
            raise ArgumentError(self, f"`{key}` is given twice")
        setattr(options, self.dest, {**known, key: value})


def show(options: Namespace, record: Any, lines: Iterable[str]) -> None:
    """Print an answer: a record for machines, or else lines."""
    print(json.dumps(record) if options.json else "\n".join(lines))
