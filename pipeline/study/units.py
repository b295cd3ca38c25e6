"""Units of a study: SI where every walker has them, else each walker's own consistent ones."""

from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.pipeline.study.model import Study
from gaitsweep.tasks.registry import SI_UNITS


def is_si(study: Study) -> bool:
    """Whether every walker of a study is in SI units."""
    return all(check["si"] for check in study.checks)


def axis_units(name: str, is_si: bool) -> str:
    """CF units of an axis, for walkers in SI (`is_si`) or in consistent units."""
    kind = {"slope": "angle", "foot_mass_ratio": "number", "detuning": "number"}.get(name)
    kind = (
        kind
        or {**resolve("gaitsweep.tasks.walkers.walker:KEYS"), **resolve("gaitsweep.tasks.walkers.walker:ONE_LINK")}[
            name
        ]
    )
    return SI_UNITS.get(kind, "1") if kind == "angle" or is_si else "1"
