"""The error of smoothed colours against the noise-free colours, estimated without knowing these, and where it is.

Stein's unbiased risk estimate: for y = x + noise of variance sigma^2, and any smooth map f,

    E |f(y) - x|^2 = E |f(y) - y|^2 - sigma^2 + 2 sigma^2 div f(y)        (mean over samples)

and the divergence is the response to a small random perturbation, div f(y) = E b . (f(y + eps b) - f(y)) / eps with
independent signs b [1]_. Where samples and channels share noise, of covariance C, sigma^2 div f is the trace of C times
the derivative of f, which is the same mean with perturbations b of covariance C.

It is estimated on a part of the samples: some blocks of a canvas, or patches of a mesh, with a rim around each.

References
----------
.. [1] S. Ramani, T. Blu, M. Unser, "Monte-Carlo SURE: a black-box optimization of regularization parameters for general
   denoising algorithms", IEEE Trans. Image Processing 17(9), 2008, eqs. (4) and (13).
   https://doi.org/10.1109/TIP.2008.2001404
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.flow.clipping import variance_of_clipped
from beltrami_cli.flow.manifold import SampleTrial, Step
from beltrami_cli.flow.noise.model import NoiseModel, VarianceStabiliser, draw_model
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED, ROWS, Atlas, Indices, refresh_halo
from beltrami_cli.surface.records import limits_of

# The perturbation, in units of the noise: far above the rounding of float32. Distances on meshes have kinks where their
# paths change, so a smaller one sees a derivative that varies from sample to sample, and a larger one changes the
# kernels: on painted and photographed samples, half or twice as much chooses worse.
PERTURBATION = 0.3

# With few samples one perturbation is too uncertain: samples, or else perturbations, that are enough.
_ENOUGH_SAMPLES, _MOST_PROBES = 5_000, 4

# The share of samples at a limit is averaged by a Gaussian on the surface: the time steps of its iterations.
_MARK_TIMES = (2.4, 2.4)

# Parts of the sample, whose estimates are compared for the standard error of their mean.
_PARTS = 16

# Cells on which parameters are tried, as a share of all, so that trying takes no longer than smoothing: some sixty
# iterations are tried, each twice. With twice as many, the default results on thirteen textures with noise of 20 of 255
# differ by 0.00 dB on average, and by 0.09 dB at most.
# With twice the most the risk is known to a tenth of a dB or better.
_TRIED_CELLS = {"share": 1 / 50, "least": 20_000, "most": 50_000}

# Cells a side of the core of a block, whose result counts.
_CORE_SIDE = 64

# Iterations spread errors from a block's border inwards; most of a kernel's weight lies within this many cells.
_RIM_CELLS = 8

# Any seed is as good; a fixed one makes the choice reproducible.
_SEED = 20

# Samples to try parameters on, as a share of all, so that trying takes hardly longer than smoothing: some sixty
# iterations are tried, each two or three times. Fewer than the least are too uncertain; these take tenths of a second.
# More than the most do not improve the choice.
TRIED_VERTICES = {"share": 1 / 20, "least": 6_000, "most": 40_000}

# Up to this many times the samples to try on, patches with their rims would cover nearly the whole surface.
_WHOLE = 1.2

# Rings of a patch that are scored, and rings around these that only supply colours.
_SCORED_RINGS, _RIM_RINGS = 7, 3

# Patches end early on small components, and overlap: the share of the wanted samples that suffices, and how often more
# patches are added to reach it.
_ENOUGH, _ROUNDS = 0.75, 3

# Rings over which detail is averaged to rank patches.
_RINGS_OF_DETAIL = 5

# Odd numbers with their bits well mixed, to hash with, as in SplitMix64.
_MIXERS = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9], np.uint64)


@dataclass(frozen=True)
class Risk:
    """An estimate of a mean square error over samples and channels."""

    value: float  # in squared units of colour; estimates of small errors may be below 0
    error: float  # standard error of `value`, from the differences between parts of the sample
    divergence: float  # the share of the divergence in `value`

    def weighted(self, weight: float) -> float:
        """Return `value` with another weight for the divergence: a larger one asks for smoother results."""
        return self.value + (weight - 1) * self.divergence


@dataclass(frozen=True)
class State:
    """Colours after some iterations, and the perturbed colours after them, for each stack of signs."""

    plain: Float32s
    perturbed: tuple[Float32s, ...]


@dataclass(frozen=True, eq=False)
class RiskEstimate:
    """Monte Carlo SURE on a trial."""

    trial: SampleTrial
    noisy: Float32s  # the colours that count, shape (S, N)
    variance: Float64s  # of their noise
    counts: Float32s | float  # factors of squared errors: these count as they are in the colours as given
    weights: tuple[Float64s, ...]  # turn the responses to each stack of signs into the divergence
    size: np.float32  # of the perturbation

    @classmethod
    def on(
        cls, trial: SampleTrial, sigma: Float64s, stabiliser: VarianceStabiliser | None = None
    ) -> RiskEstimate:
        """Prepare the estimate for noise of standard deviation `sigma` by channel, shape (N,)."""
        noisy, size = trial.scored(trial.start), PERTURBATION * float(np.sqrt(np.square(sigma).mean()))
        variance = np.square(sigma) * _unclipped_variance(trial, noisy) * trial.relative
        counts = 1.0 if stabiliser is None else np.square(stabiliser.slopes(noisy.T)).T
        signs = [trial.scored(drawn) for drawn in trial.signs]
        # 1 for signs; perturbations like the noise have its size, channel by channel, and so need no weights.
        power = np.mean([np.mean(np.square(drawn), axis=0) for drawn in signs], axis=0)
        weight = 2 * variance * counts / np.maximum(power, np.finfo(float).tiny)
        weights = tuple(weight / (len(signs) * size) * drawn for drawn in signs)
        return cls(trial, noisy, variance, counts, weights, np.float32(size))

    @property
    def noise(self) -> float:
        """The mean variance of the noise."""
        return float(np.mean(np.broadcast_to(self.variance, self.noisy.shape) * self.counts))

    @property
    def start(self) -> State:
        start = self.trial.start
        return State(start, tuple(start + self.size * signs for signs in self.trial.signs))

    def step(self, state: State, step: Step) -> State:
        perturbed = tuple(self.trial.step(colours, step) for colours in state.perturbed)
        return State(self.trial.step(state.plain, step), perturbed)

    def of(self, state: State) -> Risk:
        smoothed = self.trial.scored(state.plain).astype(np.float64)
        divergence = np.zeros_like(smoothed)
        for weights, colours in zip(self.weights, state.perturbed, strict=True):
            divergence += weights * (self.trial.scored(colours) - smoothed)
        misfit = (np.square(smoothed - self.noisy) - self.variance) * self.counts
        # A mean along so short an axis takes three times as long.
        each = np.einsum("sn->s", misfit + divergence) / misfit.shape[1]
        parts = np.array([part.mean() for part in np.array_split(each, _PARTS) if len(part)])
        error = float(parts.std(ddof=1) / np.sqrt(len(parts))) if len(parts) > 1 else float("inf")
        return Risk(float(each.mean()), error, float(divergence.mean()))


def _unclipped_variance(trial: SampleTrial, noisy: Float32s) -> Float64s | float:
    """Return which part of the noise's variance was not cut off at 0 and full scale, sample by sample."""
    # There y is the value that the estimate takes for y: x plus the mean of clipped noise, to which averages tend until
    # they are restored.
    remaining: Float64s | float = 1.0
    low, high = limits_of(noisy)
    for beyond, is_reached in (
        (trial.start <= low, (noisy == low).any()),
        (trial.start >= high, (noisy == high).any()),
    ):
        if is_reached:
            marks = beyond.astype(np.float32)
            for t in _MARK_TIMES:
                marks = trial.step(marks, Step(0.0, t, regularised=False))
            remaining = remaining * variance_of_clipped(trial.scored(marks).astype(np.float64))
    return remaining


