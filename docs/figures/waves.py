"""Fig. 4 of the paper: one texture on the plane, and on the surface {x, y, sin(2 pi x) sin(2 pi y)}."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smoothing import smooth

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]

SIDE = 256  # pixels for x and y from 0 to 1
BETA, ITERATIONS = 4.0, 5
# The kernels of pixels at the border of the image are cut off there.
BORDER = 16
LEVEL, STEEP = 0.5, 4.0
BINS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.3)
# Row and column of squares that are shown enlarged.
PEAK, SLOPE, SQUARE = (64, 64), (96, 96), 24


@dataclass(frozen=True)
class Result:
    """A texture and what becomes of it on the plane and on the surface, each of shape (H, W, 3)."""

    texture: Array
    heights: Array
    plane: Array
    surface: Array
    samples: tuple[float, float]  # in a kernel, on the plane and on the surface

    @property
    def slopes(self) -> Array:
        """How steep the surface is, shape (H, W)."""
        return np.hypot(*np.gradient(self.heights))


def run() -> Result:
    """Smooth the texture on both, with the same parameters."""
    texture, heights = make_texture(), make_heights()
    plane = smooth(texture, beta=BETA, iterations=ITERATIONS)
    surface = smooth(texture, heights, beta=BETA, iterations=ITERATIONS)
    return Result(texture, heights, plane.image, surface.image, (plane.samples, surface.samples))


def make_heights() -> Array:
    """Return sin(2 pi x) sin(2 pi y) in units of pixels."""
    y, x = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE
    return SIDE * np.sin(2 * np.pi * x) * np.sin(2 * np.pi * y)


def make_texture() -> Array:
    """Return a texture that is uniform everywhere: two warm tones in grains of several sizes."""
    from scipy.ndimage import gaussian_filter

    random = np.random.default_rng(1)
    grains = [
        gaussian_filter(random.normal(size=(SIDE, SIDE)), size, mode="wrap") for size in (0.7, 1.4, 3.0)
    ]
    mixed = sum(weight * grain / grain.std() for weight, grain in zip((0.5, 0.4, 0.5), grains, strict=True))
    share = np.clip(0.5 + 0.3 * np.asarray(mixed), 0, 1)[..., None]
    return share * np.array([0.96, 0.86, 0.62]) + (1 - share) * np.array([0.45, 0.22, 0.12])


def smoothing_by_slope(result: Result) -> list[tuple[float, float, float]]:
    """Return, for each bin of slopes, its bounds and how much is smoothed there, with 1 for as much as on the plane."""
    return [(low, high, relative_smoothing(result, low, high)) for low, high in itertools.pairwise(BINS)]


def relative_smoothing(result: Result, low: float, high: float) -> float:
    """Return the RMS change where slopes are between the bounds, over that of these pixels on the plane."""
    inner = (slice(BORDER, -BORDER),) * 2
    slopes = result.slopes[inner]
    here = (slopes >= low) & (slopes < high)
    change = [
        np.square(image - result.texture)[inner][here].mean() for image in (result.surface, result.plane)
    ]
    return float(np.sqrt(change[0] / change[1]))


def evenness(result: Result) -> float:
    """Return by how much the change on the plane varies over the image: deviation over mean, of 16 squares."""
    inner = np.square(result.plane - result.texture)[BORDER:-BORDER, BORDER:-BORDER]
    side = len(inner) // 4
    squares = inner[: 4 * side, : 4 * side].reshape(4, side, 4, side, 3).mean(axis=(1, 3, 4))
    changes = np.sqrt(squares)
    return float(changes.std() / changes.mean())


def numbers(result: Result) -> list[list[str]]:
    """Return the rows of a table, the first its head."""
    steepest = BINS[-1]
    rows = [["", "plane", "surface"]]
    rows.append(["samples in a kernel", *(f"{samples:.1f}" for samples in result.samples)])
    level, steep = relative_smoothing(result, 0, LEVEL), relative_smoothing(result, STEEP, steepest)
    rows.append([f"smoothing where level (slope below {LEVEL:g})", "1", f"{level:.2f}"])
    rows.append([f"smoothing on slopes (above {STEEP:g})", "1", f"{steep:.2f}"])
    rows.append(["variation of the smoothing over the plane", f"{evenness(result):.1%}", ""])
    return rows


def draw(result: Result, path: Path) -> None:
    """Draw the texture on both before and after, enlarged parts, and how the smoothing falls with the slope."""
    from drawing import figure, save, show, view

    made, grid = figure(3, 4, (9.6, 7.6), heights=(1, 1, 0.72))
    flat = np.zeros_like(result.heights)
    for row, (when, images) in enumerate(
        (("before", (result.texture,) * 2), ("after", (result.plane, result.surface)))
    ):
        for column, (where, heights, image) in enumerate(
            zip(("plane", "surface"), (flat, 0.4 * result.heights), images, strict=True)
        ):
            axes = made.add_subplot(grid[row, 2 * column : 2 * column + 2])
            seen = view(heights, image, 480, (32, 42), lying=True, shade=True)
            show(axes, seen, f"on the {where}, {when}")
            axes.axis("off")
    for column, (name, at) in enumerate((("a peak", PEAK), ("a slope", SLOPE))):
        part = tuple(slice(centre - SQUARE // 2, centre + SQUARE // 2) for centre in at)
        pair = np.hstack([result.plane[part], np.ones((SQUARE, 2, 3)), result.surface[part]])
        show(made.add_subplot(grid[2, column]), pair, f"{name}: plane | surface, after")
    axes = made.add_subplot(grid[2, 2:])
    low, high, ratios = (np.array(values) for values in zip(*smoothing_by_slope(result), strict=True))
    axes.axhline(1, color="0.8", lw=1)
    axes.plot((low + high) / 2, ratios, "o-", ms=4, color="tab:red")
    axes.set(ylim=(0, 1.1), xlim=(0, 6.3))
    axes.set_title("smoothing on the surface : on the plane, by slope", fontsize=10)
    save(made, path)
