"""Functions for notebooks and scripts.

`studies` runs studies and loads their archives; `in_memory` solves gaits of arrays without files; `steps` evaluates the
step map and simulates.
"""

from gaitsweep.pipeline.api.steps import simulate, step_map
from gaitsweep.pipeline.api.studies import gaits, load, run, solve

__all__ = ["gaits", "load", "run", "simulate", "solve", "step_map"]
