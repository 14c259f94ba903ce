"""Clean training pictures: files of Debian and Python packages, and pictures that are drawn from them.

Photographs are downsampled two to four times, which removes their own noise. Textures are used unchanged. Files are
split into training, validation and test by a hash of their names, which keeps variants of one picture together.
"""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from scipy.spatial import cKDTree

Image.MAX_IMAGE_PIXELS = None

Picture = Callable[[np.random.Generator, np.ndarray], np.ndarray]  # makes a clean picture from a crop

SIDE = 288  # of crops, in texels
CROPS = {"photograph": 10, "texture": 1}  # of each file
PHOTOGRAPHS = "wallpapers", "backgrounds", "sklearn", "skimage"
# Pictures of scikit-image that count as textures; and those that are excluded, since the benchmarks use them.
SURFACES = {"brick", "grass", "gravel", "text", "page", "logo", "color", "phantom", "horse"}
BENCHMARKED = {"astronaut", "coffee", "chelsea", "ihc", "motorcycle_right"}
PAINTED = 5, 40  # range of texels between edges of paint
PARTS = {8: "validation", 9: "test"}  # last digit of the hash; all others: "training"


@dataclass(frozen=True)
class Crop:
    """A clean 8-bit crop of a file, shape (R, C, 3)."""

    name: str
    kind: str
    pixels: np.ndarray


def folders_of_packages() -> list[Path]:
    """Return the folders of pictures that scikit-image and scikit-learn ship."""
    found = [
        (importlib.util.find_spec(name), part)
        for name, part in (("skimage", "data"), ("sklearn", "datasets/images"))
    ]
    return [Path(spec.origin).parent / part for spec, part in found if spec is not None and spec.origin]


def part_of(path: Path) -> str:
    """Return the part of the data that a file belongs to, by the name that its variants share."""
    names = path.parts
    name = names[names.index("contents") - 1] if "contents" in names else path.stem.lower()
    return PARTS.get(int(hashlib.sha256(name.encode()).hexdigest(), 16) % 10, "training")


def clean_crops(roots: list[Path], part: str, seed: int) -> list[Crop]:
    """Return crops of all pictures of a part."""
    rng, crops = np.random.default_rng(seed), []
    for root in roots:
        paths = [
            path for path in root.rglob("*") if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".webp")
        ]
        for path in sorted(paths):
            if part_of(path.relative_to(root)) != part or path.is_symlink() or path.stem in BENCHMARKED:
                continue
            is_photograph = any(word in str(path) for word in PHOTOGRAPHS) and path.stem not in SURFACES
            kind = "photograph" if is_photograph else "texture"
            try:
                picture = Image.open(path)
                picture.draft("RGB", (2400, 2400))
                picture = picture.convert("RGB")
            except (OSError, ValueError, SyntaxError):
                continue
            if is_photograph and min(picture.size) >= 400:
                factor = rng.uniform(2, min(4, min(picture.size) / 200)) if min(picture.size) > 400 else 2
                size = [max(1, int(side / factor)) for side in picture.size]
                picture = picture.resize(
                    size, Image.Resampling.BOX if factor > 3 else Image.Resampling.HAMMING
                )
            pixels = np.asarray(picture)
            if min(pixels.shape[:2]) < 16:
                continue
            for _ in range(CROPS[kind] * (1 + (min(pixels.shape[:2]) > 2 * SIDE))):
                top, left = (int(rng.integers(max(1, size - SIDE + 1))) for size in pixels.shape[:2])
                crops.append(
                    Crop(
                        str(path.relative_to(root)), kind, pixels[top : top + SIDE, left : left + SIDE].copy()
                    )
                )
    return crops


def random_picture(rng: np.random.Generator, pixels: np.ndarray, paint: float = 0.0) -> np.ndarray:
    """Draw a clean picture from a crop; a share of the pictures is hard-edged paint."""
    if paint and rng.random() < paint:
        return painted(rng, *pixels.shape[:2])
    return varied(rng, drawn(rng, pixels))


