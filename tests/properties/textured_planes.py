"""Textured surfaces whose texels line up, so that truths hold exactly."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

import oracles.textured
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.manifolds.grid.gaussian import gaussian_reach
from beltrami_cli.flow.manifolds.grid.manifold import ColouredCanvas
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.surface.atlas import build_atlas
from oracles import surfaces

textured = functools.partial(oracles.textured.textured, sizes=[(1, 1)], wrap=("clamp", "clamp"))


@dataclasses.dataclass
class Board:
    """A plane of cells x cells squares of `texels` texels, cut into charts, each somewhere in the image.

    places : for each chart (square of `block` cells): row and column of its slot in the image, quarter turns, mirrored.
    """

    cells: int
    texels: int
    block: int
    slot: int  # texels a side that a chart's slot in the image has
    slots: int  # slots a side of the image
    places: list

    @property
    def size(self):
        return self.slot * self.slots

    def surface(self):
        positions, faces = surfaces.plane(self.cells + 1, self.cells + 1)
        corners = positions[faces][:, :, :2]
        middle = corners.mean(axis=1)
        charts = self.cells // self.block
        uv = np.empty(corners.shape)
        for number, (row, column, turns, mirrored) in enumerate(self.places):
            cy, cx = divmod(number, charts)
            inside = (middle[:, 0] // self.block == cx) & (middle[:, 1] // self.block == cy)
            local = (corners[inside] - self.block * np.array([cx, cy])) * self.texels
            uv[inside] = (self._turn(local, turns, mirrored) + self._origin(row, column)) / self.size
        return textured(positions, faces, uv)

    def image_of(self, phantom):
        """Lay a phantom (side, side, N), a texel per place, out in the image; the rest is noise."""
        image = np.random.default_rng(99).random((self.size, self.size, phantom.shape[2]))
        y, x = self.texel_places()
        image[y, x] = phantom
        return image

    def texel_places(self):
        """Row and column in the image of every texel of the phantom."""
        side = self.cells * self.texels
        centre = np.stack(np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5), axis=-1)
        extent, charts = self.block * self.texels, self.cells // self.block
        places = np.empty((side, side, 2))
        for number, (row, column, turns, mirrored) in enumerate(self.places):
            cy, cx = divmod(number, charts)
            part = np.s_[cy * extent : (cy + 1) * extent, cx * extent : (cx + 1) * extent]
            local = centre[part] - extent * np.array([cx, cy])
            places[part] = self._turn(local, turns, mirrored) + self._origin(row, column)
        return places[..., 1].astype(int), places[..., 0].astype(int)

    def _origin(self, row, column):
        return np.array([column, row]) * self.slot + (self.slot - self.block * self.texels) // 2

    def _turn(self, local, turns, mirrored):
        extent = self.block * self.texels
        x, y = local[..., 0], local[..., 1]
        if mirrored:
            x = extent - x
        for _ in range(turns):
            x, y = y, extent - x
        return np.stack([x, y], axis=-1)


def texel_plan(atlas, colours, parameters, **others):
    """Plan the smoothing of texels with some colours, shape (T, N)."""
    return plan_on_canvas(
        ColouredCanvas(
            atlas=atlas,
            parameters=parameters,
            channels=colours.shape[1],
            colours_of=colours.__getitem__,
            **others,
        )
    )


def smoothed(plan):
    """Smooth texels and return their colours."""
    return smooth_in_place(plan).manifold.new_colours().table()


def smooth_image(surface, image, **parameters):
    """Smooth one image over a surface; texels that nothing covers stay."""
    kernel = KernelParameters(**{"threads": 1, **parameters})
    margin = kernel.window // 2 + (gaussian_reach(kernel.metric_scale) if kernel.metric_steps else 0)
    atlas = build_atlas(surface, [(image.shape[1], image.shape[0])], margin, 1)
    table = image.reshape(-1, image.shape[2]).astype(np.float32)
    plan = texel_plan(atlas, table[atlas.owned_texels], kernel)
    new = table.copy()
    new[atlas.owned_texels] = smoothed(plan)
    return new.reshape(image.shape), plan


def phantom(side, channels=3):
    """Two regions with a slow gradient, and noise of 20 / 255."""
    y, x = np.mgrid[0:side, 0:side] / side
    base = np.where((x + 0.3 * y > 0.6)[..., None], 0.7 - 0.2 * y[..., None], 0.3 + 0.2 * x[..., None])
    noise = np.random.default_rng(5).normal(0, 20 / 255, (side, side, channels))
    return base + np.linspace(-0.1, 0.1, channels) + noise
