"""Random perturbations of colours on a canvas, for the divergence of a result."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.flow.noise.drawing import draw_on_grid, draw_signs
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.atlas import EMPTY, Atlas, refresh_halo

# An arbitrary seed; a fixed one makes results reproducible.
_SEED = 20


def draw_perturbations(atlas: Atlas, noise: NoiseModel, count: int) -> list[Array]:
    """Draw random planes like the noise: independent signs as bytes, or correlated noise."""
    random, shape = np.random.default_rng(_SEED), atlas.kind.shape
    if noise.is_independent:
        drawn = [*draw_signs((count, len(noise.sigma), *shape), random)]
    else:
        drawn = [draw_on_grid(noise.covariances, shape, random) for _ in range(count)]
    for planes in drawn:
        for rows in large_arrays.blocks(len(atlas.kind), large_arrays.ROWS):
            if not noise.is_independent:
                planes[:, rows] /= np.float32(noise.rms_sigma)
            planes[:, rows][:, atlas.kind[rows] == EMPTY] = 0
        refresh_halo(planes, atlas)
    return drawn
