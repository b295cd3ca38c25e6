"""What a study of kind `optimum` asks of a line, checked before anything runs; this
module imports no solver.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.measures.names import check_measure
from gaitsweep.tasks.walkers.resolve import walkers_over
from gaitsweep.tasks.walkers.walker import WalkerError


def check(params: Mapping[str, Any]) -> None:
    """Check what is asked of a line before anything runs.

    Parameters
    ----------
    params : mapping
        `walker` and `set`, of a line, and `options` of the study.

    Raises
    ------
    WalkerError
        If there is no walker at a corner of the ranges of the keys, or the walker's
        gaits lack a measure.
    """
    options = registry.options("optimum", params["options"])
    line = {"walker": params["walker"], "set": params.get("set") or {}}
    free = options["free"]
    for corner in itertools.product(*free.values()):
        walker = walkers_over(line, *free)(*corner)
    if "g" in free and walker.is_passive:
        raise WalkerError("free", "g", "must hold keys that change more than units")

    name = options["minimise"] or options["maximise"]
    named = {name: "maximise" if options["maximise"] else "minimise"}
    named |= dict.fromkeys(options["within"], "within")
    named |= dict.fromkeys(options["tradeoff"], "tradeoff")
    for measure, option in named.items():
        check_measure(measure, walker, option, ("slope", *free))