def wanted_probes(samples: int) -> int:
    """Return how many stacks of signs are needed to estimate the divergence on this many samples."""
    return min(_MOST_PROBES, -(-_ENOUGH_SAMPLES // max(1, samples)))


def tried_cells(atlas: Atlas) -> int:
    """Return on how many cells parameters are tried; all, if there are not more."""
    return int(
        np.clip(len(atlas.owned_cells) * _TRIED_CELLS["share"], _TRIED_CELLS["least"], _TRIED_CELLS["most"])
    )


def choose_blocks(atlas: Atlas, budget: int, reach: int) -> tuple[Int64s, Bools]:
    """Choose evenly spread blocks; return their cells and which are in a core, shape (blocks * side, side)."""
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
    # What lies beyond the canvas has the flat index of its last cell, in the margin.
    cells = np.where(on, row * columns + column, atlas.kind.size - 1).reshape(-1, len(side))
    inside = (side >= 0) & (side < _CORE_SIDE)
    core = np.tile(inside[:, None] & inside, (len(chosen), 1))
    return cells.astype(np.int64), core


def with_halo(part: Atlas, whole: Atlas, cells: Int64s, core: Bools) -> Atlas:
    """Return the atlas of some cells of another, with the halo cells whose owned cells are included."""
    # A cell that is in several blocks is taken from the one whose core it is, and not from another's rim.
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
    """Find where numbers are in an ascending list, the first of equal ones; -1: nowhere."""
    if not len(ascending):
        return np.full(wanted.shape, -1, np.int64)
    rank = np.minimum(np.searchsorted(ascending, wanted), len(ascending) - 1)
    return np.where(ascending[rank] == wanted, rank, -1)


def perturbations(count: int, atlas: Atlas, noise: NoiseModel) -> list[Array]:
    """Return stacks of random planes like the noise: independent signs in bytes, or correlated as the noise is."""
    random, shape = np.random.default_rng(_SEED), atlas.kind.shape
    if noise.is_independent:
        drawn = [*large_arrays.random_signs((count, len(noise.sigma), *shape), random)]
    else:
        size = np.float32(np.sqrt(np.mean(np.square(noise.sigma))))
        drawn = [draw_model(noise.covariances, shape, random) for _ in range(count)]
    for planes in drawn:
        for rows in large_arrays.blocks(len(atlas.kind), ROWS):
            if not noise.is_independent:
                planes[:, rows] /= size
            planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
        refresh_halo(planes, atlas)
    return drawn


@dataclass(frozen=True)
class TrialSamples:
    """Samples to try parameters on: ascending indices, shape (P,), and which of them are scored."""

    samples: Int64s
    scored: Bools


def choose_patches(colours: Float32s, around: NDArray[np.uint64], edges: Int32s) -> TrialSamples:
    """Choose patches spread at random, by the `fingerprints` of colours and not by the order of samples."""
    joined = np.bincount(edges.ravel(), minlength=len(around)) > 0
    connected = np.flatnonzero(joined)
    budget = int(
        np.clip(len(connected) * TRIED_VERTICES["share"], TRIED_VERTICES["least"], TRIED_VERTICES["most"])
    )
    if len(connected) <= _WHOLE * budget:
        return TrialSamples(connected, np.ones(len(connected), bool))
    ranked = _ranked(colours, around, edges, connected) if budget == TRIED_VERTICES["least"] else None
    of_patch = 3 * (_SCORED_RINGS + _RIM_RINGS) ** 2  # each ring has six samples more than the last
    count = max(1, budget // of_patch)
    for _ in range(_ROUNDS):
        middles = np.zeros(len(around), bool)
        if ranked is None:
            middles[connected[np.argpartition(around[connected], count - 1)[:count]]] = True
        else:
            middles[[part[np.argmin(around[part])] for part in np.array_split(ranked, count)]] = True
        patches = _grown(middles, edges)
        if len(patches.samples) >= _ENOUGH * budget:
            break
        count = min(len(connected), 1 + count * budget // len(patches.samples))
    return patches


def _ranked(colours: Float32s, around: NDArray[np.uint64], edges: Int32s, connected: Int64s) -> Int64s:
    # A few patches at random may miss all detail, or hold nothing else; one from each part of this order does neither.
    detail = _detail_around(colours, edges)[connected]
    return connected[np.lexsort((around[connected], detail))]


def _grown(middles: Bools, edges: Int32s) -> TrialSamples:
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
    """Return how uneven colours are around each sample, beyond what noise makes of them."""
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
    """Hash each sample's colours with its neighbours' and their neighbours' colours; uint64, shape (S,)."""
    hashes = np.zeros(len(colours), np.uint64)
    # A sum does not depend on the order of channels, nor on that of neighbours.
    for own in _bits(colours):
        hashes += _mixed(own)
    for _ in range(2):
        around = np.zeros_like(hashes)
        for block in large_arrays.blocks(len(edges)):
            for this, other in ((0, 1), (1, 0)):
                np.add.at(around, edges[block, this], hashes[edges[block, other]])
        hashes = _mixed(_mixed(hashes) + around)
    return hashes


def random_signs(colours: Float32s, around: NDArray[np.uint64], count: int) -> Float32s:
    """Return signs, shape (count, S, N), that look random but depend only on nearby colours; `count` <= 64."""
    # So the choice is the same for a mesh that was rotated, or whose vertices or channels come in another order.
    signs: Float32s = large_arrays.empty((count, *colours.shape), np.float32)
    for block in large_arrays.blocks(len(colours)):
        for channel, own in enumerate(_bits(colours[block])):
            bits = _mixed(around[block] + _mixed(own))
            for probe in range(count):
                signs[probe, block, channel] = np.where(bits >> np.uint64(probe) & np.uint64(1), 1, -1)
    return signs


def _bits(colours: Float32s) -> Iterator[NDArray[np.uint64]]:
    """Give the bits of each channel's colours as numbers, shape (S,)."""
    for channel in colours.T:
        yield np.ascontiguousarray(channel).view(np.uint32).astype(np.uint64)


def _mixed(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread the bits of numbers over all bits, modulo 2^64."""
    mixed: NDArray[np.uint64] = values + _MIXERS[0]
    mixed *= _MIXERS[1]
    mixed ^= mixed >> np.uint64(29)
    mixed *= _MIXERS[0]
    mixed ^= mixed >> np.uint64(32)
    return mixed
