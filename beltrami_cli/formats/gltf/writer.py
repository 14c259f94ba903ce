"""A coloured mesh written as a new, minimal glTF file, and the parts of such files."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import linear_colours
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.gltf.accessors import COMPONENTS, Stored, padded_elements, quantised
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, encoded, glb_pieces
from beltrami_cli.formats.gltf.edit import INDEX_DATA, VERTEX_DATA
from beltrami_cli.formats.gltf.uris import as_uri
from beltrami_cli.surface.polygons import triangulate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.surface.records import MeshContents, VertexColours

_STORED_AS = {("linear", "uint8"): "<u1", ("linear", "uint16"): "<u2", ("srgb", "uint8"): "<u2"}
"""Component type of COLOR_0 by encoding and type of the source; float32 for all others.

sRGB levels are closest near black, where one of 255 is 20 of 65535 linear steps and one of 65535 is 0.08:
16 bits keep all 8-bit sRGB levels apart, and only float32 keeps the 16-bit ones.
"""

_COMPONENT_TYPE = {np.dtype(name): number for number, name in COMPONENTS.items()}
_MOST_FOR_U16 = 65535  # vertices: index 65535 would mean the restart of a strip


def write_glb(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as one binary file; its colours become linear, as glTF demands, and `stem` its name."""
    notices: list[str] = []
    return binary_file(*_coloured(contents, stem, notices), notices)


def write_gltf(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as JSON text with its numbers in the sidecar ``stem.bin``; otherwise as `write_glb`."""
    notices: list[str] = []
    tree, arrays = _coloured(contents, stem, notices)
    return text_file(tree, arrays, stem, {}, notices)


def binary_file(tree: Tree, arrays: Arrays, notices: list[str]) -> Written:
    """Return a file of both chunks."""
    tree["buffers"] = [{"byteLength": len(arrays.binary)}]
    text = json.dumps(tree, ensure_ascii=False, separators=(",", ":"))
    pieces = glb_pieces([Chunk(JSON_CHUNK, encoded(text)), Chunk(BIN_CHUNK, bytes(arrays.binary))])
    return Written(pieces, notices=tuple(notices))


def text_file(tree: Tree, arrays: Arrays, stem: str, images: dict[str, bytes], notices: list[str]) -> Written:
    """Return JSON text, with the numbers and images in files beside it."""
    tree["buffers"] = [{"byteLength": len(arrays.binary), "uri": as_uri(f"{stem}.bin")}]
    text = json.dumps(tree, ensure_ascii=False, indent=2) + "\n"
    return Written([encoded(text)], {f"{stem}.bin": bytes(arrays.binary), **images}, tuple(notices))


class Arrays:
    """Accessors, their views, and the bytes behind them, while they are put together."""

    def __init__(self) -> None:
        self.accessors: list[Tree] = []
        self.views: list[Tree] = []
        self.binary = bytearray()

    def add(self, numbers: Stored, *, bounds: bool = False, target: int = VERTEX_DATA) -> int:
        """Add an array of shape (n, width) and return its accessor; vertex elements are padded to 4 bytes."""
        octets, size = padded_elements(numbers)
        if target == INDEX_DATA:
            octets = octets[:, :size]
        stride = octets.shape[1]
        view = self.add_bytes(octets.tobytes())
        self.views[view] |= ({"byteStride": stride} if stride != size else {}) | {"target": target}
        accessor: dict[str, Any] = {
            "bufferView": view,
            "componentType": _COMPONENT_TYPE[numbers.dtype],
            "count": len(numbers),
            "type": {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}[numbers.shape[1]],
        }
        if numbers.dtype.kind == "u" and target == VERTEX_DATA:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_faces(self, faces: NDArray[np.integer[Any]], vertices: int) -> int:
        """Add triangles, shape (F, 3), as narrow as the number of vertices allows, and return their accessor."""
        narrow = vertices <= _MOST_FOR_U16
        return self.add(faces.reshape(-1, 1).astype("<u2" if narrow else "<u4"), target=INDEX_DATA)

    def add_bytes(self, content: bytes) -> int:
        """Add the bytes of a view, and return it."""
        self.binary += bytes(-len(self.binary) % 4)
        self.views.append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(content)})
        self.binary += content
        return len(self.views) - 1


def _coloured(contents: MeshContents, stem: str, notices: list[str]) -> tuple[Tree, Arrays]:
    positions = single_precision(contents.positions, stem, notices)
    colours = stored_colours(contents, notices)
    faces = triangulate(contents.positions, contents.corners, contents.offsets)
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    if contents.left_out:
        notices.append(f"glTF output leaves out: {', '.join(contents.left_out)}.")
    arrays = Arrays()
    attributes = {"POSITION": arrays.add(positions, bounds=True), "COLOR_0": arrays.add(colours)}
    if contents.normals is not None:
        attributes["NORMAL"] = arrays.add(unit_normals(contents.normals))
    primitive: Tree = {"attributes": attributes, "material": 0}
    if len(faces):
        primitive["indices"] = arrays.add_faces(faces, len(positions))
    else:
        primitive["mode"] = 0
    # glTF's default material is bare metal, which shows colours black without a sky.
    material: Tree = {
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
        "doubleSided": True,
    }
    if contents.alpha is not None and np.any(contents.alpha < 1):
        material["alphaMode"] = "BLEND"
    return _model(primitive, {"materials": [material]}, arrays, stem), arrays


def _model(primitive: Tree, painting: Tree, arrays: Arrays, stem: str) -> Tree:
    """Return the JSON of a file of one primitive, with the members that paint it."""
    return {
        "asset": {"version": "2.0", "generator": "beltrami"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": stem}],
        "meshes": [{"primitives": [primitive], "name": stem}],
        **painting,
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
    }


def single_precision(exact: Float64s, stem: str, notices: list[str]) -> Stored:
    """Return positions as glTF stores them; a notice is added if that rounds them."""
    with np.errstate(over="ignore"):
        positions = exact.astype("<f4")
    if not np.isfinite(positions).all():
        raise InputError(
            stem, "positions are too large for glTF, which stores float32", "scale the mesh down"
        )
    if np.any(positions != exact):
        notices.append("Positions are rounded to single precision.")
    return positions


def stored_colours(contents: MeshContents | VertexColours, notices: list[str]) -> Stored:
    """Return COLOR_0 as stored, shape (V, 3), or (V, 4) with alpha."""
    colours = linear_colours(contents, notices, "glTF demands", "Grey values become three equal channels.")
    if np.any((colours < 0) | (colours > 1)):
        colours = np.clip(colours, 0, 1)
        notices.append("Colours outside [0, 1] are clipped, since glTF does not allow them.")
    if contents.alpha is not None:
        colours = np.concatenate([colours, np.clip(contents.alpha, 0, 1)[:, None]], axis=1)
    return quantised(colours, np.dtype(_STORED_AS.get((contents.encoding, contents.stored), "<f4")))


def unit_normals(normals: Float32s) -> Stored:
    """Return normals of length one; where there is none, upwards, since glTF allows no others."""
    exact = np.nan_to_num(normals.astype(np.float64), posinf=0, neginf=0)
    length = np.linalg.norm(exact, axis=1, keepdims=True)
    return np.where(length > 0, exact / np.where(length > 0, length, 1), [0.0, 0.0, 1.0]).astype("<f4")
