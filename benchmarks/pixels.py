"""Images: photographs of scikit-image and files of folders, and functions that add noise and smooth."""

import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.ndimage import map_coordinates

import beltrami_cli
from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.jobs.noise.kinds import NumberedSamples, add_grain, seen_by_camera
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface.records import Cells
from peers import needed

WINDOW = 224  # pixels per side of windows of images
# Top and left of the window of a photograph.
CORNERS = {
    "astronaut": (20, 130), "coffee": (100, 150), "chelsea": (40, 110), "immunohistochemistry": (150, 150),
}  # fmt: skip
PHOTOGRAPHS = tuple(CORNERS)
SUFFIXES = ".png", ".jpg", ".jpeg", ".tga", ".bmp", ".webp"
SIDES = 64, 1024  # range of pixels per side of an image
COUNT = 130  # maximum number of images of a folder

Interval = tuple[float, float]


def photograph(name: str) -> Array:
    """Return a photograph that comes with scikit-image, in [0, 1]."""
    image = getattr(needed("skimage.data"), name)() / 255.0
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image[..., :3]


def on_sphere(image: Array, directions: Array) -> Array:
    """Return the colours of directions: each hemisphere shows the disc in the middle of the image, by equal areas."""
    shape = np.array(image.shape[:2])
    flat = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    # Lambert's projection; the sine is 0 at the poles only, where the direction does not matter.
    radius = np.sqrt(1 - np.abs(flat[..., 2])) / np.maximum(np.hypot(flat[..., 0], flat[..., 1]), 1e-12)
    places = [
        (c - 1) / 2 + radius * flat[..., k] * (shape.min() - 3) / 2 for k, c in ((1, shape[0]), (0, shape[1]))
    ]
    seen = [map_coordinates(image[..., k], places, order=3, mode="nearest") for k in range(3)]
    return np.clip(np.stack(seen, axis=-1), 0, 1)


def images_of(folder: Path) -> Iterator[tuple[Path, Array]]:
    """Yield up to `COUNT` 8-bit images that are spread evenly over a folder, with their paths; exit without any."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    every, found = np.arange(len(paths)) * 0.5698402909980532 % 1, 0  # spread evenly (M. Roberts, 2018)
    for number in np.argsort(every):
        try:
            pixels = read_image(paths[number].read_bytes(), paths[number].name).pixels
        except BeltramiError:
            continue
        sides = pixels.shape[:2]
        if pixels.dtype == np.uint8 and SIDES[0] <= min(sides) and max(sides) <= SIDES[1]:
            yield paths[number], pixels
            found += 1
        if found == COUNT:
            return
    if not found:
        sys.exit(f"{folder}: no 8-bit images with sides of {SIDES[0]} to {SIDES[1]} pixels")


def windows(paths: Sequence[Path]) -> Iterator[tuple[str, Float32s]]:
    """Yield names and windows of images, float32, shape (R, C, 3), in [0, 1]."""
    for name, (top, left) in CORNERS.items():
        whole = getattr(needed("skimage.data"), name)()[..., :3] / np.float32(255)
        yield name, whole[top : top + WINDOW, left : left + WINDOW]
    for path in paths:
        whole = colours_of(path.read_bytes())[..., :3]
        top, left = ((size - WINDOW) // 2 for size in whole.shape[:2])
        yield path.stem, whole[top : top + WINDOW, left : left + WINDOW]


def with_noise(image: Array, kind: Literal["camera", "grain"], **wanted: Any) -> Array:
    """Return an image with noise as `beltrami noise` adds it, before rounding."""
    settings, shape = NoiseSettings(kind=kind, **wanted), image.shape[:2]
    row, column = np.indices(shape).reshape(2, -1)
    none = np.zeros_like(row)
    grains = NumberedSamples(image.reshape(-1, 3).astype(np.float32), np.arange(row.size))
    if kind == "camera":
        noisy = seen_by_camera(grains, Cells([shape], none, row, column, none), settings)
    else:
        places = np.column_stack([column, row, none]).astype(float)
        noisy = add_grain(grains, places, np.ones(row.size), settings)
    return noisy.reshape(image.shape)


def stored(image: Array) -> Float32s:
    """Clip and round as 8-bit files do."""
    return (np.rint(255 * np.clip(image, 0, 1)) / 255).astype(np.float32)


@dataclass(frozen=True)
class Smoothed:
    colours: Array
    noise: Array  # estimated sigma of each channel
    interval: Interval | None  # of the PSNR in dB, with a certainty of 90 %; None: not predicted


def smoothed(noisy: Array | bytes, **parameters: Any) -> Smoothed:
    """Smooth an image, or a JPEG file given by its bytes."""
    if not isinstance(noisy, bytes):
        result = beltrami_cli.smooth_image(noisy, **parameters)
        return Smoothed(result.colours, result.noise, result.choice.interval if result.choice else None)
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.jpg", Path(folder) / "out.png"
        source.write_bytes(noisy)
        report = beltrami_cli.smooth_file(source, target, **parameters).image
        assert report is not None
        interval: Any = report.choice["interval"] if report.choice else None
        return Smoothed(colours_of(target.read_bytes()), np.array([*report.noise.values()]), interval)


def colours_of(image: Array | bytes) -> Array:
    """Return an image in [0, 1], decoded if it is the bytes of a file."""
    return read_image(image, "an image").pixels / np.float32(255) if isinstance(image, bytes) else image
