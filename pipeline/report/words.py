"""How a report writes numbers, units and names, and its sentences, which `words.toml`
holds.
"""

import math
import re
import string
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

#: Words of figures, tables and columns, by their names.
WORDS = tomllib.loads(
    (Path(__file__).parent / "words.toml").read_text(encoding="utf-8")
)

#: The paper's symbols.
SYMBOLS: dict[str, str] = WORDS["symbols"]

#: A whole power in plain text.
_POWER = r"\^([+-]?\d+)\b(?!\.)"

#: Superscripts of the characters of an integer.
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def plain(value: float, digits: int = 4) -> str:
    """A number as it is written in print: 0.0153, 1.2 × 10⁻⁶, −3."""
    if not np.isfinite(value):
        return {np.inf: "∞", -np.inf: "−∞"}.get(float(value), "–")

    text = f"{value + 0.0:.{digits}g}"  # adding zero turns −0 into 0
    mantissa, _, exponent = text.partition("e")
    if exponent:
        power = superscript(int(exponent))
        text = f"10{power}" if mantissa == "1" else f"{mantissa} × 10{power}"

    return text.replace("-", "−")


def as_printed(value: float, half_unit: float) -> str:
    """A number with the digits that the paper prints, given half a unit of the last:
    0.020.
    """
    return (
        f"{value:.{max(0, round(-math.log10(2 * half_unit)))}f}"
        if half_unit > 0
        else plain(value)
    )


def superscript(power: int) -> str:
    """An integer in superscripts."""
    return str(power).translate(SUPERSCRIPTS)


def grouped(count: int) -> str:
    """A count with narrow spaces between its thousands."""
    return f"{count:,}".replace(",", "\u202f")


def print_units(units: str) -> str:
    """CF units as they are written in print: `m s-1` becomes m s⁻¹, and `1` nothing."""
    return "" if units == "1" else units.translate(SUPERSCRIPTS)


def with_unit(words: str, unit: str) -> str:
    """Words with a unit in parentheses; alone if there is none."""
    return f"{words} ({unit})" if unit else words


#: Names of keys that are symbols, as `m_h`.
_SYMBOL = re.compile(r"[a-z]_[a-zA-Z]")


def spaced(name: Any) -> str:
    """A name in words, of a point that has two names both; a symbol as it is."""
    if _SYMBOL.fullmatch(str(name)):
        return str(name)
    if " and " in str(name):
        return " + ".join(map(spaced, str(name).split(" and ")))
    return str(WORDS["names"].get(name) or str(name).replace("_", " "))


def phrased(text: str, patterns: str = "phrases") -> str:
    """A sentence of an archive in the words of a page."""
    for pattern, words in WORDS[patterns].items():
        text = re.sub(pattern, words, text)
    return text


def typeset(text: str) -> str:
    """A sentence of an archive with the signs of print: powers, products, arrows, minus
    signs and ranges.
    """
    raised = re.sub(
        _POWER,
        lambda power: superscript(int(power[1])),
        phrased(phrased(text), "powers"),
    )
    return phrased(raised, "signs")


def symbol(name: str) -> str:
    """The paper's symbol of a quantity; its name in words where there is none."""
    return SYMBOLS.get(name, spaced(name))


def titled(name: str, unit: str, words: str = "") -> str:
    """A quantity in words, or in those given, with its symbol and unit."""
    words, sign = words or spaced(name), SYMBOLS.get(name, "")
    if sign and not words.endswith(sign):
        words = f"{words} {sign}"
    return with_unit(words, unit)


def shorten(name: str, most: int = 30) -> str:
    """Cut a name to a length."""
    return name if len(name) <= most else name[: most - 1] + "…"


def yes_or_no(flags: pd.Series) -> pd.Series:
    """Flags 1 and 0 in words; others stay missing."""
    return flags.map({1: "yes", 0: "no"})


def axis_values(at: Mapping[str, Any]) -> str:
    """Values of axes in words: names as they are, numbers with their symbols."""
    return ", ".join(
        v if isinstance(v, str) else f"{SYMBOLS.get(k, k)} = {plain(float(v), 6)}"
        for k, v in at.items()
    )


class _InPrint(string.Formatter):
    """Fills in values, numbers as they are printed; a specification is the number of
    their digits.
    """

    def format_field(self, value: Any, format_spec: str) -> Any:
        is_number = isinstance(value, (float, np.floating))
        return (
            plain(float(value), int(format_spec or 4))
            if is_number
            else super().format_field(value, format_spec)
        )


def fill(text: str, values: Mapping[str, Any]) -> str:
    """Text with values at its names in braces."""
    return _InPrint().vformat(text, (), values)


def sentences(texts: Mapping[str, str], values: Mapping[str, Any]) -> str:
    """Sentences with values; each stands if the value of its own name is not empty, the
    one called `always` always.
    """
    return " ".join(
        fill(text, values)
        for name, text in texts.items()
        if name == "always" or values.get(name)
    )
