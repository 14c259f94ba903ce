"""Collaborative patches after the kernel, and the blend of both.

Where colours repeat themselves along the surface, as in photographs, similar patches can be estimated together
[1]_; where they are plain with sharp edges, the kernel is better. So the kernel's result P serves as the pilot of the
patches' result Q, and

    u = P + w (Q - P),    w = - sum ((P - z) . d + sigma^2 div d) / sum |d|^2,    d = Q - P,

with sums over the samples around: Stein's unbiased estimate of the error of u is a parabola in w, and this is its least
[2]_. The divergence is the response of both to a small random perturbation of the noisy colours z.

Noise that was cut off at 0 or full scale is replaced beforehand by what it would be on average, given the kernel's
result. In the sums, P and Q are replaced by the mean of colours with such noise, which z can be compared with.

References
----------
.. [1] S. Herbreteau, C. Kervrann, "Towards a unified view of unsupervised non-local methods for image denoising: the
   NL-Ridge approach", ICIP 2022. https://arxiv.org/abs/2203.00570
.. [2] S. Ramani, T. Blu, M. Unser, "Monte-Carlo SURE: a black-box optimization of regularization parameters for general
   denoising algorithms", IEEE Trans. Image Processing 17(9), 2008. https://doi.org/10.1109/TIP.2008.2001404
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.corrections.clipping import ClippedChannels, normal_tables
from beltrami_cli.flow.manifolds.blocks import at_same_time, block_rows, for_blocks, in_blocks
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Domain, Mixing
from beltrami_cli.flow.manifolds.manifold import Manifold, relative_variance
from beltrami_cli.flow.mixing import NOISELESS, PERTURBATION, mixing_of, with_pilot
from beltrami_cli.surface import large_arrays


@dataclass(frozen=True)
class _Prior:
    """The prior of the weights of regions: the weight over all samples, from 0 to 1, to a power."""

    power: float
    variance: float  # of w around it


# Regions with small sums are plain, and there means of many samples are at home. Their weights differ between
# regions by a variance of 0.02 to 0.45, as measured on eight textures with noise of 10, 20 and 40 of 255: a prior
# narrower than the least of these would spread over plain textures what patches do for others.
_PRIORS = {"samples": _Prior(1.0, 0.025), "means": _Prior(0.5, 0.02)}

# Shares of samples that are not clipped from which on their means are trusted, and fully. Samples at a limit, as black
# and white are, err to one side only, and the kernel does not err there.
_TRUSTED_WITHIN = (0.64, 0.84)

# How many iterations of the kernel the two steps of an estimate take as long as.
PASSES = (6, 20)


# Noisy colours, a perturbation of unit size, its size, and what it is divided by in the divergence.
_Probed: TypeAlias = tuple[Float32s, Array, np.float32, Float32s]


@dataclass(frozen=True)
class Blend:
    """Colours, the mean weight of the patches, and by how much the mean square error is estimated to fall."""

    colours: Float32s
    share: float
    gain: float


def blend_with_patches_in_place(
    manifold: Manifold,
    noisy: Float32s,
    kernel: Callable[[Float32s], Float32s],
    clipped: ClippedChannels | None,
    stage: Callable[[int], Callable[[int], None] | None],
) -> Blend:
    """Blend the kernel's result with that of patches, in the memory of the noisy colours."""
    geometry, sigma = manifold.geometry, manifold.noise.sigma
    axis, threads = geometry.axis, geometry.threads
    # Chunks leave the colours as they are.
    before = kernel(large_arrays.copy_of(noisy) if manifold.resources.chunking is None else noisy)
    perturbation = manifold.perturbation()
    size = np.float32(PERTURBATION * np.sqrt(np.mean(np.square(sigma))))
    disturbed = large_arrays.copy_of(noisy)
    _add(axis, disturbed, perturbation.get(), size)
    perturbation.drop()
    disturbed = kernel(disturbed)
    manifold.drop_kernels()
    if clipped is not None:
        for_blocks(clipped.impute_in_place, threads, axis, noisy, before, relative_variance(manifold))
    mixing = mixing_of(manifold, before, manifold.noise.covariance)
    second = with_pilot(mixing, manifold)

    def estimate(colours: Float32s, pilot: Float32s) -> Float32s:
        first = manifold.collaborate(colours, pilot, mixing, stage(PASSES[0]))
        for_blocks(lambda own, other: np.divide(own + other, 2, out=own), threads, axis, first, pilot)
        return manifold.collaborate(colours, first, second, stage(PASSES[1]), replaces_pilot=True)

    after = estimate(noisy, before)
    signs = perturbation.get()
    with _added(axis, noisy, signs, size):
        response = estimate(noisy, disturbed)
    # Smoothness counts less or more, as in the choice of parameters.
    counted = np.sqrt(manifold.parameters.strength)
    model = _Model(sigma * np.sqrt(counted), clipped, threads)
    results, responses = (before, after), (disturbed, response)
    probes = noisy, signs, size, _divisors(manifold, size)
    share, gain = _mix_in_place(manifold, model, probes, results, responses)
    del response, responses
    for level in _plain_levels(manifold):
        means = _means(level, manifold, model, probes, results)
        gain += _improve_means_in_place(level, model, second, means, (before, disturbed))
    count = max(1, geometry.kernels)
    return Blend(before, share / count, manifold.noise.square_to_input(gain) / count / len(sigma))


