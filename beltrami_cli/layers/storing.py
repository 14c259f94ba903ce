"""Storage of new colours: in pixels and image files, and the changes that these make."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Indices
from beltrami_cli.formats.image.decoded_image import DecodedImage, is_unchanged
from beltrami_cli.formats.image.sample_types import as_stored
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.layers.settings import TextureSettings
from beltrami_cli.surface.colour_values import store_integers
from beltrami_cli.surface.large_arrays import blocks, kept_bytes
from beltrami_cli.surface.records import ImageFile, Slot
from beltrami_cli.surface.slots import COLOUR_SLOTS


@dataclass(frozen=True)
class SharedImage:
    """New pixels of an image that several slots show, each slot in its own channels."""

    slot: Slot
    key: str
    pixels: Array
    columns: list[int]  # the channels that change
    write: Callable[[Array], tuple[ImageFile, list[str]]]  # returns also notices

    def fits(self, other: SharedImage) -> bool:
        """Whether both can be stored in one file: colours and data are encoded differently."""
        is_of_kind = (self.slot in COLOUR_SLOTS) == (other.slot in COLOUR_SLOTS)
        return is_of_kind and set(self.columns).isdisjoint(other.columns)


@dataclass(frozen=True)
class StoredColours:
    """New colours for a document: of vertices, with their positions if they moved, or image files."""

    change: Change
    colours: Float32s | None = None
    positions: Float64s | None = None
    images: dict[tuple[Slot, str], ImageFile] = field(default_factory=dict)
    shared: tuple[SharedImage, ...] = ()
    notices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Change:
    """Sums of changes of colour values: their number, sum, sum of squares and maximum."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    @classmethod
    def between(cls, before: Float32s, after: Float32s) -> Change:
        parts = []
        for block in blocks(len(before)) if before.size else ():
            steps = np.abs(after[block] - before[block]).ravel()
            squares = float(np.einsum("i,i->", steps, steps, dtype=np.float64))
            parts.append(cls(steps.size, float(steps.sum(dtype=np.float64)), squares, float(steps.max())))
        return cls.joined(parts)

    @classmethod
    def joined(cls, changes: Iterable[Change]) -> Change:
        parts = [dataclasses.astuple(change) for change in changes]
        counts, totals, squares, largest = zip(*parts, strict=True) if parts else ((), (), (), (0.0,))
        return cls(sum(counts), sum(totals), sum(squares), max(largest))

    def summary(self) -> dict[str, float]:
        count = max(1, self.count)
        return {"mean": self.total / count, "rms": (self.squares / count) ** 0.5, "largest": self.largest}


def store(
    image: DecodedImage,
    table: Array,
    pixels: Indices,
    values: Float32s,
    channels: Sequence[int],
    threads: int,
) -> Change:
    """Write values of full scale 1, shape (K, M), to M channels of K pixels in place, clipped and rounded once."""
    if table.dtype.kind == "f":
        before = table[pixels[:, None], channels]
        for channel, old, new in zip(channels, before.T, values.T, strict=True):
            moved = new != old  # -0 is not changed to 0
            table[pixels[moved], channel] = as_stored(new[moved], image.kinds[channel])
        return Change.between(before, table[pixels[:, None], channels])
    return Change(values.size, *store_integers(table, pixels, values, channels, threads))


def dithered(values: Float32s, texels: Indices, width: int) -> Float32s:
    """Add a dither pattern of half a step of 8 bits to texels, so that rounding causes no banding.

    Multiples of a step are not changed. The pattern is interleaved gradient noise: J. Jimenez, "Next generation post
    processing in Call of Duty: Advanced Warfare", SIGGRAPH 2014.
    """
    row, column = np.divmod(texels.astype(np.int32), np.int32(width))
    pattern = (52.9829189 * ((0.06711056 * column + 0.00583715 * row) % 1)) % 1
    steps = values * np.float32(255)
    is_whole = np.abs(steps - np.rint(steps)) < 2e-3  # conversions to the working space and back are rounded
    # By less than half a step, to which rounding would go either way.
    spread = (steps + (0.98 * (pattern - 0.5)).astype(np.float32)[:, None]) / np.float32(255)
    return np.where(is_whole, values, spread)


def rewritten(
    image: DecodedImage, pixels: Array, wanted: TextureSettings, suffix: str | None, *, as_data: bool
) -> tuple[ImageFile, list[str]]:
    """Encode new pixels like an image's own file, or in another format; return the file and notices.

    If neither a pixel nor the format changed, the image's own file is returned.
    """
    if suffix is None and is_unchanged(image, pixels):
        return ImageFile(image.source, image.suffix), []
    quality, small = wanted.jpeg_quality, wanted.small
    file = write_image(image, pixels, suffix=suffix, jpeg_quality=quality, small=small, as_data=as_data)
    file = dataclasses.replace(file, content=kept_bytes(file.data), is_chosen=suffix is not None)
    return file, [*image.notices, *file.notices]


def all_images(
    stored: Iterable[StoredColours],
) -> tuple[dict[tuple[Slot, str], ImageFile], list[str]]:
    """Return the new images of all layers, and notices about images that several slots show.

    Occlusion is the red channel of an image, roughness and metalness are green and blue, usually of the same image.
    """
    images = dict[tuple[Slot, str], ImageFile]()
    joined = dict[str, list[list[SharedImage]]]()
    for each in stored:
        images |= each.images
        for new in each.shared:
            groups = joined.setdefault(new.key, [])
            if groups and all(new.fits(other) for other in groups[-1]):
                groups[-1].append(new)
            else:
                groups.append([new])
    notices = list[str]()
    for *others, last in (group for groups in joined.values() for group in groups):
        for other in others:
            last.pixels[..., other.columns] = other.pixels[..., other.columns]
        file, file_notices = last.write(last.pixels)
        images |= {(each.slot, last.key): file for each in (*others, last)}
        notices += file_notices
    return images, notices
