"""Texels of the textures of a slot as samples of a manifold, over the surface and across their seams."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult, Plan, choose_parameters
from beltrami_cli.flow.canvas import canvas_margin, painted_by
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.flow.grid_manifold import GridManifold, Whole, common_noise, grid_manifold
from beltrami_cli.flow.noise.by_scale import FoundNoise
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.records import NewColours
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture, check_writable, read_texture
from beltrami_cli.formats.image.metadata import JpegTables, read_jpeg_tables
from beltrami_cli.layers import layer
from beltrami_cli.layers.coded_pictures import plan_on_pictures
from beltrami_cli.layers.guides import GuidedTexels, noise_of_pixels
from beltrami_cli.layers.levelled_charts import TextureCharts, describe_level, halved_colour, level_report
from beltrami_cli.layers.picture_colours import PictureColours
from beltrami_cli.layers.reports import LevelReport, SlotReport
from beltrami_cli.layers.settings import COLOUR_SLOTS, LevelSettings, SmoothSettings
from beltrami_cli.layers.texel_colours import Repainting, choose_textures, only_textures
from beltrami_cli.layers.texture_groups import Common, TextureGroup
from beltrami_cli.levelling.correction import level_canvas
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, build_atlas, without_owned
from beltrami_cli.surface.baking import Cells
from beltrami_cli.surface.records import ImageFile, Slot, Texture, TexturedSurface

_UNCOVERED = "no texel is covered by the surface, so nothing was smoothed; --unwrap makes a new atlas"
_UNSEEN = (
    "all texels on the surface have an opacity of 0, so nothing was smoothed; --alpha smooth counts them, too"
)
# Per cent of texels with several places; fewer are due to rounding at the borders of charts.
_WORTH_REPORTING = 1.0


class TextureLayer(layer.Layer):
    """Covered and visible texels of the chosen textures of a slot, together."""

    part: ClassVar[layer.Part] = "textures"

    def __init__(
        self,
        surface: TexturedSurface,
        slot: Slot,
        settings: SmoothSettings,
        guided: tuple[Document, Access] | None = None,
        shared: layer.SharedImages | None = None,
        group: TextureGroup | None = None,
    ) -> None:
        self.slot, self.settings, self.label = slot, settings, f"{slot} textures"
        self._group = group
        if group is not None:
            self.label += f", {group.label}"
        self.surface = choose_textures(surface, settings.textures)
        self._tables: list[JpegTables | None] = []
        self.pictures = [self._picture(texture) for texture in self.surface.textures]
        self.atlas = atlas_of(self.surface, self.pictures, settings.kernel)
        self.colours = PictureColours(self.pictures, slot, settings)
        self.names = self.colours.names
        hidden = self.colours.transparent(self.atlas, self.surface.textures)
        if hidden.any():
            self.atlas = without_owned(self.atlas, hidden)
        self._shared = shared or layer.SharedImages()
        self._guides: list[Guide] = []
        self._noise: Float32s | None = None
        if guided is not None and settings.kernel.noise is not None:
            texels = self.atlas.owned_texels
            noise = noise_of_pixels(settings.kernel, self.pictures, texels, guided[1])
            self._noise = None if noise is None else noise.reshape(-1, noise.shape[2])[texels]
        if guided is not None and settings.embedding.guides:
            known = self.surface, self.pictures, self.atlas, settings
            self._guides = GuidedTexels(guided[0], *known, guided[1]).guides()
        self.is_data = slot not in COLOUR_SLOTS
        self._levelled: Float32s | None = None
        self._level_change: float | None = None  # None: its seams were not levelled

    def _picture(self, texture: Texture) -> Picture:
        """Decode a texture, and keep its tables; of those around a group the files are not kept."""
        data = texture.data  # which may be read anew each time
        picture = read_texture(texture, data)
        self._tables.append(read_jpeg_tables(data))
        if self._group is None or texture.key in self._group.own:
            return picture
        return dataclasses.replace(picture, source=b"")

    def plan(self, tick: Callable[[], None] | None = None) -> Plan[GridManifold]:
        tables = self._tables if self._levelled is None and self.colours.shows_all else []
        pixels = [picture.pixels for picture in self.pictures]
        known = self.settings.kernel, tick, self.colours.light_space
        plan = plan_on_pictures(self.manifold, self.atlas, pixels, tables, *known)
        self._guides = []
        return plan

    def manifold(self, planes: Float32s | None = None, noise: FoundNoise | None = None) -> GridManifold:
        """Return the manifold of the texels, with the noise of their colours; or of others, with theirs."""
        whole = None if self._group is None else self._group.common.whole(self.names)
        if noise is not None:
            whole = Whole(None if whole is None else whole.unit, noise)
        return grid_manifold(
            self.atlas,
            self._on_canvas() if planes is None else planes,
            self.settings.kernel,
            guides=self._guides,
            metric_channels=self.colours.metric_channels,
            deviations=self._noise,
            whole=whole,
        )

    def common(self) -> Common:
        """Return what groups of these textures share: noise only if it does not differ from place to place."""
        manifold = self.manifold()
        noise = None if manifold.noise.relative is not None else common_noise(manifold.noise)
        return Common(self.settings, manifold.unit, noise, self.names)

    def _on_canvas(self) -> Float32s:
        """Return the colours on the canvas, levelled if they were; these are given away."""
        planes, self._levelled = self._levelled, None
        if planes is None:
            planes = self.colours.on_canvas(self.atlas, self.settings.kernel.thread_count)
        return planes

    def level(self, wanted: LevelSettings, photographs: Int64s | None = None) -> LevelReport:
        if self.slot not in COLOUR_SLOTS:
            cause = f"{self.label}: they are data, which no camera exposed; leave them out of --slots"
            raise UsageError(cause)
        planes, charts = self._on_canvas(), TextureCharts.of(self.atlas, self.surface.textures)
        reference, halved = charts.matching(wanted.reference), halved_colour(self._tables, self.names)
        found, change = level_canvas(self.atlas, planes, wanted.strength, reference, halved)
        self._levelled, self._level_change = planes if change else None, change
        return level_report(self.label, found, change, charts.facts(self.pictures))

    def levelled(self) -> NewColours:
        known, still = self.colours.metric_channels, self.settings.kernel.with_values(iterations=0)
        return grid_manifold(self.atlas, self._on_canvas(), still, metric_channels=known).new_colours()

    def require_writable(self) -> None:
        for picture in self.pictures:
            check_writable(picture, self.settings.textures.image_suffix)

    def _written(self) -> list[int]:
        """Return which textures are written back: of a group, its own."""
        own = None if self._group is None else self._group.own
        return [i for i, texture in enumerate(self.surface.textures) if own is None or texture.key in own]

    def facts(self) -> list[dict[str, object]]:
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
            for index in self._written()
            for picture in [self.pictures[index]]
        ]

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> SlotReport:
        used, counts = self._used(plan, result), self.atlas.counts
        if self._group is not None:
            used |= self._group.common.described
            counts |= self._group.counts(self.atlas, self._written())
        return SlotReport(
            slot=self.slot,
            textures=self.facts(),
            counts={**counts, "jumps": plan.manifold.jumps},
            pitch=plan.manifold.geometry.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            **used,
        )

    def describe(self) -> dict[str, object]:
        exposure = self.exposure() if self._group is None else None
        plan, described = self.plan(), self.facts()
        plans = [plan] if len(described) == 1 else map(self._alone, range(len(described)))
        seams = 0
        for facts, own in zip(described, plans, strict=True):
            atlas = own.manifold.geometry.atlas
            facts |= {"charts": atlas.charts, "seams": atlas.seams, "overlapped": atlas.overlapped}
            facts |= {"pitch": own.manifold.geometry.spacing, "noise": self.named(own.noise)}
            seams += atlas.seams
        return {
            "slot": self.slot,
            "images": described,
            **self.atlas.counts,
            "seams_between_textures": max(0, self.atlas.seams - seams),
            "colour_jumps": plan.manifold.jumps,
            "pitch": plan.manifold.geometry.spacing,
            "exposure": exposure,
            **self._planned(plan),
        }

    def exposure(self) -> dict[str, object] | None:
        """Return what is known of exposure steps; None for data."""
        if self.slot not in COLOUR_SLOTS:
            return None
        return describe_level(self.level(LevelSettings(strength=0.0)))

    def _alone(self, index: int) -> Plan[GridManifold]:
        """Return a flow, with no parameters chosen, on one of several textures."""
        kernel, picture = dataclasses.replace(self.settings.kernel, free=()), self.pictures[index]
        surface = only_textures(self.surface, [index])
        atlas = atlas_of(surface, [picture], kernel)
        if surface.textures[0].alpha_hides:
            hidden = self.colours.hidden(picture, atlas.owned_texels)
            atlas = without_owned(atlas, hidden) if hidden.any() else atlas

        def working(block: slice) -> Float32s:
            return self.colours.working(picture, atlas.owned_texels[block])

        planes = painted_by(atlas, len(self.names), working, kernel.thread_count)
        return choose_parameters(grid_manifold(atlas, planes, kernel), kernel)

    def repaint(
        self, new: NewColours, *, is_smoothed: bool = True, positions: Float64s | None = None
    ) -> layer.Repainted:
        del positions
        is_tried, is_covered = is_smoothed or self._level_change is not None, len(self.atlas.owned_texels) > 0
        notices = _notices_of(self.atlas) if is_tried or not is_covered else []
        gutter = self.settings.textures.gutter if is_smoothed or self._level_change else None
        painter = self.painter(gutter, is_dithered=bool(self._level_change) and not is_smoothed)
        del self.atlas  # all on the canvas but the colours, before pictures as large are made
        wanted, changes = self.settings.textures, []
        images: dict[tuple[Slot, str], ImageFile] = {}
        for index in self._written():
            texture, picture = self.surface.textures[index], self.pictures[index]
            pixels, change = painter.repaint(index, new)
            changes.append(change)
            large_arrays.leave_memory()
            columns = self.colours.columns(picture)
            pixels, slots = self._shared.join(self.slot, texture.key, pixels, columns)
            file, said = layer.rewritten(picture, pixels, wanted, wanted.image_suffix, as_data=self.is_data)
            notices += said
            if self._group is not None and texture.is_read_anew:
                file = dataclasses.replace(file, content=large_arrays.kept(file.data))
            images |= {(each, texture.key): file for each in slots}
        return layer.Repainted(layer.Change.joined(changes), images=images, notices=tuple(notices))

    def painted(self, index: int, new: NewColours) -> Array:
        """Return the pixels of a texture with new colours, and nothing changed around its charts."""
        return self.painter(None).repaint(index, new)[0]

    def cells(self) -> Cells:
        atlas, sizes = self.atlas, [picture.pixels.shape[:2] for picture in self.pictures]
        picture = np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1
        own = atlas.owned_texels - atlas.texture_offsets[picture]
        row, column = np.divmod(own, np.array([columns for _, columns in sizes], np.int64)[picture])
        return Cells(sizes, picture, row, column, atlas.chart_of)

    def painter(self, gutter: int | None, *, is_dithered: bool = False) -> Repainting:
        atlas, threads = self.atlas, self.settings.kernel.thread_count
        places = atlas.texture_offsets, atlas.lone_texels
        return Repainting(self.pictures, self.colours, *places, gutter, threads, is_dithered)


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
