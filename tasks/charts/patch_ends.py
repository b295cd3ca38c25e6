"""How patches of charts end, and at which kinds of points pieces of branches do."""

from __future__ import annotations

from gaitsweep.tasks.branches.conditions import CONDITIONS
from gaitsweep.tasks.contract.kinds import KINDS

#: A patch ends at a fold, or is CUT where the piece goes on; its END is where walking
#: ends, and BEYOND that, where the equations go on, walking has ended before.
FOLD = "fold"
CUT = "cut"
END = "end"
BEYOND = "beyond"
#: Kinds of ends beyond which the equations of a gait go on and its own step tells that
#: it is none.
EVENTS = {name for name, kind in KINDS.items() if kind.ends == "walking"}
#: Kinds at which pieces end that are located over keys.
LOCATED = {
    name
    for name, kind in KINDS.items()
    if (name in EVENTS or kind.turns_slope or kind.steps_vanish) and name in CONDITIONS
}
