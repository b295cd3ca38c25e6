"""The folder of a report: pages and their data, an index and a ledger of them, and what
each says of the others.
"""

import contextlib
import fcntl
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.report import entry, ledger, paper
from gaitsweep.pipeline.report.entry import Entry
from gaitsweep.pipeline.report.paper import PAPER
from gaitsweep.pipeline.report.words import spaced, with_unit

#: Text of a page, and its data files by their names.
Page = tuple[str, dict[str, str]]

#: How every page begins, whatever its title.
_PAGE = rb"(?s)<!doctype html>.*img-src data:; script-src 'sha256-"

#: Suffix of drafts, by which a report finds those of a killed one; random, so that no
#: other file has it.
_DRAFT = "0f880eeb4f27a9a9d8dbbd8e0c329cc6"

#: Size limit of all thumbnails on the index [byte].
_MAX_THUMBNAIL_BYTES = 200_000
#: Room that a page takes on the index without a picture [byte].
_CARD_BYTES = 150

#: Places of a page for what depends on other pages.
_PLACE = re.compile(r"(<!--(pages|around|finding)(?::([\w-]+))?-->).*?<!--/-->", re.S)

#: Pages that a page lists beside itself, and data of the ledger.
_MAX_LISTED, _LEDGER = 40, "csv/ledger.csv"


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Hold the folder while its pages are combined: of two reports into it, one waits
    for the other.

    Drafts there are left from a report that was killed, and are removed.
    """
    folder = os.open(out, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(folder, fcntl.LOCK_EX)
            for draft in [*out.glob(f".*.{_DRAFT}"), *out.glob(f"csv/.*.{_DRAFT}")]:
                draft.unlink()
        yield
    finally:
        os.close(folder)


def combine(
    environment: jinja2.Environment,
    out: Path,
    pages: dict[str, Page],
    only: bool = False,
    bundle: bool = False,
) -> None:
    """Write pages and their data, fill in what depends on others, and write the index
    and ledger of all pages there.
    """
    texts = {f"{slug}.html": text for slug, (text, _) in pages.items()}
    previous = entry.read_all(out)
    found = {name: record for name in texts for record in entry.read(texts[name])}
    if not only:
        found = {k: v for k, v in previous.items() if k not in texts} | found
    entries = sorted(found.values(), key=lambda record: record.order)
    report = _Report(environment, entries)

    _check_own(out, pages, {name for own in previous.values() for name in own.files})
    for _, files in pages.values():
        for name, text in files.items():
            _publish(out / name, text)
    _write_pages(out, report, texts)
    _remove_others(out, report, previous)

    _write_ledger(out, report)
    _publish(out / "index.html", report.page("index"))
    if bundle or (out / "bundle.html").exists():
        _write_bundle(out, report)


def _write_pages(out: Path, report: "_Report", new: Mapping[str, str]) -> None:
    """Write the pages of a report, of which some are new, with what each says of the
    others.
    """
    for record in report.shown:
        name = f"{record.slug}.html"
        text = new.get(name)
        if text is None:
            text = (out / name).read_text(encoding="utf-8")
        _publish(out / name, report.filled(text, record))


def _remove_others(out: Path, report: "_Report", previous: Mapping[str, Entry]) -> None:
    """Remove pages and data of an earlier report that this one lacks."""
    wanted = {f"{record.slug}.html" for record in report.shown}
    wanted.update(*(record.files for record in report.entries))
    for record in previous.values():
        entry.remove(out, record, wanted)


def _write_ledger(out: Path, report: "_Report") -> None:
    """Write the ledger and its data, or remove them where no page has claims."""
    if report.claims:
        _publish(out / "ledger.html", report.page("ledger"))
        _publish(out / _LEDGER, csv_text(ledger.table(report.ledger)))
        return
    for name in ("ledger.html", _LEDGER):
        (out / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # no folder of data, or other files there
        (out / "csv").rmdir()


def _write_bundle(out: Path, report: "_Report") -> None:
    """Write all pages as one file."""
    names = ["index"]
    if report.claims:
        names.append("ledger")
    names += [record.slug for record in report.shown]
    texts = {}
    for name in names:
        text = (out / f"{name}.html").read_text(encoding="utf-8")
        texts[name] = _bundled(text, names)

    template = report.environment.get_template("bundle.html")
    _publish(out / "bundle.html", template.render(texts=texts))


def _bundled(text: str, names: list[str]) -> str:
    """A page as a bundle holds it: without what all share and its record, its links to
    others as the bundle's.
    """
    text = re.sub(r"<style>.*?</style>", "<style></style>", text, count=1, flags=re.S)
    for left in (
        r'<meta http-equiv="Content-Security-Policy"[^>]*>',
        r'<script type="application/json" id="entry">.*?</script>',
    ):
        text = re.sub(left, "", text, count=1, flags=re.S)

    text = text[: text.rindex("<script>")] + "<script></script>\n</body>\n</html>"

    return re.sub(
        r'href="([\w-]+)\.html(#|")',
        lambda m: f'href="?{m[1]}{m[2]}' if m[1] in names else m[0],
        text,
    )


class _Report:
    """All pages of a folder, and what each of them says of the others."""

    def __init__(self, environment: jinja2.Environment, entries: list[Entry]) -> None:
        self.environment, self.entries = environment, entries
        self.shown = [record for record in entries if not record.text]
        self.places = {record.slug: k for k, record in enumerate(self.shown)}
        self.claims = {
            str(row["id"]): row for record in entries for row in record.claims
        }
        self.figures = ledger.figures(entries)
        self.ledger = ledger.families(entries, self.figures)
        self.parts: Any = environment.get_template("parts.html").module

    def page(self, name: str) -> str:
        """The index or the ledger."""
        lines = next((record.lines for record in self.shown if record.lines), [])
        text = self.environment.get_template(f"{name}.html").render(
            sections=self.sections(self.shown),
            ledger=self.ledger,
            tally=ledger.tally(self.ledger),
            signs=ledger.sign,
            absent=PAPER["absent"]
            if any(record.section for record in self.shown)
            else {},
            behind=[record for record in self.entries if record.text],
            entries=[
                vars(record)
                for record in self.entries
                if record.text and name == "ledger"
            ],
            findings=self._findings(),
            held={record.slug: self._held(record) for record in self.shown},
            thumbnails=_thumbnails(self.shown),
            lines=lines,
        )
        return self.filled(text, None)

    def _findings(self) -> dict[str, str]:
        """What the figures of all pages find, by page and figure."""
        return {
            f"{record.slug}#{figure['name']}": self._finding(record, figure)
            for record in self.shown
            for figure in record.figures
        }

    def _finding(self, record: Entry, figure: dict[str, Any]) -> str:
        """What a figure finds: of the paper's with the values of claims."""
        study = record.name if record.section else ""
        said = paper.finding(study, figure["name"], self.claims)
        return str(said or figure["finding"])

    def sections(self, shown: list[Entry]) -> dict[str, list[Entry]]:
        """Some pages by section of the index: those of the paper, then all others."""
        titles = PAPER["sections"] | {
            "": "Other studies" if any(r.section for r in self.shown) else "Studies"
        }
        groups = {
            title: [r for r in shown if r.section == name]
            for name, title in titles.items()
        }
        return {title: members for title, members in groups.items() if members}

    def _held(self, record: Entry) -> dict[str, int]:
        """Number of claims that a page's figures show, by verdict, the best first."""
        ids = dict.fromkeys(
            id
            for figure in record.figures
            for id in self.figures[record.slug, figure["name"]]
        )
        rows = ledger.tally(self.ledger)
        counts = {
            verdict: sum(row["id"] in ids for row in members)
            for verdict, members in rows.items()
        }
        return {verdict: count for verdict, count in counts.items() if count}

    def filled(self, text: str, record: Entry | None) -> str:
        """A page with its places for what depends on other pages filled in."""
        return _PLACE.sub(
            lambda place: (
                f"{place[1]}{self._part(place[2], place[3] or '', record)}<!--/-->"
            ),
            text,
        )

    def _part(self, kind: str, name: str, record: Entry | None) -> str:
        if kind == "pages":
            return str(self.parts.pages(self._near(record), record, bool(self.claims)))
        if record is None:
            return ""
        if kind == "around":
            k = self.places[record.slug]
            around = [
                self.shown[i] if 0 <= i < len(self.shown) else None
                for i in (k - 1, k + 1)
            ]
            return str(self.parts.around(*around))

        figure = next(
            (figure for figure in record.figures if figure["name"] == name), None
        )
        if figure is None:
            return ""

        rows = [self.claims[id] for id in self.figures[record.slug, name]]
        verdicts = [
            (
                row["id"],
                spaced(row.get("verdict", "")),
                ledger.sign(row.get("verdict", "")),
            )
            for row in rows
        ]
        return str(self.parts.finding(self._finding(record, figure), verdicts))

    def _near(self, record: Entry | None) -> dict[str, list[Entry]]:
        """Pages that a page lists beside itself: all, or of many those around it."""
        first = max(0, (self.places[record.slug] if record else 0) - _MAX_LISTED // 2)
        return self.sections(self.shown[first : first + _MAX_LISTED])


def _check_own(out: Path, pages: dict[str, Page], listed: set[str]) -> None:
    """Refuse to write over what no report has made: pages are known by their beginning,
    data by a page or heading.
    """
    for name in (*pages, "index", "ledger", "bundle"):
        paths.check_own(out / f"{name}.html", _PAGE)
    if (out / "csv").is_symlink() or not (out / "csv").is_dir():
        paths.check_own(out / "csv", rb"(?!)")
    if not (out / "ledger.html").exists():
        paths.check_own(out / _LEDGER, rb"(?!)")
    for _, files in pages.values():
        for name in files.keys() - listed:
            paths.check_own(
                out / name, re.escape(files[name].partition("\n")[0].encode())
            )


def _thumbnails(entries: list[Entry]) -> dict[str, str]:
    """The first figures of the studies, the smallest first, up to the size limit of the
    index.
    """
    room, thumbnails = _MAX_THUMBNAIL_BYTES - _CARD_BYTES * len(entries), {}
    for record in sorted(
        (record for record in entries if record.thumbnail),
        key=lambda record: len(record.thumbnail),
    ):
        room -= len(record.thumbnail)
        if room > 0:
            thumbnails[record.slug] = record.thumbnail

    return thumbnails


def csv_text(frame: pd.DataFrame, units: Mapping[str, str] | None = None) -> str:
    """A frame as CSV, with units in its head."""
    units = {
        **(units or {}),
        **{name: unit for name, unit in frame.attrs.get("units", {}).items() if unit},
    }
    heads = [
        with_unit(str(c), unit if (unit := units.get(str(c), "1")) != "1" else "")
        for c in frame.columns
    ]
    words = frame.columns[
        [column.dtype.kind not in "iuf" for _, column in frame.items()]
    ]
    texts = {
        name: frame[name].astype(object).map(_word, na_action="ignore")
        for name in words
    }

    return frame.assign(**texts).to_csv(
        index=False, header=[*map(_word, heads)], lineterminator="\n"
    )


def _word(word: Any) -> str:
    """A word in a CSV file: one that a spreadsheet would evaluate as a formula is told
    to be text.
    """
    is_formula = str(word)[:1] in ("=", "+", "-", "@", "\t", "\r")
    text = f"'{word}" if is_formula else str(word)
    return text.replace("\r", "\n")  # which alone is quoted


def _publish(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    paths.publish(path, text.encode(), _DRAFT)
