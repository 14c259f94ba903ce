"""From a document and new colours to the files of the output, in the same format or in another."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.registry import write_contents

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.surface.records import ImageFile, MeshContents, MovedVertices, Slot


def make_files(
    document: Document,
    colours: NDArray[np.float32] | None,
    images: Mapping[tuple[Slot, str], ImageFile],
    target_format: str,
    stem: str,
    *,
    moved: bool,
    places: MovedVertices | None = None,
) -> Written:
    """Write a document with other colours.

    Parameters
    ----------
    document : Document
        The source.
    colours : ndarray of float32, shape (V, C), or None
        Rows as in ``document.painted().colours``; None: as they are.
    images : mapping of (Slot, str) to ImageFile
        New images, as `Document.patch` takes them.
    target_format : {"ply", "obj", "glb", "gltf", "xyz", "pts", "npz"}
        The document's own, which changes nothing but colours, or another.
    stem : str
        Name of the output without extension, for files beside it.
    moved : bool
        Whether the output lies in another folder than the source.
    places : MovedVertices or None
        New places of the vertices; None: as they are.

    Returns
    -------
    Written
        Its notices say what was lost.

    Raises
    ------
    UsageError
        If the other format cannot take over textures.
    """
    if target_format == document.format:
        return document.patch(colours, stem, moved=moved, images=images, places=places)
    from beltrami_cli.formats.gltf import GltfDocument

    if isinstance(document, GltfDocument) and target_format in ("glb", "gltf"):
        form: Literal["glb", "gltf"] = "glb" if target_format == "glb" else "gltf"
        return document.repackaged(colours, stem, form, moved=moved, images=images, places=places)
    if images or (document.slots() and not document.has_vertex_colours()):
        raise UsageError(
            f"textures cannot be converted from {document.format} to {target_format}; "
            f"give the output the extension .{document.format}, or add --unwrap, which makes one new texture of them"
        )
    contents = document.contents()
    if colours is not None:
        contents = dataclasses.replace(contents, colours=colours)
    if places is not None:
        contents = _moved(contents, places)
    return write_contents(contents, target_format, stem)


def _moved(contents: MeshContents, places: MovedVertices) -> MeshContents:
    normals = contents.normals
    if normals is not None and places.normals is not None:
        normals = np.where(np.isnan(places.normals), normals, places.normals)
    return dataclasses.replace(contents, positions=places.positions, normals=normals)
