"""A mesh with one texture written as a new, minimal glTF file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.document import Written
from beltrami_cli.formats.gltf.arrays import Arrays, single_precision
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, encoded, glb_pieces
from beltrami_cli.formats.gltf.files import as_uri
from beltrami_cli.surface.grouping import distinct_corners

if TYPE_CHECKING:
    from beltrami_cli.formats.gltf.json_text import Tree
    from beltrami_cli.surface.records import TexturedMesh

_MIME = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_LINEAR, _MIPMAPS, _CLAMP = 9729, 9987, 33071


def write_textured_glb(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh and its texture as one binary file.

    Parameters
    ----------
    mesh : TexturedMesh
        Vertices are split where texture coordinates differ.
    stem : str
        Name of the mesh in the file.

    Returns
    -------
    Written
        With notices that say what is rounded.

    Raises
    ------
    InputError
        If positions exceed float32.
    UsageError
        If the texture is neither PNG nor JPEG, which glTF demands.
    """
    tree, arrays, notices = _assembled(mesh, stem)
    view = arrays.add_bytes(mesh.image.data)
    tree["images"] = [{"bufferView": view, "mimeType": _mime(mesh), "name": stem}]
    tree["buffers"] = [{"byteLength": len(arrays.binary)}]
    text = json.dumps(tree, ensure_ascii=False, separators=(",", ":"))
    pieces = glb_pieces([Chunk(JSON_CHUNK, encoded(text)), Chunk(BIN_CHUNK, bytes(arrays.binary))])
    return Written(pieces, notices=notices)


def write_textured_gltf(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh as JSON text, with its numbers and its texture in files beside it; else as `write_textured_glb`."""
    tree, arrays, notices = _assembled(mesh, stem)
    _mime(mesh)
    image = stem + mesh.image.suffix
    tree["images"] = [{"uri": as_uri(image), "name": stem}]
    tree["buffers"] = [{"byteLength": len(arrays.binary), "uri": as_uri(f"{stem}.bin")}]
    text = json.dumps(tree, ensure_ascii=False, indent=2) + "\n"
    sidecars = {f"{stem}.bin": bytes(arrays.binary), image: mesh.image.data}
    return Written([encoded(text)], sidecars, notices)


def _assembled(mesh: TexturedMesh, stem: str) -> tuple[Tree, Arrays, tuple[str, ...]]:
    notices: list[str] = []
    uv = mesh.uv.reshape(-1, 2).astype("<f4")
    first, vertex_of = distinct_corners(mesh.faces.ravel(), *uv.T)
    positions = single_precision(mesh.positions[mesh.faces.ravel()[first]], stem, notices)
    arrays = Arrays()
    attributes = {"POSITION": arrays.add(positions, bounds=True), "TEXCOORD_0": arrays.add(uv[first])}
    indices = arrays.add_faces(vertex_of.reshape(-1, 3), len(first))
    material: Tree = {
        "name": stem,
        "pbrMetallicRoughness": {
            "baseColorTexture": {"index": 0},
            "metallicFactor": 0,
            "roughnessFactor": 1,
        },
        "doubleSided": True,
    }
    if mesh.transparent:
        material["alphaMode"] = "BLEND"
    tree: Tree = {
        "asset": {"version": "2.0", "generator": "beltrami"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": stem}],
        "meshes": [
            {"primitives": [{"attributes": attributes, "indices": indices, "material": 0}], "name": stem}
        ],
        "materials": [material],
        "textures": [{"sampler": 0, "source": 0}],
        "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS, "wrapS": _CLAMP, "wrapT": _CLAMP}],
        "accessors": arrays.accessors,
        "bufferViews": arrays.views,
    }
    return tree, arrays, tuple(notices)


def _mime(mesh: TexturedMesh) -> str:
    if mesh.image.suffix not in _MIME:
        raise UsageError(
            f"glTF takes PNG and JPEG textures, not {mesh.image.suffix}; choose --texture-format png or jpg"
        )
    return _MIME[mesh.image.suffix]
