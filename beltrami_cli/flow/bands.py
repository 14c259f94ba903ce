"""An iteration on a canvas in place, band of rows by band of rows, so that it takes little memory besides."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.canvas import apply_kernel
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import HALO, OWNED, refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.flow.canvas import Canvas

# Cells of a band, of which some 90 bytes are held each; more where many threads share them.
_CELLS = 1 << 18
_CELLS_PER_THREAD = 1 << 16

# Bands are cut where the core's tiles end, so that these are whole.
_TILE_ROWS = 32


class Bands:
    """The bands of a canvas, from the top down.

    Parameters
    ----------
    canvas : Canvas
        The canvas, of R x C cells.
    """

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        columns = canvas.atlas.kind.shape[1]
        wanted = max(_CELLS, _CELLS_PER_THREAD * canvas.parameters.thread_count) // max(1, columns)
        # A band is at least as high as the margin, so that it depends on none but the bands beside it.
        least = max(wanted, canvas.margin, 1)
        self._height = -(-least // _TILE_ROWS) * _TILE_ROWS

    def iterate(
        self,
        stacks: Sequence[NDArray[np.float32]],
        iteration: int,
        progress: Callable[[int], None] | None = None,
    ) -> int:
        """Make an iteration, counted from 0, in place.

        Parameters
        ----------
        stacks : sequence of ndarray of float32, shape (N, R, C)
            Planes to average, halo included; the first are the colours, which the metric is made of.
        iteration : int
            Counted from 0.
        progress : callable, optional
            Called with the cells done so far; may raise to stop.

        Returns
        -------
        int
            Samples that all kernels held together.
        """
        atlas, margin = self._canvas.atlas, self._canvas.margin
        rows, columns = atlas.kind.shape
        held, above = 0, np.zeros((sum(map(len, stacks)), 0, columns), np.float32)
        for band in large_arrays.blocks(rows, self._height):
            top, bottom = band.start, band.stop
            last = min(rows, bottom + margin)
            # What lies above was overwritten by the band before.
            before = np.concatenate([above, np.concatenate([stack[:, top:last] for stack in stacks])], axis=1)
            first = last - before.shape[1]
            after, samples = self._average(
                before,
                first,
                slice(top - first, bottom - first),
                iteration,
                _share(progress, top * columns, (bottom - top) / before.shape[1]),
            )
            above = before[:, max(0, bottom - margin - first) : bottom - first].copy()
            del before
            channel = 0
            for stack in stacks:
                stack[:, top:bottom] = after[channel : channel + len(stack), top - first : bottom - first]
                channel += len(stack)
            held += samples
        for stack in stacks:
            refresh_halo(stack, atlas)
        return held

    def _average(
        self,
        planes: NDArray[np.float32],
        first: int,
        core: slice,
        iteration: int,
        progress: Callable[[int], None] | None,
    ) -> tuple[NDArray[np.float32], int]:
        """Average rows of the canvas that begin with `first`; those of the core are right then."""
        canvas, atlas = self._canvas, self._canvas.atlas
        rows = slice(first, first + planes.shape[1])
        kind = atlas.kind[rows].copy()
        outside = np.ones(len(kind), bool)
        outside[core] = False
        kind[outside[:, None] & (kind == OWNED)] = HALO  # which lends its value, and has no kernel
        metric = canvas.metric.planes(planes[: canvas.channels], iteration, first)
        lengths = np.ascontiguousarray(atlas.squared_lengths[:, rows])
        threads = canvas.parameters.thread_count
        return apply_kernel(
            kind, lengths, canvas.cells.rows(rows), metric, planes, canvas.parameters, threads, progress
        )


def _share(progress: Callable[[int], None] | None, before: int, share: float) -> Callable[[int], None] | None:
    """Make the progress of a band, of whose cells only a share is new, count on from those before it."""
    return None if progress is None else lambda done: progress(before + int(done * share))
