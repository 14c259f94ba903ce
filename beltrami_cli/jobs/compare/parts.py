"""The colours of two files at the same samples: vertices, pixels, and texels of each texture."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.flow.embedding import to_space
from beltrami_cli.flow.parameters import Space, Weights
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture, read_texture
from beltrami_cli.formats.image.picture import full_scale_one
from beltrami_cli.jobs.compare.figures import (
    ComparedColours,
    cie_lab,
    delta_e_2000,
    structural_similarity,
)
from beltrami_cli.jobs.compare.models import require_one_model, same_textures
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.layer import choose_channels
from beltrami_cli.layers.memory_check import COMPARED_PIXEL_BYTES, require_memory
from beltrami_cli.layers.picture_colours import PictureColours
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.texel_colours import all_texel_colours, choose_textures
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.vertex_layer import coloured_rows, only_rows, with_surface
from beltrami_cli.surface.atlas import EMPTY, REACH, Atlas, at_seam, lines_over_seams, refresh_halo, within
from beltrami_cli.surface.geometry import vertex_areas
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import PaintedVertices, Slot, Texture, srgb_to_linear

# Distance from a seam that counts as near, in texels.
_NEAR = 4
_STEP = 0.75 / 255  # of opacity, which 8 bits store
_BLOCK = 1 << 18  # colours compared at a time, which bounds the memory for them


def near_seams(atlas: Atlas) -> Bools:
    """Return which owned cells are within 4 texels of a seam, shape (T,)."""
    at_border = np.zeros(atlas.kind.shape, bool)
    for inner, *_ in lines_over_seams(atlas, 1):
        at_border.reshape(-1)[inner] = True
    # Charts are further apart on the canvas than this reaches.
    return within(at_border, _NEAR - 1).reshape(-1)[atlas.owned_cells]


def seam_steps(atlas: Atlas, colours: Float32s) -> tuple[Int64s, Float64s]:
    """Return the owned cells at seams (rows of `colours`, shape (T, N)) and the jump there, mean over channels."""
    # The colours of three texels on a line across the seam are extrapolated to it, from both sides.
    planes = np.zeros((colours.shape[1], *atlas.kind.shape), np.float32)
    planes.reshape(len(planes), -1)[:, atlas.owned_cells] = colours.T
    refresh_halo(planes, atlas, interpolated=True)
    flat = planes.reshape(len(planes), -1)
    cells, steps = [np.zeros(0, np.int64)], [np.zeros(0)]
    for line in lines_over_seams(atlas, REACH):
        jump = at_seam([flat[:, o] - flat[:, i] for i, o in zip(line[:REACH], line[REACH:], strict=True)])
        cells.append(line[0])
        steps.append(np.abs(jump).mean(axis=0))
    return np.searchsorted(atlas.owned_cells, np.concatenate(cells)), np.concatenate(steps)


def texel_areas(atlas: Atlas) -> Float64s:
    """Return the surface area of each owned cell, shape (T,), in the surface's own unit squared."""
    across, down, diagonal = (plane.astype(np.float64) for plane in atlas.squared_lengths[:3])
    known = (atlas.kind != EMPTY)[:-1, :-1] & (atlas.kind != EMPTY)[1:, 1:]
    known &= (atlas.kind != EMPTY)[:-1, 1:] & (atlas.kind != EMPTY)[1:, :-1]
    sides = across[:-1, :-1], down[:-1, :-1], diagonal[:-1, :-1]
    known &= np.isfinite(sides[0]) & np.isfinite(sides[1]) & np.isfinite(sides[2])
    a, b, c = (np.where(known, side, 0) for side in sides)
    # Each square of four cells is the parallelogram of its sides; a cell has the mean of the squares around it.
    # |a x b|^2 = |a|^2 |b|^2 - (a . b)^2, where a . b follows from |a + b|^2.
    area = np.sqrt(np.maximum(a * b - ((c - a - b) / 2) ** 2, 0))
    total, count = np.zeros(atlas.kind.shape), np.zeros(atlas.kind.shape)
    for rows in (slice(None, -1), slice(1, None)):
        for columns in (slice(None, -1), slice(1, None)):
            total[rows, columns] += area
            count[rows, columns] += known
    owned_total, owned_count = (plane.reshape(-1)[atlas.owned_cells] for plane in (total, count))
    measured = owned_count > 0
    usual = float(np.mean(owned_total[measured] / owned_count[measured])) if measured.any() else 1.0
    return np.where(measured, owned_total / np.maximum(owned_count, 1), usual)


