"""The colours of two files at the same samples: vertices, pixels, and texels of each texture."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Literal

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.flow.colour_space import to_space
from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.compare.figures import ComparedColours, SeamJumps
from beltrami_cli.jobs.compare.measures import cie_lab, delta_e_2000, structural_similarity
from beltrami_cli.jobs.compare.seams import near_seams, seam_steps, texel_areas
from beltrami_cli.samples.memory_check import require_memory
from beltrami_cli.samples.painted_samples import choose_channels
from beltrami_cli.samples.pixel_samples import PixelSamples
from beltrami_cli.samples.selection import coloured_vertices
from beltrami_cli.samples.texel_colours import TexelColours, choose_textures
from beltrami_cli.samples.texel_samples import TexelSamples
from beltrami_cli.samples.vertex_samples import with_surface
from beltrami_cli.samples.voxels import LevelSetDocument
from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.surface.geometry import vertex_areas
from beltrami_cli.surface.grouping import group_places

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import Space, Weights
    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.formats.image.document import ImageDocument
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.records import PaintedVertices, Slot, Texture, TexturedSurface

_BLOCK = 1 << 18  # colours compared at a time, which bounds the memory for them
# Positions that two files of one model may differ by, of the model's size, and texture coordinates: text is
# often rounded to six digits.
_ROUNDING = 1e-5
_OTHER_MODEL = "compare two files of one model"


def compare_vertices(
    reference: Document, test: Document, settings: SmoothSettings, weights: Weights
) -> tuple[ComparedColours, tuple[str, ...]]:
    """Bring the vertex colours of two models together; return notices, too."""
    one, other = reference.painted(), test.painted()
    moved = _require_one_model((reference, test), (one, other))
    rows = np.intersect1d(coloured_vertices(reference), coloured_vertices(test))
    channels = choose_channels(one, settings).changing
    colours = [
        to_space(painted.colours[rows][:, channels], painted.encoding, settings.space)
        for painted in (one, other)
    ]
    if not np.isfinite(colours[1]).all():
        raise InputError(test.name, "some of its colours are no finite numbers, which cannot be compared")
    place, _ = group_places(one.positions[rows], None if one.space_of is None else one.space_of[rows])
    split = np.bincount(place)[place] > 1 if len(place) else np.zeros(0, bool)
    part = ComparedColours(
        "vertex colours",
        "vertices",
        colours[0],
        colours[1],
        rows.astype(np.int64),
        _areas(one, rows, settings) if weights == "area" else np.ones(len(rows)),
        colour_differences(colours[0], colours[1], settings.space),
        near_seams=split if split.any() else None,
        jumps=_jumps(colours, place) if split.any() else None,
    )
    notices = ("its vertices are not where those of the reference are; only colours are compared",)
    return part, notices if moved > 1 else ()


def _require_one_model(
    documents: tuple[Document, Document], painted: tuple[PaintedVertices, PaintedVertices]
) -> float:
    """Raise InputError if two models differ in more than colours and positions; return how far vertices move."""
    one, other = painted
    names = documents[0].name, documents[1].name
    counts = len(one.positions), len(other.positions)
    if counts[0] != counts[1]:
        raise InputError(
            names[1], f"it has {counts[1]} coloured vertices, but {names[0]} {counts[0]}", _OTHER_MODEL
        )
    _require_same_triangles(_triangles(documents[0]), _triangles(documents[1]), names)
    if one.channels != other.channels:
        cause = (
            f"its colours are {', '.join(other.channels)}, but those of {names[0]} {', '.join(one.channels)}"
        )
        raise InputError(names[1], cause, "compare files with the same channels")
    moved = _largest_move(one, other)
    if not len(one.faces) and moved > 1:
        raise InputError(names[1], f"its points are not where those of {names[0]} are", _OTHER_MODEL)
    return moved


def _triangles(document: Document) -> NDArray[np.int32]:
    """Return the triangles of a model, shape (F, 3); of a level set those without colours too."""
    if isinstance(document, LevelSetDocument):
        return document.contents().corners.reshape(-1, 3)
    return document.painted().faces


def _require_same_triangles(
    faces: NDArray[np.int32], others: NDArray[np.int32], names: tuple[str, str]
) -> None:
    if len(faces) != len(others):
        raise InputError(
            names[1], f"it has {len(others)} triangles, but {names[0]} {len(faces)}", _OTHER_MODEL
        )
    if not np.array_equal(faces, others):
        first = int((faces != others).any(axis=1).argmax())
        raise InputError(names[1], f"its triangle {first} is another than that of {names[0]}", _OTHER_MODEL)


def _largest_move(one: PaintedVertices, other: PaintedVertices) -> float:
    """Return how far vertices are from each other at most, in units of what rounding explains."""
    known = np.isfinite(one.positions).all(axis=1) & np.isfinite(other.positions).all(axis=1)
    if not known.any():
        return 0.0
    places = one.positions[known]
    size = float((places.max(axis=0) - places.min(axis=0)).max()) + float(np.abs(places).max()) * 1e-2
    move = float(np.abs(other.positions[known] - places).max())
    if size > 0:
        return move / (_ROUNDING * size)
    return np.inf if move > 0 else 0.0


def _areas(painted: PaintedVertices, rows: NDArray[np.intp], settings: SmoothSettings) -> NDArray[np.float64]:
    """Return the area that each vertex stands for; of points, on the surface that they lie on."""
    if len(painted.faces):
        return vertex_areas(painted.positions, painted.faces)[rows].astype(np.float64)
    spaces = None if painted.space_of is None else painted.space_of[rows]
    known = dataclasses.replace(
        painted, positions=painted.positions[rows], colours=painted.colours[rows], space_of=spaces
    )
    surface = with_surface(known, settings)
    return vertex_areas(surface.positions, surface.faces).astype(np.float64)


def _jumps(colours: list[NDArray[np.float32]], place: NDArray[np.int32]) -> SeamJumps:
    """Measure how far the colours of vertices at one place are from each other: mean of the channels' ranges."""
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.r_[True, place[order][1:] != place[order][:-1]])
    several = np.diff(np.r_[starts, len(order)]) > 1
    reference, test = (
        (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).mean(axis=1)
        for values in colours
    )
    return SeamJumps(reference[several].astype(np.float64), test[several].astype(np.float64))


