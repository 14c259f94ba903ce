"""Collaborative patches after the kernel, and the blend of both.

Where colours repeat themselves along the surface, as in photographs, similar patches can be estimated together
[1]_; where they are plain with sharp edges, the kernel is better. So the kernel's result P serves as the pilot of the
patches' result Q, and

    u = P + w (Q - P),    w = - sum ((P - z) . d + sigma^2 div d) / sum |d|^2,    d = Q - P,

with sums over the samples around: Stein's unbiased estimate of the error of u is a parabola in w, and this is its least
[2]_. The divergence is the response of both to a small random perturbation of the noisy colours z.

Noise that was clipped at 0 or full scale is replaced beforehand by its mean without clipping, given the kernel's
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

import numpy as np

from beltrami_cli._native import blend_residual, blend_share_within, blend_terms
from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.corrections.clipping import ClippedChannels, normal_tables
from beltrami_cli.flow.manifolds.blocks import block_rows, for_blocks, in_blocks, in_parallel
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Domain, Stack
from beltrami_cli.flow.manifolds.iteration import Averaged
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.mixing import NOISELESS, PERTURBATION, Mixing
from beltrami_cli.surface import large_arrays


@dataclass(frozen=True)
class _Prior:
    """Prior of the weights of regions. Its mean is the weight over all samples, in [0, 1], raised to a power."""

    power: float
    variance: float  # of the weights around the mean


# Regions with small sums are plain, where means of many samples are better than patches. The variance of the weights
# between regions was 0.02 to 0.45 on eight textures with noise of 10, 20 and 40 of 255. A prior narrower than that
# would carry the weight of patterned regions over to plain ones.
_PRIORS = {"samples": _Prior(1.0, 0.025), "means": _Prior(0.5, 0.02)}

# Shares of unclipped samples from which on a mean is trusted at all, and fully. Errors of samples at a limit (black,
# white) have one sign, and the kernel does not make them.
_TRUSTED_WITHIN = (0.64, 0.84)

# Duration of both patch estimates, in iterations of the kernel, for progress.
PASSES = (6, 20)


@dataclass(frozen=True)
class Blend:
    """The blended colours, the mean weight of patches, and the estimated reduction of the mean square error."""

    averaged: Averaged
    share: float
    gain: float


@dataclass(frozen=True)
class _Probed:
    """Noisy colours z and their perturbation, `size` times signs or noise of unit variance.

    The divergence of a result is its response times the perturbation, divided by `divisors`.
    """

    colours: Stack
    signs: Array
    size: np.float32
    divisors: Float32s

    @classmethod
    def of(cls, manifold: Manifold, signs: Array, size: np.float32) -> _Probed:
        variances = np.square(manifold.noise.sigma)
        if manifold.noise.is_independent:
            variances = np.ones(len(variances))
        # Correlated perturbations are larger in channels with more noise.
        power = np.maximum(variances / variances.mean(), NOISELESS**2)
        divisors = np.asarray(size * power, np.float32).reshape(-1, *[1] * (manifold.colours.ndim - 1))
        return cls(manifold.colours, signs, size, divisors)


def blend_with_patches_in_place(
    manifold: Manifold,
    kernel: Callable[[Stack], Averaged],
    clipped: ClippedChannels | None,
    stage: Callable[[int], Callable[[int], None] | None],
) -> Blend:
    """Blend the results of the kernel and of patches; they overwrite the colours of the manifold."""
    noisy, geometry, sigma = manifold.colours, manifold.geometry, manifold.noise.sigma
    axis, threads = geometry.axis, geometry.threads
    # Chunked kernels do not overwrite the colours.
    before = kernel(large_arrays.copy_of(noisy) if manifold.resources.chunking is None else noisy).stacks[0]
    perturbation = manifold.perturbation()
    size = np.float32(PERTURBATION * np.sqrt(np.mean(np.square(sigma))))
    perturbed = large_arrays.copy_of(noisy)
    _add(axis, perturbed, perturbation.get(), size)
    perturbation.drop()
    averaged = kernel(perturbed)
    perturbed = averaged.stacks[0]
    manifold.drop_kernels()
    if clipped is not None:
        for_blocks(clipped.impute_in_place, threads, axis, noisy, before, manifold.relative_variance)
    mixing = Mixing.of(geometry.steps(before), manifold.noise.covariance)
    with_pilot = mixing.with_pilot(manifold.parameters.strength, is_shared=manifold.noise.is_shared)

    def estimate(pilot: Stack) -> Stack:
        first = manifold.collaborate(noisy, pilot, mixing, stage(PASSES[0]))
        for_blocks(lambda mean, other: np.divide(mean + other, 2, out=mean), threads, axis, first, pilot)
        return manifold.collaborate(noisy, first, with_pilot, stage(PASSES[1]), replaces_pilot=True)

    after = estimate(before)
    probed = _Probed.of(manifold, perturbation.get(), size)
    with _perturbed(axis, noisy, probed.signs, size):
        response = estimate(perturbed)
    # The strength scales the weight of smoothness, as in the choice of parameters.
    model = _NoiseTerms(sigma * np.sqrt(np.sqrt(manifold.parameters.strength)), clipped, threads)
    results = before, after
    share, gain = _mix_in_place(manifold, model, probed, results, (perturbed, response))
    del response
    for level in _plain_levels(manifold):
        means = _noisy_means(level, manifold, model, probed, results)
        gain += _improve_means_in_place(level, model, with_pilot, means, (before, perturbed))
    count = max(1, geometry.kernels)
    return Blend(
        dataclasses.replace(averaged, stacks=[before]), share / count,
        manifold.noise.square_to_input(gain) / count / len(sigma),
    )  # fmt: skip


def _mix_in_place(
    manifold: Manifold,
    model: _NoiseTerms,
    noisy: _Probed,
    results: tuple[Stack, Stack],
    responses: tuple[Stack, Stack],
) -> tuple[float, float]:
    """Blend the second result into the first; return the sum of the weights and of the gain."""
    regions, relative = manifold.regions, manifold.relative_variance
    stacks = [
        np.moveaxis(stack, manifold.geometry.axis, 0)
        for stack in (noisy.colours, noisy.signs, relative, *results, *responses)
    ]

    def terms(rows: slice) -> Float32s:
        z, signs, variance, *estimates = (stack[:, rows] for stack in stacks)
        sums: Float32s = np.empty((2, *z.shape[1:]), np.float32)
        probe: Array = signs / noisy.divisors
        blend_terms(z, probe, tuple(estimates), (*model.noise, variance), sums, 1)
        return sums

    def move(rows: slice) -> None:
        weight = regions.enlarged(weights, rows)
        for p, q in (stacks[3:5], stacks[5:]):
            p[:, rows] += weight * (q[:, rows] - p[:, rows])

    sums = regions.gathered(2, terms, stacks[0], model.threads)
    weights, share, gain = _weigh(regions, sums, model.variance * regions.noise, _PRIORS["samples"])
    in_parallel(move, model.threads, ((rows,) for rows in block_rows(stacks[0], regions.side)))
    for stack in (results[0], responses[0]):
        manifold.geometry.refresh(stack)
    return share, gain


def _plain_levels(manifold: Manifold) -> Iterator[CoarseLevel]:
    """Yield the levels, coarse to fine, on which means of plain colours are estimated."""
    if manifold.noise.is_shared:  # coarse levels have been estimated already
        return
    levels = manifold.levels(max(manifold.plain_levels))
    yield from (levels[number - 1] for number in manifold.plain_levels if number <= len(levels))


@dataclass(frozen=True)
class _NoisyMeans:
    """Means of the noisy colours, of the probe added to them, and of the residual of the estimate.

    `within` is the share of unclipped samples, a mean that emphasises small shares.
    """

    colours: Stack
    probe: Float32s
    divisors: Float32s  # see `_Probed`
    residual: Float32s
    within: Float32s


def _noisy_means(
    level: CoarseLevel, manifold: Manifold, model: _NoiseTerms, noisy: _Probed, results: tuple[Stack, Stack]
) -> _NoisyMeans:
    """Compute the means of noisy colours and their residual to the first result; the second result is overwritten."""
    axis, relatives, (before, memory) = manifold.geometry.axis, manifold.relative_variance, results
    means, probe = level.means(noisy.colours), noisy.size * level.means(noisy.signs)

    def cube_share(p: Array, shares: Array, relative: Array) -> None:
        blend_share_within(p, (*model.noise, relative), shares, 1)
        np.subtract(1, shares, out=shares)
        shares *= np.square(shares)

    for_blocks(
        lambda z, p, residual, relative: blend_residual(z, p, (*model.noise, relative), residual, 1),
        model.threads, axis, noisy.colours, before, memory, relatives,
    )  # fmt: skip
    residual = level.means(memory)
    for_blocks(cube_share, model.threads, axis, before, memory, relatives)
    # A cubic mean: a residual found where most is clipped, as on white paper, would bleed into ink, too.
    within = 1 - np.cbrt(level.means(memory))
    return _NoisyMeans(means, probe, noisy.size * noisy.divisors, residual, within)


def _improve_means_in_place(
    level: CoarseLevel, model: _NoiseTerms, mixing: Mixing, noisy: _NoisyMeans, colours: tuple[Stack, Stack]
) -> float:
    """Blend the means of colours, and of perturbed ones, with their estimates by patches; return the estimated gain."""
    # The means of the blend are used as the pilot directly: a first estimate without a pilot would bring back noise.
    mixing = dataclasses.replace(mixing, variances=mixing.variances * level.noise)
    (p, p_perturbed), axis, sums = (level.means(stack) for stack in colours), level.axis, level.planes(2)
    difference = level.collaborate(noisy.colours, p, mixing)
    with _perturbed(axis, noisy.colours, noisy.probe, np.float32(1)):
        moved = level.collaborate(noisy.colours, p_perturbed, mixing)
    stacks = in_blocks(
        axis, difference, moved, p, p_perturbed, noisy.residual, noisy.probe, noisy.within,
        np.expand_dims(level.relative, axis),
    )  # fmt: skip
    for (d, d_perturbed, a, a_perturbed, residual, probe, within, relative), (terms,) in zip(
        stacks, in_blocks(0, sums), strict=True
    ):
        least, enough = _TRUSTED_WITHIN
        trusted = np.clip((within - least) / (enough - least), 0, 1)
        d[:], d_perturbed[:] = trusted * (d - a), trusted * (d_perturbed - a_perturbed)
        terms[:] = model.terms(
            residual, probe / noisy.divisors, within * d, within * d_perturbed, within * relative[0]
        )
    weights, _, gain = _weigh(level, sums, model.variance * level.noise, _PRIORS["means"])
    for stack, changes in zip(colours, (difference, moved), strict=True):
        for (change,), (weight,) in zip(in_blocks(axis, changes), in_blocks(0, weights), strict=True):
            change *= weight[0]
        level.add_enlarged(stack, changes)
    return gain


class _NoiseTerms:
    """Noise of the channels in the form that the sums take."""

    def __init__(self, sigma: Float64s, clipped: ClippedChannels | None, threads: int) -> None:
        self.threads = threads
        self._variances = np.square(sigma, dtype=np.float32)
        self.variance = float(np.mean(np.square(sigma)))
        channels = np.zeros((len(sigma), 4), np.float32)
        channels[:, 0] = self._variances
        if clipped is not None:
            channels[:, 1:] = np.column_stack([clipped.sigma, clipped.low, clipped.high])
        tables = normal_tables()
        self.noise = channels, tables.furthest, tables.lost, tables.share  # in the layout of the core

    def terms(
        self, residual: Float32s, probe: Array, difference: Float32s, moved: Float32s, relative: Float32s
    ) -> Float32s:
        """Return the terms of w, summed over channels; `difference`, `moved`: Q - P without and with perturbation."""
        variances = self._variances[:, *[None] * (residual.ndim - 1)]
        slope = residual * difference - variances * relative * probe * (moved - difference)
        return np.stack([slope.sum(axis=0), np.square(difference).sum(axis=0)])


def _weigh(
    surface: Domain, sums: Float32s, variance: float, expected: _Prior
) -> tuple[Float32s, float, float]:
    """Solve for w from its terms; return w, its sum, and the sum of the reduction of the squared error."""
    slope, square = surface.total(sums)
    overall = min(1.0, max(0.0, slope / square)) ** expected.power if square > 0 else 0.0
    # The variance of w is sigma^2 over the sum of squares; a mean by a Gaussian stands for this many samples.
    prior = np.float32(variance / (4 * np.pi * surface.width**2) / expected.variance)
    means = surface.spread(sums)
    for mean, terms in in_blocks(0, means, sums):
        weight = np.clip((mean[0] + prior * overall) / (mean[1] + prior), 0, 1)
        mean[0], mean[1] = weight, weight * (2 * terms[0] - weight * terms[1])
    share, gain = surface.total(means)
    return means[:1], float(share), float(gain)


@contextlib.contextmanager
def _perturbed(axis: int, stack: Float32s, signs: Array, size: np.float32) -> Iterator[None]:
    """Add a multiple of the signs to a stack within this context."""
    _add(axis, stack, signs, size)
    yield
    _add(axis, stack, signs, -size)


def _add(axis: int, stack: Float32s, signs: Array, size: np.float32) -> None:
    for block, sign in in_blocks(axis, stack, signs):
        block += np.multiply(sign, size, dtype=np.float32)
