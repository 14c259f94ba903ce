"""The surface of an image, with its holes, from other images of the same size; and its canvas."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.errors import InputError
from beltrami_cli.flow.manifolds.canvas import canvas_margin
from beltrami_cli.flow.manifolds.grid_manifold import ColouredCanvas
from beltrami_cli.flow.manifolds.guides import Guide
from beltrami_cli.flow.parameters import KernelParameters, Space
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.image import DecodedImage
from beltrami_cli.formats.image.decoded_image import full_scale_one
from beltrami_cli.layers.guides import read_of_size
from beltrami_cli.layers.settings import ImageSettings
from beltrami_cli.surface.grid_atlas import grid_atlas
from beltrami_cli.surface.precision import check_scale

Pixels = NDArray[np.int64]

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


def read_surface(picture: DecodedImage, wanted: ImageSettings, access: Access) -> ImageSurface:
    """Read the images of a picture's surface and holes; InputError if one does not fit the picture."""
    heights = positions = None
    valid = np.ones(picture.pixels.shape[:2], bool)
    notices: list[str] = []
    if wanted.height is not None:
        pixels = _read(wanted.height, picture, access, notices)
        heights = wanted.height_scale * _height_of(pixels)
        valid &= np.isfinite(heights) & _opaque(pixels)
    if wanted.positions is not None:
        pixels = _read(wanted.positions, picture, access, notices)
        positions = _positions_of(pixels)
        check_scale(positions.reshape(-1, 3), _triangles(*positions.shape[:2]), wanted.positions)
        valid &= np.isfinite(positions).all(axis=2) & _opaque(pixels)
    if wanted.mask is not None:
        mask = _read(wanted.mask, picture, access, [])  # a mask may be coarse
        colours = np.nan_to_num(mask.pixels[..., list(mask.colour)])
        valid &= (colours != 0).any(axis=2) & _opaque(mask)
    return ImageSurface(heights, positions, valid, tuple(notices))


def _read(path: str, picture: DecodedImage, access: Access, notices: list[str]) -> DecodedImage:
    """Read an image with the size of the picture; append notices about it to `notices`."""
    read = read_of_size(path, picture, access, "mapped")
    notices += read.notices
    if read.stored == "uint8":
        notices.append(
            f"{path} has 8 bits only, so that its surface has steps; 16 bits or floats are better."
        )
    return read


def _height_of(picture: DecodedImage) -> NDArray[np.float64]:
    lower = [channel.lower() for channel in picture.channels]
    named = next((lower.index(name) for name in _HEIGHTS if name in lower), None)
    colour_channels = [channel for channel in range(len(lower)) if channel != picture.alpha]
    first, *rest = (picture.pixels[..., channel] for channel in colour_channels or [0])
    if named is None and not all(np.array_equal(first, each, equal_nan=True) for each in rest):
        cause = f"which of its channels {', '.join(picture.channels)} is the height is not clear"
        raise InputError(picture.name, cause, "give an image of one channel, or call it Z")
    column = colour_channels[0] if named is None else named
    return full_scale_one(picture.pixels[..., column]).astype(np.float64)


def _positions_of(picture: DecodedImage) -> NDArray[np.float64]:
    """Return the channels x, y and z, or red, green and blue, or else the only three channels."""
    lower = [channel.lower() for channel in picture.channels]
    columns = [lower.index(name) for name in "xyz" if name in lower]
    if len(columns) != 3:
        columns = list(picture.colour)
    if len(columns) != 3:
        remedy = "give an image with the three channels X, Y and Z, or red, green and blue"
        raise InputError(
            picture.name, f"its channels {', '.join(picture.channels)} are not positions", remedy
        )
    return full_scale_one(picture.pixels[..., columns]).astype(np.float64)


def _triangles(rows: int, columns: int) -> NDArray[np.int32]:
    """Return a triangle of each pixel and its neighbours on the right and below."""
    at = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)[:-1, :-1].ravel()
    return np.stack([at, at + 1, at + columns], axis=1).astype(np.int32)


def _opaque(picture: DecodedImage) -> NDArray[np.bool_]:
    """Return where a map has values: where its own alpha is not 0."""
    if picture.alpha is None:
        return np.ones(picture.pixels.shape[:2], bool)
    return np.asarray(picture.pixels[..., picture.alpha] != 0)


def canvas_of_image(
    surface: ImageSurface,
    colours_of: Callable[[Pixels], NDArray[np.float32]],
    kernel: KernelParameters,
    *,
    guides: Sequence[Guide] = (),
    metric_channels: Sequence[int] | None = None,
    deviations: NDArray[np.float32] | None = None,
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
        rows_of, columns_of = np.indices(valid.shape, sparse=True)
        positions = np.stack(np.broadcast_arrays(columns_of, rows_of, surface.heights), axis=2)
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
