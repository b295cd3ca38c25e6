"""An error of a command in one line, and its exit code."""

import contextlib
import traceback
from collections.abc import Iterable, Iterator
from pathlib import Path

from gaitsweep.pipeline import terminal
from gaitsweep.pipeline.errors import (
    DiskFullError,
    GaitsweepError,
    described,
    is_disk_full,
    reached_limit,
    unwritten,
)

#: Exit codes, gravest first.
_BY_SEVERITY = (143, 130, 129, 4, 3, 2, 5, 1, 0)


def gravest(codes: Iterable[int]) -> int:
    """The exit code of a command that did several things; 0 if it did none."""
    return min(codes, key=_BY_SEVERITY.index, default=0)


def say(error: Exception, debug: bool) -> int:
    """Print an error on one line and its notes below, with `debug` below its traceback;
    returns its exit code.
    """
    if debug:
        traceback.print_exception(error)

    known = error if isinstance(error, GaitsweepError) else None
    if is_disk_full(error):  # of standard output
        terminal.silence(1)
        known = DiskFullError("The disk is full; not everything could be printed.")
    elif limit := reached_limit(error):
        known = unwritten(Path(), limit)

    internal = f"Internal error, {described(error)}; --debug shows where."
    notes = getattr(known, "__notes__", [])
    terminal.say("\n".join([f"gaitsweep: {known or internal}", *notes]))
    return known.exit_code if known else 2


@contextlib.contextmanager
def report_errors(codes: list[int], debug: bool) -> Iterator[None]:
    """Print the error with which a command ends, and append its exit code to `codes`."""
    try:
        yield
    except BrokenPipeError:
        terminal.silence(1)
        codes.append(1)
    except KeyboardInterrupt:
        terminal.say("gaitsweep: Stopped.")
        codes.append(130)
    except Exception as error:
        codes.append(say(error, debug))
