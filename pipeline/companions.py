"""Files that runs keep beside an archive: journal, lock, event log and the record of the
last run, in a folder of their own.
"""

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path

from gaitsweep.pipeline import paths
from gaitsweep.pipeline.errors import ArchiveError

#: Name of their folder, beside the archives.
FOLDER = ".gaitsweep"
#: Where archives are written that are given no other place.
ARCHIVES = Path("data", "archive")
_README = """\
Runs of gaitsweep keep here what they go on from: journals of results, locks, event logs and records of runs.
The folder may be deleted when no run is in flight; studies that are run again are then computed anew.
"""
#: How the names of these files end, and how the content of each begins; a journal is
#: looked at page by page.
_BEGINNINGS = {
    ".lock": rb'{"pid": \d+, "host": "',
    ".events.jsonl": rb'{"time": \d+[.\d]*, "event": "',
    ".run.json": rb'{\s*"study": "[^\n]*",\s*"archive": "',
    ".journal": b"",
}


def default_archive(name: str) -> Path:
    """Path of the archive of a study that is given no other one."""
    return ARCHIVES / f"{name}.nc"


@dataclass(frozen=True)
class Companions:
    """The companions of an archive, whether they are there or not."""

    archive: Path

    @property
    def folder(self) -> Path:
        """The folder of the companions of all archives beside this one."""
        return self.archive.parent / FOLDER

    @property
    def journal(self) -> Path:
        """The journal, whose results a run resumes from."""
        return self._named(".journal")

    @property
    def lock(self) -> Path:
        """The lock, which a run holds."""
        return self._named(".lock")

    @property
    def events(self) -> Path:
        """The event log, which `status` reads."""
        return self._named(".events.jsonl")

    @property
    def record(self) -> Path:
        """The record of the last run."""
        return self._named(".run.json")

    def _named(self, suffix: str) -> Path:
        return self.folder / (self.archive.name.removesuffix(".nc") + suffix)

    def check(self) -> None:
        """Check that those that are there are this program's.

        Raises
        ------
        ArchiveError
            If something else stands in the place of one, or of their folder.
        """
        with contextlib.suppress(FileNotFoundError):
            mode = self.folder.lstat().st_mode
            if not os.path.isdir(self.folder) or self.folder.is_symlink():
                kind = paths.kind_of(mode) or "a file"
                raise ArchiveError(
                    f"{self.folder} is {kind}, not a folder of gaitsweep; move it away."
                )

        for suffix, beginning in _BEGINNINGS.items():
            paths.check_own(self._named(suffix), beginning)

    def make_folder(self) -> None:
        """Make their folder, with a file in it that says what it is."""
        self.folder.mkdir(exist_ok=True)
        readme = self.folder / "README"
        if not os.path.lexists(readme):
            paths.publish(readme, _README.encode())


def found_in(folder: Path) -> list[Companions]:
    """Companions of the archives in a folder of which any is there, in the order of
    their names.
    """
    names = {
        file.name.removesuffix(suffix)
        for suffix in _BEGINNINGS
        for file in (folder / FOLDER).glob(f"*{suffix}")
    }
    return [Companions(folder / f"{name}.nc") for name in sorted(names)]
