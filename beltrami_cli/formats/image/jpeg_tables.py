"""How a JPEG file codes its pixels: quantisation tables, chroma subsampling, progressive scans."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.image.containers.jpeg import START

CODED_TOGETHER = 16  # blocks of all planes begin at rows and columns that are multiples of this
_RGB = [*b"RGB"]  # identifiers of components that are not luma and chroma


@dataclass(frozen=True)
class JpegTables:
    """Quantisation steps of the DCT coefficients of luma and chroma, and the pixels that a chroma sample spans."""

    steps: Float64s  # shape (1, 8, 8) of grey images, or (2, 8, 8)
    span: tuple[int, int]  # rows, columns: 1 or 2 each


def is_progressive(data: bytes) -> bool:
    header = _header(data)
    return header is not None and "progressive" in header.info


def read_jpeg_tables(data: bytes | memoryview) -> JpegTables | None:
    """Read the tables of a grey or YCbCr image; None of any other, or if they are damaged."""
    header = _header(data)
    if header is None or not header.layer:
        return None
    tables = {number: np.array(table, np.float64) for number, table in header.quantization.items()}
    identifiers, across, down, used = zip(*header.layer, strict=True)
    if not all(number in tables and len(tables[number]) == 64 for number in used):
        return None
    steps, span = np.stack([tables[number].reshape(8, 8) for number in used]), (1, 1)
    if len(used) > 1:
        is_ycbcr = header.info.get("adobe_transform", 1) == 1 and [*identifiers] != _RGB
        if len(used) != 3 or not is_ycbcr or {*across[1:], *down[1:]} != {1} or (steps[1] != steps[2]).any():
            return None
        steps, span = steps[:2], (down[0], across[0])
    # Decoders let steps of 0 pass, which have no multiples.
    return JpegTables(steps, span) if steps.min() >= 1 and {*span} <= {1, 2} else None


def _header(data: bytes | memoryview) -> Any:
    """Return the header of a JPEG file as Pillow reads it; None if it is none, or damaged."""
    if data[: len(START)] != START:
        return None
    from PIL.JpegImagePlugin import JpegImageFile

    try:
        return JpegImageFile(io.BytesIO(data))
    except (OSError, SyntaxError, ValueError):
        return None
