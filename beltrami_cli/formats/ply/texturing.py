"""Textures of PLY files: comments name the images, vertices or faces have the coordinates.

There is no standard: MeshLab, VCG and photogrammetry programs write ``comment TextureFile NAME``, and
the coordinates as the list `texcoord` of faces, or as two properties of vertices; v points up. Artec's programs list
the coordinates in an element of their own, to which the corners of faces in a second element refer.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, UnpaintedError
from beltrami_cli.formats import model_folder
from beltrami_cli.formats.document import Naming, NewImages, Written
from beltrami_cli.formats.ply.elements import finite_columns
from beltrami_cli.formats.ply.tables import Table
from beltrami_cli.formats.textured_mesh import MeshImages, alpha_mode, usable_coordinates
from beltrami_cli.formats.tokens import Spans
from beltrami_cli.surface import records
from beltrami_cli.surface.geometry import triangulate_corners

_COMMENT = re.compile(rb"(?:\n|\r)comment[ \t]+TextureFile[ \t:]++([^\r\n]*[^\s])", re.IGNORECASE)
_PREFIXES = ("", "texture_", "texcoord_", "tex_", "t")
_OF_VERTICES = tuple((f"{prefix}{u}", f"{prefix}{v}") for u, v in ("st", "uv") for prefix in _PREFIXES)
_OF_FACES = (
    "texcoord",
    "texcoords",
    "texture_coordinates",
    "texture_uv",
    "texcoord0",
    "uv",
    "uvs",
    "st",
    "t",
)
_ARTEC = ("multi_texture_vertex", "multi_texture_face")
_ARTEC_NUMBER, _ARTEC_FACE, _ARTEC_CORNERS = "tx", "tn", "texture_vertex_indices"
NUMBER = "texnumber"  # the property of faces that says which image they show


@dataclass(frozen=True)
class TextureComment:
    """A comment that names an image."""

    name: str  # of the file, as the comment spells it
    path: str | None  # relative to the model's folder, if it can be used
    start: int  # where the name stands in the PLY file
    end: int
    reason: str = ""  # why it is not used, to be put behind its name; or empty


def read_comments(header: bytes, folder: model_folder.ModelFolder) -> list[TextureComment]:
    """Return the comments that name images, in the order in which they are numbered."""
    found = []
    for match in _COMMENT.finditer(header):
        name = os.fsdecode(match[1])
        try:
            path: str | None
            path, reason = folder.locate_alike(name, tiles=False)
        except model_folder.UnfitReferenceError as error:
            path, reason = None, f"{error}{model_folder.LEFT_ALONE}"
        found.append(TextureComment(name, path, *match.span(1), reason))
    return found


def find_coordinates(tables: Mapping[str, Table]) -> tuple[str, ...]:
    """Return the properties that are texture coordinates: a list of faces, two of vertices, or none."""
    if tables.keys() >= {*_ARTEC}:
        return (_ARTEC_CORNERS,)
    lists = (
        {known.name.lower(): known.name for known in tables["face"].element.lists} if "face" in tables else {}
    )
    if (found := next((lists[name] for name in _OF_FACES if name in lists), None)) is not None:
        return (found,)
    known = {name.lower(): name for name in tables["vertex"].element.scalars}
    names = next((names for names in _OF_VERTICES if known.keys() >= {*names}), ())
    return tuple(known[name] for name in names)


def gather_textured(
    mesh: tuple[Float64s, Int32s, Int64s],
    tables: Mapping[str, Table],
    comments: Sequence[TextureComment],
    folder: model_folder.ModelFolder,
    name: str,
) -> tuple[records.TexturedSurface, list[str]]:
    """Return all triangles with their texture coordinates, the images, and notices."""
    positions, corners, offsets = mesh
    properties = find_coordinates(tables)
    if not comments or not properties:
        cause = "no texture coordinates" if comments else "no 'comment TextureFile' that names an image"
        raise InputError(name, f"it has no texture: {cause}")
    numbers, notices = _numbers(tables, len(offsets) - 1, len(comments), name)
    textures, of_number, unreadable = _load(comments, folder)
    notices += unreadable
    if properties == (_ARTEC_CORNERS,):
        values, bare = _artec_coordinates(tables, offsets, name)
    elif len(properties) == 1:
        values, bare = _face_coordinates(tables["face"].lists(properties[0]), offsets, name)
    else:
        values = finite_columns(tables["vertex"], properties, "texture coordinate")[corners]
        bare = np.zeros(len(offsets) - 1, np.bool_)
    cut, polygon = triangulate_corners(positions, corners, offsets)
    texture_of = np.where(bare, -1, of_number[numbers])[polygon]
    if not (texture_of >= 0).any():
        missing = [f"'{c.name}' {c.reason}" for c in comments if c.path is None]
        why = [*missing, *unreadable, "no face shows one"][0].removesuffix(model_folder.LEFT_ALONE)
        cause = f"it has no texture that can be shown: {why}"
        raise UnpaintedError(name, cause, model_folder.remedy_for(cause))
    uv = values[cut] * [1, -1] + [0, 1]
    surface = records.TexturedSurface(positions, corners[cut], uv, texture_of.astype(np.int32), textures)
    return surface, notices


def _numbers(
    tables: Mapping[str, Table], polygons: int, textures: int, name: str
) -> tuple[Int64s, list[str]]:
    """Return the number of every polygon's texture, -1 for none; strips, which have no number, show the first."""
    numbers = np.zeros(polygons, np.int64)
    face, number = tables.get("face"), NUMBER
    if tables.keys() >= {*_ARTEC}:
        face, number = tables[_ARTEC[1]], _ARTEC_NUMBER
    if face is None or number not in face.element.scalars:
        several = f"It names {textures} textures but not which face shows which; the first is taken for all."
        return numbers, [several] if textures > 1 else []
    given = face.scalars(number)
    wrong = (given >= textures) | (given != np.rint(given))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(name, f"face {row} shows texture {given[row]:g}, but there are {textures}")
    rows = _artec_faces(face, polygons, name) if number == _ARTEC_NUMBER else slice(len(given))
    numbers[rows] = np.maximum(given.astype(np.int64), -1)
    return numbers, []


