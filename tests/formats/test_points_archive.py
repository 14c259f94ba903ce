"""Points in NumPy archives: colours alone change, all else stays value for value."""

import contextlib
import io
import struct
import tracemalloc
import zipfile
import zlib

import numpy as np
import pytest

from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.files.numpy_files import NpzArchive
from beltrami_cli.formats.points.npz import NpzPointsDocument
from beltrami_cli.formats.points.unnamed_columns import RGB
from beltrami_cli.formats.registry import open_document
from formats.gltf_files import patched
from formats.ply_files import Table, build
from formats.volume_files import npz

POSITIONS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
COLOURS = np.array([[0, 51, 255], [10, 20, 30], [40, 50, 60], [70, 80, 90]], np.uint8)


def opened(data, access=None):
    return NpzPointsDocument(data, "cloud.npz", None, access or Access())


def unnpz(data):
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return dict(archive)


@pytest.mark.parametrize(
    ("key", "values", "channels", "first"),
    [
        ("colours", COLOURS, 3, [0, 0.2, 1]), ("colors", COLOURS.astype(np.uint16) * 257, 3, [0, 0.2, 1]),
        ("colors", COLOURS.astype(np.uint16) * 4, 3, [0, 204 / 1023, 1020 / 1023]),
        ("rgb", COLOURS.astype(np.int64), 3, [0, 0.2, 1]), ("rgb", COLOURS / 255, 3, [0, 0.2, 1]),
        ("rgba", np.column_stack([COLOURS, COLOURS[:, 0]]), 3, [0, 0.2, 1]),
        ("point_colors", COLOURS[:, 1:2], 1, [0.2]),
        ("point_colours", COLOURS[:, :2].astype(np.float32)[:, ::-1] / 255, 1, [0.2]),
        ("colours", COLOURS[:, 1], 1, [0.2]), ("intensity", COLOURS[:, 1].astype(np.float16), 1, [0.2]),
        ("intensities", np.array([-500.0, 100, 200, 1000]), 1, [-0.5]),
    ],
)  # fmt: skip
def test_arrays_are_known_by_their_names(key, values, channels, first):
    place = {3: "points", 1: "xyz"}[channels] if values.dtype.kind == "f" else "positions"
    vertices = opened(npz(**{place: POSITIONS, key: values})).coloured_vertices()
    assert np.array_equal(vertices.positions, POSITIONS)
    assert vertices.colours.shape == (4, channels)
    assert np.allclose(vertices.colours[0], first, atol=1e-3)
    assert vertices.faces.shape == (0, 3)


def test_points_of_two_dimensions_are_a_range_image():
    positions, colours = POSITIONS.reshape(2, 2, 3).copy(), COLOURS.reshape(2, 2, 3)
    positions[0, 1] = np.nan
    document = opened(npz(positions=positions, colours=colours))
    assert document.grid().tolist() == [[0, -1], [1, 2]]
    assert len(document.coloured_vertices().positions) == 3
    assert "1 of 4 points have no finite position" in document.coloured_vertices().notices[0]
    assert opened(npz(positions=POSITIONS, colours=COLOURS)).grid() is None
    new = unnpz(patched(document, np.zeros((3, 3))))["colours"]
    assert new.tolist() == [[[0, 0, 0], [10, 20, 30]], [[0, 0, 0], [0, 0, 0]]]


