"""Points in NumPy archives and in LAS, LAZ, E57 and PCD files: colours alone change, all else stays value for value."""

import contextlib
import importlib.util
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
from beltrami_cli.formats.registry import open_document
from cli.commands import beltrami, refused
from formats.gltf_files import patched
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


SIDE = 20
RNG = np.random.default_rng(7)
COUNT = SIDE * SIDE
XYZ = np.array([[n % SIDE, n // SIDE, np.sin(n % SIDE / 5)] for n in range(COUNT)])
SHADES = np.rint(120 + 15 * RNG.standard_normal((COUNT, 3))).astype(np.uint8)
INTENSITY = np.rint(3000 + 200 * RNG.standard_normal(COUNT)).astype(np.uint16)
LABELS = np.arange(COUNT)


def needs(*modules):
    lacks = [module for module in modules if importlib.util.find_spec(module) is None]
    return pytest.mark.skipif(bool(lacks), reason=f"not installed: {', '.join(lacks)}")


def las(path, *, point_format, colours):
    import laspy

    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales, header.system_identifier = [0.001] * 3, "a scanner"
    header.vlrs.append(laspy.VLR("someone", 4, "a record", b"its bytes"))
    header.add_extra_dim(laspy.ExtraBytesParams("depth", np.float32))
    cloud = laspy.LasData(header)
    cloud.xyz, cloud.intensity, cloud.classification, cloud.depth = XYZ, INTENSITY, LABELS % 9, LABELS / 7
    if colours:
        cloud.red, cloud.green, cloud.blue = SHADES.T.astype(np.uint16) * 257
    cloud.evlrs = laspy.vlrs.vlrlist.VLRList()
    cloud.evlrs.append(laspy.VLR("someone", 9, "a long one", b"x" * 70_000))
    cloud.write(str(path))
    # What laspy never writes: no date, an extent beyond the points, and unused bytes of a dimension.
    data = bytearray(path.read_bytes())
    data[90:94], data[179:187] = bytes(4), struct.pack("<d", 1000.5)
    at = data.index(b"depth\0") + 36
    data[at : at + 8] = b"unused.."
    path.write_bytes(data)


def copc(path, **options):
    """Records of an index among others: the first one, and an extended one."""
    import laspy

    las(path, **options)
    cloud = laspy.read(path)
    cloud.vlrs.insert(0, laspy.VLR("copc", 1, "info", bytes(160)))
    cloud.evlrs.append(laspy.VLR("copc", 1000, "hierarchy", bytes(32)))
    cloud.write(path)


def e57(path, *, point_format, colours):
    import pye57
    from pye57 import libe57

    with pye57.E57(str(path), "w") as file:
        for part in (slice(0, COUNT // 2), slice(COUNT // 2, COUNT)):
            columns = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), XYZ[part].T, strict=True))
            columns |= {
                "intensity": INTENSITY[part] / 4096,
                "rowIndex": LABELS[: COUNT // 2],
                "columnIndex": LABELS[: COUNT // 2],
            }
            if colours:
                columns |= zip(("colorRed", "colorGreen", "colorBlue"), SHADES[part].T, strict=True)
            file.write_scan_raw(columns, rotation=np.array([1, 0, 0, 0]), translation=np.array([0, 0, 5.0]))
        picture = libe57.StructureNode(file.image_file)
        blob = libe57.BlobNode(file.image_file, 100)
        picture.set("jpegImage", blob)
        file.root["images2D"].append(picture)
        blob.write(np.full(100, ord("p"), np.uint8), 0, 100)


def pcd(path, *, point_format, colours):
    """Fields with padding; compressed ones are runs of literal bytes, as LZF allows."""
    packed = (SHADES.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=1, dtype=np.uint32)
    fields = [("x", "<f4", XYZ[:, 0]), ("y", "<f4", XYZ[:, 1]), ("z", "<f4", XYZ[:, 2]), ("_", "<u4", LABELS)]
    fields += [("rgb", "<f4", packed.view("<f4"))] if colours else [("intensity", "<u2", INTENSITY)]
    records = np.array([*zip(*(each[2] for each in fields), strict=True)], [(n, k) for n, k, _ in fields])
    names, sizes, kinds = zip(*((n, k[2], k[1].upper()) for n, k, _ in fields), strict=True)
    head = f"# .PCD v0.7 - by a test\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE {' '.join(sizes)}\n"
    head += f"TYPE {' '.join(kinds)}\nCOUNT {'1 ' * len(fields)}\nWIDTH {COUNT}\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {COUNT}\nDATA {point_format}\n"
    body = records.tobytes()
    if point_format == "ascii":  # in columns, as PCL has it, with fields as PDAL names them
        body = "".join("  ".join(map(str, row)) + "\n" for row in records).encode()
        head = head.replace("FIELDS x y z", "FIELDS X Y Z")
    elif point_format == "binary_compressed":
        columns = b"".join(records[name].tobytes() for name in names)
        runs = b"".join(b"\x1f" + columns[at : at + 32] for at in range(0, len(columns) - 32, 32))
        last = columns[len(runs) // 33 * 32 :]
        packed_size = len(runs) + 1 + len(last)
        body = struct.pack("<II", packed_size, len(columns)) + runs + bytes([len(last) - 1]) + last
    path.write_bytes(head.encode() + body)


KINDS = [
    *((las, "las", form, colours, ["laspy"]) for form, colours in ((3, True), (6, False), (7, False))),
    *((las, "laz", form, colours, ["laspy", "lazrs"]) for form, colours in ((1, False), (7, True))),
    (copc, "laz", 7, True, ["laspy", "lazrs"]),
    *((e57, "e57", None, colours, ["pye57"]) for colours in (True, False)),
    (pcd, "pcd", "ascii", True, ["pypcd4"]),
    (pcd, "pcd", "binary", False, ["pypcd4"]),
    (pcd, "pcd", "binary_compressed", True, ["pypcd4"]),
]


@pytest.mark.slow  # four times a library in a process of its own
@pytest.mark.parametrize(
    ("write", "suffix", "form", "colours"),
    [pytest.param(*each, marks=needs(*lacks)) for *each, lacks in KINDS],
)
def test_colours_or_intensities_alone_change(tmp_path, write, suffix, form, colours):
    write(tmp_path / f"in.{suffix}", point_format=form, colours=colours)
    fixed = ("-n", 3, "--beta", 1, "--fast")  # chosen parameters would take longer than the files
    done = beltrami("smooth", f"in.{suffix}", f"out.{suffix}", *fixed, cwd=tmp_path, text=True)
    assert ("The index of COPC is left out" in done.stderr) == (write is copc)
    assert b"copc" not in (tmp_path / f"out.{suffix}").read_bytes()
    documents = [open_document(str(tmp_path / f"{stem}.{suffix}")) for stem in ("in", "out")]
    before, after = (document.fingerprint() for document in documents)
    assert after.parts == before.parts  # all but colours, by which `check` finds other differences
    old, new = (document.coloured_vertices() for document in documents)
    np.testing.assert_allclose(old.positions, XYZ + ([0, 0, 5] if suffix == "e57" else 0), atol=1e-3)
    expected = SHADES / 255 if colours else INTENSITY[:, None] / (4096 if suffix == "e57" else 4095)
    np.testing.assert_allclose(old.colours, expected, atol=1e-6)
    assert (new.colours.std(axis=0) < 0.5 * expected.std(axis=0)).all()
    if suffix == "e57":
        assert after.parts["blobs"].endswith(b"p" * 100)


# Names of parameters of NumPy's functions, of tables of beltrami, and of what the file holds otherwise.
NAMES = ("file", "allow_pickle", "args", "json", "self", "positions", "colours", "faces", "header", "opacity")


def text_pcd(fields):
    """Return a PCD file of numbers as text, with these fields."""
    names, columns = zip(*fields.items(), strict=True)
    kinds = ["F" if column.dtype.kind == "f" else "U" for column in map(np.asarray, columns)]
    head = f"VERSION 0.7\nFIELDS {' '.join(names)}\nSIZE {'4 ' * len(names)}\nTYPE {' '.join(kinds)}\n"
    head += f"COUNT {'1 ' * len(names)}\nWIDTH {COUNT}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {COUNT}\n"
    rows = zip(*(np.asarray(column).tolist() for column in columns), strict=True)
    return (head + "DATA ascii\n" + "".join(" ".join(map(str, row)) + "\n" for row in rows)).encode()


def named_las(path, shift=0):
    import laspy

    header = laspy.LasHeader(point_format=3, version="1.4")
    header.scales = [0.001] * 3
    for name in NAMES:
        header.add_extra_dim(laspy.ExtraBytesParams(name, np.float32))
    points = laspy.ScaleAwarePointRecord.zeros(COUNT, header=header)  # `LasData` has no fields of some names
    columns = dict(zip(("red", "green", "blue"), SHADES.T.astype(np.uint16) * 257, strict=True))
    columns |= zip("XYZ", np.rint(XYZ * 1000).astype(np.int32).T, strict=True)
    columns |= {name: LABELS + number + shift for number, name in enumerate(NAMES)}
    for name, column in columns.items():
        points.array[name] = column
    with laspy.open(path, "w", header=header) as file:
        file.write_points(points)


def named_pcd(path, shift=0):
    columns = dict(zip("xyz", XYZ.T, strict=True)) | dict(zip("rgb", SHADES.T.astype(np.uint32), strict=True))
    path.write_bytes(text_pcd(columns | {name: LABELS + n + shift for n, name in enumerate(NAMES)}))


@pytest.mark.slow  # twice a library in a process of its own
@pytest.mark.parametrize(
    "write",
    [pytest.param(named_las, marks=needs("laspy")), pytest.param(named_pcd, marks=needs("pypcd4"))],
)
def test_fields_may_have_any_name(write, tmp_path):
    documents = []
    for shift in (0, 1):
        path = tmp_path / f"{shift}.{write.__name__[-3:]}"
        write(path, shift)
        documents.append(open_document(str(path)))
    one = documents[0]
    np.testing.assert_allclose(one.coloured_vertices().colours, SHADES / 255, atol=1e-6)
    assert {*NAMES} <= {*one.attributes()}
    for number, name in enumerate(NAMES):
        assert np.array_equal(one.attribute(name)[:, 0], LABELS + number)
    old, new = (document.fingerprint().parts for document in documents)
    differing = {name for name in old if old[name] != new[name]}
    assert differing - {"header"} == {f"field {name}" for name in NAMES}  # which has the extents of LAS
    assert {f"the field {name}" for name in NAMES} <= {*one.contents().left_out}


@pytest.mark.slow  # five times a library in a process of its own
@needs("pypcd4")
def test_the_names_of_fields_may_be_in_capital_letters(tmp_path):
    axes, shades = dict(zip("XYZ", XYZ.T, strict=True)), SHADES.T.astype(np.uint32)
    normals = dict(
        zip(("Normal_X", "Normal_Y", "Normal_Z"), np.outer([1.0, 0, 0], np.ones(COUNT)), strict=True)
    )
    packed = {
        "RGB": (SHADES.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=1, dtype=np.uint32)
    }
    apart = dict(zip(("Red", "Green", "Blue"), shades, strict=True))
    for colours, expected in (
        (packed, SHADES / 255), (apart, SHADES / 255), ({"Intensity": INTENSITY}, INTENSITY[:, None] / 4095),
    ):  # fmt: skip
        path = tmp_path / "a.pcd"
        path.write_bytes(text_pcd(axes | colours | normals))
        document = open_document(str(path))
        np.testing.assert_allclose(document.coloured_vertices().colours, expected, atol=1e-6)
        assert document.attribute("normal")[0].tolist() == [1, 0, 0]
    new = document.coloured_vertices().colours.copy()
    new[:] = 1
    path.write_bytes(patched(document, new))
    assert (open_document(str(path)).coloured_vertices().colours == 1).all()


@pytest.mark.slow  # a library in a process of its own
@needs("pypcd4")
def test_points_without_colours_are_refused_by_the_names_of_their_fields(tmp_path):
    (tmp_path / "a.pcd").write_bytes(text_pcd(dict(zip("xyz", XYZ.T, strict=True)) | {"label": LABELS}))
    with pytest.raises(NoColoursError, match="no colours and no intensity, but label"):
        open_document(str(tmp_path / "a.pcd")).coloured_vertices()


@pytest.mark.slow  # five times a library in a process of its own
@needs("laspy", "lazrs")
def test_points_are_compressed_and_unpacked(tmp_path):
    las(tmp_path / "in.las", point_format=3, colours=True)
    for source, target in (("in.las", "a.laz"), ("a.laz", "b.las")):
        beltrami("smooth", source, target, "-n", 0, cwd=tmp_path)
    assert (tmp_path / "a.laz").stat().st_size < (tmp_path / "in.las").stat().st_size
    beltrami("check", "in.las", "b.las", cwd=tmp_path)
    beltrami("smooth", "in.las", "c.ply", cwd=tmp_path)
    refused(tmp_path, "smooth", "c.ply", "c.las", code=2, said="a .ply file is not converted to .las")