def _mix_in_place(
    manifold: Manifold,
    model: _Model,
    noisy: _Probed,
    results: tuple[Float32s, Float32s],
    responses: tuple[Float32s, Float32s],
) -> tuple[float, float]:
    """Blend the second of both with the first; return the sum of the weights, and that of the gain."""
    from beltrami_cli._native import blend_terms

    colours, signs, _, divisors = noisy
    regions, relative = manifold.regions, relative_variance(manifold)
    stacks = [
        np.moveaxis(stack, manifold.geometry.axis, 0)
        for stack in (colours, signs, relative, *results, *responses)
    ]

    def terms(rows: slice) -> Float32s:
        z, b, variance, *estimates = (stack[:, rows] for stack in stacks)
        own: Float32s = np.empty((2, *z.shape[1:]), np.float32)
        probe: Array = b / divisors
        blend_terms(z, probe, tuple(estimates), (*model.noise, variance), own, 1)
        return own

    def move(rows: slice) -> None:
        weight = regions.enlarged(weights, rows)
        for p, q in (stacks[3:5], stacks[5:]):
            p[:, rows] += weight * (q[:, rows] - p[:, rows])

    sums = regions.gathered(2, terms, stacks[0], model.threads)
    weights, share, gain = _weigh(regions, sums, model.variance * regions.noise, _PRIORS["samples"])
    at_same_time(move, model.threads, ((rows,) for rows in block_rows(stacks[0], regions.side)))
    for stack in (results[0], responses[0]):
        manifold.geometry.refresh(stack)
    return share, gain


def _divisors(manifold: Manifold, size: np.float32) -> Float32s:
    """Return what perturbations of a size are divided by in the divergence, channels first.

    Perturbations like the noise are stronger in channels that have more of it.
    """
    variances = np.square(manifold.noise.sigma)
    if manifold.noise.is_independent:
        variances = np.ones(len(variances))
    power = np.maximum(variances / variances.mean(), NOISELESS**2)
    return np.asarray(size * power, np.float32).reshape(-1, *[1] * (manifold.colours.ndim - 1))


def _plain_levels(manifold: Manifold) -> Iterator[CoarseLevel]:
    """Go through levels, coarse to fine, at which plain colours are estimated better than sample by sample."""
    if manifold.noise.is_shared:  # which they have been estimated for
        return
    levels = manifold.levels(max(manifold.plain_levels))
    yield from (levels[number - 1] for number in manifold.plain_levels if number <= len(levels))


@dataclass(frozen=True)
class _NoisyMeans:
    """Means of noisy colours, of a probe that was added to them, and of the residual of the estimate.

    `within` is the share of samples that are not cut off; the smallest shares count most.
    """

    colours: Float32s
    probe: Float32s
    divisors: Float32s  # of the products of probes and responses
    residual: Float32s
    within: Float32s


def _means(
    level: CoarseLevel,
    manifold: Manifold,
    model: _Model,
    noisy: _Probed,
    results: tuple[Float32s, Float32s],
) -> _NoisyMeans:
    """Take means of noisy colours, and compare them with the first of both results; the second is lost."""
    from beltrami_cli._native import blend_residual, blend_share_within

    axis, relatives = manifold.geometry.axis, relative_variance(manifold)
    (colours, signs, size, divisors), (before, memory) = noisy, results
    means, probe = level.means(colours), size * level.means(signs)

    def cube_share(p: Array, own: Array, relative: Array) -> None:
        blend_share_within(p, (*model.noise, relative), own, 1)
        np.subtract(1, own, out=own)
        own *= np.square(own)

    for_blocks(
        lambda z, p, own, relative: blend_residual(z, p, (*model.noise, relative), own, 1),
        model.threads, axis, colours, before, memory, relatives,
    )  # fmt: skip
    residual = level.means(memory)
    for_blocks(cube_share, model.threads, axis, before, memory, relatives)
    # A cubic mean: a residual found where most is cut off, as on white paper, would bleed into ink, too.
    within = 1 - np.cbrt(level.means(memory))
    return _NoisyMeans(means, probe, size * divisors, residual, within)