def compare_images(
    documents: Sequence[ImageDocument], settings: SmoothSettings, access: Access
) -> ComparedColours:
    """Bring the pixels of two images together that can be seen in the reference, and are finite numbers there."""
    names = [document.name for document in documents]
    require_memory([(document.name, document.data) for document in documents], access)
    _require_same_size(documents[0].picture(), documents[1].picture(), names[1])
    samples = [PixelSamples(document, settings, access, colours_only=True) for document in documents]
    one, other, valid = samples[0].colours, samples[1].colours, samples[0].valid
    if one.names != other.names:
        cause = f"it has the channels {', '.join(other.names)}, but {names[0]} {', '.join(one.names)}"
        raise InputError(names[1], cause, "compare images with the same channels, or choose with --channels")
    if not other.usable()[valid].all():
        count = int(np.count_nonzero(~other.usable()[valid]))
        raise InputError(names[1], f"{count} of its pixels are no finite numbers, but are in {names[0]}")
    pixels = np.flatnonzero(valid)
    colours = one.samples(pixels), other.samples(pixels)
    space = settings.space if set(one.names) <= {"red", "green", "blue", "grey"} else "data"
    size = (valid.shape[0], valid.shape[1])
    return _part_of_image("image", "image", colours, pixels, size, np.ones(len(pixels)), space)


def _part_of_image(
    name: str,
    kind: Literal["image", "texture"],
    colours: tuple[NDArray[np.float32], NDArray[np.float32]],
    pixels: NDArray[np.int64],
    size: tuple[int, int],
    weights: NDArray[np.float64],
    space: Space,
) -> ComparedColours:
    """Return some pixels (row * width + column) of two images as a part."""
    rows, columns = np.divmod(pixels, size[1])
    return ComparedColours(
        name,
        kind,
        colours[0],
        colours[1],
        np.stack([columns, rows], axis=1),
        weights,
        colour_differences(colours[0], colours[1], space),
        _similarity(colours[0], colours[1], pixels, size),
        size=size,
    )


def compare_textures(
    reference: Document,
    test: Document,
    slot: Slot,
    settings: SmoothSettings,
    weights: Weights,
    access: Access,
) -> list[ComparedColours]:
    """Bring the textures of a slot together, each a part of its own, texel by texel on the surface."""
    surface = reference.textured(slot)
    textures = _same_textures(surface, test.textured(slot), settings, (reference.name, test.name))
    require_memory(((texture.name, texture.data) for texture in textures), access)
    prepared = TexelSamples(surface, slot, settings)
    pictures = [read_image(texture.data, texture.name) for texture in textures]
    for old, new in zip(prepared.pictures, pictures, strict=True):
        _require_same_size(old, new, f"{test.name}: {new.name}")
    colours = TexelColours(pictures, slot, settings)
    if colours.names != prepared.colours.names:
        cause = f"its {slot} textures have {', '.join(colours.names)}, but {', '.join(prepared.colours.names)} before"
        raise InputError(test.name, cause, "compare files with the same channels")
    atlas = prepared.atlas
    both = prepared.colours.samples(atlas), colours.samples(atlas)
    counted = texel_areas(atlas) if weights == "area" else np.ones(len(atlas.owned_texels))
    return _parts(prepared, both, counted, slot, prepared.colours.space)


