"""Kinds of values that the fields of a study hold.

Each reads a value, and says its bounds, which stand once, as JSON Schema and in words.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from gaitsweep.pipeline.study import slopes
from gaitsweep.pipeline.study.location import LARGEST, Location
from gaitsweep.tasks.contract.registry import SLOPES, VIOLATIONS

#: JSON Schema, draft 2020-12.
Schema: TypeAlias = dict[str, Any]
#: Names that may be used, found when they are asked for.
Known: TypeAlias = Callable[[], Collection[str]]


class Value(ABC):
    """A kind of value."""

    @abstractmethod
    def read(self, value: Any, place: Location) -> Any:
        """Check a value of a study, and return it as it is used.

        Raises
        ------
        StudyError
            If it is not of this kind.
        """

    @property
    @abstractmethod
    def schema(self) -> Schema:
        """The same as JSON Schema."""

    @property
    @abstractmethod
    def words(self) -> str:
        """The same in words."""

    def written(self, default: Any) -> Any:
        """A default as it would stand in a study."""
        return default


@dataclass(frozen=True)
class Number(Value):
    """A number from `low` to `high`; either may be excluded."""

    low: float = -LARGEST
    high: float = LARGEST
    without_low: bool = False
    without_high: bool = False
    unit: str = ""

    def read(self, value: Any, place: Location) -> float:
        """Check a number and return it as one with a point."""
        number = place.number(value)
        is_above = number > self.low or (number == self.low and not self.without_low)
        is_below = number < self.high or (number == self.high and not self.without_high)
        if not (is_above and is_below):
            raise place.wrong(f"must {self._bounds}", value)
        return number

    @property
    def schema(self) -> Schema:
        """A number with bounds."""
        low = "exclusiveMinimum" if self.without_low else "minimum"
        high = "exclusiveMaximum" if self.without_high else "maximum"
        return {"type": "number", low: self.low, high: self.high}

    @property
    def words(self) -> str:
        """A number and its bounds."""
        bounds = self._bounds.removeprefix("be ").removeprefix("lie ")
        return f"number {bounds}".rstrip()

    @property
    def _bounds(self) -> str:
        """What it must, in words; empty if it may be any number."""
        low, high = _plain(self.low), _plain(self.high)
        if self.high == LARGEST:
            if self.low == -LARGEST:
                return ""
            return f"be {'above' if self.without_low else 'at least'} {low}{self.unit}"

        if self.without_low:
            return f"be > {low} and at most {high}{self.unit}"

        return f"lie in [{low}, {high}{')' if self.without_high else ']'}{self.unit}"


class Slope(Number):
    """A slope of the ground; that of driven walkers `may_be_level`, or lead uphill."""

    def __init__(self, may_be_level: bool = False) -> None:
        low, high = SLOPES
        super().__init__(
            -high if may_be_level else low,
            high,
            without_low=may_be_level,
            without_high=True,
            unit=" rad",
        )

    def read(self, value: Any, place: Location) -> float:
        """Check a slope, which may be meant in degrees."""
        number = place.number(value)
        slopes.check(number, place, self.without_low)
        return number


@dataclass(frozen=True)
class Whole(Value):
    """A whole number from `low` to `high`."""

    high: int
    low: int = 1

    def read(self, value: Any, place: Location) -> int:
        """Check a whole number."""
        return place.count(value, self.high, self.low)

    @property
    def schema(self) -> Schema:
        """An integer with bounds."""
        return {"type": "integer", "minimum": self.low, "maximum": self.high}

    @property
    def words(self) -> str:
        """A whole number and its bounds."""
        return f"whole number from {self.low} to {self.high:,}"


class Numbers(Value):
    """A list of numbers, each once."""

    words = "list of different numbers"

    def read(self, value: Any, place: Location) -> list[float]:
        """Check a list of numbers."""
        if not isinstance(value, list) or not value:
            raise place.wrong(f"must be a {self.words}", value)
        numbers = [place.number(each) for each in value]
        if len(set(numbers)) < len(numbers):
            raise place.wrong(f"must be a {self.words}", value)
        return numbers

    @property
    def schema(self) -> Schema:
        """An array of different numbers."""
        numbers = {"type": "array", "minItems": 1, "items": Number().schema}
        return {**numbers, "uniqueItems": True}


@dataclass(frozen=True)
class Wholes(Value):
    """A list of whole numbers."""

    of: Whole

    def read(self, value: Any, place: Location) -> list[int]:
        """Check a list of whole numbers of Python."""
        low, high = self.of.low, self.of.high
        is_list = isinstance(value, list) and len(value) > 0
        if not is_list or not all(type(n) is int and low <= n <= high for n in value):
            raise place.wrong(f"must be a {self.words}", value)
        return list(value)

    @property
    def schema(self) -> Schema:
        """An array of integers."""
        return {"type": "array", "minItems": 1, "items": self.of.schema}

    @property
    def words(self) -> str:
        """A list of whole numbers and their bounds."""
        return f"list of whole numbers from {self.of.low} to {self.of.high:,}"


@dataclass(frozen=True)
class Range(Value):
    """Two increasing numbers, or equal ones where these are allowed."""

    or_equal: bool = False

    def read(self, value: Any, place: Location) -> list[float]:
        """Check two numbers."""
        if isinstance(value, list) and len(value) == 2:
            low, high = (place.number(each) for each in value)
            if low < high or (low == high and self.or_equal):
                return [low, high]
        raise place.wrong(f"must be {self.words}", value)

    @property
    def words(self) -> str:
        """Two numbers in their order."""
        if self.or_equal:
            return "two numbers that do not fall"
        return "two increasing numbers"

    @property
    def schema(self) -> Schema:
        """An array of two numbers."""
        number = Number().schema
        return {"type": "array", "minItems": 2, "maxItems": 2, "items": number}


@dataclass(frozen=True)
class OneOf(Value):
    """One of several names; where they are many, `called` stands for them in docs."""

    known: Known
    called: str = ""

    def read(self, value: Any, place: Location) -> str:
        """Check a name."""
        known = self.known()
        if not isinstance(value, str):
            raise place.wrong(f"must be one of {', '.join(known)}", value)
        place.check_names([value], known)
        return value

    @property
    def schema(self) -> Schema:
        """One of the names."""
        return one_of(self.known())

    @property
    def words(self) -> str:
        """All names, or what they are called."""
        return self.called or ", ".join(f"`{name}`" for name in self.known())


class Either(OneOf):
    """One of a few names, all of which an error names."""

    def read(self, value: Any, place: Location) -> str:
        """Check a name."""
        if value not in self.known():
            raise place.wrong(f"must be {self.words}", value)
        return str(value)

    @property
    def words(self) -> str:
        """All names."""
        return " or ".join(f'"{name}"' for name in self.known())


@dataclass(frozen=True)
class Names(Value):
    """A list of several names, at least so many; `called` as for one. Those that `others`
    add are looked for where a name is not known.
    """

    known: Known
    called: str = "names"
    least: int = 0
    others: Known = tuple

    def read(self, value: Any, place: Location) -> list[str]:
        """Check a list of names, and return each once."""
        is_list = isinstance(value, list) and len(value) >= self.least
        if not is_list or not all(isinstance(name, str) for name in value):
            raise place.wrong(f"must be a list of {self.called}", value)
        known = self.known()
        if not all(name in known for name in value):
            place.check_names(value, self._all())
        return list(dict.fromkeys(value))

    def _all(self) -> list[str]:
        return [*self.known(), *self.others()]

    @property
    def schema(self) -> Schema:
        """An array of names."""
        items = one_of(self._all())
        return {"type": "array", "items": items, "minItems": self.least}

    @property
    def words(self) -> str:
        """A list of what the names are called."""
        return f"list of {self.called}"


@dataclass(frozen=True)
class Text(Value):
    """A text of a pattern, which `form` describes."""

    pattern: str
    form: str

    def read(self, value: Any, place: Location) -> str:
        """Check the form of a text."""
        if not isinstance(value, str) or not re.fullmatch(self.pattern, value):
            raise place.wrong(f"must be {self.words}", value)
        return value

    @property
    def schema(self) -> Schema:
        """A text and its pattern."""
        return {"type": "string", "pattern": f"^{self.pattern}$"}

    @property
    def words(self) -> str:
        """The form."""
        return self.form


_UNITS = {"": 1, "B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
_UNITS |= {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30, "TiB": 1 << 40}
_MEMORY = rf"([0-9]+(?:\.[0-9]+)?) ?({'|'.join(_UNITS)})"


@dataclass(frozen=True)
class Memory(Value):
    """An amount of memory, as bytes or as text with a unit."""

    low: int
    high: int

    def read(self, value: Any, place: Location) -> int:
        """The number of bytes."""
        size = value
        match = re.fullmatch(_MEMORY, value) if isinstance(value, str) else None
        if match:
            size = int(min(float(match[1]) * _UNITS[match[2]], 2 * self.high))
        is_whole = isinstance(size, int) and not isinstance(size, bool)
        if not is_whole or not self.low <= size <= self.high:
            raise place.wrong(f"must be {self.words}", value)

        return int(size)

    @property
    def schema(self) -> Schema:
        """A number of bytes, or a text."""
        size = Whole(self.high, self.low).schema
        return {"anyOf": [size, {"type": "string", "pattern": f"^{_MEMORY}$"}]}

    @property
    def words(self) -> str:
        """The bounds and an example."""
        low, high = f"{self.low >> 20} MiB", f"{self.high >> 40} TiB"
        return f'at least {low} and at most {high}, as in "2 GiB"'

    def written(self, default: Any) -> str:
        """So many GiB."""
        return f"{default >> 30} GiB"


#: A percentage as a study writes it.
_PERCENTAGE = r"([0-9]+(?:\.[0-9]*)?) ?%"


class Tolerance(Value):
    """By how much a number may be off: in its units, or as a percentage of its size."""

    words = 'number above 0, or a percentage, as "1%"'

    def read(self, value: Any, place: Location) -> float | str:
        """Check a tolerance, and return it as it is given."""
        if isinstance(value, str):
            match = re.fullmatch(_PERCENTAGE, value)
            size = float(match[1]) if match else 0.0
        else:
            size = place.number(value)
        if not 0 < size <= LARGEST:
            raise place.wrong(f"must be a {self.words}", value)
        return value if isinstance(value, str) else size

    @property
    def schema(self) -> Schema:
        """A number, or a text."""
        number = {"type": "number", "exclusiveMinimum": 0, "maximum": LARGEST}
        return {"anyOf": [number, {"type": "string", "pattern": f"^{_PERCENTAGE}$"}]}


class Flag(Value):
    """Whether something holds."""

    words = "true or false"

    def read(self, value: Any, place: Location) -> bool:
        """Check a flag."""
        if not isinstance(value, bool):
            raise place.wrong(f"must be {self.words}", value)
        return value

    @property
    def schema(self) -> Schema:
        """A boolean."""
        return {"type": "boolean"}


class ViolationLimits(Value):
    """Limits above which violations are flagged, by the names of violations."""

    words = "table of limits by the names of violations"
    _limit = Number(low=0)

    def read(self, value: Any, place: Location) -> dict[str, float]:
        """Check limits; those at their defaults count as left out."""
        if not isinstance(value, Mapping):
            raise place.wrong(f"must be a {self.words}", value)

        place.check_names(value, VIOLATIONS, "violation")
        limits = {
            name: self._limit.read(limit, place.at(name))
            for name, limit in value.items()
        }

        return {
            name: limit
            for name, limit in limits.items()
            if limit != VIOLATIONS[name].limit
        }

    @property
    def schema(self) -> Schema:
        """A table of limits with their defaults."""
        limits = {
            v.name: {
                "description": f"{v.reason} [{v.unit}]",
                **self._limit.schema,
                "default": v.limit,
            }
            for v in VIOLATIONS.values()
        }
        return table(limits)


@dataclass(frozen=True)
class Table(Value):
    """Values of one kind by names, all of which are known: `called` what the values and
    the names are.
    """

    known: Known
    of: Value
    called: tuple[str, str]

    def read(self, value: Any, place: Location) -> dict[str, Any]:
        """Check values."""
        if not isinstance(value, Mapping):
            raise place.wrong(f"must be a {self.words}", value)
        place.check_names(value, self.known(), self.called[1])
        return {name: self.of.read(own, place.at(name)) for name, own in value.items()}

    @property
    def schema(self) -> Schema:
        """A table of these values."""
        return table(dict.fromkeys(self.known(), self.of.schema))

    @property
    def words(self) -> str:
        """A table of what its values are called."""
        values, names = self.called
        return f"table of {values} by the names of {names}s"


@dataclass(frozen=True)
class KeyRanges(Value):
    """Ranges of two keys."""

    known: Known

    @property
    def words(self) -> str:
        """Two keys with their ranges."""
        return "table of the ranges of two keys"

    def read(self, value: Any, place: Location) -> dict[str, list[float]]:
        """Check two ranges."""
        if not isinstance(value, Mapping) or len(value) != 2:
            raise place.wrong(f"must be a {self.words}", value)
        place.check_names(value, self.known(), "key")
        return {name: Range().read(value[name], place.at(name)) for name in value}

    @property
    def schema(self) -> Schema:
        """A table of two ranges."""
        ranges = table(dict.fromkeys(self.known(), Range().schema))
        return {**ranges, "minProperties": 2, "maxProperties": 2}


@dataclass(frozen=True)
class Composite(Value):
    """A walker, or a table with fields of its own, which others read."""

    called: str

    def read(self, value: Any, place: Location) -> object:
        """The value as it is."""
        return value

    @property
    def schema(self) -> Schema:
        """Anything."""
        return {}

    @property
    def words(self) -> str:
        """What it is called."""
        return self.called


def one_of(names: Iterable[str]) -> Schema:
    """JSON Schema of one of several names."""
    return {"type": "string", "enum": list(names)}


def table(keys: Mapping[str, Schema], needed: Iterable[str] = ()) -> Schema:
    """JSON Schema of a table that holds these keys alone."""
    return {
        "type": "object",
        "properties": dict(keys),
        "required": list(needed),
        "additionalProperties": False,
    }


def _plain(number: float) -> str:
    """A number as it is written: 1e-6 and not 1e-06."""
    return re.sub(r"e([+-])0*(\d)", r"e\1\2", f"{number:g}").replace("e+", "e")
