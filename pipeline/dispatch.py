"""Functions of `tasks` by their names: solvers are loaded only where one is called."""

import importlib
from typing import Any

from gaitsweep.pipeline.errors import StudyError


def resolve(name: str) -> Any:
    """Import the object named "module:name"."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


def call(name: str, params: dict[str, Any]) -> Any:
    """Call a function of `tasks.contract.registry.CALLS` in this process."""
    return resolve(resolve("gaitsweep.tasks.contract.registry:CALLS")[name])(params)


def ask(name: str, params: dict[str, Any]) -> Any:
    """Call a function of `tasks` by its name in the registry.

    Raises
    ------
    StudyError
        If the walker or another parameter is invalid.
    """
    try:
        return call(name, params)
    except ValueError as error:
        if not hasattr(error, "bound"):
            raise
        raise StudyError(str(error)) from error
