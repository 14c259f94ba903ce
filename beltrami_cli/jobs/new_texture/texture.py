"""A mesh with its new texture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Float64s, Int32s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.jobs.progress import Progress
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.records import (
    Encoding,
    Frame,
    ImageFile,
    Material,
    MaterialMap,
    MeshContents,
    MeshImage,
    Texture,
    TexturedSurface,
)
from beltrami_cli.surface.unwrap import Unwrapped, require_few_faces, unwrap

Depth = type[np.uint8] | type[np.uint16]


@dataclass(frozen=True)
class NewTexture:
    """A mesh with its new texture."""

    positions: Float64s
    faces: Int32s
    uv: Float64s  # (F, 3, 2), as in `TexturedSurface`
    space_of: Int32s | None  # as in `ColouredVertices`
    pixels: Array  # uint8 or uint16, (H, W, 3) or (H, W, 4): the texture, sRGB
    charts: int | None  # number of charts, if it was unwrapped
    notices: tuple[str, ...]
    frame: Frame

    def encoded(self, suffix: str | None = None, jpeg_quality: int = 98, *, small: bool = False) -> ImageFile:
        """Return the texture as a file, PNG by default; options as for `write_image`."""
        image = new_image(self.pixels, "the new texture")
        return write_image(image, self.pixels, suffix=suffix, jpeg_quality=jpeg_quality, small=small)

    def surface(self) -> TexturedSurface:
        texture = Texture("new", "the new texture", self.encoded().data, wrap=("clamp", "clamp"))
        texture_of = np.zeros(len(self.faces), np.int32)
        return TexturedSurface(self.positions, self.faces, self.uv, texture_of, (texture,), self.space_of)

    def mesh(self, image: ImageFile) -> MeshContents:
        """Return the mesh with the texture as an image file, for the writers."""
        alpha = self.pixels[..., 3:]
        transparent = bool(alpha.size and (alpha < alpha.max()).any())
        shown = MaterialMap(MeshImage(image), ("clamp", "clamp"))
        material = Material(maps={"baseColor": shown}, alpha="blend" if transparent else "opaque")
        return MeshContents(
            positions=self.positions,
            corners=self.faces.ravel(),
            offsets=3 * np.arange(len(self.faces) + 1),
            colours=np.empty((len(self.positions), 0), np.float32),
            frame=self.frame,
            uv=self.uv.reshape(-1, 2),
            materials=(material,),
        )


def texture_description(file: ImageFile) -> str:
    """Describe a new texture as its file holds it, which may have fewer bits than the colours."""
    size = measure_image(file.data, f"texture{file.suffix}")
    assert size is not None
    bits = 8 * size.sample
    return f"{'an' if bits == 8 else 'a'} {bits}-bit texture of {size.width} x {size.height}"


def unwrap_within_limit(
    document: Document, positions: Float64s, faces: Int32s, space_of: Int32s | None, texels: float,
    settings: BakeSettings, progress: Progress | None,
) -> Unwrapped:  # fmt: skip
    require_few_faces(len(faces), settings.max_unwrap_faces, document.name)
    return unwrap(
        positions, faces, settings.size, settings.padding, document.name, space_of=space_of, texels=texels,
        progress=None if progress is None else partial(progress, "unwrapping"),
    )  # fmt: skip


def as_srgb(values: Float64s, encoding: Encoding) -> Float64s:
    """Return colours, shape (N, 3) or (N, 4) with opacity, as display values."""
    if encoding == "srgb":
        return values
    return np.column_stack([linear_to_srgb(values[:, :3]), values[:, 3:]])


def quantised(values: Float64s, depth: Depth) -> Array:
    return np.rint(np.clip(values, 0, 1) * np.iinfo(depth).max).astype(depth)
