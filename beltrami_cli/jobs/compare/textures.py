"""The textures of two models, texel by texel on the surface that they cover."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.image import read_image
from beltrami_cli.jobs.compare.paired_colours import PairedColours, SeamSteps, differences
from beltrami_cli.jobs.compare.structural_similarity import structural_similarity
from beltrami_cli.jobs.compare.vertices import require_same_triangles
from beltrami_cli.samples.memory_check import require_room
from beltrami_cli.samples.textures.choosing import choose_textures
from beltrami_cli.samples.textures.colours import TexelColours
from beltrami_cli.samples.textures.places import near_seams, seam_steps, texel_areas
from beltrami_cli.samples.textures.prepare import prepare_slot

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.flow.parameters import Space, Weights
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.settings.smooth import SmoothSettings
    from beltrami_cli.samples.textures.prepare import PreparedSlot
    from beltrami_cli.surface.records import Slot, Texture, TexturedSurface

# Texture coordinates may be rounded to six digits, as in text.
_ROUNDING = 1e-5


def pair_slot(
    reference: Document,
    test: Document,
    slot: Slot,
    settings: SmoothSettings,
    weights: Weights,
    access: Access = EVERYTHING_INSIDE,
) -> list[tuple[PairedColours, tuple[int, int]]]:
    """Bring the textures of a slot together, each a part of its own.

    Parameters
    ----------
    reference, test : Document
        With textures in the slot.
    slot : Slot
        Which.
    settings : SmoothSettings
        The working space, the channels, and which textures.
    weights : {"uniform", "area"}
        Whether each covered texel counts once, or by its area on the surface.
    access : Access
        What may be read.

    Returns
    -------
    list of (PairedColours, (int, int))
        With the rows and columns of each image.

    Raises
    ------
    InputError
        If the models have not the same triangles, texture coordinates, textures, sizes and channels.
    """
    surface = reference.textured(slot)
    textures = _same_textures(surface, test.textured(slot), settings, (reference.name, test.name))
    require_room(((texture.name, texture.data) for texture in textures), access)
    prepared = prepare_slot(surface, slot, settings)
    pictures = [read_image(texture.data, texture.name) for texture in textures]
    for old, new in zip(prepared.pictures, pictures, strict=True):
        require_same_size(old, new, f"{test.name}: {new.name}")
    colours = TexelColours(pictures, slot, settings)
    if colours.names != prepared.colours.names:
        cause = f"its {slot} textures have {', '.join(colours.names)}, but {', '.join(prepared.colours.names)} before"
        raise InputError(test.name, cause, "compare files with the same channels")
    atlas = prepared.atlas
    both = prepared.colours.samples(atlas), colours.samples(atlas)
    counted = texel_areas(atlas) if weights == "area" else np.ones(len(atlas.owned_texels))
    return _parts(prepared, both, counted, slot, prepared.colours.space)


def _parts(
    prepared: PreparedSlot,
    both: tuple[NDArray[np.float32], NDArray[np.float32]],
    weights: NDArray[np.float64],
    slot: Slot,
    space: Space,
) -> list[tuple[PairedColours, tuple[int, int]]]:
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
        one, other = both[0][inside], both[1][inside]
        size = picture.pixels.shape[:2]
        rows, columns = np.divmod(texels, size[1])
        pair = PairedColours(
            f"{slot} {prepared.surface.textures[index].name}",
            "texture",
            one,
            other,
            np.stack([columns, rows], axis=1),
            weights[inside],
            differences(one, other, space),
            similarity(one, other, texels, size),
            near[inside] if near[inside].any() else None,
            SeamSteps(before[here], after[here]) if here.any() else None,
        )
        parts.append((pair, size))
    return parts


def similarity(
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


def require_same_size(old: Picture, new: Picture, name: str) -> None:
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
    require_same_triangles(surface.faces, other.faces, names)
    if len(surface.textures) != len(other.textures):
        cause = f"it has {len(other.textures)} textures, but {names[0]} {len(surface.textures)}"
        raise InputError(names[1], cause, "compare two files of one model")
    used = surface.texture_of >= 0
    same = np.array_equal(surface.texture_of, other.texture_of)
    if not same or not np.allclose(surface.uv[used], other.uv[used], rtol=0, atol=_ROUNDING):
        cause = f"its texture coordinates are not those of {names[0]}"
        raise InputError(names[1], cause, "compare two files of one model")
    numbered = dataclasses.replace(
        surface,
        textures=tuple(
            dataclasses.replace(texture, key=str(i)) for i, texture in enumerate(surface.textures)
        ),
    )
    return tuple(other.textures[int(t.key)] for t in choose_textures(numbered, settings.textures).textures)
