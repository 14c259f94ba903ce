"""Conversion of documents to meshes that writers of other formats take."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.formats.colours import BYTE, holds_bytes
from beltrami_cli.formats.document import Document
from beltrami_cli.surface import records


def vertex_mesh(document: Document, colours: Float32s | None = None) -> records.MeshContents:
    """Return the mesh of the coloured vertices; `colours` as in `patch`."""
    mesh = document.contents()
    new = mesh.colours if colours is None else document.colours_at_vertices(colours)
    return replace(mesh, colours=new, stored=_type_for(document, mesh))


def _type_for(document: Document, mesh: records.MeshContents) -> str:
    """Return the type in which another format stores the colours, where the stored one does not determine it."""
    shown = document.coloured_vertices()
    says_little = mesh.stored == "text" or shown.assumed_scale == BYTE
    are_bytes = says_little and holds_bytes(shown.colours) and (mesh.alpha is None or holds_bytes(mesh.alpha))
    return "uint8" if are_bytes else mesh.stored


def with_vertex_colours(
    mesh: records.MeshContents, document: Document, colours: Float32s | None
) -> records.MeshContents:
    """Add vertex colours, as in `patch`, to a textured mesh if both have the same vertices."""
    if not document.has_vertex_colours():
        return mesh
    shown = vertex_mesh(document, colours)
    if not np.array_equal(shown.positions, mesh.positions):
        lost = "vertex colours, which are not one for each vertex"
        return replace(mesh, left_out=(*mesh.left_out, lost))
    return replace(
        mesh, colours=shown.colours, alpha=shown.alpha, encoding=shown.encoding, stored=shown.stored
    )


def not_converted(
    mesh: records.MeshContents,
    further: Iterable[str] = (),
    *,
    keeps_frame: bool = False,
) -> list[str]:
    """Return a notice of the losses of a conversion, if there are any."""
    left = dict.fromkeys([*mesh.left_out, *further])
    if mesh.frame.up != "Y" and not keeps_frame:
        left |= {f"the axis that is up, which is {mesh.frame.up}": None}
    if mesh.frame.unit != 1 and not keeps_frame:
        left |= {f"the unit of {mesh.frame.unit:g} m": None}
    return [f"Not converted: {'; '.join(left)}."] if left else []
