"""Volumes: the same arrays from every kind of file, and places as the header says.

Damaged and harmful files are refused in one clear line, for no more memory than the refusal takes.
"""

import gzip
import pickle
import tracemalloc
from contextlib import contextmanager

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.access import Access, Hooks
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.formats.volume import is_volume, read_colours, read_volume
from beltrami_cli.surface.level_sets import GridColours, NearColours
from formats.volume_files import header_only, lattice_fields, npz, npz_of_members, nrrd_file

RANDOM = np.random.default_rng(7)
SHAPE = (3, 4, 5)
VALUES = RANDOM.standard_normal(SHAPE).astype(np.float32)
COLOURS = RANDOM.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
AXES = np.array([[0.5, 0.1, 0.0], [0.0, 2.0, 0.3], [-0.2, 0.0, 1.0]])
MEGABYTE = 1 << 20
ORIGIN = np.array([3.0, -7.0, 11.0])
NOWHERE = ModelFolder(None)


def read(data, folder=None, most=1000):
    assert is_volume(data, "file")
    return read_volume(data, "file", ModelFolder(folder), most)


def test_an_archive_gives_its_arrays_whatever_the_spelling():
    data = npz(
        values=VALUES, colours=COLOURS, spacing=[1.0, 2.0, 3.0], origin=ORIGIN, level=0.25, mask=VALUES > 0
    )
    volume = read(data)
    np.testing.assert_array_equal(volume.values, VALUES)
    np.testing.assert_array_equal(volume.colours.samples, COLOURS)
    np.testing.assert_array_equal(volume.lattice.axes, np.diag([1, 2, 3]))
    np.testing.assert_array_equal(volume.lattice.origin, ORIGIN)
    np.testing.assert_array_equal(volume.known, VALUES > 0)
    assert volume.level == 0.25
    other = read(npz(tsdf=np.asfortranarray(VALUES.astype(">f8")), colors=COLOURS, voxel_size=0.5))
    np.testing.assert_array_equal(other.values, VALUES)
    np.testing.assert_array_equal(other.lattice.axes, np.eye(3) / 2)
    assert other.values.dtype.isnative
    assert other.known is other.level is None


def test_an_archive_may_give_colours_by_points():
    points, colours = RANDOM.random((6, 3)), RANDOM.random((6, 4))
    near = read(npz(sdf=VALUES, points=points, point_colors=colours)).colours
    assert isinstance(near, NearColours)
    np.testing.assert_array_equal(near.points, points)
    np.testing.assert_array_equal(near.samples, colours)


def test_archives_without_a_level_set_are_not_volumes():
    assert not is_volume(npz(points=np.zeros((2, 3)), colours=np.zeros((2, 3))), "file")
    assert not is_volume(b"PK\x03\x04 something else", "file")
    assert not is_volume(b"ply\n", "file")


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2", "ASCII"])
@pytest.mark.parametrize("dtype", ["<f4", ">f8", "i2", "u1"])
def test_every_encoding_and_type_of_nrrd_gives_the_same_numbers(encoding, dtype):
    samples = (100 + 20 * VALUES).astype(dtype)
    endian = {"endian": "big"} if dtype[0] == ">" else {}
    volume = read(nrrd_file(samples, encoding, **lattice_fields(AXES, ORIGIN), **endian))
    np.testing.assert_allclose(volume.values, samples, rtol=1e-12)
    assert volume.values.dtype.isnative
    np.testing.assert_array_equal(volume.lattice.axes, AXES)
    np.testing.assert_array_equal(volume.lattice.origin, ORIGIN)
    assert volume.colours is None


@pytest.mark.parametrize("listed", [0, 3])
def test_colours_of_nrrd_may_be_its_first_or_last_axis(listed):
    stored = np.moveaxis(COLOURS, -1, listed)
    colours = read_colours(nrrd_file(stored, **lattice_fields(AXES, ORIGIN, listed)), "file", NOWHERE, 1000)
    assert isinstance(colours, GridColours)
    np.testing.assert_array_equal(colours.samples, COLOURS)
    np.testing.assert_array_equal(colours.lattice.axes, AXES)
    kinds = ["domain"] * 3
    kinds.insert(listed, "RGB-color")
    by_kind = read_colours(nrrd_file(stored, kinds=kinds, spacings=[2.0] * 4), "file", NOWHERE, 1000)
    np.testing.assert_array_equal(by_kind.samples, COLOURS)
    np.testing.assert_array_equal(by_kind.lattice.axes, 2 * np.eye(3))


