"""Files on their way to a place: hidden beside it, under names that nobody else can have.

Every process has a secret of its own, kept in the locks it holds. Who gets a lock finds there the secret of the one
before, and so the drafts of a process that is gone, and no other file.
"""

from __future__ import annotations

import contextlib
import re
import secrets
from pathlib import Path

SECRET = secrets.token_hex(16)


def of(place: Path, secret: str = SECRET) -> Path:
    """The draft of the file at `place`."""
    return place.with_name(f".{place.name}.{secret}")


def discard(place: Path, secret: object = SECRET) -> None:
    """Remove the draft of the file at `place`, if there is one, and what SQLite keeps beside it."""
    if isinstance(secret, str) and re.fullmatch("[0-9a-f]{32}", secret):  # a lock may be damaged
        for suffix in ("", "-wal", "-shm"):
            draft = of(place, secret)
            with contextlib.suppress(OSError):
                draft.with_name(draft.name + suffix).unlink()
