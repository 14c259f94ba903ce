"""What differs between two glTF files: members of the JSON, bytes with what they are used for, and images.

And what the validator of Khronos finds, an npm package that `make test` installs; the environment variable
BELTRAMI_GLTF_VALIDATOR may name the folder where it is elsewhere.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.surface.records import ImageFile
from formats.gltf_files import CODES, JPEG, PNG, SLOT_PATHS, WEBP, Textured, joined, opened, picture, unpacked
from hostile.folders import write

WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
SIZES = {code: int(name[1]) for name, code in CODES.items()}


def json_differences(old, new, place=""):
    """Return the places at which two trees differ, as {place: (old, new)}; None for a missing value."""
    found = {}
    if isinstance(old, dict) and isinstance(new, dict):
        for key in {**old, **new}:
            found |= json_differences(old.get(key), new.get(key), f"{place}.{key}" if place else key)
    elif isinstance(old, list) and isinstance(new, list):
        for index in range(max(len(old), len(new))):
            pair = [values[index] if index < len(values) else None for values in (old, new)]
            found |= json_differences(*pair, f"{place}[{index}]")
    elif old != new or type(old) is not type(new):
        found[place] = old, new
    return found


def uses(tree):
    """Return what every byte is for: {buffer: [(use, indices of bytes)]}."""
    found = defaultdict(list)
    named = defaultdict(set)
    for mesh in tree.get("meshes", []):
        for primitive in mesh["primitives"]:
            for key, index in primitive["attributes"].items():
                named[index].add(key)
            for target in primitive.get("targets", []):
                for key, index in target.items():
                    named[index].add(f"target {key}")
            named[primitive.get("indices")].add("indices")
    known = set()
    for index, accessor in enumerate(tree.get("accessors", [])):
        parts = [(accessor, accessor["type"], accessor["componentType"], accessor["count"])]
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            parts += [
                (sparse["indices"], "SCALAR", sparse["indices"]["componentType"], sparse["count"]),
                (sparse["values"], accessor["type"], accessor["componentType"], sparse["count"]),
            ]
        for part, kind, code, count in parts:
            if "bufferView" in part:
                view = tree["bufferViews"][part["bufferView"]]
                known.add(part["bufferView"])
                size = SIZES[code] * WIDTHS[kind]
                start = view.get("byteOffset", 0) + part.get("byteOffset", 0)
                rows = start + np.arange(count)[:, None] * view.get("byteStride", size) + np.arange(size)
                for use in named[index] or {f"accessors[{index}]"}:
                    found[view["buffer"]].append((use, rows.ravel()))
    images = {image["bufferView"] for image in tree.get("images", []) if "bufferView" in image}
    for index, view in enumerate(tree.get("bufferViews", [])):
        if index not in known:
            use = "image" if index in images else f"bufferViews[{index}]"
            start, size = view.get("byteOffset", 0), view["byteLength"]
            size += -size % 4 if index in images else 0  # an image at the end is cut off with its padding
            size = min(size, tree["buffers"][view["buffer"]]["byteLength"] - start)
            found[view["buffer"]].append((use, np.arange(start, start + size)))
    return found


def byte_differences(before, after):
    """Return the uses of the bytes of the first file's buffers that the second has others for, where they were.

    What nothing uses at the end of a buffer is padding, which may differ.
    """
    (old, old_buffers, *_), (_, new_buffers, *_) = before, after
    found = set()
    where = uses(old)
    for index, octets in enumerate(old_buffers):
        if octets is None:
            continue
        size = old["buffers"][index]["byteLength"]
        left, right = (np.frombuffer(data, np.uint8)[:size] for data in (octets, new_buffers[index]))
        differs = np.ones(len(left), bool)
        differs[: len(right)] = left[: len(right)] != right
        for use, indices in where[index]:
            if differs[indices].any():
                found.add(use)
        for _, indices in where[index]:
            differs[indices] = False
        if differs[:-8].any():
            found.add("unused")
    return found


HEADS = {".png": PNG, ".jpg": JPEG, ".webp": WEBP}
MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}
EXTENSIONS = {"webp": "EXT_texture_webp", "ktx2": "KHR_texture_basisu", "avif": "EXT_texture_avif"}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "<f4")


def new_image(number, suffix=".png", size=70):
    return ImageFile(picture(1000 + number, HEADS[suffix], size), suffix)


def save(written, name, folder, source=None):
    """Write what a patch returned, and copies of files of the source; return the path of the main file."""
    copies = {new: (source.parent / old).read_bytes() for new, old in written.copies.items() if source}
    sidecars = {sidecar: bytes(data) for sidecar, data in written.sidecars.items()}
    return write(folder, {**sidecars, **copies, name: joined(written)}) / name


def shown(path):
    """Return what every textureInfo of a file shows, by material and slot: bytes, and the texture's other members."""
    tree, buffers, files = opened(path)
    found = {}
    for number, material in enumerate(tree.get("materials", [])):
        for slot, keys in SLOT_PATHS.items():
            info = material
            for key in keys:
                info = info.get(key, {})
            if info:
                texture = tree["textures"][info["index"]]
                others = {key: texture[key] for key in texture.keys() - {"source", "extensions"}}
                found[number, slot] = image_of(tree, buffers, files, texture), others
    return found


