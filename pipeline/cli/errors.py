"""An error of a command in one line, and its exit code."""

import contextlib
import traceback
from collections.abc import Iterator
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


@contextlib.contextmanager
def report_errors(codes: list[int], debug: bool) -> Iterator[None]:
    """Print an error on one line and append its exit code to `codes`."""
    try:
        yield
    except BrokenPipeError:
        terminal.silence(1)
        codes.append(1)
    except KeyboardInterrupt:
        terminal.say("gaitsweep: Stopped.")
        codes.append(130)
    except Exception as error:
        if debug:
            traceback.print_exc()
        known = error if isinstance(error, GaitsweepError) else None
        if is_disk_full(error):  # of standard output
            terminal.silence(1)
            known = DiskFullError("The disk is full; not everything could be printed.")
        elif limit := reached_limit(error):
            known = unwritten(Path(), limit)
        internal = f"Internal error, {described(error)}; --debug shows where."
        terminal.say(f"gaitsweep: {known or internal}")
        codes.append(known.exit_code if known else 2)
