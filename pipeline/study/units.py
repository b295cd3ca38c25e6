"""Units of a study: SI where every walker has them, else each walker's own consistent
ones.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.tasks.contract.registry import SI_UNITS


def of_kind(kind: str, checks: Sequence[Mapping[str, Any]]) -> str:
    """CF units of a kind of quantity, for walkers of which `tasks` reports so: in SI,
    or in consistent units.
    """
    are_si = {check["si"] for check in checks} == {True}
    if are_si or kind == "angle":
        return SI_UNITS.get(kind, "1")
    return "1"


def kinds() -> dict[str, str]:
    """Kind of quantity of every axis, so of every key of a walker."""
    keys, one_link = (
        resolve(f"gaitsweep.tasks.walkers.walker:{table}")
        for table in ("KEYS", "ONE_LINK")
    )
    return {
        **keys,
        **one_link,
        "slope": "angle",
        "foot_mass_ratio": "number",
        "detuning": "number",
    }


def axis_units(name: str, checks: Sequence[Mapping[str, Any]]) -> str:
    """CF units of an axis."""
    return of_kind(kinds()[name], checks)


def described(
    long_name: str, kind: str, checks: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """CF attributes of a quantity of some kind; where walkers are in SI and not, units
    are those of each.
    """
    about = {"long_name": long_name, "units": of_kind(kind, checks)}
    if len({check["si"] for check in checks}) > 1 and kind not in ("number", "angle"):
        about["comment"] = "in the units of each walker: see walker_units"
    return about
