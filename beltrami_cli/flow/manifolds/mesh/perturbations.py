"""Random perturbations of colours on a mesh, for the divergence of a result."""

from __future__ import annotations

from itertools import islice

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s
from beltrami_cli.flow.manifolds.mesh.fingerprints import random_signs
from beltrami_cli.flow.noise.drawing import draw_on_clusters
from beltrami_cli.flow.noise.model import NoiseModel
from beltrami_cli.flow.vertex_graph import Graph, levels_of


def draw_perturbations(
    graph: Graph, noise: NoiseModel, colours: Float32s, around: NDArray[np.uint64], count: int
) -> Float32s:
    """Draw random stacks like the noise, from nearby colours: independent signs, or correlated noise."""
    if noise.is_independent:
        return random_signs(colours, around, count)
    covariances = noise.covariances
    levels = list(islice(levels_of(graph), len(covariances) + 1))
    signs = np.split(random_signs(colours, around, count * len(levels)), count)
    drawn = np.stack([draw_on_clusters(covariances, levels, of_levels) for of_levels in signs])
    drawn /= np.float32(noise.rms_sigma)
    return drawn
