"""LAS, LAZ, E57 and PCD: colours or intensities are smoothed, and all else comes back value for value."""

from __future__ import annotations

import importlib.util
import struct

import numpy as np
import pytest

from beltrami_cli.formats.registry import open_document
from cli.commands import beltrami, refused

SIDE = 20
RNG = np.random.default_rng(7)
COUNT = SIDE * SIDE
XYZ = np.array([[n % SIDE, n // SIDE, np.sin(n % SIDE / 5)] for n in range(COUNT)])
COLOURS = np.rint(120 + 15 * RNG.standard_normal((COUNT, 3))).astype(np.uint8)
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
        cloud.red, cloud.green, cloud.blue = COLOURS.T.astype(np.uint16) * 257
    cloud.evlrs = laspy.vlrs.vlrlist.VLRList()
    cloud.evlrs.append(laspy.VLR("someone", 9, "a long one", b"x" * 70_000))
    cloud.write(str(path))


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
                columns |= zip(("colorRed", "colorGreen", "colorBlue"), COLOURS[part].T, strict=True)
            file.write_scan_raw(columns, rotation=np.array([1, 0, 0, 0]), translation=np.array([0, 0, 5.0]))
        picture = libe57.StructureNode(file.image_file)
        blob = libe57.BlobNode(file.image_file, 100)
        picture.set("jpegImage", blob)
        file.root["images2D"].append(picture)
        blob.write(np.full(100, ord("p"), np.uint8), 0, 100)


def pcd(path, *, point_format, colours):
    """Fields with padding; compressed ones are runs of literal bytes, as LZF allows."""
    packed = (COLOURS.astype(np.uint32) << np.array([16, 8, 0], np.uint32)).sum(axis=1, dtype=np.uint32)
    fields = [("x", "<f4", XYZ[:, 0]), ("y", "<f4", XYZ[:, 1]), ("z", "<f4", XYZ[:, 2]), ("_", "<u4", LABELS)]
    fields += [("rgb", "<f4", packed.view("<f4"))] if colours else [("intensity", "<u2", INTENSITY)]
    records = np.array([*zip(*(each[2] for each in fields), strict=True)], [(n, k) for n, k, _ in fields])
    names, sizes, kinds = zip(*((n, k[2], k[1].upper()) for n, k, _ in fields), strict=True)
    head = f"# .PCD v0.7 - by a test\nVERSION 0.7\nFIELDS {' '.join(names)}\nSIZE {' '.join(sizes)}\n"
    head += f"TYPE {' '.join(kinds)}\nCOUNT {'1 ' * len(fields)}\nWIDTH {COUNT}\nHEIGHT 1\n"
    head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {COUNT}\nDATA {point_format}\n"
    body = records.tobytes()
    if point_format == "ascii":
        body = "".join(" ".join(map(str, row)) + "\n" for row in records).encode()
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
    *((e57, "e57", None, colours, ["pye57"]) for colours in (True, False)),
    (pcd, "pcd", "ascii", True, ["pypcd4"]),
    (pcd, "pcd", "binary", False, ["pypcd4"]),
    (pcd, "pcd", "binary_compressed", True, ["pypcd4"]),
]


@pytest.mark.slow  # six times a library in a process of its own
@pytest.mark.parametrize(
    ("write", "suffix", "form", "colours"),
    [pytest.param(*each, marks=needs(*lacks)) for *each, lacks in KINDS],
)
def test_colours_or_intensities_alone_change(tmp_path, write, suffix, form, colours):
    write(tmp_path / f"in.{suffix}", point_format=form, colours=colours)
    beltrami("smooth", f"in.{suffix}", f"out.{suffix}", cwd=tmp_path)
    said = beltrami("check", f"in.{suffix}", f"out.{suffix}", cwd=tmp_path, text=True).stdout
    assert said.endswith("nothing else differs\n")
    old, new = (open_document(str(tmp_path / f"{stem}.{suffix}")).painted() for stem in ("in", "out"))
    np.testing.assert_allclose(old.positions, XYZ + ([0, 0, 5] if suffix == "e57" else 0), atol=1e-3)
    expected = COLOURS / 255 if colours else INTENSITY[:, None] / (4096 if suffix == "e57" else 4095)
    np.testing.assert_allclose(old.colours, expected, atol=1e-6)
    assert (new.colours.std(axis=0) < 0.5 * expected.std(axis=0)).all()
    if suffix == "e57":
        parts = open_document(str(tmp_path / "out.e57")).fingerprint().parts
        assert parts["member blobs.npy"].endswith(b"p" * 100)


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
