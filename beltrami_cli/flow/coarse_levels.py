"""Colours of a canvas from coarse to fine: noise that cells share, and plain colours.

At half the size such noise is closer to independent. So means of squares of cells are estimated first, by patches on
the coarsest level, and what that changes is added to the next finer one, enlarged; on each level only the details of
its own cells are then left to be estimated [1]_. Colours reach over seams as halo does, on each level anew.

Where colours are plain, what is left of independent noise is in the mean of many cells. So after single cells have been
estimated, means are once more, by patches that see as much further as squares are larger.

References
----------
.. [1] M. Lebrun, M. Colom, J.-M. Morel, "Multiscale image blind denoising", IEEE Trans. Image Processing 24(10), 2015.
   https://doi.org/10.1109/TIP.2015.2439041
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.flow.canvas import canvas_margin, collaborate_on_canvas
from beltrami_cli.flow.manifold import CoarseLevel
from beltrami_cli.flow.noise.haar_noise import mixed_signs
from beltrami_cli.flow.patches import mixing_of, with_pilot
from beltrami_cli.flow.regularisation import gaussian_taps
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import OWNED, refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from beltrami_cli.arrays import Float32s, Float64s
    from beltrami_cli.flow.grid_kernels import GridKernels
    from beltrami_cli.flow.manifold import Manifold, Stack
    from beltrami_cli.flow.records import Mixing

# Of the noise of a level, what its own details hold; the rest is in its means, which coarser levels estimate: but for
# the share that they leave, and at the coarsest level all.
_OWN, _LEFT, _ALL = 0.75, 0.1, 0.25

# Less of a mean than any sample near has.
_LEAST_SHARE = 1e-6

# The scale from which on noise grows no more than this is the coarsest.
_GROWS = 1.1

# The perturbation, in units of the noise; any seed is as good.
_PERTURBATION, _SEED = 0.2, 21

# Sides of squares at which plain colours are estimated once more: patches of squares see further than those of cells.
_SIDES = 8, 4


class Squares(CoarseLevel):
    """Means of squares of cells of a canvas: of the owned cells of each, or of halo where there are no such."""

    axis: ClassVar[int] = 0
    width: ClassVar[float] = 3.0

    def __init__(self, manifold: GridKernels, side: int, tick: Callable[[], None] | None = None) -> None:
        from beltrami_cli._native import sort_squares

        self._manifold, self._side = manifold, side
        self._report = None if tick is None else lambda _: tick()
        self.kinds, counts = sort_squares(manifold.atlas.kind, side)
        self.noise, self._counts = 1 / side**2, counts
        self._differing = None if manifold.differing is None else self.means(manifold.differing)[0]
        ones = np.ones(self.kinds.shape, np.float32)
        self.relative = ones if self._differing is None else self._differing

    def means(self, stack: Float32s) -> Float32s:
        """Return the means of planes, shape (N, R, C); 0 in empty squares."""
        from beltrami_cli._native import means_of_squares

        kind, threads = self._manifold.atlas.kind, self._manifold.threads
        means: Float32s = large_arrays.empty((len(stack), *self.kinds.shape), np.float32)
        for rows in large_arrays.blocks(len(self.kinds), self._rows_at_once):
            cells = self._cells(rows)
            for plane, own in zip(stack[:, None], means, strict=True):
                own[rows] = means_of_squares(
                    kind[cells], self.kinds[rows], plane[:, cells], self._side, threads
                )[0]
        return means

    @property
    def _rows_at_once(self) -> int:
        cells: int = self._side**2 * self.kinds.shape[1]
        return max(1, large_arrays.BLOCK // cells)

    def _cells(self, rows: slice) -> slice:
        """Return the rows of cells of some rows of squares."""
        return slice(rows.start * self._side, rows.stop * self._side)

    def collaborate(self, noisy: Stack, pilot: Stack, mixing: Mixing, *, shared: bool = False) -> Stack:
        """Estimate means from patches; noise that cells share is no smaller where a square has more of them."""
        relative = None if self._differing is None else self._differing[None]
        if not shared:
            fewer = np.maximum(self._counts, 1) * np.float32(self.noise)
            relative = (self.relative / fewer)[None]
        own = self._manifold
        return collaborate_on_canvas(
            self.kinds, noisy, pilot, mixing, own.threads, self._report, relative=relative
        )

    def add_enlarged(self, stack: Stack, changes: Stack) -> None:
        """Add changes of squares to their owned cells, bilinear between the squares that have such."""
        from beltrami_cli._native import add_enlarged

        atlas, threads = self._manifold.atlas, self._manifold.threads
        for rows in large_arrays.blocks(len(self.kinds), self._rows_at_once):
            # With those above and below, between whose changes their cells lie.
            around = slice(max(0, rows.start - 1), min(len(self.kinds), rows.stop + 1))
            cells, first = self._cells(rows), self._cells(around).start
            kind, kinds = atlas.kind[self._cells(around)], self.kinds[around]
            for plane, change in zip(stack, changes[:, None], strict=True):
                part = plane[None, self._cells(around)].copy()
                add_enlarged(kind, kinds, change[:, around], part, self._side, threads)
                plane[cells] = part[0, cells.start - first : cells.stop - first]
        refresh_halo(stack, atlas)

    def planes(self, count: int) -> Float32s:
        """Return planes of zeros."""
        planes: Float32s = large_arrays.zeros((count, *self.kinds.shape), np.float32)
        return planes

    def total(self, planes: Float32s) -> Float64s:
        """Sum planes over the owned cells."""
        return np.asarray(
            np.sum(planes * self._counts, axis=(1, 2), dtype=np.float64, where=self.kinds == OWNED)
        )

    def spread(self, planes: Float32s) -> Float32s:
        """Average planes over the owned squares around."""
        from beltrami_cli._native import convolve

        return convolve(planes * (self.kinds == OWNED), gaussian_taps(self.width), self._manifold.threads)


def squares_for(manifold: GridKernels) -> Iterator[Squares]:
    """Go through the squares whose means patches estimate after single cells, coarse to fine."""
    for side in _SIDES:
        if side <= _most_apart(manifold):
            yield Squares(manifold, side)


def denoise_means(
    manifold: GridKernels, covariances: Float64s, tick: Callable[[], None] | None = None
) -> float:
    """Estimate the means of squares, coarse to fine, in place; return their estimated mean square error."""
    if manifold.parameters.clipping == "restore":
        _impute_cut_off(manifold)
        refresh_halo(manifold.colours, manifold.atlas)
    error, random = 0.0, np.random.default_rng(_SEED)
    coarsest = _coarsest(covariances, _most_apart(manifold))
    for level in range(coarsest, 0, -1):
        squares = Squares(manifold, 2**level, tick)
        noise = noise_of_level(covariances, level, coarsest)
        error += max(0.0, _estimate(squares, manifold, noise, random))
    return error


def _impute_cut_off(manifold: Manifold) -> None:
    """Replace samples at a limit, in place, by what noise beyond it would be on average, given those around them."""
    found, axis = manifold.find_clipped(), manifold.axis
    colours, relative = (np.moveaxis(stack, axis, 0) for stack in (manifold.colours, manifold.relative))
    for clipped in () if found is None else found.sides():
        # What is beyond an edge is not near the limit, and does not count.
        near = clipped.near_limit(colours, relative[0])
        counted, pilot = manifold.spread(near), colours.copy()
        np.maximum(counted, _LEAST_SHARE, out=counted)
        pilot[clipped.clipped] = manifold.spread(colours[clipped.clipped] * near) / counted
        clipped.restore(pilot, manifold.spread(clipped.marks(colours) * near) / counted, relative[0])
        clipped.impute(colours, pilot, relative[0])


def _most_apart(manifold: GridKernels) -> int:
    """Return the side of squares up to which none holds cells of two charts."""
    one_chart = manifold.atlas.chart_of.max(initial=0) == 0
    return max(manifold.atlas.kind.shape) if one_chart else 2 * canvas_margin(manifold.parameters)


def _coarsest(covariances: Float64s, gap: int) -> int:
    """Return the coarsest level that is needed, of which no square is wider than `gap` cells."""
    sizes = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    grows = np.flatnonzero(sizes[1:] > _GROWS * sizes[:-1])
    wanted = int(grows[-1]) + 1 if len(grows) else 0
    while wanted > 0 and 2**wanted > gap:
        wanted -= 1
    return wanted


def _estimate(squares: Squares, manifold: GridKernels, noise: Float64s, random: np.random.Generator) -> float:
    """Estimate means, in place; return their mean square error by SURE, see `tuning.sure`."""
    first = mixing_of(manifold, manifold.colours, noise)
    second, means = with_pilot(first, manifold), squares.means(manifold.colours)
    collaborate = partial(squares.collaborate, shared=True)

    def estimate(noisy: Float32s) -> Float32s:
        return collaborate(noisy, collaborate(noisy, noisy, first), second)

    after = estimate(means)
    probe = mixed_signs(noise, means.shape[1:], random)
    size = np.float32(_PERTURBATION)
    response = estimate(means + size * probe)
    response -= after
    owned = squares.kinds == OWNED
    response *= probe / size
    after -= means
    misfit = np.square(after).mean(axis=(1, 2), where=owned, dtype=np.float64)
    freedom = response.mean(axis=(1, 2), where=owned, dtype=np.float64)
    squares.add_enlarged(manifold.colours, after)
    return float(np.mean(misfit - np.diag(noise) + 2 * freedom))


def noise_of_level(covariances: Float64s, level: int, coarsest: int) -> Float64s:
    """Return the covariance of noise, shape (N, N), that is left in the means of a level, 0 being single cells."""
    above = covariances[min(level + 1, len(covariances) - 1)]
    shared = _ALL if level == coarsest else _LEFT
    own: Float64s = (_OWN * covariances[level] + shared * above) / 4**level
    return own


def left_for_cells(covariances: Float64s) -> Float64s:
    """Return the covariances of noise that coarser levels leave, shape (L, N, N), see `haar_noise`."""
    left = np.zeros_like(covariances)
    left[0] = covariances[0]
    left[1:] = _LEFT * covariances[1] / _ALL / 4 ** np.arange(len(covariances) - 1)[:, None, None]
    return left
