"""What a study of kind `curve` asks of a line, checked before anything runs; this module
imports no solver.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gaitsweep.tasks.contract import registry
from gaitsweep.tasks.contract.registry import VIOLATIONS
from gaitsweep.tasks.measures.names import check_measure, measures
from gaitsweep.tasks.walkers.resolve import walker_of_line
from gaitsweep.tasks.walkers.walker import Walker


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


def without_meaning(names: Sequence[str], walker: Walker) -> Iterator[str]:
    """Say of each of some violations that gaits of a walker can have none of it, where
    that is so.
    """
    known = {*measures(walker)}
    for name in names:
        if name != "all" and known.isdisjoint(VIOLATIONS[name].amounts):
            yield f"`{name}` begins nowhere: gaits of this walker have no such violation."