def test_one_nrrd_file_may_hold_values_and_colours():
    both = np.concatenate([VALUES[None], np.moveaxis(COLOURS, -1, 0) / np.float32(255)])
    volume = read(nrrd_file(both, kinds=["list", "domain", "domain", "domain"]))
    np.testing.assert_array_equal(volume.values, VALUES)
    np.testing.assert_allclose(volume.colours.samples, COLOURS / 255, rtol=1e-6)


@pytest.mark.parametrize(
    ("fields", "step", "first"),
    [
        ({}, 1.0, 0.0),
        ({"spacings": [0.5] * 3}, 0.5, 0.0),
        ({"spacings": [0.5] * 3, "axis_mins": [2.0] * 3}, 0.5, 2.0),
        # Nodes stand on both ends of the range; cells fill it, so that their centres are half a step inside.
        ({"axis_mins": [0.0] * 3, "axis_maxs": [4.0, 6.0, 8.0], "centerings": ["node"] * 3}, 2.0, 0.0),
        ({"axis_mins": [0.0] * 3, "axis_maxs": [6.0, 8.0, 10.0], "centerings": ["cell"] * 3}, 2.0, 1.0),
    ],
)
def test_without_directions_places_follow_from_the_fields_of_the_axes(fields, step, first):
    lattice = read(nrrd_file(VALUES, **fields)).lattice
    np.testing.assert_allclose(lattice.axes, step * np.eye(3))
    np.testing.assert_allclose(lattice.origin, np.full(3, first))


def test_a_detached_header_finds_its_data_beside_it_and_nowhere_else(tmp_path):
    whole = nrrd_file(VALUES, "gzip", **lattice_fields(AXES, ORIGIN))
    head, data = whole.split(b"\n\n", 1)
    folder = tmp_path / "inner"
    folder.mkdir()
    (folder / "values.raw.gz").write_bytes(data)
    (tmp_path / "secret").write_bytes(data)
    detached = head + b"\ndata file: values.raw.gz\n\n"
    np.testing.assert_array_equal(read(detached, folder).values, VALUES)
    for name in (b"../secret", str(tmp_path / "secret").encode(), b"missing", b"LIST"):
        with pytest.raises(InputError, match="its data are in"):
            read(head + b"\ndata file: " + name + b"\n\n", folder)
    with pytest.raises(InputError, match="its data are in"):
        read(detached, None)
    seen = {}
    noted = Access(hooks=Hooks(lambda path, content: seen.update({path.name: content})))
    read_volume(detached, "file", ModelFolder(folder, noted), 1000)
    assert seen == {"values.raw.gz": data}
    with pytest.raises(InputError, match="cannot be read"):
        read_volume(detached, "file", ModelFolder(folder, Access(memory=len(data) - 1)), 1000)


@contextmanager
def peak_memory():
    """Give a function that returns the largest number of bytes allocated in the block, once that has ended."""
    peak = 0
    tracemalloc.start()
    try:
        yield lambda: peak
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()


def refused(data, most=1000):
    """Check that a file is refused in one line for little memory; return the line."""
    with peak_memory() as peak, pytest.raises(InputError) as error:
        opened(data, most)
    assert peak() < 2 * len(data) + 4 * MEGABYTE  # modules that are imported on the way count too
    line = str(error.value)
    assert line.startswith("file: ")
    assert "\n" not in line
    return line


def opened(data, most):
    return read_volume(data, "file", NOWHERE, most) if is_volume(data, "file") else None


def changed(old, new):
    """Return an NRRD file with other words in its header."""
    data = nrrd_file(VALUES, "gzip")
    assert old in data
    return data.replace(old, new, 1)


def archive(**arrays):
    return npz(values=VALUES, **arrays)


def member(*header, **data):
    return npz_of_members(values=header_only(*header, **data))


