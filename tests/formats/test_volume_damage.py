"""Volumes that are damaged or mean harm: one clear line, and no more memory than the refusal takes."""

from __future__ import annotations

import gzip
import pickle
import tracemalloc

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.volume import is_volume, read_colours, read_volume
from formats.volume_files import header_only, npz, npz_of_members, nrrd_file

RANDOM = np.random.default_rng(8)
SHAPE = (3, 4, 5)
VALUES = RANDOM.standard_normal(SHAPE).astype(np.float32)
COLOURS = RANDOM.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
MEGABYTE = 1 << 20


def read(data, most=1000):
    return read_volume(data, "file", None, most)


def refused(data, most=1000):
    """Check that a file is refused in one line for little memory; return the line."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as error:
            opened(data, most)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 * len(data) + 4 * MEGABYTE  # modules that are imported on the way count too
    line = str(error.value)
    assert line.startswith("file: ")
    assert "\n" not in line
    return line


def opened(data, most):
    return read(data, most) if is_volume(data, "file") else None


@pytest.mark.parametrize(
    "member",
    [
        header_only((1 << 20, 1 << 20, 1 << 20)),
        header_only((1 << 62, 1 << 62, 4)),
        header_only((-1, 4, 4), data=bytes(64)),
        header_only((3, 4, 5), data=bytes(100)),
        header_only((3, 4, 5), "<c16", bytes(960)),
        header_only((3, 4, 5), "|O", pickle.dumps([0] * 60)),
        header_only((3, 4, 5), [("a", "<f4")], bytes(240)),
        header_only((3, 4), data=bytes(48)),
        header_only((1, 4, 5), data=bytes(80)),
        header_only((0, 4, 5)),
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(5000),
        b"\x93NUMPY\x01\x00\x10\x00" + b"{'descr': __import__('os')}",
        b"no array",
        b"",
    ],
)
def test_archives_whose_headers_are_false_are_refused_before_anything_is_read(member):
    refused(npz_of_members(values=member))


def test_an_archive_that_unpacks_to_much_costs_no_more_than_its_refusal():
    size = 32 * MEGABYTE  # of zeros: some 32 kB packed
    assert "are allowed" in refused(npz_of_members(values=header_only((2, 2, size // 16), data=bytes(size))))
    # As much behind a small array as well.
    data = npz_of_members(values=header_only(SHAPE, data=VALUES.tobytes() + bytes(size)))
    tracemalloc.start()
    np.testing.assert_array_equal(read(data).values, VALUES)
    assert tracemalloc.get_traced_memory()[1] < MEGABYTE
    tracemalloc.stop()


@pytest.mark.parametrize(
    "arrays",
    [
        {"colours": COLOURS[:2]},
        {"colours": COLOURS[..., None]},
        {"colours": np.zeros((*SHAPE, 5))},
        {"mask": np.ones((3, 4, 4), bool)},
        {"spacing": [1.0, 0.0, 1.0]},
        {"spacing": [1.0, np.nan, 1.0]},
        {"spacing": np.ones((3, 3))},
        {"spacing": 1e300},
        {"spacing": [1e-9, 1.0, 1.0]},
        {"spacing": 1e-3, "origin": [0.0, 1e20, 0.0]},
        {"origin": [0.0, 1.0]},
        {"level": [0.0, 1.0]},
        {"level": np.inf},
        {"points": np.zeros((4, 3))},
        {"points": np.zeros((4, 2)), "point_colours": np.zeros((4, 3))},
        {"points": np.zeros((4, 3)), "point_colours": np.zeros((5, 3))},
        {"points": np.full((4, 3), np.nan), "point_colours": np.zeros((4, 3))},
    ],
)
def test_arrays_that_do_not_fit_are_refused(arrays):
    refused(npz(values=VALUES, **arrays))


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.replace(b"sizes: 3 4 5", b"sizes: 3000000 4000000 5000000"),
        lambda data: data.replace(b"sizes: 3 4 5", b"sizes: 3 4 500"),
        lambda data: data.replace(b"sizes: 3 4 5", b"sizes: 3 4 -5"),
        lambda data: data.replace(b"sizes: 3 4 5", b"sizes: 3 4"),
        lambda data: data.replace(b"dimension: 3", b"dimension: 4"),
        lambda data: data.replace(b"type: float", b"type: block"),
        lambda data: data.replace(b"encoding: gzip", b"encoding: hex"),
        lambda data: data.replace(b"endian: little", b"endian: middle"),
        lambda data: data.replace(b"sizes", b"sizes: 3 4 5\nsizes"),
        lambda data: data.replace(b"dimension: 3", b"dimension: 3\nspacings: 1 0 1"),
        lambda data: data.replace(b"dimension: 3", b"dimension: 3\nbyte skip: -1"),
        lambda data: data.replace(
            b"dimension: 3", b"dimension: 3\nspace directions: (1,0,0) (0,1,0) (1,1,0)"
        ),
        lambda data: data.replace(b"dimension: 3", b"dimension: 3\nspace directions: (1,0) (0,1) (1,1)"),
        lambda data: data[:-20],
        lambda data: data[:60],
        lambda data: b"NRRD0009" + data[8:],
    ],
)
def test_damaged_nrrd_files_are_refused(change):
    data = nrrd_file(VALUES, "gzip")
    assert change(data) != data
    refused(change(data))


def test_nrrd_data_that_unpack_to_much_are_read_no_further_than_the_header_says():
    head, packed = nrrd_file(VALUES, "gzip").split(b"\n\n", 1)
    plain = gzip.decompress(packed)
    data = head + b"\n\n" + gzip.compress(plain + bytes(32 * MEGABYTE))
    tracemalloc.start()
    np.testing.assert_array_equal(read(data).values, VALUES)
    assert tracemalloc.get_traced_memory()[1] < MEGABYTE
    tracemalloc.stop()


def test_lists_that_are_no_colours_and_colours_that_are_no_values_are_refused():
    stored = np.moveaxis(COLOURS, -1, 0)
    assert "rgb-color" in refused(nrrd_file(stored, kinds=["RGB-color", *["domain"] * 3]))
    many = nrrd_file(np.zeros((4, 5, 6, 30)), kinds=[*["domain"] * 3, "list"])
    assert "30 numbers" in refused(many)
    with pytest.raises(InputError, match="5 numbers"):
        read_colours(nrrd_file(np.zeros((5, 3, 4, 6)), kinds=["list", *["domain"] * 3]), "file", None, 1000)


def test_openvdb_is_refused_with_a_way_out():
    assert "npz" in refused(b" BDV\0\0\0\0" + bytes(50))


def test_changed_bytes_lead_to_a_refusal_or_to_arrays():
    sources = [npz(values=VALUES, colours=COLOURS, spacing=2.0), nrrd_file(VALUES, "gzip"), nrrd_file(VALUES)]
    lines, shapes = [], []
    for data in sources:
        for _ in range(200):
            broken = bytearray(data)
            for at in RANDOM.integers(0, len(data), RANDOM.integers(1, 6)):
                broken[at] = RANDOM.integers(256)
            del broken[RANDOM.integers(len(data) // 2, 2 * len(data)) :]
            try:
                volume = opened(bytes(broken), 1000)
            except InputError as error:
                lines.append(str(error))
            else:
                shapes += [] if volume is None else [volume.values.shape]
    assert not any("\n" in line for line in lines)
    assert min(map(min, shapes)) > 1
    assert len(lines) > 100
