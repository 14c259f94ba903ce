"""Noise that neighbouring cells share, from coarse to fine.

At half the size such noise is closer to independent. So means of squares of cells are estimated first, by patches on
the coarsest level, and what that changes is added to the next finer one, enlarged; on each level only the details of
its own cells are then left to be estimated [1]_. Colours reach over seams as halo does, on each level anew.

References
----------
.. [1] M. Lebrun, M. Colom, J.-M. Morel, "Multiscale image blind denoising", IEEE Trans. Image Processing 24(10), 2015.
   https://doi.org/10.1109/TIP.2015.2439041
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.flow.canvas import canvas_margin, collaborate_on_canvas
from beltrami_cli.flow.noise.haar_noise import mixed_signs
from beltrami_cli.flow.patches import mixing_of, with_pilot
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, OWNED, refresh_halo

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.arrays import Float32s, Float64s, Uint8s
    from beltrami_cli.flow.grid_kernels import GridKernels
    from beltrami_cli.flow.records import Mixing

# Of the noise of a level, what its own details hold; the rest is in its means, which coarser levels estimate: but for
# the share that they leave, and at the coarsest level all.
_OWN, _LEFT, _ALL = 0.75, 0.1, 0.25

# The scale from which on noise grows no more than this is the coarsest.
_GROWS = 1.1

# The perturbation, in units of the noise; any seed is as good.
_PERTURBATION, _SEED = 0.2, 21

# Rows of the finest level that are enlarged at a time.
_ROWS = 64


def denoise_means(
    manifold: GridKernels, covariances: Float64s, tick: Callable[[], None] | None = None
) -> float:
    """Estimate the means of squares, coarse to fine, in place; return their estimated mean square error."""
    planes, kind = manifold.colours, manifold.atlas.kind
    error, random = 0.0, np.random.default_rng(_SEED)
    one_chart = manifold.atlas.chart_of.max(initial=0) == 0
    gap = max(kind.shape) if one_chart else 2 * canvas_margin(manifold.parameters)
    coarsest = _coarsest(covariances, gap)
    report = None if tick is None else lambda _: tick()
    for level in range(coarsest, 0, -1):
        means, kinds = means_of_squares(planes, kind, 2**level)
        noise = noise_of_level(covariances, level, coarsest)
        relative = manifold.differing
        if relative is not None:
            relative = means_of_squares(relative, kind, 2**level)[0]
        collaborate = partial(
            collaborate_on_canvas, kinds, threads=manifold.threads, progress=report, relative=relative
        )
        after, risk = _estimated(manifold, means, kinds, noise, random, collaborate)
        after -= means
        add_enlarged(planes, kind, after, kinds, 2**level)
        refresh_halo(planes, manifold.atlas)
        error += max(0.0, risk)
    return error


def _coarsest(covariances: Float64s, gap: int) -> int:
    """Return the coarsest level that is needed, of which no square holds cells of two charts, `gap` cells apart."""
    sizes = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    grows = np.flatnonzero(sizes[1:] > _GROWS * sizes[:-1])
    wanted = int(grows[-1]) + 1 if len(grows) else 0
    while wanted > 0 and 2**wanted > gap:
        wanted -= 1
    return wanted


def _estimated(
    manifold: GridKernels,
    means: Float32s,
    kinds: Uint8s,
    noise: Float64s,
    random: np.random.Generator,
    collaborate: Callable[[Float32s, Float32s, Mixing], Float32s],
) -> tuple[Float32s, float]:
    """Estimate means from patches; return them and their mean square error by SURE, see `tuning.sure`."""
    first = mixing_of(manifold, manifold.colours, noise)
    second = with_pilot(first, manifold)

    def estimate(noisy: Float32s) -> Float32s:
        return collaborate(noisy, collaborate(noisy, noisy, first), second)

    after = estimate(means)
    probe = mixed_signs(noise, means.shape[1:], random)
    size = np.float32(_PERTURBATION)
    response = estimate(means + size * probe)
    response -= after
    owned = kinds == OWNED
    response *= probe / size
    misfit = np.square(after - means).mean(axis=(1, 2), where=owned, dtype=np.float64)
    freedom = response.mean(axis=(1, 2), where=owned, dtype=np.float64)
    return after, float(np.mean(misfit - np.diag(noise) + 2 * freedom))


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


def means_of_squares(planes: Float32s, kind: Uint8s, side: int) -> tuple[
    Float32s, Uint8s
]:  # fmt: skip
    """Return means of squares of cells and their kinds: of the owned cells, or of halo where there are no such."""
    rows, columns = (-(-size // side) for size in kind.shape)
    means = large_arrays.zeros((len(planes), rows, columns), np.float32)
    kinds = np.full((rows, columns), EMPTY, np.uint8)
    for block in large_arrays.blocks(rows, max(1, _ROWS // side)):
        cells = slice(block.start * side, block.stop * side)
        own = _squares(kind[cells], side, EMPTY)
        highest = np.where((own == OWNED).any(axis=(1, 3)), OWNED, own.max(axis=(1, 3)))
        kinds[block] = highest
        counted = own == highest[:, None, :, None]
        counted &= (highest != EMPTY)[:, None, :, None]
        count = np.maximum(counted.sum(axis=(1, 3)), 1)
        for mean, plane in zip(means, planes, strict=True):
            values = _squares(plane[cells], side, 0)
            mean[block] = np.sum(values, axis=(1, 3), where=counted, dtype=np.float32) / count
    return means, kinds


def add_enlarged(planes: Float32s, kind: Uint8s, changes: Float32s, kinds: Uint8s, side: int) -> None:
    """Add changes of squares to their owned cells, in place, bilinear between the squares that have such."""
    owned = (kinds == OWNED).astype(np.float32)
    changes = np.concatenate([changes * owned, owned[None]])
    columns = _between(planes.shape[2], side, changes.shape[2])
    for rows in large_arrays.blocks(planes.shape[1], _ROWS):
        low, high, share = (part[rows] for part in _between(planes.shape[1], side, changes.shape[1]))
        tall = changes[:, low] * (1 - share)[:, None] + changes[:, high] * share[:, None]
        wide = tall[:, :, columns[0]] * (1 - columns[2]) + tall[:, :, columns[1]] * columns[2]
        wide[:-1] /= np.maximum(wide[-1], np.float32(1e-6))
        np.add(planes[:, rows], wide[:-1], out=planes[:, rows], where=kind[rows] == OWNED)


def _squares(cells: NDArray[np.generic], side: int, filling: float) -> NDArray[np.generic]:
    """Return the squares of cells, shape (R, side, C, side), filled up at the end."""
    rows, columns = (-size % side for size in cells.shape)
    if rows or columns:
        cells = np.pad(cells, ((0, rows), (0, columns)), constant_values=filling)
    return cells.reshape(len(cells) // side, side, -1, side)


def _between(count: int, side: int, squares: int) -> tuple[NDArray[np.intp], ...]:
    """Return the squares on both sides of each cell, and how far it is from the first to the second."""
    place = np.clip((np.arange(count) + 0.5) / side - 0.5, 0, squares - 1)
    low = place.astype(np.intp)
    return low, np.minimum(low + 1, squares - 1), (place - low).astype(np.float32)
