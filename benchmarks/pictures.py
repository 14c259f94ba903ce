"""Images: photographs of scikit-image and files of folders, and functions that add noise and smooth."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

import beltrami_cli
from beltrami_cli.errors import BeltramiError
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.jobs.noise_kinds import NumberedSamples, add_grain, seen_by_camera
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.surface.records import Cells
from peers import needed

SIDE = 224  # pixels per side of windows of images
# Top and left of the window of a photograph.
CORNERS = {
    "astronaut": (20, 130),
    "coffee": (100, 150),
    "chelsea": (40, 110),
    "immunohistochemistry": (150, 150),
}
PHOTOGRAPHS = tuple(CORNERS)
SUFFIXES = ".png", ".jpg", ".jpeg", ".tga", ".bmp", ".webp"
SIDES = 64, 1024  # range of pixels per side of a picture
COUNT = 130  # maximum number of pictures of a folder


def photograph(name):
    """Return a photograph that comes with scikit-image, in [0, 1]."""
    image = getattr(needed("skimage.data"), name)() / 255.0
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image[..., :3]


def on_sphere(image, directions):
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


def pictures(folder):
    """Yield up to `COUNT` 8-bit pictures that are spread evenly over a folder, with their paths."""
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    every, wanted = np.arange(len(paths)) * 0.5698402909980532 % 1, COUNT  # spread evenly (M. Roberts, 2018)
    for number in np.argsort(every):
        try:
            pixels = read_image(paths[number].read_bytes(), paths[number].name).pixels
        except BeltramiError:
            continue
        sides = pixels.shape[:2]
        if pixels.dtype == np.uint8 and SIDES[0] <= min(sides) and max(sides) <= SIDES[1]:
            yield paths[number], pixels
            wanted -= 1
        if not wanted:
            return


def images(paths):
    """Yield names and windows of images, float32, shape (R, C, 3), in [0, 1]."""
    for name, (top, left) in CORNERS.items():
        whole = getattr(needed("skimage.data"), name)()[..., :3] / np.float32(255)
        yield name, whole[top : top + SIDE, left : left + SIDE]
    for path in paths:
        whole = colours_of(path.read_bytes())[..., :3]
        top, left = ((size - SIDE) // 2 for size in whole.shape[:2])
        yield path.stem, whole[top : top + SIDE, left : left + SIDE]


def with_noise(image, kind, **wanted):
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


def stored(image):
    """Round to 8 bit."""
    return (np.rint(255 * np.clip(image, 0, 1)) / 255).astype(np.float32)


@dataclass(frozen=True)
class Smoothed:
    """A smoothed image, the estimated noise, and the predicted interval of the PSNR."""

    colours: Any
    noise: Any
    interval: Any  # None: not smoothed; []: no prediction


def smoothed(noisy, **parameters):
    """Smooth an image, or a JPEG file."""
    if not isinstance(noisy, bytes):
        result = beltrami_cli.smooth_image(noisy, **parameters)
        choice = result.choice
        return Smoothed(result.colours, result.noise, None if choice is None else choice.interval or [])
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "in.jpg", Path(folder) / "out.png"
        source.write_bytes(noisy)
        report = beltrami_cli.smooth_file(source, target, **parameters).image
        choice, noise = report.choice, np.array(list(report.noise.values()))
        return Smoothed(
            colours_of(target.read_bytes()), noise, None if choice is None else choice["interval"] or []
        )


def colours_of(image):
    """Return an image in [0, 1], decoded if it is the bytes of a file."""
    return read_image(image, "an image").pixels / np.float32(255) if isinstance(image, bytes) else image
