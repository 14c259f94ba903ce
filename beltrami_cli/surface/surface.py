"""The record that sampling hands to the flow: samples and the triangles between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class SampledSurface:
    """Samples of an image painted on a triangulated surface.

    Attributes
    ----------
    positions : ndarray of float64, shape (S, M)
        Positions, finite.
    faces : ndarray of int32, shape (F, 3)
        Triangles of the surface in space.
    walls : ndarray of int32, shape (W, 3)
        Triangles that stand upright on hard colour edges: they have no area in space, and join the samples
        on both sides through the colour jump.
    colours : ndarray of float32, shape (S, N)
        Colours in the working space, finite.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    walls: NDArray[np.int32]
    colours: NDArray[np.float32]

    @property
    def all_faces(self) -> NDArray[np.int32]:
        """Triangles of the surface and of its walls, shape (F + W, 3)."""
        return np.concatenate([self.faces, self.walls]) if len(self.walls) else self.faces
