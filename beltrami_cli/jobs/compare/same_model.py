"""Whether two files hold one model, and how far its vertices moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.layers.selection import Selection
from beltrami_cli.surface.records import ColouredVertices, Texture, TexturedSurface

Documents = tuple[Document, Document]
# Texture coordinates of two files of one model may differ by this much, and vertices by this part of its size: text
# is often rounded to six digits.
_ROUNDING = 1e-5
ROUNDED_MOVE = 2e-5
_ONE_MODEL_REMEDY = "compare two files of one model"


def require_same_size(old: DecodedImage, new: DecodedImage, name: str) -> None:
    sizes = [f"{image.pixels.shape[1]} x {image.pixels.shape[0]}" for image in (old, new)]
    if sizes[0] != sizes[1]:
        cause = f"it has {sizes[1]} pixels, but {old.name} {sizes[0]}"
        raise InputError(name, cause, "compare images of one size")


def moves_of(places: Float64s, places_after: Float64s) -> Float64s:
    """Return the distances of known places, in sizes of the model, shape (K,)."""
    known = np.isfinite(places).all(axis=1) & np.isfinite(places_after).all(axis=1)
    places, places_after = places[known], places_after[known]
    moves = np.asarray(np.linalg.norm(places_after - places, axis=1), np.float64)
    if not len(places):
        return moves
    # Coordinates of a small model far from the origin are rounded by more.
    size = float(np.ptp(places, axis=0).max()) + float(np.abs(places).max()) * 1e-2
    return moves / size if size > 0 else np.where(moves > 0, np.inf, 0.0)


def require_one_model(documents: Documents, vertices: tuple[ColouredVertices, ColouredVertices]) -> None:
    """Raise InputError if two models differ in more than colours and positions."""
    one, other = vertices
    names = documents[0].name, documents[1].name
    counts = len(one.positions), len(other.positions)
    if counts[0] != counts[1]:
        cause = f"it has {counts[1]} coloured vertices, but {names[0]} {counts[0]}"
        raise InputError(names[1], cause, _ONE_MODEL_REMEDY)
    faces, others = map(_triangles, documents)
    _require_same_count(faces, others, names)
    if not np.array_equal(faces, others):
        first = int((faces != others).any(axis=1).argmax())
        raise InputError(
            names[1], f"its triangle {first} is another than that of {names[0]}", _ONE_MODEL_REMEDY
        )
    if one.channels != other.channels:
        channels = [", ".join(each.channels) for each in vertices]
        cause = f"its channels are {channels[1]}, but {names[0]} has {channels[0]}"
        raise InputError(names[1], cause, "compare files with the same channels")
    if not len(one.faces) and moves_of(one.positions, other.positions).max(initial=0) > ROUNDED_MOVE:
        raise InputError(names[1], f"its points are at other places than in {names[0]}", _ONE_MODEL_REMEDY)


def _triangles(document: Document) -> Int32s:
    """Return the triangles of a model, shape (F, 3); of a level set those without colours too."""
    if document.kind == "volume":
        return document.contents().corners.reshape(-1, 3)
    return document.coloured_vertices().faces


def _require_same_count(faces: Int32s, others: Int32s, names: tuple[str, str]) -> None:
    if len(faces) != len(others):
        cause = f"it has {len(others)} triangles, but {names[0]} {len(faces)}"
        raise InputError(names[1], cause, _ONE_MODEL_REMEDY)


def matching_textures(
    surface: TexturedSurface, other: TexturedSurface, names: tuple[str, str]
) -> dict[str, Texture]:
    """Return the textures of the other surface by the keys that they have in the one."""
    # Vertices may be split, and numbered, otherwise: corners are one by their texture coordinates, and their places are
    # measured as moves.
    _require_same_count(surface.faces, other.faces, names)
    if len(surface.textures) != len(other.textures):
        cause = f"it has {len(other.textures)} textures, but {names[0]} {len(surface.textures)}"
        raise InputError(names[1], cause, _ONE_MODEL_REMEDY)
    used = surface.texture_of >= 0
    # The numbers that textures have in the other, where they may be in another order; that of no texture first.
    number_of = np.arange(-1, len(other.textures))
    number_of[surface.texture_of + 1] = other.texture_of
    same = number_of[0] == -1 and len(np.unique(number_of)) == len(number_of)
    same &= np.array_equal(number_of[surface.texture_of + 1], other.texture_of)
    if not same or not np.allclose(surface.uv[used], other.uv[used], rtol=0, atol=_ROUNDING):
        cause = f"its texture coordinates differ from {names[0]}"
        raise InputError(names[1], cause, _ONE_MODEL_REMEDY)
    pairs = zip(surface.textures, number_of[1:].tolist(), strict=True)
    return {texture.key: other.textures[number] for texture, number in pairs}


@dataclass(frozen=True)
class Moves:
    """Distances of vertices from the reference, in units of the longest side of its bounding box."""

    largest: float
    mean: float

    @property
    def is_rounding(self) -> bool:
        """Whether the rounding of numbers in text explains the distances."""
        return self.largest <= ROUNDED_MOVE


def moves_between(documents: Documents, selection: Selection) -> Moves:
    """Measure the distances of vertices, in all compared parts."""
    found = [np.zeros(0)]
    if selection.vertices:
        found.append(moves_of(*(document.coloured_vertices().positions for document in documents)))
    if selection.slots:
        surfaces = [document.textured(selection.slots[0]) for document in documents]
        found.append(moves_of(*(surface.positions[surface.faces].reshape(-1, 3) for surface in surfaces)))
    every = np.concatenate(found) if any(moves.size for moves in found) else np.zeros(1)
    return Moves(float(every.max()), float(every.mean()))
