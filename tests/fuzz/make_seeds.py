"""Makes the seeds of the fuzzers, a small file for each dialect: `python tests/fuzz/make_seeds.py`."""

from __future__ import annotations

import dataclasses
import io
import json
import random
import sys
import zipfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from beltrami_cli.batch.item import Outcome
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.usd.package import packed as as_package
from formats.gltf_comparison import with_better_image
from formats.gltf_compressed import GRID, draco_model, meshopt_model
from formats.gltf_files import Textured
from formats.gltf_files import coloured as with_levels
from formats.image_files import encode
from formats.ply_files import ENCODINGS, Table, build, coloured
from formats.read_only_files import OBJECT, coff, model, stl, threemf
from formats.usd_files import BOUND, COLOURS, material_text, mesh_text, scene
from formats.usd_files import coloured as with_colours
from fuzz.targets import SEPARATOR

CORE = ("triangulated", "grid", "atlas")
CORPUS = Path(__file__).with_name("corpus")
PIXELS = np.random.default_rng(1).integers(0, 256, (4, 4, 3), np.uint8)
PICTURE = encode(PIXELS, "png")
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
PLACES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
LEVELS = np.array([[255, 0, 0, 255], [0, 128, 0, 255], [0, 0, 64, 0], [9, 8, 7, 6]], "<u1")


def files(main: bytes | str, **others: bytes | str) -> bytes:
    """Join a model and the files beside it; names have a dot for every underscore."""
    parts = [main if isinstance(main, bytes) else main.encode()]
    for name, content in others.items():
        data = content if isinstance(content, bytes) else content.encode()
        parts.append(name.replace("_", ".").encode() + b"\n" + data)
    return SEPARATOR.join(parts)


def ply_seeds() -> dict[str, bytes]:
    seeds = {}
    for encoding in ENCODINGS:
        short = encoding.rpartition("_")[0].rpartition("_")[2] or encoding
        seeds[f"mixed-{short}"] = build(
            coloured(5, [[0, 1, 2], [0, 1, 2, 3], [4, 3, 2, 1, 0]], "uchar", 1), encoding
        ).data
        rows = [[*place, place[0] / 2, place[1] / 2] for place in PLACES.tolist()]
        names = [(name, "float") for name in ("x", "y", "z", "s", "t")]
        face = Table("face", [("vertex_indices", "uchar int"), ("texnumber", "int")], [[[0, 1, 2, 3], 0]])
        text = build([Table("vertex", names, rows), face], encoding, comments=["TextureFile a.png"]).data
        seeds[f"textured-{short}"] = files(text, a_png=PICTURE)
    wedge = Table(
        "face",
        [("vertex_indices", "uchar int"), ("texcoord", "uchar float")],
        [[[0, 1, 2], [0, 0, 1, 0, 1, 1.0]]],
    )
    vertices = Table("vertex", [(axis, "double") for axis in "xyz"], PLACES.tolist())
    seeds["wedges"] = files(
        build([vertices, wedge], ENCODINGS[1], comments=["TextureFile a.png"]).data, a_png=PICTURE
    )
    strip = Table("tristrips", [("vertex_indices", "int int")], [[[0, 1, 2, -1, 1, 2, 3]]])
    properties = [(axis, "float") for axis in "xyz"] + [
        (f"diffuse_{name}", "ushort") for name in ("red", "green", "blue")
    ]
    rows = [[*place, 1, 2, 65535] for place in PLACES.tolist()]
    seeds["strips"] = build([strip, Table("vertex", properties, rows)], ENCODINGS[2], "\r\n").data
    return seeds


def obj_seeds() -> dict[str, bytes]:
    tiles = "mtllib m.mtl\n" + SQUARE.replace("vt 1", "vt 2") + "usemtl a\nf 1/1 2/2 3/3 4/4\n"
    textured = "mtllib m.mtl\n" + SQUARE + "usemtl a b\nf 1/1 2/2 3/3 \\\n4/4\nf -4/-4 -3/-3 -2/-2\nl 1 2\n"
    library = "newmtl a b\nmap_Kd -s 2 2 1 -o .5 0 -clamp on a.png\nbump -bm 1 a.png\n"
    return {
        "coloured": b"v 0 0 0 1 0 0\nv 1 0 0 0 .5 0\r\nv 0 1 0 0 0 1 # c\nf 1 2 3\n",
        "scale": b"v 0 0 0 255 0 0 1\nv 1 0 0 0 128 0 1\nv 0 1 0 7 8 9 0\nf 1//1 2//1 3//1\nvn 0 0 1\n",
        "polypaint": (SQUARE + "#MRGB ff102030FFaAbBcC00000000ff7f80ff\nf 1 2 3 4\n").encode(),
        "textured": files(textured, m_mtl=library, a_png=PICTURE),
        "tiles": files(
            tiles, m_mtl="newmtl a\nmap_Kd a.<UDIM>.png\n", a_1001_png=PICTURE, a_1002_png=PICTURE
        ),
    }


