"""Textures too many for the memory, smoothed in groups that lie together, each with the surface around it.

A kernel reads a few texels beyond its own in each iteration, so a texture has the same result with all others as with
those triangles alone that are as near as all iterations reach. Only the textures of a group itself are written back.
Parameters and noise are chosen once, on textures spread evenly over all, for all groups.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.flow.beltrami_flow import choose_parameters
from beltrami_cli.flow.canvas import canvas_margin
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.image.reading import ImageSize
from beltrami_cli.layers import memory_check
from beltrami_cli.layers.layer import describe_choice, named
from beltrami_cli.layers.settings import SmoothSettings
from beltrami_cli.layers.texel_colours import only_textures
from beltrami_cli.layers.texture_groups import Borders, Common, TextureGroup
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.records import Slot, TexturedSurface

# Patches are looked for around each texel twice, and their weights are averaged.
_PASSES_OF_PATCHES = 4
_SHARE_OF_DISK = 0.5  # of the free space
_RESIDENT_BYTES = 50  # of a texel that are in memory at a time, pages of files included
_USUAL = 0.999  # of the texels of a texture; others are in slivers
_MOST_POINTS = 1 << 18


@dataclass(frozen=True)
class TileGroups:
    """Textures that are `too_many_together`."""

    surface: TexturedSurface
    sizes: Sequence[ImageSize]
    memory: int

    def evenly_chosen(self) -> TexturedSurface:
        """Return the surface with textures spread evenly over all, as many as are worth smoothing together."""
        room, count, chosen = self._room(), len(self.sizes), [len(self.sizes) // 2]
        for number in range(2, count):
            wanted = np.linspace(0, count - 1, number).round().astype(int).tolist()
            if sum(self.sizes[index].texels for index in wanted) > room:
                break
            chosen = wanted
        return only_textures(self.surface, chosen)

    def common(self, slot: Slot, settings: SmoothSettings) -> Common:
        """Estimate noise and choose parameters on some of the textures, with nothing left to choose."""
        samples = TextureLayer.read(self.evenly_chosen(), slot, settings)
        manifold = samples.manifold()
        noise, plan = manifold.noise.with_relative(None), choose_parameters(manifold, settings.kernel)
        kernel = dataclasses.replace(
            plan.parameters,
            free=(),
            beta=plan.manifold.beta,
            patches="on" if plan.takes_patches else "off",
        )
        described = {
            "noise": named(samples.names, plan.noise),
            "noise_model": plan.described_noise,
            "choice": describe_choice(plan.choice),
        }
        chosen = dataclasses.replace(settings, kernel=kernel)
        return Common(chosen, manifold.unit, noise, samples.names, described)

    def parted(self, common: Common) -> list[TextureGroup]:
        """Part all textures; InputError if one does not fit into memory with the surface around it."""
        near = _near_faces(self.surface, self.sizes, common.settings.kernel)
        adjacent = [{*self.surface.texture_of[faces].tolist()} for faces in near]
        room, left = self._room(), set(range(len(self.sizes)))
        parts: list[set[int]] = []
        while left:
            group = {min(left)}
            if self._texels(group, near) > self._most_texels:
                raise memory_check.too_large(self.surface.textures[min(left)].name, self.sizes[min(left)])
            while candidates := set[int]().union(*(adjacent[index] for index in group)) & left - group:
                # The one with the most neighbours in the group makes it the roundest.
                new = max(candidates, key=lambda index: (len(adjacent[index] & group), -index))
                if self._texels(group | {new}, near) > room:
                    break
                group.add(new)
            left -= group
            parts.append(group)
        labels = [f"group {number} of {len(parts)}" for number in range(1, len(parts) + 1)]
        return [self._part(group, near, at, common) for group, at in zip(parts, labels, strict=True)]

    def _texels(self, group: set[int], near: Sequence[Int64s]) -> int:
        """Return about how many texels a group has, with the surface around it; texels beyond that count half."""
        total = sum(self.sizes[index].texels for index in group)
        faces = np.concatenate([near[index] for index in group])
        texture, uv = self.surface.texture_of[faces], self.surface.uv[faces]
        for index in {*texture.tolist()} - group:
            low, high = (bound(uv[texture == index], axis=(0, 1)) for bound in (np.min, np.max))
            total += int(self.sizes[index].texels * (1 + np.prod(np.clip(high - low, 0, 1))) / 2)
        return total

    def _part(self, group: set[int], near: Sequence[Int64s], label: str, common: Common) -> TextureGroup:
        surface = self.surface
        kept = np.isin(surface.texture_of, [-1, *group])
        kept[np.concatenate([near[index] for index in group])] = True
        faces, uv, texture_of = surface.faces[kept], surface.uv[kept], surface.texture_of[kept]
        part = dataclasses.replace(surface, faces=faces, uv=uv, texture_of=texture_of)
        shown = np.unique(texture_of[texture_of >= 0]).tolist()
        own = frozenset(surface.textures[index].key for index in group)
        return TextureGroup(label, only_textures(part, shown), own, common)

    @property
    def _most_texels(self) -> int:
        """How many texels memory is enough for, with all large arrays in files."""
        return (self.memory - max(size.decoded for size in self.sizes)) // memory_check.TEXEL_BYTES_ON_DISK

    def _room(self) -> int:
        """Return how many texels are worth smoothing together: as pages of files, their arrays need room as well."""
        return min(
            self._most_texels,
            self.memory // _RESIDENT_BYTES,
            int(_SHARE_OF_DISK * large_arrays.free_space() / memory_check.TEXEL_BYTES),
        )


def _near_faces(
    surface: TexturedSurface, sizes: Sequence[ImageSize], kernel: KernelParameters
) -> list[Int64s]:
    """Return for each texture the triangles of others from which all iterations carry colours to it."""
    from scipy.spatial import cKDTree

    border = Borders.of(surface)
    pitches = _pitches(surface, sizes)
    steps = kernel.iterations + (_PASSES_OF_PATCHES if kernel.takes_patches else 0)
    cells = np.sqrt(2) * canvas_margin(kernel) * max(1, steps)
    corners = surface.positions[surface.faces]
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    found = []
    for index in range(len(sizes)):
        own = border.texture == index
        edges, shared = border.ends[own], np.isin(border.edge, border.edge[own])
        if not len(edges):
            found.append(np.zeros(0, np.int64))
            continue
        reach = cells * max(pitches[each] for each in (index, *border.texture[shared].tolist()))
        points, slack = _along(surface.positions[edges], reach)
        faces = np.flatnonzero((surface.texture_of >= 0) & (surface.texture_of != index))
        distance = cKDTree(points).query(centres[faces])[0]
        found.append(faces[distance <= reach + slack + radii[faces]])
    return found


def _pitches(surface: TexturedSurface, sizes: Sequence[ImageSize]) -> Float64s:
    """Return for each texture how far apart neighbouring texels are in space, but for slivers, shape (T,)."""
    # Of the map J from texels to space: the norm is at least the largest distance of neighbours.
    a, b = np.moveaxis(np.diff(surface.positions[surface.faces], axis=1), 1, 0)
    extent = np.array([(size.width, size.height) for size in sizes] + [(0, 0)], np.float64)
    u, v = np.moveaxis(np.diff(surface.uv, axis=1) * extent[surface.texture_of][:, None], 1, 0)
    area = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    dot = partial(np.einsum, "fi,fi->f")
    squared = dot(a, a) * dot(v, v) - 2 * dot(a, b) * dot(u, v) + dot(b, b) * dot(u, u)
    with np.errstate(divide="ignore", invalid="ignore"):
        norms = np.sqrt(np.maximum(squared, 0)) / area
    pitches = np.zeros(len(sizes))
    for index in range(len(sizes)):
        faces = np.flatnonzero((surface.texture_of == index) & (area > 0))
        if len(faces):
            order = faces[np.argsort(norms[faces])]
            covered = np.cumsum(area[order])
            pitches[index] = norms[order[np.searchsorted(covered, _USUAL * covered[-1])]]
    return pitches


def _along(ends: Float64s, reach: float) -> tuple[Float64s, float]:
    """Return points along edges, shape (E, 2, 3), and how far from one of them a place on an edge is at most."""
    steps = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(steps, axis=1)
    pace = max(reach, float(lengths.sum()) / _MOST_POINTS)
    if pace == 0:
        return ends[:, 0], 0.0
    counts = np.ceil(lengths / pace).astype(np.int64) + 1
    edge = np.repeat(np.arange(len(ends)), counts)
    within = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = within / np.maximum(1, counts - 1)[edge]
    return ends[edge, 0] + share[:, None] * steps[edge], pace / 2
