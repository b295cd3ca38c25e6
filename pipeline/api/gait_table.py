"""Gaits as a table that draws their steps in a notebook."""

import base64
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd

from gaitsweep.pipeline.api.steps import simulate
from gaitsweep.pipeline.dispatch import ask
from gaitsweep.pipeline.errors import GaitsweepError
from gaitsweep.pipeline.study.model import Definition

#: Gaits that are drawn, and poses of each step.
_DRAWN, _POSES = 4, 5

#: State just after heelstrike from which a gait's steps are simulated.
_STATE = ["stance_angle", "stance_rate", "thigh_rate"]


class Walks(NamedTuple):
    """What the gaits of a table walk with: the walker, keys that are set, the number of
    steps after which they repeat, and what was varied to find them.
    """

    walker: Definition
    keys: dict[str, Any]
    steps: int
    varied: str


class GaitTable(pd.DataFrame):
    """One row a gait. A notebook shows the steps of the first gaits above the numbers, as
    pictures that lie in the page itself: they stay when it is converted or sent.

    What is selected or computed from it is an ordinary DataFrame.
    """

    # Names that pandas takes for no columns.
    _metadata: ClassVar[list[str]] = ["_walks"]
    _walks: Walks | None = None

    @classmethod
    def of(cls, frame: pd.DataFrame, walks: Walks) -> "GaitTable":
        """A table with what its gaits walk with."""
        table = cls(frame)
        table.attrs = frame.attrs
        table._walks = walks
        return table

    def _repr_html_(self) -> str | None:
        """The pictures and the table, as HTML."""
        numbers = super()._repr_html_()  # type: ignore[operator]
        if self._walks is None or numbers is None:
            return numbers  # type: ignore[no-any-return]
        rows = [row for _, row in self.head(_DRAWN).iterrows()]
        return "".join(_figure(row, self._walks) for row in rows) + str(numbers)


def _figure(gait: pd.Series, walks: Walks) -> str:
    """A gait's steps as HTML; empty where they cannot be simulated again, or the table
    has lost a column that this takes.
    """
    if not {*_STATE, "slope", walks.varied} <= {*gait.index}:
        return ""

    try:
        picture = base64.b64encode(_picture(gait, walks)).decode()
    except GaitsweepError:
        return ""

    stability = "stable" if gait.get("stable") == 1 else "unstable"
    words = f"{gait.get('gait', 'a')} step, {stability}"

    return (
        '<figure style="display:inline-block;margin:0 1em .5em 0">'
        f'<img alt="{words}" width="360" src="data:image/svg+xml;base64,{picture}">'
        f"<figcaption>{words}</figcaption></figure>"
    )


def _picture(gait: pd.Series, walks: Walks) -> bytes:
    """Poses of a gait over two of its periods, so that both legs step, as SVG."""
    from gaitsweep.pipeline.report.figures import film
    from gaitsweep.pipeline.report.figures.body import Body

    keys = dict(walks.keys)
    if walks.varied != "slope":
        keys[walks.varied] = float(gait[walks.varied])
    state = [float(value) for value in gait[_STATE]]
    slope, steps = float(gait["slope"]), 2 * walks.steps
    motion = simulate(walks.walker, slope, state, steps, motion=True, **keys)

    known = ask("check_walker", {"walker": walks.walker, "set": keys})
    body = Body.of(known["parameters"])
    assert body is not None  # its gaits were found
    lengths = film.lengths(motion)
    moments = np.linspace(0, lengths.sum(), _POSES * len(lengths) + 1)
    return film.strip(body, film.poses(motion, body, moments), slope, ".svg")
