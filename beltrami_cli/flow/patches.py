"""Collaborative patches after the kernel.

Where colours repeat themselves along the surface, as in photographs, similar patches can be estimated together [1]_;
where they are plain with sharp edges, the kernel is better. So the kernel's result serves as the pilot of the patches,
and `blending` weighs both results by their estimated error. That needs the response of both to a small random
perturbation of the noisy colours, so both are computed twice.

Noise that was clipped at 0 or full scale is replaced beforehand by its mean without clipping, given the kernel's
result.

References
----------
.. [1] S. Herbreteau, C. Kervrann, "Towards a unified view of unsupervised non-local methods for image denoising: the
   NL-Ridge approach", ICIP 2022. https://arxiv.org/abs/2203.00570
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from beltrami_cli.flow.blending import BlendNoise, Pair, Probed, blend_means_in_place, blend_samples_in_place
from beltrami_cli.flow.corrections.clipping import ClippedChannels
from beltrami_cli.flow.manifolds.blocks import for_blocks
from beltrami_cli.flow.manifolds.domain import CoarseLevel
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.manifolds.iteration import Averaged
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.mixing import PATCH_PERTURBATION, Mixing
from beltrami_cli.surface import large_arrays

# Duration of both patch estimates, in iterations of the kernel, for progress.
PASSES = (6, 20)


@dataclass(frozen=True)
class Blend:
    """The result of the kernel, whose colours are blended with those of patches."""

    averaged: Averaged
    share: float  # mean weight of patches
    gain: float  # estimated reduction of the mean square error


def blend_with_patches_in_place(
    manifold: Manifold,
    run_kernel_in_place: Callable[[Stack], Averaged],
    clipped: ClippedChannels | None,
    stage: Callable[[int], Callable[[int], None] | None],
) -> Blend:
    """Blend the results of the kernel and of patches. The colours of the manifold are lost."""
    geometry, noise, strength = manifold.geometry, manifold.noise, manifold.parameters.strength
    axis, threads = geometry.axis, geometry.threads
    probed, averaged, results = _run_kernels(manifold, run_kernel_in_place)
    if clipped is not None:
        for_blocks(
            clipped.impute_in_place, threads, axis, probed.colours, results.plain, manifold.relative_variance
        )
    mixing = Mixing.of(geometry.differences(results.plain), noise.covariance)
    with_pilot = mixing.with_pilot(strength, is_shared=noise.is_shared)

    def estimate(pilot: Stack) -> Stack:
        first = manifold.collaborate(probed.colours, pilot, mixing, stage(PASSES[0]))
        for_blocks(lambda mean, other: np.divide(mean + other, 2, out=mean), threads, axis, first, pilot)
        return manifold.collaborate(probed.colours, first, with_pilot, stage(PASSES[1]), replaces_pilot=True)

    plain = estimate(results.plain)
    with probed.perturbed_in_place():
        patches = Pair(plain, estimate(results.perturbed))
    del plain
    # The strength scales the weight of smoothness, as in the choice of parameters.
    blend_noise = BlendNoise(noise.sigma * np.sqrt(np.sqrt(strength)), clipped)
    share, gain = blend_samples_in_place(manifold, blend_noise, probed, results, patches)
    del patches
    for level in _plain_levels(manifold):
        gain += blend_means_in_place(level, manifold, blend_noise, with_pilot, probed, results)
    count = max(1, geometry.kernels)
    return Blend(averaged, share / count, noise.square_to_input(gain) / count / len(noise.sigma))


def _run_kernels(
    manifold: Manifold, run_kernel_in_place: Callable[[Stack], Averaged]
) -> tuple[Probed, Averaged, Pair]:
    """Run the kernel without and with a perturbation of the colours; return the first run, and both results."""
    noisy = manifold.colours
    # Chunked kernels do not overwrite the colours.
    averaged = run_kernel_in_place(large_arrays.copy_of(noisy) if manifold.chunking is None else noisy)
    size = np.float32(PATCH_PERTURBATION * manifold.noise.rms_sigma)
    probed = Probed.of(manifold, manifold.perturbation(), size)
    perturbed = probed.perturbed_copy()
    probed.drawn.drop()
    results = Pair(averaged.stacks[0], run_kernel_in_place(perturbed).stacks[0])
    manifold.drop_kernels()
    return probed, averaged, results


def _plain_levels(manifold: Manifold) -> Iterator[CoarseLevel]:
    """Yield the levels, coarse to fine, on which means of plain colours are estimated."""
    if manifold.noise.is_shared:  # coarse levels have been estimated already
        return
    levels = manifold.levels(max(manifold.plain_levels))
    yield from (levels[number - 1] for number in manifold.plain_levels if number <= len(levels))
