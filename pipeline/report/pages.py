"""From archives to pages: an index, a page for each study, the ledger of claims, and the data of every figure."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from pipeline.archive.citation import PAPER
from pipeline.report import entry, html_tables, results
from pipeline.report.figures import FIGURES, draw
from pipeline.report.figures.cycle import animation
from pipeline.report.figures.style import plain
from pipeline.report.figures.svg import Drawing
from pipeline.report.source import Source, read

_TEMPLATES = Path(__file__).parent / "templates"

#: Names of pages that are not a study's.
_RESERVED = ("index", "ledger")

#: What a page tells of the run; its record also names the machine, which is nobody's business.
_RUN = ("began", "seconds", "jobs", "cluster", "version", "points", "failed", "exit_code")

#: Points without a gait that are listed beside a page; the archive has all.
_MAX_ABSENT = 20_000

#: Bytes the index gives to small pictures of its studies.
_THUMBNAILS = 235_000


@dataclass(frozen=True)
class Page:
    """One study as its page shows it."""

    slug: str
    source: Source
    drawings: list[Drawing]
    undrawn: list[str]
    moves: list[dict[str, Any]]
    statuses: list[tuple[str, int, float]]
    absent: pd.DataFrame

    @cached_property
    def files(self) -> dict[str, str]:
        """Data beside the page, by file name."""
        found = {f"{self.slug}-{drawing.name}.csv": _csv(drawing.data) for drawing in self.drawings}
        absent = {f"{self.slug}-absent.csv": _csv(self.absent.head(_MAX_ABSENT))} if len(self.absent) else {}
        return found | absent

    @property
    def entry(self) -> dict[str, Any]:
        """What the page carries of itself for the index and the ledger; its first picture is read off the page."""
        source, first = self.source, self.drawings[0] if self.drawings else None
        return {
            "slug": self.slug,
            "study": source.slug,
            "name": source.name,
            "title": source.title,
            "about": source.about,
            "whole": source.whole,
            "statuses": self.statuses,
            "figures": [drawing.name for drawing in self.drawings],
            "claims": html_tables.claims(source),
            "files": list(self.files),
            "thumbnail": first.small if first and first.small != first.svg else "",
        }


def write(archives: Iterable[Path], out: Path, only: bool = False) -> Path:
    """Write the report of some archives into a folder: their pages, and the index and ledger of all pages in it.

    Parameters
    ----------
    archives : iterable of Path
        Archives as `gaitsweep run` leaves them; nothing else is read but the `NAME.run.json` beside each.
    out : Path
        Folder of the pages, made if missing. A page and the data of its figures are named after the study; the same
        study again takes its place.
    only : bool
        Take other pages that a report has left there away.

    Returns
    -------
    Path
        The index.

    Raises
    ------
    ArchiveError
        If a file is not one of gaitsweep's archives.
    OSError
        If the folder cannot be written.
    """
    sources = [read(Path(archive)) for archive in archives]
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    environment = _environment()
    pages = [_page(source, slug) for source, slug in zip(sources, _slugs(sources), strict=True)]
    texts = {f"{page.slug}.html": _study(environment, page) for page in pages}
    before, now = entry.standing(out), {name: entry.read(text) for name, text in texts.items()}
    keep = {name: found for name, found in before.items() if name not in texts and not only} | now
    entries = sorted((found for found in keep.values() if found), key=lambda found: found.order)
    for page in pages:
        for name, text in page.files.items():
            _publish(out / name, text)
        _publish(out / f"{page.slug}.html", texts[f"{page.slug}.html"])
    wanted = {*keep, *(name for found in entries for name in found.files)}
    for found in before.values():
        entry.remove(out, found, wanted)
    ledger = html_tables.ledger(entries)
    common = {"entries": entries, "ledger": ledger, "tally": _tally(ledger)}
    _publish(out / "ledger.html", environment.get_template("ledger.html").render(**common))
    moves = next((found.moves for found in entries if found.moves), [])
    index = environment.get_template("index.html")
    _publish(out / "index.html", index.render(**common, thumbnails=_thumbnails(entries), moves=moves))
    return out / "index.html"


def _study(environment: jinja2.Environment, page: Page) -> str:
    """The page of one study; nothing in it depends on others."""
    return environment.get_template("study.html").render(
        page=page,
        fits=html_tables.fits(page.source),
        special=html_tables.special_points(page.source),
        results=results.tables(page.source),
        outcomes=html_tables.outcomes(page.source, page.absent),
        failures=html_tables.failures(page.absent),
        failed_tasks=html_tables.failed_tasks(page.source),
        walkers=html_tables.walkers(page.source),
        run=html_tables.pairs({k: v for k, v in page.source.run.items() if k in _RUN}),
        provenance=html_tables.pairs(_rest(page.source)),
    )


def _page(source: Source, slug: str) -> Page:
    wanted = list(dict.fromkeys(source.figures))
    if "fits/scaling" in source.tables and "residuals" not in wanted:
        wanted.append("residuals")
    drawn = {name: draw(source, name, slug) for name in wanted}
    drawings = [drawing for drawing in drawn.values() if drawing is not None]
    undrawn = [name for name in source.figures if drawn[name] is None]
    return Page(
        slug, source, drawings, undrawn, animation(source), html_tables.statuses(source), html_tables.points(source)
    )


def _slugs(sources: list[Source]) -> list[str]:
    """A file name for each study, no two alike."""
    taken: list[str] = []
    for source in sources:
        slug, k = source.slug, 1
        while slug in taken or slug.lower() in _RESERVED:
            k += 1
            slug = f"{source.slug}-{k}"
        taken.append(slug)
    return taken


def _rest(source: Source) -> dict[str, Any]:
    """Provenance without what the page shows elsewhere."""
    return {key: value for key, value in source.provenance.items() if key not in ("study", "walkers", "varied")}


def _tally(ledger: list[html_tables.Family]) -> dict[str, int]:
    signs = [verdict.sign for family in ledger for verdict in family.verdicts]
    return {sign: signs.count(sign) for sign in ("yes", "no", "open")} if signs else {}


def _thumbnails(entries: list[entry.Entry]) -> dict[str, str]:
    """The first figure of each study, the smallest first, while the index has room for it."""
    room, found = _THUMBNAILS, {}
    for one in sorted((one for one in entries if one.thumbnail), key=lambda one: len(one.thumbnail)):
        room -= len(one.thumbnail)
        if room > 0:
            found[one.slug] = one.thumbnail
    return found


def _environment() -> jinja2.Environment:
    """Templates that escape everything, and a page that runs no script but ours.

    Notes
    -----
    An archive may come from anyone. Text is escaped, figures' text passes matplotlib's own escaping, data travels as
    JSON that cannot close its element, and the page's content policy names our one script by its hash.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    script = (_TEMPLATES / "report.js").read_text(encoding="utf-8").strip()
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment.globals.update(
        style=(_TEMPLATES / "report.css").read_text(encoding="utf-8"),
        script=script,
        digest=digest,
        known=list(FIGURES),
        paper=PAPER,
    )
    environment.filters.update(plain=plain, grouped=lambda n: f"{n:,}".replace(",", "\u202f"))
    return environment


def _csv(frame: pd.DataFrame) -> str:
    """Tidy text; words that a spreadsheet would run as a formula are quoted."""
    words = frame.select_dtypes(exclude="number")
    safe = frame.assign(**{c: [f"'{v}" if str(v)[:1] in ("=", "+", "-", "@") else v for v in words[c]] for c in words})
    return safe.to_csv(index=False, lineterminator="\n")


def _publish(path: Path, text: str) -> None:
    """Write a file whole: a reader sees the old one or the new one."""
    beside = path.with_name(f"{path.name}.tmp.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
