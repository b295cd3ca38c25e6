"""The record that a page carries for the index and the ledger, which are made from the
pages in a folder.
"""

import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Entry:
    """One page as the index and the ledger show it.

    `slug` names the page, `study` is the slug of its study; `section` and `place` are
    those of a study of the paper in the index; `statuses` are (name, count, share);
    `figures` have name, title, finding and the claims that they show besides those that
    name them; `thumbnail` is the first figure, small; `claims` are rows of the ledger;
    `files` are the data files written with the page; `lines` are gaits that the index
    can show walking. A study that only feeds the ledger has no page but its `text`
    there.
    """

    slug: str
    study: str
    name: str
    title: str
    about: str
    whole: str
    section: str
    place: int
    statuses: list[tuple[str, int, float]]
    figures: list[dict[str, Any]]
    claims: list[dict[str, Any]]
    files: list[str]
    thumbnail: str
    lines: list[dict[str, Any]]
    text: str

    @property
    def short(self) -> str:
        """A title for links: that of a figure or a section of the paper without what it
        shows.
        """
        return self.title.partition(". ")[0] if self.section else self.title

    @property
    def order(self) -> tuple[int, bool, bool, list[tuple[int, str]], str]:
        """Sort key in the index: the paper's studies in their order, then pages with
        pictures, then numbered ones.
        """
        parts = re.findall(r"\d+|\D+", self.name.lower())
        numbered = bool(parts) and parts[-1].isdigit()
        numbers = [(int(p), "") if p.isdigit() else (0, p) for p in parts]
        return self.place, not self.figures, not numbered, numbers, self.slug


class _Reader(HTMLParser):
    """Reads the text of the element called `entry`."""

    text, is_inside = "", False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.is_inside = ("id", "entry") in attrs

    def handle_endtag(self, tag: str) -> None:
        self.is_inside = False

    def handle_data(self, data: str) -> None:
        self.text += data * self.is_inside


def read(page: str) -> list[Entry]:
    """Read the entries in the head of a page's text: its own, or those of studies that
    only feed the ledger.
    """
    reader = _Reader()
    reader.feed(page.partition("</head>")[0])
    try:
        return [Entry(**record) for record in json.loads(reader.text)]
    except (ValueError, TypeError, RecursionError):
        return []


def read_all(folder: Path) -> dict[str, Entry]:
    """Read the entries of the pages in a folder, by file name; files that are not pages
    of a report are left out.
    """
    found = {}
    for path in sorted(path for path in folder.glob("*.html") if path.is_file()):
        for entry in read(path.read_text(encoding="utf-8", errors="replace")):
            if path.name == ("ledger.html" if entry.text else f"{entry.slug}.html"):
                found[f"{entry.slug}.html"] = entry
    return found


def remove(folder: Path, entry: Entry, keep: set[str]) -> None:
    """Delete a page and its data files, except those in `keep`."""
    for name in {f"{entry.slug}.html", *entry.files} - keep:
        if re.fullmatch(rf"(csv/)?{re.escape(entry.slug)}(-[\w-]+\.csv|\.html)", name):
            (folder / name).unlink(missing_ok=True)
