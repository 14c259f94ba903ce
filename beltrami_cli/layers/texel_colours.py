"""Which textures are meant, the colours of their texels, and new pixels, with gutters refilled around charts."""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
from beltrami_cli.flow.beltrami_flow import Plan
from beltrami_cli.flow.domain import NewColours
from beltrami_cli.flow.grid_manifold import GridManifold
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image import Picture, check_writable
from beltrami_cli.formats.image.metadata import JpegTables
from beltrami_cli.layers.layer import Change, Layer, store
from beltrami_cli.layers.picture_colours import Make, PictureColours, plan_on_pictures
from beltrami_cli.layers.settings import SmoothSettings, TextureSettings
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import (
    ROWS,
    Atlas,
    Indices,
    fill_gutter,
    nearest_covered,
    texels_by_texture,
    within,
    without_owned,
)
from beltrami_cli.surface.records import Texture, TexturedSurface


def choose_textures(surface: TexturedSurface, wanted: TextureSettings) -> TexturedSurface:
    """Keep the textures that match the globs, possibly none."""

    def fits(texture: Texture) -> bool:
        by_name = not wanted.names or any(fnmatch(texture.name, glob) for glob in wanted.names)
        by_material = not wanted.materials or any(
            fnmatch(material, glob) for material in texture.materials for glob in wanted.materials
        )
        return by_name and by_material

    return only_textures(surface, [i for i, texture in enumerate(surface.textures) if fits(texture)])


def only_textures(surface: TexturedSurface, kept: list[int]) -> TexturedSurface:
    """Keep the textures of these indices; triangles of the others have none."""
    new_index = np.full(len(surface.textures) + 1, -1, np.int32)
    new_index[kept] = np.arange(len(kept), dtype=np.int32)
    textures = tuple(surface.textures[index] for index in kept)
    return dataclasses.replace(surface, textures=textures, texture_of=new_index[surface.texture_of])


def texel_colours(
    colours: PictureColours, pictures: Sequence[Picture], atlas: Atlas, block: slice
) -> Float32s:
    """Return the colours of a block of the owned cells in the working space, shape (T, N)."""
    texels = atlas.owned_texels[block]
    table = np.empty((len(texels), len(colours.names)), np.float32)
    for index, inside, own in texels_by_texture(atlas.texture_offsets, texels):
        table[inside] = colours.working(pictures[index], own)
    return table


def all_texel_colours(colours: PictureColours, pictures: Sequence[Picture], atlas: Atlas) -> Float32s:
    """Return the colours of all owned cells, which are converted block by block."""
    table = large_arrays.empty((len(atlas.owned_texels), len(colours.names)), np.float32)
    for block in large_arrays.blocks(len(table)):
        table[block] = texel_colours(colours, pictures, atlas, block)
    return table


def without_transparent(
    atlas: Atlas, colours: PictureColours, pictures: Sequence[Picture], textures: Sequence[Texture]
) -> Atlas:
    """Return the atlas without the owned cells that supply no colour because their texel is transparent."""
    pairs = zip(pictures, textures, strict=True)
    can_hide = [picture.alpha is not None and texture.alpha_hides for picture, texture in pairs]
    if not (colours.hides and any(can_hide)):
        return atlas
    hidden = np.zeros(len(atlas.owned_texels), bool)
    for block in large_arrays.blocks(len(hidden)):
        for index, inside, texels in texels_by_texture(atlas.texture_offsets, atlas.owned_texels[block]):
            if can_hide[index]:
                hidden[block][inside] = colours.hidden(pictures[index], texels)
    return without_owned(atlas, hidden) if hidden.any() else atlas


