"""Names of the arrays that go through a step, with their shapes and units.

In shapes n counts lanes, m section coordinates, k event times, both of all steps after
which a gait repeats, and p runtime parameters.
"""

from __future__ import annotations

from typing import Annotated

from numpy import ndarray

#: A number of every lane.
PerLane = Annotated[ndarray, "(n,)"]
#: Whether something holds of every lane.
Marks = Annotated[ndarray, "bool, (n,)"]
#: Places of some lanes among all.
Numbers = Annotated[ndarray, "int, (some of n,)"]
Slopes = Annotated[ndarray, "(n,) [rad]"]
#: ln of the slope in rad.
LogSlopes = Annotated[ndarray, "(n,)"]
#: Similarity coordinates and event times: ln(angle in rad), rates over the angle, and
#: times in sqrt(leg/g); of order one over decades of slope.
Unknowns = Annotated[ndarray, "(m + k, n)"]
#: Angle and rates on the section, over the scale.
Sections = Annotated[ndarray, "(m, n)"]
#: Angles, then rates, of two links or three, over the scale.
States = Annotated[ndarray, "(4 or 6, n)"]
#: Times of the strikes since the step began, the last that of heelstrike.
Times = Annotated[ndarray, "(k, n) [sqrt(leg/g)]"]
#: Slope, scale and the structure's constants.
Parameters = Annotated[ndarray, "(p, n)"]
#: States of each phase at equal times; three links before two.
Motion = Annotated[list[ndarray], "(samples + 1, 4 or 6, n)"]
#: Unknowns of the equations along branches and curves: similarity coordinates, event
#: times, then ln slope or keys of the walker.
Coordinates = Annotated[ndarray, "(c, n)"]
#: Those of one gait.
Gait = Annotated[ndarray, "(c,)"]
