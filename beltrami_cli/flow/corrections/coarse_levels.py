"""Removal of noise that neighbours share, from coarse to fine levels.

In means of squares of cells, or of clusters of vertices, such noise is closer to independent. So means are estimated by
patches on the coarsest level first. Their change is interpolated and added to the next finer level, and on each level
only the details of its own samples remain to be estimated [1]_.

References
----------
.. [1] M. Lebrun, M. Colom, J.-M. Morel, "Multiscale image blind denoising", IEEE Trans. Image Processing 24(10), 2015.
   https://doi.org/10.1109/TIP.2015.2439041
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s
from beltrami_cli.flow.corrections.clipping import impute_clipped_in_place
from beltrami_cli.flow.corrections.dark_outliers import fill_dark_outliers_in_place
from beltrami_cli.flow.manifolds.domain import CoarseLevel
from beltrami_cli.flow.manifolds.manifold import Manifold
from beltrami_cli.flow.mixing import PATCH_PERTURBATION, Mixing
from beltrami_cli.flow.noise.components import sigma_of_covariances
from beltrami_cli.surface import large_arrays

AnyManifold = TypeVar("AnyManifold", bound=Manifold)

# Share of the noise of a level that is in the means of four of its samples, which coarser levels estimate; the rest is
# in its details.
_SHARE_IN_MEANS = 0.25

# Share of the noise in means that coarser levels leave, in the same units. On 13 images each of three kinds of noise
# (`benchmarks/bench_regret.py FOLDER... --kinds camera,filtered --readings`), 0.05 loses 0.1 to 0.4 dB on average where
# the noise is given, and gains nothing where it is estimated. On seven of them, 0.2 loses 0.1 to 0.3 dB where the noise
# is estimated.
_RESIDUAL_SHARE = 0.1

# A level is the coarsest if the noise grows by no more than this factor beyond it.
_GROWTH_LIMIT = 1.1


def without_shared_noise(
    manifold: AnyManifold, tick: Callable[[], None] | None = None
) -> tuple[AnyManifold, float]:
    """Return the manifold with colours whose noise is independent, except at the finest scale.

    Return also the estimated mean square error of what was removed, in the input's colours. `tick` is called often, and
    may raise to stop.
    """
    covariances = manifold.noise.covariances
    manifold = dataclasses.replace(manifold, colours=large_arrays.copy_of(manifold.colours))
    if manifold.parameters.clipping == "restore":
        impute_clipped_in_place(manifold)
    levels, error = manifold.levels(_coarsest(covariances)), 0.0
    if not levels:
        return manifold, 0.0
    fill_dark_outliers_in_place(manifold, levels[0], sigma_of_covariances(covariances))
    for number, level in reversed(list(enumerate(levels, 1))):
        noise = level.noise_ratio * _noise_of_level(covariances, number, is_coarsest=number == len(levels))
        error += max(0.0, _estimate_in_place(level, manifold, noise, tick))
    left = dataclasses.replace(manifold.noise, covariances=_residual_covariances(covariances))
    return dataclasses.replace(manifold, noise=left), manifold.noise.square_to_input(error)


def _coarsest(covariances: Float64s) -> int:
    sizes = np.sqrt(np.trace(covariances, axis1=1, axis2=2))
    grows = np.flatnonzero(sizes[1:] > _GROWTH_LIMIT * sizes[:-1])
    return int(grows[-1]) + 1 if len(grows) else 0


def _estimate_in_place(
    level: CoarseLevel, manifold: Manifold, noise: Float64s, tick: Callable[[], None] | None
) -> float:
    """Estimate means; return their mean square error by SURE, see `risk`."""
    estimate, means = _estimator(level, manifold, noise, tick), level.means(manifold.colours)
    estimated = estimate(means)
    probe, size = level.probe(means, noise), np.float32(PATCH_PERTURBATION)
    response = estimate(means + size * probe)
    response -= estimated
    response *= probe / size
    change = np.subtract(estimated, means, out=estimated)
    level.add_enlarged_in_place(manifold.colours, change)
    squares = np.moveaxis(np.square(change) + 2 * response, level.axis, 0)
    mean = level.total(squares) / level.total(np.ones_like(squares[:1]))
    return float(np.mean(mean - np.diag(noise)))


def _estimator(
    level: CoarseLevel, manifold: Manifold, noise: Float64s, tick: Callable[[], None] | None
) -> Callable[[Float32s], Float32s]:
    """Return the estimation of noisy means by patches: without a pilot, and again with the result as the pilot."""
    first = Mixing.of(manifold.geometry.differences(manifold.colours), noise)
    second = first.with_pilot(manifold.parameters.strength, is_shared=manifold.noise.is_shared)
    progress = None if tick is None else lambda _: tick()
    collaborate = partial(level.collaborate, progress=progress, shared=True)
    return lambda noisy: collaborate(noisy, collaborate(noisy, noisy, first), second)


def _noise_of_level(covariances: Float64s, level: int, *, is_coarsest: bool) -> Float64s:
    """Return the covariance of the noise left in the means of a level, shape (N, N), in units of that of cells."""
    above = covariances[min(level + 1, len(covariances) - 1)]
    shared = _SHARE_IN_MEANS if is_coarsest else _RESIDUAL_SHARE
    return np.asarray((1 - _SHARE_IN_MEANS) * covariances[level] + shared * above)


def _residual_covariances(covariances: Float64s) -> Float64s:
    """Return the covariances of the noise left by coarser levels, shape (L, N, N), see `noise.model`."""
    left = np.zeros_like(covariances)
    left[0] = covariances[0]
    cells = 4.0 ** np.arange(len(covariances) - 1)[:, None, None]
    left[1:] = _RESIDUAL_SHARE * covariances[1] / (_SHARE_IN_MEANS * cells)
    return left
