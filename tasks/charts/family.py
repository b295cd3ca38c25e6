"""A walker with free keys, and what drives it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gaitsweep.tasks.step.drive import OVER_SLOPE, Drive
from gaitsweep.tasks.walkers.resolve import resolve_many
from gaitsweep.tasks.walkers.walker_array import WalkerArray


@dataclass(frozen=True)
class Family:
    """A walker with free keys: its name or table and the keys that have one value, as
    JSON, and the free ones; and what its gaits are followed over.
    """

    text: str
    keys: tuple[str, ...]
    drive: Drive = OVER_SLOPE

    @classmethod
    def of(
        cls, line: Mapping[str, Any], keys: Iterable[str], along: str = ""
    ) -> Family:
        """Return the family of a line with some keys free, over slopes or `along`
        another key that drives at the line's slope.
        """
        fixed = {
            key: value
            for key, value in (line.get("set") or {}).items()
            if key not in set(keys)
        }
        drive = OVER_SLOPE
        if along:
            drive = Drive(along, float(line["slope"]))
            fixed[along] = 0.0

        text = json.dumps([line["walker"], fixed], sort_keys=True)
        return cls(text, tuple(keys), drive)

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
