"""The figures of a report: one function each, by the name that a study's `figures` list uses."""

import os
import warnings
from collections.abc import Callable
from functools import partial
from unittest import mock

from gaitsweep.pipeline.report.figures import (
    bifurcation,
    body,
    branch_curves,
    cycle,
    design_maps,
    families,
    laws,
    maps,
    measured,
    quantities,
    scaling,
    searches,
)
from gaitsweep.pipeline.report.figures.degrees import add_degrees
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import style
from gaitsweep.pipeline.report.figures.svg import Drawing, render
from gaitsweep.pipeline.report.source import Source

FIGURES: dict[str, Callable[[Source], Sketch | None]] = {
    "loglog": families.loglog,
    "linear": families.linear,
    "residuals": families.residuals,
    "transition_ladder": scaling.transition_ladder,
    "angles": cycle.angles,
    "walker": body.walker,
    "conditions": body.conditions,
    "locus": branch_curves.locus,
    "bifurcation": bifurcation.bifurcation,
    "heatmap": maps.heatmap,
    "basin": maps.basin,
    "design": design_maps.design,
    **{name: partial(quantities.draw, name) for name in quantities.QUANTITIES},
    "measured": measured.measured,
    "lyapunov": bifurcation.lyapunov,
    "exponents": laws.exponents,
    "census": searches.census,
    "cascade": searches.cascade,
    "curves": searches.curves,
}


def draw(source: Source, name: str, salt: str, small: bool = True, told: set[str] | None = None) -> Drawing | None:
    """Draw one figure of a study; None if the archive lacks its data or there is no figure of that name.

    `salt` makes the SVG's identifiers differ from those of other figures on the page; `small` asks for a version for
    the index; `told` are the legends of earlier figures of the page, which this one does not repeat.
    """
    function = FIGURES.get(name)
    if function is None:
        return None
    with style(), warnings.catch_warnings(), mock.patch.dict(os.environ):
        # Matplotlib reads it even for what it does not write, and it may be anything.
        os.environ.pop("SOURCE_DATE_EPOCH", None)
        # Words stay words in the SVG: the reader's fonts have the glyphs that the font of the layout lacks.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        sketch = function(source)
        if sketch is None:
            return None
        sketch.draw_legend(set() if told is None else told)
        add_degrees(sketch.figure)
        sketch.values["steps"] = source.steps if source.steps > 1 else None
        return render(sketch, name, salt, small)