def _parts(
    prepared: TexelSamples,
    both: tuple[NDArray[np.float32], NDArray[np.float32]],
    weights: NDArray[np.float64],
    slot: Slot,
    space: Space,
) -> list[ComparedColours]:
    """Cut what belongs to all textures together in parts."""
    atlas = prepared.atlas
    near = near_seams(atlas)
    cells, before = seam_steps(atlas, both[0])
    _, after = seam_steps(atlas, both[1])
    texture_of = np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1
    parts = []
    for index, picture in enumerate(prepared.pictures):
        inside, here = texture_of == index, texture_of[cells] == index
        texels = atlas.owned_texels[inside] - atlas.texture_offsets[index]
        colours = both[0][inside], both[1][inside]
        name = f"{slot} {prepared.surface.textures[index].name}"
        size = picture.pixels.shape[:2]
        part = _part_of_image(name, "texture", colours, texels, size, weights[inside], space)
        near_here = near[inside] if near[inside].any() else None
        jumps = SeamJumps(before[here], after[here]) if here.any() else None
        parts.append(dataclasses.replace(part, near_seams=near_here, jumps=jumps))
    return parts


def _similarity(
    one: NDArray[np.float32], other: NDArray[np.float32], texels: NDArray[np.int64], size: tuple[int, int]
) -> float | None:
    """Compute the structural similarity of two images of which some texels (row * width + column) count."""
    counts = np.zeros(size, bool)
    counts.reshape(-1)[texels] = True
    images = []
    for colours in (one, other):
        image = np.zeros((*size, colours.shape[1]), np.float32)
        image.reshape(-1, colours.shape[1])[texels] = colours
        images.append(image)
    return structural_similarity(images[0], images[1], counts)


def _require_same_size(old: Picture, new: Picture, name: str) -> None:
    """Raise InputError if two images have not the same numbers of rows and columns."""
    sizes = [f"{picture.pixels.shape[1]} x {picture.pixels.shape[0]}" for picture in (old, new)]
    if sizes[0] != sizes[1]:
        raise InputError(
            name, f"it has {sizes[1]} pixels, but {old.name} {sizes[0]}", "compare images of one size"
        )


def _same_textures(
    surface: TexturedSurface, other: TexturedSurface, settings: SmoothSettings, names: tuple[str, str]
) -> tuple[Texture, ...]:
    """Return the textures of the one surface that are the chosen ones of the other."""
    _require_same_triangles(surface.faces, other.faces, names)
    if len(surface.textures) != len(other.textures):
        cause = f"it has {len(other.textures)} textures, but {names[0]} {len(surface.textures)}"
        raise InputError(names[1], cause, _OTHER_MODEL)
    used = surface.texture_of >= 0
    same = np.array_equal(surface.texture_of, other.texture_of)
    if not same or not np.allclose(surface.uv[used], other.uv[used], rtol=0, atol=_ROUNDING):
        cause = f"its texture coordinates are not those of {names[0]}"
        raise InputError(names[1], cause, _OTHER_MODEL)
    numbered = [dataclasses.replace(texture, key=str(i)) for i, texture in enumerate(surface.textures)]
    chosen = choose_textures(dataclasses.replace(surface, textures=tuple(numbered)), settings.textures)
    return tuple(other.textures[int(texture.key)] for texture in chosen.textures)


def colour_differences(
    reference: NDArray[np.float32], test: NDArray[np.float32], space: Space
) -> NDArray[np.float64] | None:
    """Compute how different colours look, shape (S,); None if they are no colours."""
    if space not in ("srgb", "linear") or reference.shape[1] not in (1, 3):
        return None
    found = np.empty(len(reference))
    for first in range(0, len(reference), _BLOCK):
        block = slice(first, first + _BLOCK)
        found[block] = delta_e_2000(*(_lab(colours[block], space) for colours in (reference, test)))
    return found


def _lab(colours: NDArray[np.float32], space: Space) -> NDArray[np.float64]:
    linear = srgb_to_linear(colours) if space == "srgb" else colours
    return cie_lab(np.broadcast_to(linear, (len(linear), 3)))
