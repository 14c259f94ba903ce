"""Clean images of `bench_regret`: crops of photographs and of files, and generated images."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.ndimage import gaussian_filter

from beltrami_cli.arrays import Array, Float32s
from pixels import images_of
from vertices import mosaic

CROP, MIN_CROP = 192, 128  # texels per side of crops


def halved(image: Array) -> Array:
    """Return the middle of an image downsampled to half the size, which removes the noise of a photograph."""
    rows, columns = (size // 2 * 2 for size in image.shape[:2])
    return cropped(image[:rows, :columns].reshape(rows // 2, 2, columns // 2, 2, -1).mean(axis=(1, 3)))


def cropped(image: Array) -> Array:
    top, left = (max(0, (size - CROP) // 2) for size in image.shape[:2])
    return image[top : top + CROP, left : left + CROP]


def crops_of(folder: Path, count: int) -> Iterator[tuple[str, Array]]:
    """Yield names and crops of opaque images of a folder that are not of one colour."""
    found = 0
    for path, pixels in images_of(folder):
        image = cropped(pixels / 255)
        opaque = image.shape[2] % 2 or (image[..., -1] == 1).all()
        colours = np.repeat(image[..., :1], 3, axis=2) if image.shape[2] < 3 else image[..., :3]
        if opaque and min(image.shape[:2]) >= MIN_CROP and colours.std() > 0.02:
            yield path.name, colours
            found += 1
        if found == count:
            return


def paint() -> Array:
    """Return cells of flat colours with slow gradients."""
    side = np.linspace(-0.8, 0.8, CROP)
    directions = np.stack([*np.meshgrid(side, side), np.ones((CROP, CROP))], axis=2).reshape(-1, 3)
    return mosaic(directions / np.linalg.norm(directions, axis=1, keepdims=True)).reshape(CROP, CROP, 3)


def label(seed: int) -> Array:
    """Return words and bars in a few colours."""
    random = np.random.default_rng(seed)
    colours = [tuple(map(int, random.integers(0, 256, 3))) for _ in range(5)]
    image = Image.new("RGB", (CROP, CROP), colours[0])
    draw = ImageDraw.Draw(image)
    for row, size in enumerate(random.integers(10, 40, 6)):
        top, left = 30 * row + 4, int(random.integers(4, 60))
        draw.rectangle((left, top + 22, CROP - left, top + 26), fill=colours[1 + row % 4])
        draw.text((left, top - 4), "Nº 48 Fragile", colours[1 + (row + 1) % 4], ImageFont.load_default(size))
    return np.asarray(image) / 255


def pixel_art(seed: int) -> Array:
    """Return sprites of eight colours, symmetric, on a dithered ground, with texels of 4 x 4 pixels."""
    random = np.random.default_rng(seed)
    palette, side = random.integers(0, 256, (8, 3)) / 255, CROP // 4
    column, row = np.meshgrid(np.arange(side), np.arange(side))
    ground = (column + row) % 2 * (row > side // 2)
    sprite = np.round(gaussian_filter(random.uniform(-30, 30, (side, side)), 2)).astype(int)
    sprite = sprite + sprite[:, ::-1]
    return np.kron(palette[np.where(sprite > 0, 2 + sprite % 6, ground)], np.ones((4, 4, 1)))


def weave() -> Array:
    """Return threads that pass over and under each other."""
    random = np.random.default_rng(1)
    tones = random.uniform(0.5, 1, (2, CROP // 6))
    x, y = np.meshgrid(np.arange(CROP), np.arange(CROP))
    over = (x // 6 + y // 6) % 2 == 0
    across, along = (
        tones[k][each // 6] * np.sin(np.pi * (each % 6 + 0.5) / 6) for k, each in enumerate((x, y))
    )
    return np.where(over, across, along)[..., None] * np.array([0.8, 0.6, 0.4])


def plaster() -> Array:
    """Return smooth bumps of several sizes."""
    random, found = np.random.default_rng(2), np.zeros((CROP, CROP))
    for width in (2, 4, 8, 16):
        bumps = gaussian_filter(random.standard_normal(found.shape), width)
        found += np.sqrt(width) * bumps / bumps.std()
    return 0.6 + 0.03 * found[..., None] * np.array([1, 0.95, 0.9])


def rendered(seed: int) -> Float32s:
    """Return linear light of three lamps with penumbrae on a wall of several materials."""
    random = np.random.default_rng(seed)
    place = np.moveaxis(np.mgrid[:CROP, :CROP], 0, 2) / CROP
    found = np.full((CROP, CROP, 3), 0.03)
    for _ in range(3):
        lamp, edge, angle = random.uniform(0, 1, 2), random.uniform(0.2, 0.8), random.uniform(0, 2 * np.pi)
        falloff = (1 + np.square((place - lamp) / 0.35).sum(axis=2, keepdims=True)) ** -1.5
        lit = (place - 0.5) @ [np.cos(angle), np.sin(angle)] < edge - 0.3
        found += falloff * gaussian_filter(lit.astype(float), 1.5)[..., None] * random.uniform(0.4, 1, 3)
    return found.astype(np.float32)
