"""`gaitsweep clean`: removes journals that no run needs any more."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaitsweep.pipeline.archive import read
from gaitsweep.pipeline.cli import kinds, studies
from gaitsweep.pipeline.cli.errors import gravest, say
from gaitsweep.pipeline.companions import Companions
from gaitsweep.pipeline.engine.locks import lock_archive
from gaitsweep.pipeline.engine.progress import last_state
from gaitsweep.pipeline.errors import BusyError, GaitsweepError, unwritten
from gaitsweep.pipeline.store.file import forget


@dataclass(frozen=True)
class _Cleaned:
    """What became of the journal of an archive: the bytes that it had, or why it stays."""

    archive: Path
    freed: int = 0
    kept: str = ""


def run(options: argparse.Namespace) -> int:
    """Remove the journals of finished studies, and name those that stay; returns the
    gravest exit code.
    """
    archives, codes = studies.archives(options.names, options.debug)
    with_journal = [path for path in archives if Companions(path).journal.exists()]
    complete = {*read.complete(with_journal)}

    cleaned = []
    for path in with_journal:
        try:
            cleaned.append(_clean(path, path in complete))
        except OSError as error:
            codes.append(say(unwritten(path, error), options.debug))
        except GaitsweepError as error:
            codes.append(say(error, options.debug))

    if cleaned or not codes:
        kinds.show(options, [_record(each) for each in cleaned], _lines(cleaned))
    return gravest(codes)


def _clean(archive: Path, is_complete: bool) -> _Cleaned:
    """Remove the journal of an archive, unless a run holds it or would go on with it.

    The last run must have come to its end after the last change of the study, and the
    archive must hold what the journal does.
    """
    companions = Companions(archive)
    companions.check()
    try:
        with lock_archive(archive):
            last = last_state(companions.events)
            if not (last and last["over"]):
                return _Cleaned(archive, kept="its study is not finished")
            if not is_complete:
                return _Cleaned(archive, kept="its archive is missing or not complete")
            return _Cleaned(archive, forget(companions.journal))
    except BusyError as error:
        return _Cleaned(archive, kept=str(error).rstrip("."))


def _record(cleaned: _Cleaned) -> dict[str, Any]:
    """For machines: `archive`, the bytes `freed`, and why the journal was `kept`."""
    return {
        "archive": str(cleaned.archive),
        "freed": cleaned.freed,
        "kept": cleaned.kept or None,
    }


def _lines(every: list[_Cleaned]) -> Iterator[str]:
    """Say what was removed, what stays and why, and how much was freed."""
    kept = [cleaned for cleaned in every if cleaned.kept]
    freed = sum(cleaned.freed for cleaned in every)
    for cleaned in every:
        if cleaned.kept:
            yield f"{cleaned.archive}: journal kept: {cleaned.kept}."
        else:
            yield f"{cleaned.archive}: journal removed, {_size(cleaned.freed)}."

    removed = len(every) - len(kept)
    total = f"{removed:,} removed, {_size(freed)} freed" if removed else "none removed"
    rest = f"; {len(kept):,} kept" if kept else ""
    yield f"Journals: {total}{rest}."


def _size(size: int) -> str:
    """A size in words."""
    return f"{size / 1e6:,.1f} MB" if size >= 1e5 else f"{size / 1e3:,.1f} kB"
