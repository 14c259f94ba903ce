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
from pathlib import PurePosixPath

import numpy as np

from beltrami_cli.arrays import Array, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, Obstacle
from beltrami_cli.formats.changes import Naming, NewImages, Written
from beltrami_cli.formats.files.edits import Spans
from beltrami_cli.formats.meshes.scene import Maps, Scene, ShownMap
from beltrami_cli.formats.ply.tables import Table
from beltrami_cli.formats.sidecars import model_folder, new_files
from beltrami_cli.surface import records

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
_ARTEC_VERTICES, _ARTEC_FACES = "multi_texture_vertex", "multi_texture_face"  # elements
_ARTEC_NUMBER, _ARTEC_FACE, _ARTEC_CORNERS = "tx", "tn", "texture_vertex_indices"  # properties of the faces
_REMEDY = "export it again"
NUMBER = "texnumber"  # property of faces: the index of their image


@dataclass(frozen=True)
class TextureComment:
    """A comment that names an image."""

    name: str  # file name as spelled in the comment
    path: str | None  # relative to the model's folder, if it can be used
    start: int  # offset of the name in the PLY file
    end: int
    notice: str = ""  # a sentence on its use, or why it is not used; or empty
    obstacle: Obstacle | None = None  # why it is not used


def read_comments(header: bytes, folder: model_folder.ModelFolder) -> list[TextureComment]:
    """Return the comments that name images, in the order in which they are numbered."""
    comments = []
    for match in _COMMENT.finditer(header):
        name = os.fsdecode(match[1])
        try:
            path, instead = folder.locate_similar(name, tiles=False)
            comments.append(
                TextureComment(name, path, *match.span(1), f"'{name}' {instead}" if instead else "")
            )
        except model_folder.UnfitReferenceError as error:
            why = Obstacle(f"'{name}' {error}", error.obstacle.remedy)
            notice = f"{why.cause}{model_folder.IGNORED}"
            comments.append(TextureComment(name, None, *match.span(1), notice, why))
    return comments


def find_coordinates(tables: Mapping[str, Table]) -> tuple[str, ...]:
    """Return the properties that are texture coordinates: a list of faces, two of vertices, or none."""
    if tables.keys() >= {_ARTEC_VERTICES, _ARTEC_FACES}:
        return (_ARTEC_CORNERS,)
    given = tables["face"].element.lists if "face" in tables else []
    lists = {prop.name.lower(): prop.name for prop in given}
    if (found := next((lists[name] for name in _OF_FACES if name in lists), None)) is not None:
        return (found,)
    scalars = {name.lower(): name for name in tables["vertex"].element.scalars}
    names = next((names for names in _OF_VERTICES if scalars.keys() >= {*names}), ())
    return tuple(scalars[name] for name in names)


def read_scene(
    mesh: tuple[Float64s, Int32s, Int64s],
    tables: Mapping[str, Table],
    comments: Sequence[TextureComment],
    folder: model_folder.ModelFolder,
    name: str,
) -> Scene:
    """Return the polygons with a material for each image, named after it, and one without."""
    positions, corners, offsets = mesh
    properties = find_coordinates(tables)
    if not comments or not properties:
        cause = "no texture coordinates" if comments else "no 'comment TextureFile' that names an image"
        raise InputError(name, f"it has no texture: {cause}")
    numbers, notices = _numbers(tables, len(offsets) - 1, len(comments), name)
    if properties == (_ARTEC_CORNERS,):
        uv = _artec_coordinates(tables, offsets, name)
    elif len(properties) == 1:
        uv = _face_coordinates(tables["face"].lists(properties[0]), offsets, name)
    else:
        uv = tables["vertex"].columns(properties, "texture coordinate")[corners]
    images: list[Maps] = [
        {"baseColor": ShownMap(each.name, each.path)} if each.path else {} for each in comments
    ]
    names = [*(PurePosixPath(each.path or "").stem for each in comments), "untextured"]
    return Scene(
        name=name,
        positions=positions,
        corners=corners,
        offsets=offsets,
        material_of=np.where(numbers < 0, len(comments), numbers),
        materials=[records.Material(name) for name in names],
        maps=[*images, {}],
        uv=lambda _: uv,
        read=folder.content,
        notices=(*notices,),
    )


