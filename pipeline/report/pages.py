"""From archives to pages: an index, a page for each study, the ledger of claims, and
the data of every figure.
"""

import base64
import contextlib
import hashlib
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import joblib
import pandas as pd

from gaitsweep.pipeline.archive.citation import PAPER
from gaitsweep.pipeline.archive.read import blamed_if_damaged
from gaitsweep.pipeline.errors import StudyError
from gaitsweep.pipeline.report import entry, folder, html_tables, paper
from gaitsweep.pipeline.report.extra import Picture
from gaitsweep.pipeline.report.extra import pictures as extra_pictures
from gaitsweep.pipeline.report.figures import Undrawn, draw, slices, starts
from gaitsweep.pipeline.report.figures.style import NARROW_SMALL_WORDS, NARROW_WORDS
from gaitsweep.pipeline.report.figures.svg import Drawing
from gaitsweep.pipeline.report.minified import minified
from gaitsweep.pipeline.report.source import Source, read
from gaitsweep.pipeline.report.time_to_go import TimeToGo, work
from gaitsweep.pipeline.report.words import grouped, plain
from gaitsweep.pipeline.terminal import duration
from gaitsweep.pipeline.without_dask import without_dask

#: HTML and CSS of the pages, and the modules of their script.
TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = Path(__file__).parent / "scripts"

#: Modules of the script, each of which may call those before it.
_MODULES = (
    "flight",
    "gaits",
    "address",
    "stage",
    "walker",
    "figures",
    "slices",
    "tables",
)

#: Names of pages that belong to no study.
_RESERVED = ("index", "ledger", "bundle")

#: Columns of figures that are no variables of a grid, which have the unit of what gaits
#: are followed along; and units of others.
_ALONG = ("flip", "next flip", "distance")
_UNITS = dict.fromkeys(("slope", "stance_angle", "angle", *_ALONG), "rad")

#: Entries of the run's record that a page shows; the record also names the computer,
#: which a page does not.
_RUN = {
    name: name
    for name in (
        "began",
        "jobs",
        "cluster",
        "version",
        "points",
        "failed",
        "exit_code",
    )
}
_RUN |= {"seconds": "finished after (s)"}

#: Processes that make pages; a large archive takes each of them a GiB.
_MAX_PROCESSES = 4


def write(
    archives: Iterable[Path],
    out: Path,
    only: bool = False,
    tell: Callable[[int, float], object] = lambda made, left: None,
    bundle: bool = False,
    extra: Sequence[tuple[str, Any, str]] = (),
) -> Path:
    """Write the report of some archives into a folder: their pages, and the index and
    ledger of all pages there.

    Parameters
    ----------
    archives : iterable of Path
        Archives written by `gaitsweep run`; nothing else is read but the record of
        the run of each, `.gaitsweep/NAME.run.json` beside it.
    out : Path
        Folder of the pages, created if missing. A page and its data files are named
        after the study; a study reported again replaces them.
    only : bool
        Delete the other pages of earlier reports.
    tell : callable
        Told the number of pages made and the time to go [s], before the first, when
        that is NaN, and after each.
    bundle : bool
        Write `bundle.html` too, which holds all pages of the folder; one that is there
        is kept up to date.
    extra : sequence of (str, matplotlib.figure.Figure, str)
        Titles, figures and captions of the caller's own, for the page of a single
        archive.

    Returns
    -------
    Path
        The page of a single archive; of several, or of a study that only feeds the
        ledger, the index.

    Raises
    ------
    ArchiveError
        If a file is not an archive of gaitsweep.
    StudyError
        If `extra` has no page, or holds what is no figure.
    OSError
        If the folder cannot be written.
    """
    archives = [Path(archive) for archive in archives]
    pictures = extra_pictures(extra)
    sources = [read(archive) for archive in archives]
    _check_extra(pictures, sources)

    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    slugs = _slugs(sources)
    tell(0, math.nan)
    pages = _in_processes(sources, slugs, tell, pictures)
    with folder.locked(out):
        folder.combine(_environment(), out, pages, only, bundle)
    is_shown = len(sources) == 1 and not sources[0].only_claims
    return out / (f"{slugs[0]}.html" if is_shown else "index.html")


def _check_extra(pictures: Sequence[Picture], sources: Sequence[Source]) -> None:
    """Refuse figures of the caller's own that have no page.

    Raises
    ------
    StudyError
    """
    if pictures and len(sources) != 1:
        raise StudyError(
            f"`extra` belongs to the page of one archive; got {len(sources)} archives."
        )
    if pictures and sources[0].only_claims:
        raise StudyError(
            f"`extra` has no page: {sources[0].name} only feeds the ledger."
        )


def _make(source: Source, slug: str, pictures: Sequence[Picture] = ()) -> folder.Page:
    """Text of the page of a study, and its data files by their names."""
    with blamed_if_damaged(source.path):
        if source.only_claims:
            parts: Any = _environment().get_template("parts.html").module
            return str(parts.entry([vars(_entry(source, slug))])), {}
        return _study_page(source, slug, pictures)


