"""Reports and single figures of archives, from Python and for the command."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gaitsweep import extensions
from gaitsweep.pipeline.api.threads import in_turn
from gaitsweep.pipeline.archive import read
from gaitsweep.pipeline.errors import ArchiveError, unwritten
from gaitsweep.pipeline.study.location import Location
from gaitsweep.pipeline.without_dask import without_dask

if TYPE_CHECKING:  # the folder `report` imports matplotlib, with its own settings
    from matplotlib.figure import Figure


@in_turn
def report(
    archives: str | Path | Sequence[str | Path],
    folder: str | Path = "reports",
    *,
    only: bool = False,
    bundle: bool = False,
    extra: "Sequence[tuple[str, Figure, str]]" = (),
) -> Path:
    """Write the pages of archives, as the command does.

    Parameters
    ----------
    archives : str, Path or sequence of them
        Archives written by `run`.
    folder : str or Path
        Folder to whose pages they are added.
    only : bool
        Remove other pages there.
    bundle : bool
        Write `bundle.html` too: all pages there in one file.
    extra : sequence of (str, matplotlib.figure.Figure, str)
        Titles, figures and captions of your own, which the page of a single archive
        shows after its figures.

    Returns
    -------
    Path
        The page of a single archive; of several, or of a study that only feeds the
        ledger, the index.

    Raises
    ------
    ArchiveError
        If a file is not an archive of gaitsweep, or the folder cannot be written.
    StudyError
        If `extra` has no page, or holds what is no figure.
    """
    several = [archives] if isinstance(archives, str | Path) else archives
    return write(
        [archive_path(archive) for archive in several],
        archive_path(folder),
        only,
        bundle,
        extra=extra,
    )


def write(
    archives: Sequence[Path],
    folder: Path,
    only: bool,
    bundle: bool,
    tell: Callable[[int, float], object] = lambda made, left: None,
    extra: "Sequence[tuple[str, Figure, str]]" = (),
) -> Path:
    """Write the pages as `report` does; `tell` is told the number of pages made and the
    time to go [s], before the first and after each.
    """
    try:
        with without_dask():
            read.probe(archives, meanwhile=_load_pages)
            from gaitsweep.pipeline.report import pages

            return pages.write(archives, folder, only, tell, bundle, extra)
    except OSError as error:
        raise unwritten(folder, error) from error


def _load_pages() -> None:
    """Load what pages are made with, which takes as long as to read many archives."""
    from gaitsweep.pipeline.report import pages  # noqa: F401


@in_turn
def figure(archive: str | Path, name: str) -> "Figure":
    """Draw a figure of an archive as its page shows it.

    Parameters
    ----------
    archive : str or Path
        An archive written by `run`.
    name : str
        A name of a study's `figures`: `"loglog"`, `"bifurcation"`, `"heatmap"`, …; the
        study need not want it.

    Returns
    -------
    matplotlib.figure.Figure
        To change or to save; a notebook shows it.

    Raises
    ------
    StudyError
        If there is no figure of that name.
    ArchiveError
        If the file is not an archive of gaitsweep, or has no data for the figure.
    """
    from gaitsweep.pipeline.report import source
    from gaitsweep.pipeline.report.figures import FIGURES, Undrawn, sketch, style

    known = [*FIGURES, *extensions.names("figures")]
    Location("").check_names([name], known, "figure")
    path = archive_path(archive)
    read_source = source.read(path)
    try:
        with style():
            drawn = sketch(read_source, name, set()).figure
    except Undrawn as why:
        raise ArchiveError(f"{path} has no figure {name}: {why}.") from why

    def to_svg() -> str:
        stream = io.StringIO()
        with style():
            drawn.savefig(stream, format="svg", facecolor="white")
        return stream.getvalue()

    # A notebook shows figures of pyplot only, unless they say how.
    drawn._repr_svg_ = to_svg  # type: ignore[attr-defined]
    return drawn


def archive_path(archive: str | Path) -> Path:
    """Path of an archive that is named in Python; ArchiveError if it is no path."""
    if not isinstance(archive, str | Path):
        raise ArchiveError(f"An archive must be a file; got {type(archive).__name__}.")
    return Path(archive)
