"""The colours of two files of one model at the same samples: vertices, pixels, and texels of each texture."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.jobs.compare.figures import ComparedPart, Pair
from beltrami_cli.jobs.compare.same_model import (
    Documents,
    matching_textures,
    require_one_model,
    require_same_size,
)
from beltrami_cli.layers.channels import choose_channels
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.image_memory import require_memory
from beltrami_cli.layers.pixel_colours import PixelColours
from beltrami_cli.layers.settings import DEFAULTS, SmoothSettings
from beltrami_cli.layers.texture_groups import choose_textures
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import (
    REACH,
    Atlas,
    at_seam,
    lines_over_seams,
    texel_areas,
)
from beltrami_cli.surface.colour_values import to_space
from beltrami_cli.surface.geometry import vertex_areas
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.gutters import within
from beltrami_cli.surface.points import with_surface
from beltrami_cli.surface.records import ColouredVertices, Slot

_SEAM_DISTANCE = 4  # texels from a seam that count as near
_OPACITY_TOLERANCE = 0.75 / 255  # below a step of 8 bits, in which opacity is stored


def compare_vertices(
    documents: Documents, settings: SmoothSettings, weights: Weights, *, is_extra: bool
) -> ComparedPart:
    """Match the vertex colours of two models; `is_extra`: textures are compared, too."""
    one, other = _on_one_scale(*(document.coloured_vertices() for document in documents))
    require_one_model(documents, (one, other))
    rows = np.intersect1d(one.coloured_rows(), other.coloured_rows())
    channels, space = choose_channels(one.channels, settings, "the colours have").changing, settings.space

    def read(vertices: Indices) -> Pair:
        first, second = (
            to_space(each.colours[vertices][:, channels], each.encoding, space) for each in (one, other)
        )
        return first, second

    reference, test = read(rows)
    if not np.isfinite(test).all():
        cause = "some of its colours are not finite numbers, which cannot be compared"
        raise InputError(documents[1].name, cause)
    place, _ = group_places(one.positions[rows], None if one.space_of is None else one.space_of[rows])
    split = np.bincount(place)[place] > 1 if len(place) else np.zeros(0, bool)
    opacities = (None if each.kind == "volume" else each.contents().alpha for each in documents)
    return ComparedPart(
        name="vertex colours", kind="vertices", index=rows, read=read, space=space,
        weights=_vertex_areas(one, rows, settings) if weights == "area" else None,
        near_seams=split if split.any() else None,
        jumps=_vertex_jumps([reference, test], place) if split.any() else None,
        is_identical=is_extra and np.array_equal(reference, test),
        other_opacity=_opacities_differ(*opacities),
    )  # fmt: skip


def _opacity(image: DecodedImage) -> Float32s | None:
    return None if image.alpha is None else full_scale_one(image.pixels[..., image.alpha])


def _opacities_differ(one: Float32s | None, other: Float32s | None) -> bool:
    """Whether two opacities differ by more than rounding; None: all is opaque."""
    difference = np.asarray(1.0 if one is None else one) - (1.0 if other is None else other)
    return bool(np.abs(difference).max(initial=0) > _OPACITY_TOLERANCE)


def _on_one_scale(
    one: ColouredVertices, other: ColouredVertices
) -> tuple[ColouredVertices, ColouredVertices]:
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


def _vertex_areas(vertices: ColouredVertices, rows: NDArray[np.intp], settings: SmoothSettings) -> Float64s:
    """Return the part of the surface area that belongs to each vertex or point."""
    if len(vertices.faces):
        return vertex_areas(vertices.positions, vertices.faces)[rows].astype(np.float64)
    surface = with_surface(vertices.only(rows), settings.kernel.thread_count)
    return vertex_areas(surface.positions, surface.faces).astype(np.float64)


def _vertex_jumps(colours: list[Float32s], place: Int32s) -> tuple[Float64s, Float64s]:
    """Return the range of the colours of vertices at one place, as the mean over channels."""
    order = np.argsort(place, kind="stable")
    starts = np.flatnonzero(np.r_[True, place[order][1:] != place[order][:-1]])
    several = np.diff(np.r_[starts, len(order)]) > 1
    reference, test = (
        (np.maximum.reduceat(values[order], starts) - np.minimum.reduceat(values[order], starts)).mean(axis=1)
        for values in colours
    )
    return reference[several].astype(np.float64), test[several].astype(np.float64)


def compare_images(documents: Documents, settings: SmoothSettings, access: Access) -> ComparedPart:
    """Match the pixels of two images that are visible and finite in the reference."""
    names = [document.name for document in documents]
    slots = settings.textures.slots or DEFAULTS.textures.slots  # which images do without
    settings = dataclasses.replace(settings, textures=dataclasses.replace(settings.textures, slots=slots))
    require_memory([(document.name, document.data) for document in documents], access, "compared")
    require_same_size(documents[0].image(), documents[1].image(), names[1])
    samples = [ImageLayer.read(document, settings, colours_only=True) for document in documents]
    one, other, valid = samples[0].colours, samples[1].colours, samples[0].valid
    images = [each.image for each in samples]
    if one.names != other.names:
        cause = f"it has the channels {', '.join(other.names)}, but {names[0]} {', '.join(one.names)}"
        raise InputError(names[1], cause, "compare images with the same channels, or choose with --channels")
    if count := int(np.count_nonzero(~other.finite(images[1])[valid])):
        raise InputError(names[1], f"{count} of its pixels are not finite numbers, but are in {names[0]}")
    opacities = [None if "alpha" in one.names else _opacity(image) for image in images]
    return ComparedPart(
        name="image", kind="image", index=large_arrays.indices_of(valid, True),
        read=partial(_both_colours, (one, images[0]), (other, images[1])),
        space=settings.space if set(one.names) <= {"red", "green", "blue", "grey"} else "data",
        size=(valid.shape[0], valid.shape[1]), other_opacity=_opacities_differ(*opacities),
    )  # fmt: skip


def compare_textures(
    documents: Documents, slot: Slot, settings: SmoothSettings, weights: Weights, access: Access,
    *, is_extra: bool,
) -> list[ComparedPart]:  # fmt: skip
    """Match the textures of a slot, each a part; `is_extra`: equal files need only a notice."""
    reference, test = documents
    surface = reference.textured(slot)
    same = matching_textures(surface, test.textured(slot), (reference.name, test.name))
    chosen = choose_textures(surface, settings.textures)
    before, after = chosen.textures, [same[texture.key] for texture in chosen.textures]
    count = Counter(texture.name for texture in before)
    # Keys distinguish textures with equal names.
    names = [f"{slot} {each.name if count[each.name] == 1 else each.key}" for each in before]
    if is_extra and [texture.data for texture in before] == [texture.data for texture in after]:
        nothing = np.zeros((0, 3), np.float32)
        return [
            ComparedPart(
                name=name, kind="texture", index=np.zeros(0, np.int64), read=lambda _: (nothing, nothing),
                space="data", is_identical=True,
            )
            for name in names
        ]  # fmt: skip
    require_memory(((texture.name, texture.data) for texture in after), access)
    one = TextureLayer.read(chosen, slot, settings)
    images = [read_texture(texture) for texture in after]
    for old, new in zip(one.images, images, strict=True):
        require_same_size(old, new, f"{test.name}: {new.name}")
    colours = PixelColours.of(images, slot, settings)
    if colours.names != one.names:
        cause = f"its {slot} textures have {', '.join(colours.names)}, but {', '.join(one.names)} before"
        raise InputError(test.name, cause, "compare files with the same channels")
    return _by_texture(one, dataclasses.replace(one, images=images, colours=colours), names, weights)


def _by_texture(
    one: TextureLayer, other: TextureLayer, names: Sequence[str], weights: Weights
) -> list[ComparedPart]:
    """Split two layers with one atlas into parts by texture."""
    atlas, parts = one.atlas, list[ComparedPart]()
    areas, near_seams = texel_areas(atlas) if weights == "area" else None, _near_seams(atlas)
    (cells, before), (_, after) = (_seam_steps(atlas, each.texel_colours) for each in (one, other))
    texture_of_step = atlas.texture_of(atlas.owned_texels[cells])
    owned = {index: (inside, texels) for index, inside, texels in atlas.by_texture(atlas.owned_texels)}
    gutter = np.concatenate([atlas.gutter.border_texels, atlas.gutter.lone_texels])
    around_charts = {index: texels for index, _, texels in atlas.by_texture(gutter)}
    no_texels = np.zeros(0, np.int64)
    for index, name in enumerate(names):
        inside, texels = owned.get(index, (slice(0), no_texels))
        around = around_charts.get(index, no_texels)
        old, new, hides = one.images[index], other.images[index], one.surface.textures[index].alpha_hides
        if hides:
            around = around[~one.colours.hidden(old, around)]
        read = partial(_both_colours, (one.colours, old), (other.colours, new))
        is_near, is_here = near_seams[inside], texture_of_step == index
        parts.append(
            ComparedPart(
                name=name, kind="texture", index=texels, read=read, space=one.colours.space,
                weights=None if areas is None else areas[inside],
                near_seams=is_near if is_near.any() else None,
                jumps=(before[is_here], after[is_here]) if is_here.any() else None,
                size=(old.pixels.shape[0], old.pixels.shape[1]),
                around=read(around), other_opacity=hides and _opacities_differ(_opacity(old), _opacity(new)),
            )
        )  # fmt: skip
    return parts


def _near_seams(atlas: Atlas) -> Bools:
    """Return which owned cells are within 4 texels of a seam, shape (T,)."""
    at_border = np.zeros(atlas.kind.shape, bool)
    for inner, *_ in lines_over_seams(atlas, 1):
        at_border.reshape(-1)[inner] = True
    # Charts are further apart on the canvas than this reaches.
    return within(at_border, _SEAM_DISTANCE - 1).reshape(-1)[atlas.owned_cells]


def _seam_steps(atlas: Atlas, colours: Callable[[Indices], Float32s]) -> tuple[Int64s, Float64s]:
    """Return the owned cells at seams and the jump there, mean over channels; `colours` reads cells by their rows."""
    # The colours of three texels on a line across the seam are extrapolated to it, from both sides.
    lines = np.concatenate([np.stack(line) for line in lines_over_seams(atlas, REACH)], axis=1)
    cells = np.searchsorted(atlas.owned_cells, lines[0])
    steps = np.empty(len(cells))
    for block in large_arrays.blocks(len(cells), large_arrays.SCATTERED):
        values = [colours(np.searchsorted(atlas.owned_cells, inner)) for inner in lines[:REACH, block]]
        for here, beyond in zip(values, lines[REACH:, block], strict=True):
            halo = np.searchsorted(atlas.halo.cells, beyond)
            # Cells that are owned no more have the weight 0.
            taps = np.minimum(
                np.searchsorted(atlas.owned_cells, atlas.halo.taps[halo]), len(atlas.owned_cells) - 1
            )
            tapped = colours(taps.reshape(-1)).reshape(*taps.shape, -1)
            np.subtract(np.einsum("ht,htn->hn", atlas.halo.weights[halo], tapped), here, out=here)
        steps[block] = np.abs(at_seam(values)).mean(axis=1)
    return cells, steps


def _both_colours(
    one: tuple[PixelColours, DecodedImage], other: tuple[PixelColours, DecodedImage], pixels: Indices
) -> Pair:
    return one[0].working(one[1], pixels), other[0].working(other[1], pixels)
