"""A request answered: as a whole, or, where that fails, in parts, down to the line or
the point responsible.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from gaitsweep.pipeline.engine.request import Answer, AtlasAnswer, Request
from gaitsweep.pipeline.grid.grid import Shape
from gaitsweep.pipeline.statuses import of_atlas
from gaitsweep.pipeline.store.points import Points, joined
from gaitsweep.pipeline.store.record import ChunkCodec, Record

#: Asks for one request, once more if it fails by one of the words that follow; returns
#: "ok" or a name of `statuses.ENDINGS`, and the parts of the answer or a sentence.
Ask = Callable[..., tuple[str, Any]]

_PIECES = 16  # parts of a chunk that failed
#: What may have a cause outside; a second time it has none.
_EXTERNAL = ("worker_died", "out_of_memory")
#: Longest result [byte]: SQLite has rows of at most 10^9 byte.
MAX_PAYLOAD = 999_000_000


def answer(request: Request, ask: Ask) -> Answer:
    """Answer a request by asking for it, or for its parts."""
    if not request.codec:
        return _of_task(request, ask)
    places = None
    if "lines" in request.params:
        places = np.arange(len(request.params["lines"]))
    record, atlases = _of_part(request, places, ask)
    return Answer(record=record, atlases=atlases)


def _of_task(request: Request, ask: Ask) -> Answer:
    """Answer to a task that is no chunk."""
    status, result = ask(request, *_EXTERNAL)
    if status != "ok":
        return Answer(status, result)

    (data,) = result
    if len(data) > MAX_PAYLOAD:
        size = f"Its result of {size_of(len(data))}"
        return Answer("raised", f"{size} is larger than a journal can hold.")

    return Answer(data=data)


def size_of(memory: int) -> str:
    """A number of bytes in words."""
    for unit, name in ((1 << 30, "GiB"), (1 << 20, "MiB")):
        if memory >= unit:
            return f"{memory / unit:.4g} {name}"
    return f"{memory} B"


def _of_part(
    request: Request, places: np.ndarray | None, ask: Ask
) -> tuple[Record, list[AtlasAnswer]]:
    """Record of the points of a part of a chunk: of its line, or of the lines side by
    side at some `places` in it.

    If they fail together, they are asked for in smaller parts, down to the point
    responsible.
    """
    params, codec = request.params, request.codec
    assert codec
    lines = 1 if places is None else len(places)
    slopes = len(params["slope"])
    has_atlases = places is not None and request.alone is not None
    is_point = lines * slopes == 1 and not has_atlases

    outcome: str = ""
    parts: list[Any] = []
    if lines * slopes <= (request.most or math.inf):
        again: tuple[str, ...] = ()
        if is_point:
            again = ("timed_out", *_EXTERNAL)
        outcome, parts = ask(request, *again)

    if outcome == "ok":
        return _of_whole(parts, places)
    if is_point:
        ending = Points.of_ending(1, outcome, str(parts), params["want"])
        return codec.encode(ending), []

    if places is not None and lines == 1 and has_atlases:
        return _alone(request, int(places[0]), ask)
    if outcome:
        sizes = _fewer(lines, slopes)
    else:
        assert request.most
        sizes = _at_most(request.most, lines, slopes, has_atlases)

    return _divided(request, places, sizes, ask)


def _of_whole(
    parts: list[Any], places: np.ndarray | None
) -> tuple[Record, list[AtlasAnswer]]:
    """Record and atlases that were answered together."""
    head, payload, *packed = parts
    atlases = []
    if places is not None:
        for place, atlas in zip(places.tolist(), packed, strict=False):
            atlases.append(AtlasAnswer(place, "ok", "", atlas))

    return Record(head, payload), atlases


def _divided(
    request: Request, places: np.ndarray | None, sizes: tuple[int, int], ask: Ask
) -> tuple[Record, list[AtlasAnswer]]:
    """Record of a part of a chunk that is computed in parts of so many lines and
    slopes.
    """
    assert request.codec
    slopes = len(request.params["slope"])
    lines = 1 if places is None else len(places)
    found: list[Points] = []
    rows: list[np.ndarray] = []
    atlases: list[AtlasAnswer] = []
    parts = itertools.product(_ranges(lines, sizes[0]), _ranges(slopes, sizes[1]))
    for some, at in parts:
        part = _part_of(request, some, at)
        of_part = places
        if places is not None:
            of_part = places[some]
        record, atlases_of_part = _of_part(part, of_part, ask)
        found.append(ChunkCodec.decode(record))
        rows.append((some[:, None] * slopes + at).ravel())
        atlases += atlases_of_part

    order = np.argsort(np.concatenate(rows))
    points = joined(found).take(order)
    return request.codec.encode(points), atlases


def _part_of(request: Request, lines: np.ndarray, slopes: np.ndarray) -> Request:
    """Request for the points of some lines at some slopes, by their places."""
    assert request.codec
    params = {**request.params, "slope": request.params["slope"][slopes]}
    if "lines" in params:
        params["lines"] = [params["lines"][k] for k in lines.tolist()]

    shape = Shape.of_rows(len(lines), len(slopes))
    return replace(request, params=params, codec=replace(request.codec, shape=shape))


def _fewer(lines: int, slopes: int) -> tuple[int, int]:
    """Lines and slopes of each smaller part of one that failed: the lines are divided,
    or the slopes of one.
    """
    if lines > 1:
        return math.ceil(lines / _PIECES), slopes
    return 1, math.ceil(slopes / _PIECES)


def _at_most(most: int, lines: int, slopes: int, has_atlases: bool) -> tuple[int, int]:
    """Lines and slopes of parts with so many points, or of single lines that have
    atlases.

    A plane's lines remain side by side, if only at a few slopes: those without charts
    are followed together, by a worker that remembers their branches for the next
    slopes.
    """
    if most >= slopes or has_atlases:
        return max(1, most // slopes), slopes
    together = min(lines, most)
    return together, most // together


def _ranges(n: int, size: int) -> list[np.ndarray]:
    """Places of n things in parts of a size, the last perhaps smaller."""
    return [np.arange(k, min(k + size, n)) for k in range(0, n, size)]


def _alone(request: Request, place: int, ask: Ask) -> tuple[Record, list[AtlasAnswer]]:
    """A line that failed beside others, or whose points are wanted a few at a time: its
    atlas, then its points.
    """
    shared = ("lines", "atlases")
    params = {k: value for k, value in request.params.items() if k not in shared}
    (line,) = request.params["lines"]
    assert request.alone and request.codec
    atlas, points = request.alone
    of_atlas_alone = {"line": line, "coarse": True}
    alone = replace(request, function=atlas, params=of_atlas_alone, codec=None)
    outcome, result = ask(alone, *_EXTERNAL)
    if outcome != "ok":
        count, reason = len(params["slope"]), of_atlas(result)
        ending = Points.of_ending(count, outcome, reason, params["want"])
        return request.codec.encode(ending), [AtlasAnswer(place, outcome, result, b"")]

    of_points = replace(
        request, function=points, params={**params, "line": line}, inputs=result
    )
    record, _ = _of_part(of_points, None, ask)
    return record, [AtlasAnswer(place, "ok", "", result[0])]