def compare_vertices(
    documents: tuple[Document, Document], settings: SmoothSettings, weights: Weights, *, is_extra: bool
) -> ComparedColours:
    """Bring the vertex colours of two models together; `is_extra`: textures are compared, too."""
    one, other = _on_one_scale(*(document.painted() for document in documents))
    require_one_model(documents, (one, other))
    held = [coloured_rows(each.painted(), in_triangles=each.kind == "volume") for each in documents]
    rows = np.intersect1d(held[0], held[1])
    channels, space = choose_channels(one.channels, settings, "the colours have").changing, settings.space
    reference, test = (
        to_space(each.colours[rows][:, channels], each.encoding, space) for each in (one, other)
    )
    if not np.isfinite(test).all():
        cause = "some of its colours are no finite numbers, which cannot be compared"
        raise InputError(documents[1].name, cause)
    place, _ = group_places(one.positions[rows], None if one.space_of is None else one.space_of[rows])
    split = np.bincount(place)[place] > 1 if len(place) else np.zeros(0, bool)
    counted = _areas(one, rows, settings) if weights == "area" else np.ones(len(rows))
    opacities = (None if each.kind == "volume" else each.contents().alpha for each in documents)
    return ComparedColours(
        "vertex colours", "vertices", reference, test, rows.astype(np.int64), counted,
        colour_differences(reference, test, space),
        near_seams=split if split.any() else None,
        jumps=_jumps([reference, test], place) if split.any() else None,
        is_identical=is_extra and np.array_equal(reference, test),
        other_opacity=_differ(*opacities),
    )  # fmt: skip


def _opacity(picture: Picture) -> Float32s | None:
    return None if picture.alpha is None else full_scale_one(picture.pixels[..., picture.alpha])


def _differ(one: Float32s | None, other: Float32s | None) -> bool:
    """Whether two opacities differ by more than rounding; None: all is opaque."""
    difference = np.asarray(1.0 if one is None else one) - (1.0 if other is None else other)
    return bool(np.abs(difference).max(initial=0) > _STEP)


def _on_one_scale(one: PaintedVertices, other: PaintedVertices) -> tuple[PaintedVertices, PaintedVertices]:
    """Return colours of one full scale, since a smoothed file may fit into fewer bits."""
    scales = np.array([one.full_scale, other.full_scale])
    if one.stored != other.stored or scales[0] == scales[1] or scales.min() <= 1:
        return one, other
    shares = (scales / scales.max()).astype(np.float32)
    first, second = (
        dataclasses.replace(each, colours=each.colours * share)
        for each, share in zip((one, other), shares, strict=True)
    )
    return first, second


def _areas(painted: PaintedVertices, rows: NDArray[np.intp], settings: SmoothSettings) -> Float64s:
    """Return the area that each vertex stands for; of points, on the surface that they lie on."""
    if len(painted.faces):
        return vertex_areas(painted.positions, painted.faces)[rows].astype(np.float64)
    surface = with_surface(only_rows(painted, rows), settings)
    return vertex_areas(surface.positions, surface.faces).astype(np.float64)


def _jumps(colours: list[Float32s], place: Int32s) -> tuple[Float64s, Float64s]:
    """Measure how far the colours of vertices at one place are from each other: mean of the channels' ranges."""
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.r_[True, place[order][1:] != place[order][:-1]])
    several = np.diff(np.r_[starts, len(order)]) > 1
    reference, test = (
        (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).mean(axis=1)
        for values in colours
    )
    return reference[several].astype(np.float64), test[several].astype(np.float64)


