"""Similar patches on a canvas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from beltrami_cli._native import (
    PATCH_TILE_MARGIN,
    PATCH_TILE_SIDE,
    collaborate_on_grid,
)
from beltrami_cli.arrays import Float32s, Uint8s
from beltrami_cli.flow.chunks import Chunking, KernelCounts
from beltrami_cli.flow.cuts import Rectangle, chunks_of_canvas, grown
from beltrami_cli.flow.manifolds.geometry import Stack
from beltrami_cli.flow.mixing import Mixing
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import HALO, OWNED


def collaborate_on_canvas(
    kind: Uint8s,
    stacks: Sequence[Stack],
    mixing: Mixing,
    threads: int,
    progress: Callable[[int], None] | None = None,
    *,
    replaces_pilot: bool = False,
    chunking: Chunking | None = None,
) -> Float32s:
    """Estimate the owned cells from similar patches.

    `stacks`: the noisy colours, the pilot on which patches are compared, and, if the noise varies, its variance
    relative to the mean.
    """
    noisy, pilot = stacks[:2]
    if chunking is None:
        estimates = pilot if replaces_pilot else large_arrays.empty(noisy.shape, np.float32)
        _write_estimates(kind, stacks, mixing, threads, estimates, progress)
        return estimates
    estimates = large_arrays.zeros(noisy.shape, np.float32)  # where no chunk has owned cells
    # Groups start tile by tile. The order in which tiles add to a cell has a period of two tiles.
    before, after = 2 * PATCH_TILE_SIDE, PATCH_TILE_SIDE + PATCH_TILE_MARGIN
    cut, operation = partial(_part_for_patches, kind), partial(_estimate_part, mixing=mixing)
    chunks = chunks_of_canvas(cut, kind == OWNED, chunking.count, before, before, after)
    chunking.apply(chunks, operation, stacks, [estimates], progress, size=kind.size, threads=threads)
    return estimates


def _part_for_patches(kind: Uint8s, around: Rectangle, core: Rectangle) -> tuple[Uint8s, Rectangle]:
    """Cut out the kinds of cells; groups start only near `core`, the rectangle that is estimated."""
    part: Uint8s = kind[around].copy()
    # The groups of adjacent tiles reach the rectangle; cells beyond these only supply candidates.
    inside = np.zeros(part.shape, bool)
    inside[grown(core, PATCH_TILE_SIDE, PATCH_TILE_SIDE, part.shape)] = True
    part[(part == OWNED) & ~inside] = HALO
    return part, core


def _estimate_part(
    part: tuple[Uint8s, Rectangle], stacks: Sequence[Float32s], threads: int, mixing: Mixing
) -> tuple[list[Float32s], KernelCounts]:
    (kind, core), estimates = part, large_arrays.empty(stacks[0].shape, np.float32)
    _write_estimates(kind, stacks, mixing, threads, estimates)
    return [estimates[core]], KernelCounts()


def _write_estimates(
    kind: Uint8s,
    stacks: Sequence[Float32s],
    mixing: Mixing,
    threads: int,
    estimates: Float32s,
    progress: Callable[[int], None] | None = None,
) -> None:
    noisy, pilot, *relative = stacks

    def report(done: int) -> None:
        large_arrays.release_pages()
        if progress is not None:
            progress(done)

    variances = relative[0][0] if relative else None
    collaborate_on_grid(
        kind, noisy, pilot, mixing.parts, variances, mixing.has_pilot, estimates, threads, report
    )
