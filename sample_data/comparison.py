"""Whether a file is what the script makes, though another version of an image encoder may have packed the pixels."""

from __future__ import annotations

import json
import struct

from images import MIME, same_image

SUFFIX_OF = {mime: suffix for suffix, mime in MIME.items()}


def same(stored: bytes, made: bytes, suffix: str) -> bool:
    """Return whether two files of a kind are the same: images in their pixels, all else in every byte."""
    if stored == made:
        return True
    if suffix in {".png", ".jpg", ".exr"}:
        return same_image(stored, made, suffix)
    return suffix == ".glb" and same_glb(stored, made)


def same_glb(stored: bytes, made: bytes) -> bool:
    """Return whether two GLB files differ in how their images are packed and in nothing else."""
    try:
        (one, views), (other, others) = unpacked(stored), unpacked(made)
    except (struct.error, ValueError, KeyError):
        return False
    if one != other or len(views) != len(others):
        return False
    kind_of = {image["bufferView"]: SUFFIX_OF[image["mimeType"]] for image in other.get("images", [])}
    pairs = enumerate(zip(views, others, strict=True))
    return all(a == b or (k in kind_of and same_image(a, b, kind_of[k])) for k, (a, b) in pairs)


def unpacked(data: bytes) -> tuple[dict, list[bytes]]:
    """Return the document of a GLB file without places and lengths in its buffer, and its buffer views."""
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]
    views = []
    for view in document["bufferViews"]:
        start = view.pop("byteOffset")
        views.append(binary[start : start + view.pop("byteLength")])
    del document["buffers"]
    return document, views
