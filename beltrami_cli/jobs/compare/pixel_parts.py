"""The pixels of two images, and the texels of the textures of two files of one model."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import Weights
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.jobs.compare.measured import ComparedPart, Pair, opacities_differ
from beltrami_cli.jobs.compare.same_model import Documents, matching_textures, require_same_size
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
from beltrami_cli.surface.gutters import within
from beltrami_cli.surface.records import Slot, Texture

_SEAM_DISTANCE = 4  # texels from a seam that count as near


def compare_images(documents: Documents, settings: SmoothSettings, access: Access) -> list[ComparedPart]:
    """Match the pixels of two images that are visible and finite in the reference; they are one part."""
    names = [document.name for document in documents]
    slots = settings.textures.slots or DEFAULTS.textures.slots  # which images do without
    settings = dataclasses.replace(settings, textures=dataclasses.replace(settings.textures, slots=slots))
    require_memory([(document.name, document.data) for document in documents], access, "compared")
    require_same_size(documents[0].image(), documents[1].image(), names[1])
    reference, test = (ImageLayer.read(document, settings, colours_only=True) for document in documents)
    channels, valid = reference.colours.names, reference.valid
    if channels != test.colours.names:
        cause = f"it has the channels {', '.join(test.colours.names)}, but {names[0]} {', '.join(channels)}"
        raise InputError(names[1], cause, "compare images with the same channels, or choose with --channels")
    if count := int(np.count_nonzero(~test.colours.finite(test.image)[valid])):
        raise InputError(names[1], f"{count} of its pixels are not finite numbers, but are in {names[0]}")
    opacities = [None if "alpha" in channels else _opacity(layer.image) for layer in (reference, test)]
    part = ComparedPart(
        name="image", kind="image", index=large_arrays.indices_of(valid, True),
        read=partial(_both_colours, (reference.colours, reference.image), (test.colours, test.image)),
        space=settings.space if set(channels) <= {"red", "green", "blue", "grey"} else "data",
        size=(valid.shape[0], valid.shape[1]), other_opacity=opacities_differ(*opacities),
    )  # fmt: skip
    return [part]


def compare_textures(
    documents: Documents, slot: Slot, settings: SmoothSettings, weights: Weights, access: Access,
    *, is_extra: bool,
) -> list[ComparedPart]:  # fmt: skip
    """Match the textures of a slot, each a part; `is_extra`: equal files need only a notice."""
    names = documents[0].name, documents[1].name
    surface = documents[0].textured(slot)
    counterparts = matching_textures(surface, documents[1].textured(slot), names)
    chosen = choose_textures(surface, settings.textures)
    textures = [counterparts[texture.key] for texture in chosen.textures]
    part_names = _part_names(slot, chosen.textures)
    if is_extra and [each.data for each in chosen.textures] == [each.data for each in textures]:
        return [_identical_texture(name) for name in part_names]
    require_memory(((texture.name, texture.data) for texture in textures), access)
    reference = TextureLayer.read(chosen, slot, settings)
    images = [read_texture(texture) for texture in textures]
    for old, new in zip(reference.images, images, strict=True):
        require_same_size(old, new, f"{names[1]}: {new.name}")
    colours = PixelColours.of(images, slot, settings)
    if colours.names != reference.names:
        has, had = ", ".join(colours.names), ", ".join(reference.names)
        cause = f"its {slot} textures have {has}, but {had} before"
        raise InputError(names[1], cause, "compare files with the same channels")
    test = dataclasses.replace(reference, images=images, colours=colours)
    return _by_texture(reference, test, part_names, weights)


def _part_names(slot: Slot, textures: Sequence[Texture]) -> list[str]:
    """Name textures by their files, or by their keys if several have one name."""
    count = Counter(texture.name for texture in textures)
    return [f"{slot} {each.name if count[each.name] == 1 else each.key}" for each in textures]


def _identical_texture(name: str) -> ComparedPart:
    nothing = np.zeros((0, 3), np.float32)
    return ComparedPart(
        name=name, kind="texture", index=np.zeros(0, np.int64), read=lambda _: (nothing, nothing),
        space="data", is_identical=True,
    )  # fmt: skip


def _by_texture(
    reference: TextureLayer, test: TextureLayer, names: Sequence[str], weights: Weights
) -> list[ComparedPart]:
    """Split two layers with one atlas into parts by texture."""
    atlas, parts = reference.atlas, list[ComparedPart]()
    areas, near_seams = texel_areas(atlas) if weights == "area" else None, _near_seams(atlas)
    seam_cells, jumps_before = _seam_jumps(atlas, reference.texel_colours)
    _, jumps_after = _seam_jumps(atlas, test.texel_colours)
    texture_of_jump = atlas.texture_of(atlas.owned_texels[seam_cells])
    owned = {index: (inside, texels) for index, inside, texels in atlas.by_texture(atlas.owned_texels)}
    gutter = np.concatenate([atlas.gutter.border_texels, atlas.gutter.lone_texels])
    around_charts = {index: texels for index, _, texels in atlas.by_texture(gutter)}
    no_texels = np.zeros(0, np.int64)
    for index, name in enumerate(names):
        inside, texels = owned.get(index, (slice(0), no_texels))
        around = around_charts.get(index, no_texels)
        old, new = reference.images[index], test.images[index]
        hides = reference.surface.textures[index].alpha_hides
        if hides:
            around = around[~reference.colours.hidden(old, around)]
        read = partial(_both_colours, (reference.colours, old), (test.colours, new))
        is_near, is_here = near_seams[inside], texture_of_jump == index
        parts.append(
            ComparedPart(
                name=name, kind="texture", index=texels, read=read, space=reference.colours.space,
                weights=None if areas is None else areas[inside],
                near_seams=is_near if is_near.any() else None,
                jumps=(jumps_before[is_here], jumps_after[is_here]) if is_here.any() else None,
                size=(old.pixels.shape[0], old.pixels.shape[1]),
                around=read(around), other_opacity=hides and opacities_differ(_opacity(old), _opacity(new)),
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


def _seam_jumps(atlas: Atlas, colours: Callable[[Indices], Float32s]) -> tuple[Int64s, Float64s]:
    """Return the owned cells at seams and the jumps there, mean over channels; `colours` reads cells by their rows."""
    # The colours of three texels on a line across the seam are extrapolated to it, from both sides.
    lines = np.concatenate([np.stack(line) for line in lines_over_seams(atlas, REACH)], axis=1)
    cells = np.searchsorted(atlas.owned_cells, lines[0])
    jumps = np.empty(len(cells))
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
        jumps[block] = np.abs(at_seam(values)).mean(axis=1)
    return cells, jumps


def _both_colours(
    one: tuple[PixelColours, DecodedImage], other: tuple[PixelColours, DecodedImage], pixels: Indices
) -> Pair:
    return one[0].working(one[1], pixels), other[0].working(other[1], pixels)


def _opacity(image: DecodedImage) -> Float32s | None:
    return None if image.alpha is None else full_scale_one(image.pixels[..., image.alpha])
