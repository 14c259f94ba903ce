"""Checks that images fit into memory, before any of them is decoded."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.reading import ImageSize, measure_image
from beltrami_cli.layers.settings import TextureSettings
from beltrami_cli.layers.texel_colours import choose_textures
from beltrami_cli.surface.large_arrays import kept_on_disk
from beltrami_cli.surface.records import Slot, Texture
from beltrami_cli.surface.worker_process import temporary_folder

# Bytes per pixel and per sample that a job on images needs in memory at least, besides the decoded images: to paint one
# at a time, its old and new colours in single precision; to smooth an image, the least of `beltrami info` and
# `beltrami noise`, from their peaks on noise of 1536 x 1536 pixels with one channel and three (41 + 13, 40 + 15); to
# compare two (30 + 1); to read heights or positions, as coordinates in double precision, as read and for each pixel.
PIXEL_BYTES = {"painted": (0, 2 * 4), "smoothed": (40, 13), "compared": (30, 1), "mapped": (3 * 8, 8)}

# Image files that are not read again stay in memory as they are, and as they are written.
_FILES = 2

# Bytes per texel of all textures, or per pixel of an image, that smoothing needs besides the images, at most: with
# large arrays in memory, for up to four channels, and in files.
TEXEL_BYTES, TEXEL_BYTES_ON_DISK = 195, 8
_CHANNELS = 4


def require_memory(
    images: Iterable[tuple[str, bytes]], access: Access, pixel_bytes: tuple[int, int] = PIXEL_BYTES["painted"]
) -> None:
    """Raise InputError if images cannot fit into memory: all as stored, and one of them as it is worked on.

    `pixel_bytes`: what that takes per pixel and per sample, by default that it is twice there as floats.
    """
    if access.memory is None:
        return
    decoded, working = 0, 0
    for name, size in _measured(images):
        decoded += size.decoded
        working = max(working, pixel_bytes[0] * size.texels + pixel_bytes[1] * size.samples)
        if decoded + working > access.memory:
            raise too_large(name, size)


def require_memory_for_textures(
    document: Document, slots: Iterable[Slot], wanted: TextureSettings, access: Access
) -> None:
    """Raise InputError if the chosen textures of a document cannot fit into memory, slot by slot."""
    for slot in slots:
        textures = choose_textures(document.textured(slot), wanted).textures
        require_memory(((texture.name, texture.data) for texture in textures), access)


@contextlib.contextmanager
def checked_memory(
    document: Document, slots: Sequence[Slot], wanted: TextureSettings, access: Access, target: str | None,
    *, image: bool, on_disk: bool = True, in_groups: bool,
) -> Iterator[None]:  # fmt: skip
    """Keep large arrays in files where memory is too small, for textures of some slots, or the `image` that it is.

    `in_groups`: some textures can be painted at a time.
    """
    if not on_disk:
        require_memory_for_textures(document, slots, wanted, access)
        yield
        return
    # The files have no name, and lie in `target`'s folder, or in the folder for temporary files.
    is_too_much = False
    memory = memory_beside(document, access)
    if memory is not None:
        for slot in slots:
            textures = choose_textures(document.textured(slot), wanted).textures
            sizes = list(_measured((texture.name, texture.data) for texture in textures))
            left = memory - held_by_files(textures)
            is_too_much |= _is_too_much(sizes, left, in_groups=in_groups)
        if image:
            sizes = list(_measured([(document.name, document.data)]))
            is_too_much = _is_too_much(sizes, memory, in_groups=False)
    if not is_too_much:
        yield
        return
    with contextlib.ExitStack() as stack:
        folder = Path(target).absolute().parent if target else stack.enter_context(temporary_folder())
        stack.enter_context(kept_on_disk(folder, memory))
        yield


def _is_too_much(sizes: Sequence[tuple[str, ImageSize]], memory: int, *, in_groups: bool) -> bool:
    """Return whether images cannot be smoothed together in memory; InputError if not even in files."""
    every = [size for _, size in sizes]
    if not fit_in_files(every, memory):
        for number, (name, size) in enumerate(sizes):
            if not fit_in_files([size] if in_groups else every[: number + 1], memory):
                raise too_large(name, size)
    working = sum(TEXEL_BYTES * max(size.texels, size.samples / _CHANNELS) for size in every)
    return 2 * sum(size.decoded for size in every) + working > memory


def fit_in_files(sizes: Iterable[ImageSize], memory: int) -> bool:
    """Whether images can be smoothed together where all large arrays are in files."""
    largest = texels = 0
    for size in sizes:
        largest, texels = max(largest, size.decoded), texels + size.texels
    return largest + TEXEL_BYTES_ON_DISK * texels <= memory


def too_many_together(textures: Sequence[Texture], memory: int | None) -> tuple[list[ImageSize], int] | None:
    """Return the sizes of textures that do not fit together, not even in files, and the memory; None: they do."""
    if memory is None or len(textures) < 2:
        return None
    known = [size for _, size in _measured((texture.name, texture.data) for texture in textures)]
    memory -= held_by_files(textures)
    return None if len(known) < len(textures) or fit_in_files(known, memory) else (known, memory)


def memory_beside(document: Document, access: Access) -> int | None:
    """Return the remaining bytes while a file is in memory; None: there is no limit."""
    return None if access.memory is None else access.memory - len(document.data)


def held_by_files(textures: Iterable[Texture]) -> int:
    """Return how many bytes image files take in memory all the time."""
    return sum(_FILES * len(texture.data) for texture in textures if not texture.is_read_anew)


def _measured(images: Iterable[tuple[str, bytes]]) -> Iterator[tuple[str, ImageSize]]:
    """Measure images; images that cannot be measured are left to their decoder, which raises the error."""
    for name, data in images:
        size = measure_image(data, name)
        if size is not None:
            yield name, size


def too_large(name: str, size: ImageSize) -> InputError:
    """Return the error that an image, with those around it, needs more memory than there is."""
    cause = f"its {size.width} x {size.height} pixels of {size.channels} channels do not fit into memory"
    return InputError(name, cause, "scale it down, or raise --max-memory")
