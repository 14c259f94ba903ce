"""A mesh with one texture written as a binary PLY file with the image beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.ply.writer import shortest

if TYPE_CHECKING:
    from beltrami_cli.surface.records import TexturedMesh


def write_textured_ply(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh and its texture, as MeshLab and photogrammetry programs do.

    Parameters
    ----------
    mesh : TexturedMesh
        The mesh.
    stem : str
        Name of the image beside it, without extension.

    Returns
    -------
    Written
        Positions become floats if that loses nothing, otherwise doubles; every face has its texture coordinates.
    """
    positions = shortest(mesh.positions)
    kind = "float" if positions.dtype == np.float32 else "double"
    faces = np.empty(
        len(mesh.faces), [("corners", "u1"), ("vertices", "<i4", 3), ("numbers", "u1"), ("uv", "<f4", (3, 2))]
    )
    faces["corners"], faces["vertices"] = 3, mesh.faces
    faces["numbers"], faces["uv"] = 6, mesh.uv * [1, -1] + [0, 1]
    image = stem + mesh.image.suffix
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment TextureFile {image}",
        f"element vertex {len(positions)}",
        *(f"property {kind} {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "property list uchar float texcoord",
        "end_header",
    ]
    text = "".join(f"{line}\n" for line in header).encode()
    little = positions.astype(positions.dtype.newbyteorder("<"))
    return Written([text, little.tobytes(), faces.tobytes()], {image: mesh.image.data})
