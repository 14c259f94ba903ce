"""Smooth the textures of one slot: textured surface in, new image files out."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from fnmatch import fnmatch
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.flow.guide import guide_radius
from beltrami_cli.flow.texels import TexelFlow
from beltrami_cli.formats.image import check_writable, losses, read_image, write_image
from beltrami_cli.mesh.atlas import without_owned
from beltrami_cli.pipeline.repainting import SmoothedTexels, repaint
from beltrami_cli.pipeline.report import Change
from beltrami_cli.pipeline.texel_colours import COLOUR_SLOTS, TexelColours
from beltrami_cli.sampling.atlas import build_atlas

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.formats.image import Picture
    from beltrami_cli.mesh.atlas import Atlas
    from beltrami_cli.mesh.textured import ImageFile, Slot, Texture, TexturedSurface
    from beltrami_cli.pipeline.settings import SmoothSettings, TextureSettings


# Per cent of texels with several places; fewer come of rounding at the borders of charts.
_WORTH_TELLING = 1.0


@dataclass(frozen=True)
class SlotReport:
    """What was done to the textures of a slot.

    Attributes
    ----------
    slot : str
        The slot.
    textures : list of dict
        For each texture its name, size, type, and how many of its texels the surface covers.
    counts : dict of str to int
        Charts, seams, jumps, covered and overlapped texels of all textures together; jumps are seams whose two
        sides really differ, which nothing was smoothed over.
    pitch : float
        Mean distance of neighbouring texels on the surface, in the model's own unit of length.
    beta : float
        As used.
    noise : dict of str to float
        Estimated standard deviation per channel, full scale 1, in the working space.
    samples_per_kernel : float
        Mean number of samples that a kernel held.
    change : dict of str to float
        Mean, root mean square and largest change of a covered texel's value, full scale 1, as stored.
    """

    slot: str
    textures: list[dict[str, object]]
    counts: dict[str, int]
    pitch: float
    beta: float
    noise: dict[str, float]
    samples_per_kernel: float
    change: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class SlotResult:
    """New image files for a slot, under the keys of its textures; what was done; and what the user should know."""

    images: dict[tuple[Slot, str], ImageFile]
    report: SlotReport
    notices: tuple[str, ...]


@dataclass(frozen=True)
class PreparedSlot:
    """The textures of a slot as samples of a manifold.

    Attributes
    ----------
    surface : TexturedSurface
        With the chosen textures only.
    pictures : list of Picture
        Decoded, one for each texture.
    atlas : Atlas
        The manifold of their texels, without those that lend no colour.
    colours : TexelColours
        The way from pictures to samples and back.
    """

    surface: TexturedSurface
    pictures: list[Picture]
    atlas: Atlas
    colours: TexelColours

    def flow(self, settings: SmoothSettings) -> TexelFlow:
        """Make the flow on these samples."""
        return TexelFlow(self.atlas, self.colours.samples(self.atlas), settings.kernel)


def prepare_slot(surface: TexturedSurface, slot: Slot, settings: SmoothSettings) -> PreparedSlot:
    """Decode the textures of a slot and make the manifold of their texels.

    Raises
    ------
    UsageError
        If the settings contradict the textures.
    InputError
        If an image cannot be decoded.
    """
    surface = choose_textures(surface, settings.textures)
    pictures = [read_image(texture.data, texture.name) for texture in surface.textures]
    kernel = settings.kernel
    margin = kernel.window // 2 + (guide_radius(kernel.metric_scale) if kernel.metric_steps else 0)
    sizes = [(picture.pixels.shape[1], picture.pixels.shape[0]) for picture in pictures]
    atlas = build_atlas(surface, sizes, margin, kernel.thread_count)
    colours = TexelColours(pictures, slot, settings)
    transparent = colours.transparent(atlas, surface.textures)
    if transparent.any():
        atlas = without_owned(atlas, transparent)
    return PreparedSlot(surface, pictures, atlas, colours)


def smooth_slot(
    surface: TexturedSurface,
    slot: Slot,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
) -> SlotResult:
    """Smooth all chosen textures of a slot together, over the surface and across their seams.

    Parameters
    ----------
    surface : TexturedSurface
        As a document gives it.
    slot : Slot
        Which slot it is: colours, or data.
    settings : SmoothSettings
        The kernel's parameters, the working space, and what concerns textures.
    progress : callable, optional
        Called with the work done so far and the work to do; may raise to stop.

    Returns
    -------
    SlotResult

    Raises
    ------
    UsageError, InputError
        As `prepare_slot`.
    """
    prepared = prepare_slot(surface, slot, settings)
    for picture in prepared.pictures:
        check_writable(picture, settings.textures.image_suffix)
    flow = prepared.flow(settings)
    result = flow.run(progress)
    report = SlotReport(
        slot=slot,
        textures=describe_textures(prepared),
        counts={**atlas_counts(prepared.atlas), "jumps": flow.jumps},
        pitch=result.spacing,
        beta=result.beta,
        noise=prepared.colours.named(result.sigma),
        samples_per_kernel=round(result.samples_per_kernel, 2),
    )
    notices = list(atlas_notices(prepared.atlas))
    smoothed = SmoothedTexels(
        prepared.atlas.texture_offsets,
        prepared.atlas.owned_texels,
        result.colours,
        flow.atlas.gutter_texels,
        flow.gutter_colours(),
    )
    pictures, colours, textures = prepared.pictures, prepared.colours, prepared.surface.textures
    del prepared, flow  # canvases as large as the pictures that are made now
    images: dict[tuple[Slot, str], ImageFile] = {}
    changes = []
    for index, (texture, picture) in enumerate(zip(textures, pictures, strict=True)):
        pixels, change = repaint(picture, index, colours, smoothed, settings.textures.gutter)
        changes.append(change)
        images[slot, texture.key] = _encode(picture, pixels, slot, settings.textures)
        notices += picture.notices
        if settings.textures.image_suffix is not None:
            notices += losses(picture, settings.textures.image_suffix)
    report = dataclasses.replace(report, change=Change.joined(changes).summary())
    return SlotResult(images, report, tuple(notices))


def _encode(picture: Picture, pixels: NDArray[Any], slot: Slot, wanted: TextureSettings) -> ImageFile:
    return write_image(
        picture,
        pixels,
        suffix=wanted.image_suffix,
        jpeg_quality=wanted.jpeg_quality,
        small=wanted.small,
        as_data=slot not in COLOUR_SLOTS,
    )


def atlas_counts(atlas: Atlas) -> dict[str, int]:
    """Return what an atlas is made of."""
    return {
        "charts": atlas.charts,
        "seams": atlas.seams,
        "covered": atlas.covered,
        "overlapped": atlas.overlapped,
    }


def atlas_notices(atlas: Atlas) -> tuple[str, ...]:
    """Return what the user should know of texels that are covered more than once, or not at all."""
    if not len(atlas.owned_texels):
        return (
            "no visible texel is covered by the surface, so nothing was smoothed; --unwrap makes a new atlas",
        )
    share = 100 * atlas.overlapped / max(1, atlas.covered)
    if share < _WORTH_TELLING:
        return ()
    return (
        f"{share:.0f} % of the covered texels lie at several places of the surface (mirrored, tiled or overlapping "
        "charts); each was smoothed at one of them",
    )


def describe_textures(prepared: PreparedSlot) -> list[dict[str, object]]:
    """Return facts about each texture, in JSON types."""
    covered = np.histogram(prepared.atlas.owned_texels, prepared.atlas.texture_offsets)[0]
    return [
        {
            "name": texture.name,
            "width": picture.pixels.shape[1],
            "height": picture.pixels.shape[0],
            "format": picture.format,
            "stored": picture.stored,
            "channels": list(picture.channels),
            "covered": round(float(count / picture.pixels[..., 0].size), 4),
        }
        for texture, picture, count in zip(prepared.surface.textures, prepared.pictures, covered, strict=True)
    ]


def choose_textures(surface: TexturedSurface, wanted: TextureSettings) -> TexturedSurface:
    """Keep the textures that the globs choose, which may be none."""

    def fits(texture: Texture) -> bool:
        by_name = not wanted.names or any(fnmatch(texture.name, glob) for glob in wanted.names)
        by_material = not wanted.materials or any(
            fnmatch(material, glob) for material in texture.materials for glob in wanted.materials
        )
        return by_name and by_material

    kept = [index for index, texture in enumerate(surface.textures) if fits(texture)]
    new_index = np.full(len(surface.textures) + 1, -1, np.int32)
    new_index[kept] = np.arange(len(kept), dtype=np.int32)
    return dataclasses.replace(
        surface,
        textures=tuple(surface.textures[index] for index in kept),
        texture_of=new_index[surface.texture_of],
    )
