"""Chunks are rectangles that cover a grid once, as large as their points are cheap."""

from pathlib import Path

import numpy as np
import pytest

from gaitsweep.pipeline.grid.grid import Grid
from gaitsweep.pipeline.study.parse import parse


def grid(slope=(0.01, 0.1, 100_000), walker="D", **changes):
    low, high, n = slope
    axes = {
        "slope": {"from": low, "to": high, "n": n, "spacing": "log"},
        **changes.pop("axes", {}),
    }
    return Grid(
        parse(
            {"name": "s", "walker": walker, "axes": axes, **changes}, "", Path("s.toml")
        )
    )


def test_points_that_take_longer_are_fewer_in_a_chunk():
    extents = [
        grid(**changes).extent[0]
        for changes in (
            {},
            {"walker": "C"},
            {"walker": "C", "want": {"variables": ["violations"]}},
            {"slope": (1e-12, 0.1, 100_000)},  # which may need extended precision
            {"limits": {"seconds": 0.01}},
            {"want": {"variables": ["proofs"]}},
        )
    ]
    assert extents == sorted(extents, reverse=True) and len(set(extents)) == len(
        extents
    )
    assert 10_000 < extents[0] <= 16384 and extents[3] <= 512 and extents[-1] == 4


@pytest.mark.parametrize(
    ("slopes", "axes", "lines"),
    [
        (1000, {"R": [0.0, 0.1, 0.2]}, 1),
        (20, {"R": {"from": 0.0, "to": 0.1, "n": 70}, "m_h": [0.0, 1.0, 2.0]}, None),
        (3, {}, None),
        (1, {"g": {"from": 1.0, "to": 2.0, "n": 130}, "R": [0.0, 0.1]}, None),
    ],
)
@pytest.mark.parametrize("is_first", [False, True])
def test_chunks_cover_the_grid_once_and_know_their_lines(slopes, axes, lines, is_first):
    """Wherever the slope stands among the axes."""
    slope = {"slope": {"from": 0.01, "to": 0.02, "n": slopes}}
    table = {
        "name": "s",
        "walker": ["B", "E"],
        "axes": {**slope, **axes} if is_first else {**axes, **slope},
    }
    found = Grid(parse(table, "", Path("s.toml")))
    seen = np.zeros(tuple(found.sizes.values()), int)
    of_line = {line: [] for line in range(found.study.lines)}
    for k in range(found.chunks):
        chunk = found.chunk(k)
        box = tuple(chunk.spans.values())
        seen[box] += 1
        assert lines is None or len(chunk.numbers) == lines
        assert (
            chunk.points
            == seen[box].size
            == chunk.shape.unfold(np.arange(chunk.points)).size
        )
        for line in chunk.numbers.tolist():
            of_line[line].append(k)
        # The first point of its last line, in the grid.
        last = chunk.shape.unfold(np.arange(chunk.points))
        n = chunk.slopes.stop - chunk.slopes.start
        place = np.argwhere(last == chunk.points - n)[0] + [span.start for span in box]
        at = dict(zip(found.sizes, place.tolist(), strict=True))
        own = found.study.line(int(chunk.numbers[-1]))
        assert (
            own["walker"] == found.study.walkers[at["walker"]]
            and at["slope"] == chunk.slopes.start
        )
        assert all(
            own["set"][axis.name] == axis.values[at[axis.name]]
            for axis in found.study.axes
            if axis.name != "slope"
        )
    assert (seen == 1).all()
    assert all(
        list(found.chunks_of_line(line)) == numbers for line, numbers in of_line.items()
    )


@pytest.mark.parametrize("slopes", [8, 300])
def test_a_chunk_counts_lines_and_points_without_numbering_them(slopes):
    slope = {"from": 0.01, "to": 0.02, "n": slopes}
    radius = {"from": 0.0, "to": 0.3, "n": 90}
    axes = {"R": radius, "slope": slope, "c_t": [0.1, 0.2, 0.3]}
    table = {"name": "s", "walker": ["B", "E"], "axes": axes}
    grid = Grid(parse(table, "", Path("s.toml")))

    chunks = [grid.chunk(k) for k in range(grid.chunks)]

    assert [chunk.line for chunk in chunks] == [chunk.numbers[0] for chunk in chunks]
    assert [chunk.lines for chunk in chunks] == [len(chunk.numbers) for chunk in chunks]
    assert sum(chunk.points for chunk in chunks) == 2 * 90 * 3 * slopes
