"""The time to go of a report: what is left of the work of its pages, at the pace of those
that are made.
"""

import math
from collections.abc import Mapping

from gaitsweep.pipeline.report.source import Source

#: Numbers of an archive that take as long as a figure does.
_VALUES_OF_A_FIGURE = 800_000
#: Of a study that only feeds the ledger [figure].
_LEAST = 0.02


def work(source: Source) -> float:
    """Expected work of the page of an archive: of an ordinary figure it is 1."""
    if source.only_claims:
        return _LEAST
    values = sum(variable.size for variable in source.grid.data_vars.values())
    values += sum(table.size for table in source.tables.values())
    return max(1, len(source.figures)) + values / _VALUES_OF_A_FIGURE


class TimeToGo:
    """Counts the pages that are made, by some processes side by side.

    Parameters
    ----------
    works : mapping
        Expected work of every page, by its name.
    processes : int
    """

    def __init__(self, works: Mapping[str, float], processes: int = 1) -> None:
        self._left = dict(works)
        self._processes = max(1, processes)
        self._done = self._seconds = 0.0

    def count(self, name: str, seconds: float) -> None:
        """Count a page that a process has made in some time."""
        self._done += self._left.pop(name)
        self._seconds += seconds

    @property
    def seconds(self) -> float:
        """Time to go [s]; NaN before the first page."""
        if not self._done:
            return math.nan
        pace = self._seconds / self._done
        return pace * sum(self._left.values()) / self._processes
