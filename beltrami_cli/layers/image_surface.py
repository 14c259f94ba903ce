"""The surface of an image, with its holes, from other images of the same size; and its canvas."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices, Int32s
from beltrami_cli.errors import InputError
from beltrami_cli.flow.manifolds.grid.manifold import ColouredCanvas
from beltrami_cli.flow.manifolds.grid.margins import canvas_margin
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.parameters import KernelParameters, Space
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.layers.sample_files import read_of_size
from beltrami_cli.layers.settings import ImageSettings
from beltrami_cli.surface.grid_atlas import grid_atlas
from beltrami_cli.surface.precision import require_scale

# Names of channels with depth or height in files of renderers and cameras.
_HEIGHTS = ("z", "depth", "height", "depth.z", "y")


@dataclass(frozen=True)
class ImageSurface:
    """The positions of the pixels of an image in space; without heights and positions, a plane.

    Attributes
    ----------
    heights : ndarray, shape (H, W), or None
        Above the plane of the image, in pixels. Pixels with a height that is not finite are holes.
    positions : ndarray, shape (H, W, M), or None
        In a space of any dimension M. Pixels with a coordinate that is not finite are holes.
    valid : ndarray of bool, shape (H, W), or None
        False at holes. They keep their colours, contribute none, and no kernel crosses them.
    notices : tuple of str
        Messages for users, one sentence each; set when the surface was read from files.
    """

    heights: NDArray[Any] | None = None
    positions: NDArray[Any] | None = None
    valid: NDArray[np.bool_] | None = None
    notices: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """The kind of surface: "plane", "height" or "positions"."""
        if self.heights is not None:
            return "height"
        return "plane" if self.positions is None else "positions"


def read_surface(target: DecodedImage, wanted: ImageSettings, access: Access) -> ImageSurface:
    """Read the files of an image's surface and holes; InputError if one does not fit it."""
    heights = positions = None
    valid = np.ones(target.pixels.shape[:2], bool)
    notices: list[str] = []
    if wanted.height is not None:
        pixels = read_of_size(wanted.height, target, access, "mapped")
        notices += _notices_of(wanted.height, pixels)
        heights = wanted.height_scale * _height_of(pixels)
        valid &= np.isfinite(heights) & _opaque(pixels)
    if wanted.positions is not None:
        pixels = read_of_size(wanted.positions, target, access, "mapped")
        notices += _notices_of(wanted.positions, pixels)
        positions = _positions_of(pixels)
        require_scale(positions.reshape(-1, 3), _triangles(*positions.shape[:2]), wanted.positions)
        valid &= np.isfinite(positions).all(axis=2) & _opaque(pixels)
    if wanted.mask is not None:
        mask = read_of_size(wanted.mask, target, access, "mapped")
        colours = np.nan_to_num(mask.pixels[..., list(mask.colour)])
        valid &= (colours != 0).any(axis=2) & _opaque(mask)
    return ImageSurface(heights, positions, valid, tuple(notices))


def _notices_of(path: str, image: DecodedImage) -> list[str]:
    if image.stored != "uint8":
        return [*image.notices]
    coarse = f"{path} has 8 bits only, so that its surface has steps; 16 bits or floats are better."
    return [*image.notices, coarse]


def _height_of(image: DecodedImage) -> Float64s:
    lower = [channel.lower() for channel in image.channels]
    named = next((lower.index(name) for name in _HEIGHTS if name in lower), None)
    colour_channels = [channel for channel in range(len(lower)) if channel != image.alpha]
    first, *rest = (image.pixels[..., channel] for channel in colour_channels or [0])
    if named is None and not all(np.array_equal(first, each, equal_nan=True) for each in rest):
        cause = f"which of its channels {', '.join(image.channels)} is the height is not clear"
        raise InputError(image.name, cause, "give an image of one channel, or call it Z")
    column = colour_channels[0] if named is None else named
    return full_scale_one(image.pixels[..., column]).astype(np.float64)


def _positions_of(image: DecodedImage) -> Float64s:
    """Return the channels x, y and z, or red, green and blue, or else the only three channels."""
    lower = [channel.lower() for channel in image.channels]
    columns = [lower.index(name) for name in "xyz" if name in lower]
    if len(columns) != 3:
        columns = list(image.colour)
    if len(columns) != 3:
        remedy = "give an image with the three channels X, Y and Z, or red, green and blue"
        raise InputError(image.name, f"its channels {', '.join(image.channels)} are not positions", remedy)
    return full_scale_one(image.pixels[..., columns]).astype(np.float64)


def _triangles(rows: int, columns: int) -> Int32s:
    """Return a triangle of each pixel and its neighbours on the right and below."""
    at = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)[:-1, :-1].ravel()
    return np.stack([at, at + 1, at + columns], axis=1).astype(np.int32)


def _opaque(image: DecodedImage) -> Bools:
    """Return where a map has values: where its own alpha is not 0."""
    if image.alpha is None:
        return np.ones(image.pixels.shape[:2], bool)
    return np.asarray(image.pixels[..., image.alpha] != 0)


def canvas_of_image(
    surface: ImageSurface,
    colours_of: Callable[[Indices], Float32s],
    kernel: KernelParameters,
    *,
    guides: Sequence[Guide] = (),
    metric_channels: Sequence[int] | None = None,
    deviations: Float32s | None = None,
    light: Space | None = None,
) -> ColouredCanvas:
    """Return the canvas of an image; its owned texels are the pixels except holes, row by row.

    Guides and deviations have one row per pixel.
    """
    # On heights as on the plane, the unit of length is the pixel, not the spacing along the surface. Samples on slopes
    # are further apart, and are smoothed less.
    valid, positions = surface.valid, surface.positions
    assert valid is not None
    if surface.heights is not None:
        valid = valid & np.isfinite(surface.heights)
        rows, columns = surface.heights.shape
        x, y = np.arange(columns), np.arange(rows)[:, None]
        positions = np.stack(np.broadcast_arrays(x, y, surface.heights), axis=2)
        kernel = dataclasses.replace(kernel, units="world")
    atlas = grid_atlas(valid.shape, canvas_margin(kernel), positions, valid)
    del positions  # as large as the canvas
    texels = atlas.owned_texels
    return ColouredCanvas(
        atlas=atlas, parameters=kernel, channels=colours_of(texels[:0]).shape[1],
        colours_of=lambda block: colours_of(texels[block]),
        deviations=None if deviations is None else deviations[texels], light=light,
        guides=[dataclasses.replace(guide, values=guide.values[texels]) for guide in guides],
        metric_channels=metric_channels, stop_at_holes=atlas.covered < valid.size,
        unit=None if surface.heights is None else 1.0,
    )  # fmt: skip
