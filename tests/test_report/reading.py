"""What the tests read in a page: its elements, links and the numbers of its tables."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import netCDF4
import numpy as np


class Page(HTMLParser):
    """Elements, links, identifiers and archived numbers of one page."""

    def __init__(self, path: Path):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.numbers: list[float] = []
        self.words: list[str] = []
        self._inside, self._hidden = 0, False
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        about = dict(attrs)
        self.elements.append((tag, about))
        if tag == "table" and "archive" in (about.get("class") or ""):
            self._inside += 1
        if tag == "data" and self._inside and about.get("class") != "count":
            self.numbers.append(float(about["value"] or "nan"))

        self._hidden = tag in ("script", "style")

    def handle_endtag(self, tag: str) -> None:
        self._hidden = False
        if tag == "table" and self._inside:
            self._inside -= 1

    def handle_data(self, data: str) -> None:
        if not self._hidden:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)

    def all(self, attribute: str) -> list[str]:
        return [
            about[attribute] or "" for _, about in self.elements if attribute in about
        ]


def numbers_in(path: Path) -> set[float]:
    """Every number in an archive, in any group, and in the walkers of its provenance."""
    found: set[float] = set()

    def gather(group: netCDF4.Dataset) -> None:
        for variable in group.variables.values():
            if variable.dtype != "S1":
                found.update(
                    np.ravel(np.ma.filled(variable[...], 0)).astype(float).tolist()
                )
        for inner in group.groups.values():
            gather(inner)

    with netCDF4.Dataset(path) as file:
        gather(file)
    return found
