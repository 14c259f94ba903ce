"""A doughnut of two materials: its icing runs down over the seam between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from baking import baked
from nonmanifold import grid_triangles
from samples import normalised
from solid_noise import fractal, solid_noise
from textured import Texture, TexturedSample

Array = NDArray[np.float64]
AROUND, ACROSS = 64, 12  # edges along the ring, and over each half of the tube
RING, TUBE = 0.335, 0.165  # radii, where the whole is 1 wide
SIZES = {"icing": (512, 136), "dough": (320, 88)}
GUTTER = 4
SPRINKLES = 120
SPRINKLE = (0.019, 0.0062)  # half its length, and its radius
PALETTE = np.array(
    [(0.96, 0.93, 0.86), (0.98, 0.80, 0.22), (0.32, 0.62, 0.84), (0.42, 0.70, 0.36), (0.46, 0.20, 0.16)]
)
SEED = 12


def make() -> TexturedSample:
    """Return the torus; the upper half of the tube is icing, the lower dough, each image is one chart."""
    side = 2 * ACROSS
    ring, tube = (part.ravel() for part in np.mgrid[:AROUND, :side])
    theta, phi = 2 * np.pi * ring / AROUND, 2 * np.pi * tube / side
    reach = RING + TUBE * np.cos(phi)
    positions = normalised(
        np.column_stack([reach * np.cos(theta), TUBE * np.sin(phi), reach * np.sin(theta)])
    )
    coordinates, vertices, corners, textures = [], [], [], []
    for half, (name, size) in enumerate(SIZES.items()):
        i, j = np.mgrid[: AROUND + 1, : ACROSS + 1]
        vertices.append(grid_triangles(i % AROUND * side + (j + half * ACROSS) % side)[:, ::-1])
        corners.append(grid_triangles(i * (ACROSS + 1) + j)[:, ::-1])
        inside = 1 - 2 * GUTTER / np.array(size)
        # Seen from outside, theta runs to the left and phi up.
        flat = np.column_stack([1 - i.ravel() / AROUND, 1 - j.ravel() / ACROSS])
        coordinates.append(np.round(0.5 + (flat - 0.5) * inside, 6))
        places = positions[vertices[half]], coordinates[half][corners[half]]
        textures.append(Texture(name, *baked(pattern, *places, size, GUTTER), "png8"))
    material_of = np.repeat([0, 1], len(vertices[0]))
    corners[1] = corners[1] + len(coordinates[0])
    parts = map(np.concatenate, (coordinates, vertices, corners))
    return TexturedSample(positions, *parts, material_of, tuple(textures))


def pattern(positions: Array) -> Array:
    """Return the colours, shape (K, 3) in [0, 1]: pink icing with sprinkles over golden dough with a pale ring."""
    x, y, z = positions.T
    theta, out = np.arctan2(z, x), np.hypot(x, z) - RING
    phi = np.arctan2(y, out)
    crumb = fractal(positions, 14, 61, 2)[:, None]
    height = (y / TUBE)[:, None]
    dough = np.array([0.80, 0.54, 0.28]) + crumb * np.array([0.05, 0.06, 0.06]) + 0.10 * height
    ring = np.exp(-(((height + 0.22) / 0.16) ** 2))
    dough += ring * np.array([0.13, 0.20, 0.24])
    runs = 0.30 * np.sin(7 * theta + 1.2 * np.sin(2 * theta)) + 0.12 * np.sin(17 * theta + 1)
    edge = np.where(out > 0, -0.18 + runs, -0.06 + 0.5 * runs)
    shine = np.exp(-(((phi - 1.15) / 0.28) ** 2))[:, None]
    icing = np.array([0.90, 0.48, 0.62]) + shine * np.array([0.07, 0.16, 0.13]) + 0.05 * height
    icing += solid_noise(positions, 5, 62)[:, None] * np.array([0.02, 0.03, 0.02])
    colours = np.where((y / TUBE > edge)[:, None], icing, dough)
    random = np.random.Generator(np.random.PCG64(SEED))
    for _ in range(SPRINKLES):
        at_theta, at_phi, turn = random.uniform((0, 0.35, 0), (2 * np.pi, np.pi - 0.45, np.pi))
        along = (np.mod(theta - at_theta + np.pi, 2 * np.pi) - np.pi) * (RING + out)
        over = (phi - at_phi) * TUBE
        length = along * np.cos(turn) + over * np.sin(turn)
        beyond = np.maximum(np.abs(length) - SPRINKLE[0], 0)
        colours[np.hypot(beyond, along * np.sin(turn) - over * np.cos(turn)) < SPRINKLE[1]] = random.choice(
            PALETTE
        )
    return colours