def _numbers(
    tables: Mapping[str, Table], polygons: int, textures: int, name: str
) -> tuple[Int64s, list[str]]:
    """Return the number of every polygon's texture, -1 for none; strips, which have no number, show the first."""
    numbers = np.zeros(polygons, np.int64)
    face, number = tables.get("face"), NUMBER
    if tables.keys() >= {_ARTEC_VERTICES, _ARTEC_FACES}:
        face, number = tables[_ARTEC_FACES], _ARTEC_NUMBER
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


def _artec_faces(rows: Table, polygons: int, name: str) -> Int64s:
    """Return the polygon of each row of Artec's texture faces."""
    if _ARTEC_FACE not in rows.element.scalars:
        return np.arange(rows.element.count)
    faces = rows.scalars(_ARTEC_FACE).astype(np.int64)
    if faces.size and (faces.min() < 0 or faces.max() >= polygons or len(np.unique(faces)) < len(faces)):
        raise InputError(name, f"element {_ARTEC_FACES} names faces that are not there, or one twice")
    return faces


def _artec_coordinates(tables: Mapping[str, Table], offsets: Int64s, name: str) -> Float64s:
    """Look up coordinates of every corner as `_face_coordinates` does, by Artec's elements."""
    vertices, rows = tables[_ARTEC_VERTICES], tables[_ARTEC_FACES]
    lists = {prop.name for prop in rows.element.lists}
    if not {"u", "v"} <= vertices.element.scalars.keys() or _ARTEC_CORNERS not in lists:
        cause = f"elements {_ARTEC_VERTICES} and {_ARTEC_FACES} lack u, v or {_ARTEC_CORNERS}"
        raise InputError(name, cause, _REMEDY)
    chosen, bounds = rows.lists(_ARTEC_CORNERS)
    if chosen.size and (chosen.min() < 0 or chosen.max() >= vertices.element.count):
        raise InputError(name, f"element {_ARTEC_FACES} names texture vertices that are not there", _REMEDY)
    uv = vertices.columns(("u", "v"), "texture coordinate")
    faces, lengths = _artec_faces(rows, len(offsets) - 1, name), np.diff(bounds)
    if (lengths != np.diff(offsets)[faces]).any():
        raise InputError(name, f"element {_ARTEC_FACES} has other numbers of corners than its faces", _REMEDY)
    values = np.full((int(offsets[-1]), 2), np.nan)
    values[np.repeat(offsets[faces] - bounds[:-1], lengths) + np.arange(len(chosen))] = uv[chosen]
    return values


def _face_coordinates(lists: tuple[Array, Int64s], offsets: Int64s, name: str) -> Float64s:
    """Return coordinates of every corner, shape (K, 2), NaN for polygons that have none."""
    items, bounds = lists
    sizes, lengths = np.diff(offsets), np.zeros(len(offsets) - 1, np.int64)
    lengths[: len(bounds) - 1] = np.diff(bounds)
    wrong = (lengths != 0) & (lengths != 2 * sizes)
    if wrong.any():
        row = int(np.argmax(wrong))
        cause = f"face {row} has {sizes[row]} corners, but {lengths[row]} numbers of texture coordinates"
        raise InputError(name, cause)
    values = np.full((int(offsets[-1]), 2), np.nan)
    with np.errstate(invalid="ignore"):  # Signalling NaNs warn when they are made wider.
        values[np.repeat(lengths > 0, sizes)] = items.reshape(-1, 2)
    return values


def renamed_images(
    comments: Sequence[TextureComment], images: NewImages, source: str, naming: Naming
) -> tuple[Written, Spans]:
    """Return the sidecar files of a PLY file, and new names by their place in the header."""
    present = [comment.path for comment in comments if comment.path is not None]
    missing = [comment.name for comment in comments if comment.path is None]
    names = new_files.NewFiles(naming, source, present, missing)
    new_of: dict[str, str] = {}
    for (_, path), image in images.items():
        new_of[path] = names.image(path, image.suffix)
        names.sidecars[new_of[path]] = image.data
    for comment in comments if names.is_moved else ():
        if comment.path is None or comment.path in new_of:
            continue
        if model_folder.is_outside(comment.path):
            names.leave(comment.name)
        else:
            new_of[comment.path] = names.image(comment.path)
            names.copies[new_of[comment.path]] = comment.path
    spans: Spans = {}
    for comment in comments:
        if comment.path is not None and comment.path in new_of and new_of[comment.path] != comment.path:
            new = new_files.new_reference(comment.name, comment.path, new_of[comment.path])
            spans[comment.start, comment.end] = new
    return names.written(), spans