def _load(
    comments: Sequence[TextureComment], folder: model_folder.ModelFolder
) -> tuple[tuple[records.Texture, ...], Int64s, list[str]]:
    """Return each image once, which of them every number means (the last row: -1), and the unreadable ones."""
    textures: dict[str, records.Texture] = {}
    unreadable = []
    of_number = np.full(len(comments) + 1, -1, np.int64)
    for number, comment in enumerate(comments):
        path = comment.path
        if path is None:
            continue
        try:
            if path not in textures:
                textures[path] = records.Texture(path, path.rpartition("/")[2], folder.read(path))
            of_number[number] = list(textures).index(path)
        except OSError as error:
            reason = f"cannot be read ({error.strerror})"
            unreadable.append(f"'{comment.name}' {reason}{model_folder.LEFT_ALONE}")
    return tuple(textures.values()), of_number, unreadable


def _artec_faces(rows: Table, polygons: int, name: str) -> Int64s:
    """Return which polygon each row of Artec's texture faces is."""
    if _ARTEC_FACE not in rows.element.scalars:
        return np.arange(rows.element.count)
    faces = rows.scalars(_ARTEC_FACE).astype(np.int64)
    if faces.size and (faces.min() < 0 or faces.max() >= polygons or len(np.unique(faces)) < len(faces)):
        raise InputError(name, f"element {_ARTEC[1]} names faces that are not there, or one twice")
    return faces


def _artec_coordinates(tables: Mapping[str, Table], offsets: Int64s, name: str) -> tuple[Float64s, Bools]:
    """Look up coordinates of every corner as `_face_coordinates` does, by Artec's elements."""
    vertices, rows = (tables[element] for element in _ARTEC)
    if not (
        {"u", "v"} <= vertices.element.scalars.keys()
        and any(p.name == _ARTEC_CORNERS for p in rows.element.lists)
    ):
        raise InputError(
            name, f"elements {' and '.join(_ARTEC)} lack u, v or {_ARTEC_CORNERS}", "export it again"
        )
    chosen, bounds = rows.lists(_ARTEC_CORNERS)
    if chosen.size and (chosen.min() < 0 or chosen.max() >= vertices.element.count):
        raise InputError(
            name, f"element {_ARTEC[1]} names texture vertices that are not there", "export it again"
        )
    uv = finite_columns(vertices, ("u", "v"), "texture coordinate")
    faces, lengths = _artec_faces(rows, len(offsets) - 1, name), np.diff(bounds)
    if (lengths != np.diff(offsets)[faces]).any():
        raise InputError(
            name, f"element {_ARTEC[1]} has other numbers of corners than its faces", "export it again"
        )
    values, bare = np.zeros((int(offsets[-1]), 2)), np.ones(len(offsets) - 1, np.bool_)
    values[np.repeat(offsets[faces] - bounds[:-1], lengths) + np.arange(len(chosen))] = uv[chosen]
    bare[faces] = False
    return values, bare


