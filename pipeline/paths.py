"""What lies beside an archive: its journal, lock and records, and the drafts it is written in."""

from __future__ import annotations

import contextlib
import re
import secrets
from pathlib import Path


def sidecar_path(path: Path, what: str) -> Path:
    """A companion of an archive: its journal, event log, lock or record."""
    return path.with_name(path.name.removesuffix(".nc") + what)


SECRET = secrets.token_hex(16)


def of(file: Path, secret: str = SECRET) -> Path:
    """The draft of the file at `place`."""
    return file.with_name(f".{file.name}.{secret}")


def discard(file: Path, secret: object = SECRET) -> None:
    """Remove the draft of the file at `place`, if there is one, and what SQLite keeps beside it."""
    if isinstance(secret, str) and re.fullmatch("[0-9a-f]{32}", secret):  # a lock may be damaged
        for suffix in ("", "-wal", "-shm"):
            draft = of(file, secret)
            with contextlib.suppress(OSError):
                draft.with_name(draft.name + suffix).unlink()
