"""LAS, LAZ, E57 and PCD files: colours alone change, all else stays value for value."""

import importlib.util
import struct

import numpy as np
import pytest

from beltrami_cli.errors import InputError, NoColoursError
from beltrami_cli.formats.registry import open_document
from cli.commands import beltrami, refused
from formats.gltf_files import patched

SIDE = 20
RNG = np.random.default_rng(7)
COUNT = SIDE * SIDE
XYZ = np.array([[n % SIDE, n // SIDE, np.sin(n % SIDE / 5)] for n in range(COUNT)])
SHADES = np.rint(120 + 15 * RNG.standard_normal((COUNT, 3))).astype(np.uint8)
INTENSITY = np.rint(3000 + 200 * RNG.standard_normal(COUNT)).astype(np.uint16)
LABELS = np.arange(COUNT)
PACKED = (SHADES.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=1, dtype=np.uint32)
OPACITY = LABELS.astype(np.uint32) % 256


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
    fields = [("x", "<f4", XYZ[:, 0]), ("y", "<f4", XYZ[:, 1]), ("z", "<f4", XYZ[:, 2]), ("_", "<u4", LABELS)]
    fields += [("rgb", "<f4", PACKED.view("<f4"))] if colours else [("intensity", "<u2", INTENSITY)]
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


# Of LAS records of the old and the new kind, with colours, with places for colours that are all 0, and without.
KINDS = [
    (las, "las", 3, True, ["laspy"]),
    (las, "las", 7, False, ["laspy"]),
    (las, "laz", 1, False, ["laspy", "lazrs"]),
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
    apart = dict(zip(("Red", "Green", "Blue"), shades, strict=True))
    for colours, expected in (
        ({"RGB": PACKED}, SHADES / 255), (apart, SHADES / 255), ({"Intensity": INTENSITY}, INTENSITY[:, None] / 4095),
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


@pytest.mark.slow  # three times a library in a process of its own
@needs("pypcd4")
def test_opacity_that_is_packed_with_colours_stays_and_can_be_a_guide(tmp_path):
    path = tmp_path / "a.pcd"
    path.write_bytes(text_pcd(dict(zip("xyz", XYZ.T, strict=True)) | {"rgba": PACKED | OPACITY << 24}))
    document = open_document(str(path))
    path.write_bytes(patched(document, np.ones_like(document.coloured_vertices().colours)))
    for each in (document, open_document(str(path))):
        assert np.array_equal(each.attribute("opacity")[:, 0], OPACITY)
    assert np.loadtxt(path, skiprows=10)[:, 3].tolist() == (0xFFFFFF | OPACITY << 24).tolist()


@pytest.mark.slow  # twice a library in a process of its own
@needs("pypcd4")
def test_points_without_a_place_keep_their_spelling(tmp_path):
    path, places = tmp_path / "a.pcd", XYZ.copy()
    places[7] = np.nan
    numbers = text_pcd(dict(zip("xyz", places.T, strict=True)) | {"rgb": PACKED})
    path.write_bytes(numbers.replace(b"\nnan nan nan ", b"\nNaN -nan NAN "))
    document = open_document(str(path))
    colours = document.coloured_vertices().colours
    assert len(colours) == COUNT - 1
    assert b"\nNaN -nan NAN " in patched(document, np.ones_like(colours))


@pytest.mark.slow  # twice a library in a process of its own
@needs("pypcd4")
def test_colours_that_text_cannot_hold_are_refused(tmp_path):
    """Of opaque colours as floats: with red above 127 they are not numbers."""
    path, dark = tmp_path / "a.pcd", (PACKED & 0x7FFFFF | 0xFF << 24).astype(np.uint32).view(np.float32)
    path.write_bytes(text_pcd(dict(zip("xyz", XYZ.T, strict=True)) | {"rgba": dark}))
    document = open_document(str(path))
    with pytest.raises(InputError, match="text cannot hold"):
        patched(document, np.ones_like(document.coloured_vertices().colours))


@pytest.mark.slow  # three times a library in a process of its own
@needs("pypcd4")
@pytest.mark.parametrize("size", [b"1", b"2", b"8"])
def test_only_fields_of_four_bytes_hold_packed_colours(tmp_path, size):
    numbers = text_pcd(dict(zip("xyz", XYZ.T, strict=True)) | {"rgb": OPACITY})
    (tmp_path / "a.pcd").write_bytes(numbers.replace(b"SIZE 4 4 4 4", b"SIZE 4 4 4 " + size))
    with pytest.raises(NoColoursError, match="but rgb"):
        open_document(str(tmp_path / "a.pcd")).coloured_vertices()


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