FALSE = [
    member((1 << 20, 1 << 20, 1 << 20)), member((1 << 62, 1 << 62, 4)), member((-1, 4, 4), data=bytes(64)),
    member((3, 4, 5), data=bytes(100)), member((3, 4, 5), "<c16", data=bytes(960)),
    member((3, 4, 5), "|O", data=pickle.dumps([0] * 60)), member((3, 4, 5), [("a", "<f4")], data=bytes(240)),
    member((3, 4), data=bytes(48)), member((1, 4, 5), data=bytes(80)), member((0, 4, 5)),
    npz_of_members(values=b"\x93NUMPY\x02\x00\xff\xff\xff\xff" + bytes(5000)),
    npz_of_members(values=b"\x93NUMPY\x01\x00\x10\x00" + b"{'descr': __import__('os')}"),
    npz_of_members(values=b"no array"), archive(colours=COLOURS[:2]), archive(colours=np.zeros((*SHAPE, 5))),
    archive(mask=np.ones((3, 4, 4), bool)), archive(spacing=[1.0, 0.0, 1.0]), archive(spacing=[1.0, np.nan, 1.0]),
    archive(spacing=np.ones((3, 3))), archive(spacing=1e300), archive(spacing=[1e-9, 1.0, 1.0]),
    archive(spacing=1e-3, origin=[0.0, 1e20, 0.0]), archive(origin=[0.0, 1.0]), archive(level=[0.0, 1.0]),
    archive(level=np.inf), archive(points=np.zeros((4, 3))),
    archive(points=np.zeros((4, 2)), point_colours=np.zeros((4, 3))),
    archive(points=np.zeros((4, 3)), point_colours=np.zeros((5, 3))),
    archive(points=np.full((4, 3), np.nan), point_colours=np.zeros((4, 3))),
    changed(b"sizes: 3 4 5", b"sizes: 3000000 4000000 5000000"), changed(b"sizes: 3 4 5", b"sizes: 3 4 500"),
    changed(b"sizes: 3 4 5", b"sizes: 3 4 -5"), changed(b"sizes: 3 4 5", b"sizes: 3 4"),
    changed(b"dimension: 3", b"dimension: 4"), changed(b"type: float", b"type: block"),
    changed(b"encoding: gzip", b"encoding: hex"), changed(b"endian: little", b"endian: middle"),
    changed(b"sizes", b"sizes: 3 4 5\nsizes"), changed(b"dimension: 3", b"dimension: 3\nspacings: 1 0 1"),
    changed(b"dimension: 3", b"dimension: 3\nbyte skip: -1"),
    changed(b"dimension: 3", b"dimension: 3\nspace directions: (1,0,0) (0,1,0) (1,1,0)"),
    changed(b"dimension: 3", b"dimension: 3\nspace directions: (1,0) (0,1) (1,1)"),
    changed(b"NRRD0005", b"NRRD0009"),
    nrrd_file(VALUES, "gzip")[:-20],
    nrrd_file(VALUES, "gzip")[:60],
    b" BDV\0\0\0\0" + bytes(50),
]  # fmt: skip


@pytest.mark.parametrize("data", FALSE, ids=range(len(FALSE)))
def test_false_files_are_refused_in_a_line_and_little_memory(data):
    assert "npz" in refused(data) or not data.startswith(b" BDV")


@pytest.mark.slow
def test_what_unpacks_to_much_costs_no_more_than_what_the_header_says():
    size = 32 * MEGABYTE  # of zeros: some 32 kB packed
    assert "are allowed" in refused(npz_of_members(values=header_only((2, 2, size // 16), data=bytes(size))))
    head, packed = nrrd_file(VALUES, "gzip").split(b"\n\n", 1)
    behind_small_arrays = (
        npz_of_members(values=header_only(SHAPE, data=VALUES.tobytes() + bytes(size))),
        head + b"\n\n" + gzip.compress(gzip.decompress(packed) + bytes(size)),
    )
    for data in behind_small_arrays:
        with peak_memory() as peak:
            np.testing.assert_array_equal(read(data).values, VALUES)
        assert peak() < MEGABYTE


def test_lists_that_are_no_colours_and_colours_that_are_no_values_are_refused():
    stored = np.moveaxis(COLOURS, -1, 0)
    assert "rgb-color" in refused(nrrd_file(stored, kinds=["RGB-color", *["domain"] * 3]))
    many = nrrd_file(np.zeros((4, 5, 6, 30)), kinds=[*["domain"] * 3, "list"])
    assert "30 numbers" in refused(many)
    with pytest.raises(InputError, match="5 numbers"):
        read_colours(
            nrrd_file(np.zeros((5, 3, 4, 6)), kinds=["list", *["domain"] * 3]), "file", NOWHERE, 1000
        )
