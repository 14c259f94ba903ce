"""The files of a document with new colours, and the names of its sidecar files before anything is computed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import UsageError
from beltrami_cli.formats import output_format
from beltrami_cli.formats.changes import Naming, Written
from beltrami_cli.formats.colours import as_in_file
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.file_formats import suffix_for
from beltrami_cli.formats.image_document import ImageDocument
from beltrami_cli.formats.meshes.writing import with_images, with_suffixes
from beltrami_cli.formats.output_format import OutputFormat
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.storing import StoredColours, all_images
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.records import ImageFile, MeshContents, MovedVertices, PlannedImage, Slot


def files_with_new_colours(
    document: Document, stored: Sequence[StoredColours], images: dict[tuple[Slot, str], ImageFile],
    kind: OutputFormat, naming: Naming,
) -> Written:  # fmt: skip
    """Return the files of a document with new colours, images and positions, in the format of the output."""
    colours = next((each.colours for each in stored if each.colours is not None), None)
    places = next((each.positions for each in stored if each.positions is not None), None)
    moved = None if places is None else _moved_vertices(document, places)
    if not naming.is_moved:  # in the source's folder, the output refers to the unchanged images of the source
        images = {key: image for key, image in images.items() if _is_new(document, *key, image)}
    if kind.is_patched:
        return document.patch(colours, naming, images=images, places=moved, form=kind.name)
    if not _has_textures(document, kind):
        mesh = _with_positions(document.vertex_mesh(colours), moved)
    elif moved is None:
        mesh = with_images(document.textured_mesh(colours), images)
    else:
        cause = "positions that --smooth-geometry moves cannot be converted together with textures"
        raise UsageError(f"{cause}; give the output the extension .{document.format}", document.name)
    mesh, notices = with_suffixes(mesh, output_format.image_suffixes(kind.name) or ())
    stem = naming.free_stem(partial(output_format.sidecars_of_mesh, mesh, kind.name))
    written = output_format.write_mesh(mesh, kind.name, stem)
    return replace(written, notices=(*notices, *written.notices))


def _with_positions(mesh: MeshContents, moved: MovedVertices | None) -> MeshContents:
    if moved is None:
        return mesh
    normals = mesh.normals
    if normals is not None and moved.normals is not None:
        normals = np.where(np.isnan(moved.normals), normals, moved.normals)
    return replace(mesh, positions=moved.positions, normals=normals)


def _is_new(document: Document, slot: Slot, key: str, image: ImageFile) -> bool:
    """Whether an image changed."""
    if slot not in document.slots():
        return True
    return all(image.data != each.data for each in document.textured(slot).textures if each.key == key)


def _has_textures(document: Document, kind: OutputFormat) -> bool:
    return output_format.image_suffixes(kind.name) is not None and bool(document.readable(document.slots()))


def _moved_vertices(document: Document, positions: Float64s) -> MovedVertices:
    """Return new positions of coloured vertices, with normals around moved vertices if every vertex has one."""
    vertices = document.coloured_vertices()
    if not document.has_normals_by_vertex():
        return MovedVertices(positions)
    # Copies of a vertex with equal normals get equal new ones; others stay separate, so that hard edges stay hard.
    columns = [*vertices.positions.T, *document.attribute("normal").T]
    if vertices.space_of is not None:
        columns.append(vertices.space_of)
    group_of, _ = group_equal_rows(*columns)
    normals = vertex_normals(positions, vertices.faces, group_of)
    moved = np.any(positions != vertices.positions, axis=1)
    touched = np.zeros(int(group_of.max(initial=-1)) + 1, bool)
    touched[group_of[vertices.faces[moved[vertices.faces].any(axis=1)]]] = True
    normals[~touched[group_of] | ~normals.any(axis=1)] = np.nan
    return MovedVertices(positions, normals)


def sidecar_names(selection: Selection, kind: OutputFormat, naming: Naming) -> list[str]:
    """Return the names of the output's sidecar files, as if all selected colours changed."""
    document, settings = selection.document, selection.settings
    chosen = settings.textures.image_suffix
    images: dict[tuple[Slot, str], PlannedImage] = {}
    for slot, surface in zip(selection.slots, selection.surfaces, strict=True):
        for texture in surface.textures:
            suffix = chosen or suffix_for(texture.data, texture.name) or ".png"
            images[slot, texture.key] = PlannedImage(suffix, is_chosen=chosen is not None, slot=slot)
    if kind.is_patched:
        moves = selection.vertices and settings.embedding.smooth_geometry
        changes = {"colours": selection.vertices, "places": moves}
        return document.sidecar_names(images, naming, form=kind.name, **changes)
    if _has_textures(document, kind):
        output_format.require_textures(kind.name, chosen)
        mesh = with_images(document.textured_mesh(), images)
        names = partial(output_format.sidecars_of_mesh, mesh, kind.name)
    elif images or (document.slots() and not document.has_vertex_colours()):
        remedy = "end the name of the output in .glb, .gltf, .obj or .ply"
        raise UsageError(f"a .{kind.name} file has no textures; {remedy}")
    else:
        names = partial(output_format.usual_sidecars, kind.name, image_suffix=None)
    return names(naming.free_stem(names))


def with_new_colours(document: Document, stored: Sequence[StoredColours]) -> Document:
    """Return the document as it would be with new colours, rounded to the precision of its file."""
    images = {key: image.data for key, image in all_images(stored)[0].items()}
    new = next((each for each in stored if each.colours is not None), None)
    if document.kind == "image":
        return ImageDocument(images.get(("baseColor", ""), document.data), document.name)
    if new is None or new.colours is None:
        return document.with_colours(None, images)
    vertices = document.coloured_vertices()
    colours = as_in_file(vertices, new.colours)
    positions = vertices.positions if new.positions is None else new.positions
    return document.with_colours(replace(vertices, colours=colours, positions=positions), images)
