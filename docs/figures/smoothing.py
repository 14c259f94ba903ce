"""Images, on the plane and over height maps, smoothed by the paper's kernel; and one kernel to look at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import beltrami_cli
from beltrami_cli.flow.decoding import plan_on_canvas
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.layers.image_surface import ImageSurface, canvas_of_image

Array = NDArray[np.float64]

# Section 5 of the paper: one iteration, t 0.5, a threshold of 0.01, 7 x 7, fast marching by the metric at each pixel,
# with distances from the colours as they are.
PAPER = {
    "iterations": 1,
    "t": 0.5,
    "threshold": 0.01,
    "window": 7,
    "scheme": "metric",
    "metric_steps": 0,
    "beta_growth": 1,
    "clipping": "keep",
}


@dataclass(frozen=True)
class Smoothed:
    """A smoothed image, shape (H, W, N), and how many pixels its kernels held on average."""

    image: Array
    samples: float


def smooth(image: Array, heights: Array | None = None, **parameters: object) -> Smoothed:
    """Smooth an image with the paper's kernel.

    Parameters
    ----------
    image : ndarray of float64, shape (H, W, N)
        Colours of full scale 1.
    heights : ndarray of float64, shape (H, W), optional
        The surface (x, y, height) that the image lies on, in pixels; without it, the plane.
    parameters
        In place of the paper's.
    """
    result = beltrami_cli.smooth_image(
        image, surface=ImageSurface(heights=heights), space="data", **{**PAPER, **parameters}
    )
    return Smoothed(result.colours.astype(np.float64), result.samples_per_kernel)


def kernel(image: Array, at: tuple[int, int], **parameters: object) -> Array:
    """Return the weights of the paper's kernel of the pixel at a row and column, shape (H, W); their sum is 1."""
    rows, columns = image.shape[:2]
    table = image.reshape(rows * columns, -1).astype(np.float32)
    settings = KernelParameters(**{**PAPER, **parameters, "iterations": 0})
    plan = plan_on_canvas(
        canvas_of_image(
            ImageSurface(valid=np.ones((rows, columns), bool)), lambda pixels: table[pixels], settings
        )
    )
    found = plan.manifold.kernel_at(at[0] * columns + at[1], plan.step(0))
    weights = np.zeros(rows * columns)
    weights[found.samples] = found.weights
    return (weights / weights.sum()).reshape(rows, columns)