def image_of(tree, buffers, files, texture):
    """Return the bytes of the image of a texture, whose type must be declared as what they are."""
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    index = webp.get("source", texture.get("source"))
    data, image = image_bytes(tree, buffers, files, index), tree["images"][index]
    suffix = next(suffix for suffix, head in HEADS.items() if data.startswith(head))
    assert image.get("mimeType", MEDIA[suffix]) == MEDIA[suffix]
    assert "bufferView" in image or image["uri"].startswith(f"data:{MEDIA[suffix]}") or suffix in image["uri"]
    assert bool(webp) == (suffix == ".webp")
    assert not webp or "EXT_texture_webp" in tree["extensionsUsed"]
    return data


def image_bytes(tree, buffers, files, index):
    image = tree["images"][index]
    if "bufferView" in image:
        view = tree["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        return buffers[view["buffer"]][start : start + view["byteLength"]]
    if image["uri"].startswith("data:"):
        return unpacked(json.dumps({"buffers": [{"uri": image["uri"], "byteLength": 1}]}).encode())[1][0]
    return files[image["uri"]]


def check_rest(source, path):
    """Nothing differs but images, textures, and the views and extensions that these need."""
    before, after = opened(source), opened(path)
    assert byte_differences(before, after) <= {"image"}
    assert all(
        view["byteOffset"] % 4 == 0 for view in after[0]["bufferViews"][len(before[0]["bufferViews"]) :]
    )
    pictures = [str(image["bufferView"]) for image in before[0]["images"] if "bufferView" in image]
    new = map(str, range(len(before[0]["bufferViews"]), len(after[0]["bufferViews"])))
    free = r"materials.*\.index|(images|textures|buffers|extensions(Used|Required))\b.*"
    free += rf"|bufferViews\[({'|'.join([*pictures, *new])})\].*"
    assert [place for place in json_differences(before[0], after[0]) if not re.fullmatch(free, place)] == []


def with_images(count=1, place="view", size=50):
    """Return triangles with an image each."""
    model = Textured(place)
    for number in range(count):
        texture = model.texture(model.image(picture(number + 1, size=size), f"{number}.png"))
        model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture), translation=[number, 0, 0])
    return model


def with_better_image(known, better, fallback=None):
    """Return a triangle whose texture is of a type that core glTF lacks, with or without a plain image as well."""
    model = Textured()
    plain = None if fallback is None else model.image(fallback)
    source = {"source": model.image(better, f"b.{known}", f"image/{known}")}
    texture = model.texture(plain, extensions={EXTENSIONS[known]: source})
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture))
    model.tree["extensionsUsed"] = [EXTENSIONS[known]]
    if fallback is None:
        model.tree["extensionsRequired"] = [EXTENSIONS[known]]
    return model


_INSTALLED = Path(sys.prefix) / "gltf-validator" / "node_modules" / "gltf-validator"
_PACKAGE = Path(os.environ.get("BELTRAMI_GLTF_VALIDATOR", _INSTALLED))
_SCRIPT = Path(__file__).with_name("gltf_validator.cjs")
_NODE = shutil.which("node", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))

needs_validator = pytest.mark.skipif(
    _NODE is None or not _PACKAGE.is_dir(),
    reason="the glTF validator is not installed: run the tests by `make test`",
)


def issues(*files):
    """Return for each file what the validator finds: (severity, code, place, message), in order."""
    done = subprocess.run(
        [_NODE, _SCRIPT, _PACKAGE, *files], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    return [
        sorted((m["severity"], m["code"], m.get("pointer", ""), m["message"]) for m in found)
        for found in json.loads(done.stdout)
    ]
