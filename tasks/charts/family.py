"""A walker with free keys."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.walkers.resolve import resolve_many
from gaitsweep.tasks.walkers.walker_array import WalkerArray


@dataclass(frozen=True)
class Family:
    """A walker with free keys: its name or table and the keys that have one value, as
    JSON, and the free ones.
    """

    text: str
    keys: tuple[str, ...]

    @classmethod
    def of(cls, line: Mapping[str, Any], keys: Iterable[str]) -> Family:
        """Return the family of a line with some keys free."""
        fixed = {
            key: value
            for key, value in (line.get("set") or {}).items()
            if key not in set(keys)
        }
        return cls(json.dumps([line["walker"], fixed], sort_keys=True), tuple(keys))

    def walkers(self, points: np.ndarray) -> WalkerArray:
        """Return the walkers at values of the free keys.

        Parameters
        ----------
        points : ndarray, shape (n, d) [the walker's units]
        """
        walker, fixed = json.loads(self.text)
        return resolve_many(
            walker, {**fixed, **dict(zip(self.keys, points.T.copy(), strict=True))}
        )
