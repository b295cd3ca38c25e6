"""Run studies, store their results and report them.

The folders follow a number from study to page: a `study` is asked for; `grid` divides
it into chunks; `graph` lays out what is to be computed, with keys; `engine` computes
what `store`, the journal, lacks; `archive` writes a netCDF file of the store; `report`
makes pages of archives. `cli` is the command line and `api` the functions for Python;
what a notebook uses of these is exported by `gaitsweep`.
"""


def __getattr__(name: str) -> object:
    import gaitsweep

    if name in gaitsweep.__all__ and name != "report":  # which here is a folder
        return getattr(gaitsweep, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
