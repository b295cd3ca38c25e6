"""What a study of kind `curve` asks of a line, checked before anything runs; this module
imports no solver.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.measures.names import check_measure
from gaitsweep.tasks.walkers.resolve import walker_of_line


def check(params: Mapping[str, Any]) -> None:
    """Check that gaits of a line have the measures whose levels are followed.

    Parameters
    ----------
    params : mapping
        `walker` and `set`, of a line, and `options` of the study.

    Raises
    ------
    WalkerError
        If there is no walker, or its gaits lack a measure.
    """
    options = registry.options("curve", params["options"])
    walker = walker_of_line(params)
    for measure in options["levels"]:
        check_measure(measure, walker, "levels")
