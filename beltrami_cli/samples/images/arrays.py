"""Images as arrays: what may be given, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.flow.colour_space import from_space, to_space
from beltrami_cli.samples.images.grid_flow import grid_flow
from beltrami_cli.surface.validation import array_of, colour_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

    from beltrami_cli.flow.parameters import KernelParameters, Space
    from beltrami_cli.flow.tuning.choice import Choice
    from beltrami_cli.samples.images.guides import GuideImage
    from beltrami_cli.surface.records import Encoding


@dataclass(frozen=True)
class ImageResult:
    """A smoothed image, and how it came about.

    Attributes
    ----------
    colours : ndarray of float32, shape (H, W, C)
        In the same encoding as the input's. Pixels that did not change, and holes, have the input's bits.
    beta : float
        As used, in units of length per unit of colour.
    spacing : float
        Mean distance of neighbouring pixels, in the unit of the positions; 0 if there are no pixels.
    noise : ndarray of float64, shape (C,)
        Estimated standard deviation of the noise of each channel, in the working space.
    samples : int
        Pixels that are no holes.
    samples_per_kernel : float
        Mean number of pixels that a kernel held.
    choice : Choice or None
        Parameters that were chosen from the data, and their estimated error, if any were.
    """

    colours: NDArray[np.float32]
    beta: float
    spacing: float
    noise: NDArray[np.float64]
    samples: int
    samples_per_kernel: float
    choice: Choice | None = None


@dataclass(frozen=True)
class ArrayImage:
    """Colours of all pixels, shape (H * W, C), the shape (H, W), and what the numbers mean."""

    table: NDArray[np.float32]
    shape: tuple[int, int]
    encoding: Encoding
    space: Space

    def __post_init__(self) -> None:
        if self.space == "oklab" and self.table.shape[1] != 3:
            raise UsageError("the space oklab needs three channels")

    def require_channels(self, metric_channels: Sequence[int] | None) -> None:
        """Check that the channels that are to enter the metric are there.

        Raises
        ------
        UsageError
            If they are not, or cannot be told apart in the working space.
        """
        channels = self.table.shape[1]
        for channel in metric_channels or ():
            if not isinstance(channel, (int, np.integer)) or not 0 <= channel < channels:
                raise UsageError(
                    f"metric_channels names {channel!r}, but the {channels} channels count from 0"
                )
        if self.space == "oklab" and metric_channels:
            raise UsageError("the space oklab mixes the channels, so metric_channels can only be empty")

    def smooth(
        self,
        valid: NDArray[np.bool_] | None,
        positions: NDArray[Any] | None,
        heights: NDArray[Any] | None,
        kernel: KernelParameters,
        progress: Callable[[int, int], None] | None,
        guides: Sequence[GuideImage],
        metric_channels: Sequence[int] | None,
    ) -> ImageResult:
        """Smooth the image.

        Parameters
        ----------
        valid, positions, heights : ndarray, optional
            As for `smooth_image`; heights in pixels.
        kernel : KernelParameters
            What to run with.
        progress : callable, optional
            As for `smooth_image`.
        guides : sequence of GuideImage
            What enters the metric besides the colours.
        metric_channels : sequence of int, optional
            Which colour channels enter the metric; without it all.

        Returns
        -------
        ImageResult
        """
        whole = np.asarray(np.isfinite(self.table.reshape(*self.shape, -1)).all(axis=2))
        if valid is not None:
            whole = whole & valid
        flow = grid_flow(
            whole,
            self._working,
            kernel,
            positions=None if positions is None else positions.astype(np.float64),
            heights=None if heights is None else heights.astype(np.float64),
            guides=guides,
            metric_channels=None if metric_channels is None else sorted(set(metric_channels)),
        )
        result = flow.run(progress)
        pixels = flow.manifold.atlas.owned_texels
        return ImageResult(
            self._with(pixels, flow.values()).reshape(*self.shape, -1),
            result.beta,
            result.spacing,
            result.sigma,
            len(pixels),
            result.samples_per_kernel,
            choice=result.choice,
        )

    def _working(self, pixels: NDArray[np.int64]) -> NDArray[np.float32]:
        return to_space(self.table[pixels], self.encoding, self.space)

    def _with(self, pixels: NDArray[np.int64], after: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of all pixels with the new ones of some."""
        smoothed = self.table.copy()
        moved = np.any(self._working(pixels) != after, axis=1)
        if moved.any():
            back = from_space(after[moved], self.encoding, self.space)
            # The way there and back is not exact; what comes of it stays in the range of the colours.
            old = self.table[pixels]
            smoothed[pixels[moved]] = np.clip(back, old.min(axis=0), old.max(axis=0))
        return smoothed


def pixel_colours(colours: ArrayLike) -> tuple[NDArray[np.float32], tuple[int, int]]:
    """Return the colours of all pixels, shape (H * W, C), and the shape (H, W)."""
    image = array_of(colours, "colours")
    if image.ndim not in (2, 3) or image.size == 0:
        raise UsageError(f"colours must be of shape (H, W) or (H, W, C), not {image.shape}")
    rows, columns = image.shape[:2]
    return colour_table(image.reshape(rows * columns, -1)), (rows, columns)


def pixel_array(values: ArrayLike, name: str, shape: tuple[int | None, ...], kinds: str) -> NDArray[Any]:
    """Take an array with a number for each pixel, or M numbers where the last of the shape is None."""
    array = array_of(values, name)
    fits = array.ndim == len(shape) and all(
        b is None or a == b for a, b in zip(array.shape, shape, strict=True)
    )
    if not fits or array.dtype.kind not in kinds or 0 in array.shape:
        wanted = ", ".join("M" if size is None else str(size) for size in shape)
        raise UsageError(
            f"{name} must be numbers of shape ({wanted}), not {array.dtype} of shape {array.shape}"
        )
    return array
