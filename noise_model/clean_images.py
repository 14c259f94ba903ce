"""Clean training images, drawn from crops of files."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

MakeImage = Callable[[np.random.Generator, np.ndarray], np.ndarray]  # makes a clean image from a crop

PAINTED = 5, 40  # range of texels between edges of paint


def random_image(rng: np.random.Generator, pixels: np.ndarray, paint: float = 0.0) -> np.ndarray:
    """Draw a clean image from a crop; a share of the images is hard-edged paint."""
    if paint and rng.random() < paint:
        return painted(rng, *pixels.shape[:2])
    return varied(rng, drawn(rng, pixels))


def drawn(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Return the crop itself, or an image made from it of another kind that games and scans contain."""
    choice = rng.random()
    return next(make for limit, make in IMAGES if choice < limit)(rng, pixels)


def _unchanged(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    return pixels / np.float32(255)


def _text(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    height, width = pixels.shape[:2]
    paper = Image.new("RGB", (width, height), _random_colour(rng))
    pen = ImageDraw.Draw(paper)
    for _ in range(int(rng.integers(2, 40))):
        letters = "".join(chr(code) for code in rng.integers(33, 126, rng.integers(3, 40)))
        at, size = rng.integers(-20, max(height, width), 2), float(rng.uniform(7, 40))
        pen.text((int(at[0]), int(at[1])), letters, _random_colour(rng), font_size=size)
    return _colours_of(paper)


def _random_colour(rng: np.random.Generator) -> tuple[int, ...]:
    return tuple(int(level) for level in rng.integers(0, 256, 3))


def _quantised(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Reduce an image to few colours, dithered or not, or replace them by random ones."""
    method = Image.Dither.FLOYDSTEINBERG if rng.random() < 0.6 else Image.Dither.NONE
    image = Image.fromarray(pixels).quantize(int(rng.integers(2, 64)), dither=method)
    if rng.random() < 0.4:
        image.putpalette([int(level) for level in rng.integers(0, 256, 768)])
    return _colours_of(image.convert("RGB"))


def _with_ordered_dither(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    height, width = pixels.shape[:2]
    bayer = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16
    threshold = np.tile(bayer, (height // 4 + 1, width // 4 + 1))[:height, :width, None]
    levels = rng.integers(1, 6)
    return (np.floor(pixels / 255 * levels + threshold).clip(0, levels) / levels).astype(np.float32)


def _pixel_art(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    height, width = pixels.shape[:2]
    scale = int(rng.integers(2, 9))
    size = max(1, width // scale), max(1, height // scale)
    small = Image.fromarray(pixels).resize(size, Image.Resampling.NEAREST).quantize(int(rng.integers(3, 32)))
    return _colours_of(small.convert("RGB").resize((width, height), Image.Resampling.NEAREST))


def _normal_map(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Draw the normal map of the relief that the brightness would be."""
    relief = pixels.mean(axis=2) / 255 * rng.uniform(0.3, 8)
    down, across = np.gradient(relief)
    normal = np.stack([-across, down, np.ones_like(relief)], axis=2)
    return (normal / np.linalg.norm(normal, axis=2, keepdims=True) / 2 + 0.5).astype(np.float32)


def _gradient(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    height, width = pixels.shape[:2]
    y, x = np.mgrid[:height, :width] / max(height, width)
    slopes, base = rng.normal(0, rng.choice([0.02, 0.2, 1]), (2, 3)), rng.uniform(0, 1, 3)
    bent = y[..., None] ** (1 + rng.uniform(0, 3))
    return (base + bent * slopes[0] + x[..., None] * slopes[1]).clip(0, 1).astype(np.float32)


def _one_channel(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Draw a single channel, as roughness, height and occlusion have."""
    grey = pixels[..., rng.integers(3)].astype(np.float32) / 255
    low, high = np.sort(rng.uniform(0, 1, 2))
    return np.repeat((low + (high - low) * grey)[..., None], 3, axis=2).astype(np.float32)


def _partly_constant(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Draw constant shapes on an image, like the unlit parts of light maps."""
    height, width = pixels.shape[:2]
    image = Image.fromarray(pixels)
    pen = ImageDraw.Draw(image)
    shade = int(rng.choice([0, 255, int(rng.integers(256))]))
    for _ in range(int(rng.integers(1, 8))):
        (x0, x1), (y0, y1) = np.sort(rng.integers(0, width, 2)), np.sort(rng.integers(0, height, 2))
        draw = pen.ellipse if rng.random() < 0.5 else pen.rectangle
        draw((int(x0), int(y0), int(x1), int(y1)), fill=(shade, shade, shade))
    return _colours_of(image)


def _colours_of(image: Image.Image) -> np.ndarray:
    return np.asarray(image, np.float32) / 255


# Kinds of images, each with the limit below which a random number from 0 to 1 chooses it.
IMAGES: tuple[tuple[float, MakeImage], ...] = (
    (0.66, _unchanged), (0.69, _text), (0.72, _quantised), (0.74, _with_ordered_dither), (0.77, _pixel_art),
    (0.83, _normal_map), (0.88, _gradient), (0.94, _one_channel), (1.0, _partly_constant),
)  # fmt: skip


def painted(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Draw hard-edged paint: chequers, stripes, cells of a Voronoi diagram, overlapping labels."""
    colours = rng.random((int(rng.integers(2, 9)), 3)).astype(np.float32)
    size, angle = float(np.exp(rng.uniform(*np.log(PAINTED)))), rng.uniform(0, np.pi)
    y, x = np.mgrid[:height, :width]
    along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    kind, count = rng.choice(["chequers", "stripes", "cells", "labels"]), int(height * width / size**2) + 2
    if kind == "chequers":
        places = along // size + across // size
    elif kind == "stripes":
        places = along // size
    elif kind == "cells":
        middles = rng.uniform(0, 1, (count, 2)) * (height, width)
        places = cKDTree(middles).query(np.stack([y, x], axis=-1).reshape(-1, 2))[1].reshape(height, width)
    else:
        image = Image.new("L", (width, height))
        pen = ImageDraw.Draw(image)
        for _ in range(count):
            left, top = rng.integers(0, width), rng.integers(0, height)
            right, low = (np.array([left, top]) + rng.uniform(0, 3 * size, 2)).astype(int)
            draw = pen.ellipse if rng.random() < 0.5 else pen.rectangle
            draw((int(left), int(top), int(right), int(low)), fill=int(rng.integers(255)))
        places = np.asarray(image)
    found = colours[places.astype(int) % len(colours)]
    if rng.random() < 0.3:  # shaded
        found = found * (0.7 + 0.3 * np.sin(along / rng.uniform(20, 100)))[..., None]
    return np.asarray(np.rint(found * 255) / 255, np.float32)


def varied(rng: np.random.Generator, colours: np.ndarray) -> np.ndarray:
    """Vary brightness, contrast, hue and orientation, and quantise to 8 bits."""
    if rng.random() < 0.5:
        colours = colours.swapaxes(0, 1)
    colours = colours[:, :, rng.permutation(3)]
    choice = rng.random()
    if choice < 0.12:
        colours = colours * rng.uniform(0.03, 0.5)
    elif choice < 0.2:
        colours = 1 - (1 - colours) * rng.uniform(0.03, 0.5)
    elif choice < 0.3:
        colours = colours ** rng.uniform(0.4, 2.5)
    elif choice < 0.36:
        grey = colours.mean(axis=2, keepdims=True)
        colours = grey + (colours - grey) * rng.uniform(0, 1.6)
    elif choice < 0.39:
        colours = 1 - colours
    colours = np.clip(colours, 0, 1)
    return np.ascontiguousarray(np.rint(colours * 255) / 255, np.float32)
