"""How a JPEG file was quantised, from its headers.

The layout of markers and tables is that of ITU-T T.81, annex B.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.image.metadata import jpeg_segments

_START, _TABLES, _ADOBE = b"\xff\xd8", 0xDB, 0xEE

# Frames of 8-bit samples that are coded by Huffman's code: baseline, extended and progressive ones.
_FRAMES = 0xC0, 0xC1, 0xC2
_RGB = [*b"RGB"]  # components that are no luma and chroma

# The places of coefficients, row * 8 + column, in the order in which tables store them: along the diagonals, of which
# every second one is gone up.
_ZIGZAG = sorted(range(64), key=lambda at: (at // 8 + at % 8, at // 8 if (at // 8 + at % 8) % 2 else at % 8))

CODED_TOGETHER = 16  # blocks of all planes begin at rows and columns that are multiples of this


@dataclass(frozen=True)
class JpegTables:
    """Steps of the DCT coefficients of luma and of chroma, and the pixels that a sample of chroma spans."""

    steps: Float64s  # shape (1, 8, 8) of grey pictures, or (2, 8, 8)
    span: tuple[int, int]  # rows, columns: 1 or 2 each


def read_jpeg_tables(data: bytes | memoryview) -> JpegTables | None:
    """Read the tables of a grey or YCbCr picture; None of any other, or if they are damaged."""
    if data[: len(_START)] != _START:
        return None
    tables: dict[int, Float64s] = {}
    frame, transform = b"", 1
    try:
        for marker, segment in jpeg_segments(data):
            body = segment[4:]
            if marker == _TABLES:
                tables |= _tables(body)
            elif marker in _FRAMES:
                frame = bytes(body)
            elif marker == _ADOBE and body[:5] == b"Adobe":
                transform = body[11]
        found = _of_frame(frame, tables, transform)
    except (IndexError, KeyError, ValueError):
        return None
    # Decoders let steps of 0 pass, of which nothing can be a multiple.
    return None if found is None or found.steps.min() < 1 or min(found.span) < 1 else found


def _tables(body: bytes | memoryview) -> dict[int, Float64s]:
    """Return the tables of a segment by their numbers, each of shape (8, 8)."""
    found, at = {}, 0
    while at < len(body):
        kind = ">u2" if body[at] >> 4 else "u1"
        table = np.empty(64)
        table[_ZIGZAG] = np.frombuffer(body, kind, 64, at + 1)
        found[body[at] & 15] = table.reshape(8, 8)
        at += 1 + 64 * np.dtype(kind).itemsize
    return found


def _of_frame(frame: bytes, tables: dict[int, Float64s], transform: int) -> JpegTables | None:
    components = [frame[at : at + 3] for at in range(6, 6 + 3 * frame[5], 3)]
    if len(components) == 1:
        return JpegTables(tables[components[0][2]][None], (1, 1))
    identities = [component[0] for component in components]
    if len(components) != 3 or transform != 1 or identities == _RGB:
        return None
    luma, blue, red = components
    span = luma[1] & 15, luma[1] >> 4
    if max(span) > 2 or not blue[1] == red[1] == 0x11 or (tables[blue[2]] != tables[red[2]]).any():
        return None
    return JpegTables(np.stack([tables[luma[2]], tables[blue[2]]]), span)