def _processes(pages: int) -> int:
    """How many processes make some pages."""
    return min(_MAX_PROCESSES, joblib.cpu_count(), pages)


def _in_processes(
    sources: list[Source],
    slugs: list[str],
    tell: Callable[[int, float], object],
    pictures: list[Picture],
) -> dict[str, folder.Page]:
    """What `_make` gives for each source, by slug; pages depend on no other, so every
    core makes some, those of most work first.

    What processes do not deliver, for lack of memory or in error, is made here, where
    the error is raised.
    """
    works = {slug: work(source) for source, slug in zip(sources, slugs, strict=True)}
    called = dict(zip(slugs, sources, strict=True))
    processes = _processes(len(sources))
    to_go = TimeToGo(works, processes)
    made: dict[str, folder.Page] = {}

    def take(slug: str, page: folder.Page, seconds: float) -> None:
        made[slug] = page
        to_go.count(slug, seconds)
        tell(len(made), to_go.seconds)

    if processes > 1:
        first = sorted(slugs, key=lambda slug: -works[slug])
        calls = [joblib.delayed(_delivered)(called[slug], slug) for slug in first]
        # They start when the archives were read: without the memory for these, those
        # would be waited for without end.
        parallel = joblib.Parallel(
            processes,
            return_as="generator_unordered",
            batch_size=1,
            pre_dispatch="all",
        )
        # Whatever happens to a process: an error of a page is raised again below.
        with contextlib.suppress(Exception):
            for delivered in parallel(calls):
                take(*delivered)

    for slug in slugs:
        if slug not in made:
            take(*_timed(called[slug], slug, pictures))

    return {slug: made[slug] for slug in slugs}


def _delivered(source: Source, slug: str) -> tuple[str, folder.Page, float]:
    """What `_timed` gives, from a process of its own."""
    with without_dask():
        return _timed(source, slug, ())


def _timed(
    source: Source, slug: str, pictures: Sequence[Picture]
) -> tuple[str, folder.Page, float]:
    """A page with its slug, and the time that it took [s]."""
    began = time.monotonic()
    page = _make(source, slug, pictures)
    return slug, page, time.monotonic() - began


def _study_page(source: Source, slug: str, pictures: Sequence[Picture]) -> folder.Page:
    """The page of one study, which depends on no other, and its data files."""
    drawn, undrawn = drawings(source, slug)
    sections = html_tables.sections(source)
    absent = html_tables.points(source)
    listed = html_tables.listed(absent)
    frames = {drawing.name: drawing.data for drawing in drawn}
    frames |= {
        f"table-{table.name}": table.frame
        for _, own in sections.values()
        for table in own
        if table.name
    }
    frames |= {"absent": listed} if len(absent) else {}
    csv, files = _data_files(source, slug, frames)
    template, lines, states = (
        _environment().get_template("study.html"),
        starts.lines(source, _commands(drawn)),
        _share_states(drawn),
    )
    text = template.render(
        source=source,
        slug=slug,
        drawings=drawn,
        undrawn=undrawn,
        pictures=pictures,
        slices=slices.volume(source) if "heatmap" in source.figures else {},
        lines=lines,
        states=states,
        entries=[vars(_entry(source, slug, drawn, lines, files))],
        sections=sections,
        csv=csv,
        absent=absent,
        listed=listed,
        run={_RUN[k]: v for k, v in source.run.items() if k in _RUN},
        origin=_origin(source),
        software=_software(source),
    )
    return text, files


def _entry(
    source: Source,
    slug: str,
    drawings: Sequence[Drawing] = (),
    lines: list[dict[str, Any]] | None = None,
    files: Iterable[str] = (),
) -> entry.Entry:
    """The record for the index and the ledger; a study that only feeds the latter draws
    nothing.
    """
    words = paper.words(source)
    return entry.Entry(
        slug=slug,
        study=source.slug,
        name=source.name,
        title=words.get("title", source.title),
        about=source.about,
        whole=source.whole,
        section=words.get("section", ""),
        place=paper.PLACES.get(source.name, 0) if words else len(paper.PLACES),
        statuses=html_tables.statuses(source),
        figures=[
            {name: getattr(drawing, name) for name in ("name", "title", "finding")}
            | {"claims": words.get(drawing.name, {}).get("claims", [])}
            for drawing in drawings
        ],
        claims=html_tables.claims(source),
        files=list(files),
        thumbnail=drawings[0].small if drawings else "",
        lines=starts.brief(lines or []),
        text=source.provenance["study"] if source.only_claims else "",
    )


def drawings(source: Source, slug: str) -> tuple[list[Drawing], dict[str, str]]:
    """The figures of a study, and why others that it wants are missing."""
    added = {"fits/scaling": "residuals", "overlay": "measured", "lyapunov": "lyapunov"}
    wanted = dict.fromkeys(source.figures)
    if "walker" in wanted:  # where the walker is drawn, its parameters are named
        wanted["parameters"] = None
    wanted |= {name: None for table, name in added.items() if table in source.tables}
    drawn: list[Drawing] = []
    undrawn: dict[str, str] = {}
    told: set[str] = set()
    for name in wanted:
        try:
            # The index shows the first.
            drawing = draw(source, name, slug, not drawn, told)
        except Undrawn as why:
            undrawn |= (
                {name: str(why)} if name in source.figures and name != "claims" else {}
            )
            continue

        drawn.append(
            replace(
                drawing,
                title=paper.words(source).get(name, {}).get("title", drawing.title),
            )
        )

    return drawn, undrawn


