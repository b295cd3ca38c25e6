"""The record that a page carries for the index and the ledger, which are made from the pages in a folder."""

import json
import re
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Entry:
    """One page as the index and the ledger show it.

    `slug` names the page, `study` is the slug of its study; `statuses` are (name, count, share); `figures` are anchors
    on the page; `thumbnail` is its first figure, small; `claims` are rows of the ledger; `files` are the data files
    written with the page; `lines` are gaits that the index can show walking.
    """

    slug: str
    study: str
    name: str
    title: str
    about: str
    whole: str
    statuses: list[tuple[str, int, float]]
    figures: list[str]
    claims: list[dict[str, Any]]
    files: list[str]
    thumbnail: str
    lines: list[dict[str, Any]]

    @property
    def order(self) -> tuple[bool, bool, list[tuple[int, str]], str]:
        """Sort key in the index: pages with pictures first, numbered ones before others, figure 3 before figure 11."""
        parts = re.findall(r"\d+|\D+", self.name.lower())
        numbered = bool(parts) and parts[-1].isdigit()
        return not self.figures, not numbered, [(int(p), "") if p.isdigit() else (0, p) for p in parts], self.slug


class _Reader(HTMLParser):
    """Reads the text of the element called `entry`."""

    text, is_inside = "", False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.is_inside = ("id", "entry") in attrs

    def handle_endtag(self, tag: str) -> None:
        self.is_inside = False

    def handle_data(self, data: str) -> None:
        self.text += data * self.is_inside


def read(page: str) -> Entry | None:
    """Read the entry in the head of a page's text; None if there is none."""
    reader = _Reader()
    reader.feed(page.partition("</head>")[0])
    try:
        return Entry(**json.loads(reader.text))
    except (ValueError, TypeError, RecursionError):
        return None


def read_all(folder: Path) -> dict[str, Entry]:
    """Read the entries of the pages in a folder, by file name; files that are not pages of a report are left out."""
    pages = [path for path in folder.glob("*.html") if path.is_file()]
    entries = {path.name: read(path.read_text(encoding="utf-8", errors="replace")) for path in pages}
    return {name: entry for name, entry in entries.items() if entry is not None and name == f"{entry.slug}.html"}


def remove(folder: Path, entry: Entry, keep: set[str]) -> None:
    """Delete a page and its data files, except those in `keep`."""
    for name in {f"{entry.slug}.html", *entry.files} - keep:
        if re.fullmatch(re.escape(entry.slug) + r"(-[\w-]+\.csv|\.html)", name):
            (folder / name).unlink(missing_ok=True)
