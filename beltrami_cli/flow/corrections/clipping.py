"""Averages of colours whose noise was clipped at 0 and at full scale.

Where a surface is white, noise can only darken it: what would be brighter than full scale is stored as full scale. An
average over such samples is too dark, by up to 0.4 standard deviations of the noise, however many samples it has [2]_.
But the share of the samples at the limit shows how close the true colour is to it: samples are a normal variable
censored at the limit, with known mean and share.

With alpha = (limit - true) / sigma, the share at the limit is 1 - Phi(alpha), and the mean lies below the limit by
sigma (alpha Phi(alpha) + phi(alpha)) [1]_. The share gives alpha, and the gap between limit and mean the local sigma.

References
----------
.. [1] J. Tobin, "Estimation of relationships for limited dependent variables", Econometrica 26 (1958): the mean of a
   censored normal variable. https://doi.org/10.2307/1907382
.. [2] A. Foi, "Clipped noisy images: heteroskedastic modeling and practical denoising", Signal Processing 89 (2009):
   denoised images need this correction. https://doi.org/10.1016/j.sigpro.2009.04.035
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import starmap
from typing import NamedTuple

import numpy as np

from beltrami_cli._native import impute_clipped, restore_clipped
from beltrami_cli.arrays import Array, Bools, Float32s, Float64s
from beltrami_cli.flow.corrections.normal_tables import censored_normal, normal_tables
from beltrami_cli.flow.manifolds.blocks import block_rows, for_blocks
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY
from beltrami_cli.surface.colour_values import limits_of

# Minimum share of samples at a limit: fewer change no mean enough to be worth a plane of memory.
_WORTH_RESTORING = 1e-3

# Bound of the local noise relative to the estimate, which is too low where many samples are clipped. Larger differences
# are in the colours themselves.
_MAX_LOCAL_NOISE = 1.2

# Standard deviations that contain nearly all of the noise.
_NOISE_EXTENT = 3.0

# Smaller than the share of any sample in a mean of its neighbourhood.
MIN_SHARE = 1e-6


class ClippedChannel(NamedTuple):
    """The noise of a channel, and whether it is clipped at 0 (`low`) and at 1 (`high`), as the core takes them.

    Arrays have the shape (1, ...), `relative` is the variance of the noise relative to `sigma` squared.
    """

    sigma: float
    low: bool
    high: bool

    @property
    def sides(self) -> list[ClippedChannel]:
        """The clipping at each limit alone."""
        sides = self._replace(high=False), self._replace(low=False)
        return [side for side in sides if side.low or side.high]

    def near_limit(self, colours: Float32s, relative: Float32s) -> Bools:
        """Mark samples that noise may have moved to a limit."""
        reach = np.float32(_NOISE_EXTENT) * (np.float32(self.sigma) * np.sqrt(relative))
        return np.asarray((self.low & (colours < reach)) | (self.high & (colours > 1 - reach)))

    def marks_of(self, colours: Float32s) -> Float32s:
        """Mark samples at a limit by 1 or -1, to be averaged like colours."""
        # Both limits share one plane, because an average seldom contains many samples of both.
        return np.subtract(self.high & (colours >= 1), self.low & (colours <= 0), dtype=np.float32)

    def restore_in_place(
        self, means: Float32s, marks: Float32s, relative: Float32s, threads: int = 1
    ) -> None:
        """Turn averages of clipped colours into estimates of the noise-free colours."""
        table = censored_normal()
        tables = table.share, table.alpha, table.gap
        restore_clipped(means, marks, self, _MAX_LOCAL_NOISE, *tables, relative, threads)

    def impute_in_place(
        self, colours: Float32s, pilot: Float32s, relative: Float32s, threads: int = 1
    ) -> None:
        """Replace samples at a limit by the mean of noise beyond it, given the pilot."""
        tables = normal_tables()
        impute_clipped(colours, pilot, self, tables.limits, tables.beyond, relative, threads)


@dataclass(frozen=True)
class ClippedChannels:
    """The clipping of N channels; arrays have the shape (N, ...), marks have a plane for each clipped channel."""

    channels: tuple[ClippedChannel, ...]

    @property
    def clipped(self) -> list[int]:
        """The channels that are clipped at either limit."""
        return [k for k, channel in enumerate(self.channels) if channel.low or channel.high]

    def marks_of(self, colours: Float32s) -> Float32s:
        return np.concatenate([self.channels[k].marks_of(colours[k : k + 1]) for k in self.clipped])

    def restore_in_place(
        self, means: Float32s, marks: Float32s, relative: Float32s, threads: int = 1
    ) -> None:
        relative = np.broadcast_to(relative, (1, *means.shape[1:]))
        for plane, k in enumerate(self.clipped):
            of_channel = means[k : k + 1], marks[plane : plane + 1]
            self.channels[k].restore_in_place(*of_channel, relative, threads)

    def impute_in_place(
        self, colours: Float32s, pilot: Float32s, relative: Float32s, threads: int = 1
    ) -> None:
        relative = np.broadcast_to(relative, (1, *colours.shape[1:]))
        for k in self.clipped:
            self.channels[k].impute_in_place(colours[k : k + 1], pilot[k : k + 1], relative, threads)


def find_clipped(channels: Float32s, sigma: Float64s, empty: int = 0) -> ClippedChannels | None:
    """Find the channels, shape (N, ...), that are clipped at 0 or full scale; None if there are none.

    In each channel, `empty` zeros are cells without a colour.
    """
    count = channels[0].size - empty
    if not count:
        return None
    rows = max(1, large_arrays.BLOCK // channels[0, :1].size)
    at_0, at_1 = np.zeros((2, len(channels)), int)
    for block in large_arrays.blocks(channels.shape[1], rows):
        for k, channel in enumerate(channels):
            at_0[k] += np.count_nonzero(channel[block] == 0)
            at_1[k] += np.count_nonzero(channel[block] == 1)
    floor, ceiling = np.transpose([limits_of(channel) for channel in channels])
    worth, noisy = _WORTH_RESTORING * count, sigma > 0
    low = noisy & (floor == 0) & (at_0 - empty >= worth)
    high = noisy & (ceiling == 1) & (at_1 >= worth)
    found = ClippedChannels(
        tuple(starmap(ClippedChannel, zip(sigma.tolist(), low.tolist(), high.tolist(), strict=True)))
    )
    return found if found.clipped else None


def clipped_on(manifold: Manifold) -> ClippedChannels | None:
    """Find the clipped channels of a manifold's colours; None if there are none."""
    channels, empty = manifold.geometry.smoothable(manifold.colours)
    return find_clipped(channels, manifold.noise.sigma, empty)


