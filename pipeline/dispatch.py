"""Functions of `tasks` by their names: solvers are loaded only where one is called."""

import contextlib
import importlib
import threading
from collections.abc import Iterator
from typing import Any

from gaitsweep.pipeline import terminal
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


#: Points, and walkers, of a question that is answered by code that is compiled quickly.
_FEW_POINTS, _FEW_WALKERS = 1000, 8


def for_question(
    points: int = 1, walkers: int = 1
) -> contextlib.AbstractContextManager[None]:
    """Let solvers be compiled as fast as the answer to a question of so many points,
    and walkers, is wanted; what is archived is computed without. Who waits at a
    terminal or a notebook is told of it.
    """
    is_large = points > _FEW_POINTS or walkers > _FEW_WALKERS
    code = "told" if is_large else "compact_code"
    compiling = resolve(f"gaitsweep.tasks.mechanics.kernel:{code}")
    context: contextlib.AbstractContextManager[None] = compiling(_tell)
    return context


#: After how many seconds who waits for an answer is told what takes so long.
_PATIENCE = 3.0


@contextlib.contextmanager
def telling(sentence: str) -> Iterator[None]:
    """Tell who waits at a terminal or a notebook what is done, where that takes longer
    than three seconds.
    """
    timer = threading.Timer(_PATIENCE, _tell, [sentence])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _tell(sentence: str) -> None:
    """Tell who waits, if there is somebody."""
    if terminal.is_terminal() or terminal.is_notebook():
        terminal.say(f"gaitsweep: {sentence}")
