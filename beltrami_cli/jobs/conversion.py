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
    from beltrami_cli.samples.selection import OutputFormat
    from beltrami_cli.surface.records import ImageFile, MeshContents, MovedVertices, Slot


def make_files(
    document: Document,
    colours: NDArray[np.float32] | None,
    images: Mapping[tuple[Slot, str], ImageFile],
    kind: OutputFormat,
    stem: str,
    *,
    moved: bool,
    places: MovedVertices | None = None,
) -> Written:
    """Return the files of a document with other colours and places; UsageError if the format cannot take textures over.

    `colours` and `places` have rows as in ``document.painted()``; None: as they are. `stem` is the name of the output
    without extension, for files beside it, and `moved` whether it lies in another folder than the source.
    """
    target_format = kind.name
    if kind.is_own or kind.suffix is not None:
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