# A step between two texels has the noise of both; beyond this many deviations of what smoothing took away it is real.
_REAL_STEP = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PictureLayer(Layer):
    """The common part of the texels of textures and the pixels of an image."""

    names: tuple[str, ...]
    settings: SmoothSettings
    pictures: Sequence[Picture]
    tables: Sequence[
        JpegTables | None
    ]  # of pictures that are JPEG files, and whose colours are as these have them
    colours: PictureColours
    atlas: Atlas | None = None  # of textures
    noise: Float32s | None = None  # standard deviations, with a row for each sample or, in images, pixel
    suffix: str | None = None  # of another image format that is written

    @abstractmethod
    def _canvas(self) -> tuple[Make, Atlas, KernelParameters]:
        """Return how the manifold is made, its atlas, and the parameters in its unit of length."""

    def plan(self, tick: Callable[[], None] | None = None) -> Plan[GridManifold]:
        make, atlas, kernel = self._canvas()
        pixels = [picture.pixels for picture in self.pictures]
        coded = list(zip(pixels, self.tables, strict=True)) if self.colours.shows_all else []
        return plan_on_pictures(make, atlas, coded, kernel, tick=tick, light_in=self.colours.light_space)

    def require_writable(self) -> None:
        for picture in self.pictures:
            check_writable(picture, self.suffix)

    def new_pixels(
        self, index: int, new: NewColours, gutter: int | None = None, *, is_dithered: bool = False
    ) -> tuple[Array, Change]:
        """Return a picture's pixels with new colours, and the change of its samples; other numbers keep their bits.

        `gutter`: texels around the charts of a texture that are refilled. `is_dithered`: so that smooth changes of
        colours are no bands in 8 bits.
        """
        picture, threads, atlas = self.pictures[index], self.settings.kernel.thread_count, self.atlas
        pixels = large_arrays.copy_of(picture.pixels)
        change = self._paint(pixels, index, new.places, new.take, is_dithered=is_dithered)
        if gutter is not None and atlas is not None:
            covered, known, rows = self._near_charts(index, pixels.shape[:2], new, gutter)
            chosen, values = new.beyond_places[rows], new.beyond[rows]
            beyond = NewColours.of(values)
            self._paint(pixels, index, chosen, beyond.take, is_dithered=is_dithered)
            keep_others(
                picture.pixels, pixels, covered, known, partial(self.colours.shown, picture),
                width=gutter, lone=self._of_picture(atlas.lone_texels, index)[1], threads=threads,
            )  # fmt: skip
            opacity, columns = self.colours.opacity(picture), self.colours.columns(picture)
            fill_gutter(pixels, covered, gutter, known, threads, columns, opacity)
        return pixels, change

    def _of_picture(self, texels: Indices, index: int) -> tuple[Bools | slice, Indices]:
        """Select the texels of one picture, and number them from its first."""
        if len(self.pictures) == 1 or self.atlas is None:
            return slice(None), texels
        begin, end = self.atlas.texture_offsets[index : index + 2].tolist()
        inside = (texels >= begin) & (texels < end)
        return inside, texels[inside] - begin

    def _near_charts(
        self, index: int, shape: tuple[int, ...], new: NewColours, gutter: int
    ) -> tuple[Bools, Bools, Int64s]:
        """Return the covered texels of a texture, shape (H, W), the gutter texels near them, and their rows."""
        covered, near = np.zeros(shape, bool), np.zeros(shape, bool)
        for block in large_arrays.blocks(len(new.places)):
            covered.reshape(-1)[self._of_picture(new.places[block], index)[1]] = True
        inside, texels = self._of_picture(new.beyond_places, index)
        chosen = within(covered, gutter).reshape(-1)[texels]
        near.reshape(-1)[texels[chosen]] = True
        return covered, near, np.arange(len(new.beyond_places))[inside][chosen]

    def _paint(
        self, pixels: Array, index: int, texels: Indices, take: Callable[[slice, Bools | slice], Float32s], *,
        is_dithered: bool,
    ) -> Change:  # fmt: skip
        """Write samples into pixels like a picture's own, in place, and return how these change."""
        picture, colours, threads = self.pictures[index], self.colours, self.settings.kernel.thread_count
        table, changes = pixels.reshape(-1, pixels.shape[2]), []
        for block in large_arrays.blocks(len(texels), large_arrays.CACHED):
            inside, here = self._of_picture(texels[block], index)
            if not len(here):
                continue
            values = colours.stored(picture, table, here, take(block, inside))
            if is_dithered and picture.stored == "uint8":
                values = dithered(values, here, picture.pixels.shape[1])
            changes.append(store(picture, table, here, values, colours.columns(picture), threads))
        return Change.joined(changes)


