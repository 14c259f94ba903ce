"""The blend of two results by their estimated error.

The kernel's result P is moved towards the patches' result Q,

    u = P + w (Q - P),    w = - sum ((P - z) . d + sigma^2 div d) / sum |d|^2,    d = Q - P,

with sums over the samples around: Stein's unbiased estimate of the error of u is a parabola in w, and this is its least
[1]_. The divergence is the response of both to a small random perturbation of the noisy colours z. If noise was
clipped, P and Q are replaced in the sums by the mean of colours with such noise, which z can be compared with.

The means of plain colours over coarse levels are blended likewise, with patches of means.

References
----------
.. [1] S. Ramani, T. Blu, M. Unser, "Monte-Carlo SURE: a black-box optimization of regularization parameters for general
   denoising algorithms", IEEE Trans. Image Processing 17(9), 2008. https://doi.org/10.1109/TIP.2008.2001404
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
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
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.mixing import NOISELESS, Mixing
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.large_arrays import Droppable


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
_TRUSTED_SHARES = (0.64, 0.84)


class _Weights(NamedTuple):
    """The weights w over a domain, one plane, and sums over its samples."""

    plane: Float32s
    share: float  # sum of w
    gain: float  # sum of the reduction of the squared error


class Pair(NamedTuple):
    """The result of the noisy colours, and that of the perturbed ones."""

    plain: Stack
    perturbed: Stack


@dataclass(frozen=True)
class Probed:
    """Noisy colours z and their perturbation, `size` times signs or noise of unit variance.

    The divergence of a result is its response times the signs, divided by `divisors`.
    """

    colours: Stack
    axis: int
    drawn: Droppable[Array]  # signs or noise
    size: np.float32
    divisors: Float32s

    @classmethod
    def of(cls, manifold: Manifold, drawn: Droppable[Array], size: np.float32) -> Probed:
        variances = np.square(manifold.noise.sigma)
        if manifold.noise.is_independent:
            variances = np.ones(len(variances))
        # Correlated perturbations are larger in channels with more noise.
        power = np.maximum(variances / variances.mean(), NOISELESS**2)
        divisors = np.asarray(size * power, np.float32).reshape(-1, *[1] * (manifold.colours.ndim - 1))
        return cls(manifold.colours, manifold.geometry.axis, drawn, size, divisors)

    @property
    def signs(self) -> Array:
        return self.drawn.get()

    def means(self, level: CoarseLevel) -> Probed:
        perturbation = Droppable(self.size * level.means(self.signs))
        divisors = self.size * self.divisors
        return Probed(level.means(self.colours), self.axis, perturbation, np.float32(1), divisors)

    def perturbed_copy(self) -> Stack:
        copy = large_arrays.copy_of(self.colours)
        self._add_in_place(copy, self.size)
        return copy

    @contextlib.contextmanager
    def perturbed_in_place(self) -> Iterator[None]:
        """Add the perturbation to the colours within this context."""
        self._add_in_place(self.colours, self.size)
        yield
        self._add_in_place(self.colours, -self.size)

    def _add_in_place(self, stack: Stack, size: np.float32) -> None:
        for block, sign in in_blocks(self.axis, stack, self.signs):
            block += np.multiply(sign, size, dtype=np.float32)


class BlendNoise:
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

    def terms_of_means(
        self, residual: Float32s, probe: Array, difference: Float32s, moved: Float32s, relative: Float32s
    ) -> Float32s:
        """Return the terms of w over a level, as `blend_terms` does for samples, from the residual z - P of means.

        `difference`, `moved`: Q - P without and with perturbation.
        """
        variances = self._variances[:, *[None] * (residual.ndim - 1)]
        slope = residual * difference - variances * relative * probe * (moved - difference)
        return np.stack([slope.sum(axis=0), np.square(difference).sum(axis=0)])


def blend_samples_in_place(
    manifold: Manifold, noise: BlendNoise, noisy: Probed, kernel: Pair, patches: Pair
) -> tuple[float, float]:
    """Blend the patches' results into the kernel's; return the sum of the weights and of the gain."""
    regions, threads = manifold.regions, manifold.geometry.threads
    z, signs, relative, p, p_perturbed, q, q_perturbed = (
        np.moveaxis(stack, manifold.geometry.axis, 0)
        for stack in (noisy.colours, noisy.signs, manifold.relative_variance, *kernel, *patches)
    )

    def terms_of(rows: slice) -> Float32s:
        terms: Float32s = np.empty((2, *z[0, rows].shape), np.float32)
        estimates = tuple(stack[:, rows] for stack in (p, q, p_perturbed, q_perturbed))
        probe: Array = signs[:, rows] / noisy.divisors
        blend_terms(z[:, rows], probe, estimates, (*noise.for_core, relative[:, rows]), terms, 1)
        return terms

    def move(rows: slice) -> None:
        weight = regions.enlarged(weights.plane, rows)
        for of_kernel, of_patches in ((p, q), (p_perturbed, q_perturbed)):
            of_kernel[:, rows] += weight * (of_patches[:, rows] - of_kernel[:, rows])

    terms = regions.gathered(2, terms_of, z, threads)
    weights = _weigh(regions, terms, noise.variance, _PRIOR_OF_SAMPLES)
    in_parallel(move, threads, ((rows,) for rows in block_rows(z, regions.side)))
    for stack in kernel:
        manifold.geometry.refresh(stack)
    return weights.share, weights.gain


def blend_means_in_place(
    level: CoarseLevel, manifold: Manifold, noise: BlendNoise, mixing: Mixing, noisy: Probed, results: Pair
) -> float:
    """Blend the means of results over a level with estimates of them by patches; return the sum of the gain."""
    means = noisy.means(level)
    residuals, unclipped = _means_of_residuals(level, manifold, noise, noisy.colours, results.plain)
    changes = _changes_by_patches(level, mixing, means, unclipped, results)
    terms = np.empty((2, *level.shape), np.float32)

    blocks = in_blocks(
        level.axis, *changes, residuals, means.signs, unclipped,
        np.expand_dims(level.relative_variances, level.axis), np.moveaxis(terms, 0, level.axis),
    )  # fmt: skip
    for d, d_perturbed, residual, signs, share, relative, block in blocks:
        # The mean of colours with clipped noise moves by the unclipped share of a change: its derivative.
        block[:] = noise.terms_of_means(
            residual, signs / means.divisors, share * d, share * d_perturbed, share * relative
        )
    weights = _weigh(level, terms, noise.variance, _PRIOR_OF_MEANS)
    for stack, change in zip(results, changes, strict=True):
        level.add_enlarged_in_place(stack, change * np.moveaxis(weights.plane, 0, level.axis))
    return weights.gain


def _means_of_residuals(
    level: CoarseLevel, manifold: Manifold, noise: BlendNoise, noisy: Stack, result: Stack
) -> tuple[Stack, Stack]:
    """Average the residual of a result, and the shares of unclipped samples; small shares weigh more."""
    geometry, relatives = manifold.geometry, manifold.relative_variance
    values = large_arrays.empty(noisy.shape, np.float32)

    def write_residual(z: Array, p: Array, residual: Array, relative: Array) -> None:
        blend_residual(z, p, (*noise.for_core, relative), residual, 1)

    def write_cube_of_clipped(p: Array, shares: Array, relative: Array) -> None:
        blend_share_within(p, (*noise.for_core, relative), shares, 1)
        np.subtract(1, shares, out=shares)
        shares *= np.square(shares)

    for_blocks(write_residual, geometry.threads, geometry.axis, noisy, result, values, relatives)
    residuals = level.means(values)
    for_blocks(write_cube_of_clipped, geometry.threads, geometry.axis, result, values, relatives)
    # A cubic mean: a residual found where most is clipped, as on white paper, would bleed into ink, too.
    return residuals, 1 - np.cbrt(level.means(values))


def _changes_by_patches(
    level: CoarseLevel, mixing: Mixing, noisy: Probed, unclipped: Stack, results: Pair
) -> Pair:
    """Estimate the means of results by patches; return the changes, which are less where many samples are clipped."""
    # The means of the results are used as the pilot directly: a first estimate without a pilot would bring back noise.
    mixing = dataclasses.replace(mixing, variances=mixing.variances * level.noise_ratio)
    pilots, (least, enough) = Pair(*map(level.means, results)), _TRUSTED_SHARES
    plain = level.collaborate(noisy.colours, pilots.plain, mixing)
    with noisy.perturbed_in_place():
        changes = Pair(plain, level.collaborate(noisy.colours, pilots.perturbed, mixing))
    for change, pilot in zip(changes, pilots, strict=True):
        for q, p, share in in_blocks(level.axis, change, pilot, unclipped):
            q[:] = np.clip((share - least) / (enough - least), 0, 1) * (q - p)
    return changes


def _weigh(domain: Domain, terms: Float32s, variance: float, expected: _Prior) -> _Weights:
    """Solve for w from two planes of terms: the numerator, a slope of the error, and the square of d."""
    total_slope, total_square = domain.total(terms)
    ratio = total_slope / total_square if total_square > 0 else 0.0
    overall = min(1.0, max(0.0, ratio)) ** expected.power
    # The variance of w is sigma^2 over the sum of squares; a mean by a Gaussian stands for this many samples.
    prior = np.float32(variance * domain.noise_ratio / (4 * np.pi * domain.width**2) / expected.variance)
    weights_and_gains = domain.spread(terms)  # takes the memory of the means
    for (mean_slope, mean_square), (slope, square) in in_blocks(0, weights_and_gains, terms):
        weight = np.clip((mean_slope + prior * overall) / (mean_square + prior), 0, 1)
        mean_slope[:], mean_square[:] = weight, weight * (2 * slope - weight * square)
    share, gain = domain.total(weights_and_gains)
    return _Weights(weights_and_gains[:1], float(share), float(gain))
