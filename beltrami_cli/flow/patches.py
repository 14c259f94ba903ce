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
from typing import NamedTuple

import numpy as np

from beltrami_cli._native import blend_residual, blend_share_within, blend_terms
from beltrami_cli.arrays import Array, Float32s, Float64s
from beltrami_cli.flow.corrections.clipping import ClippedChannels
from beltrami_cli.flow.corrections.normal_tables import normal_tables
from beltrami_cli.flow.manifolds.blocks import block_rows, for_blocks, in_blocks, in_parallel
from beltrami_cli.flow.manifolds.domain import CoarseLevel, Domain
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.manifolds.iteration import Averaged
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.mixing import NOISELESS, PATCH_PERTURBATION, Mixing
from beltrami_cli.surface import large_arrays


class _Prior(NamedTuple):
    """Prior of the weights of regions. Its mean is the weight over all samples, in [0, 1], raised to a power."""

    power: float
    variance: float  # of the weights around the mean


# Regions with small sums are plain, where means of many samples are better than patches. The variance of the weights
# between regions was 0.02 to 0.45 on eight textures with noise of 10, 20 and 40 of 255. A prior narrower than that
# would carry the weight of patterned regions over to plain ones.
_PRIOR_OF_SAMPLES, _PRIOR_OF_MEANS = _Prior(1.0, 0.025), _Prior(0.5, 0.02)

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


class _Pair(NamedTuple):
    """The result of the noisy colours, and that of the perturbed ones."""

    plain: Stack
    perturbed: Stack