def _face_coordinates(lists: tuple[Array, Int64s], offsets: Int64s, name: str) -> tuple[Float64s, Bools]:
    """Return coordinates of every corner, shape (K, 2), and which polygons have none."""
    items, bounds = lists
    sizes, lengths = np.diff(offsets), np.zeros(len(offsets) - 1, np.int64)
    lengths[: len(bounds) - 1] = np.diff(bounds)
    wrong = (lengths != 0) & (lengths != 2 * sizes)
    if wrong.any():
        row = int(np.argmax(wrong))
        cause = f"face {row} has {sizes[row]} corners, but {lengths[row]} numbers of texture coordinates"
        raise InputError(name, cause)
    bare = lengths == 0
    values = np.zeros((int(offsets[-1]), 2))
    with np.errstate(invalid="ignore"):  # Signalling NaNs warn when they are made wider.
        values[~np.repeat(bare, sizes)] = items.reshape(-1, 2)
    finite = np.isfinite(values).all(axis=1)
    if not finite.all():
        row = int(np.searchsorted(offsets, int(np.argmin(finite)), side="right")) - 1
        raise InputError(name, f"a texture coordinate of face {row} is not finite", "repair the file")
    return values, bare


def renamed_images(
    comments: Sequence[TextureComment], images: NewImages, source: str, naming: Naming
) -> tuple[Written, Spans]:
    """Return the sidecar files of a PLY file, and new names by their place in the header."""
    present = [comment.path for comment in comments if comment.path is not None]
    missing = [comment.name for comment in comments if comment.path is None]
    names = model_folder.NewFiles(naming, source, present, missing)
    new_of: dict[str, str] = {}
    for (_, path), image in images.items():
        new_of[path] = names.image(path, image.suffix)
        names.sidecars[new_of[path]] = image.data
    for comment in comments if names.copies else ():
        if comment.path is None or comment.path in new_of:
            continue
        if model_folder.is_outside(comment.path):
            names.leave(comment.name)
        else:
            new_of[comment.path] = names.image(comment.path)
            names.copied[new_of[comment.path]] = comment.path
    spans: Spans = {}
    for comment in comments:
        if comment.path is not None and comment.path in new_of and new_of[comment.path] != comment.path:
            new = model_folder.new_reference(comment.name, comment.path, new_of[comment.path])
            spans[comment.start, comment.end] = new
    return names.written(), spans


def mesh_of_surface(
    surface: records.TexturedSurface,
    normals: Float32s | None,
    colours: records.VertexColours | None,
    source: str,
    left_out: tuple[str, ...],
) -> records.TexturedMesh:
    """Return a surface as a mesh with a material for each image, named after it; normals and colours by vertex."""
    shown, materials = MeshImages(), []
    for each in surface.textures:
        painting = records.MaterialMap(shown.take(each.key, each.name, each.data), each.wrap)
        name, alpha = each.name.rpartition(".")[0], alpha_mode(each.data, each.name)
        materials.append(records.Material(name, {"baseColor": painting}, alpha=alpha))
    bare = surface.texture_of < 0
    uv = np.where(bare[:, None, None], np.nan, usable_coordinates(surface.uv))
    if bare.any():
        materials.append(records.Material("untextured"))
    return records.TexturedMesh(
        positions=surface.positions,
        faces=surface.faces,
        uv=uv,
        materials=tuple(materials),
        images=tuple(shown.images),
        source=source,
        material_of=np.where(bare, len(surface.textures), surface.texture_of).astype(np.int32),
        normals=None if normals is None else normals[surface.faces],
        colours=colours,
        left_out=left_out,
    )
