"""A vase whose two halves, left and right, show the same texels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baking import baked
from nonmanifold import grid_triangles
from samples import normalised
from textured import Texture, TexturedSample

Array = NDArray[np.float64]
AROUND, UP = 20, 36  # edges about each half, and along the profile
SIZE, GUTTER = (256, 320), 4
PROFILE = np.array([  # radius and height
    (0.150, 0.000), (0.152, 0.020), (0.120, 0.045), (0.092, 0.075), (0.120, 0.130), (0.215, 0.260), (0.278, 0.400),
    (0.292, 0.520), (0.262, 0.650), (0.170, 0.760), (0.112, 0.830), (0.100, 0.890), (0.112, 0.945), (0.160, 0.985),
    (0.168, 1.000),
])  # fmt: skip
KEY = np.array([[int(c) for c in row] for row in (
    "1111111111", "0000000000", "1111111110", "1000000010", "1011111010", "1010001010",
    "1010111010", "1010000010", "1011111110", "0000000000", "1111111111",
)])  # fmt: skip


def make() -> TexturedSample:
    """Return the vase, open above and below, symmetric about the plane x = 0."""
    along = np.linspace(0, 1, UP + 1)
    knots = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(PROFILE, axis=0), axis=1))])
    radius, height = (np.interp(along, knots / knots[-1], column) for column in PROFILE.T)
    for _ in range(3):
        radius[1:-1] = (radius[:-2] + 2 * radius[1:-1] + radius[2:]) / 4
    i, j = np.mgrid[: 2 * AROUND, : UP + 1]
    # Vertex columns run from the back over the right, the front and the left to the back.
    theta = np.pi * i / AROUND
    points = np.stack([radius[j] * np.sin(theta), height[j] + 0 * theta, -radius[j] * np.cos(theta)], axis=-1)
    positions = normalised(points.reshape(-1, 3))
    vertices, corners = [], []
    for half in range(2):
        i, j = np.mgrid[: AROUND + 1, : UP + 1]
        here = (i + half * AROUND) % (2 * AROUND)
        vertices.append(grid_triangles(here * (UP + 1) + j)[:, ::-1])
        # Both halves run from the back to the front in the image.
        corners.append(grid_triangles((AROUND - i if half else i) * (UP + 1) + j)[:, ::-1])
    flat = np.column_stack([1 - i.ravel() / AROUND, 1 - j.ravel() / UP])
    coordinates = np.round(0.5 + (flat - 0.5) * (1 - 2 * GUTTER / np.array(SIZE)), 6)
    right = positions[vertices[0]], coordinates[corners[0]]
    texture = Texture("clay", *baked(pattern, *right, SIZE, GUTTER), "png8")
    both = np.concatenate(vertices), np.concatenate(corners)
    return TexturedSample(positions, coordinates, *both, np.zeros(len(both[0]), np.int64), (texture,))


def pattern(positions: Array) -> Array:
    """Return the grey, shape (K, 1) in [0, 1]: bands of ornament in glaze on clay."""
    x, y, z = positions.T
    # A quarter of a turn to either side of the front is 1; the ornament is symmetric about front and back.
    turn = np.arctan2(np.abs(x), z) / (np.pi / 2)
    light = 0.06 * np.cos(2.2 * turn) + 0.10 * y
    clay, glaze = 0.74 + light, 0.16 + 0.5 * light
    dark = np.zeros(len(y), bool)
    for low, high in ((-0.50, -0.455), (-0.10, -0.085), (0.035, 0.05), (0.285, 0.30), (0.47, 0.50)):
        dark |= (y > low) & (y < high)
    rays = np.abs(np.mod(turn * 8, 1) - 0.5) * 2
    dark |= (y > -0.43) & (y < -0.25) & (rays < (-0.25 - y) / 0.18)
    key = (y > -0.085) & (y < 0.035)
    row = np.clip(np.floor((0.035 - y) / 0.12 * len(KEY)).astype(int), 0, len(KEY) - 1)
    column = np.floor(np.mod(turn * 7, 1) * KEY.shape[1]).astype(int)
    dark |= key & (KEY[row, column] == 1)
    wave = 0.135 + 0.022 * np.sin(np.pi * 10 * turn + np.pi / 2)
    dark |= np.abs(y - wave) < 0.012
    tongue = np.mod(turn * 9, 1) - 0.5
    low = 0.205 + 0.06 * (2 * tongue) ** 2
    dark |= (y > low) & (y < 0.285) & (np.abs(tongue) < 0.36)
    dark |= (
        (y > 0.33)
        & (y < 0.45)
        & (np.abs(np.mod(turn * 6 + 0.5, 1) - 0.5) < 0.16 * np.sin((y - 0.33) / 0.12 * np.pi))
    )
    return np.where(dark, glaze, clay)[:, None]
