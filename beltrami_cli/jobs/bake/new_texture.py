"""A mesh with a texture that was made for it, and what all ways to make one have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.image import write_image
from beltrami_cli.formats.image.picture import new_picture
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.records import Texture, TexturedMesh, TexturedSurface
from beltrami_cli.surface.unwrap import unwrap

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.bake.settings import BakeSettings
    from beltrami_cli.surface.records import Encoding, ImageFile
    from beltrami_cli.surface.unwrap import Unwrapped

    Progress = Callable[[str, int, int], None] | None


@dataclass(frozen=True)
class NewTexture:
    """A mesh with a texture that is made for it.

    Attributes
    ----------
    positions, faces, uv
        As in `TexturedMesh`.
    space_of : ndarray of int32, shape (V,), or None
        As in `PaintedVertices`.
    pixels : ndarray of uint8 or uint16, shape (H, W, 3) or (H, W, 4)
        The texture, sRGB.
    charts : int or None
        How many, if it was unwrapped.
    notices : tuple of str
        What the user should know.
    """

    positions: NDArray[np.float64]
    faces: NDArray[np.int32]
    uv: NDArray[np.float64]
    space_of: NDArray[np.int32] | None
    pixels: NDArray[Any]
    charts: int | None
    notices: tuple[str, ...]

    def encoded(self, suffix: str | None = None, jpeg_quality: int = 98, *, small: bool = False) -> ImageFile:
        """Return the texture as a file, PNG by default; options as for `write_image`."""
        picture = new_picture(self.pixels, "the new texture")
        return write_image(picture, self.pixels, suffix=suffix, jpeg_quality=jpeg_quality, small=small)

    def surface(self) -> TexturedSurface:
        """Return the textured surface, as a document would."""
        texture = Texture("new", "the new texture", self.encoded().data, wrap=("clamp", "clamp"))
        untextured = np.zeros(len(self.faces), np.int32)
        return TexturedSurface(self.positions, self.faces, self.uv, untextured, (texture,), self.space_of)

    def mesh(self, image: ImageFile) -> TexturedMesh:
        """Return the mesh with the texture as a file, for the writers."""
        transparent = self.pixels.shape[2] == 4 and bool(
            (self.pixels[..., 3] < self.pixels[..., 3].max()).any()
        )
        return TexturedMesh(self.positions, self.faces, self.uv, image, transparent)


def unwrapped(
    document: Document,
    positions: NDArray[np.float64],
    faces: NDArray[np.int32],
    space_of: NDArray[np.int32] | None,
    texels: float,
    wanted: BakeSettings,
    progress: Progress,
) -> Unwrapped:
    """Lay triangles out anew, as the settings want it; raises as `unwrap` does."""
    return unwrap(
        positions,
        faces,
        wanted.size,
        wanted.padding,
        document.name,
        space_of=space_of,
        most_faces=wanted.max_unwrap_faces,
        texels=texels,
        progress=None if progress is None else lambda done, total: progress("unwrapping", done, total),
    )


def as_srgb(values: NDArray[np.float64], encoding: Encoding) -> NDArray[np.float64]:
    """Return colours, shape (N, 3) or (N, 4) with opacity, as display values."""
    if encoding == "srgb":
        return values
    return np.column_stack([linear_to_srgb(values[:, :3]), values[:, 3:]])


def rounded(values: NDArray[np.float64], dtype: type[np.uint8] | type[np.uint16]) -> NDArray[Any]:
    """Round values of full scale 1 to a type, clipping them to its range."""
    return np.rint(np.clip(values, 0, 1) * np.iinfo(dtype).max).astype(dtype)
