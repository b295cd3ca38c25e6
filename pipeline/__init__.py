"""How a grid of points is run, kept and shown: study, plan, graph, journal, archive, report.

In a notebook, `from pipeline import load, run, solve`.
"""

from typing import Any

__all__ = ["load", "run", "solve"]

#: What "the paper" means in archives and on pages.
PAPER = ("M. Garcia, A. Chatterjee, A. Ruina: Efficiency, speed, and scaling of two-dimensional passive-dynamic"
         " walking, Dynamics and Stability of Systems 15(2), 75-99, 2000, doi:10.1080/713603737")


def __getattr__(name: str) -> Any:
    # Late, so that the command line loads no more than a command needs.
    if name in __all__:
        from pipeline import notebook

        return getattr(notebook, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
