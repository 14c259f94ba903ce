"""Small files that promise huge contents, or images too large for memory, cost no more than a refusal in one line."""

import base64
import functools
import gzip
import io
import json
import os
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable

import numpy as np
import pytest

from beltrami_cli.formats.usd.layers import binary_layer
from cli.commands import refused, run_command
from formats.image_files import encode, png_chunk
from hostile.textured_models import PICTURE, write_model

LIMIT = "300M"
# What the program takes before it has read anything, and the limit: more than that was not taken by the bomb.
MOST = (160 + 300) << 20
# Runs commands in forks of itself, and measures each. What it has loaded counts as their memory, so it loads no more
# than a command does. That each command loads its modules by itself would take most of the time.
MEASURING = """
import contextlib, importlib, json, os, pkgutil, sys
import beltrami_cli.formats, beltrami_cli.jobs.smooth, beltrami_cli.cli.commands.smooth
from beltrami_cli.cli import main as command

for module in pkgutil.walk_packages(beltrami_cli.formats.__path__, "beltrami_cli.formats."):
    if ".usd." not in module.name:  # which takes a process of its own
        with contextlib.suppress(ImportError):
            importlib.import_module(module.name)
for line in sys.stdin:
    said, *arguments = json.loads(line)
    child = os.fork()
    if child == 0:
        os.dup2(os.open(said, os.O_WRONLY | os.O_CREAT), 2)
        sys.argv = ["beltrami", *arguments]
        code = 1
        try:
            command.main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        finally:
            sys.stderr.flush()
            os._exit(code)
    _, status, used = os.wait4(child, 0)
    seconds = used.ru_utime + used.ru_stime
    print(json.dumps([os.waitstatus_to_exitcode(status), used.ru_maxrss << 10, seconds]), flush=True)
"""
COLOURS = (f"property uchar {name}" for name in ("red", "green", "blue"))
VERTICES = "\n".join([*(f"property float {axis}" for axis in "xyz"), *COLOURS])


def ply(*lines, body=b""):
    header = "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""])
    return header.encode() + body


def png(width, height, data, *chunks, colour=2):
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, colour, 0, 0, 0))
    pixels = png_chunk(b"IDAT", data) + png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + header + b"".join(chunks) + pixels


Data = bytes | Callable[[], bytes]


def made(data):
    """What takes long to make is made when it is needed."""
    return data if isinstance(data, bytes) else data()


def file(name, data):
    def make(folder):
        (folder / name).write_bytes(made(data))
        return folder / name

    return make


def gltf(tree):
    return file("a.gltf", json.dumps({"asset": {"version": "2.0"}, **tree}).encode())


def accessor(count, kind=5126, shape="VEC3", **more):
    return {"componentType": kind, "count": count, "type": shape, **more}


def primitive(**more):
    return {"attributes": {"POSITION": 0, "COLOR_0": 1}, **more}


def coloured(position, colour, *others, primitives=None, **more):
    """A glTF whose primitives are of two accessors, and maybe of others."""
    meshes = [{"primitives": primitives or [primitive()]}]
    return gltf({"accessors": [position, colour, *others], "meshes": meshes, **more})


def buffer_of(size):
    """Return a buffer of zeros and a view of all of it."""
    uri = "data:;base64," + base64.b64encode(bytes(size)).decode()
    return {"buffers": [{"byteLength": size, "uri": uri}], "bufferViews": [{"buffer": 0, "byteLength": size}]}


def packed_elements(count):
    """Few compressed bytes that claim to be many elements."""
    tree, length = buffer_of(8), 12 * count
    packed = {"buffer": 0, "byteLength": 8, "byteStride": 12, "count": count, "mode": "ATTRIBUTES"}
    tree["buffers"].append({"byteLength": length})
    view = {"buffer": 1, "byteLength": length, "byteStride": 12}
    tree["bufferViews"] = [{**view, "extensions": {"EXT_meshopt_compression": packed}}]
    return coloured(*[accessor(count, bufferView=0)] * 2, extensionsUsed=["EXT_meshopt_compression"], **tree)


def with_texture(image):
    def make(folder):
        path = write_model(folder, "ply", "bomb.png")
        (folder / "bomb.png").write_bytes(made(image))
        return path

    return make


def sparse_file(folder):
    """A file of a tebibyte that takes no room on the disk."""
    path = folder / "sparse.ply"
    path.write_bytes(b"ply\n")
    os.truncate(path, 1 << 40)
    return path


