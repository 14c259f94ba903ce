"""Drawing of coloured triangles by ray tracing with Embree; their colours, and cameras.

View coordinates are x to the right, y up, z towards the eye.

I. Wald, S. Woop, C. Benthin, G. S. Johnson, M. Ernst, "Embree: a kernel framework for efficient CPU ray tracing",
ACM Transactions on Graphics 33(4), 2014, doi:10.1145/2601097.2601199.

Textures are averaged where they are seen from afar, by L. Williams, "Pyramidal parametrics", SIGGRAPH 1983,
doi:10.1145/800059.801126.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import ProcessingError, install_hint
from beltrami_cli.surface.geometry import unit_vectors, vertex_normals, without_unused
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.lookups import look_up
from beltrami_cli.surface.memory import memory_reserved
from beltrami_cli.surface.records import TexturedSurface, Wrap

Sheet = Float32s
"""An image in linear light with opacity, shape (H, W, 4); colours are not multiplied by it."""

_MAX_EXACT_TEXEL = 1 << 13  # texels from the origin up to which single precision is sufficient
_UNTEXTURED = 0.32  # linear light of a middle grey
_SMALLEST = 1e-13  # of the distance from the origin: smaller models would vanish by rounding
_NARROWEST = 1e-3  # degrees: smaller fields of view are orthographic
_MARGIN = 0.92  # of the shorter side of a view that a model fills


class InterpolatedColours:
    """Linear light at vertices, (V, 3), interpolated between them."""

    is_opaque = True  # whether the surface hides everything behind it

    def __init__(self, faces: Int32s, colours: Float64s) -> None:
        self._corners = colours.astype(np.float32)[faces]

    def __call__(self, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        """Return light times opacity, and opacity, (K, 4), at points of faces with barycentric weights, (K, 3)."""
        mixed = np.ones((len(faces), 4), np.float32)
        mixed[:, :3] = _interpolated(self._corners, faces, weights)
        return mixed


class TextureColours:
    """Textures with bilinear interpolation, and smaller copies for points that cover several texels."""

    def __init__(self, surface: TexturedSurface, sheets: Sequence[Sheet], areas: Float64s) -> None:
        self._surface = surface
        for sheet, texture in zip(sheets, surface.textures, strict=True):
            if not texture.alpha_hides:
                sheet[..., 3] = 1
        self._pyramids = [Pyramid(sheet) for sheet in sheets]
        first, second = (surface.uv[:, k] - surface.uv[:, 0] for k in (1, 2))
        covered = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
        sizes = np.array([0, *(sheet.shape[0] * sheet.shape[1] for sheet in sheets)], float)
        texels = covered * sizes[surface.texture_of + 1]
        with np.errstate(over="ignore"):
            self._density = np.divide(texels, areas, out=np.zeros_like(areas), where=areas > 0)
        # As many bits as are needed to resolve parts of a texel.
        largest = np.abs(surface.uv).max(initial=0) * max((max(sheet.shape) for sheet in sheets), default=1)
        self._uv = surface.uv.astype(np.float32) if largest < _MAX_EXACT_TEXEL else surface.uv
        self.is_opaque = all(pyramid.is_opaque for pyramid in self._pyramids)

    def __call__(self, faces: Int32s, weights: Float32s, footprints: Float64s) -> Float32s:
        colours = np.full((len(faces), 4), _UNTEXTURED, np.float32)
        colours[:, 3] = 1
        of, uv = self._surface.texture_of[faces], _interpolated(self._uv, faces, weights)
        texels = footprints * self._density[faces]
        for number, texture in enumerate(self._surface.textures):
            mine = np.flatnonzero(of == number)
            colours[mine] = self._pyramids[number].look_up(uv[mine], texture.wrap, texels[mine])
        return colours


SurfaceColours = InterpolatedColours | TextureColours


class Pyramid:
    """An image, and its copies of half the size down to a single texel, which are made when they are needed.

    Colours are multiplied by the opacity, in place, so that transparent texels do not count in averages.
    """

    def __init__(self, sheet: Sheet) -> None:
        self.is_opaque = bool((sheet[..., 3] == 1).all())
        if not self.is_opaque:
            sheet[..., :3] *= sheet[..., 3:]
        self._levels = [np.ascontiguousarray(sheet)]
        self._last = int(np.ceil(np.log2(max(sheet.shape[:2]))))

    def look_up(self, uv: Float64s, wrap: tuple[Wrap, Wrap], texels: Float64s) -> Float32s:
        """Interpolate at places, (K, 2), v down, that stand for areas of `texels`, (K,), of the first level; (K, 4)."""
        at = np.clip(np.log2(np.maximum(texels, 1)) / 2, 0, self._last)
        lower = at.astype(np.int64)
        part = (at - lower).astype(np.float32)[:, None]
        colours = np.empty((len(uv), 4), np.float32)
        for number in range(int(lower.min(initial=self._last)), int(lower.max(initial=-1)) + 1):
            mine = np.flatnonzero(lower == number)
            colours[mine] = look_up(self._level(number), uv[mine], wrap, precision=np.float32)
            between = mine[part[mine, 0] > 0]
            if len(between):  # blended with the next smaller copy
                smaller = look_up(self._level(number + 1), uv[between], wrap, precision=np.float32)
                colours[between] += part[between] * (smaller - colours[between])
        return colours

    def _level(self, number: int) -> Sheet:
        while len(self._levels) <= number:
            last = self._levels[-1]
            # The last of an odd number of texels is counted twice.
            even = np.pad(last, [(0, side % 2) for side in last.shape[:2]] + [(0, 0)], mode="edge")
            four = [even[row::2, column::2] for row in (0, 1) for column in (0, 1)]
            self._levels.append(np.asarray((four[0] + four[1] + four[2] + four[3]) / 4, np.float32))
        return self._levels[number]


def _interpolated(corners: Array, faces: Int32s, weights: Float32s) -> Array:
    """Interpolate numbers at the corners of all faces, (F, 3, X), at points of some of them; (K, X)."""
    three = corners.take(faces, axis=0)
    return three[:, 0] * weights[:, :1] + three[:, 1] * weights[:, 1:2] + three[:, 2] * weights[:, 2:]


# Rows: the directions to the right, up and towards the eye in a view from the front, by the axis that points up.
_FRONT = {
    "x": [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    "y": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}

Window = tuple[float, float, float, float]
"""Part of a view: left, upper, right and lower border, as fractions of its width and height."""


def part_of(window: Window, part: Window) -> Window:
    """Return a part of a window as a window of the whole view."""
    width, height = window[2] - window[0], window[3] - window[1]
    left, upper = window[0] + part[0] * width, window[1] + part[1] * height
    return left, upper, left + (part[2] - part[0]) * width, upper + (part[3] - part[1]) * height


@dataclass(frozen=True)
class Camera:
    """A perspective or orthographic camera."""

    rotation: Float64s  # (3, 3): rows are the directions of view coordinates
    place: Float64s  # (3,), view coordinates: the eye; orthographic: a point in front of the model
    reach: Float64s  # (2,): half the width and height seen at distance 1; orthographic: anywhere
    is_orthographic: bool

    def rays(
        self, columns: Float64s, rows: Float64s, precision: type[np.float32] | type[np.float64] = np.float64
    ) -> tuple[Array, Array]:
        """Return origins and unit directions of rays, (K, 3) each, through places in fractions of the view."""
        # Columns (C,) with rows (R, 1) make a grid, by the rules of broadcasting.
        across = ((2 * columns - 1) * self.reach[0])[..., None]
        up = ((1 - 2 * rows) * self.reach[1])[..., None]
        right, above, back = self.rotation
        eye = self.place @ self.rotation
        if self.is_orthographic:
            starts = (eye + up * above) + across * right
            return starts.reshape(-1, 3), np.broadcast_to(-back, (starts.size // 3, 3))
        directions = (up * above - back).astype(precision) + (across * right).astype(precision)
        directions /= np.sqrt(across**2 + up**2 + 1).astype(precision)
        return np.broadcast_to(eye, (directions.size // 3, 3)), directions.reshape(-1, 3)

    def project(self, positions: Float64s) -> tuple[Float64s, Float64s]:
        """Return where points are in the view, (K, 2), as fractions of it, and their depths, (K,)."""
        seen = positions @ self.rotation.T - self.place
        depth = -seen[:, 2]
        scale = 1.0 if self.is_orthographic else np.maximum(depth, 1e-300)[:, None]
        across = seen[:, :2] / (scale * self.reach)
        return np.column_stack([(1 + across[:, 0]) / 2, (1 - across[:, 1]) / 2]), depth

    def breadth(self, distances: Float64s) -> Float64s:
        """Return the width of the whole view at distances from the origins of rays, in units of the model."""
        return np.asarray(
            2 * self.reach[0] * (np.ones_like(distances) if self.is_orthographic else distances)
        )


def orientation(azimuth: float, elevation: float, up: str = "y") -> Float64s:
    """Return the rotation to view coordinates, (3, 3), of an eye to the right of the front and above, in degrees."""
    (c, s), (d, e) = ((np.cos(angle), np.sin(angle)) for angle in np.radians((azimuth, elevation)))
    around = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    over = np.array([[1, 0, 0], [0, d, -e], [0, e, d]])
    return np.asarray(over @ around @ np.array(_FRONT[up], float))


def size_between(low: Float64s, high: Float64s) -> float:
    """Return the longest side of a bounding box, or a small positive number for a single point."""
    farthest = float(np.abs([low, high]).max())
    return max(float((high - low).max()), _SMALLEST * farthest, float(np.finfo(float).tiny))


def fitted(positions: Float64s, rotation: Float64s, field: float, aspect: float) -> Camera:
    """Place a camera so that all points, at least one, are visible and fill the view."""
    seen = positions @ rotation.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    size = size_between(low, high)
    shape = np.array([aspect, 1.0]) / min(aspect, 1.0)
    middle = (low + high) / 2
    if field < _NARROWEST:
        half = max(float(((high - low)[:2] / 2 / shape).max()), 1e-6 * size) / _MARGIN
        return Camera(rotation, np.array([*middle[:2], high[2] + size]), half * shape, True)
    reach = np.tan(np.radians(field) / 2) * shape
    # |x - cx| <= T (d - z) for all points: linear in the eye (cx, d), so the outermost planes decide.
    slope = _MARGIN * reach
    centred = seen - middle
    right = (centred[:, :2] + slope * centred[:, 2:]).max(axis=0)
    left = (-centred[:, :2] + slope * centred[:, 2:]).max(axis=0)
    nearest = float(centred[:, 2].max())
    distance = max(float(((right + left) / (2 * slope)).max()), nearest + 0.05 * size)
    eye = middle + np.array([*(right - left) / 2, distance])
    return Camera(rotation, eye, reach, False)


SAMPLES = 3  # rays along a side of each pixel
AMBIENT = 0.35  # share of ambient light
# Direction of the lamp in view coordinates: upper left, behind the eye.
LAMP = np.array([-0.4, 0.5, 0.77]) / np.linalg.norm([-0.4, 0.5, 0.77])

_CREASE = np.cos(np.radians(40))  # smoothed normals further than this from the triangle's are not used
# Rays at a time: arrays of more leave the processor's cache, and memory is asked for again for each of them.
_BLOCK = 1 << 12
_OPAQUE = 0.999  # opacity from which surfaces behind are invisible
_LAYERS = 16  # most transparent surfaces along a ray
_FACE_BYTES = 100  # that Embree takes, besides its threads
_STEP = 1e-5  # in sizes of the model: distance behind a transparent surface at which the ray continues


def require_embree() -> tuple[Any, Any]:
    """Import the two modules that cast rays; ProcessingError says what to install if they are missing."""
    try:
        scenes = importlib.import_module("embreex.rtcore_scene")
        return scenes, importlib.import_module("embreex.mesh_construction")
    except ImportError as error:
        # Linux on ARM, where this package does not ask for it.
        cause = "to draw surfaces, the package embreex is needed"
        raise ProcessingError(f"{cause}; {install_hint('embreex')}") from error


class SurfaceView:
    """A coloured surface of at least one triangle, seen from both sides, to be looked at from anywhere."""

    def __init__(self, positions: Float64s, faces: Int32s, colours: SurfaceColours) -> None:
        scenes, meshes = require_embree()
        self.positions, self.faces = without_unused(positions, faces)
        self._colours = colours
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        # Embree computes in single precision: around the middle and of unit size, large coordinates lose no digits.
        self._middle, self._size = (low + high) / 2, size_between(low, high)
        with memory_reserved(_FACE_BYTES * len(faces)):
            self._scene = scenes.EmbreeScene(robust=True)
            self._mesh = meshes.TriangleMesh(self._scene, self._normalised(self.positions), self.faces)
            self._cast(positions[:1], np.array([[0.0, 0.0, 1.0]]))  # builds the tree now

    def _cast(self, starts: Float64s, directions: Float64s) -> tuple[Int64s, Int32s, Float32s, Float64s]:
        """Return which rays hit, (K,), and the faces, barycentric weights, (K, 3), and distances of these places."""
        # Rays from an eye have one start, which is normalised once.
        origins = self._normalised(starts if starts.strides[0] else starts[:1])
        origins = np.ascontiguousarray(np.broadcast_to(origins, starts.shape))
        found = self._scene.run(origins, np.ascontiguousarray(directions, np.float32), output=1)
        rays = np.flatnonzero(found["primID"] >= 0)
        faces, u, v, distances = (found[name][rays] for name in ("primID", "u", "v", "tfar"))
        return rays, faces, np.stack([1 - u - v, u, v], axis=1), distances.astype(np.float64) * self._size

    def _normalised(self, positions: Float64s) -> Float32s:
        return np.ascontiguousarray((positions - self._middle) / self._size, np.float32)

    def draw(self, camera: Camera, size: tuple[int, int], window: Window, *, lit: bool) -> Float32s:
        """Draw a window of a view, `size` = (width, height) pixels: linear light times opacity, and opacity."""
        width, height = size
        image = np.zeros((height, width, 4), np.float32)
        shares = [(np.arange(side * SAMPLES) + 0.5) / (side * SAMPLES) for side in size]
        x, y = (window[k] + (window[k + 2] - window[k]) * share for k, share in enumerate(shares))
        left, upper, right, lower = self._covered(camera, size, window)
        x, y, pixel = x[left * SAMPLES : right * SAMPLES], y[upper * SAMPLES : lower * SAMPLES], x[1] - x[0]
        for rows in blocks(lower - upper, max(1, _BLOCK // width)):
            # One ray through each pixel at a time, so that sums go over whole blocks.
            down, part = y[rows.start * SAMPLES : rows.stop * SAMPLES, None], image[upper:, left:right][rows]
            for row, column in np.ndindex(SAMPLES, SAMPLES):
                starts, directions = camera.rays(x[column::SAMPLES], down[row::SAMPLES], np.float32)
                part += self._seen(camera, starts, directions, pixel, lit=lit).reshape(part.shape)
            part /= SAMPLES**2
        return image

    def _covered(self, camera: Camera, size: tuple[int, int], window: Window) -> list[int]:
        """Return first and last (exclusive) column and row of the pixels that may show the surface."""
        places, depths = camera.project(self.positions)
        if not camera.is_orthographic and depths.min() <= 0:
            return [0, 0, *size]
        corner, extent = np.array(window[:2]), np.subtract(window[2:], window[:2])
        low, high = ((each - corner) / extent * size for each in (places.min(axis=0), places.max(axis=0)))
        first, last = np.floor(low) - 1, np.ceil(high) + 1  # a pixel more, as rays are rounded
        return [int(each) for each in np.clip([*first, *last], 0, [*size, *size])]

    def _seen(
        self, camera: Camera, starts: Float64s, directions: Float64s, pixel: float, *, lit: bool
    ) -> Float32s:  # fmt: skip
        """Return the light along rays, (K, 4), also through transparent surfaces."""
        seen = np.zeros((len(starts), 4), np.float32)
        active = np.arange(len(starts))
        travelled = np.zeros(len(starts))
        for _ in range(_LAYERS):
            rays, faces, weights, distances = self._cast(starts, directions)
            directions, active = directions[rays], active[rays]
            travelled = travelled[rays] + distances
            colours = self._colours(faces, weights, (camera.breadth(travelled) * pixel) ** 2)
            if lit:
                colours[:, :3] *= self._light(camera, faces, weights, directions)[:, None]
            if self._colours.is_opaque:
                seen[active] = colours
                break
            total = seen[active]
            total += (1 - total[:, 3:]) * colours
            seen[active] = total
            on = np.flatnonzero(total[:, 3] < _OPAQUE)
            if not len(on):
                break
            starts = starts[rays]
            step = _STEP * self._size
            starts = starts[on] + (distances[on] + step)[:, None] * directions[on]
            directions, active, travelled = directions[on], active[on], travelled[on] + step
        return seen

    def _light(self, camera: Camera, faces: Int32s, weights: Float32s, directions: Float64s) -> Float32s:
        normals = np.einsum("kc,kcx->kx", weights, self._corner_normals[faces])
        normals /= np.maximum(np.sqrt(np.einsum("kx,kx->k", normals, normals)), 1e-30)[:, None]
        away = np.einsum("kx,kx->k", self._face_normals[faces], directions) > 0
        towards = normals @ (LAMP @ camera.rotation).astype(np.float32)
        lambert = np.maximum(np.where(away, -towards, towards), 0)
        return np.asarray(AMBIENT + (1 - AMBIENT) * lambert, np.float32)

    @cached_property
    def _face_normals(self) -> Float32s:
        corners = self.positions[self.faces]
        crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.asarray(unit_vectors(crosses), np.float32)

    @cached_property
    def _corner_normals(self) -> Float32s:
        """Normals of the corners of triangles, (F, 3, 3): smooth, except at creases."""
        place_of, _ = group_equal_rows(*self.positions.T)
        smooth = vertex_normals(self.positions, self.faces, place_of).astype(np.float64)[self.faces]
        flat = self._face_normals[:, None, :]
        creased = (smooth * flat).sum(axis=2, keepdims=True) < _CREASE
        return np.asarray(np.where(creased, flat, smooth), np.float32)
