"""Smoothing that preserves the mean radiance.

Colours are averaged as display values or stabilised values, in which their noise is even. The mean of such values is
not the mean of the light. If noise grows with the light, as with renderers that trace few paths, the result is too
dark, by up to one half. So the light that smoothing lost around each sample is restored, in proportion to the local
light.

With z the light before, u after smoothing, w_b weights of the level of u that sum to one over the bands b, and G the
mean over a part of the surface:

    u' = u + |u| sum_b w_b G[w_b (z - u)] / G[w_b |u|]

Bands prevent that dark samples beyond an edge receive the loss of bright ones. The magnitude |u| admits negative light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.flow.manifolds.blocks import block_rows, in_blocks
from beltrami_cli.flow.manifolds.domain import Regions
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.noise_amount import COLOURS
from beltrami_cli.flow.parameters import Space
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_values import from_space, to_space

# Ratio of light between successive bands. Where only the noise on the dark side of an edge of 1 to 50 has heavy tails
# (a gamma distribution of four samples), the mean of the 32 cells at the edge is off by 2.3 % without bands and by 0.2
# % with ratios of 4 and 16. Bands with a ratio of 4 are narrower than the remaining noise, and would keep more of it: 9
# % against 4 %.
_BAND_FACTOR = 16.0

# Number of bands below and above full scale. The last ones include all light beyond, such as black.
_MAX_BANDS = 4


@dataclass(frozen=True)
class MeanLight:
    """The light of a manifold's samples in a colour space before smoothing."""

    planes: Float32s  # of all channels
    space: Space

    @classmethod
    def of(cls, manifold: Manifold, space: Space) -> MeanLight:
        return cls(_light_of(manifold, space), space)

    def restore_in_place(self, manifold: Manifold) -> None:
        """Restore the mean light of the smoothed colours of the manifold."""
        stabiliser, space = manifold.noise.stabiliser, self.space
        manifold.geometry.refresh(manifold.colours)
        light = _light_of(manifold, space)
        for k, channel in enumerate(light):
            before, smoothed = self.planes[k : k + 1], light[k : k + 1]
            channel[:] = _restored(manifold.regions, before, smoothed, manifold.geometry.threads)[0]
        axis = manifold.geometry.axis
        for block, new in zip(in_blocks(axis, manifold.colours), in_blocks(0, light), strict=True):
            block[0][:] = _converted(new[0], lambda rows: to_space(rows, "linear", space))
            if stabiliser is not None:
                stabiliser.stabilise_in_place(block[0])
        manifold.geometry.refresh(manifold.colours)


def _restored(regions: Regions, before: Float32s, smoothed: Float32s, threads: int) -> Float32s:
    """Return u' of a channel, shape (1, ...), from z and u."""
    restored = smoothed.copy()
    for band in _bands(smoothed):

        def lost_and_size(rows: slice, band: int = band) -> Float32s:
            z, u = before[0, rows], smoothed[0, rows]
            weighted = _weights(u, band)
            return np.stack([weighted * (z - u), weighted * np.abs(u)])

        sums = regions.spread(regions.gathered(2, lost_and_size, smoothed, threads))
        for rows in block_rows(smoothed, regions.side):
            u, (lost, size) = smoothed[0, rows], regions.enlarged(sums, rows)
            size = np.maximum(size, np.finfo(np.float32).tiny)
            restored[0, rows] += _weights(u, band) * np.abs(u) * lost / size
    return restored


def _light_of(manifold: Manifold, space: Space) -> Float32s:
    axis, stabiliser = manifold.geometry.axis, manifold.noise.stabiliser
    channels = manifold.colours.shape[axis]
    planes: Float32s = large_arrays.empty((channels, *manifold.geometry.shape), np.float32)
    for block, light in zip(in_blocks(axis, manifold.colours), in_blocks(0, planes), strict=True):
        colours = block[0].copy()
        if stabiliser is not None:
            stabiliser.restore_in_place(colours)
        light[0][:] = _converted(colours, lambda rows: from_space(rows, "linear", space))
    return planes


def _bands(light: Float32s) -> list[int]:
    """Return the bands that contain light other than 0."""
    below: set[int] = set()
    for (block,) in in_blocks(0, light):
        below.update(np.unique(np.floor(_levels(block[block != 0])).astype(int)).tolist())
    return sorted(below | {band + 1 for band in below})


def _levels(light: Float32s) -> Float32s:
    """Return the band of each light value, and the fractional position towards the next."""
    size = np.clip(np.abs(light), _BAND_FACTOR**-_MAX_BANDS, _BAND_FACTOR**_MAX_BANDS)
    levels: Float32s = np.log(size) / np.float32(np.log(_BAND_FACTOR))
    return levels


def _weights(light: Float32s, band: int) -> Float32s:
    weights: Float32s = np.maximum(1 - np.abs(_levels(light) - np.float32(band)), 0)
    return weights


def _converted(channels: Array, convert: Callable[[Float32s], Float32s]) -> Float32s:
    """Convert the colours, the first of the channels along the first axis, but not the others, such as opacity."""
    result: Float32s = channels.copy()
    count = min(COLOURS, len(channels))
    rows = np.ascontiguousarray(channels[:count].reshape(count, -1).T)
    result[:count] = convert(rows).T.reshape(channels[:count].shape)
    return result
