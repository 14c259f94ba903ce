"""Rays cast at triangles, by Embree.

References
----------
.. [1] I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst, "Embree: a kernel framework for efficient CPU ray
   tracing", ACM Transactions on Graphics 33(4), 2014, doi:10.1145/2601097.2601199.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import ProcessingError
from beltrami_cli.view.rendering.camera import size_between

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Tracer:
    """Triangles that rays can be cast at.

    Parameters
    ----------
    positions : ndarray of float64, shape (V, 3)
        Finite, in any unit.
    faces : ndarray of int32, shape (F, 3)
        Triangles, at least one.

    Attributes
    ----------
    size : float
        Longest side of the bounding box.

    Raises
    ------
    ProcessingError
        If the package that casts rays is not installed.
    """

    def __init__(self, positions: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        scenes, meshes = require_embree()
        low, high = positions.min(axis=0), positions.max(axis=0)
        # Embree computes in single precision: around the middle and of unit size, large coordinates lose no digits.
        self._middle = (low + high) / 2
        self.size = size_between(low, high)
        self._scene = scenes.EmbreeScene(robust=True)
        vertices = np.ascontiguousarray(self._normalised(positions))
        self._mesh = meshes.TriangleMesh(self._scene, vertices, np.ascontiguousarray(faces, np.int32))

    def cast(
        self, starts: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Find what rays hit first.

        Parameters
        ----------
        starts, directions : ndarray of float64, shape (K, 3)
            Directions are of unit length.

        Returns
        -------
        faces : ndarray of int64, shape (K,)
            -1 where nothing is hit.
        weights : ndarray of float64, shape (K, 3)
            Barycentric, of the place that is hit.
        distances : ndarray of float64, shape (K,)
            In units of the model.
        """
        found = self._scene.run(
            np.ascontiguousarray(self._normalised(starts)),
            np.ascontiguousarray(directions, np.float32),
            output=1,
        )
        u, v = found["u"].astype(np.float64), found["v"].astype(np.float64)
        weights = np.column_stack([1 - u - v, u, v])
        return found["primID"].astype(np.int64), weights, found["tfar"].astype(np.float64) * self.size

    def _normalised(self, positions: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.asarray((positions - self._middle) / self.size, np.float32)


def require_embree() -> tuple[Any, Any]:
    """Import what casts rays.

    Raises
    ------
    ProcessingError
        If it is not installed; the message names the extra.
    """
    try:
        return (
            importlib.import_module("embreex.rtcore_scene"),
            importlib.import_module("embreex.mesh_construction"),
        )
    except ImportError as error:
        raise ProcessingError(
            "to draw surfaces, the package embreex is needed; "
            "install it with: pip install 'beltrami-cli[render]'"
        ) from error
