"""From archives to pages: an index, a page for each study, the ledger of claims, and the data of every figure."""

from __future__ import annotations

import base64
import hashlib
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from pipeline.paper import PAPER
from pipeline.report import results, tables
from pipeline.report.figures import FIGURES, draw
from pipeline.report.figures.motion import animation
from pipeline.report.figures.style import plain
from pipeline.report.figures.svg import Drawing
from pipeline.report.source import Source, read

_TEMPLATES = Path(__file__).parent / "templates"

#: Names of pages that are not a study's.
_RESERVED = ("index", "ledger")

#: What a page tells of the run; its record also names the machine, which is nobody's business.
_RUN = ("began", "seconds", "jobs", "cluster", "version", "points", "failed", "exit_code")

#: Points without a gait that are listed beside a page; the archive has all.
_MOST_ABSENT = 20_000

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

    @property
    def title(self) -> str:
        return self.source.title

    @property
    def order(self) -> tuple[bool, bool, list[tuple[int, str]]]:
        """Place in the index: pages with pictures first, numbered ones before others, figure 3 before figure 11."""
        parts = re.findall(r"\d+|\D+", self.source.name.lower())
        return not self.drawings, not parts[-1].isdigit(), [(int(p), "") if p.isdigit() else (0, p) for p in parts]


def write(archives: Iterable[Path], out: Path) -> Path:
    """Write the report of some archives into a folder.

    Parameters
    ----------
    archives : iterable of Path
        Archives as `gaitsweep run` leaves them; nothing else is read but the `NAME.run.json` beside each.
    out : Path
        Folder of the pages, made if missing. A page and the data of its figures are named after the study.

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
    pages = [_page(source, slug) for source, slug in zip(sources, _slugs(sources), strict=True)]
    pages.sort(key=lambda page: page.order)
    shown = {page.slug: f"{page.slug}.html" for page in pages}
    shown |= {f"{p.source.slug}/{d.name}": f"{p.slug}.html#{d.name}" for p in pages for d in p.drawings}
    ledger = tables.ledger(sources, shown)
    environment = _environment()
    common = {"pages": pages, "ledger": ledger, "tally": _tally(ledger)}
    for page in pages:
        for drawing in page.drawings:
            _publish(out / f"{page.slug}-{drawing.name}.csv", _csv(drawing.data))
        if len(page.absent):
            _publish(out / f"{page.slug}-absent.csv", _csv(page.absent.head(_MOST_ABSENT)))
        _publish(
            out / f"{page.slug}.html",
            environment.get_template("study.html").render(
                **common,
                page=page,
                fits=tables.fits(page.source),
                special=tables.special_points(page.source),
                results=results.tables(page.source),
                outcomes=tables.outcomes(page.source, page.absent),
                failures=tables.failures(page.absent),
                failed_tasks=tables.failed_tasks(page.source),
                walkers=tables.walkers(page.source),
                run=tables.pairs({k: v for k, v in page.source.run.items() if k in _RUN}),
                provenance=tables.pairs(_rest(page.source)),
            ),
        )
    _publish(out / "ledger.html", environment.get_template("ledger.html").render(**common))
    _publish(
        out / "index.html",
        environment.get_template("index.html").render(
            **common, thumbnails=_thumbnails(pages), moves=next((p.moves[:2] for p in pages if p.moves), [])
        ),
    )
    return out / "index.html"


def _page(source: Source, slug: str) -> Page:
    wanted = list(dict.fromkeys(source.figures))
    if "fits/scaling" in source.tables and "residuals" not in wanted:
        wanted.append("residuals")
    drawn = {name: draw(source, name, slug) for name in wanted}
    drawings = [drawing for drawing in drawn.values() if drawing is not None]
    undrawn = [name for name in source.figures if drawn[name] is None]
    return Page(slug, source, drawings, undrawn, animation(source), tables.statuses(source), tables.points(source))


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


def _tally(ledger: list[tables.Family]) -> dict[str, int]:
    signs = [verdict.sign for family in ledger for verdict in family.verdicts]
    return {sign: signs.count(sign) for sign in ("yes", "no", "open")} if signs else {}


def _thumbnails(pages: list[Page]) -> dict[str, Drawing]:
    """The first figure of each study, the smallest first, while the index has room for it."""
    room, found = _THUMBNAILS, {}
    firsts = [(page.slug, drawing) for page in pages for drawing in page.drawings[:1]]
    for slug, drawing in sorted(firsts, key=lambda first: len(first[1].small)):
        room -= len(drawing.small)
        if room > 0:
            found[slug] = drawing
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
        style=(_TEMPLATES / "report.css").read_text(encoding="utf-8"), script=script, digest=digest,
        known=list(FIGURES), paper=PAPER,
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
