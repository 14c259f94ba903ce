"""A coloured mesh written as a new, minimal glTF file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.gltf.accessors import Stored, quantised
from beltrami_cli.formats.gltf.arrays import Arrays, single_precision
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, encoded, glb_pieces
from beltrami_cli.formats.gltf.files import as_uri
from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.surface.polygons import triangulate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.surface.records import MeshContents

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
    positions = single_precision(contents.positions, stem, notices)
    colours = _colours(contents, notices)
    faces = triangulate(contents.positions, contents.corners, contents.offsets)
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    notices += [f"glTF output leaves out: {', '.join(contents.left_out)}."] if contents.left_out else []
    arrays = Arrays()
    attributes = {"POSITION": arrays.add(positions, bounds=True), "COLOR_0": arrays.add(colours)}
    if contents.normals is not None:
        attributes["NORMAL"] = arrays.add(_unit(contents.normals))
    primitive: Tree = {"attributes": attributes, "material": 0}
    if len(faces):
        primitive["indices"] = arrays.add_faces(faces, len(positions))
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
