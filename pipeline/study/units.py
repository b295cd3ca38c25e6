"""Units of a study: SI where every walker has them, else each walker's own consistent ones."""

from typing import Any

from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.registry import SI_UNITS


def is_si(study: Study) -> bool:
    """Whether every walker of a study is in SI units."""
    return all(check["si"] for check in study.checks)


def is_mixed(study: Study) -> bool:
    """Whether some walkers of a study are in SI units and some are not."""
    return len({check["si"] for check in study.checks}) > 1


def of_kind(kind: str, is_si: bool) -> str:
    """CF units of a kind of quantity, for walkers in SI (`is_si`) or in consistent units."""
    return SI_UNITS.get(kind, "1") if is_si or kind == "angle" else "1"


def axis_units(name: str, is_si: bool) -> str:
    """CF units of an axis, for walkers in SI (`is_si`) or in consistent units."""
    keys, one_link = (resolve(f"gaitsweep.tasks.walkers.walker:{table}") for table in ("KEYS", "ONE_LINK"))
    kinds = {**keys, **one_link, "slope": "angle", "foot_mass_ratio": "number", "detuning": "number"}
    return of_kind(kinds[name], is_si)


def described(long_name: str, kind: str, is_si: bool, is_mixed: bool = False) -> dict[str, Any]:
    """CF attributes of a quantity of some kind; where units are mixed, they are those of each walker."""
    about = {"long_name": long_name, "units": of_kind(kind, is_si)}
    if is_mixed and kind not in ("number", "angle"):
        about["comment"] = "in the units of each walker: see walker_units"
    return about
