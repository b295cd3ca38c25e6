"""Gaits of passive dynamic walkers, swept over grids and kept as CF netCDF.

`gaits`, `solve`, `sensitivities`, `step_map`, `simulate` and `check` answer in Python;
`run` runs a study, `load` opens its archive, `report` and `figure` show it; `schema`
describes studies to editors. The code is in the folders `pipeline`, which runs, keeps and shows, and `tasks`, which
computes.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gaitsweep.pipeline.api.check import check
    from gaitsweep.pipeline.api.reports import figure, report
    from gaitsweep.pipeline.api.sensitivities import sensitivities
    from gaitsweep.pipeline.api.steps import simulate, step_map
    from gaitsweep.pipeline.api.studies import gaits, load, run, solve
    from gaitsweep.pipeline.errors import (
        ArchiveError,
        BusyError,
        DiskFullError,
        GaitsweepError,
        StoppedError,
        StudyError,
        WorkerError,
    )
    from gaitsweep.pipeline.study.plot import Plot
    from gaitsweep.pipeline.study.schema import schema
    from gaitsweep.tasks.contract.registry import Variable

    __version__: str

_ERRORS = (
    "ArchiveError",
    "BusyError",
    "DiskFullError",
    "GaitsweepError",
    "StoppedError",
    "StudyError",
    "WorkerError",
)
#: Module of each name; it is imported on use, so that a command loads only what it
#: needs.
_HOMES = {
    "check": "gaitsweep.pipeline.api.check",
    **dict.fromkeys(("figure", "report"), "gaitsweep.pipeline.api.reports"),
    **dict.fromkeys(("simulate", "step_map"), "gaitsweep.pipeline.api.steps"),
    **dict.fromkeys(
        ("gaits", "load", "run", "solve"), "gaitsweep.pipeline.api.studies"
    ),
    "schema": "gaitsweep.pipeline.study.schema",
    "sensitivities": "gaitsweep.pipeline.api.sensitivities",
    "Plot": "gaitsweep.pipeline.study.plot",
    "Variable": "gaitsweep.tasks.contract.registry",
    **dict.fromkeys(_ERRORS, "gaitsweep.pipeline.errors"),
}

__all__ = [
    "ArchiveError",
    "BusyError",
    "DiskFullError",
    "GaitsweepError",
    "Plot",
    "StoppedError",
    "StudyError",
    "Variable",
    "WorkerError",
    "__version__",
    "check",
    "figure",
    "gaits",
    "load",
    "report",
    "run",
    "schema",
    "sensitivities",
    "simulate",
    "solve",
    "step_map",
]


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if name == "__version__":
        from importlib.metadata import version

        return version("gaitsweep")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
