"""Fig. 2 of the paper: a noisy step edge under the linear Gaussian kernel and under the Beltrami kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from smoothing import kernel, smooth

if TYPE_CHECKING:
    from pathlib import Path

Array = NDArray[np.float64]

SIDE, EDGE = 64, 32
LOW, HIGH = 0.25, 0.75
NOISE = 0.05
BETA, ITERATIONS = 20.0, 10
# A pixel whose kernels are shown: row, and the last column before the edge.
SHOWN = (30, EDGE - 1)


@dataclass(frozen=True)
class Result:
    """A noisy step and what the two kernels make of it, each of shape (H, W, 1)."""

    noisy: Array
    gaussian: Array
    beltrami: Array


def run() -> Result:
    """Smooth the step edge with both kernels, for the same time and over the same number of iterations."""
    clean = np.full((SIDE, SIDE, 1), LOW)
    clean[:, EDGE:] = HIGH
    noisy = clean + np.random.default_rng(0).normal(0, NOISE, clean.shape)
    gaussian = smooth(noisy, beta=0.0, iterations=ITERATIONS).image
    return Result(noisy, gaussian, smooth(noisy, beta=BETA, iterations=ITERATIONS).image)


def edge_width(image: Array) -> float:
    """Return over how many pixels the mean profile rises from 10 to 90 per cent of the step."""
    profile = image[..., 0].mean(axis=0)
    low, high = profile[8:20].mean(), profile[-20:-8].mean()
    rise = np.maximum.accumulate((profile - low) / (high - low))[16:-16]
    columns = np.arange(len(rise), dtype=float)
    return float(np.interp(0.9, rise, columns) - np.interp(0.1, rise, columns))


def noise_left(image: Array) -> float:
    """Return the standard deviation on both sides, away from the edge and the borders."""
    sides = image[8:-8, 8:20], image[8:-8, -20:-8]
    return float(np.sqrt(np.mean([side.var() for side in sides])))


def step_height(image: Array) -> float:
    """Return the difference of the means of both sides, away from the edge."""
    return float(image[8:-8, -20:-8].mean() - image[8:-8, 8:20].mean())


def share_beyond_edge(beta: float, image: Array) -> float:
    """Return what share of its weight the kernel of a pixel next to the edge has on the other side."""
    return float(kernel(image, SHOWN, beta=beta)[:, EDGE:].sum())


def numbers(result: Result) -> list[list[str]]:
    """Return the rows of a table, the first its head."""
    images = {"noisy": result.noisy, "Gaussian": result.gaussian, "Beltrami": result.beltrami}
    rows = [["", *images]]
    rows.append(["noise left, of 255", *(f"{255 * noise_left(image):.1f}" for image in images.values())])
    rows.append(["width of the edge, pixels", *(f"{edge_width(image):.1f}" for image in images.values())])
    beyond = [f"{share_beyond_edge(beta, result.noisy):.0%}" for beta in (0.0, BETA)]
    rows.append(["weight beyond the edge, of a kernel just before it", "", *beyond])
    return rows


def draw(result: Result, path: Path) -> None:
    """Draw the step as a surface, as a profile, and the two kernels of one pixel next to the edge."""
    from drawing import figure, save, show

    made, grid = figure(3, 3, (9.6, 8.4), heights=(1.25, 0.8, 1))
    titles = ("with noise", "after the Gaussian kernel (β = 0)", f"after the Beltrami kernel (β = {BETA:g})")
    y, x = np.mgrid[:SIDE, :SIDE]
    for column, image in enumerate((result.noisy, result.gaussian, result.beltrami)):
        axes = made.add_subplot(grid[0, column], projection="3d")
        axes.plot_surface(
            x, y, image[..., 0], cmap="viridis", rcount=SIDE, ccount=SIDE, linewidth=0, antialiased=False
        )
        axes.view_init(elev=38, azim=-112)
        axes.set(zlim=(0, 1), xticks=(), yticks=(), zticks=())
        axes.set_box_aspect((1, 1, 0.6), zoom=1.25)
        axes.set_title(titles[column], fontsize=10)
        axes = made.add_subplot(grid[1, column])
        axes.axvline(EDGE - 0.5, color="0.8", lw=1)
        axes.plot(image[SHOWN[0], :, 0], ".", ms=4, color="0.45", label="one row")
        axes.plot(image[..., 0].mean(axis=0), lw=1.6, color="tab:red", label="mean of all rows")
        axes.set(ylim=(0, 1), xticks=(0, 16, 32, 48), yticks=(0.25, 0.75))
    made.axes[1].legend(loc="upper left", fontsize=8, frameon=False)
    part = (slice(SHOWN[0] - 7, SHOWN[0] + 8), slice(SHOWN[1] - 7, SHOWN[1] + 8))
    show(made.add_subplot(grid[2, 0]), result.noisy[part], "the last pixel before the edge", marked=(7, 7))
    for column, beta in ((1, 0.0), (2, BETA)):
        weights = kernel(result.noisy, SHOWN, beta=beta)[part]
        title = "weights of its Gaussian kernel" if beta == 0 else "weights of its Beltrami kernel"
        show(made.add_subplot(grid[2, column]), weights, title, marked=(7, 7), edge=EDGE - SHOWN[1] + 6.5)
    save(made, path)
