"""Texels of the textures of a slot as samples of a manifold, on the surface and across seams."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Self

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Indices, Int64s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import FlowResult
from beltrami_cli.flow.estimation import estimate_on_canvas
from beltrami_cli.flow.manifolds.grid.canvas import fill_canvas
from beltrami_cli.flow.manifolds.grid.geometry import colours_at
from beltrami_cli.flow.manifolds.grid.manifold import ColouredCanvas, GridManifold, grid_manifold
from beltrami_cli.flow.manifolds.grid.margins import canvas_margin
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.flow.plan import Plan
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.jpeg_tables import JpegTables, read_jpeg_tables
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.layers.guides import GuidedTexels
from beltrami_cli.layers.layer import Part
from beltrami_cli.layers.pixel_colours import PixelColours
from beltrami_cli.layers.pixel_layer import PixelLayer
from beltrami_cli.layers.reports import SlotReport, describe_reading, named
from beltrami_cli.layers.sample_files import noise_of_pixels
from beltrami_cli.layers.settings import LevelSettings, SmoothSettings
from beltrami_cli.layers.storing import Change, SharedImage, StoredColours, rewritten
from beltrami_cli.layers.texture_groups import only_textures
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import Atlas, build_atlas, without_owned
from beltrami_cli.surface.gutters import fill_gutter, keep_foreign_texels, within
from beltrami_cli.surface.records import Cells, ImageFile, Slot, TexturedSurface
from beltrami_cli.surface.slots import COLOUR_SLOTS

_UNCOVERED_NOTICE = (
    "no texel is covered by the surface, so nothing was changed; `smooth --unwrap` makes a new atlas"
)
_UNSEEN_NOTICE = (
    "all texels on the surface have an opacity of 0, so nothing was changed; --alpha smooth counts them, too"
)
# Percentage of texels with several places; smaller ones are due to rounding at the borders of charts.
_WORTH_REPORTING = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class TextureLayer(PixelLayer):
    """The covered and visible texels of the selected textures of a slot."""

    part: ClassVar[Part] = "textures"

    slot: Slot
    surface: TexturedSurface
    atlas: Atlas
    shared: Collection[str] = ()  # keys of images that other slots also show
    group: str = ""  # name of the group of textures; empty: all of the slot

    @classmethod
    def read(
        cls, surface: TexturedSurface, slot: Slot, settings: SmoothSettings, *,
        guided: Document | None = None, shared: Collection[str] = (), group: str = "",
        decoded: Sequence[DecodedImage] | None = None,
    ) -> TextureLayer:  # fmt: skip
        """Decode the textures of a surface, unless they are `decoded`, and lay out their charts.

        `guided`: source of guides and noise; `group`: name of the layer if it does not have all textures of the slot.
        """
        kernel, images, tables = settings.kernel, [*(decoded or ())], list[JpegTables | None]()
        if decoded is None:
            for texture in surface.textures:
                data = texture.data  # each access may read the file again
                images.append(dataclasses.replace(read_texture(texture, data), content=texture.content))
                tables.append(read_jpeg_tables(data))
        colours = PixelColours.of(images, slot, settings)
        atlas = _visible_atlas(surface, images, kernel, colours)
        noise, guides = None, list[Guide]()
        if guided is not None:
            noise = noise_of_pixels(kernel, images, atlas.owned_texels, guided.access)
            guides = GuidedTexels(guided, surface, images, atlas, settings).guides()
        return cls(
            slot=slot, group=group, settings=settings, surface=surface, images=images,
            jpeg_tables=tables or [None] * len(images), atlas=atlas, colours=colours, shared=shared, guides=guides,
            noise=None if noise is None else noise[atlas.owned_texels], suffix=settings.textures.image_suffix,
        )  # fmt: skip

    @property
    def label(self) -> str:
        return f"{self.slot} textures" + (f", {self.group}" if self.group else "")

    @property
    def as_data(self) -> bool:
        return self.slot not in COLOUR_SLOTS

    def _in_own_unit(self) -> Self:
        return self if self.as_data else super()._in_own_unit()  # data slots are defined on [0, 1]

    def canvas(self) -> ColouredCanvas:
        return ColouredCanvas(
            atlas=self.atlas, parameters=self.kernel, channels=len(self.names), colours_of=self._colours_of,
            deviations=self.deviations, light=self.light,
            guides=self.guides, metric_channels=self.colours.channels.metric,
        )  # fmt: skip

    def _colours_of(self, block: slice) -> Float32s:
        """Return the colours of a block of owned cells, levelled if they were, shape (T, N)."""
        if self.levelled_colours is not None:
            return self.levelled_colours[block]
        return self.texel_colours(block)

    def texel_colours(self, rows: slice | Indices) -> Float32s:
        """Return the stored colours of some owned cells in the working space, shape (T, N)."""
        texels = self.atlas.owned_texels[rows]
        table = np.empty((len(texels), len(self.names)), np.float32)
        for index, inside, of_texture in self.atlas.by_texture(texels):
            table[inside] = self.colours.working(self.images[index], of_texture)
        return table

    def all_texel_colours(self) -> Float32s:
        """Return the stored colours of all owned cells, converted block by block."""
        table = large_arrays.empty((len(self.atlas.owned_texels), len(self.names)), np.float32)
        for block in large_arrays.blocks(len(table)):
            table[block] = self.texel_colours(block)
        return table

    def _facts(self) -> list[dict[str, object]]:
        atlas = self.atlas
        covered = atlas.covered_by_texture().tolist()
        return [
            {
                "name": self.surface.textures[index].name,
                "width": image.pixels.shape[1],
                "height": image.pixels.shape[0],
                "format": image.format,
                "stored": image.stored,
                "channels": list(image.channels),
                "covered": round(float(covered[index] / image.pixels[..., 0].size), 4),
            }
            for index, image in enumerate(self.images)
        ]

    def report(self, plan: Plan[GridManifold], result: FlowResult[GridManifold]) -> SlotReport:
        return SlotReport(
            slot=self.slot,
            textures=self._facts(),
            counts={**self.atlas.counts, "jumps": plan.manifold.jumps},
            pitch=plan.manifold.geometry.spacing,
            samples_per_kernel=round(result.samples_per_kernel, 2),
            **self._common_report(plan, result),
        )

    def describe(self) -> dict[str, object]:
        """Return facts without exposure steps, which several layers may share."""
        plan, described = self.plan(), self._facts()
        seams = 0
        for index, facts in enumerate(described):
            manifold, noise, reading = plan.manifold, plan.noise, plan.reading
            if len(described) > 1:
                manifold = self._manifold_alone(index)
                noise, reading = manifold.noise.of_input, manifold.noise.reading
            atlas = manifold.geometry.atlas
            facts |= {"charts": atlas.charts, "seams": atlas.seams, "overlapped": atlas.overlapped}
            facts |= {"pitch": manifold.geometry.spacing, "noise": named(self.names, self.unit * noise)}
            facts["reading"] = describe_reading(reading, self.unit)
            seams += atlas.seams
        return {
            "slot": self.slot,
            "images": described,
            **self.atlas.counts,
            "seams_between_textures": max(0, self.atlas.seams - seams),
            "colour_jumps": plan.manifold.jumps,
            "pitch": plan.manifold.geometry.spacing,
            "exposure": None,
            **self._described_plan(plan),
        }

    def _manifold_alone(self, index: int) -> GridManifold:
        surface, images = only_textures(self.surface, [index]), [self.images[index]]
        atlas = _visible_atlas(surface, images, self.kernel, self.colours)
        alone = dataclasses.replace(self, surface=surface, images=images, atlas=atlas, guides=(), noise=None)
        canvas = dataclasses.replace(alone.canvas(), parameters=dataclasses.replace(self.kernel, free=()))
        return grid_manifold(canvas, estimate_on_canvas(canvas))

    def encode(self, new: NewColours, *, is_smoothed: bool = True) -> StoredColours:
        is_levelled, wanted = self.levelled_colours is not None, self.settings.textures
        gutter = wanted.gutter if is_smoothed or is_levelled else None
        is_dithered = is_levelled and not is_smoothed
        notices = list[str]()
        if is_smoothed or self.level_report is not None or not len(self.atlas.owned_texels):
            notices += _notices_of(self.atlas)
        changes: list[Change] = []
        images: dict[tuple[Slot, str], ImageFile] = {}
        shared: list[SharedImage] = []
        for index, (texture, image) in enumerate(zip(self.surface.textures, self.images, strict=True)):
            pixels, change = self.new_pixels(index, new, is_dithered=is_dithered)
            if gutter is not None:
                self._refill_gutter(pixels, index, new, gutter, is_dithered=is_dithered)
            large_arrays.release_pages()
            write = partial(rewritten, image, wanted=wanted, suffix=self.suffix, as_data=self.as_data)
            if texture.key in self.shared:
                columns = self.colours.columns(image)
                shared.append(SharedImage(self.slot, texture.key, pixels, columns, write))
                changes.append(change)
                continue
            file, file_notices = write(pixels)
            images[self.slot, texture.key] = file
            changes.append(self.change_in(file, index, new, change))
            notices += file_notices
        change = Change.joined(changes)
        return StoredColours(change, images=images, shared=tuple(shared), notices=tuple(notices))

    def _refill_gutter(
        self, pixels: Array, index: int, new: NewColours, gutter: int, *, is_dithered: bool
    ) -> None:
        """Refill the gutter of a texture's charts, with its old width, in place."""
        image, threads = self.images[index], self.settings.kernel.thread_count
        covered, known, rows = self._gutter_rows(index, pixels.shape[:2], new, gutter)
        beyond = NewColours.of(new.beyond[rows])
        self._fill(pixels, index, new.beyond_places[rows], beyond.take, is_dithered=is_dithered)
        keep_foreign_texels(
            image.pixels, pixels, covered, known, partial(self.colours.written_channels, image),
            width=gutter, lone=self._of_image(self.atlas.gutter.lone_texels, index)[1], threads=threads,
        )  # fmt: skip
        opacity, columns = self.colours.opacity(image), self.colours.columns(image)
        fill_gutter(pixels, covered, gutter, known, threads, columns, opacity)

    def _gutter_rows(
        self, index: int, shape: tuple[int, ...], new: NewColours, gutter: int
    ) -> tuple[Bools, Bools, Int64s]:
        """Return the covered texels, shape (H, W), the gutter texels next to them, and the rows of these."""
        covered, near = np.zeros(shape, bool), np.zeros(shape, bool)
        for block in large_arrays.blocks(len(new.places)):
            covered.reshape(-1)[self._of_image(new.places[block], index)[1]] = True
        inside, texels = self._of_image(new.beyond_places, index)
        chosen = within(covered, gutter).reshape(-1)[texels]
        near.reshape(-1)[texels[chosen]] = True
        return covered, near, np.arange(len(new.beyond_places))[inside][chosen]

    def levelled(self, wanted: LevelSettings) -> TextureLayer:
        from beltrami_cli.layers.levelled_charts import level_charts

        assert not self.is_normalised, "exposures are as stored"
        if self.slot not in COLOUR_SLOTS:
            cause = "they are data, which no camera exposed; leave them out of --slots"
            raise UsageError(f"{self.label}: {cause}")
        if self.group:
            raise UsageError(f"{self.label}: exposures are fitted to all textures of a slot together")
        planes = fill_canvas(self.atlas, len(self.names), self._colours_of)
        textures = self.surface.textures
        is_coloured = self.names == ("red", "green", "blue")
        spans = [max(each.span) if is_coloured and each is not None else 1 for each in self.jpeg_tables]
        report = level_charts(self.label, planes, self.atlas, textures, self.images, wanted, spans)
        reported = dataclasses.replace(self, level_report=report)
        if not report.levelled:
            return reported
        levelled = colours_at(planes, self.atlas.owned_cells)
        return dataclasses.replace(reported, levelled_colours=levelled, jpeg_tables=[None] * len(self.images))

    def places(self) -> Cells:
        atlas, sizes = self.atlas, [image.pixels.shape[:2] for image in self.images]
        image = atlas.texture_of(atlas.owned_texels)
        of_image = atlas.owned_texels - atlas.texture_offsets[image]
        row, column = np.divmod(of_image, np.array([columns for _, columns in sizes], np.int64)[image])
        names = [texture.name for texture in self.surface.textures]
        return Cells(sizes, image, row, column, atlas.chart_of, names)