def mark_clipped(manifold: Manifold, clipped: ClippedChannels) -> Stack:
    """Return the marks of samples at a limit as a stack, to be averaged like colours."""
    geometry = manifold.geometry
    planes = large_arrays.zeros((len(clipped.clipped), *geometry.shape), np.float32)
    marks = np.ascontiguousarray(np.moveaxis(planes, 0, geometry.axis))

    def mark(channels: Array, block: Array, kind: Array) -> None:
        block[:] = clipped.marks_of(channels)
        np.copyto(block, 0, where=kind == EMPTY)

    for_blocks(mark, geometry.threads, geometry.axis, manifold.colours, marks, geometry.kind)
    geometry.refresh(marks)
    return marks


def restore_clipped_in_place(
    manifold: Manifold, clipped: ClippedChannels, colours: Stack, marks: Stack
) -> None:
    """Turn averages of clipped colours into estimates of the colours without noise."""
    geometry, relative = manifold.geometry, manifold.relative_variance
    for_blocks(clipped.restore_in_place, geometry.threads, geometry.axis, colours, marks, relative)


def impute_clipped_in_place(manifold: Manifold) -> None:
    """Replace samples at a limit by the mean of the noise beyond it, given the samples around."""
    geometry, clipped = manifold.geometry, clipped_on(manifold)
    if clipped is None:
        return
    colours, relative = (
        np.moveaxis(each, geometry.axis, 0) for each in (manifold.colours, manifold.relative_variance)
    )
    for k, channel in enumerate(clipped.channels):
        for side in channel.sides:
            _impute_side_in_place(manifold, side, colours[k : k + 1], relative)
    geometry.refresh(manifold.colours)


def _impute_side_in_place(
    manifold: Manifold, side: ClippedChannel, channel: Float32s, relative: Float32s
) -> None:
    regions, threads = manifold.regions, manifold.geometry.threads

    def terms(rows: slice) -> Float32s:
        block = channel[:, rows]
        # Samples beyond an edge are not near the limit, and are ignored.
        near = side.near_limit(block, relative[:, rows])
        return np.concatenate([np.ones_like(block), block, side.marks_of(block)]) * near

    sums = regions.spread(regions.gathered(3, terms, channel, threads))
    for rows in block_rows(channel, regions.side):
        means, variance = regions.enlarged(sums, rows), relative[:, rows]
        means[1:] /= np.maximum(means[:1], MIN_SHARE)
        side.restore_in_place(means[1:2], means[2:], variance, threads)
        side.impute_in_place(channel[:, rows], means[1:2], variance, threads)
