"""Volumes: the same arrays from every kind of file, and places as the header says."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.volume import is_volume, read_colours, read_volume
from beltrami_cli.surface.volume import GridColours, NearColours
from formats.volume_files import lattice_fields, npz, nrrd_file

RANDOM = np.random.default_rng(7)
SHAPE = (3, 4, 5)
VALUES = RANDOM.standard_normal(SHAPE).astype(np.float32)
COLOURS = RANDOM.integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
AXES = np.array([[0.5, 0.1, 0.0], [0.0, 2.0, 0.3], [-0.2, 0.0, 1.0]])
ORIGIN = np.array([3.0, -7.0, 11.0])


def read(data, folder=None, most=1000):
    assert is_volume(data, "file")
    return read_volume(data, "file", folder, most)


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


def test_an_archive_may_paint_by_points():
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
    colours = read_colours(nrrd_file(stored, **lattice_fields(AXES, ORIGIN, listed)), "file", None, 1000)
    assert isinstance(colours, GridColours)
    np.testing.assert_array_equal(colours.samples, COLOURS)
    np.testing.assert_array_equal(colours.lattice.axes, AXES)
    kinds = ["domain"] * 3
    kinds.insert(listed, "RGB-color")
    by_kind = read_colours(nrrd_file(stored, kinds=kinds, spacings=[2.0] * 4), "file", None, 1000)
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
