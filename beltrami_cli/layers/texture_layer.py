"""Texels of the textures of a slot as samples of a manifold, over the surface and across their seams."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult, Plan
from beltrami_cli.flow.canvas import canvas_margin, colours_at, painted_by
from beltrami_cli.flow.domain import NewColours
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture, read_texture
from beltrami_cli.formats.image.metadata import JpegTables, read_jpeg_tables
from beltrami_cli.layers import layer
from beltrami_cli.layers.guides import GuidedTexels, noise_of_pixels
from beltrami_cli.layers.layer import LevelReport, SlotReport
from beltrami_cli.layers.picture_colours import Make, PictureColours, maker_of_manifolds
from beltrami_cli.layers.settings import COLOUR_SLOTS, LevelSettings, SmoothSettings
from beltrami_cli.layers.texel_colours import (
    PictureLayer,
    choose_textures,
    only_textures,
    texel_colours,
    without_transparent,
)
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, build_atlas
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.records import ImageFile, Slot, TexturedSurface

_UNCOVERED = "no texel is covered by the surface, so nothing was changed; `smooth --unwrap` makes a new atlas"
_UNSEEN = (
    "all texels on the surface have an opacity of 0, so nothing was changed; --alpha smooth counts them, too"
)
# Per cent of texels with several places; fewer are due to rounding at the borders of charts.
_WORTH_REPORTING = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TextureLayer(PictureLayer):
    """Covered and visible texels of the chosen textures of a slot, together."""

    part: ClassVar[layer.Part] = "textures"

    label: str
    slot: Slot
    surface: TexturedSurface
    atlas: Atlas
    shared: Collection[str] = ()  # keys of images that other slots show, too
    guided: GuidedTexels | None = None  # where its guides are read from
    is_whole: bool = True  # no texture of the slot is in another layer
    levelled_colours: Float32s | None = None  # of the owned cells without exposure steps, (T, N)
    level_report: LevelReport | None = None

    @classmethod
    def read(
        cls, surface: TexturedSurface, slot: Slot, settings: SmoothSettings, *,
        guided: tuple[Document, Access] | None = None, shared: Collection[str] = (), part: str = "",
        decoded: Sequence[Picture] | None = None,
    ) -> TextureLayer:  # fmt: skip
        """Decode the chosen textures, unless they are `decoded`, and lay their charts out.

        `guided`: where guides and noise are read from; `part`: a name, if it has not all textures of the slot.
        """
        kernel, pictures, tables = settings.kernel, [*(decoded or ())], list[JpegTables | None]()
        if decoded is None:
            surface = choose_textures(surface, settings.textures)
            for texture in surface.textures:
                data = texture.data  # each access may read the file
                pictures.append(dataclasses.replace(read_texture(texture, data), content=texture.content))
                tables.append(read_jpeg_tables(data))
        colours = PictureColours.of(pictures, slot, settings)
        atlas = without_transparent(atlas_of(surface, pictures, kernel), colours, pictures, surface.textures)
        noise = guides = None
        if guided is not None:
            noise = noise_of_pixels(kernel, pictures, atlas.owned_texels, guided[1])
            guides = GuidedTexels(guided[0], surface, pictures, atlas, settings, guided[1])
        return cls(
            label=f"{slot} textures" + (f", {part}" if part else ""), is_whole=not part, names=colours.names,
            slot=slot, settings=settings, surface=surface, pictures=pictures,
            tables=tables or [None] * len(pictures), atlas=atlas, colours=colours, shared=shared, guided=guides,
            noise=None if noise is None else noise[atlas.owned_texels], suffix=settings.textures.image_suffix,
        )  # fmt: skip

    def _canvas(self) -> tuple[Make, Atlas, KernelParameters]:
        make = maker_of_manifolds(
            self.atlas, self.settings.kernel, len(self.names), self._colours_of, self.noise,
            guides=self.guided.guides() if self.guided else (), metric_channels=self.colours.metric_channels,
        )  # fmt: skip
        return make, self.atlas, self.settings.kernel

    def _colours_of(self, block: slice) -> Float32s:
        """Return the colours of a block of the owned cells, levelled if they were, shape (T, N)."""
        if self.levelled_colours is not None:
            return self.levelled_colours[block]
        return texel_colours(self.colours, self.pictures, self.atlas, block)

    def _facts(self) -> list[dict[str, object]]:
        atlas = self.atlas
        covered = atlas.covered_by_texture().tolist()
        return [
            {
                "name": self.surface.textures[index].name,
                "width": picture.pixels.shape[1],
                "height": picture.pixels.shape[0],
                "format": picture.format,
                "stored": picture.stored,
                "channels": list(picture.channels),
                "covered": round(float(covered[index] / picture.pixels[..., 0].size), 4),
            }
            for index, picture in enumerate(self.pictures)
        ]

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> SlotReport:
        return SlotReport(
            slot=self.slot,
            textures=self._facts(),
            counts={**self.atlas.counts, "jumps": plan.manifold.jumps},
            pitch=plan.manifold.geometry.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            **self._used(plan, result),
        )

    def describe(self) -> dict[str, object]:
        """Return the facts without exposure steps, which may be common to several layers."""
        plan, described = self.plan(), self._facts()
        seams = 0
        for index, facts in enumerate(described):
            own = plan.manifold if len(described) == 1 else _manifold_alone(self, index)
            atlas, noise = own.geometry.atlas, plan.noise if len(described) == 1 else own.noise.of_input
            facts |= {"charts": atlas.charts, "seams": atlas.seams, "overlapped": atlas.overlapped}
            facts |= {"pitch": own.geometry.spacing, "noise": layer.named(self.names, noise)}
            seams += atlas.seams
        return {
            "slot": self.slot,
            "images": described,
            **self.atlas.counts,
            "seams_between_textures": max(0, self.atlas.seams - seams),
            "colour_jumps": plan.manifold.jumps,
            "pitch": plan.manifold.geometry.spacing,
            "exposure": None,
            **self._planned(plan),
        }

    def repaint(self, new: NewColours, *, is_smoothed: bool = True) -> layer.Repainted:
        is_tried, is_covered = is_smoothed or self.level_report is not None, len(self.atlas.owned_texels) > 0
        notices = _notices_of(self.atlas) if is_tried or not is_covered else []
        is_levelled, wanted = self.levelled_colours is not None, self.settings.textures
        gutter = wanted.gutter if is_smoothed or is_levelled else None
        is_dithered = is_levelled and not is_smoothed
        changes: list[layer.Change] = []
        images: dict[tuple[Slot, str], ImageFile] = {}
        shared: list[layer.SharedImage] = []
        for index, (texture, picture) in enumerate(zip(self.surface.textures, self.pictures, strict=True)):
            pixels, change = self.new_pixels(index, new, gutter, is_dithered=is_dithered)
            large_arrays.leave_memory()
            as_data = self.slot not in COLOUR_SLOTS
            write = partial(layer.rewritten, picture, wanted=wanted, suffix=self.suffix, as_data=as_data)
            if texture.key in self.shared:
                columns = self.colours.columns(picture)
                shared.append(layer.SharedImage(self.slot, texture.key, pixels, columns, write))
                changes.append(change)
                continue
            file, said = write(pixels)
            images[self.slot, texture.key] = file
            changes.append(change.in_file(file, picture))
            notices += said
        change = layer.Change.joined(changes)
        return layer.Repainted(change, images=images, shared=tuple(shared), notices=tuple(notices))

    def levelled(self, wanted: LevelSettings) -> TextureLayer:
        from beltrami_cli.layers.levelled_charts import level_charts

        if self.slot not in COLOUR_SLOTS:
            cause = "they are data, which no camera exposed; leave them out of --slots"
            raise UsageError(f"{self.label}: {cause}")
        if not self.is_whole:
            raise UsageError(f"{self.label}: exposures are fitted to all textures of a slot together")
        planes = painted_by(self.atlas, len(self.names), self._colours_of)
        textures = self.surface.textures
        is_coloured = self.names == ("red", "green", "blue")
        spans = [max(each.span) if is_coloured and each is not None else 1 for each in self.tables]
        report = level_charts(self.label, planes, self.atlas, textures, self.pictures, wanted, spans)
        made = dataclasses.replace(self, level_report=report)
        if not report.levelled:
            return made
        levelled = colours_at(planes, self.atlas.owned_cells)
        return dataclasses.replace(made, levelled_colours=levelled, tables=[None] * len(self.tables))

    def places(self) -> Cells:
        atlas, sizes = self.atlas, [picture.pixels.shape[:2] for picture in self.pictures]
        picture = np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1
        own = atlas.owned_texels - atlas.texture_offsets[picture]
        row, column = np.divmod(own, np.array([columns for _, columns in sizes], np.int64)[picture])
        names = [texture.name for texture in self.surface.textures]
        return Cells(sizes, picture, row, column, atlas.chart_of, names)


def _manifold_alone(textures: TextureLayer, index: int) -> GridManifold:
    """Return the manifold of one of several textures."""
    surface, pictures = only_textures(textures.surface, [index]), [textures.pictures[index]]
    kernel, colours = dataclasses.replace(textures.settings.kernel, free=()), textures.colours
    atlas = without_transparent(atlas_of(surface, pictures, kernel), colours, pictures, surface.textures)
    colours_of = partial(texel_colours, colours, pictures, atlas)
    return maker_of_manifolds(atlas, kernel, len(textures.names), colours_of, None)(None, None)


def atlas_of(surface: TexturedSurface, pictures: Sequence[Picture], kernel: KernelParameters) -> Atlas:
    """Make the atlas of the texels of pictures, continued beyond seams as far as a kernel reads."""
    sizes = [(picture.pixels.shape[1], picture.pixels.shape[0]) for picture in pictures]
    return build_atlas(surface, sizes, canvas_margin(kernel), kernel.thread_count)


def _notices_of(atlas: Atlas) -> list[str]:
    """Return notices about texels that are covered more than once, or not at all."""
    if not len(atlas.owned_texels):
        return [_UNSEEN if atlas.covered else _UNCOVERED]
    share = 100 * atlas.overlapped / max(1, atlas.covered)
    if share < _WORTH_REPORTING:
        return []
    return [
        f"{share:.0f} % of the covered texels lie at several places of the surface (mirrored, tiled or overlapping "
        "charts); each is taken at one of them",
    ]
