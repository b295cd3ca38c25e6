"""Variables of gaits, which `variables.toml` lists, and what the other modules need to
know of each.

Like the registry, this module imports no solver.
"""

import re
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gaitsweep import extensions

#: Labels of the gait dimension. `other1`, ... hold the further gaits of a label, by
#: falling angle.
GAITS = ("long", "short", "other1", "other2")

#: What can become of a solve (CF flag values). How a run ended for a worker is added by
#: the pipeline.
STATUSES = {
    "converged": 0,
    "no_gait": 1,
    "not_converged": 2,
    "fell": 3,
    "less_accurate": 9,
}

_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: SI units of each kind of quantity; every one is "1" for a walker in consistent units.
SI_UNITS: dict[str, str] = _TABLES["units"]
#: Powers of length, mass and time in SI units, which those of kinds consist of.
_POWERS = {
    **{"m": (1, 0, 0), "kg": (0, 1, 0), "s": (0, 0, 1), "rad": (0, 0, 0)},
    **{"N": (1, 1, -2), "J": (2, 1, -2), "W": (2, 1, -3)},
}


def _dimensions(units: str) -> tuple[int, ...]:
    """Powers of length, mass and time in units that are written as "kg m2 s-2"."""
    total = [0, 0, 0]
    for symbol, exponent in re.findall(r"([A-Za-z]+)(-?\d*)", units):
        for k, power in enumerate(_POWERS[symbol]):
            total[k] += power * int(exponent or 1)
    return tuple(total)


_DIMENSIONS = {kind: _dimensions(units) for kind, units in SI_UNITS.items()}


def units_of(kind: str, si: bool) -> str:
    """CF units of a kind of quantity, in SI (`si`) or in consistent units."""
    return SI_UNITS[kind] if si or kind == "angle" else "1"


@dataclass(frozen=True)
class Variable:
    """One archive variable: name, dimensions after the axes, kind of quantity, meaning,
    value without a gait.

    `over_steps` is what a gait of n steps has of its steps' values: that of the
    `first`, which begins with the largest stance angle, their `sum` or `mean`, the
    `greatest`, the `least`, or the flags of `any`; others follow from them. `is_smooth`
    is whether polynomials give it along a branch (`tasks.measures.smooth`): gaits are
    otherwise integrated. `only_of` is what a walker must have for it to have a
    value (`Walker.features`), empty for any: others have NaN, and but for knees studies
    of none but others leave it out.

    A variable of another package has a `measure`, called with the steps
    (`tasks.measures.gaits.Steps`) and what is measured of them already, arrays by name;
    it returns a value of each step. Its `version` is bumped by hand when its values
    change.
    """

    name: str
    dims: tuple[str, ...]
    kind: str
    long_name: str
    group: str = ""
    dtype: str = "f8"
    absent: float = float("nan")
    over_steps: str = "first"
    is_smooth: bool = False
    only_of: str = ""
    measure: Callable[[Any, dict[str, Any]], Any] | None = None
    version: int = 1

    def is_left_out(self, features: Iterable[str]) -> bool:
        """Whether studies leave it out whose walkers have none but these features."""
        return self.only_of not in ("", "knees", *features)

    def unit(self, length: Any, mass: Any, time: Any) -> Any:
        """Return its unit, by those of length, mass and time: numbers, or arrays."""
        # Powers of numbers and of arrays are rounded in two ways, products in one.
        unit = 1.0
        for power, base in zip(
            _DIMENSIONS[self.kind], (length, mass, time), strict=True
        ):
            for _ in range(abs(power)):
                unit = unit * base if power > 0 else unit / base
        return unit

    def units(self, si: bool) -> str:
        """CF units of this variable for a walker in SI (`si`) or in consistent units."""
        return units_of(self.kind, si)


#: Variables of a grid study, and assumptions with their limits, in the order in which
#: they are archived.
VARIABLES = {
    name: Variable(name, tuple(about.pop("dims", ["gait"])), **about)
    for name, about in _TABLES["variables"].items()
}


