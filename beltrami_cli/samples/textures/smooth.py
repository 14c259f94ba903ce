"""Smooth the textures of one slot: textured surface in, new image files out."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from beltrami_cli.flow.canvas import colours_at
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.image import check_writable, is_unchanged, losses, write_image
from beltrami_cli.samples.change import Change
from beltrami_cli.samples.settings import describe_choice
from beltrami_cli.samples.textures.colours import COLOUR_SLOTS
from beltrami_cli.samples.textures.description import atlas_counts, describe_textures
from beltrami_cli.samples.textures.prepare import prepare_slot
from beltrami_cli.samples.textures.repainting import SmoothedTexels, repaint
from beltrami_cli.samples.textures.shared import SharedImages
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import ImageFile

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.settings import SmoothSettings, TextureSettings
    from beltrami_cli.samples.textures.repainting import ColoursOf
    from beltrami_cli.surface.atlas import Atlas, Indices
    from beltrami_cli.surface.records import Slot, TexturedSurface


_UNCOVERED = "no texel is covered by the surface, so nothing was smoothed; --unwrap makes a new atlas"
_UNSEEN = (
    "all texels on the surface have an opacity of 0, so nothing was smoothed; --alpha smooth counts them, too"
)
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
    iterations : int
        As for `VertexReport`.
    noise : dict of str to float
        Estimated standard deviation per channel, full scale 1, in the working space.
    samples_per_kernel : float
        Mean number of samples that a kernel held.
    guides : dict of str to float
        The beta used for each guide, by its name.
    change : dict of str to float
        Mean, root mean square and largest change of a covered texel's value, in the channels that change, full scale 1,
        as stored.
    choice : dict or None
        As for `VertexReport`.
    """

    slot: str
    textures: list[dict[str, object]]
    counts: dict[str, int]
    pitch: float
    beta: float
    iterations: int
    noise: dict[str, float]
    samples_per_kernel: float
    guides: dict[str, float] = field(default_factory=dict)
    change: dict[str, float] = field(default_factory=dict)
    choice: dict[str, object] | None = None


@dataclass(frozen=True)
class SlotResult:
    """New image files for a slot, under the keys of its textures; what was done; and what the user should know."""

    images: dict[tuple[Slot, str], ImageFile]
    report: SlotReport
    notices: tuple[str, ...]


def smooth_slot(
    surface: TexturedSurface,
    slot: Slot,
    settings: SmoothSettings,
    progress: Callable[[int, int], None] | None = None,
    document: Document | None = None,
    access: Access = EVERYTHING_INSIDE,
    shared: SharedImages | None = None,
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
    document, access
        As for `prepare_slot`.
    shared : SharedImages, optional
        What other slots made of the same images.

    Returns
    -------
    SlotResult
        Its images are also those of earlier slots, where their changes are in them.

    Raises
    ------
    UsageError, InputError
        As `prepare_slot`.
    """
    prepared = prepare_slot(surface, slot, settings, document, access)
    for picture in prepared.pictures:
        check_writable(picture, settings.textures.image_suffix)
    flow = prepared.flow(settings)
    result = flow.run(progress)
    report = SlotReport(
        slot=slot,
        textures=describe_textures(prepared),
        counts={**atlas_counts(prepared.atlas), "jumps": flow.manifold.jumps},
        pitch=result.spacing,
        beta=result.beta,
        iterations=flow.parameters.iterations,
        noise=prepared.colours.named(result.sigma),
        samples_per_kernel=round(result.samples_per_kernel, 2),
        guides=flow.manifold.guide_betas,
        choice=describe_choice(result.choice),
    )
    is_covered = len(prepared.atlas.owned_texels) > 0
    notices = list(atlas_notices(prepared.atlas)) if report.iterations or not is_covered else []
    smoothed = SmoothedTexels(
        prepared.atlas.texture_offsets,
        prepared.atlas.owned_texels,
        _colours_of(flow.manifold.colours, flow.manifold.atlas.owned_cells, settings.kernel.thread_count),
        flow.manifold.atlas.gutter_texels,
        flow.manifold.gutter_values(),
    )
    pictures, colours, textures = prepared.pictures, prepared.colours, prepared.surface.textures
    gutter = settings.textures.gutter if report.iterations else None  # what is not smoothed stays as it is
    del prepared, flow  # and all on the canvas but the colours, before pictures as large are made
    images: dict[tuple[Slot, str], ImageFile] = {}
    changes, shared = [], shared or SharedImages()
    for index, (texture, picture) in enumerate(zip(textures, pictures, strict=True)):
        pixels, change = repaint(picture, index, colours, smoothed, gutter, settings.kernel.thread_count)
        changes.append(change)
        large_arrays.leave_memory()
        pixels, slots = shared.join(slot, texture.key, pixels, colours.columns(index))
        file = _encode(picture, pixels, slot, settings.textures)
        images |= {(each, texture.key): file for each in slots}
        if file.data is not picture.source:
            notices += picture.notices
        if settings.textures.image_suffix is not None:
            notices += losses(picture, settings.textures.image_suffix)
    report = dataclasses.replace(report, change=Change.joined(changes).summary())
    return SlotResult(images, report, tuple(notices))


def _colours_of(planes: NDArray[np.float32], cells: Indices, threads: int) -> ColoursOf:
    return lambda block, inside: colours_at(planes, cells[block][inside], threads)


def _encode(picture: Picture, pixels: NDArray[Any], slot: Slot, wanted: TextureSettings) -> ImageFile:
    if wanted.image_suffix is None and is_unchanged(picture, pixels):
        return ImageFile(picture.source, picture.suffix)
    return write_image(
        picture,
        pixels,
        suffix=wanted.image_suffix,
        jpeg_quality=wanted.jpeg_quality,
        small=wanted.small,
        as_data=slot not in COLOUR_SLOTS,
    )


def atlas_notices(atlas: Atlas) -> tuple[str, ...]:
    """Return what the user should know of texels that are covered more than once, or not at all."""
    if not len(atlas.owned_texels):
        return (_UNSEEN if atlas.covered else _UNCOVERED,)
    share = 100 * atlas.overlapped / max(1, atlas.covered)
    if share < _WORTH_TELLING:
        return ()
    return (
        f"{share:.0f} % of the covered texels lie at several places of the surface (mirrored, tiled or overlapping "
        "charts); each was smoothed at one of them",
    )
