"""The figures of a report: one function each, by the name that a study's `figures` list
uses.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from unittest import mock

import pandas as pd

from gaitsweep import extensions
from gaitsweep.pipeline.report.figures import (
    bifurcation,
    body,
    branch_curves,
    curves,
    cycle,
    design_maps,
    families,
    laws,
    maps,
    optima,
    over_key,
    parameters,
    ranking,
    searches,
    sought,
)
from gaitsweep.pipeline.report.figures.degrees import add_degrees
from gaitsweep.pipeline.report.figures.sketch import Sketch
from gaitsweep.pipeline.report.figures.style import style
from gaitsweep.pipeline.report.figures.svg import Drawing, render
from gaitsweep.pipeline.report.source import Source
from gaitsweep.pipeline.report.words import WORDS
from gaitsweep.pipeline.study.plot import Plot

#: What draws each figure, of the archive and of the tables that `words.toml` names for
#: it.
_DRAWN: dict[str, Callable[..., Sketch | None]] = {
    "residuals": families.residuals,
    "transition_ladder": laws.transition_ladder,
    "angles": cycle.angles,
    "walker": body.walker,
    "conditions": body.conditions,
    "parameters": parameters.parameters,
    "locus": branch_curves.locus,
    "bifurcation": bifurcation.bifurcation,
    "heatmap": maps.heatmap,
    "over_key": over_key.over_key,
    "basin": maps.basin,
    "design": design_maps.design,
    **{name: partial(families.quantity, name) for name in families.QUANTITIES},
    "measured": families.measurements,
    "lyapunov": bifurcation.lyapunov,
    "exponents": laws.exponents,
    "sensitivities": ranking.sensitivities,
    "census": searches.census,
    "cascade": searches.cascade,
    "curves": curves.curves,
    "optimum": optima.optimum,
    "sought": sought.sought,
}


def _of_tables(name: str, source: Source) -> Sketch | None:
    """Sketch a figure from the tables that it needs; None where the archive lacks one,
    a column or other data.
    """
    tables = [
        source.table(table, *columns)
        for table, columns in WORDS["figures"][name].get("tables", {}).items()
    ]
    return (
        None
        if any(table is None for table in tables)
        else _DRAWN[name](source, *tables)
    )


FIGURES = {name: partial(_of_tables, name) for name in _DRAWN}


class Undrawn(Exception):
    """Why a figure cannot be drawn, as the end of a sentence."""


def sketch(source: Source, name: str, told: set[str]) -> Sketch:
    """Sketch one figure of a study, without what is `told` of its legend already.

    Raises
    ------
    Undrawn
        If the archive lacks its data, or there is no figure of that name.
    """
    drawn = FIGURES[name](source) if name in FIGURES else _of_package(source, name)
    if drawn is None:
        raise Undrawn(f"the archive has no {WORDS['figures'][name]['absent']}")
    drawn.draw_legend(told)
    add_degrees(drawn.figure)
    return drawn


def _of_package(source: Source, name: str) -> Sketch:
    """Sketch a figure that another package draws."""
    try:
        plot = extensions.find("figures", name, Plot)
    except extensions.ExtensionError as error:
        raise Undrawn(str(error)) from error

    if plot is None:
        raise Undrawn("there is no figure of that name")

    absent = [each for each in plot.reads if each not in source.grid.variables]
    if absent:
        raise Undrawn(f"the archive has no {' and no '.join(absent)}")

    drawn = Sketch(name, plot.height)
    try:
        data = pd.DataFrame(plot.draw(drawn.panels[0], source.grid))
    except (
        Exception
    ) as error:  # whatever a function may raise: the other figures are drawn
        raise Undrawn(f"its package raises {type(error).__name__}: {error}") from error

    drawn.texts = {
        "title": "{title}",
        "alt": "{alt}",
        "caption": {"always": "{caption}"},
    }
    return drawn.finish(data, title=plot.title, alt=plot.alt, caption=plot.caption)


def draw(
    source: Source,
    name: str,
    salt: str,
    small: bool = True,
    told: set[str] | None = None,
) -> Drawing:
    """Draw one figure of a study.

    `salt` makes the SVG's identifiers differ from those of other figures on the page;
    `small` asks for a version for the index; `told` are the legends of earlier figures
    of the page, which this one does not repeat.

    Raises
    ------
    Undrawn
        As `sketch`.
    """
    with style(), mock.patch.dict(os.environ):
        # Matplotlib reads it even for what it does not write, and it may be anything.
        os.environ.pop("SOURCE_DATE_EPOCH", None)
        drawn = sketch(source, name, set() if told is None else told)
        drawn.values["steps"] = source.steps if source.steps > 1 else None
        drawn.marks = [
            replace(marks, free=marks.free or source.steps > 1) for marks in drawn.marks
        ]
        return render(drawn, name, salt, small)
