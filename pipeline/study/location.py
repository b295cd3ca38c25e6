"""Places in a study file, and errors that name them."""

import difflib
import math
from collections.abc import Callable, Collection, Iterable
from numbers import Integral
from typing import Any

from gaitsweep.extensions import ExtensionError
from gaitsweep.pipeline.errors import StudyError

#: Largest number that may be given.
LARGEST = 1e300


class Location:
    """Place in a study file, given by its keys; makes errors that name it."""

    def __init__(self, file: str, *keys: str):
        self.file, self.keys = file, keys

    def at(self, *keys: str) -> "Location":
        """Location of a key below this one."""
        return Location(self.file, *self.keys, *keys)

    def error(self, sentence: str) -> StudyError:
        """Error of one sentence with the location."""
        sentence = sentence.rstrip(".")
        if self.file:
            position = [self.file]
            if self.keys:
                position.append(".".join(self.keys))
            sentence = f"{sentence} ({', '.join(position)})"

        if not sentence.endswith("?"):
            sentence = f"{sentence}."
        return StudyError(sentence)

    def wrong(self, bound: str, value: object) -> StudyError:
        """Error for a value that violates a bound."""
        return self.error(f"`{self.keys[-1]}` {bound}; got {_show(value)}")

    def unknown(
        self, name: str, known: Iterable[str], kind: str = "name"
    ) -> StudyError:
        """Error for an unknown name or key, with the nearest known one."""
        known = list(dict.fromkeys(known))
        near = difflib.get_close_matches(name, known, 1)
        hint = f"known: {', '.join(known)}"
        if near:
            hint = f"did you mean `{near[0]}`?"
        return self.error(f"Unknown {kind} `{clip(name)}`, {hint}")

    def check_names(
        self, names: Iterable[object], known: Collection[str], kind: str = "name"
    ) -> None:
        """Check that names, or keys, are known.

        Raises
        ------
        StudyError
            If one is not, with the nearest known one.
        """
        for name in names:
            if name not in known:
                raise self.unknown(str(name), known, kind)

    def blamed(self, find: Callable[..., Any], *what: Any) -> Any:
        """What a function finds in a file or of another package; an error of theirs is
        one at this place.
        """
        try:
            return find(*what)
        except (ExtensionError, StudyError) as error:
            raise self.error(str(error)) from error

    def number(self, value: object) -> float:
        """Check that a value is a finite number.

        Raises
        ------
        StudyError
            If it is not.
        """
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.wrong("must be a number", value)
        if value in (math.inf, -math.inf):
            raise self.wrong("must be finite", value)
        if abs(value) > LARGEST:  # a whole number may exceed every double
            raise self.wrong("must be at most 1e300", value)

        if math.isnan(value):
            raise self.wrong("must be finite", value)

        return float(value)

    def count(self, value: object, most: int, least: int = 1) -> int:
        """Check that a value is a whole number, of Python or numpy, and within its
        bounds.

        Raises
        ------
        StudyError
            If it is not.
        """
        bound = f"must be a whole number from {least} to {most:,}"
        if isinstance(value, bool) or not isinstance(value, Integral):
            raise self.wrong(bound, value)
        if not least <= int(value) <= most:
            raise self.wrong(bound, value)

        return int(value)


def clip(text: str, max_length: int = 60) -> str:
    """Shorten text from outside and replace unprintable characters, for use in an
    error.
    """
    for character in set(text):
        if not character.isprintable():
            text = text.replace(character, "?")
    if len(text) > max_length:
        text = text[: max_length - 3] + "..."
    return text


def _show(value: object) -> str:
    try:
        return clip(repr(value))
    except (ValueError, RecursionError):
        return "something that cannot be shown"
