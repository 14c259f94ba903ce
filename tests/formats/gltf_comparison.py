"""What differs between two glTF files: members of the JSON, and bytes with what they are used for."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from formats.gltf_files import CODES

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
            start = view.get("byteOffset", 0)
            found[view["buffer"]].append((use, np.arange(start, start + view["byteLength"])))
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
