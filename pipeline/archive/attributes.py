"""CF attributes of axes and variables, in files and in memory."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gaitsweep.pipeline.archive.citation import PAPER
from gaitsweep.pipeline.dispatch import resolve
from gaitsweep.pipeline.statuses import ALL_STATUSES
from gaitsweep.pipeline.study import units
from gaitsweep.pipeline.study.fields import EXTRA_AXES
from gaitsweep.pipeline.study.model import Study
from gaitsweep.pipeline.study.ways import ends
from gaitsweep.tasks.contract.registry import (
    PROVED,
    SENSITIVITIES,
    VARIABLES,
    VARIED,
    VIOLATIONS,
    Variable,
)

#: Attributes of coordinates, and of the sentences.
GAIT = {"long_name": "gait by its character", "units": "1"}
MULTIPLIER = {
    "long_name": "number of the eigenvalue, largest magnitude first",
    "units": "1",
}
KEY = {"long_name": "what a measure is differentiated by", "units": "1"}
KEY_UNITS = {"long_name": "units of the slope or of each key", "units": "1"}
REASON_TEXT = {"long_name": "sentences that `reason` counts from 0", "units": "1"}


def put(owner: Any, values: dict[str, Any]) -> None:
    """Set attributes of an open file, group or variable.

    Raises
    ------
    RuntimeError
        If they cannot be set, or are missing afterwards: short of memory, the library
        may lose them silently.
    """
    try:
        owner.setncatts(values)
        kept = set(owner.ncattrs())
    except AttributeError as error:  # netCDF4 raises it for any library error
        raise RuntimeError(str(error)) from error
    if not kept.issuperset(values):
        raise RuntimeError("attributes are lost")


def of_axis(name: str, checks: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """CF attributes of an axis.

    Of `detuning` also the parameters of the walkers at 0 and at 1, or lists of them, as
    JSON, by what `tasks` reports of each walker.
    """
    if name in VARIABLES:
        measure = VARIABLES[name]
        return units.described(measure.long_name, measure.kind, checks)

    about = {
        "long_name": EXTRA_AXES.get(name, f"walker's {name}"),
        "units": units.axis_units(name, checks),
    }
    found = [check["way"] for check in checks if "way" in check]
    if name != "detuning" or not found:
        return about

    start, end = ends(found)
    about["long_name"] = f"mixture of {start} (0) and {end} (1)"
    for at in (0, 1):
        tables = [way["tables"][at] for way in found]
        whole = tables[0] if len(tables) == 1 else tables
        about[f"walker_at_{at}"] = json.dumps(whole)

    return about


def differentiated(count: int) -> tuple[str, ...]:
    """The slope and the keys by which measures are differentiated, so many, in order."""
    names: tuple[str, ...] = resolve("gaitsweep.tasks.walkers.walker:DIFFERENTIATED")
    return names[:count]


def of_dataset(study: Study) -> dict[str, Any]:
    """Attributes of the results of a study, in a file or in memory."""
    source = "gaitsweep: passive dynamic walking in two dimensions, solved numerically"
    about: dict[str, Any] = {
        "Conventions": "CF-1.11",
        "source": source,
        "references": PAPER,
    }
    if study.accuracy:
        about["accuracy"] = study.accuracy
    if study.drive and study.kind != "grid":
        about["along"] = study.drive
    if study.steps > 1:
        about["steps"] = np.int32(study.steps)
        about["comment"] = (
            f"gaits that repeat after {study.steps} steps: the state is that with the "
            f"largest stance angle, period and losses are of all {study.steps} steps, a "
            "violation is the worst of them"
        )

    return about


def over_steps(long_name: str, steps: int) -> str:
    """Meaning of a quantity of one step, for gaits that repeat after several."""
    if steps == 1:
        return long_name
    of_all = long_name.replace("one step", f"{steps} steps")
    iterated = f"the {steps} times iterated step map's eigenvalues"
    return of_all.replace("the step map's eigenvalues", iterated)


def of_variable(variable: Variable, study: Study) -> dict[str, Any]:
    """CF attributes of a variable of a study."""
    about: dict[str, Any] = {}
    if variable.name == VARIED:
        about |= of_axis(str(study.at["vary"]), study.checks)
        return about | {"ancillary_variables": "status reason"}

    if variable.group == SENSITIVITIES:
        unit = units.of_kind(variable.kind, study.checks)
        comment = f"in {unit} over the unit of each key: see key_units"
        return {"long_name": variable.long_name, "units": "1", "comment": comment}

    meaning = over_steps(variable.long_name, study.steps)
    about |= units.described(meaning, variable.kind, study.checks)
    flags = {"status": ALL_STATUSES, "proved": PROVED}.get(variable.name)
    if flags is not None:
        about["flag_values"] = np.array(list(flags.values()), np.int8)
        about["flag_meanings"] = " ".join(flags)
    elif variable.name == "violations":
        about |= _flags_of_violations(study)

    if variable.name not in ("status", "reason"):
        about["ancillary_variables"] = "status reason"
    return about


def _flags_of_violations(study: Study) -> dict[str, Any]:
    """Attributes of the bits of violations: names, limits and units of these."""
    limits = violation_limits(study)
    masks = [1 << bit for bit in range(len(limits))]
    of_limits = [f"{name}: {VIOLATIONS[name].unit}" for name in limits]
    return {
        "flag_masks": np.array(masks, np.int32),
        "flag_meanings": " ".join(limits),
        "flag_limits": np.array(list(limits.values())),
        "flag_limit_units": "; ".join(of_limits),
    }


def violation_limits(study: Study) -> dict[str, float]:
    """Limit of every violation up to the last that the study's walkers may have, by name
    in the order of their bits.
    """
    limits: dict[str, float] = {}
    count = 0
    for violation in VIOLATIONS.values():
        limits[violation.name] = violation.limit
        amounts = [VARIABLES[name] for name in violation.amounts]
        if not all(amount.is_left_out(study.features) for amount in amounts):
            count = len(limits)

    limits = dict([*limits.items()][:count])
    return limits | study.options.get("violation_limits", {})
