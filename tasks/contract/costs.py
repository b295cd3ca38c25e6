"""Processor time of the tasks, which `costs.toml` lists, for plans and times to go
before any task is measured.

Like the registry, this module imports nothing but the standard library.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

#: Share of the lines of a plane that are surveyed by themselves, because charts predict
#: none of their gaits.
ALONE = 0.02
#: Time of one of few lines side by side, as those are in a chunk, over that of one of
#: many.
FEW = 2.0


@dataclass(frozen=True)
class Cost:
    """Time of each of a product of numbers [s], for walkers without knees and with.

    `of` names the factors: `slopes` of the study, `points`, `gait_steps` after which
    gaits repeat, `searches` for longer gaits, or options of its kind, those that are
    lists by their lengths; `a+b` is a sum. Without factors it is that of a line, or of
    a study if the task is over studies.
    """

    straight: float
    kneed: float
    of: Sequence[str] = ()


_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: Costs of each task, which add up.
COSTS = {
    name: tuple(Cost(*each) for each in costs)
    for name, costs in _TABLES["tasks"].items()
}
#: Time to start a run, and costs of a task that is not named.
STARTING, OTHERS = COSTS.pop("starting"), COSTS.pop("others")
#: Costs of a point by the way it is computed, and of groups of variables beside it.
POINTS = {name: Cost(*each) for name, each in _TABLES["points"].items()}
