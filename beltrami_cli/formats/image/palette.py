"""PNG files that store indices into a palette, which OpenImageIO reads as full colours and does not write.

References
----------
.. [1] PNG (Portable Network Graphics) Specification, third edition, W3C 2025, sections 9 and 11.
"""

from __future__ import annotations

import struct
import zlib
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.image.metadata import PNG_START, png_chunks
from beltrami_cli.surface.large_arrays import blocks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Array, Uint8s

_MOST = 256  # entries
_ROWS = 64  # looked at together
_OPAQUE = 255
_INDICES = 3  # as type of colour
_LEVEL, _LEVEL_OF_SMALL = 6, 9  # of compression


def encode_with_palette(pixels: Array, source: bytes, *, small: bool) -> bytes | None:
    """Encode pixels, (H, W, C) of 8 bits, with the palette of a PNG file; None if not all colours find room in it.

    Entries keep their numbers; colours that are not among them are added behind.
    """
    palette = _palette_of(source)
    indices = np.empty(pixels.shape[:2], np.uint8)
    for rows in blocks(len(pixels), _ROWS):
        colours, which = np.unique(_as_numbers(pixels[rows]), return_inverse=True)
        palette = np.concatenate([palette, colours[~np.isin(colours, palette)]])
        if len(palette) > _MOST:
            return None
        first_of = np.argsort(palette, kind="stable")
        places = first_of[np.searchsorted(palette, colours, sorter=first_of)]
        indices[rows] = places[which].reshape(indices[rows].shape)
    depth = source[24] if len(palette) <= 1 << source[24] else 8
    return _encoded(indices, palette, depth, _LEVEL_OF_SMALL if small else _LEVEL)


def _palette_of(source: bytes) -> NDArray[np.uint32]:
    """Return the entries of a palette, as `_as_numbers`."""
    chunks = {kind: bytes(chunk[8:-4]) for kind, chunk in png_chunks(source) if kind in (b"PLTE", b"tRNS")}
    colours = np.frombuffer(chunks.get(b"PLTE", b""), np.uint8)
    colours = colours[: len(colours) // 3 * 3].reshape(-1, 3)[:_MOST]
    alpha = np.full((len(colours), 1), _OPAQUE, np.uint8)
    stored = np.frombuffer(chunks.get(b"tRNS", b""), np.uint8)[: len(colours)]
    alpha[: len(stored), 0] = stored
    return _as_numbers(np.concatenate([colours, alpha], axis=1))


def _as_numbers(pixels: Array) -> NDArray[np.uint32]:
    """Return each pixel, of grey or colours, with or without opacity, as one number."""
    channels = pixels.shape[-1]
    entries = np.full((*pixels.shape[:-1], 4), _OPAQUE, np.uint8)
    entries[..., :3] = pixels[..., :3] if channels >= 3 else pixels[..., :1]
    if channels in (2, 4):
        entries[..., 3] = pixels[..., -1]
    return entries.view(np.uint32)[..., 0]


def _encoded(indices: Uint8s, palette: NDArray[np.uint32], depth: int, level: int) -> bytes:
    height, width = indices.shape
    entries = palette.view(np.uint8).reshape(-1, 4)
    alpha = entries[:, 3]
    last = int(np.flatnonzero(alpha != _OPAQUE).max(initial=-1))
    per_byte = 8 // depth
    padded = np.pad(indices, ((0, 0), (0, -width % per_byte))).reshape(height, -1, per_byte)
    shifts = np.arange(per_byte - 1, -1, -1, dtype=np.uint8) * depth
    packed = np.bitwise_or.reduce(padded << shifts, axis=2, dtype=np.uint8)
    lines = np.pad(packed, ((0, 0), (1, 0)))  # in front of each line, that it has no filter
    header = struct.pack(">IIBBBBB", width, height, depth, _INDICES, 0, 0, 0)
    transparency = [_chunk(b"tRNS", alpha[: last + 1].tobytes())] if last >= 0 else []
    return b"".join([
        PNG_START,
        _chunk(b"IHDR", header),
        _chunk(b"PLTE", entries[:, :3].tobytes()),
        *transparency,
        _chunk(b"IDAT", zlib.compress(lines.tobytes(), level)),
        _chunk(b"IEND", b""),
    ])  # fmt: skip


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
