"""What a study of kind `optimum` asks of a line, checked before anything runs; this
module imports no solver.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from typing import Any

from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.measures.names import measures
from gaitsweep.tasks.walkers.resolve import resolve
from gaitsweep.tasks.walkers.walker import Walker, WalkerError


def walker_over(
    line: Mapping[str, Any], keys: Iterable[str], values: Iterable[float]
) -> Walker:
    """Return a line's walker at values of several keys.

    Raises
    ------
    WalkerError
        If there is none.
    """
    own = line.get("set") or {}
    return resolve(line["walker"], {**own, **dict(zip(keys, values, strict=True))})


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
        walker = walker_over(line, free, corner)

    known = measures(walker)
    name = options["minimise"] or options["maximise"]
    named = {name: "maximise" if options["maximise"] else "minimise"}
    named |= dict.fromkeys(options["within"], "within")
    named |= dict.fromkeys(options["tradeoff"], "tradeoff")
    for measure, option in named.items():
        if measure not in (*known, "slope", *free):
            bound = f"must be a measure of its gaits: {', '.join(known)}"
            raise WalkerError(option, measure, bound)
