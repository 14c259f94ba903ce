"""Points in NumPy archives: which array is what, and that only that of the colours changes."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.points.archive import NpzPointsDocument, write_npz
from formats.points_files import patched
from formats.volume_files import npz

POSITIONS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
COLOURS = np.array([[0, 51, 255], [10, 20, 30], [40, 50, 60], [70, 80, 90]], np.uint8)


def opened(data, access=None):
    return NpzPointsDocument(data, "cloud.npz", None, access or Access())


def unnpz(data):
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return dict(archive)


@pytest.mark.parametrize("position_key", ["positions", "points", "xyz"])
@pytest.mark.parametrize(
    ("key", "values", "channels", "first"),
    [
        ("colours", COLOURS, 3, [0, 0.2, 1]),
        ("colors", COLOURS.astype(np.uint16) * 257, 3, [0, 0.2, 1]),
        ("rgb", COLOURS.astype(np.int64), 3, [0, 0.2, 1]),
        ("rgb", COLOURS / 255, 3, [0, 0.2, 1]),
        ("rgba", np.column_stack([COLOURS, COLOURS[:, 0]]), 3, [0, 0.2, 1]),
        ("point_colors", COLOURS[:, 1:2], 1, [0.2]),
        ("point_colours", COLOURS[:, :2].astype(np.float32)[:, ::-1] / 255, 1, [0.2]),
        ("colours", COLOURS[:, 1], 1, [0.2]),
        ("intensity", COLOURS[:, 1].astype(np.float16), 1, [0.2]),
        ("intensities", np.array([-500.0, 100, 200, 1000]), 1, [-0.5]),
    ],
)
def test_arrays_are_known_by_their_names(position_key, key, values, channels, first):
    painted = opened(npz(**{position_key: POSITIONS, key: values})).painted()
    assert np.array_equal(painted.positions, POSITIONS)
    assert painted.colours.shape == (4, channels)
    assert np.allclose(painted.colours[0], first, atol=1e-3)
    assert painted.faces.shape == (0, 3)


def test_points_of_two_dimensions_are_a_range_image():
    positions, colours = POSITIONS.reshape(2, 2, 3).copy(), COLOURS.reshape(2, 2, 3)
    positions[0, 1] = np.nan
    document = opened(npz(positions=positions, colours=colours))
    assert document.grid().tolist() == [[0, -1], [1, 2]]
    assert len(document.painted().positions) == 3
    assert "1 of 4 points have no place" in document.notices[0]
    assert opened(npz(positions=POSITIONS, colours=COLOURS)).grid() is None
    new = unnpz(patched(document, np.zeros((3, 3))))["colours"]
    assert new.tolist() == [[[0, 0, 0], [10, 20, 30]], [[0, 0, 0], [0, 0, 0]]]


def test_faces_make_a_mesh():
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    assert opened(npz(xyz=POSITIONS, rgb=COLOURS, faces=faces)).painted().faces.tolist() == faces.tolist()


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
    document = opened(data)
    same = document.painted().colours
    assert patched(document, same) == data
    assert b"".join(document.patch(None, Naming("out")).main) == data
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


def test_opacity_stays():
    rgba = np.column_stack([COLOURS, [9, 8, 7, 6]]).astype(np.uint8)
    document = opened(npz(positions=POSITIONS, rgba=rgba))
    new = unnpz(patched(document, np.ones((4, 3))))["rgba"]
    assert new.tolist() == [[255, 255, 255, alpha] for alpha in (9, 8, 7, 6)]
    assert np.allclose(document.contents().alpha, rgba[:, 3] / 255)


@pytest.mark.parametrize(
    ("arrays", "error", "said"),
    [
        ({"positions": POSITIONS}, UnpaintedError, "no array of colours"),
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
        opened(npz(**arrays)).painted()
    assert "\n" not in str(caught.value)


def test_pickles_are_not_opened_but_stay():
    things = np.array([{"a": 1}, print], dtype=object)
    data = npz(compressed=False, positions=POSITIONS, colours=COLOURS, things=things)
    document = opened(data)
    assert document.attributes() == ()
    result = patched(document, 1 - document.painted().colours)
    with zipfile.ZipFile(io.BytesIO(result)) as new, zipfile.ZipFile(io.BytesIO(data)) as old:
        assert new.read("things.npy") == old.read("things.npy")


def test_arrays_beyond_the_memory_allowed_are_refused_before_they_are_unnpz():
    data = npz(positions=np.zeros((200_000, 3)), colours=np.zeros((200_000, 3), np.uint8))
    assert len(data) < 100_000
    with pytest.raises(InputError, match="raise --max-memory"):
        opened(data, Access(memory=10_000_000)).painted()
    assert len(opened(data, Access(memory=100_000_000)).painted().positions) == 200_000


def test_other_arrays_of_the_points_are_attributes():
    arrays = {"quality": np.arange(4), "normals": POSITIONS, "pose": np.eye(3), "labels": np.array(["a"] * 4)}
    document = opened(npz(points=POSITIONS, rgb=COLOURS, intensity=np.arange(4.0), **arrays))
    assert document.attributes() == ("normal", "intensity", "quality")
    assert document.attribute("Quality").tolist() == [[0], [1], [2], [3]]
    assert np.array_equal(document.attribute("normal"), POSITIONS)


def test_the_fingerprint_of_two_archives_differs_in_colours_alone():
    document = opened(npz(positions=POSITIONS, rgba=np.column_stack([COLOURS, COLOURS[:, 0]])))
    other = opened(patched(document, 1 - document.painted().colours))
    assert other.fingerprint().parts == document.fingerprint().parts
    assert not np.array_equal(other.fingerprint().colours["point colours"], document.painted().colours)
    opaque = opened(npz(positions=POSITIONS, rgba=np.column_stack([COLOURS, COLOURS[:, 1]])))
    assert opaque.fingerprint().parts != document.fingerprint().parts


def test_what_is_written_is_read_back():
    data = npz(positions=POSITIONS, rgba=np.column_stack([COLOURS, COLOURS[:, 0]]), faces=[[0, 1, 2]])
    contents = opened(data).contents()
    again = opened(b"".join(write_npz(contents, "out").main))
    assert np.array_equal(again.painted().positions, POSITIONS)
    assert np.array_equal(again.painted().colours, contents.colours)
    assert again.painted().stored == "uint8"
    assert again.painted().faces.tolist() == [[0, 1, 2]]
    assert np.array_equal(again.contents().alpha, contents.alpha)


def test_an_archive_whose_members_would_start_before_it_is_refused():
    data = bytearray(npz(positions=POSITIONS, colours=COLOURS))
    where = len(data) - 6  # of the place of its directory, in the record at its end
    data[where : where + 4] = (int.from_bytes(data[where : where + 4], "little") + 1).to_bytes(4, "little")
    for use in (NpzPointsDocument.painted, NpzPointsDocument.fingerprint):
        with pytest.raises(InputError, match="damaged"):
            use(opened(bytes(data)))
