"""What a study wants: variables, fits, figures and claims."""

import importlib.util
from collections.abc import Mapping
from typing import Any

from gaitsweep import extensions
from gaitsweep.pipeline.study.fields import WANT, value_of
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.study.plot import Plot
from gaitsweep.tasks.contract import accuracy as accuracies
from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import (
    COSTLY,
    FIGURES,
    READS,
    SENSITIVITIES,
    VARIABLES,
    VARIED,
    derivatives,
)


def read(
    table: Mapping[str, Any],
    accuracy: float,
    location: Location,
    at: Mapping[str, Any] | None = None,
) -> dict[str, tuple[str, ...]]:
    """What a study wants, by the fields of its table `want`; `at` is what its gaits are
    sought at.

    Raises
    ------
    StudyError
        If a name is unknown.
    """
    given, place = table.get("variables"), location.at("variables")
    wanted = {"variables": of_targets(variables(given, place, accuracy), at)}
    for key in ("fits", "figures", "claims"):
        wanted[key] = tuple(value_of(WANT, key, table, location))

    place = location.at("figures")
    for name in wanted["figures"]:
        if name not in FIGURES:
            plot = place.blamed(extensions.find, "figures", name, Plot)
            READS[name] = variables(list(plot.reads), place)

    return wanted


def variables(
    value: object, location: Location, accuracy: float = 0.0
) -> tuple[str, ...]:
    """Names of the variables that a list of names and groups asks for.

    Parameters
    ----------
    value : object
        If it is None, all but the costly ones, and of an accuracy those that need not
        be integrated.
    location : Location
    accuracy : float
        0 for none.

    Raises
    ------
    StudyError
        If a name is unknown.
    """
    if value is None:
        return _unasked(accuracy)
    if isinstance(value, list):
        given = [name for name in value if isinstance(name, str)]
        location.blamed(registry.admit, given)

    names = WANT["variables"].value.read(value, location)
    if names == [SENSITIVITIES]:
        names += _unasked(accuracy)
    requested = {*names, *accuracies.always(accuracy)}
    own = [
        v.name
        for v in VARIABLES.values()
        if {v.name, v.group} & requested and v.group != SENSITIVITIES
    ]
    if SENSITIVITIES in requested:
        requested |= {*own, *derivatives(own)}
        registry.admit(requested)

    wanted = tuple(
        v.name
        for v in VARIABLES.values()
        if v.name in requested or v.group in requested - {SENSITIVITIES}
    )
    if any(VARIABLES[name].group == "proofs" for name in wanted):
        need_proofs(location)
    return wanted


def of_targets(names: tuple[str, ...], at: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Names of variables with what is varied, and without the measure that is an axis,
    where gaits are sought at its values.
    """
    if not at:
        return names
    return (*(name for name in names if name != at["measure"]), VARIED)


def _unasked(accuracy: float) -> tuple[str, ...]:
    """Variables of a study that names none."""
    groups = {*COSTLY, "multipliers"} if accuracy else set(COSTLY)
    integrated = accuracies.OF_INTEGRATION if accuracy else ()
    return tuple(
        v.name
        for v in VARIABLES.values()
        if v.group not in groups and v.name not in integrated
    )


def need_proofs(location: Location) -> None:
    """Check that the extra `proof` is installed; raises StudyError if it is not."""
    if importlib.util.find_spec("flint") is None:
        raise location.error(
            "Proofs need the extra `proof` (python-flint): pip install 'gaitsweep[proof]'"
        )
