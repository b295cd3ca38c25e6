"""The paper's walkers (figures 3 and 9), by name."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

from gaitsweep.tasks.walkers.walker import KEYS, Walker

_TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
#: Each walker in words.
DESCRIPTIONS = {name: str(table["description"]) for name, table in _TABLES.items()}
#: The walker that `detuning` = 1 gives, where a table names none, for each tuned
#: walker.
PARTNERS = {
    name: str(table["detuned"]) for name, table in _TABLES.items() if "detuned" in table
}


def tune_exactly(walker: Walker) -> Walker:
    """Give a kneed walker the offsets w_t and w_s that meet section 5.1 exactly; those
    printed are rounded to 1 mm.
    """
    w_s = walker.c_s * math.tan(walker.eps_S)
    w_t = -math.tan(walker.eps_T) * (walker.c_t + walker.m_s * walker.l_t / walker.m_t)
    return replace(walker, w_t=w_t, w_s=w_s)


def _walker(name: str) -> Walker:
    table = _TABLES[name]
    keys = {key: value for key, value in table.items() if key in KEYS}
    walker = (
        replace(_walker(table["base"]), **keys) if "base" in table else Walker(**keys)
    )
    return tune_exactly(walker) if table.get("tuned_exactly") else walker


#: Walkers by name. A, C and the physical walker are in SI units, the others have g = 1.
CATALOGUE = {name: _walker(name) for name in _TABLES}
