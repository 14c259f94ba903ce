"""Textured surfaces for the benchmarks: which texels they cover, which of them are near seams, and noise on them.

The rasteriser and the seams are made here in NumPy, so that nothing is judged by the package's own atlas.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scene import SIGMA, chequer
from scipy.ndimage import distance_transform_edt
from texture_files import read_image

from beltrami_cli.formats.registry import open_document

NEAR = 4  # texels
SMALLEST = 64  # texels; smaller images are palettes


@dataclass(frozen=True)
class TexturedScene:
    """A textured surface without noise.

    Attributes
    ----------
    name : str
        Of the model.
    corners : ndarray of float64, shape (F, 3, 3)
        Positions of the triangles' corners.
    uv : ndarray of float64, shape (F, 3, 2)
        Texture coordinates, v down; they may leave [0, 1], where images repeat.
    texture_of : ndarray of int64, shape (F,)
        Index into `clean`.
    clean : list of ndarray of float32, shape (H, W, 3)
        Display values in [0, 1].
    visible : list of ndarray of bool, shape (H, W)
        Where alpha is not 0.
    """

    name: str
    corners: np.ndarray
    uv: np.ndarray
    texture_of: np.ndarray
    clean: list
    visible: list

    @cached_property
    def covered(self):
        """Per image, the visible texels whose centre lies in a triangle."""
        found = []
        for number, image in enumerate(self.clean):
            mine = self.texture_of == number
            seen = rasterised(self.uv[mine] * image.shape[1::-1], image.shape[1::-1])
            found.append(seen & self.visible[number])
        return found

    @cached_property
    def near_seams(self):
        """Per image, the covered texels within `NEAR` texels of a seam."""
        faces, ends = seams(self.corners, self.uv, self.texture_of)
        found = []
        for number, image in enumerate(self.clean):
            lines = ends[self.texture_of[faces] == number] * image.shape[1::-1]
            found.append(self.covered[number] & close_to(lines, image.shape[1::-1]))
        return found

    @cached_property
    def noisy(self):
        """Per image, 8-bit pixels with noise on all texels, covered or gutter.

        A filter on the flat image reaches far into the gutter, and must not find the truth there.
        """
        random = np.random.default_rng(11)
        noise = (SIGMA * random.standard_normal(image.shape) for image in self.clean)
        noisy = (image + added for image, added in zip(self.clean, noise, strict=True))
        return [np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8) for image in noisy]


def from_file(path):
    """Return the textured surface of a file; images that are no pictures are left out."""
    surface = open_document(str(path)).textured("baseColor")
    decoded = [read_image(texture.data, texture.name) for texture in surface.textures]
    large = [min(pixels.shape[:2]) >= SMALLEST for pixels, _ in decoded]
    index = np.append(np.where(large, np.cumsum(large) - 1, -1), -1)
    texture_of = index[surface.texture_of]
    kept = texture_of >= 0
    clean, visible = ([one[k] for one, keep in zip(decoded, large, strict=True) if keep] for k in range(2))
    corners = surface.positions[surface.faces[kept]]
    return TexturedScene(path.name, corners, surface.uv[kept], texture_of[kept], clean, visible)


def torus(size, charts=4, cuts=16):
    """Return a torus in charts * charts square charts, shuffled and turned by right angles, on one image."""
    random = np.random.default_rng(5)
    cell = size // charts
    flat = np.stack(np.mgrid[: cuts + 1, : cuts + 1], axis=-1) / cuts
    a, b, c, d = (flat[i, j].reshape(-1, 2) for i, j in cells())
    local = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    gutter = NEAR / cell
    corners, uv, clean = [], [], np.zeros((size, size, 3), np.float32)
    centre = (np.stack(np.mgrid[:cell, :cell], axis=-1)[:, :, ::-1] + 0.5) / cell
    for number, place in enumerate(random.permutation(charts**2).tolist()):
        at, where = np.array(divmod(number, charts)), np.array(divmod(place, charts))
        turn = int(random.integers(4))
        corners.append(on_torus((local + at) / charts))
        inset = rotated(local, turn) * (1 - 2 * gutter) + gutter
        uv.append((inset + where) / charts)
        # The gutter continues the painting, which is a function of place.
        back = rotated((centre - gutter) / (1 - 2 * gutter), -turn)
        # Moved, so that no border of the pattern lies along a seam.
        painted = chequer(on_torus((back + at) / charts).reshape(-1, 3) * 1.6 + (0.13, 0.09, 0.06))
        x, y = where * cell
        clean[y : y + cell, x : x + cell] = painted.reshape(cell, cell, 3)
    corners, uv = np.concatenate(corners), np.concatenate(uv)
    everywhere = [np.ones((size, size), bool)]
    return TexturedScene("torus", corners, uv, np.zeros(len(uv), np.int64), [clean], everywhere)


def cells():
    """Return the slices of a grid of points that are the four corners of its cells."""
    near, far = slice(None, -1), slice(1, None)
    return (near, near), (far, near), (far, far), (near, far)


def rotated(uv, quarters):
    """Return coordinates of the unit square turned by right angles about its centre."""
    for _ in range(quarters % 4):
        uv = np.stack([1 - uv[..., 1], uv[..., 0]], axis=-1)
    return uv


def on_torus(uv):
    """Return places on a torus, rounded so that the same place is the same number in every chart."""
    u, v = 2 * np.pi * uv[..., 0], 2 * np.pi * uv[..., 1]
    reach = 0.7 + 0.3 * np.cos(v)
    return np.round(np.stack([reach * np.cos(u), reach * np.sin(u), 0.3 * np.sin(v)], axis=-1), 6) + 0.0


def rasterised(triangles, size):
    """Return which texels have their centre in one of the triangles (in texels), shape (H, W)."""
    width, height = size
    seen = np.zeros((height, width), bool)
    # Whole repeats are taken off, so that far tiles cost nothing.
    triangles = triangles - np.floor(triangles.min(axis=1, keepdims=True) / size) * size
    low, high = (
        np.ceil(triangles.min(axis=1) - 0.5).astype(int),
        np.floor(triangles.max(axis=1) - 0.5).astype(int),
    )
    for (a, b, c), (left, top), (right, bottom) in zip(triangles, low, high, strict=True):
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if right < left or bottom < top or abs(area) < 1e-12:
            continue
        x, y = np.arange(left, right + 1) + 0.5, np.arange(top, bottom + 1)[:, None] + 0.5
        inside = np.ones((len(y), len(x)), bool)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= ((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])) / area >= -1e-9
        rows, columns = np.nonzero(inside)
        seen[(rows + top) % height, (columns + left) % width] = True
    return seen


def seams(corners, uv, texture_of):
    """Return the faces at seams and the ends of the seam edges in their texture, shapes (S,) and (S, 2, 2)."""
    _, place = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    place = place.reshape(-1, 3)
    face, k = (part.ravel() for part in np.mgrid[: len(place), :3])
    ends = np.stack([place[face, k], place[face, (k + 1) % 3]], axis=1)
    sides = np.stack([uv[face, k], uv[face, (k + 1) % 3]], axis=1)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], sides[turned] = ends[turned, ::-1], sides[turned, ::-1]
    _, edge, count = np.unique(ends, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    first = np.full(len(count), -1)
    first[edge[::-1]] = np.arange(len(edge))[::-1]
    other = first[edge]
    differ = (np.abs(sides - sides[other]) > 1e-6).any(axis=(1, 2)) | (
        texture_of[face] != texture_of[face[other]]
    )
    is_seam = np.zeros(len(count), bool)
    np.logical_or.at(is_seam, edge, differ)
    at_seam = is_seam[edge] & (ends[:, 0] != ends[:, 1])
    return face[at_seam], sides[at_seam]


def close_to(lines, size):
    """Return the texels whose centre is within `NEAR` texels of one of the lines, shape (L, 2, 2), in texels."""
    width, height = size
    if not len(lines):
        return np.zeros((height, width), bool)
    steps = int(np.ceil(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).max() * 2)) + 1
    drawn = np.zeros((height, width), bool)
    for part in np.linspace(0, 1, min(steps, 4096)):
        x, y = np.floor((1 - part) * lines[:, 0] + part * lines[:, 1]).astype(int).T
        drawn[y % height, x % width] = True
    return distance_transform_edt(~drawn) <= NEAR
