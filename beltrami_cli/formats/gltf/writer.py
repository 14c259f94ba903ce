"""A coloured mesh written as a new, minimal glTF file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.gltf.accessors import Stored, quantised
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, encoded, glb_pieces
from beltrami_cli.formats.gltf.files import as_uri
from beltrami_cli.formats.gltf.layouts import COMPONENTS
from beltrami_cli.mesh.polygons import triangulate
from beltrami_cli.mesh.transfer import srgb_to_linear

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.mesh.painted import MeshContents

_COMPONENT_TYPE = {np.dtype(name): number for number, name in COMPONENTS.items()}
_MOST_FOR_U16 = 65535  # vertices: index 65535 would mean the restart of a strip

_STORED_AS = {
    ("linear", "uint8"): "<u1",
    ("linear", "uint16"): "<u2",
    ("srgb", "uint8"): "<u2",
}
"""Component type of COLOR_0 by encoding and type of the source; float32 for all others.

sRGB levels are closest near black, where one of 255 is 20 of 65535 linear steps and one of 65535 is 0.08:
16 bits keep all 8-bit sRGB levels apart, and only float32 keeps the 16-bit ones.
"""


def write_glb(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as one binary file.

    Parameters
    ----------
    contents : MeshContents
        The mesh; its colours become linear, as glTF demands.
    stem : str
        Name of the mesh in the file.

    Returns
    -------
    Written
        With notices that say what is rounded, cut, or left out.

    Raises
    ------
    InputError
        If positions exceed float32.
    """
    tree, binary, notices = _assembled(contents, stem)
    text = json.dumps(tree, ensure_ascii=False, separators=(",", ":"))
    return Written(glb_pieces([Chunk(JSON_CHUNK, encoded(text)), Chunk(BIN_CHUNK, binary)]), {}, notices)


def write_gltf(contents: MeshContents, stem: str) -> Written:
    """Write a mesh as JSON text with its numbers in the sidecar ``stem.bin``; otherwise as `write_glb`."""
    tree, binary, notices = _assembled(contents, stem)
    tree["buffers"][0]["uri"] = as_uri(f"{stem}.bin")
    text = json.dumps(tree, ensure_ascii=False, indent=2) + "\n"
    return Written([encoded(text)], {f"{stem}.bin": binary}, notices)


def _assembled(contents: MeshContents, stem: str) -> tuple[Tree, bytes, tuple[str, ...]]:
    notices: list[str] = []
    positions = _positions(contents, stem, notices)
    colours = _colours(contents, notices)
    faces = triangulate(contents.positions, contents.corners, contents.offsets)
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    notices += [f"glTF output leaves out: {', '.join(contents.left_out)}."] if contents.left_out else []
    arrays = _Arrays()
    attributes = {"POSITION": arrays.add(positions, bounds=True), "COLOR_0": arrays.add(colours)}
    if contents.normals is not None:
        attributes["NORMAL"] = arrays.add(_unit(contents.normals))
    primitive: Tree = {"attributes": attributes, "material": 0}
    if len(faces):
        narrow = len(positions) <= _MOST_FOR_U16
        primitive["indices"] = arrays.add(
            faces.reshape(-1, 1).astype("<u2" if narrow else "<u4"), target=34963
        )
    else:
        primitive["mode"] = 0
    tree = {
        "asset": {"version": "2.0", "generator": "beltrami"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": stem}],
        "meshes": [{"primitives": [primitive], "name": stem}],
        "materials": [_material(contents)],
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
        "buffers": [{"byteLength": len(arrays.binary)}],
    }
    return tree, bytes(arrays.binary), tuple(notices)


def _positions(contents: MeshContents, stem: str, notices: list[str]) -> Stored:
    with np.errstate(over="ignore"):
        positions = contents.positions.astype("<f4")
    if not np.isfinite(positions).all():
        raise InputError(
            stem, "positions are too large for glTF, which stores float32", "scale the mesh down"
        )
    if np.any(positions != contents.positions):
        notices.append("Positions are rounded to single precision.")
    return positions


def _colours(contents: MeshContents, notices: list[str]) -> Stored:
    """Return COLOR_0 as stored, shape (V, 3), or (V, 4) with alpha."""
    colours = contents.colours
    if contents.encoding == "srgb":
        colours = srgb_to_linear(colours).astype(np.float32)
        notices.append("Colours are turned from sRGB into linear light, as glTF demands.")
    if colours.shape[1] == 1:
        colours = np.repeat(colours, 3, axis=1)
        notices.append("Grey values become three equal channels.")
    if np.any((colours < 0) | (colours > 1)):
        colours = np.clip(colours, 0, 1)
        notices.append("Colours outside [0, 1] are clipped, since glTF does not allow them.")
    if contents.alpha is not None:
        colours = np.concatenate([colours, np.clip(contents.alpha, 0, 1)[:, None]], axis=1)
    return quantised(colours, np.dtype(_STORED_AS.get((contents.encoding, contents.stored), "<f4")))


def _unit(normals: NDArray[np.float32]) -> Stored:
    """Return normals of length one; where there is none, upwards, since glTF allows no others."""
    exact = np.nan_to_num(normals.astype(np.float64), posinf=0, neginf=0)
    length = np.linalg.norm(exact, axis=1, keepdims=True)
    return np.where(length > 0, exact / np.where(length > 0, length, 1), [0.0, 0.0, 1.0]).astype("<f4")


def _material(contents: MeshContents) -> Tree:
    """Return a plain material: glTF's default one is bare metal, which shows colours black without a sky."""
    material: Tree = {
        "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1},
        "doubleSided": True,
    }
    if contents.alpha is not None and np.any(contents.alpha < 1):
        material["alphaMode"] = "BLEND"
    return material


class _Arrays:
    """Accessors, their views, and the bytes behind them, while they are put together."""

    def __init__(self) -> None:
        self.accessors: list[Tree] = []
        self.views: list[Tree] = []
        self.binary = bytearray()

    def add(self, numbers: Stored, *, bounds: bool = False, target: int = 34962) -> int:
        """Add an array of shape (n, width) and return its accessor; vertex elements are padded to 4 bytes."""
        size = numbers.dtype.itemsize * numbers.shape[1]
        stride = size if target == 34963 else -(-size // 4) * 4
        octets = np.zeros((len(numbers), stride), np.uint8)
        octets[:, :size] = np.ascontiguousarray(numbers).view(np.uint8)
        self.binary += bytes(-len(self.binary) % 4)
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": octets.size}
        self.views.append(view | ({"byteStride": stride} if stride != size else {}) | {"target": target})
        self.binary += octets.tobytes()
        accessor: dict[str, Any] = {
            "bufferView": len(self.views) - 1,
            "componentType": _COMPONENT_TYPE[numbers.dtype],
            "count": len(numbers),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[numbers.shape[1]],
        }
        if numbers.dtype.kind == "u" and target == 34962:
            accessor["normalized"] = True
        if bounds:
            accessor |= {"min": numbers.min(axis=0).tolist(), "max": numbers.max(axis=0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1
