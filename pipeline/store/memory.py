"""Finished results in memory, within a bound."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import Any


class Memory:
    """Results by their keys, the least recently used dropped beyond a bound of bytes."""

    def __init__(self, bound: int):
        self.bound, self.size = bound, 0
        self._results: OrderedDict[Hashable, tuple[int, Any]] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._results

    def get(self, key: Hashable) -> Any:
        """A result; None if it is not remembered."""
        if key not in self._results:
            return None
        self._results.move_to_end(key)
        return self._results[key][1]

    def put(self, key: Hashable, result: Any, size: int) -> None:
        """Remember a result that is not, of so many bytes."""
        self._results[key] = size, result
        self.size += size
        while self.size > self.bound:
            self.size -= self._results.popitem(last=False)[1][0]
