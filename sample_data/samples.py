"""The record of a coloured sample mesh, and the noise that is put on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

NOISE = 20.0 / 255.0


@dataclass(frozen=True)
class Sample:
    """A small coloured mesh.

    Attributes
    ----------
    positions : ndarray of float64, shape (V, 3)
        The longest side is 1, +Y is up, the front looks along +Z; rounded to 1e-5.
    polygons : tuple of tuples of int
        Triangles and quads.
    colours : ndarray of uint8, shape (V, 3)
        sRGB display values.
    """

    positions: NDArray[np.float64]
    polygons: tuple[tuple[int, ...], ...]
    colours: NDArray[np.uint8]

    def triangles(self) -> NDArray[np.int32]:
        """Return all polygons cut into fans of triangles, shape (F, 3)."""
        fans = [(p[0], p[k], p[k + 1]) for p in self.polygons for k in range(1, len(p) - 1)]
        return np.array(fans, np.int32)


def normalised(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centre the bounding box, scale its longest side to 1 and round to 1e-5.

    Rounding hides the last bits of sines and exponentials, which differ between platforms; everything
    that is decided later is decided from the rounded numbers. Adding 0 turns -0.0 into 0.0.
    """
    low, high = positions.min(axis=0), positions.max(axis=0)
    return np.round((positions - (low + high) / 2) / (high - low).max(), 5) + 0.0


def quantised(colours: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Clip colours in [0, 1] and round them to 8 bit."""
    return np.rint(np.clip(np.round(colours, 9), 0, 1) * 255).astype(np.uint8)


def noisy(sample: Sample, seed: int) -> Sample:
    """Add independent Gaussian noise of standard deviation 20/255 to every channel, clip, round to 8 bit.

    Vertices at one place with one colour are one point of the surface that a format had to split; they
    get the same noise.
    """
    keys = np.column_stack([np.rint(sample.positions * 1e5).astype(np.int64), sample.colours])
    points, point_of = np.unique(keys, axis=0, return_inverse=True)
    noise = np.random.Generator(np.random.PCG64(seed)).standard_normal((len(points), 3)) * NOISE
    return replace(sample, colours=quantised(sample.colours / 255 + noise[point_of.reshape(-1)]))