@dataclass(frozen=True)
class _Probed:
    """Noisy colours z and their perturbation, `size` times signs or noise of unit variance.

    The divergence of a result is its response times the signs, divided by `divisors`.
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

    def means(self, level: CoarseLevel) -> _Probed:
        colours, perturbation = level.means(self.colours), self.size * level.means(self.signs)
        return _Probed(colours, perturbation, np.float32(1), self.size * self.divisors)

    @contextlib.contextmanager
    def perturbed(self, axis: int) -> Iterator[None]:
        """Add the perturbation to the colours within this context."""
        _add(axis, self.colours, self.signs, self.size)
        yield
        _add(axis, self.colours, self.signs, -self.size)


def blend_with_patches_in_place(
    manifold: Manifold,
    kernel: Callable[[Stack], Averaged],
    clipped: ClippedChannels | None,
    stage: Callable[[int], Callable[[int], None] | None],
) -> Blend:
    """Blend the results of the kernel and of patches; they overwrite the colours of the manifold."""
    noisy, geometry, sigma = manifold.colours, manifold.geometry, manifold.noise.sigma
    axis, threads, strength = geometry.axis, geometry.threads, manifold.parameters.strength
    # Chunked kernels do not overwrite the colours.
    before = kernel(large_arrays.copy_of(noisy) if manifold.chunking is None else noisy).stacks[0]
    perturbation = manifold.perturbation()
    size = np.float32(PATCH_PERTURBATION * manifold.noise.rms_sigma)
    perturbed = large_arrays.copy_of(noisy)
    _add(axis, perturbed, perturbation.get(), size)
    perturbation.drop()
    averaged = kernel(perturbed)
    perturbed = averaged.stacks[0]
    manifold.drop_kernels()
    if clipped is not None:
        for_blocks(clipped.impute_in_place, threads, axis, noisy, before, manifold.relative_variance)
    mixing = Mixing.of(geometry.steps(before), manifold.noise.covariance)
    with_pilot = mixing.with_pilot(strength, is_shared=manifold.noise.is_shared)

    def estimate(pilot: Stack) -> Stack:
        first = manifold.collaborate(noisy, pilot, mixing, stage(PASSES[0]))
        for_blocks(lambda mean, other: np.divide(mean + other, 2, out=mean), threads, axis, first, pilot)
        return manifold.collaborate(noisy, first, with_pilot, stage(PASSES[1]), replaces_pilot=True)

    after = estimate(before)
    probed = _Probed.of(manifold, perturbation.get(), size)
    with probed.perturbed(axis):
        response = estimate(perturbed)
    results = _Pair(before, perturbed)
    # The strength scales the weight of smoothness, as in the choice of parameters.
    noise = _NoiseTerms(sigma * np.sqrt(np.sqrt(strength)), clipped)
    share, gain = _blend_samples_in_place(manifold, noise, probed, results, _Pair(after, response))
    del response
    for level in _plain_levels(manifold):
        means = _NoisyMeans.of(level, manifold, noise, probed, before, scratch=after)
        gain += _blend_means_in_place(level, noise, with_pilot, means, results)
    count = max(1, geometry.kernels)
    return Blend(
        dataclasses.replace(averaged, stacks=[before]), share / count,
        manifold.noise.square_to_input(gain) / count / len(sigma),
    )  # fmt: skip


def _blend_samples_in_place(
    manifold: Manifold, noise: _NoiseTerms, noisy: _Probed, kernel: _Pair, patches: _Pair
) -> tuple[float, float]:
    """Blend the patches' results into the kernel's; return the sum of the weights and of the gain."""
    regions, threads = manifold.regions, manifold.geometry.threads
    z, signs, relative, p, p_perturbed, q, q_perturbed = (
        np.moveaxis(stack, manifold.geometry.axis, 0)
        for stack in (noisy.colours, noisy.signs, manifold.relative_variance, *kernel, *patches)
    )

    def terms(rows: slice) -> Float32s:
        sums: Float32s = np.empty((2, *z[0, rows].shape), np.float32)
        estimates = tuple(stack[:, rows] for stack in (p, q, p_perturbed, q_perturbed))
        probe: Array = signs[:, rows] / noisy.divisors
        blend_terms(z[:, rows], probe, estimates, (*noise.for_core, relative[:, rows]), sums, 1)
        return sums

    def move(rows: slice) -> None:
        weight = regions.enlarged(weights, rows)
        for of_kernel, of_patches in ((p, q), (p_perturbed, q_perturbed)):
            of_kernel[:, rows] += weight * (of_patches[:, rows] - of_kernel[:, rows])

    sums = regions.gathered(2, terms, z, threads)
    weights, share, gain = _weigh(regions, sums, noise.variance, _PRIOR_OF_SAMPLES)
    in_parallel(move, threads, ((rows,) for rows in block_rows(z, regions.side)))
    for stack in kernel:
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
    """Means of the noisy colours and of their residual, and a mean of the shares of unclipped samples."""

    probed: _Probed
    residual: Float32s
    within: Float32s  # emphasises small shares

    @classmethod
    def of(
        cls, level: CoarseLevel, manifold: Manifold, noise: _NoiseTerms, noisy: _Probed, result: Stack, *,
        scratch: Stack,
    ) -> _NoisyMeans:  # fmt: skip
        """Average over a level; the residual is that of a result. `scratch` is overwritten."""
        geometry, relatives = manifold.geometry, manifold.relative_variance

        def cube_share(p: Array, shares: Array, relative: Array) -> None:
            blend_share_within(p, (*noise.for_core, relative), shares, 1)
            np.subtract(1, shares, out=shares)
            shares *= np.square(shares)

        for_blocks(
            lambda z, p, residual, relative: blend_residual(z, p, (*noise.for_core, relative), residual, 1),
            geometry.threads, geometry.axis, noisy.colours, result, scratch, relatives,
        )  # fmt: skip
        residual = level.means(scratch)
        for_blocks(cube_share, geometry.threads, geometry.axis, result, scratch, relatives)
        # A cubic mean: a residual found where most is clipped, as on white paper, would bleed into ink, too.
        return cls(noisy.means(level), residual, 1 - np.cbrt(level.means(scratch)))


def _blend_means_in_place(
    level: CoarseLevel, noise: _NoiseTerms, mixing: Mixing, means: _NoisyMeans, results: _Pair
) -> float:
    """Blend the means of results with their estimates by patches; return the estimated gain."""
    # The means of the blend are used as the pilot directly: a first estimate without a pilot would bring back noise.
    mixing = dataclasses.replace(mixing, variances=mixing.variances * level.noise)
    noisy, axis, (least, enough) = means.probed, level.axis, _TRUSTED_WITHIN
    sums = np.empty((2, *level.shape), np.float32)
    pilots = _Pair(*(level.means(stack) for stack in results))
    change = level.collaborate(noisy.colours, pilots.plain, mixing)
    with noisy.perturbed(axis):
        perturbed_change = level.collaborate(noisy.colours, pilots.perturbed, mixing)

    def subtract_and_trust(q: Array, p: Array, within: Array) -> None:
        """Turn an estimate by patches into a change, which is less where many samples are clipped."""
        q[:] = np.clip((within - least) / (enough - least), 0, 1) * (q - p)

    def write_terms(
        q: Array, q_perturbed: Array, residual: Array, signs: Array, within: Array, relative: Array, terms: Array
    ) -> None:  # fmt: skip
        terms[:] = noise.terms(
            residual, signs / noisy.divisors, within * q, within * q_perturbed, within * relative
        )

    for stack, pilot in zip((change, perturbed_change), pilots, strict=True):
        for_blocks(subtract_and_trust, 1, axis, stack, pilot, means.within)
    for_blocks(
        write_terms, 1, axis, change, perturbed_change, means.residual, noisy.signs, means.within,
        np.expand_dims(level.relative, axis), np.moveaxis(sums, 0, axis),
    )  # fmt: skip
    weights, _, gain = _weigh(level, sums, noise.variance, _PRIOR_OF_MEANS)
    for stack, changes in zip(results, (change, perturbed_change), strict=True):
        changes *= np.moveaxis(weights, 0, axis)
        level.add_enlarged_in_place(stack, changes)
    return gain


class _NoiseTerms:
    """Noise of the channels in the form that the sums take."""

    def __init__(self, sigma: Float64s, clipped: ClippedChannels | None) -> None:
        self._variances = np.square(sigma, dtype=np.float32)
        self.variance = float(np.mean(np.square(sigma)))
        channels = np.zeros((len(sigma), 4), np.float32)
        channels[:, 0] = self._variances
        if clipped is not None:
            channels[:, 1:] = clipped.channels
        tables = normal_tables()
        self.for_core = channels, tables.furthest, tables.lost, tables.share

    def terms(
        self, residual: Float32s, probe: Array, difference: Float32s, moved: Float32s, relative: Float32s
    ) -> Float32s:
        """Return the terms of w, summed over channels; `difference`, `moved`: Q - P without and with perturbation."""
        variances = self._variances[:, *[None] * (residual.ndim - 1)]
        slope = residual * difference - variances * relative * probe * (moved - difference)
        return np.stack([slope.sum(axis=0), np.square(difference).sum(axis=0)])


def _weigh(
    domain: Domain, sums: Float32s, variance: float, expected: _Prior
) -> tuple[Float32s, float, float]:
    """Solve for w from its terms; return w, its sum, and the sum of the reduction of the squared error."""
    slope, square = domain.total(sums)
    overall = min(1.0, max(0.0, slope / square)) ** expected.power if square > 0 else 0.0
    # The variance of w is sigma^2 over the sum of squares; a mean by a Gaussian stands for this many samples.
    prior = np.float32(variance * domain.noise / (4 * np.pi * domain.width**2) / expected.variance)
    means = domain.spread(sums)
    for mean, terms in in_blocks(0, means, sums):
        weight = np.clip((mean[0] + prior * overall) / (mean[1] + prior), 0, 1)
        mean[0], mean[1] = weight, weight * (2 * terms[0] - weight * terms[1])
    share, gain = domain.total(means)
    return means[:1], float(share), float(gain)


def _add(axis: int, stack: Float32s, signs: Array, size: np.float32) -> None:
    """Add a multiple of signs to a stack."""
    for block, sign in in_blocks(axis, stack, signs):
        block += np.multiply(sign, size, dtype=np.float32)
