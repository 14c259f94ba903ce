"""The textures of a slot as samples of a manifold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from beltrami_cli.flow.beltrami_flow import BeltramiFlow
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.regularisation import guide_radius
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.image import read_image
from beltrami_cli.samples.textures.choosing import choose_textures
from beltrami_cli.samples.textures.colours import TexelColours
from beltrami_cli.samples.textures.guides import GuidedTexels
from beltrami_cli.surface.atlas import build_atlas, without_owned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.flow.embedding import Guide
    from beltrami_cli.flow.parameters import KernelParameters
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.settings import SmoothSettings
    from beltrami_cli.surface.atlas import Atlas
    from beltrami_cli.surface.records import Slot, TexturedSurface


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
    guides : tuple of Guide
        With one row a sample.
    """

    surface: TexturedSurface
    pictures: list[Picture]
    atlas: Atlas
    colours: TexelColours
    guides: tuple[Guide, ...]

    def flow(self, settings: SmoothSettings) -> BeltramiFlow[GridManifold]:
        """Make the flow on these samples."""
        manifold = GridManifold(
            self.atlas,
            self.colours.on_canvas(self.atlas, settings.kernel.thread_count),
            settings.kernel,
            guides=self.guides,
            metric_channels=self.colours.metric_channels,
        )
        return BeltramiFlow(manifold, settings.kernel)


def prepare_slot(
    surface: TexturedSurface,
    slot: Slot,
    settings: SmoothSettings,
    document: Document | None = None,
    access: Access = EVERYTHING_INSIDE,
) -> PreparedSlot:
    """Decode the textures of a slot and make the manifold of their texels.

    Parameters
    ----------
    surface : TexturedSurface
        As a document gives it.
    slot : Slot
        Which slot it is: colours, or data.
    settings : SmoothSettings
        The kernel's parameters, the working space, the guides, and what concerns textures.
    document : Document, optional
        Where other slots are looked for that guide. Without it there are no guides.
    access : Access
        What may be read.

    Raises
    ------
    UsageError
        If the settings contradict the textures.
    InputError
        If an image cannot be decoded.
    """
    surface = choose_textures(surface, settings.textures)
    pictures = [read_image(texture.data, texture.name) for texture in surface.textures]
    atlas = build_slot_atlas(surface, pictures, settings.kernel)
    colours = TexelColours(pictures, slot, settings)
    transparent = colours.transparent(atlas, surface.textures)
    if transparent.any():
        atlas = without_owned(atlas, transparent)
    guides = GuidedTexels(document, surface, pictures, atlas, settings, access).guides() if document else []
    return PreparedSlot(surface, pictures, atlas, colours, tuple(guides))


def build_slot_atlas(
    surface: TexturedSurface, pictures: Sequence[Picture], kernel: KernelParameters
) -> Atlas:
    """Make the manifold of the texels of pictures, as far continued beyond seams as a kernel looks."""
    margin = kernel.window // 2 + (guide_radius(kernel.metric_scale) if kernel.metric_steps else 0)
    sizes = [(picture.pixels.shape[1], picture.pixels.shape[0]) for picture in pictures]
    return build_atlas(surface, sizes, margin, kernel.thread_count)
