"""The command line over toy tasks."""

import os
import sys

from gaitsweep.tasks.contract import registry

# Lines of 200 points are long ones, whose chunks workers finish. Read when modules are
# imported, so set before.
registry.SHORT_LINE = 100

from gaitsweep.pipeline.cli import commands  # noqa: E402
from gaitsweep.pipeline.grid import grid  # noqa: E402

grid.MOST_POINTS = int(os.environ.get("TOY_CHUNK", "20"))

VERSIONS = dict(item.split("=") for item in os.environ.get("TOY_VERSIONS", "").split())
TOYS = {
    t.name: t
    for t in (
        registry.Task(
            "atlas",
            "toy:atlas",
            int(VERSIONS.get("atlas", 1)),
            side_by_side=os.environ.get("TOY_SIDE_BY_SIDE", ""),
        ),
        registry.Task(
            "points", "toy:points", int(VERSIONS.get("points", 1)), needs=("atlas",)
        ),
        registry.Task(
            "scaling", "toy:fit", int(VERSIONS.get("scaling", 1)), needs=("points",)
        ),
        registry.Task("transition", "toy:fit_atlas", 1, needs=("points", "atlas")),
        registry.Task("orbit", "toy:orbit", 1, needs=("atlas",)),
    )
}
registry.TASKS.clear()
registry.TASKS.update(TOYS)
for kind in registry.OPTIONS.keys() - {"grid", *TOYS}:
    del registry.OPTIONS[kind]

if __name__ == "__main__":
    sys.exit(commands.main())
