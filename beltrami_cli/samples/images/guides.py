"""Images that guide the smoothing of an image of the same size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.flow.embedding import Guide
from beltrami_cli.samples.images.guide_files import read_map, require_size

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.settings import SmoothSettings


@dataclass(frozen=True)
class GuideImage:
    """A guide with a row for each pixel.

    Attributes
    ----------
    name : str
        What the user calls it.
    image : ndarray of float32, shape (H, W, G)
        Its channels, finite wherever there is a sample.
    beta : float or None
        As in `Guide`.
    """

    name: str
    image: NDArray[np.float32]
    beta: float | None

    def at(self, pixels: NDArray[np.int64]) -> Guide:
        """Return the guide at some pixels (row * width + column)."""
        return Guide(self.name, self.image.reshape(-1, self.image.shape[2])[pixels], self.beta)


def read_guide_images(
    picture: Picture, valid: NDArray[np.bool_], settings: SmoothSettings, access: Access
) -> tuple[GuideImage, ...]:
    """Read all guides for an image.

    Parameters
    ----------
    picture : Picture
        The image that is smoothed.
    valid : ndarray of bool, shape (H, W)
        False at its holes.
    settings : SmoothSettings
        Which guides.
    access : Access
        What may be read.

    Raises
    ------
    InputError
        If one cannot be read, is of another size, or is not finite somewhere but at holes.
    """
    guides = []
    for path, beta in settings.embedding.weighted_guides:
        image = read_map(path, access)
        require_size(image, valid.shape, path, picture.name)
        finite = np.isfinite(image).all(axis=2) | ~valid
        if not finite.all():
            row, column = np.unravel_index(int(np.argmin(finite)), finite.shape)
            remedy = "leave such pixels out with --mask"
            raise InputError(
                path, f"its pixel {column},{row} is not finite, so it cannot guide there", remedy
            )
        guides.append(GuideImage(path, image, beta))
    return tuple(guides)
