"""Run a grid of points, store the results and report them.

The folders follow a number from study to page: `study`, `grid`, `graph`, `store`, `engine`, `archive`, `report`.

In a notebook, `from pipeline import load, run, solve, gaits`; `api` has them all.
"""

from typing import Any

__all__ = ["gaits", "load", "run", "simulate", "solve", "step_map"]


def __getattr__(name: str) -> Any:
    # Imported on use, so that a command loads only what it needs.
    if name in __all__:
        from pipeline import api

        return getattr(api, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