def drawn(rng: np.random.Generator, pixels: np.ndarray) -> np.ndarray:
    """Return the crop itself, or a picture made from it of another kind that games and scans contain."""
    height, width = pixels.shape[:2]
    choice, picture = rng.random(), Image.fromarray(pixels)
    if choice < 0.66:
        return pixels / np.float32(255)
    if choice < 0.69:  # text
        paper = Image.new("RGB", (width, height), tuple(int(c) for c in rng.integers(0, 256, 3)))
        pen = ImageDraw.Draw(paper)
        for _ in range(int(rng.integers(2, 40))):
            letters = "".join(chr(c) for c in rng.integers(33, 126, rng.integers(3, 40)))
            at, size = rng.integers(-20, max(height, width), 2), float(rng.uniform(7, 40))
            pen.text(
                tuple(int(a) for a in at),
                letters,
                tuple(int(c) for c in rng.integers(0, 256, 3)),
                font_size=size,
            )
        picture = paper
    elif choice < 0.72:  # few colours, dithered or not
        method = Image.Dither.FLOYDSTEINBERG if rng.random() < 0.6 else Image.Dither.NONE
        picture = picture.quantize(int(rng.integers(2, 64)), dither=method)
        if rng.random() < 0.4:
            picture.putpalette([int(c) for c in rng.integers(0, 256, 768)])
        picture = picture.convert("RGB")
    elif choice < 0.74:  # ordered dithering
        bayer = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]) / 16
        threshold, levels = (
            np.tile(bayer, (height // 4 + 1, width // 4 + 1))[:height, :width, None],
            rng.integers(1, 6),
        )
        return (np.floor(pixels / 255 * levels + threshold).clip(0, levels) / levels).astype(np.float32)
    elif choice < 0.77:  # pixel art
        scale = int(rng.integers(2, 9))
        small = picture.resize((max(1, width // scale), max(1, height // scale)), Image.Resampling.NEAREST)
        picture = (
            small.quantize(int(rng.integers(3, 32)))
            .convert("RGB")
            .resize((width, height), Image.Resampling.NEAREST)
        )
    elif choice < 0.83:  # a normal map of the relief that the brightness would be
        relief = pixels.mean(axis=2) / 255 * rng.uniform(0.3, 8)
        down, across = np.gradient(relief)
        normal = np.stack([-across, down, np.ones_like(relief)], axis=2)
        return (normal / np.linalg.norm(normal, axis=2, keepdims=True) / 2 + 0.5).astype(np.float32)
    elif choice < 0.88:  # gradients
        y, x = np.mgrid[:height, :width] / max(height, width)
        slopes, base = rng.normal(0, rng.choice([0.02, 0.2, 1]), (2, 3)), rng.uniform(0, 1, 3)
        bent = rng.uniform(0, 3)
        return (
            (base + y[..., None] ** (1 + bent) * slopes[0] + x[..., None] * slopes[1])
            .clip(0, 1)
            .astype(np.float32)
        )
    elif choice < 0.94:  # one channel, as roughness, height and occlusion have
        grey = pixels[..., rng.integers(3)].astype(np.float32) / 255
        low, high = np.sort(rng.uniform(0, 1, 2))
        return np.repeat((low + (high - low) * grey)[..., None], 3, axis=2).astype(np.float32)
    else:  # constant beside lit areas
        picture = Image.fromarray(pixels)
        pen = ImageDraw.Draw(picture)
        shade = int(rng.choice([0, 255, rng.integers(256)]))
        for _ in range(int(rng.integers(1, 8))):
            (x0, x1), (y0, y1) = np.sort(rng.integers(0, width, 2)), np.sort(rng.integers(0, height, 2))
            draw = pen.ellipse if rng.random() < 0.5 else pen.rectangle
            draw((int(x0), int(y0), int(x1), int(y1)), fill=(shade, shade, shade))
    return np.asarray(picture, np.float32) / 255


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
        picture = Image.new("L", (width, height))
        pen = ImageDraw.Draw(picture)
        for _ in range(count):
            left, top = rng.integers(0, width), rng.integers(0, height)
            right, low = (np.array([left, top]) + rng.uniform(0, 3 * size, 2)).astype(int)
            draw = pen.ellipse if rng.random() < 0.5 else pen.rectangle
            draw((int(left), int(top), int(right), int(low)), fill=int(rng.integers(255)))
        places = np.asarray(picture)
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