def _improve_means_in_place(
    level: CoarseLevel,
    model: _Model,
    mixing: Mixing,
    noisy: _NoisyMeans,
    colours: tuple[Float32s, Float32s],
) -> float:
    """Blend the means of colours with what patches estimate of them; return the estimated gain."""
    # The means of the blend are the pilot as they are: patches without a pilot would bring back noise.
    mixing = dataclasses.replace(mixing, variances=mixing.variances * level.noise)
    (p, near_p), axis, sums = (level.means(own) for own in colours), level.axis, level.planes(2)
    q = level.collaborate(noisy.colours, p, mixing)
    with _added(axis, noisy.colours, noisy.probe, np.float32(1)):
        near_q = level.collaborate(noisy.colours, near_p, mixing)
    differences, others = (q, near_q), (noisy.residual, noisy.probe, noisy.within)
    stacks = in_blocks(axis, *differences, p, near_p, *others, np.expand_dims(level.relative, axis))
    for (d, near_d, b, near_b, residual, probe, within, relative), (own,) in zip(
        stacks, in_blocks(0, sums), strict=True
    ):
        least, enough = _TRUSTED_WITHIN
        trusted = np.clip((within - least) / (enough - least), 0, 1)
        d[:], near_d[:] = trusted * (d - b), trusted * (near_d - near_b)
        own[:] = model.terms(
            residual, probe / noisy.divisors, within * d, within * near_d, within * relative[0]
        )
    weights, _, gain = _weigh(level, sums, model.variance * level.noise, _PRIORS["means"])
    for stack, difference in zip(colours, differences, strict=True):
        for (change,), (weight,) in zip(in_blocks(axis, difference), in_blocks(0, weights), strict=True):
            change *= weight[0]
        level.add_enlarged(stack, difference)
    return gain


class _Model:
    """The noise of channels, as the sums need it."""

    def __init__(self, sigma: Float64s, clipped: ClippedChannels | None, threads: int) -> None:
        self.threads = threads
        self._variances = np.square(sigma, dtype=np.float32)
        self.variance = float(np.mean(np.square(sigma)))
        own = np.zeros((len(sigma), 4), np.float32)
        own[:, 0] = self._variances
        if clipped is not None:
            own[:, 1:] = np.column_stack([clipped.sigma, clipped.low, clipped.high])
        tables = normal_tables()
        self.noise = own, tables.furthest, tables.lost, tables.share  # as the core takes it

    def terms(
        self, residual: Float32s, probe: Array, difference: Float32s, moved: Float32s, relative: Float32s
    ) -> Float32s:
        """Return the terms of w, summed over channels, by the residual and the difference Q - P before and after."""
        variances = self._variances[:, *[None] * (residual.ndim - 1)]
        slope = residual * difference - variances * relative * probe * (moved - difference)
        return np.stack([slope.sum(axis=0), np.square(difference).sum(axis=0)])


def _weigh(
    surface: Domain, sums: Float32s, variance: float, expected: _Prior
) -> tuple[Float32s, float, float]:
    """Find w from its terms; return it with its sum, and the sum of what it takes off the square error."""
    slope, square = surface.total(sums)
    overall = min(1.0, max(0.0, slope / square)) ** expected.power if square > 0 else 0.0
    # The variance of w is sigma^2 over the sum of squares; a mean by a Gaussian stands for this many samples.
    prior = np.float32(variance / (4 * np.pi * surface.width**2) / expected.variance)
    means = surface.spread(sums)
    for own, terms in in_blocks(0, means, sums):
        own[0] = np.clip((own[0] + prior * overall) / (own[1] + prior), 0, 1)
        own[1] = own[0] * (2 * terms[0] - own[0] * terms[1])
    share, gain = surface.total(means)
    return means[:1], float(share), float(gain)


@contextlib.contextmanager
def _added(axis: int, stack: Float32s, signs: Array, size: np.float32) -> Iterator[None]:
    """Have multiples of the signs in a stack within this context."""
    _add(axis, stack, signs, size)
    yield
    _add(axis, stack, signs, -size)


def _add(axis: int, stack: Float32s, signs: Array, size: np.float32) -> None:
    for own, sign in in_blocks(axis, stack, signs):
        own += np.multiply(sign, size, dtype=np.float32)
