"""Models with other images: a plain GLB writer, and decoders that are not the package's own."""

import json
import struct
import sys

import numpy as np
from scene import ROOT

sys.path.insert(0, str(ROOT / "sample_data"))

import images
from beltrami_cli.formats.registry import open_document
from textured import Painting


def read_image(data, name):
    """Return display values, shape (H, W, 3), and where alpha is not 0."""
    marks = {b"\x89PNG": ".png", b"\xff\xd8": ".jpg", b"v/1\x01": ".exr", b"RIFF": ".webp"}
    suffix = next((s for mark, s in marks.items() if data.startswith(mark)), "." + name.rpartition(".")[2])
    stored = images.decode(data, suffix)
    integer = stored.dtype.kind == "u"
    values = stored / np.iinfo(stored.dtype).max if integer else images.displayed(stored.astype(float))
    channels = values.shape[2]
    visible = values[:, :, -1] > 0 if channels in (2, 4) else np.ones(values.shape[:2], bool)
    return np.clip(values[:, :, (0, 1, 2) if channels > 2 else (0, 0, 0)], 0, 1).astype(np.float32), visible


def _vertices(scene, *, torn):
    """Return the vertices with their texture coordinates, and the triangles between them."""
    rows = np.concatenate([scene.corners, scene.uv], axis=2).astype("<f4").reshape(-1, 5)
    owned = np.column_stack([rows, np.repeat(scene.texture_of, 3)])
    vertices, index = np.unique(owned, axis=0, return_inverse=True)
    vertices, index = vertices[:, :5].astype("<f4"), index.reshape(-1, 3)
    if torn:
        _, place, copies = np.unique(vertices[:, :3], axis=0, return_inverse=True, return_counts=True)
        split = copies[place.reshape(-1)] > 1
        trace = 3e-6 * np.ptp(vertices[:, :3], axis=0).max()
        vertices[split, :3] += np.random.default_rng(9).uniform(-trace, trace, (split.sum(), 3))
    return vertices, index


def write_glb(path, scene, pixels, *, torn=False):
    """Write the scene with other images, 8-bit PNG; `torn`: vertices at seams are moved apart by a trace, so that both
    sides of every seam are open boundaries.
    """
    vertices, index = _vertices(scene, torn=torn)
    pngs = [images.encode(Painting("", image / 255, None, "png8")) for image in pixels]
    columns = [np.ascontiguousarray(vertices[:, part]).tobytes() for part in (slice(3), slice(3, 5))]
    triangles = [index[scene.texture_of == number].astype("<u4") for number in range(len(pngs))]
    views, binary = [], b""
    for data in [*columns, *(part.tobytes() for part in triangles), *pngs]:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
        binary += data + bytes(-len(data) % 4)
    box = vertices[:, :3]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": len(box), "type": "VEC3"}
        | {"min": box.min(axis=0).tolist(), "max": box.max(axis=0).tolist()},
        {"bufferView": 1, "componentType": 5126, "count": len(box), "type": "VEC2"},
    ]
    accessors += [
        {"bufferView": 2 + k, "componentType": 5125, "count": part.size, "type": "SCALAR"}
        for k, part in enumerate(triangles)
    ]
    numbers = range(len(pngs))
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {"primitives": [{"attributes": attributes, "indices": 2 + k, "material": k} for k in numbers]}
        ],
        "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": k}}} for k in numbers],
        "textures": [{"source": k} for k in numbers],
        "images": [{"mimeType": "image/png", "bufferView": 2 + len(pngs) + k} for k in numbers],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text
    parts += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts)


def read_images(path):
    """Return the images of a model, in the order of `write_glb`, as display values."""
    surface = open_document(str(path)).textured("baseColor")
    order = np.argsort([int(texture.name.split()[-1]) for texture in surface.textures])
    return [read_image(surface.textures[k].data, surface.textures[k].name)[0] for k in order]
