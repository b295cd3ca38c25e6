"""Figures of other packages."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class Plot:
    """A figure of a report, as the entry point `gaitsweep.figures` of a package leads
    to it.

    Parameters
    ----------
    draw : callable
        Called with the axes and the archive's grid (docs/archive.md), a Dataset;
        returns a table of what it shows, which the page offers as CSV.
    reads : tuple of str
        Variables that it needs; a study with the figure computes them.
    title, caption, alt : str
        Title, caption, and a text for those who do not see it.
    height : float [pt]
    """

    draw: "Callable[[Axes, xr.Dataset], pd.DataFrame]"
    reads: tuple[str, ...]
    title: str
    caption: str
    alt: str
    height: float = 330
