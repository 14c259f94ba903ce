"""Fig. 5 of the paper: a colour face smoothed as a regular image, and as an image on the surface of the face."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from face_model import Face, make_face
from smoothing import Smoothed, smooth

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PAPERS_SAMPLES = 20
# The paper names no beta. With this one the kernels on the surface hold the paper's 20 pixels; the regular image is
# smoothed with the same, and once more with one by which its kernels hold 20 pixels too.
BETA, BETA_OF_EQUAL_KERNELS = 8.0, 13.0
LEVEL, EDGE = 0.5, 1.5  # slopes below, and above
LIPS, FOREHEAD = (slice(148, 192), slice(52, 128)), (slice(22, 66), slice(52, 128))


@dataclass(frozen=True)
class Result:
    """The face, and its noisy image smoothed in three ways."""

    face: Face
    regular: Smoothed
    regular_of_equal_kernels: Smoothed
    surface: Smoothed

    @property
    def regions(self) -> dict[str, Mask]:
        """Parts of the image, by their names."""
        face = self.face
        return {
            "forehead": face.forehead,
            "lips": face.lips,
            f"edges of the surface (slope above {EDGE:g})": face.slopes > EDGE,
            "whole face": np.ones(face.slopes.shape, bool),
        }


def run() -> Result:
    """Smooth the face: one iteration, t 0.5, threshold 0.01, 7 x 7."""
    face = make_face()
    return Result(
        face,
        smooth(face.noisy, beta=BETA),
        smooth(face.noisy, beta=BETA_OF_EQUAL_KERNELS),
        smooth(face.noisy, face.heights, beta=BETA),
    )


def change(result: Result, smoothed: Smoothed, region: Mask) -> float:
    """Return the root mean square change of a region, full scale 1: how much it was smoothed."""
    return float(np.sqrt(np.square(smoothed.image - result.face.noisy)[region].mean()))


def error(result: Result, smoothed: Smoothed, region: Mask) -> float:
    """Return the root mean square difference to the face without noise, full scale 1."""
    return float(np.sqrt(np.square(smoothed.image - result.face.clean)[region].mean()))


def difference(result: Result, region: Mask) -> float:
    """Return the root mean square difference between the two versions of the same beta, full scale 1."""
    return float(np.sqrt(np.square(result.surface.image - result.regular.image)[region].mean()))


def numbers(result: Result) -> list[list[str]]:
    """Return the rows of a table, the first its head."""
    ways = {
        f"regular image, β = {BETA:g}": result.regular,
        f"regular image, β = {BETA_OF_EQUAL_KERNELS:g}": result.regular_of_equal_kernels,
        f"on the surface, β = {BETA:g}": result.surface,
    }
    rows = [["", *ways]]
    samples = [f"{smoothed.samples:.1f}" for smoothed in ways.values()]
    rows.append([f"pixels in a kernel (in the paper: {PAPERS_SAMPLES})", *samples])
    for what, measure in (("change", change), ("error left", error)):
        for name, region in result.regions.items():
            values = [255 * measure(result, smoothed, region) for smoothed in ways.values()]
            rows.append([f"{what}, of 255: {name}", *(f"{value:.1f}" for value in values)])
    return rows


def draw(result: Result, path: Path) -> None:
    """Draw the face in three columns, noisy, regular and on the surface; parts enlarged; and where the two differ."""
    from drawing import figure, save, show, view

    made, grid = figure(4, 3, (7.2, 9.4), heights=(1.9, 0.85, 0.85, 1.5))
    images = {
        "with noise": result.face.noisy,
        f"smoothed as a regular image\n{result.regular.samples:.1f} pixels in a kernel": result.regular.image,
        f"smoothed on its surface\n{result.surface.samples:.1f} pixels in a kernel": result.surface.image,
    }
    for column, (title, image) in enumerate(images.items()):
        show(made.add_subplot(grid[0, column]), image, title)
        show(made.add_subplot(grid[1, column]), image[LIPS], "lips" if column == 0 else "")
        show(made.add_subplot(grid[2, column]), image[FOREHEAD], "forehead" if column == 0 else "")
    heights = result.face.heights
    relief = view(heights, np.full((*heights.shape, 3), 0.85), 420, (30, 8), shade=True)
    axes = made.add_subplot(grid[3, 0])
    show(axes, relief, "the surface")
    axes.axis("off")
    axes = made.add_subplot(grid[3, 1])
    drawn = show(axes, result.face.slopes, "its slope", limits=(0, 2.5))
    made.colorbar(drawn, ax=axes, location="bottom", shrink=0.7, pad=0.02, ticks=(0, 1, 2))
    axes = made.add_subplot(grid[3, 2])
    apart = 255 * np.sqrt(np.square(result.surface.image - result.regular.image).mean(axis=2))
    drawn = show(axes, apart, "difference of the two, of 255", limits=(0, 8))
    made.colorbar(drawn, ax=axes, location="bottom", shrink=0.7, pad=0.02, ticks=(0, 4, 8))
    save(made, path)
