"""Figures of a reader's own on a page of an archive: a title, a picture and a caption."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib

from gaitsweep.pipeline.errors import StudyError

#: Resolution of a picture that is smaller in dots than in lines [dots an inch].
_DPI = 150
#: What a file of each format would say of when it was made.
_UNDATED = {"svg": {"Date": None}, "png": {}}
_TYPES = {"svg": "image/svg+xml", "png": "image/png"}


@dataclass(frozen=True)
class Picture:
    """A figure as the page shows it.

    Attributes
    ----------
    name : str
        Its anchor on the page.
    title, caption : str
    address : str
        The picture itself, as a data URL.
    """

    name: str
    title: str
    caption: str
    address: str


def pictures(extra: Sequence[tuple[str, Any, str]]) -> list[Picture]:
    """Return the pictures of titles, figures of matplotlib and captions.

    Raises
    ------
    StudyError
        If one is not such a triple.
    """
    made = []
    for number, each in enumerate(extra, start=1):
        if not isinstance(each, Sequence) or len(each) != 3:
            raise _wrong(number, "(title, figure, caption)", each)

        title, figure, caption = each
        if not isinstance(title, str) or not isinstance(caption, str):
            raise _wrong(number, "with a title and a caption in words", each)
        if not hasattr(figure, "savefig"):
            raise _wrong(number, "with a figure of matplotlib", figure)

        made.append(Picture(f"extra-{number}", title, caption, _address(figure)))

    return made


def _wrong(number: int, wanted: str, got: Any) -> StudyError:
    return StudyError(f"`extra` {number} must be {wanted}; got {repr(got)[:60]}.")


def _address(figure: Any) -> str:
    """A figure as a data URL, in lines or in dots, whichever is shorter: equal figures
    give equal ones.
    """
    files = {}
    with matplotlib.rc_context({"svg.hashsalt": "extra"}):
        for kind, undated in _UNDATED.items():
            stream = io.BytesIO()
            figure.savefig(stream, format=kind, metadata=undated, dpi=_DPI)
            files[kind] = stream.getvalue()

    kind = min(files, key=lambda kind: len(files[kind]))
    return f"data:{_TYPES[kind]};base64,{base64.b64encode(files[kind]).decode()}"
