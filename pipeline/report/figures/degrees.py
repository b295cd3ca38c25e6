"""Second axes in degrees, at the top and at the right of what is drawn in radians.

Logarithmic axes have none: their decades are read, not their values.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gaitsweep.pipeline.report.figures.style import MUTED, RULE, raise_titles, title_of
from gaitsweep.pipeline.report.words import plain

_UNIT = "(rad)"
_MAX_INTERVALS = 5

#: Size of the numbers, and the height of an axis above a panel [pt].
_SIZE, _HEIGHT = 8, 13.5


def add_degrees(figure: Figure) -> None:
    """Add axes in degrees to the top and right panels of a figure whose titles say
    radians.
    """
    panels = [
        axes
        for axes in figure.axes
        if axes.get_subplotspec() is not None and axes.axison
    ]
    for axes in panels:
        place: Any = axes.get_subplotspec()
        # Panels that do not share a scale each have their own.
        alone = len(axes.get_shared_y_axes().get_siblings(axes)) == 1
        for which, edge, is_outer in (
            ("x", "top", place.is_first_row()),
            ("y", "right", place.is_last_col() or alone),
        ):
            if (
                is_outer
                and getattr(axes, f"get_{which}scale")() != "log"
                and _is_in_radians(axes, which)
            ):
                _add(axes, which, edge)


def _is_in_radians(axes: Axes, which: str) -> bool:
    """Whether an axis of a panel is in radians, by its title or by that of the panels
    that share it.
    """
    shared = getattr(axes, f"get_shared_{which}_axes")().get_siblings(axes)
    return any(_UNIT in title_of(other, which) for other in shared)


def _add(axes: Axes, which: str, edge: str) -> None:
    low, high = np.degrees(sorted(getattr(axes, f"get_{which}lim")()))
    ticks = [
        float(tick)
        for tick in MaxNLocator(_MAX_INTERVALS).tick_values(low, high)
        if low <= tick <= high
    ]
    second = getattr(axes, f"secondary_{which}axis")(
        edge, functions=(np.degrees, np.radians)
    )
    getattr(second, f"set_{which}ticks")(
        ticks, [f"{plain(tick, 3)}°" for tick in ticks]
    )
    second.tick_params(colors=MUTED, labelsize=_SIZE, length=2)
    second.spines[edge].set(visible=True, color=RULE)
    if edge == "top":
        raise_titles(axes, _HEIGHT)