@dataclass(frozen=True)
class Violation:
    """A physical assumption of the model (appendix A of the paper), and how far a gait
    may go beyond it.

    A gait is flagged where one of its `amounts`, in `unit`, exceeds the `limit`; where
    `is_least`, where one lies below its negative. Quantities in the walker's units are
    over those of its leg l + R, its mass and g.
    """

    name: str
    amounts: tuple[str, ...]
    limit: float
    unit: str
    reason: str
    is_least: bool = False


VIOLATIONS = {
    name: Violation(name, tuple(about.pop("amounts")), **about)
    for name, about in _TABLES["violations"].items()
}

#: Values of `proved` (CF flags).
PROVED = {"not_attempted": 0, "proved": 1, "not_proved": 2}

#: Groups of variables that cost much: only a study that names them has them.
COSTLY = ("violations", "proofs", "targets", "sensitivities")
#: The group of derivatives of measures by slope and keys, each of which is called by
#: its measure and this.
SENSITIVITIES, BY_KEY = "sensitivities", "_by_key"
#: The group of what only gaits at values of a measure have, which no study names.
OF_TARGETS = "targets"
#: The variable that holds what is varied so that gaits have wanted values.
VARIED = "varied"

#: Always archived, whatever a study wants.
ALWAYS = ("residual", "error_bound", "branch", "piece", "status", "reason")


#: Variables that say how well a gait is known, not what it is.
_OF_THE_SOLVE = (
    "residual",
    "error_bound",
    "multiplier_error_bound",
    "energy_imbalance",
)


def derivatives(names: Iterable[str]) -> tuple[str, ...]:
    """Names of the derivatives of those of some variables that are measures."""
    return tuple(
        f"{name}{BY_KEY}" for name in names if name in VARIABLES and is_measure(name)
    )


def nameable() -> list[str]:
    """Return the names of the variables that a study may name one by one."""
    hidden = OF_TARGETS, SENSITIVITIES
    return [v.name for v in VARIABLES.values() if v.group not in hidden]


def is_measure(name: str) -> bool:
    """Whether a variable is a number of a gait, and not of its solve."""
    about = VARIABLES[name]
    return (
        about.dims == ("gait",)
        and about.dtype == "f8"
        and about.group not in ("proofs", OF_TARGETS)
        and name not in _OF_THE_SOLVE
    )


def _admit_derivative(name: str) -> None:
    """Add the derivatives of a measure, if it is the name of any."""
    measure = name.removesuffix(BY_KEY)
    if name in VARIABLES or name == measure or not derivatives([measure]):
        return

    own = VARIABLES[measure]
    VARIABLES[name] = replace(
        own,
        name=name,
        dims=("gait", "key"),
        long_name=f"derivatives by slope and keys of the {own.long_name}",
        group=SENSITIVITIES,
        is_smooth=False,
    )


def admit(names: Iterable[str]) -> None:
    """Add those of some variables that another package measures.

    Raises
    ------
    ExtensionError
        If one cannot be loaded, or is none.
    """
    names = {*names}
    by_keys = [name for name in names if name.endswith(BY_KEY)]
    for name in by_keys:
        _admit_derivative(name)
    if by_keys:
        for name in derivatives([*VARIABLES]):  # in the order of their measures
            if name in VARIABLES:
                VARIABLES[name] = VARIABLES.pop(name)

    for name in names - {
        own
        for variable in VARIABLES.values()
        for own in (variable.name, variable.group)
    }:
        added = extensions.find("measures", name, Variable)
        if added is None:
            continue

        like = Variable(
            name, ("gait",), added.kind, added.long_name, over_steps=added.over_steps
        )
        if (
            replace(added, measure=None, version=1) != like
            or added.kind not in SI_UNITS
            or added.measure is None
        ):
            raise extensions.ExtensionError(
                f"`{name}` has another name, kind or group than a measure of a package may"
            )

        VARIABLES[name] = added

    for name in sorted(
        v.name for v in VARIABLES.values() if v.measure
    ):  # in whatever order they came
        VARIABLES[name] = VARIABLES.pop(name)