@pytest.mark.parametrize(
    ("compressed", "stored", "order"),
    [(True, np.uint8, "C"), (False, np.uint16, "F"), (False, np.int16, "C"), (True, np.int64, "F"),
     (False, np.float16, "C"), (True, np.float32, "F"), (False, np.float64, "F"), (True, ">u2", "C")],
)  # fmt: skip
def test_only_the_colours_change_and_every_other_array_stays(compressed, stored, order):
    scale = 65535 if np.dtype(stored) in (np.uint16, np.dtype(">u2")) else 255
    colours = np.asarray(COLOURS.astype(int) * (scale // 255), stored, order=order)
    others = {
        "label": np.array(["a", "b"]),
        "pose": np.eye(4)[::-1].T,
        "normals": np.ones((4, 3), np.float32),
        "nan": np.array(np.nan),
    }
    data = npz(compressed=compressed, **others, positions=POSITIONS, colours=colours)
    data = data.replace(b"\0\0\x21\0", b"\0\0\x22\0")  # the date of all members, the second of January 1980
    document = opened(data)
    same = document.coloured_vertices().colours
    assert patched(document, same) == data
    assert patched(document, None) == data
    new = same.copy()
    new[2] = [1, 0.5, 0]
    result = patched(document, new)
    arrays, before = unnpz(result), unnpz(data)
    assert list(arrays) == list(before)
    assert arrays["colours"].dtype == colours.dtype
    assert arrays["colours"].flags.f_contiguous == before["colours"].flags.f_contiguous
    assert np.array_equal(arrays["colours"][[0, 1, 3]], colours[[0, 1, 3]])
    rounding = 0.5 if np.dtype(stored).kind != "f" else 255 * np.finfo(stored).eps
    assert np.abs(arrays["colours"][2].astype(float) - np.array([1, 0.5, 0]) * scale).max() <= rounding
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(io.BytesIO(result)) as new_archive:
        for one, other in zip(old.infolist(), new_archive.infolist(), strict=True):
            kept = ("filename", "date_time", "compress_type", "external_attr", "create_system")
            assert all(getattr(one, field) == getattr(other, field) for field in kept)
            if one.filename != "colours.npy":
                assert old.read(one) == new_archive.read(other)


@pytest.mark.parametrize(
    ("arrays", "error", "said"),
    [
        ({"positions": POSITIONS}, NoColoursError, "no array of colours"),
        ({"rgb": COLOURS}, InputError, "no array of positions"),
        ({"positions": POSITIONS[:, :2], "rgb": COLOURS}, InputError, r"\(4, 2\), not \(..., 3\)"),
        ({"positions": POSITIONS, "rgb": COLOURS[:3]}, InputError, r"of shape \(3, 3\)"),
        ({"positions": POSITIONS, "rgb": np.zeros((4, 5))}, InputError, r"of shape \(4, 5\)"),
        ({"positions": POSITIONS, "rgb": COLOURS > 9}, InputError, "booleans"),
        ({"positions": POSITIONS, "rgb": np.full((4, 3), "red")}, InputError, "not of real numbers"),
        ({"positions": POSITIONS, "rgb": np.full((4, 3), np.nan)}, InputError, "colour of point 0"),
        ({"positions": np.full((4, 3), np.nan), "rgb": COLOURS}, InputError, "not finite"),
        ({"positions": POSITIONS[:0], "rgb": COLOURS[:0]}, InputError, "no points"),
        ({"xyz": POSITIONS, "rgb": COLOURS, "faces": np.zeros((1, 4), int)}, InputError, r"not \(F, 3\)"),
        ({"xyz": POSITIONS, "rgb": COLOURS, "faces": [[0, 1, 4]]}, InputError, "outside 0 to 3"),
        ({"xyz": POSITIONS, "rgb": COLOURS, "faces": [[0.5, 1, 2]]}, InputError, "whole numbers"),
    ],
)
def test_what_does_not_go_together_is_refused_in_one_line(arrays, error, said):
    with pytest.raises(error, match=said) as caught:
        opened(npz(**arrays)).coloured_vertices()
    assert "\n" not in str(caught.value)


def test_pickles_are_not_opened_but_stay():
    things = np.array([{"a": 1}, print], dtype=object)
    data = npz(compressed=False, positions=POSITIONS, colours=COLOURS, things=things)
    document = opened(data)
    assert document.attributes() == ()
    result = patched(document, 1 - document.coloured_vertices().colours)
    with zipfile.ZipFile(io.BytesIO(result)) as new, zipfile.ZipFile(io.BytesIO(data)) as old:
        assert new.read("things.npy") == old.read("things.npy")


def test_arrays_beyond_the_memory_allowed_are_refused_before_they_are_unnpz():
    data = npz(positions=np.zeros((200_000, 3)), colours=np.zeros((200_000, 3), np.uint8))
    assert len(data) < 100_000
    with pytest.raises(InputError, match="raise --max-memory"):
        opened(data, Access(memory=10_000_000)).coloured_vertices()
    assert len(opened(data, Access(memory=100_000_000)).coloured_vertices().positions) == 200_000


def test_other_arrays_of_the_points_are_attributes():
    arrays = {"quality": np.arange(4), "normals": POSITIONS, "pose": np.eye(3), "labels": np.array(["a"] * 4)}
    document = opened(npz(points=POSITIONS, rgb=COLOURS, intensity=np.arange(4.0), **arrays))
    assert document.attributes() == ("normal", "intensity", "quality")
    assert document.attribute("Quality").tolist() == [[0], [1], [2], [3]]
    assert np.array_equal(document.attribute("normal"), POSITIONS)


def test_opacity_and_faces_stay_and_count_in_comparisons():
    faces, rgba = [[0, 1, 2], [1, 3, 2]], np.column_stack([COLOURS, [9, 8, 7, 6]]).astype(np.uint8)
    document = opened(npz(positions=POSITIONS, rgba=rgba, faces=faces))
    assert document.coloured_vertices().faces.tolist() == faces
    assert np.allclose(document.contents().alpha, rgba[:, 3] / 255)
    assert (document.facts()["points"], document.facts()["organised"]) == (4, [4])
    new = patched(document, np.ones((4, 3)))
    assert unnpz(new)["rgba"].tolist() == [[255, 255, 255, alpha] for alpha in (9, 8, 7, 6)]
    assert opened(new).fingerprint().parts == document.fingerprint().parts
    assert (opened(new).fingerprint().colours["point colours"] == 1).all()
    rgba[0, 3] += 1
    opaque = opened(npz(positions=POSITIONS, rgba=rgba, faces=faces))
    assert opaque.fingerprint().parts != document.fingerprint().parts


def test_an_archive_whose_members_would_start_before_it_is_refused():
    data = bytearray(npz(positions=POSITIONS, colours=COLOURS))
    where = len(data) - 6  # of the place of its directory, in the record at its end
    data[where : where + 4] = (int.from_bytes(data[where : where + 4], "little") + 1).to_bytes(4, "little")
    for use in (NpzPointsDocument.coloured_vertices, NpzPointsDocument.fingerprint):
        with pytest.raises(InputError, match="damaged"):
            use(opened(bytes(data)))


HELD, ANNOUNCED = 25_165_937, 100


def archive_with_a_longer_member(checksum):
    """Write an archive of an array and of zeros, of which it announces too few."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("points.npy", "w") as file:
            np.save(file, np.zeros((4, 3)))
        archive.writestr("zeros.bin", bytes(HELD))
    # Sizes stand after checksums, in headers and in the directory: PKWARE's APPNOTE.TXT, section 4.3.
    was = struct.pack("<I", HELD)
    assert buffer.getvalue().count(was) == 2
    found = struct.pack("<I", zlib.crc32(bytes(HELD)))
    return (
        buffer.getvalue()
        .replace(was, struct.pack("<I", ANNOUNCED))
        .replace(found, struct.pack("<I", checksum))
    )


@pytest.mark.parametrize("checksum", [zlib.crc32(bytes(HELD)), zlib.crc32(bytes(ANNOUNCED))])
def test_of_a_member_no_more_is_unpacked_than_it_announces(checksum):
    archive = NpzArchive(archive_with_a_longer_member(checksum), "points.npz")
    tracemalloc.start()
    with contextlib.suppress(InputError):  # for its checksum
        assert len(archive.contents()["zeros.bin"]) == ANNOUNCED
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < HELD / 8


def scalars_of_ply(scalars):
    tables = [(name, "float", column) for name, column in zip("xyz", POSITIONS.T, strict=True)]
    tables += [(name, "uchar", column) for name, column in zip(RGB, COLOURS.T, strict=True)]
    tables += [(name, "float", column) for name, column in scalars.items()]
    names, kinds, columns = zip(*tables, strict=True)
    rows = [list(row) for row in zip(*(column.tolist() for column in columns), strict=True)]
    return build(
        [Table("vertex", [*zip(names, kinds, strict=True)], rows)], encoding="binary_little_endian"
    ).data


@pytest.mark.parametrize("form", ["ply", "npz"])
def test_a_scalar_may_be_called_normal_and_capital_letters_tell_scalars_apart(form, tmp_path):
    scalars = {"normal": np.arange(4.0), "Quality": np.arange(4.0) + 1, "quality": np.arange(4.0) + 2}
    arrays = (
        npz(positions=POSITIONS, colours=COLOURS, **scalars) if form == "npz" else scalars_of_ply(scalars)
    )
    (tmp_path / f"a.{form}").write_bytes(arrays)
    document = open_document(str(tmp_path / f"a.{form}"))
    for name, values in scalars.items():
        assert np.array_equal(document.attribute(name)[:, 0], values)
    assert np.array_equal(document.attribute("QUALITY"), document.attribute("Quality"))
