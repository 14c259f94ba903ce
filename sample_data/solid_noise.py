"""Value noise: smooth random functions of space, the same on every platform."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

PERIOD = 32


def solid_noise(points: NDArray[np.float64], frequency: float, seed: int) -> NDArray[np.float64]:
    """Return a smooth random function in [-1, 1] at points, shape (..., 3), with `frequency` cells to the unit."""
    lattice = np.random.Generator(np.random.PCG64(seed)).uniform(-1, 1, (PERIOD,) * 3)
    scaled = points * frequency + PERIOD / 2
    corner = np.floor(scaled).astype(int)
    part = scaled - corner
    part = part**3 * (part * (6 * part - 15) + 10)
    total = np.zeros(points.shape[:-1])
    for step in itertools.product((0, 1), repeat=3):
        weight = np.where(step, part, 1 - part).prod(axis=-1)
        x, y, z = np.moveaxis((corner + step) % PERIOD, -1, 0)
        total += weight * lattice[x, y, z]
    return total


def fractal(points: NDArray[np.float64], frequency: float, seed: int, octaves: int) -> NDArray[np.float64]:
    """Return a sum of noises, each twice as fine and half as strong as the one before."""
    return sum(
        (solid_noise(points, frequency * 2**k, seed + k) / 2**k for k in range(octaves)),
        start=np.zeros(points.shape[:-1]),
    )