def gltf_seeds() -> dict[str, bytes]:
    chance, seeds = np.random.default_rng(7), {}
    for arrangement, kind, mode in (
        ("dense", "u1", 4),
        ("interleaved", "f4", 5),
        ("sparse on zeros", "u2", 6),
    ):
        model = with_levels(arrangement, chance, kind, count=4).model
        corners = model.indices(np.array([0, 1, 2, 0, 2, 3], "<u2"))
        model.tree["meshes"][0]["primitives"][0] |= {"mode": mode, "indices": corners}
        seeds[arrangement.replace(" ", "-")] = model.glb()
    seeds["text"] = model.data_text(indent=1)
    seeds["buffer"] = files(model.text("b.bin"), b_bin=bytes(model.binary))
    levels = chance.integers(0, 256, (len(GRID), 4)).astype("u1")
    seeds |= {"draco": draco_model(levels).glb(), "meshopt": meshopt_model(levels).glb()}
    for known in ("ktx2", "avif"):
        seeds[f"textured-{known}"] = with_better_image(known, stored_as(known)).glb()
    for place in ("view", "data"):
        textured = Textured(place)
        transform = {"KHR_texture_transform": {"scale": [2, 2]}}
        info = {"index": textured.texture(textured.image(PICTURE)), "extensions": transform}
        material = textured.material("skin", baseColor=info, emissive=0)
        textured.triangles(PLACES, PLACES[:, :2], material, corners=[0, 1, 2, 0, 2, 3])
        seeds[f"textured-{place}"] = textured.glb() if place == "view" else textured.data_text()
    return seeds


