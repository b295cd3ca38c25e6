"""Chunks packed here are what HDF5's own filters read, and no larger than what they
would write.
"""

import zlib

import netCDF4
import numpy as np
import pytest

from gaitsweep.pipeline.archive import layout
from gaitsweep.pipeline.archive.direct_chunks import direct_chunks
from gaitsweep.pipeline.grid.boxes import MOST_POINTS, box_shape, boxes
from gaitsweep.pipeline.store import packing

SMOOTH = np.cbrt(np.linspace(1e-4, 0.1, 3 * 9000)).reshape(3, 9000)
PACKED = {"zlib": True, "complevel": 1, "shuffle": True, "fletcher32": True}


def _file(path, values, extent):
    with netCDF4.Dataset(path, "w") as file:
        for k, n in enumerate(values.shape):
            file.createDimension(f"d{k}", n)
        dims = tuple(f"d{k}" for k in range(values.ndim))
        file.createVariable(
            "v", values.dtype, dims, chunksizes=extent, fill_value=False, **PACKED
        )
    return path


@pytest.mark.parametrize(
    "values",
    [
        np.stack([SMOOTH, SMOOTH**2], -1),
        np.full((3, 9000, 2), np.nan),
        (SMOOTH * 90).astype(np.int8)[..., None],
        np.ones((1, 3, 1), np.int8),
        np.ones((1, 1, 3), np.int8),
        (SMOOTH * 9e3).astype(np.int16)[..., None],
        (SMOOTH * 9e8).astype(np.int32)[..., None],
        np.zeros((1, 1, 1)),
        np.random.default_rng(1).random((2, 9000, 3)),
    ],
    ids=["smooth", "nan", "i1", "odd", "columns", "i2", "i4", "one", "noise"],
)
def test_netcdf_reads_back_what_was_packed(tmp_path, values):
    sizes = {"line": values.shape[0], "slope": values.shape[1]}
    shape = box_shape(sizes, MOST_POINTS)
    extent = (*shape, values.shape[2])
    ours, theirs = (
        _file(tmp_path / name, values, extent) for name in ("ours.nc", "theirs.nc")
    )
    with netCDF4.Dataset(theirs, "a") as file:
        file["v"][:] = values
    with direct_chunks(ours) as write:
        for box in boxes(sizes, shape, MOST_POINTS):
            for corner, part in layout.split(values[box], box, extent):
                packed = packing.pack_values(part, extent)
                write("v", corner, packed.data)
                unpacked = packing.unpack(packed.data, values.dtype.str, extent)[
                    tuple(map(slice, part.shape))
                ]
                np.testing.assert_array_equal(unpacked, part)
                assert packed.checksum == zlib.crc32(part.tobytes())
    with netCDF4.Dataset(ours) as file:
        np.testing.assert_array_equal(np.ma.getdata(file["v"][:]), values)
    assert ours.stat().st_size < 1.05 * theirs.stat().st_size + 1000


def test_a_flipped_byte_in_a_chunk_is_refused_by_the_library(tmp_path):
    path = _file(tmp_path / "v.nc", SMOOTH, (1, 9000))
    data = bytearray(packing.pack(SMOOTH[:1], SMOOTH[:1].shape))
    data[len(data) // 2] ^= 1
    with direct_chunks(path) as write:
        write("v", (0, 0), bytes(data))
    with netCDF4.Dataset(path) as file, pytest.raises(RuntimeError):
        file["v"][0]


@pytest.mark.parametrize(
    "sizes",
    [
        {"slope": 200_000},
        {"slope": 1000, "R": 300},
        {"R": 70, "m": 90, "slope": 50},
        {"R": 3000, "slope": 3},
        {"slope": 1},
    ],
)
def test_boxes_are_whole_chunks_and_cover_the_grid_once(sizes):
    seen, chunk = (
        np.zeros(tuple(sizes.values()), int),
        box_shape(sizes, MOST_POINTS // 3),
    )
    for box in boxes(sizes, chunk, MOST_POINTS):
        seen[box] += 1
        assert seen[box].size <= MOST_POINTS and all(
            s.start % c == 0 for s, c in zip(box, chunk, strict=True)
        )
        assert all(
            s.stop % c == 0 or s.stop == n
            for s, c, n in zip(box, chunk, seen.shape, strict=True)
        )
    assert (seen == 1).all()
