"""How a grid of points is run, kept and shown: study, plan, graph, journal, archive, report.

In a notebook, `from pipeline import load, run, solve`.
"""

from typing import Any

__all__ = ["load", "run", "solve"]


def __getattr__(name: str) -> Any:
    # Late, so that the command line loads no more than a command needs.
    if name in __all__:
        from pipeline import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