def compare_images(
    documents: Sequence[Document], settings: SmoothSettings, access: Access
) -> ComparedColours:
    """Bring the pixels of two images together that can be seen in the reference, and are finite numbers there."""
    names = [document.name for document in documents]
    both = [(document.name, document.data) for document in documents]
    require_memory(both, access, COMPARED_PIXEL_BYTES)
    _require_same_size(documents[0].picture(), documents[1].picture(), names[1])
    samples = [ImageLayer.read(document, settings, access, colours_only=True) for document in documents]
    one, other, valid = samples[0].colours, samples[1].colours, samples[0].valid
    if one.names != other.names:
        cause = f"it has the channels {', '.join(other.names)}, but {names[0]} {', '.join(one.names)}"
        raise InputError(names[1], cause, "compare images with the same channels, or choose with --channels")
    if count := int(np.count_nonzero(~other.finite(samples[1].picture)[valid])):
        raise InputError(names[1], f"{count} of its pixels are no finite numbers, but are in {names[0]}")
    pixels = np.flatnonzero(valid)
    colours = one.working(samples[0].picture, pixels), other.working(samples[1].picture, pixels)
    space = settings.space if set(one.names) <= {"red", "green", "blue", "grey"} else "data"
    part = _part_of_image("image", "image", colours, pixels, valid.shape, np.ones(len(pixels)), space)
    opacity = [None if "alpha" in one.names else _opacity(each.picture) for each in samples]
    return dataclasses.replace(part, other_opacity=_differ(*opacity))


def _part_of_image(
    name: str, kind: Literal["image", "texture"], colours: tuple[Float32s, Float32s], pixels: Int64s,
    size: tuple[int, ...], weights: Float64s, space: Space,
) -> ComparedColours:  # fmt: skip
    """Return some pixels (row * width + column) of two images of `size` = (rows, columns) as a part."""
    counts = np.zeros((size[0], size[1]), bool)
    counts.reshape(-1)[pixels] = True
    images = np.zeros((2, *counts.shape, colours[0].shape[1]), np.float32)
    images.reshape(2, counts.size, -1)[:, pixels] = colours
    rows, columns = np.divmod(pixels, size[1])
    return ComparedColours(
        name, kind, *colours, np.stack([columns, rows], axis=1), weights, colour_differences(*colours, space),
        structural_similarity(images[0], images[1], counts), size=counts.shape,
    )  # fmt: skip


def compare_textures(
    documents: tuple[Document, Document], slot: Slot, settings: SmoothSettings, weights: Weights, access: Access,
    *, is_extra: bool,
) -> list[ComparedColours]:  # fmt: skip
    """Bring textures of a slot together, each a part; `is_extra`: of equal files it is enough to say that they are."""
    reference, test = documents
    surface = reference.textured(slot)
    textures = same_textures(surface, test.textured(slot), settings, (reference.name, test.name))
    olds = choose_textures(surface, settings.textures).textures
    if is_extra and [texture.data for texture in olds] == [texture.data for texture in textures]:
        nothing = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros((0, 2), np.int64)
        return [
            ComparedColours(name, "texture", *nothing, np.zeros(0), None, is_identical=True)
            for name in _names(slot, olds)
        ]
    require_memory(((texture.name, texture.data) for texture in textures), access)
    prepared = TextureLayer.read(surface, slot, settings)
    pictures = [read_texture(texture) for texture in textures]
    for old, new in zip(prepared.pictures, pictures, strict=True):
        _require_same_size(old, new, f"{test.name}: {new.name}")
    colours = PictureColours.of(pictures, slot, settings)
    if colours.names != prepared.colours.names:
        cause = f"its {slot} textures have {', '.join(colours.names)}, but {', '.join(prepared.colours.names)} before"
        raise InputError(test.name, cause, "compare files with the same channels")
    atlas = prepared.atlas
    both = (
        all_texel_colours(prepared.colours, prepared.pictures, atlas),
        all_texel_colours(colours, pictures, atlas),
    )
    counted = texel_areas(atlas) if weights == "area" else np.ones(len(atlas.owned_texels))
    opacities = [[_opacity(picture) for picture in each] for each in (prepared.pictures, pictures)]
    hides = [texture.alpha_hides for texture in prepared.surface.textures]
    differ = [hidden and _differ(old, new) for hidden, old, new in zip(hides, *opacities, strict=True)]
    parts = _parts(prepared, both, counted, slot, prepared.colours.space)
    around = [_around(prepared, colours, pictures, index) for index in range(len(pictures))]
    return [
        dataclasses.replace(part, other_opacity=each, around=pair)
        for part, each, pair in zip(parts, differ, around, strict=True)
    ]


