"""Images to put into glTF files, and what a viewer would find in the result."""

from __future__ import annotations

import json
import re

import numpy as np

from beltrami_cli.surface.records import ImageFile
from formats.gltf_comparison import byte_differences, json_differences
from formats.gltf_files import JPEG, PNG, SLOT_PATHS, WEBP, Textured, joined, opened, picture, unpacked

HEADS = {".png": PNG, ".jpg": JPEG, ".webp": WEBP}
MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}
EXTENSIONS = {"webp": "EXT_texture_webp", "ktx2": "KHR_texture_basisu", "avif": "EXT_texture_avif"}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "<f4")


def new_image(number, suffix=".png", size=70):
    return ImageFile(picture(1000 + number, HEADS[suffix], size), suffix)


def save(written, name, folder):
    """Write what a patch returned; return the path of the main file."""
    for sidecar, data in written.sidecars.items():
        (folder / sidecar).parent.mkdir(parents=True, exist_ok=True)
        (folder / sidecar).write_bytes(bytes(data))
    (folder / name).write_bytes(joined(written))
    return folder / name


def copied(written, source, folder):
    for new, old in written.copies.items():
        (folder / new).parent.mkdir(parents=True, exist_ok=True)
        (folder / new).write_bytes((source.parent / old).read_bytes())


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


def with_images(folder, count, form="glb", place="view"):
    model = Textured(place)
    for number in range(count):
        texture = model.texture(model.image(picture(number, size=300), f"{number}.png"))
        model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture), translation=[number, 0, 0])
    return model.written_to(folder, form)


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
