"""A scanned pumpkin: irregular triangles, nothing below, a hundred ragged charts, and a JPEG."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import head
from baking import baked, covering, grown
from charts import segmented
from packing import unwrapped
from samples import normalised
from solid_noise import fractal, solid_noise
from textured import Texture, TexturedSample

Array = NDArray[np.float64]
FREQUENCY, ROUNDS = 11, 6
CHARTS = 114
SIZE, SCALE, GUTTER = 512, 218.0, 4
SEED = 31
GAINS, OFFSET, EXPOSURE_SEED = (0.82, 1.12), 10 / 255, 1
RIBS = 9
STALK = 0.13  # radius, where the whole is 1 wide


def make() -> TexturedSample:
    """Return the pumpkin, as photogrammetry would make it."""
    random = np.random.Generator(np.random.PCG64(SEED))
    sphere, faces = irregular(random)
    raw = surface(sphere)
    # A scan ends where the thing stands on the table.
    faces = faces[(raw[faces][:, :, 1] > -0.30).all(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)
    positions = normalised(raw[used])
    chart_of = segmented(positions, faces, CHARTS, random, ragged=0.9, delay=0.8)
    coordinates, corners = unwrapped(positions, faces, chart_of, SIZE, SCALE, GUTTER, random)
    pixels, filled = baked(pattern, positions[faces], coordinates[corners], (SIZE, SIZE), GUTTER)
    texture = Texture("scan", pixels, filled, "jpeg")
    return TexturedSample(positions, coordinates, faces, corners, np.zeros(len(faces), np.int64), (texture,))


def exposed(sample: TexturedSample) -> TexturedSample:
    """Give every chart a gain and an offset in each channel, as photographs of differing exposure do.

    Stored as PNG: JPEG would mix the colours of neighbouring charts at their borders.
    """
    (texture,) = sample.textures
    covered = covering(sample.coordinates[sample.corners] * (SIZE, SIZE), (SIZE, SIZE))
    chart = connected(sample.corners, len(sample.coordinates))[grown(covered, GUTTER)]
    random = np.random.Generator(np.random.PCG64(EXPOSURE_SEED))
    gain = random.uniform(*GAINS, (chart.max() + 1, 3))
    offset = random.uniform(-OFFSET, OFFSET, gain.shape)
    pixels = np.where(texture.filled[:, :, None], texture.pixels * gain[chart] + offset[chart], 0)
    return replace(sample, textures=(replace(texture, pixels=pixels, kind="png8"),))


def connected(corners: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the number of the chart of each triangle: triangles of a chart share rows of texture coordinates."""
    lowest, before = np.arange(count), np.zeros(0)
    while not np.array_equal(lowest, before):
        before = lowest.copy()
        np.minimum.at(lowest, corners, lowest[corners].min(axis=1, keepdims=True))
    return np.unique(lowest[corners[:, 0]], return_inverse=True)[1]


def irregular(random: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
    """Return a unit sphere of triangles of many sizes: shaken, then some of the longest edges cut again and again."""
    sphere, polygons = head.geodesic_sphere(FREQUENCY)
    faces = np.array(polygons)
    sphere = onto_sphere(np.round(sphere + random.uniform(-0.25, 0.25, sphere.shape) / FREQUENCY, 6))
    for _ in range(ROUNDS):
        sphere, faces = cut(sphere, faces, random)
    return sphere, faces


def cut(
    sphere: Array, faces: NDArray[np.int64], random: np.random.Generator
) -> tuple[Array, NDArray[np.int64]]:
    """Cut some of the edges that are the longest of both of their triangles, each at a random place."""
    ends = np.roll(faces, -1, axis=1)
    longest = np.argmax(np.round(np.linalg.norm(sphere[ends] - sphere[faces], axis=2), 6), axis=1)
    row = np.arange(len(faces))
    # Turned so that the longest edge comes first.
    faces = np.stack([faces[row, (longest + k) % 3] for k in range(3)], axis=1)
    edge, edge_of, count = np.unique(
        np.sort(faces[:, :2], axis=1), axis=0, return_inverse=True, return_counts=True
    )
    chosen = (count == 2) & (random.random(len(edge)) < 0.22)
    place = random.uniform(0.35, 0.65, (len(edge), 1))
    middle = place * sphere[edge[:, 0]] + (1 - place) * sphere[edge[:, 1]]
    new = np.cumsum(chosen) - 1 + len(sphere)
    halved = chosen[edge_of.reshape(-1)]
    (a, b, c), m = faces[halved].T, new[edge_of.reshape(-1)][halved]
    parts = [faces[~halved], np.stack([a, m, c], axis=1), np.stack([m, b, c], axis=1)]
    return np.concatenate([sphere, onto_sphere(np.round(middle[chosen], 6))]), np.concatenate(parts)


def onto_sphere(points: Array) -> Array:
    """Return the points at the distance 1 from the origin."""
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def surface(sphere: Array) -> Array:
    """Return the pumpkin over the unit sphere, shape (V, 3): ribs, a dent on top, a crooked stalk."""
    x, y, z = sphere.T
    flat = np.hypot(x, z)
    rib = np.abs(np.cos(RIBS / 2 * np.arctan2(z, x))) ** 0.7
    radius = 0.5 * (0.86 + 0.14 * rib * flat**0.5) * (1 + 0.03 * solid_noise(sphere, 1.4, 71))
    points = radius[:, None] * sphere * (1, 0.78, 1)
    points[:, 1] -= 0.10 * np.exp(-((flat / 0.28) ** 2)) * np.sign(y)
    rise = np.clip((0.21 - flat) / 0.09, 0, 1) * (y > 0)
    rise = rise * rise * (3 - 2 * rise)
    points[:, 1] += 0.24 * rise
    points[:, 0] += 0.07 * rise**2
    return points


def pattern(positions: Array) -> Array:
    """Return the colours, shape (K, 3) in [0, 1]: an orange skin with pores and green flecks, and a woody stalk."""
    x, y, z = positions.T
    groove = 1 - np.abs(np.cos(RIBS / 2 * np.arctan2(z, x))) ** 0.7
    patchy = fractal(positions, 5, 101, 3)
    skin = np.array([0.88, 0.50, 0.12]) + patchy[:, None] * np.array([0.05, 0.07, 0.04])
    skin = skin - (groove * 0.9)[:, None] * np.array([0.16, 0.16, 0.05])
    skin += (0.18 * y)[:, None] * np.array([0.4, 0.6, 0.3])
    green = np.clip((fractal(positions, 7, 201, 2) - 0.45 + 0.35 * y) * 5, 0, 1)
    skin += (0.75 * green)[:, None] * (np.array([0.44, 0.48, 0.16]) - skin)
    pore = solid_noise(positions, 30, 301) > 0.62
    skin[pore] -= 0.10
    pale = solid_noise(positions, 22, 302) > 0.68
    skin[pale] += np.array([0.06, 0.16, 0.18])
    grain = solid_noise(positions * (3, 0.4, 3), 16, 401)[:, None]
    wood = np.array([0.46, 0.44, 0.26]) + grain * np.array([0.13, 0.12, 0.09])
    tip = np.clip((y - 0.36) * 12, 0, 1)[:, None]
    wood += 0.7 * tip * (np.array([0.62, 0.52, 0.36]) - wood)
    base = np.hypot(x - 0.01, z) - STALK - 0.02 * np.cos(5 * np.arctan2(z, x))
    return np.where(((base < 0) & (y > 0.15))[:, None], wood, skin)
