"""Write textured samples as OBJ with MTL, PLY, GLB and glTF. Plain on purpose, like the writers of coloured ones."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from images import MIME, SUFFIX, encode
from writers import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, NOTE, accessor, glb_file, joined

if TYPE_CHECKING:
    from textured import TexturedSample

Files = dict[str, bytes]
REPEAT, CLAMP_TO_EDGE = 10497, 33071


def images_of(sample: TexturedSample, stem: str) -> Files:
    """Return the image files by name; a single one is named like the model."""
    single = len(sample.textures) == 1
    names = [stem if single else f"{stem}-{texture.name}" for texture in sample.textures]
    parts = zip(names, sample.textures, strict=True)
    return {name + SUFFIX[texture.kind]: encode(texture) for name, texture in parts}


def obj(sample: TexturedSample, stem: str) -> Files:
    """Return an OBJ file, its MTL file and the images. There v points up."""
    images = images_of(sample, stem)
    lines = [f"# {NOTE}", f"mtllib {stem}.mtl"]
    lines += ["v {:.5f} {:.5f} {:.5f}".format(*p) for p in sample.positions.tolist()]
    lines += [f"vt {u:.6f} {1 - v:.6f}" for u, v in sample.coordinates.tolist()]
    material = [f"# {NOTE}"]
    for number, (texture, image) in enumerate(zip(sample.textures, images, strict=True)):
        material += [f"newmtl {texture.name}", "Kd 1 1 1", f"map_Kd {image}"]
        lines.append(f"usemtl {texture.name}")
        mine = sample.material_of == number
        faces = np.stack([sample.vertices[mine], sample.corners[mine]], axis=2).reshape(-1, 6) + 1
        lines += ["f {}/{} {}/{} {}/{}".format(*face) for face in faces.tolist()]
    text = {f"{stem}.obj": lines, f"{stem}.mtl": material}
    return {name: "\n".join([*part, ""]).encode("ascii") for name, part in text.items()} | images


def ply(sample: TexturedSample, stem: str) -> Files:
    """Return a binary PLY file, with coordinates at each face and the texture in a comment, and the image."""
    images = images_of(sample, stem)
    header = ["ply", "format binary_little_endian 1.0", f"comment {NOTE}"]
    header += [f"comment TextureFile {image}" for image in images]
    header += [f"element vertex {len(sample.positions)}", *(f"property float {axis}" for axis in "xyz")]
    header += [f"element face {len(sample.vertices)}", "property list uchar int vertex_indices"]
    header += ["property list uchar float texcoord", "end_header\n"]
    faces = np.empty(
        len(sample.vertices), [("n", "u1"), ("vertices", "<i4", 3), ("m", "u1"), ("texcoord", "<f4", (3, 2))]
    )
    faces["n"], faces["vertices"], faces["m"] = 3, sample.vertices, 6
    faces["texcoord"] = upwards(sample.coordinates)[sample.corners]
    data = "\n".join(header).encode("ascii") + sample.positions.astype("<f4").tobytes() + faces.tobytes()
    return {f"{stem}.ply": data} | images


def upwards(coordinates: np.ndarray) -> np.ndarray:
    """Return texture coordinates with v up."""
    return np.round(coordinates * (1, -1) + (0, 1), 6)


def glb(sample: TexturedSample, stem: str) -> Files:
    """Return a GLB file with the images inside."""
    document, views = description(sample)
    document["images"] = []
    for texture in sample.textures:
        image = {"name": texture.name, "mimeType": MIME[SUFFIX[texture.kind]], "bufferView": len(views)}
        document["images"].append(image)
        views.append((encode(texture), {}))
    return {f"{stem}.glb": glb_file(document, views)}


def gltf(sample: TexturedSample, stem: str) -> Files:
    """Return a glTF file, its buffer and its images, each a file of its own."""
    images = images_of(sample, stem)
    document, views = description(sample)
    binary, described = joined(views)
    document["images"] = [{"uri": name} for name in images]
    document |= {"bufferViews": described}
    document |= {"buffers": [{"uri": f"{stem}.bin", "byteLength": len(binary)}]}
    text = json.dumps(document, indent=1).encode()
    return {f"{stem}.gltf": text + b"\n", f"{stem}.bin": binary} | images


def description(sample: TexturedSample) -> tuple[dict, list[tuple[bytes, dict[str, int]]]]:
    """Return the glTF document without buffer and images, and the data of its buffer views.

    All primitives share the vertices, one for each row of texture coordinates: at seams they are split.
    """
    vertex_of = np.empty(len(sample.coordinates), np.int64)
    vertex_of[sample.corners] = sample.vertices
    stored = sample.positions[vertex_of].astype("<f4")
    position = accessor(0, "f4", len(stored), "VEC3")
    position |= {"min": stored.min(axis=0).tolist(), "max": stored.max(axis=0).tolist()}
    accessors = [position, accessor(1, "f4", len(stored), "VEC2")]
    views = [
        (part.astype("<f4").tobytes(), {"target": ARRAY_BUFFER}) for part in (stored, sample.coordinates)
    ]
    primitives, materials = [], []
    for number, texture in enumerate(sample.textures):
        triangles = sample.corners[sample.material_of == number]
        accessors.append(accessor(len(views), "u2", triangles.size, "SCALAR"))
        views.append((triangles.astype("<u2").tobytes(), {"target": ELEMENT_ARRAY_BUFFER}))
        attributes = {"POSITION": 0, "TEXCOORD_0": 1}
        primitives.append({"attributes": attributes, "indices": 2 + number, "material": number})
        look = {"baseColorTexture": {"index": number}, "metallicFactor": 0, "roughnessFactor": 1}
        materials.append({"name": texture.name, "pbrMetallicRoughness": look, "doubleSided": True})
    repeats = sample.coordinates.max() > 1
    wrap = REPEAT if repeats else CLAMP_TO_EDGE
    return {
        "asset": {"version": "2.0", "generator": "sample_data/make.py", "copyright": "CC0-1.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": primitives}],
        "materials": materials,
        "textures": [{"source": number, "sampler": 0} for number in range(len(materials))],
        "samplers": [{"wrapS": wrap, "wrapT": wrap}],
        "accessors": accessors,
    }, views