def _around(
    prepared: TextureLayer, colours: PictureColours, pictures: Sequence[Picture], index: int
) -> tuple[Float32s, Float32s]:
    """Return the colours, in both files, of a texture's texels that faces look up, but none covers."""
    atlas = prepared.atlas
    begin, end = atlas.texture_offsets[index : index + 2].tolist()
    every = np.concatenate([atlas.border_texels, atlas.lone_texels]).astype(np.int64)
    own = every[(every >= begin) & (every < end)] - begin
    picture = prepared.pictures[index]
    if prepared.surface.textures[index].alpha_hides:
        own = own[~prepared.colours.hidden(picture, own)]
    return prepared.colours.working(picture, own), colours.working(pictures[index], own)


def _names(slot: Slot, textures: Sequence[Texture]) -> list[str]:
    """Return the names of parts; of textures with equal names also what the files know them by."""
    count = Counter(texture.name for texture in textures)
    return [f"{slot} {texture.name if count[texture.name] == 1 else texture.key}" for texture in textures]


def _parts(
    prepared: TextureLayer, both: tuple[Float32s, Float32s], weights: Float64s, slot: Slot, space: Space
) -> list[ComparedColours]:
    """Cut what belongs to all textures together in parts."""
    atlas = prepared.atlas
    near = near_seams(atlas)
    cells, before = seam_steps(atlas, both[0])
    _, after = seam_steps(atlas, both[1])
    texture_of = np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1
    names = _names(slot, prepared.surface.textures)
    parts = []
    for index, picture in enumerate(prepared.pictures):
        inside, here = texture_of == index, texture_of[cells] == index
        texels = atlas.owned_texels[inside] - atlas.texture_offsets[index]
        colours, size = (both[0][inside], both[1][inside]), picture.pixels.shape[:2]
        part = _part_of_image(names[index], "texture", colours, texels, size, weights[inside], space)
        near_here = near[inside] if near[inside].any() else None
        jumps = (before[here], after[here]) if here.any() else None
        parts.append(dataclasses.replace(part, near_seams=near_here, jumps=jumps))
    return parts


def _require_same_size(old: Picture, new: Picture, name: str) -> None:
    sizes = [f"{picture.pixels.shape[1]} x {picture.pixels.shape[0]}" for picture in (old, new)]
    if sizes[0] != sizes[1]:
        cause = f"it has {sizes[1]} pixels, but {old.name} {sizes[0]}"
        raise InputError(name, cause, "compare images of one size")


def colour_differences(reference: Float32s, test: Float32s, space: Space) -> Float64s | None:
    """Compute how different colours look, shape (S,); None if they are no colours."""
    if space not in ("srgb", "linear") or reference.shape[1] not in (1, 3):
        return None
    found = np.empty(len(reference))
    for first in range(0, len(reference), _BLOCK):
        block = slice(first, first + _BLOCK)
        pair = (colours[block] for colours in (reference, test))
        light = (srgb_to_linear(colours) if space == "srgb" else colours for colours in pair)
        found[block] = delta_e_2000(*(cie_lab(np.broadcast_to(each, (len(each), 3))) for each in light))
    return found
