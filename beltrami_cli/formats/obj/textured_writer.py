"""A mesh with one texture written as OBJ, its material, and the image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.document import Written
from beltrami_cli.formats.obj.writer import blocks, shortest, spell
from beltrami_cli.surface.grouping import distinct_corners

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from beltrami_cli.surface.records import TexturedMesh

_MATERIAL = "painted"


def write_textured_obj(mesh: TexturedMesh, stem: str) -> Written:
    """Write a mesh and its texture.

    Parameters
    ----------
    mesh : TexturedMesh
        The mesh.
    stem : str
        Name of the files beside it, without extension.

    Returns
    -------
    Written
        Positions have as many digits as they need to be read back the same, texture coordinates those of float32.
    """
    first, coordinate_of = distinct_corners(*mesh.uv.reshape(-1, 2).T)
    coordinates = (mesh.uv.reshape(-1, 2)[first] * [1, -1] + [0, 1]).astype(np.float32)
    image = stem + mesh.image.suffix
    pieces = [
        f"mtllib {stem}.mtl\n".encode(),
        *_lines("v {} {} {}\n", shortest(mesh.positions)),
        *_lines("vt {} {}\n", coordinates),
        f"usemtl {_MATERIAL}\n".encode(),
        *_face_lines(mesh.faces + 1, coordinate_of.reshape(-1, 3) + 1),
    ]
    alpha = f"map_d -imfchan m -clamp on {image}\n" if mesh.transparent else ""
    material = f"newmtl {_MATERIAL}\nKd 1 1 1\nillum 1\nmap_Kd -clamp on {image}\n{alpha}"
    return Written(pieces, {f"{stem}.mtl": material.encode(), image: mesh.image.data})


def _lines(style: str, rows: NDArray[np.float32] | NDArray[np.float64]) -> Iterator[bytes]:
    for block in blocks(len(rows)):
        yield "".join([style.format(*row) for row in zip(*spell(rows[block]), strict=True)]).encode()


def _face_lines(vertices: NDArray[np.integer], coordinates: NDArray[np.integer]) -> Iterator[bytes]:
    for block in blocks(len(vertices)):
        corners = np.stack([vertices[block], coordinates[block]], axis=2).reshape(-1, 6).tolist()
        yield "".join(["f {}/{} {}/{} {}/{}\n".format(*corner) for corner in corners]).encode()
