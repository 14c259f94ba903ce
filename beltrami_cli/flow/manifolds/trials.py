"""Samples on which parameters are tried, and random perturbations of their colours.

The samples are blocks of a canvas or patches of a mesh, each with a rim.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Indices, Int32s, Int64s
from beltrami_cli.flow.noise.drawing import draw_model
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED, Atlas, refresh_halo

# Number of samples for which one perturbation suffices, and maximum number of perturbations for fewer samples.
_ENOUGH_SAMPLES, _MAX_PROBES = 5_000, 4

# Cells on which parameters are tried, as a share of all, so that trying takes no longer than smoothing: some sixty
# iterations are tried, each twice. With twice as many, the default results on thirteen textures with noise of 20 of 255
# differ by 0.00 dB on average, and by 0.09 dB at most.
# With twice the most the risk is known to a tenth of a dB or better.
_TRIED_CELLS = {"share": 1 / 50, "least": 20_000, "most": 50_000}

# Side of the core of a block in cells; only the core is evaluated.
_CORE_SIDE = 64

# Width of the rim in cells. Iterations spread errors inwards from a block's border; most of a kernel's weight lies
# within this distance.
_RIM_CELLS = 8

# An arbitrary seed; a fixed one makes the choice reproducible.
_SEED = 20

# Samples on which parameters are tried, as a share of all, so that trying takes hardly longer than smoothing: some
# sixty iterations are tried, each two or three times. With fewer than the least the estimate is too uncertain; these
# take tenths of a second. More than the most do not improve the choice.
TRIED_VERTICES = {"share": 1 / 20, "least": 6_000, "most": 40_000}

# Below this ratio of all samples to those wanted, patches with their rims would cover nearly the whole surface.
_WHOLE_SURFACE = 1.2

# Rings of a patch that are evaluated, and rings of its rim, which only supply colours.
_SCORED_RINGS, _RIM_RINGS = 7, 3

# Patches are small on small components, and overlap. Share of the wanted samples that suffices, and maximum number of
# rounds in which patches are added.
_SUFFICIENT_SHARE, _MAX_EXTENSIONS = 0.75, 3

# Rings over which detail is averaged to rank patches.
_RINGS_OF_DETAIL = 5

# Odd multipliers with well-mixed bits, as in SplitMix64, for hashing.
_MIXERS = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9], np.uint64)


def wanted_probes(samples: int) -> int:
    """Return the number of stacks of signs needed to estimate the divergence on this many samples."""
    return min(_MAX_PROBES, -(-_ENOUGH_SAMPLES // max(1, samples)))


def tried_cells(atlas: Atlas) -> int:
    """Return the number of cells on which parameters are tried, which may exceed the number of cells."""
    return int(
        np.clip(len(atlas.owned_cells) * _TRIED_CELLS["share"], _TRIED_CELLS["least"], _TRIED_CELLS["most"])
    )


def choose_blocks(atlas: Atlas, budget: int, reach: int) -> tuple[Int64s, Bools]:
    """Choose evenly spread blocks; return their cells, and which are in a core, shape (blocks * side, side)."""
    rows, columns = atlas.kind.shape
    across = np.arange(0, columns, _CORE_SIDE)
    bands = (atlas.kind[top : top + _CORE_SIDE] == OWNED for top in range(0, rows, _CORE_SIDE))
    totals = np.cumsum([np.add.reduceat(band.sum(axis=0), across) for band in bands])
    wanted = max(1, budget // _CORE_SIDE**2)
    chosen = np.unique(np.searchsorted(totals, (np.arange(wanted) + 0.5) * totals[-1] / wanted))
    top, left = np.divmod(chosen, -(-columns // _CORE_SIDE))
    margin = _RIM_CELLS + reach
    side = np.arange(-margin, _CORE_SIDE + margin)
    row = (top[:, None] * _CORE_SIDE + side)[:, :, None]
    column = (left[:, None] * _CORE_SIDE + side)[:, None, :]
    on = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    # Cells beyond the canvas get the flat index of its last cell, which is in the margin.
    cells = np.where(on, row * columns + column, atlas.kind.size - 1).reshape(-1, len(side))
    inside = (side >= 0) & (side < _CORE_SIDE)
    core = np.tile(inside[:, None] & inside, (len(chosen), 1))
    return cells.astype(np.int64), core


def with_halo(part: Atlas, whole: Atlas, cells: Int64s, core: Bools) -> Atlas:
    """Complete the atlas of some cells of `whole` by the halo cells whose owned cells are included."""
    # A cell in several blocks is taken from the block whose core contains it.
    owned = part.owned_cells
    order = np.lexsort([~core.reshape(-1)[owned], cells.reshape(-1)[owned]])
    owned = owned[order]
    mirrored = np.flatnonzero(part.kind != EMPTY)
    rank = _rank(whole.halo_cells, cells.reshape(-1)[mirrored])
    mirrored, rank = mirrored[rank >= 0], rank[rank >= 0]
    place = _rank(cells.reshape(-1)[owned], whole.halo_taps[rank])
    taps = np.where(place >= 0, owned[place], -1) if len(owned) else place
    complete = np.all((taps >= 0) | (whole.halo_weights[rank] == 0), axis=1)
    return dataclasses.replace(
        part,
        halo_cells=mirrored[complete],
        halo_taps=np.maximum(taps[complete], 0).astype(np.int64),
        halo_weights=whole.halo_weights[rank[complete]],
        halo_seams=whole.halo_seams[rank[complete]],
    )


def _rank(ascending: Indices, wanted: Indices) -> Int64s:
    """Return the index of numbers in an ascending list, the first of equal ones; -1 if absent."""
    if not len(ascending):
        return np.full(wanted.shape, -1, np.int64)
    rank = np.minimum(np.searchsorted(ascending, wanted), len(ascending) - 1)
    return np.where(ascending[rank] == wanted, rank, -1)


def perturbations(count: int, atlas: Atlas, noise: NoiseModel) -> list[Array]:
    """Draw random planes like the noise: independent signs as bytes, or correlated noise."""
    random, shape = np.random.default_rng(_SEED), atlas.kind.shape
    if noise.is_independent:
        drawn = [*large_arrays.random_signs((count, len(noise.sigma), *shape), random)]
    else:
        size = np.float32(np.sqrt(np.mean(np.square(noise.sigma))))
        drawn = [draw_model(noise.covariances, shape, random) for _ in range(count)]
    for planes in drawn:
        for rows in large_arrays.blocks(len(atlas.kind), large_arrays.ROWS):
            if not noise.is_independent:
                planes[:, rows] /= size
            planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
        refresh_halo(planes, atlas)
    return drawn


@dataclass(frozen=True)
class TrialSamples:
    """Samples on which parameters are tried: ascending indices, shape (P,), and which of them are evaluated."""

    samples: Int64s
    scored: Bools


def choose_patches(colours: Float32s, around: NDArray[np.uint64], edges: Int32s) -> TrialSamples:
    """Choose random patches by the `fingerprints` of colours, independently of the order of samples."""
    joined = np.bincount(edges.ravel(), minlength=len(around)) > 0
    connected = np.flatnonzero(joined)
    budget = int(
        np.clip(len(connected) * TRIED_VERTICES["share"], TRIED_VERTICES["least"], TRIED_VERTICES["most"])
    )
    if len(connected) <= _WHOLE_SURFACE * budget:
        return TrialSamples(connected, np.ones(len(connected), bool))
    ranked = _ranked(colours, around, edges, connected) if budget == TRIED_VERTICES["least"] else None
    of_patch = 3 * (_SCORED_RINGS + _RIM_RINGS) ** 2  # each ring has six samples more than the last
    count = max(1, budget // of_patch)
    for _ in range(_MAX_EXTENSIONS):
        middles = np.zeros(len(around), bool)
        if ranked is None:
            middles[connected[np.argpartition(around[connected], count - 1)[:count]]] = True
        else:
            middles[[part[np.argmin(around[part])] for part in np.array_split(ranked, count)]] = True
        patches = _grow_patches(middles, edges)
        if len(patches.samples) >= _SUFFICIENT_SHARE * budget:
            break
        count = min(len(connected), 1 + count * budget // len(patches.samples))
    return patches


def _ranked(colours: Float32s, around: NDArray[np.uint64], edges: Int32s, connected: Int64s) -> Int64s:
    # A few random patches may miss all detail, or contain nothing else. One patch from each part of this order does
    # neither.
    detail = _detail_around(colours, edges)[connected]
    return connected[np.lexsort((around[connected], detail))]


def _grow_patches(middles: Bools, edges: Int32s) -> TrialSamples:
    """Grow patches around some samples, ring by ring."""
    reached, scored = middles.copy(), middles
    low, high = np.ascontiguousarray(edges.T)
    for ring in range(_SCORED_RINGS + _RIM_RINGS):
        leads_out = reached[low] != reached[high]
        reached[low[leads_out]] = True
        reached[high[leads_out]] = True
        if ring == _SCORED_RINGS - 1:
            scored = reached.copy()
    samples = np.flatnonzero(reached)
    return TrialSamples(samples, scored[samples])


def _detail_around(colours: Float32s, edges: Int32s) -> Float64s:
    """Return the variation of colours around each sample, beyond that of noise."""
    from beltrami_cli.flow.vertex_graph import sums_around

    size = np.bincount(edges.ravel(), minlength=len(colours))[:, None] + 1.0
    means = (colours + sums_around(colours.astype(np.float64), edges)) / size
    steps = np.square(means[edges[:, 0]] - means[edges[:, 1]]).sum(axis=1)
    ends = np.concatenate([edges[:, 0], edges[:, 1]])
    detail: Float64s = np.bincount(ends, np.concatenate([steps, steps]), len(colours)).astype(float)[:, None]
    for _ in range(_RINGS_OF_DETAIL):
        detail = (detail + sums_around(detail, edges)) / size
    return detail[:, 0]


def fingerprints(colours: Float32s, edges: Int32s) -> NDArray[np.uint64]:
    """Hash the colours of each sample, its neighbours and their neighbours; uint64, shape (S,)."""
    hashes = np.zeros(len(colours), np.uint64)
    # A sum is invariant to the order of channels and of neighbours.
    for own in _bits(colours):
        hashes += _hashed(own)
    for _ in range(2):
        around = np.zeros_like(hashes)
        for block in large_arrays.blocks(len(edges)):
            for this, other in ((0, 1), (1, 0)):
                np.add.at(around, edges[block, this], hashes[edges[block, other]])
        hashes = _hashed(_hashed(hashes) + around)
    return hashes


def random_signs(colours: Float32s, around: NDArray[np.uint64], count: int) -> Float32s:
    """Return pseudo-random signs that depend only on nearby colours, shape (count, S, N); `count` <= 64."""
    # The choice is then invariant to rotation and to the order of vertices and channels.
    signs: Float32s = large_arrays.empty((count, *colours.shape), np.float32)
    for block in large_arrays.blocks(len(colours)):
        for channel, own in enumerate(_bits(colours[block])):
            bits = _hashed(around[block] + _hashed(own))
            for probe in range(count):
                signs[probe, block, channel] = np.where(bits >> np.uint64(probe) & np.uint64(1), 1, -1)
    return signs


def _bits(colours: Float32s) -> Iterator[NDArray[np.uint64]]:
    """Yield the bits of each channel's colours as integers, shape (S,)."""
    for channel in colours.T:
        yield np.ascontiguousarray(channel).view(np.uint32).astype(np.uint64)


def _hashed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Hash integers to well-mixed ones, modulo 2^64."""
    mixed: NDArray[np.uint64] = values + _MIXERS[0]
    mixed *= _MIXERS[1]
    mixed ^= mixed >> np.uint64(29)
    mixed *= _MIXERS[0]
    mixed ^= mixed >> np.uint64(32)
    return mixed