def stored_package() -> bytes:
    """Return a package with directories, dates and remarks, as another program makes them."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in (("b.usdc", b"PXR-USDC"), ("0/", b""), ("0/é.jpg", b"image")):
            archive.writestr(zipfile.ZipInfo(name, (2024, 2, 29, 1, 2, 4)), data)
        archive.comment = b"remark"
    return made.getvalue()


def stored_threemf() -> bytes:
    """Return a file whose members are not compressed, which would leave nothing for a fuzzer to see."""
    stored = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(threemf(model(OBJECT)))) as old, zipfile.ZipFile(stored, "w") as new:
        for member in old.namelist():
            new.writestr(zipfile.ZipInfo(member), old.read(member))
    return stored.getvalue()


def image_seeds(chance: np.random.Generator) -> dict[str, bytes]:
    integers = ("png", "jpeg", "tiff", "bmp", "targa", "webp", "ppm", "dpx", "sgi", "fits", "rla")
    images = {kind: encode(chance.integers(0, 256, (3, 5, 3), np.uint8), kind) for kind in integers}
    images |= {kind: encode(chance.random((3, 5, 3), np.float32), kind) for kind in ("openexr", "hdr")}
    flat = np.full((40, 40, 3), 90, np.uint8)  # encoders of these fail on very few pixels
    images |= {kind: encode(flat, kind) for kind in ("jpegxl", "jpeg2000")}
    return images | {kind: stored_as(kind) for kind in ("ktx2", "avif")}


def stored_as(kind: str) -> bytes:
    return write_image(new_image(PIXELS, "x"), PIXELS, suffix=f".{kind}").data


def other_seeds() -> dict[str, dict[str, bytes]]:
    packed = io.BytesIO()
    np.savez(packed, positions=PLACES, colours=LEVELS[:, :3])
    volume = io.BytesIO()
    np.savez(volume, values=np.arange(27, dtype="f4").reshape(3, 3, 3) - 13, spacing=[1, 1, 1.0])
    nrrd = "NRRD0004\ntype: float\ndimension: 3\nsizes: 2 2 2\nencoding: raw\nendian: little\nspacings: 1 1 1\n\n"
    chance = np.random.default_rng(5)
    images = image_seeds(chance)
    return {
        "off": {
            "float": coff("float"),
            "integer": coff("integer", "CN", "0 0 1"),
            "faces": b"OFF 3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 9 8 7\n",
        },
        "stl": {"viscam": stl([1 << 15, 0]), "magics": stl([31, 1 << 15], b"COLOR=\x00\xff\x00\xff")},
        "3mf": {"stored": stored_threemf()},
        "usd": {
            "scene": files(
                scene(mesh_text(BOUND + with_colours(COLOURS[:64])), material_text("a.png")), a_png=PICTURE
            )
        },
        "usdz": {
            "stored": b"".join(as_package({"a.usda": b"#usda 1.0\n", "0/a.png": PICTURE})),
            "other": stored_package(),
            "nameless": b"".join(as_package({"a.usda": b"#usda 1.0\n", "": b""})),
        },
        "xyz": {
            "levels": b"0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n",
            "shares": b"0 0 0 1 0 0\n1 0 0 0 .5 0\n",
        },
        "npz": {"cloud": packed.getvalue()},
        "volume": {"npz": volume.getvalue(), "nrrd": nrrd.encode() + np.arange(8, dtype="<f4").tobytes()},
        "image": {kind: bytes([{"targa": 1, "rla": 4}.get(kind, 0)]) + data for kind, data in images.items()},
        "core": {name: bytes([number]) + _varied(number) for number, name in enumerate(CORE)},
        "arrays": {
            "plain": bytes([1, 16, 0, 0, 0, 0, 6, 0]) + chance.random(120).tobytes(),
            "guided": bytes([2, 64, 200, 1, 1, 1, 7, 1]) + chance.random(300).tobytes(),
            "cloud": bytes([1, 16, 0, 0, 0, 0, 14, 0]) + chance.random(240).tobytes(),
        },
    }


def data_seeds() -> dict[str, dict[str, bytes]]:
    """Text files that are read as data; the first byte of a manifest says its kind."""
    options = b'iterations = 3\nbeta = 8.5\nchannels = ["red", "green"]\nspace = "linear"\nfast = true\n'
    line = b'{"input": "a.ply", "output": "b/c.ply", "beta": 8, "guides": ["normal"]}\n'
    written = {"vertices": {"noise": {"red": 0.1}, "change": {"mean": 0.2}}, "warnings": ["x"]}
    outcomes = [
        Outcome("a.ply", "b.ply", "started"),
        Outcome("a.ply", "b.ply", "done", "0" * 64, report=written),
    ]
    outcomes.append(Outcome("s3://a/b.ply", "s3://c/d.ply", "done", read={"s3://a/b.ply": "f" * 64}))
    record = "".join(json.dumps(dataclasses.asdict(outcome)) + "\n" for outcome in outcomes)
    report = {
        "parameters": {"beta": 8, "free": ["t"], "x": {"y": 1}},
        "stages": {"read": {"wall": 0.5, "cpu": 1}},
    }
    return {
        "configuration": {
            "own": b"threads = 2\n[smooth]\n" + options,
            "shared": b"[tool.beltrami]\nthreads = 2\n[tool.beltrami.batch]\njobs = 2\n[tool.beltrami.smooth]\n"
            + options,
            "odd": b"q = 4\nt = 1979-05-27\niterations = 07:32:00\nmaterial = [1, 2.5]\n",
        },
        "manifest": {
            "toml": b"\0" + options + b'[[files]]\ninput = "a.ply"\nbeta = 4\n',
            "csv": b'\1input,output,beta,channels\na.ply,,8,"red,green"\n',
            "lines": b"\2" + line * 2,
        },
        "record": {"lines": record.encode()},
        "report": {"run": json.dumps(report, indent=2).encode()},
    }


def _varied(number: int) -> bytes:
    """Return bytes of which many are small or zero, for the fuzzer of the native core."""
    chance = random.Random(number)
    return bytes(chance.choice([chance.randrange(256), chance.randrange(40), 0]) for _ in range(1500))


def main() -> None:
    """Write all seeds; other files in the folders, which fuzzing found, stay."""
    seeds = {"ply": ply_seeds(), "obj": obj_seeds(), "gltf": gltf_seeds(), **other_seeds(), **data_seeds()}
    for target, made in seeds.items():
        (CORPUS / target).mkdir(parents=True, exist_ok=True)
        for name, data in made.items():
            (CORPUS / target / name).write_bytes(data)


if __name__ == "__main__":
    main()
