"""Files beside an archive: journal, lock, records, and drafts of each."""

from __future__ import annotations

import contextlib
import re
import secrets
from pathlib import Path


def sidecar_path(path: Path, suffix: str) -> Path:
    """Path of the journal, event log, lock or record of an archive."""
    return path.with_name(path.name.removesuffix(".nc") + suffix)


SECRET = secrets.token_hex(16)


def of(file: Path, secret: str = SECRET) -> Path:
    """Path of the draft of a file."""
    return file.with_name(f".{file.name}.{secret}")


def discard(file: Path, secret: object = SECRET) -> None:
    """Remove the draft of a file, if there is one, and the files of SQLite beside it."""
    if isinstance(secret, str) and re.fullmatch("[0-9a-f]{32}", secret):  # a damaged lock may hold anything
        for suffix in ("", "-wal", "-shm"):
            draft = of(file, secret)
            with contextlib.suppress(OSError):
                draft.with_name(draft.name + suffix).unlink()
