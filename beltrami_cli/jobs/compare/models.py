"""Two models held against each other: what of them is compared, whether they are one, and how far vertices moved."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s, Int32s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Document
from beltrami_cli.layers.selection import Selection, select
from beltrami_cli.layers.settings import DEFAULTS, SLOTS, SmoothSettings
from beltrami_cli.layers.texel_colours import choose_textures
from beltrami_cli.surface.records import PaintedVertices, Slot, Texture, TexturedSurface

Pair = tuple[Document, Document]

EVERYTHING = dataclasses.replace(DEFAULTS, textures=dataclasses.replace(DEFAULTS.textures, slots=()))
"""Settings of a comparison of all that is coloured: where no slots are named, all are compared."""

# Texture coordinates of two files of one model may differ by this much, and vertices by this part of its size: text
# is often rounded to six digits.
_ROUNDING = 1e-5
ROUNDED_MOVE = 2e-5
_OTHER_MODEL = "compare two files of one model"


def choose_parts(documents: Pair, settings: SmoothSettings) -> tuple[Selection, list[str]]:
    """Choose the compared parts, by default all coloured ones; return notices on all others."""
    kinds = ["an image" if document.kind == "image" else "a model" for document in documents]
    if kinds[0] != kinds[1]:
        cause = f"it is {kinds[1]}, but {documents[0].name} is {kinds[0]}"
        raise InputError(documents[1].name, cause, "compare two files of one kind")
    if documents[0].kind == "image":
        return Selection(image=True), []
    notices: list[str] = []
    chosen = settings if settings.textures.slots else _everything(documents, settings, notices)
    selection = select(documents[0], chosen)
    notices += [notice for notice in selection.notices if notice.startswith("it has no ")]
    others = [f"{slot} textures" for slot in _slots_of(documents) if slot not in selection.slots]
    if not selection.vertices and any(document.has_vertex_colours() for document in documents):
        others.insert(0, "vertex colours")
    if settings.textures.names or settings.textures.materials:
        others.append("textures that --texture and --material leave out")
    if settings.channels is not None:
        others.append("other channels")
    return selection, [*notices, *([f"not compared: {', '.join(others)}"] if others else [])]


def _slots_of(documents: Pair) -> tuple[Slot, ...]:
    known = {slot for document in documents for slot in document.slots()}
    return tuple(sorted(known, key=SLOTS.index))


def _everything(documents: Pair, settings: SmoothSettings, notices: list[str]) -> SmoothSettings:
    """Return settings that name all that is coloured in both models; InputError if only one has some of it."""
    slots = () if settings.on == "vertices" else _slots_of(documents)
    for slot in slots:
        _require_both(documents, [slot in document.slots() for document in documents], f"{slot} textures")
    slots = tuple(slot for slot in slots if _is_readable(documents, slot, notices))
    has_globs = bool(settings.textures.names or settings.textures.materials)
    vertices = settings.on != "texture" and not (settings.on == "auto" and has_globs and slots)
    if vertices and slots:
        coloured = [document.has_vertex_colours() for document in documents]
        _require_both(documents, coloured, "vertex colours")
        vertices = settings.on == "both" or all(coloured)
    textures = dataclasses.replace(settings.textures, slots=slots or DEFAULTS.textures.slots)
    on = settings.on
    if slots:
        on = "both" if vertices else "texture"
    return dataclasses.replace(settings, on=on, textures=textures)


def _require_both(documents: Pair, has: list[bool], what: str) -> None:
    if has[0] != has[1]:
        names = [documents[not has[0]].name, documents[has[0]].name]
        cause = f"it has no {what}, but {names[0]} has"
        raise InputError(names[1], cause, "choose what both have with --slots or --on")


def _is_readable(documents: Pair, slot: Slot, notices: list[str]) -> bool:
    """Return whether the textures of a slot can be read in both models; raise the error if only in one."""
    errors = []
    for document in documents:
        try:
            document.textured(slot)
        except InputError as error:
            errors.append(error)
    if len(errors) == 1:
        raise errors[0]
    notices += [f"not compared: {slot} textures, because {error.cause}" for error in errors[:1]]
    return not errors


@dataclass(frozen=True)
class Moves:
    """How far vertices are from their places in the reference, in longest sides of its bounding box."""

    largest: float
    mean: float

    @property
    def is_rounding(self) -> bool:
        """Whether the rounding of text explains them."""
        return self.largest <= ROUNDED_MOVE


def moves_between(documents: Pair, selection: Selection) -> Moves:
    """Measure how far vertices moved, in all that is compared."""
    found = [np.zeros(0)]
    if selection.vertices:
        found.append(_moves(*(document.painted().positions for document in documents)))
    if selection.slots:
        surfaces = [document.textured(selection.slots[0]) for document in documents]
        found.append(_moves(*(surface.positions[surface.faces].reshape(-1, 3) for surface in surfaces)))
    every = np.concatenate(found) if any(moves.size for moves in found) else np.zeros(1)
    return Moves(float(every.max()), float(every.mean()))


def _moves(places: Float64s, others: Float64s) -> Float64s:
    """Return how far known places are apart, in sizes of the model, shape (K,)."""
    known = np.isfinite(places).all(axis=1) & np.isfinite(others).all(axis=1)
    places, others = places[known], others[known]
    moves = np.asarray(np.linalg.norm(others - places, axis=1), np.float64)
    if not len(places):
        return moves
    # Coordinates of a small model far from the origin are rounded by more.
    size = float(np.ptp(places, axis=0).max()) + float(np.abs(places).max()) * 1e-2
    return moves / size if size > 0 else np.where(moves > 0, np.inf, 0.0)


def require_one_model(documents: Pair, painted: tuple[PaintedVertices, PaintedVertices]) -> None:
    """Raise InputError if two models differ in more than colours and positions."""
    one, other = painted
    names = documents[0].name, documents[1].name
    counts = len(one.positions), len(other.positions)
    if counts[0] != counts[1]:
        cause = f"it has {counts[1]} coloured vertices, but {names[0]} {counts[0]}"
        raise InputError(names[1], cause, _OTHER_MODEL)
    faces, others = map(_triangles, documents)
    _require_as_many(faces, others, names)
    if not np.array_equal(faces, others):
        first = int((faces != others).any(axis=1).argmax())
        raise InputError(names[1], f"its triangle {first} is another than that of {names[0]}", _OTHER_MODEL)
    if one.channels != other.channels:
        channels = [", ".join(each.channels) for each in painted]
        cause = f"its channels are {channels[1]}, but {names[0]} has {channels[0]}"
        raise InputError(names[1], cause, "compare files with the same channels")
    if not len(one.faces) and _moves(one.positions, other.positions).max(initial=0) > ROUNDED_MOVE:
        raise InputError(names[1], f"its points are at other places than in {names[0]}", _OTHER_MODEL)


def _triangles(document: Document) -> Int32s:
    """Return the triangles of a model, shape (F, 3); of a level set those without colours too."""
    if document.kind == "volume":
        return document.contents().corners.reshape(-1, 3)
    return document.painted().faces


def _require_as_many(faces: Int32s, others: Int32s, names: tuple[str, str]) -> None:
    if len(faces) != len(others):
        cause = f"it has {len(others)} triangles, but {names[0]} {len(faces)}"
        raise InputError(names[1], cause, _OTHER_MODEL)


def same_textures(
    surface: TexturedSurface, other: TexturedSurface, settings: SmoothSettings, names: tuple[str, str]
) -> tuple[Texture, ...]:
    """Return the textures of the one surface that are the chosen ones of the other."""
    # Vertices may be split, and numbered, otherwise: corners are one by their texture coordinates, and their places are
    # measured as moves.
    _require_as_many(surface.faces, other.faces, names)
    if len(surface.textures) != len(other.textures):
        cause = f"it has {len(other.textures)} textures, but {names[0]} {len(surface.textures)}"
        raise InputError(names[1], cause, _OTHER_MODEL)
    used = surface.texture_of >= 0
    # The numbers that textures have in the other, where they may be in another order; that of no texture first.
    number_of = np.arange(-1, len(other.textures))
    number_of[surface.texture_of + 1] = other.texture_of
    same = number_of[0] == -1 and len(np.unique(number_of)) == len(number_of)
    same &= np.array_equal(number_of[surface.texture_of + 1], other.texture_of)
    if not same or not np.allclose(surface.uv[used], other.uv[used], rtol=0, atol=_ROUNDING):
        cause = f"its texture coordinates differ from {names[0]}"
        raise InputError(names[1], cause, _OTHER_MODEL)
    pairs = zip(surface.textures, number_of[1:], strict=True)
    numbered = [dataclasses.replace(texture, key=str(number)) for texture, number in pairs]
    chosen = choose_textures(dataclasses.replace(surface, textures=tuple(numbered)), settings.textures)
    return tuple(other.textures[int(texture.key)] for texture in chosen.textures)
