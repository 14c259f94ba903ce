"""From a document and new colours to the files of the output, in the same format or in another."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.samples.settings.smooth import POINT_FORMATS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document, Written
    from beltrami_cli.samples.settings.smooth import Format
    from beltrami_cli.surface.painted import MeshContents, MovedVertices
    from beltrami_cli.surface.textured import ImageFile, Slot
    from beltrami_cli.surface.textured_mesh import TexturedMesh


def make_files(
    document: Document,
    colours: NDArray[np.float32] | None,
    images: Mapping[tuple[Slot, str], ImageFile],
    target_format: Format,
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

    if isinstance(document, GltfDocument) and (target_format == "glb" or target_format == "gltf"):
        return document.repackaged(colours, stem, target_format, moved=moved, images=images, places=places)
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


def write_contents(contents: MeshContents, target_format: Format, stem: str) -> Written:
    """Write a mesh with vertex colours as a new file."""
    if target_format == "ply":
        from beltrami_cli.formats.ply import write_ply

        return write_ply(contents, stem)
    if target_format == "obj":
        from beltrami_cli.formats.obj import write_obj

        return write_obj(contents, stem)
    if target_format in POINT_FORMATS:
        from beltrami_cli.formats.points import write_npz, write_pts, write_xyz

        return {"xyz": write_xyz, "pts": write_pts, "npz": write_npz}[target_format](contents, stem)
    from beltrami_cli.formats.gltf import write_glb, write_gltf

    return write_glb(contents, stem) if target_format == "glb" else write_gltf(contents, stem)


def write_textured(mesh: TexturedMesh, target_format: Format, stem: str) -> Written:
    """Write a mesh with one texture as a new file; UsageError if the format has no textures."""
    _require_textures(target_format)
    if target_format == "ply":
        from beltrami_cli.formats.ply import write_textured_ply

        return write_textured_ply(mesh, stem)
    if target_format == "obj":
        from beltrami_cli.formats.obj import write_textured_obj

        return write_textured_obj(mesh, stem)
    from beltrami_cli.formats.gltf import write_textured_glb, write_textured_gltf

    return write_textured_glb(mesh, stem) if target_format == "glb" else write_textured_gltf(mesh, stem)


def names_beside(target_format: Format, stem: str, image_suffix: str | None) -> list[str]:
    """Return the files that `write_textured`, or without an image `write_contents`, puts beside the main one.

    Raises
    ------
    UsageError
        If there is an image, and the format has no textures.
    """
    if image_suffix is not None:
        _require_textures(target_format)
    names = [f"{stem}.bin"] if target_format == "gltf" else []
    if image_suffix is None or target_format == "glb":
        return names
    return [*names, *([f"{stem}.mtl"] if target_format == "obj" else []), stem + image_suffix]


def _require_textures(target_format: Format) -> None:
    if target_format in POINT_FORMATS:
        raise UsageError(
            f"a .{target_format} file has no textures; end the name of the output in .glb, .obj or .ply"
        )
