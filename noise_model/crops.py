"""Crops of clean images, which are files of Debian and Python packages.

Photographs are downsampled two to four times, which removes their own noise. Textures are used unchanged. Files are
split into training, validation and test by a hash of their names, which keeps variants of one image together.
"""

from __future__ import annotations

import hashlib
import importlib.util
from pathlib import Path

import numpy as np
from PIL import Image

Image.MAX_IMAGE_PIXELS = None

SUFFIXES = ".png", ".jpg", ".jpeg", ".webp"
MIN_SIDE = 16  # texels per side of an image
SIDE = 288  # of crops, in texels
CROPS_OF_PHOTOGRAPH = 10  # textures have one; images of more than two sides have twice as many
PHOTOGRAPHS = "wallpapers", "backgrounds", "sklearn", "skimage"
# Images of scikit-image that count as textures; and images that are excluded, since the benchmarks use them.
NO_PHOTOGRAPHS = {"brick", "grass", "gravel", "text", "page", "logo", "color", "phantom", "horse"}
BENCHMARKED = {"astronaut", "coffee", "chelsea", "ihc", "motorcycle_right"}
PARTS = {8: "validation", 9: "test"}  # last digit of the hash; all others: "training"


def folders_of_packages() -> list[Path]:
    """Return the folders of images that scikit-image and scikit-learn ship."""
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


def clean_crops(roots: list[Path], part: str, seed: int) -> list[np.ndarray]:
    """Return clean 8-bit crops of files, shape (R, C, 3) each."""
    rng, crops = np.random.default_rng(seed), []
    for root in roots:
        for path in sorted(own for own in root.rglob("*") if own.suffix.lower() in SUFFIXES):
            if part_of(path.relative_to(root)) != part or path.is_symlink() or path.stem in BENCHMARKED:
                continue
            is_photograph = any(word in str(path) for word in PHOTOGRAPHS) and path.stem not in NO_PHOTOGRAPHS
            pixels = _clean_pixels(path, is_photograph, rng)
            if pixels is None or min(pixels.shape[:2]) < MIN_SIDE:
                continue
            count = CROPS_OF_PHOTOGRAPH if is_photograph else 1
            for _ in range(2 * count if min(pixels.shape[:2]) > 2 * SIDE else count):
                top, left = (int(rng.integers(max(1, size - SIDE + 1))) for size in pixels.shape[:2])
                crops.append(pixels[top : top + SIDE, left : left + SIDE].copy())
    return crops


def _clean_pixels(path: Path, is_photograph: bool, rng: np.random.Generator) -> np.ndarray | None:
    """Decode an image, and downsample a photograph; None if it cannot be decoded."""
    try:
        file = Image.open(path)
        file.draft("RGB", (2400, 2400))
        image = file.convert("RGB")
    except (OSError, ValueError, SyntaxError):
        return None
    shorter = min(image.size)
    if is_photograph and shorter >= 400:
        factor = rng.uniform(2, min(4, shorter / 200)) if shorter > 400 else 2
        width, height = (max(1, int(side / factor)) for side in image.size)
        image = image.resize(
            (width, height), Image.Resampling.BOX if factor > 3 else Image.Resampling.HAMMING
        )
    return np.asarray(image)