def _data_files(
    source: Source, slug: str, frames: Mapping[str, pd.DataFrame]
) -> tuple[dict[str, str], dict[str, str]]:
    """Names of the CSV files of figures and tables, without folder, and the texts of
    all: equal data is in one file.

    What is longer than the list of points without a gait is in the archive alone, which
    reads faster.
    """
    units = {
        str(name): str(column.attrs.get("units", "1"))
        for name, column in source.grid.variables.items()
    }
    if source.along != "slope":
        units |= dict.fromkeys(_ALONG, source.units(source.along))
    short = {
        name: frame
        for name, frame in frames.items()
        if len(frame) <= html_tables.MAX_LISTED
    }
    texts = {
        name: folder.csv_text(frame, _UNITS | units) for name, frame in short.items()
    }
    first: dict[str, str] = {}
    csv = {
        name: first.setdefault(text, f"{slug}-{name}.csv")
        for name, text in texts.items()
    }
    return csv, {f"csv/{name}": text for text, name in first.items()}


def _commands(drawings: Sequence[Drawing]) -> set[str]:
    """Commands that points of figures have of their own."""
    asked = (
        row[2] for drawing in drawings for t in drawing.targets for row in t["rows"]
    )
    return {own for own in asked if isinstance(own, str)}


def _share_states(drawings: list[Drawing]) -> list[list[float]]:
    """Every state once that marks of some figures start from; the marks are left with
    their places.
    """
    places: dict[tuple[float, ...], int] = {}
    for target in (
        target
        for drawing in drawings
        for target in drawing.targets
        if "starts" in target
    ):
        target["starts"] = [
            places.setdefault(tuple(start), len(places)) for start in target["starts"]
        ]

    return [list(state) for state in places]


def _slugs(sources: list[Source]) -> list[str]:
    """A file name for each study, all different."""
    taken: list[str] = []
    for source in sources:
        slug, k = source.slug, 1
        while slug in taken or slug.lower() in _RESERVED:
            k += 1
            slug = f"{source.slug}-{k}"
        taken.append(slug)

    return taken


def _origin(source: Source) -> str:
    """Where the archive comes from, and the processor time of its run, in one line."""
    record, account = source.provenance, source.run.get("account")
    parts = [f"gaitsweep {record.get('packages', {}).get('gaitsweep', '')}".strip()]
    parts += [
        f"{word} {str(record[word.lower()])[:12]}"
        for word in ("commit", "Python")
        if record.get(word.lower())
    ]
    if isinstance(account, dict) and isinstance(account.get("workers_cpu"), float):
        jobs = source.run.get("jobs", "?")
        used = duration(float(f"{account['workers_cpu']:.2g}"))
        parts.append(f"{used} CPU, {jobs} worker{'' if jobs == 1 else 's'}")

    return ", ".join(parts)


def _software(source: Source) -> dict[str, Any]:
    """Provenance without the parts that the page shows elsewhere."""
    shown = ("study", "walkers", "varied", "ways")
    return {
        key: value
        for key, value in source.provenance.items()
        if key not in shown and value not in ("", [])
    }


def render_template(name: str, **content: Any) -> str:
    """Return a page of its own from a template, without a study."""
    return _environment().get_template(name).render(entries=[], **content)


@cache
def _environment() -> jinja2.Environment:
    """Templates that escape everything; a page runs no script but the report's own.

    Notes
    -----
    An archive may come from anyone. Text is escaped, the text of figures by matplotlib; data is JSON that cannot close
    its element; and the page's content security policy names the one script by its
    hash.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.policies["json.dumps_kwargs"] = {
        "ensure_ascii": False,
        "sort_keys": True,
        "separators": (",", ":"),
    }
    script = _script()
    environment.globals.update(
        style=_style(),
        script=script,
        digest=_digest(script),
        digest_of=_digest,
        opener=(_SCRIPTS / "bundle.js").read_text(encoding="utf-8"),
        paper=PAPER,
        tables=html_tables,
    )
    environment.filters.update(plain=plain, grouped=grouped)
    return environment


def _digest(script: str) -> str:
    """Hash of a script, by which a page's security policy names it."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def _style() -> str:
    """The style of all pages, with the sizes that figures are laid out for."""
    sizes = f"--narrow-words: {NARROW_WORDS}px; "
    sizes += f"--narrow-small-words: {NARROW_SMALL_WORDS}px;"
    text = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    return f":root {{ {sizes} }}\n{text}"


def _script() -> str:
    """The one script of a page, its modules in their order."""
    modules = [
        (_SCRIPTS / f"{name}.js").read_text(encoding="utf-8") for name in _MODULES
    ]
    text = minified("\n".join(modules))
    return f'"use strict";\n(() => {{\n{text}\n}})();'
