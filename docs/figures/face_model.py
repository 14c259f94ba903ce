"""A face as a range scanner sees it: a colour image and a height for each of its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

UNIT = 100  # pixels; half the width of the head
WIDTH, HEIGHT = 180, 232
LIGHT = np.array([-0.45, -0.55, 0.70])
NOISE = 8 / 255
EYE, MOUTH = (0.37, -0.27), (0.0, 0.53)


@dataclass(frozen=True)
class Face:
    """A face.

    Attributes
    ----------
    clean, noisy : ndarray of float64, shape (H, W, 3)
        Display values without and with the noise of a camera.
    heights : ndarray of float64, shape (H, W)
        Towards the camera, in pixels.
    forehead, lips, nose : ndarray of bool, shape (H, W)
        Parts of it.
    """

    clean: Array
    noisy: Array
    heights: Array
    forehead: Mask
    lips: Mask
    nose: Mask

    @property
    def slopes(self) -> Array:
        """Height gained for each pixel of the image, shape (H, W)."""
        return np.hypot(*np.gradient(self.heights))


def make_face() -> Face:
    """Return the face, always the same."""
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    u, v = (x - (WIDTH - 1) / 2) / UNIT, (y - (HEIGHT - 1) / 2) / UNIT
    heights = UNIT * shape(u, v)
    clean = np.clip(pattern(u, v) * lighting(heights)[..., None], 0, 1)
    noise = np.random.default_rng(5).normal(0, NOISE, clean.shape)
    return Face(
        clean,
        np.clip(clean + noise, 0, 1),
        heights,
        forehead=(np.abs(u) < 0.4) & (np.abs(v + 0.78) < 0.14),
        lips=np.abs(lip_line(u, v)) < 1.2,
        nose=(np.abs(u) < 0.24) & (np.abs(v - 0.05) < 0.22),
    )


def bump(u: Array, v: Array, at: tuple[float, float], width: float, height: float) -> Array:
    """Return a Gaussian hill of the given standard deviations."""
    return np.exp(-(((u - at[0]) / width) ** 2 + ((v - at[1]) / height) ** 2) / 2)


def shape(u: Array, v: Array) -> Array:
    """Return heights over the image, in units of half a head: an egg with brows, eyes, nose, lips and chin."""
    side = np.abs(u)
    z = 0.85 * np.sqrt(1 - (u / 1.30) ** 2 - (v / 1.75) ** 2)
    z += 0.07 * bump(side, v, (0.33, -0.46), 0.22, 0.06)
    z -= 0.13 * bump(side, v, (0.38, -0.28), 0.18, 0.11)
    z += 0.11 * bump(side, v, EYE, 0.105, 0.075)
    z += 0.07 * bump(side, v, (0.52, 0.03), 0.17, 0.17)
    bridge = 0.13 * bump(u, v, (0, -0.22), 0.065, 0.20) + 0.20 * bump(u, v, (0, 0.02), 0.085, 0.16)
    tip = 0.16 * bump(u, v, (0, 0.10), 0.10, 0.09) + 0.13 * bump(side, v, (0.14, 0.15), 0.055, 0.05)
    z += (bridge + tip) / (1 + np.exp((v - 0.215) / 0.018))  # the nose ends in an edge
    # Each lip bulges, falls off at its border, and dives where they meet.
    line = lip_line(u, v)
    lips = np.clip(1 - line**2, 0, 1) ** 0.5
    z += 0.085 * lips - 0.05 * np.exp(-((line / 0.12) ** 2))
    z += 0.10 * bump(u, v, (0, 0.93), 0.22, 0.12)
    return z


def lip_line(u: Array, v: Array) -> Array:
    """Return 0 where the lips meet, -1 at the border of the upper and 1 at that of the lower one."""
    across = np.clip(1 - (u / 0.30) ** 2, 1e-3, 1)
    below = v - MOUTH[1] + 0.10 * u**2
    upper = 0.088 * across**0.7 * (1 - 0.25 * np.exp(-((u / 0.04) ** 2)))
    line = np.where(below < 0, below / upper, below / (0.105 * across**0.8))
    return np.where(np.abs(u) < 0.30, line, np.inf)


def pattern(u: Array, v: Array) -> Array:
    """Return the colours of the skin, the lips, the eyes, the brows and the hair, without light."""
    side = np.abs(u)
    spots = np.random.default_rng(3).normal(0, 1, (60, 2)) * [0.35, 0.10] + [0, 0.08]
    freckles = sum(bump(u, v, (a, b), 0.008, 0.008) for a, b in spots)
    colours = np.array([0.95, 0.76, 0.66]) - 0.10 * np.asarray(freckles)[..., None] * [1, 1.2, 1.2]
    colours -= 0.5 * bump(side, v, (0.5, 0.10), 0.15, 0.12)[..., None] * [0.02, 0.20, 0.16]

    def fill(where: Mask, rgb: tuple[float, float, float]) -> None:
        colours[where] = rgb

    line = lip_line(u, v)
    fill(np.abs(line) < 1, (0.80, 0.36, 0.36))
    fill(np.abs(line) < 0.10, (0.45, 0.15, 0.16))
    brow = -0.47 + 0.55 * (side - 0.33) ** 2
    fill((np.abs(v - brow) < 0.030) & (np.abs(side - 0.35) < 0.19), (0.34, 0.22, 0.15))
    across, down = (side - EYE[0]) / 0.135, (v - EYE[1]) / 0.055
    eye = np.abs(down) < np.clip(1 - across**2, 0, 1)
    fill((np.abs(down) < 1.25 * np.clip(1.15 - across**2, 0, 1)) & ~eye & (down < 0), (0.40, 0.25, 0.20))
    fill(eye, (0.96, 0.95, 0.93))
    iris = np.hypot((side - EYE[0]), v - EYE[1])
    fill(eye & (iris < 0.058), (0.25, 0.45, 0.55))
    fill(eye & (iris < 0.024), (0.04, 0.04, 0.05))
    hair = v + 1.02 - 0.10 * u**2 + 0.012 * np.sin(40 * u)
    fill(hair < 0, (0.42, 0.28, 0.18))
    return colours


def lighting(heights: Array) -> Array:
    """Return how bright each pixel is under a lamp at the upper left."""
    down, across = np.gradient(heights)
    normals = np.stack([-across, -down, np.ones_like(heights)], axis=2)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return 0.45 + 0.60 * np.clip(normals @ (LIGHT / np.linalg.norm(LIGHT)), 0, 1)
