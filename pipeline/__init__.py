"""Run a grid of points, store the results and report them.

The folders follow a number from study to page: `study`, `grid`, `graph`, `store`, `engine`, `archive`, `report`.
What a notebook uses is exported by `gaitsweep`.
"""


def __getattr__(name: str) -> object:
    import gaitsweep

    if name in gaitsweep.__all__ and name != "report":  # which here is a folder
        return getattr(gaitsweep, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