def _notices_of(atlas: Atlas) -> list[str]:
    """Return notices about texels that are covered more than once, or not at all."""
    if not len(atlas.owned_texels):
        return [_UNSEEN_NOTICE if atlas.covered else _UNCOVERED_NOTICE]
    share = 100 * atlas.overlapped / max(1, atlas.covered)
    if share < _WORTH_REPORTING:
        return []
    return [
        f"{share:.0f} % of the covered texels lie at several places of the surface (mirrored, tiled or overlapping "
        "charts); each is taken at one of them",
    ]


def _visible_atlas(
    surface: TexturedSurface, images: Sequence[DecodedImage], kernel: KernelParameters, colours: PixelColours
) -> Atlas:
    """Lay out charts, extended over seams by the reach of a kernel, without texels that supply no colour."""
    sizes = [(image.pixels.shape[1], image.pixels.shape[0]) for image in images]
    atlas = build_atlas(surface, sizes, canvas_margin(kernel), kernel.thread_count)
    pairs = zip(images, surface.textures, strict=True)
    can_hide = [image.alpha is not None and texture.alpha_hides for image, texture in pairs]
    if not (colours.skips_transparent and any(can_hide)):
        return atlas
    hidden = np.zeros(len(atlas.owned_texels), bool)
    for block in large_arrays.blocks(len(hidden)):
        for index, inside, texels in atlas.by_texture(atlas.owned_texels[block]):
            if can_hide[index]:
                hidden[block][inside] = colours.hidden(images[index], texels)
    return without_owned(atlas, hidden) if hidden.any() else atlas