def with_library(text):
    def make(folder):
        path = write_model(folder, "obj", "")
        (folder / "m.mtl").write_text(text)
        return path

    return make


@functools.cache
def zeros(count):
    """As much as can be compressed to next to nothing."""
    return zlib.compress(bytes(count), 9)


def equal_points(count):
    """A small archive of many points in one place."""

    def make(folder):
        arrays = {"positions": np.zeros((count, 3), np.float32), "intensity": np.zeros(count, np.uint8)}
        np.savez_compressed(folder / "a.npz", **arrays)
        return folder / "a.npz"

    return make


def package(relationships):
    """A 3MF file that names where it starts."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("_rels/.rels", relationships)
    return content.getvalue()


def crate(section):
    """A binary USD layer in which a section claims to have 2^28 entries, of 4 to 24 bytes in memory each."""

    def make():
        pytest.importorskip("pxr", reason="usd-core is not installed")
        layer = bytearray(binary_layer(SCENE, "a.usdc"))
        (contents,) = struct.unpack_from("<Q", layer, 16)
        (count,) = struct.unpack_from("<Q", layer, contents)
        sections = (struct.unpack_from("<16sQQ", layer, contents + 8 + 32 * i) for i in range(count))
        starts = {name.rstrip(b"\0").decode(): start for name, start, _ in sections}
        struct.pack_into("<Q", layer, starts[section], 1 << 28)
        return bytes(layer)

    return make


def scan(suffix, count=1 << 24):
    """A scan of a few points that announces many more, of 30 bytes each."""

    def make(folder):
        laspy = pytest.importorskip("laspy", reason="laspy is not installed")
        cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.2"))
        cloud.xyz, cloud.red = np.zeros((9, 3)), np.arange(9)
        cloud.write(path := folder / f"a.{suffix}")
        data = bytearray(path.read_bytes())
        struct.pack_into("<I", data, 107, count)
        path.write_bytes(data)
        return path

    return make


def equal_scan(folder, count=1 << 22):
    """A scan of many points in one place, of which each takes no bit, and more than 20 bytes in memory."""
    pytest.importorskip("pye57", reason="pye57 is not installed")
    from pye57 import libe57

    file = libe57.ImageFile(str(folder / "a.e57"), "w")
    scan, prototype = libe57.StructureNode(file), libe57.StructureNode(file)
    for name in ("cartesianX", "cartesianY", "cartesianZ"):
        prototype.set(name, libe57.ScaledIntegerNode(file, 0, 0, 0, 1.0, 0.0))
    points = libe57.CompressedVectorNode(file, prototype, libe57.VectorNode(file, True))
    scans = libe57.VectorNode(file, True)
    file.root().set("data3D", scans)
    scan.set("points", points)
    scans.append(scan)
    nothing, buffers = np.zeros(count, np.int64), libe57.VectorSourceDestBuffer()
    for name in ("cartesianX", "cartesianY", "cartesianZ"):
        buffers.append(libe57.SourceDestBuffer(file, name, nothing, count, True, False))
    writer = points.writer(buffers)
    writer.write(count)
    writer.close()
    file.close()
    return folder / "a.e57"


PCD = b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 9999999\nHEIGHT 1\nPOINTS 9999999\n"
SCENE = b"""#usda 1.0
def Mesh "a"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1)] (interpolation = "vertex")
}
"""
SECTIONS = ("TOKENS", "FIELDSETS", "SPECS")
MANY = 1_000_000
CROWD = {"nodes": [{"children": [i + 1]} if i < 19_999 else {} for i in range(20_000)]}
NESTED = b'{"asset":' + b"[" * 200_000 + b"]" * 200_000 + b"}"
REPEATED = b"{" + b",".join(b'"%d":0' % i for i in range(200_000)) + b',"199999":1}'
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n"
LONG_LIST, MAX_ENTRIES = (
    ("element face 1", "property list int int vertex_indices"),
    struct.pack("<i", 2**31 - 1),
)
BOMBS = {
    "rows": file("a.ply", ply("element vertex 100000000000000000", VERTICES)),
    "rows of nothing": file("a.ply", ply("element ghost 100000000000000000", "element vertex 3", VERTICES)),
    "properties": file("a.ply", ply("element vertex 1", *(f"property char p{i}" for i in range(200_000)))),
    "elements": file("a.ply", ply(*(f"element e{i} 0" for i in range(200_000)))),
    "list": file("a.ply", ply("element vertex 1", VERTICES, *LONG_LIST, body=bytes(15) + MAX_ENTRIES)),
    "sparse file": sparse_file,
    "elements without bytes": coloured(accessor(2**31 - 1), accessor(2**31 - 1, 5121, normalized=True)),
    "packed elements": packed_elements(1 << 27),
    "buffer": gltf({"buffers": [{"byteLength": 2**40, "uri": "data:;base64,AAAA"}]}),
    "chunk": file("a.glb", struct.pack("<4sIIII", b"glTF", 2, 20, 2**32 - 1, 0x4E4F534A)),
    "nested": file("a.gltf", NESTED),
    "repeated keys": file("a.gltf", REPEATED),
    "scenes of all nodes": gltf({**CROWD, "scenes": [{"nodes": [0]}] * 20_000}),
    "triangles drawn again": coloured(
        accessor(100, bufferView=0),
        accessor(100, 5121, bufferView=0, normalized=True),
        *(accessor(50_000, 5121, "SCALAR", bufferView=0, byteOffset=i) for i in range(3000)),
        primitives=[primitive(indices=i) for i in range(2, 3002)],
        **buffer_of(60_000),
    ),
    "words of mtllib": file("a.obj", f"mtllib {'m ' * 100_000}\n{SQUARE}".encode()),
    "names of mtllib": file("a.obj", (SQUARE + "mtllib m.mtl\n" * 50_000).encode()),
    "missing maps": with_library("newmtl m\n" + "".join(f"map_Kd {i}.png\n" for i in range(20_000))),
    "blanks behind newmtl": with_library(f"newmtl{' ' * MANY}\n"),
    "digits in an option": with_library(f"newmtl m\nmap_Kd -s {'1' * MANY}x a.png\n"),
    "blanks behind TextureFile": file(
        "a.ply", ply(f"comment TextureFile{' ' * MANY}", "element vertex 1", "property float x")
    ),
    "relationships without end": file("a.3mf", lambda: package("<Relationship " * MANY)),
    "points in one place": equal_points(10 * MANY),
    "a line of corners": file("a.obj", (SQUARE + "f" + " 1 2 3" * MANY + "\n").encode()),
    "a line of coordinates": file("a.obj", ("v" + " 1 2 3" * MANY + f"\n{SQUARE}").encode()),
    "continued lines": file("a.obj", (SQUARE + "f" + " 1 2 3\\\n" * MANY + "\n").encode()),
    "a line of points": file("a.xyz", b"1 2 3 4 5 6 " * MANY),
    "a line of OFF": file("a.off", b"OFF\n3 1 0\n" + b"1 2 3 " * MANY),
    "a member of blanks": lambda folder: file("a.3mf", package(" " * (70 * MANY)))(folder),
    "comments before OFF": file("a.off", b"#\n" * MANY * 10),
    "pixels by the header": with_texture(png(65535, 65535, zlib.compress(b""))),
    "pixels that are there": with_texture(lambda: png(8192, 8192, zeros(8192 * (3 * 8192 + 1)))),
    "profile": with_texture(lambda: png(4, 4, b"", png_chunk(b"iCCP", b"a\0\0" + zeros(1 << 28)))),
    "text": with_texture(lambda: png(4, 4, b"", png_chunk(b"zTXt", b"a\0\0" + zeros(1 << 28)))),
    "archive": file("a.obj", b"PK\x03\x04" + bytes(100)),
    "compressed": file("a.ply", lambda: gzip.compress(bytes(1 << 24))),
    "columns of points": file("a.csv", b"1," * MANY + b"1\n" + b"2," * MANY + b"1\n"),
    "points of LAS": scan("las"),
    "points of LAZ": scan("laz"),
    "points of E57": equal_scan,
    "points of PCD": file("a.pcd", PCD + b"DATA binary\n" + bytes(120)),
    "lines of PCD": file("a.pcd", PCD + b"DATA ascii\n" + b"1 2 3\n" * 3),
    **{f"entries of {section}": file("a.usdc", crate(section)) for section in SECTIONS},
}


# What the longest line and the largest ratio of archives keep out where memory is not limited, and so where it is.
UNLIMITED = [
    "points in one place", "a line of corners", "a line of coordinates", "continued lines", "a line of points",
    "a line of OFF", "points of LAS", "points of LAZ", "points of E57", "a member of blanks", "packed elements",
    *(f"entries of {section}" for section in SECTIONS),
]  # fmt: skip


@pytest.fixture(scope="module")
def measured():  # its processor time counts for the last test
    """Returns the exit code of a command, what it said, the most memory that it took in bytes, and its seconds."""
    with subprocess.Popen(
        [sys.executable, "-P", "-c", MEASURING], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
    ) as process:  # fmt: skip

        def run(said, *arguments):
            process.stdin.write(json.dumps([str(said), *map(str, arguments)]) + "\n")
            process.stdin.flush()
            code, memory, seconds = json.loads(process.stdout.readline())
            return code, said.read_text(), memory, seconds

        yield run


@pytest.mark.slow
@pytest.mark.parametrize("bomb", BOMBS)
def test_bombs_are_refused_in_one_line_and_little_memory(bomb, measured, tmp_path, tmp_path_factory):
    model = BOMBS[bomb](tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    out = tmp_path / ("out.ply" if model.suffix in (".3mf", ".off") else f"out{model.suffix}")
    limit = () if bomb in UNLIMITED else ("--max-memory", LIMIT)
    code, said, memory, seconds = measured(
        tmp_path_factory.mktemp("said") / "said", "smooth", model, out, "--threads", "1", *limit
    )
    assert (code, said.count("\n")) == (3, 1), said
    assert "Traceback" not in said
    assert len(said) < 1000
    assert memory < MOST, f"{memory >> 20} MiB"
    assert seconds < 10, said
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.slow
def test_a_large_image_is_smoothed_where_there_is_room(tmp_path):
    model = with_texture(PICTURE)(tmp_path)
    assert run_command("smooth", model, tmp_path / "out.ply", "--max-memory", LIMIT).returncode == 0


# The largest that is read; there are no pixels behind the header, so decoding would say "damaged".
SIDE = 16384
# Decoded, one takes 256 MB, which fits, and for every use at least 2 bytes per pixel more, which do not.
IMAGE_LIMIT = "512M"
# Jobs that recolour keep their arrays in files then; other jobs on all pixels take at least 28 bytes per pixel.
LIMIT_IN_MEMORY = "7G"


COMMANDS = [
    "info large.png", "smooth large.png out.png", "smooth large.png out.jpg -n 0",
    "noise large.png out.png --sigma 5%", "kernel large.png out.png --at 5,5", "compare large.png large.png",
    "report large.png large.png out.html", "render large.png out.png", "sweep large.png out.png --beta 1,2",
    "view large.png --no-open", "smooth small.png out.png --height large.png",
    "smooth small.png out.png --positions large.png", "smooth small.png out.png --mask large.png",
    "smooth small.png out.png --guide large.png", "smooth small.png out.png --noise large.png", "info model.obj",
    "smooth model.obj out.obj", "smooth model.obj out.glb --unwrap", "level model.obj out.obj",
    "noise model.obj out.obj --sigma 5%", "kernel model.obj out.png --at 0.5,0.5", "check model.obj other.obj",
    "compare model.obj other.obj", "report model.obj other.obj out.html", "render model.obj out.png",
    "bake model.obj out.ply --to vertices",
]  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("large")
    large = png(SIDE, SIDE, zlib.compress(b""), colour=0)
    (folder / "large.png").write_bytes(large)
    (folder / "other.png").write_bytes(large + b"\0")
    (folder / "small.png").write_bytes(encode(np.full((8, 8, 1), 99, np.uint8), "png"))
    for name, image in (("other", "other.png"), ("model", "large.png")):
        write_model(folder, "obj", image, f"{name}.mtl").rename(folder / f"{name}.obj")
    return folder


_JOBS = tuple(f"{name} large" for name in ("noise", "kernel", "compare", "report"))
IN_MEMORY = [each for each in COMMANDS if each.startswith(_JOBS)]


LIMITED = [(IMAGE_LIMIT, each) for each in COMMANDS] + [(LIMIT_IN_MEMORY, each) for each in IN_MEMORY]


@pytest.mark.slow
@pytest.mark.parametrize(("limit", "command"), LIMITED)
def test_what_does_not_fit_is_refused_before_it_is_decoded(limit, command, folder):
    said = refused(folder, *command.split(), "--max-memory", limit, code=3)
    assert "fit into memory" in said, said
    assert "raise --max-memory" in said
