"""Standard output and standard error, either of which may be closed or full, and words
of what is written there.
"""

import contextlib
import io
import os
import sys

#: How many times longer than something that is shown of a run takes is waited before it
#: is done again.
PAUSE = 100.0


def prepare() -> None:
    """Open closed standard streams on the null device, so that no other file takes
    their place.

    Letters that the encoding of standard output lacks are printed by number, as on
    standard error.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    for name, stream in (("stdout", 1), ("stderr", 2)):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(stream, "w", closefd=False))

    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def is_terminal() -> bool:
    """Whether standard error is a terminal; a Python process may have none, or another
    object in its place.
    """
    return bool(getattr(sys.stderr, "isatty", bool)())


def is_notebook() -> bool:
    """Whether cells of a notebook are run."""
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return hasattr(shell, "kernel")


def columns() -> int:
    """Width of the terminal that standard error is; 119 where it is not known."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        return os.get_terminal_size(sys.stderr.fileno()).columns or 119
    return 119


def counted(n: int, noun: str) -> str:
    """A number of things in words."""
    return f"{n:,} {noun}{'' if n == 1 else 's'}"


def say(text: str, end: str = "\n") -> None:
    """Write to standard error; on a full disk the text is lost, and nothing else."""
    if sys.stderr is None:
        return
    try:
        print(text, end=end, file=sys.stderr, flush=True)
    except OSError:
        silence(2)


def silence(stream: int) -> None:
    """Discard what is written to a standard stream from now on, and what is still in
    its buffer.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream)
    os.close(nowhere)


def duration(seconds: float) -> str:
    """Format a time, given in seconds."""
    if seconds < 120:
        return f"{seconds:.3g} s"
    if seconds < 7200:
        return f"{seconds / 60:.3g} min"
    return f"{float(f'{seconds / 3600:.3g}'):,.10g} h"


def processor_time() -> float:
    """Processor time of this process and of those that it has waited for [s]."""
    return sum(os.times()[:4])
