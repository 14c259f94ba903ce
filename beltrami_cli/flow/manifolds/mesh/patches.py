"""Similar patches on a mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.chunks import KernelCounts
from beltrami_cli.flow.manifolds.blocks import in_blocks
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.flow.vertex_graph import Graph
from beltrami_cli.surface import large_arrays


def collaborate_on_graph(
    graph: Graph,
    noisy: Stack,
    pilot: Stack,
    mixing: Mixing,
    relative: Float32s | None,
    progress: Callable[[int], None] | None = None,
    *,
    is_whole: bool = False,
) -> Stack:
    """Estimate colours from patches that are similar in the pilot; `relative`: noise variance by its mean."""
    stacks = [noisy, pilot, *([] if relative is None else [relative[:, None]])]
    chunking = graph.chunking
    # Colours without shared noise determine the parameters, so they must have the same bits for any number of chunks.
    if chunking is None or is_whole:
        sums, _ = _sums_of_patches(graph, stacks, graph.threads, mixing, progress)
    else:
        sums = [large_arrays.zeros(noisy.shape, np.float32) for _ in range(2)]
        chunking.apply(
            graph.chunks, partial(_sums_of_patches, mixing=mixing), stacks, sums, progress,
            size=graph.size, threads=graph.threads, adds=True,
        )  # fmt: skip
    estimates, weights = sums
    for estimate, weight, of_pilot in in_blocks(0, estimates, weights, pilot):
        is_known = weight > 0  # 0 for isolated samples
        mixed = np.divide(estimate, weight, out=np.zeros_like(estimate), where=is_known)
        estimate[:] = np.where(is_known, np.einsum("ij,sj->si", mixing.back, mixed), of_pilot)
    return estimates


def _sums_of_patches(
    graph: Graph,
    stacks: Sequence[Stack],
    threads: int,
    mixing: Mixing,
    progress: Callable[[int], None] | None = None,
) -> tuple[list[Float32s], KernelCounts]:
    """Sum the estimates of mixed channels by groups of patches, and their weights, shape (S, N) each."""
    noisy, pilot, *relative = stacks
    estimates, weights = np.zeros_like(noisy), np.zeros_like(noisy)
    variances = relative[0][:, 0] if relative else None
    graph.patches.collaborate(
        noisy, pilot, mixing.parts, variances, mixing.has_pilot, estimates, weights, threads, progress
    )
    return [estimates, weights], KernelCounts()
