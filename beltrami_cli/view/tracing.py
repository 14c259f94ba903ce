"""Painted triangles drawn by ray tracing, with Embree.

I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst, "Embree: a kernel framework for efficient CPU ray tracing",
ACM Transactions on Graphics 33(4), 2014, doi:10.1145/2601097.2601199.
"""

from __future__ import annotations

import importlib
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import ProcessingError
from beltrami_cli.surface.geometry import vertex_normals
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.view.camera import size_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.view.camera import Camera, Window
    from beltrami_cli.view.paint import Paint

SAMPLES = 3  # rays along a side of each pixel
AMBIENT = 0.35  # share of the light that comes from everywhere
# Towards the lamp, in view coordinates: at the upper left, behind the eye.
LAMP = np.array([-0.4, 0.5, 0.77]) / np.linalg.norm([-0.4, 0.5, 0.77])

_CREASE = np.cos(np.radians(40))  # smoothed normals further than this from the triangle's are not used
_BLOCK = 1 << 15  # rays at a time, which bounds the memory; larger blocks leave the processor's cache
_LAYERS = 16  # transparent surfaces behind each other
_SLACK = 1e-3  # of the view around what is covered: more than single precision loses
_STEP = 1e-5  # behind a transparent surface the ray goes on, in sizes of the model


class Tracer:
    """Triangles, (F, 3), of finite positions, (V, 3), that rays can be cast at."""

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
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Return which rays hit, and the first faces, barycentric weights and distances along unit directions."""
        found = self._scene.run(
            np.ascontiguousarray(self._normalised(starts)),
            np.ascontiguousarray(directions, np.float32),
            output=1,
        )
        hit = np.flatnonzero(found["primID"] >= 0)
        u, v = found["u"][hit].astype(np.float64), found["v"][hit].astype(np.float64)
        weights = np.column_stack([1 - u - v, u, v])
        distances = found["tfar"][hit].astype(np.float64) * self.size
        return hit, found["primID"][hit].astype(np.int64), weights, distances

    def _normalised(self, positions: NDArray[np.float64]) -> NDArray[np.float32]:
        return np.asarray((positions - self._middle) / self.size, np.float32)


def require_embree() -> tuple[Any, Any]:
    """Import the two modules that cast rays, or raise a ProcessingError that names the extra."""
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


class SurfaceView:
    """A painted surface of at least one triangle, seen from both sides, to be looked at from anywhere."""

    def __init__(self, positions: NDArray[np.float64], faces: NDArray[np.int32], paint: Paint) -> None:
        self.positions = positions[np.unique(faces)]
        self._all, self._faces, self._paint = positions, faces, paint
        self._tracer = Tracer(self.positions, np.searchsorted(np.unique(faces), faces).astype(np.int32))

    def draw(
        self, camera: Camera, size: tuple[int, int], window: Window, *, lit: bool
    ) -> NDArray[np.float32]:
        """Draw a window of a view, `size` = (width, height) pixels: linear light times opacity, and opacity."""
        width, height = size
        image = np.zeros((height, width, 4), np.float32)
        rows, columns = self._covered(camera, size, window)
        x, y = (_places(window[k], window[k + 2], size[k]) for k in (0, 1))
        x = x[columns.start * SAMPLES : columns.stop * SAMPLES]
        pixel = (window[2] - window[0]) / (width * SAMPLES)
        rows_at_once = max(1, _BLOCK // (max(1, len(x)) * SAMPLES))
        for first in range(rows.start, rows.stop, rows_at_once):
            last = min(first + rows_at_once, rows.stop)
            across, down = np.meshgrid(x, y[first * SAMPLES : last * SAMPLES])
            starts, directions = camera.rays(across.ravel(), down.ravel())
            seen = self._follow(camera, starts, directions, pixel, lit=lit)
            blocks = seen.reshape(last - first, SAMPLES, len(x) // SAMPLES, SAMPLES, 4)
            image[first:last, columns] = blocks.mean(axis=(1, 3))
        return image

    def _covered(self, camera: Camera, size: tuple[int, int], window: Window) -> tuple[slice, slice]:
        """Return the rows and columns of pixels outside of which nothing can be seen."""
        with np.errstate(over="ignore"):
            places, depths = camera.project(self.positions)
        if depths.min() <= 0:  # the eye is within the model
            return slice(0, size[1]), slice(0, size[0])
        share = np.array([window[2] - window[0], window[3] - window[1]])
        low, high = places.min(axis=0) - _SLACK, places.max(axis=0) + _SLACK
        first = np.clip(np.floor((low - window[:2]) / share * size), 0, size).astype(int)
        last = np.clip(np.ceil((high - window[:2]) / share * size), 0, size).astype(int)
        return slice(first[1], last[1]), slice(first[0], last[0])

    def _follow(
        self,
        camera: Camera,
        starts: NDArray[np.float64],
        directions: NDArray[np.float64],
        pixel: float,
        *,
        lit: bool,
    ) -> NDArray[np.float64]:
        """Return what rays see, (K, 4), through everything transparent."""
        seen = np.zeros((len(starts), 4))
        active = np.arange(len(starts))
        travelled = np.zeros(len(starts))
        for _ in range(_LAYERS):
            hit, faces, weights, distances = self._tracer.cast(starts, directions)
            active, starts, directions = active[hit], starts[hit], directions[hit]
            travelled = travelled[hit] + distances
            footprints = (camera.breadth(travelled) * pixel) ** 2
            colours = self._paint(faces, weights, footprints)
            if lit:
                colours[:, :3] *= self._light(camera, faces, weights, directions)[:, None]
            total = seen[active]
            share = (1 - total[:, 3]) * colours[:, 3]
            total[:, :3] += share[:, None] * colours[:, :3]
            total[:, 3] += share
            seen[active] = total
            on = np.flatnonzero(total[:, 3] < 0.999)
            if not len(on):
                break
            step = _STEP * self._tracer.size
            active, directions, travelled = active[on], directions[on], travelled[on] + step
            starts = starts[on] + (distances[on] + step)[:, None] * directions
        return seen

    def _light(
        self,
        camera: Camera,
        faces: NDArray[np.int64],
        weights: NDArray[np.float64],
        directions: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        normals = np.einsum("kc,kcx->kx", weights, self._corner_normals[faces])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        away = np.einsum("kx,kx->k", self._face_normals[faces], directions) > 0
        normals[away] *= -1
        lambert = np.maximum(normals @ (LAMP @ camera.rotation), 0)
        return np.asarray(AMBIENT + (1 - AMBIENT) * lambert)

    @cached_property
    def _face_normals(self) -> NDArray[np.float64]:
        corners = self._all[self._faces]
        crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        lengths = np.linalg.norm(crosses, axis=1, keepdims=True)
        return np.asarray(np.divide(crosses, lengths, out=np.zeros_like(crosses), where=lengths > 0))

    @cached_property
    def _corner_normals(self) -> NDArray[np.float64]:
        """Normals of the corners of triangles, (F, 3, 3): smooth, except at creases."""
        place_of, _ = group_equal_rows(*self._all.T)
        smooth = vertex_normals(self._all, self._faces, place_of).astype(np.float64)[self._faces]
        flat = self._face_normals[:, None, :]
        creased = (smooth * flat).sum(axis=2, keepdims=True) < _CREASE
        return np.where(creased, flat, smooth)


def _places(first: float, last: float, pixels: int) -> NDArray[np.float64]:
    """Return where rays go through along one side of a window."""
    count = pixels * SAMPLES
    return np.asarray(first + (last - first) * (np.arange(count) + 0.5) / count, np.float64)
