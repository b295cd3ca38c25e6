"""Files that are this program's own, drafts of files, and how these are replaced."""

import contextlib
import os
import re
import secrets
import stat
from pathlib import Path

from gaitsweep.pipeline.errors import ArchiveError, unwritten

_HEAD = 1024  # read of a file to recognise it [byte]
_TAIL = 4096  # and of its end, if it is recognised by that
#: What is no regular file, by the letter with which `ls -l` shows it.
_KINDS = {
    "d": "a directory",
    "l": "a link",
    "p": "a named pipe",
    "s": "a socket",
    "c": "a device",
    "b": "a device",
}


def check_own(path: Path, beginning: bytes, mark: bytes = b"") -> None:
    """Check that where this program is to write nothing stands, or a file of its own.

    Parameters
    ----------
    path : Path
    beginning : bytes
        Pattern of the beginning of its content. An empty file, or zeros that a power
        failure left, are nobody's.
    mark : bytes
        What its content has near its beginning or its end.

    Raises
    ------
    ArchiveError
        If something else stands there.
    """
    with contextlib.suppress(FileNotFoundError):
        if kind := kind_of(path.lstat().st_mode):
            raise ArchiveError(
                f"{path} is {kind}, not a file of gaitsweep; move it away."
            )

        with open(path, "rb") as file:
            head = file.read(_HEAD).strip(b"\0")
            file.seek(max(0, path.lstat().st_size - _TAIL))
            has_mark = mark in head or mark in file.read(_TAIL)

        if head and not (has_mark and re.match(beginning, head)):
            raise ArchiveError(f"{path} is not a file of gaitsweep; move it away.")


def check_page(path: Path, command: str) -> None:
    """Check that where a command is to write its page nothing stands, or a page of it.

    Raises
    ------
    ArchiveError
        If something else stands there.
    """
    made = f'<meta name="generator" content="gaitsweep {command}">'
    check_own(path, b"(?s)<!doctype html>.*" + re.escape(made.encode()))


def publish_page(path: Path, command: str, text: str) -> None:
    """Write the page of a command, over nothing but an earlier page of it.

    Raises
    ------
    ArchiveError
        If something else stands there, or it cannot be written.
    """
    check_page(path, command)
    publish_for_user(path, text.encode())


def publish_for_user(path: Path, data: bytes) -> None:
    """Write a file that a user has named, where that was checked.

    Raises
    ------
    ArchiveError
        If it cannot be written.
    """
    try:
        publish(path, data)
    except OSError as error:
        raise unwritten(path, error) from error


def kind_of(mode: int) -> str:
    """What something is that is no regular file, by its mode; empty for one."""
    return _KINDS.get(stat.filemode(mode)[0], "")


SECRET = secrets.token_hex(16)


def of(file: Path, secret: str = SECRET) -> Path:
    """Path of the draft of a file."""
    return file.with_name(f".{file.name}.{secret}")


def publish(file: Path, data: bytes, secret: str = SECRET) -> None:
    """Replace a file at once: a reader sees the old content or the new. Errors name the
    file, not its draft.
    """
    draft = of(file, secret)
    try:
        draft.write_bytes(data)
        os.replace(draft, file)
    except OSError as error:
        error.filename = str(file)
        raise
    finally:
        discard(file, secret)


def discard(file: Path, secret: object = SECRET) -> None:
    """Remove the draft of a file, if there is one, and the files of SQLite beside it."""
    if isinstance(secret, str) and re.fullmatch(
        "[0-9a-f]{32}", secret
    ):  # a damaged lock may hold anything
        for suffix in ("", "-wal", "-shm"):
            draft = of(file, secret)
            with contextlib.suppress(OSError):
                draft.with_name(draft.name + suffix).unlink()