def dithered(values: Float32s, texels: Indices, width: int) -> Float32s:
    """Add a pattern of half a step of 8 bits to some texels, so that rounding spreads what it takes away.

    Multiples of a step stay. The pattern is interleaved gradient noise: J. Jimenez, "Next generation post
    processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
    """
    row, column = np.divmod(texels.astype(np.int32), np.int32(width))
    pattern = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1)) % 1
    steps = values * np.float32(255)
    is_whole = np.abs(steps - np.rint(steps)) < 2e-3
    spread = (steps + (0.98 * (pattern - 0.5)).astype(np.float32)[:, None]) / np.float32(255)
    return np.where(is_whole, values, spread)


def keep_others(
    old: Array, new: Array, covered: Bools, known: Bools, shown: Callable[[Array], Float32s], *,
    width: int, lone: Indices, threads: int,
) -> None:  # fmt: skip
    """Let texels around charts that do not continue the adjacent chart keep their colours, in place.

    A texel continues its chart if the step to the nearest covered texel was, but for noise, what it is now; or if there
    was none, and then it is left to be filled from there. All else is background, or the edge of a colour that lies on
    the chart's border, or paint of another chart, material or model. Single texels of such paint may resemble the
    chart, so half of the uncovered texels around must continue it, too. Of lone texels it is not known which part of
    the surface they show.

    `old`, `new`: pixels before and now, (H, W, C), whose colours `shown` returns. Texels that are `known`, (H, W), are
    not filled afterwards.
    """
    rows, new_rows, is_known = old.reshape(covered.size, -1), new.reshape(covered.size, -1), known.reshape(-1)
    limit = _REAL_STEP * _taken_away(rows, new_rows, covered, shown)
    painted, continues = np.flatnonzero(is_known), np.zeros(covered.shape, bool)
    for texels, nearest in nearest_covered(covered, width + 1 if width else 0, threads=threads):
        for block in large_arrays.blocks(len(texels), large_arrays.CACHED):
            here, there = texels[block], nearest[block]
            step = shown(rows[here]) - shown(rows[there])
            is_halo = is_known[here]
            halo = here[is_halo]
            now = shown(new_rows[halo]) - shown(new_rows[there[is_halo]])
            follows = _size(step[is_halo] - now) <= limit
            is_known[halo] = follows
            has_no_step = _size(step) <= limit
            has_no_step[is_halo] |= follows
            continues.reshape(-1)[here] = has_no_step
    continues &= _is_half(continues, ~covered)
    continues.reshape(-1)[lone] = False
    stays = ~(continues | covered)
    restored = painted[stays.reshape(-1)[painted]]
    new_rows[restored] = rows[restored]
    known[stays] = True


def _is_half(marked: Bools, counted: Bools) -> Bools:
    """Return where at least half of the texels that count, of 3 x 3 around, are marked; these count, too."""
    found = np.empty(marked.shape, bool)
    for rows in large_arrays.blocks(len(marked), ROWS):
        first = max(0, rows.start - 1)
        # By sums of slices, since to import SciPy's filters takes longer than to smooth a small texture.
        balance = np.pad(
            2 * marked[first : rows.stop + 1].astype(np.int8) - counted[first : rows.stop + 1], 1
        )
        balance = balance[:-2] + balance[1:-1] + balance[2:]
        balance = balance[:, :-2] + balance[:, 1:-1] + balance[:, 2:]
        found[rows] = balance[rows.start - first :][: rows.stop - rows.start] >= 0
    return found


def _taken_away(old: Array, new: Array, covered: Bools, shown: Callable[[Array], Float32s]) -> float:
    """Return the root mean square by which the texels at the borders of charts changed."""
    edge = np.flatnonzero(covered & within(~covered, 1))
    total = 0.0
    for block in large_arrays.blocks(len(edge), large_arrays.CACHED):
        change = shown(new[edge[block]]) - shown(old[edge[block]])
        total += float(np.square(_size(change)).sum())
    return float(np.sqrt(total / max(1, len(edge))))


def _size(differences: Float32s) -> Float64s:
    """Return the root mean square over the channels."""
    return np.asarray(np.sqrt(np.square(differences, dtype=np.float64).mean(axis=1)))
