"""What a study of kind `curve` asks of a line, checked before anything runs; this module
imports no solver.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.measures.names import check_measure
from gaitsweep.tasks.walkers.resolve import walker_of_line, walkers_over
from gaitsweep.tasks.walkers.walker import ORDINARY, Walker, WalkerError


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
    walker = walker_inside(params, options)
    for measure in options["levels"]:
        check_measure(measure, walker, "levels")


def walker_inside(line: Mapping[str, Any], options: Mapping[str, Any]) -> Walker:
    """Return the walker near the middle of the keys over which curves are followed: what
    drives it there, as `push_off`, gives its gaits measures that the line's own may lack.

    Parameters
    ----------
    line, options : mapping
        Of a study of kind `curve`.
    """
    own = walker_of_line(line)
    ranges = options["plane"] or {options["key"]: (options["from"], options["to"])}
    try:
        values = [low + ORDINARY * (high - low) for low, high in ranges.values()]
        return walkers_over(line, *ranges)(*values)
    except WalkerError:
        return own
