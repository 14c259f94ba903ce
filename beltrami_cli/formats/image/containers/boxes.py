"""Boxes of JPEG 2000 and JPEG XL files; new files keep none of them."""

from __future__ import annotations

import re
from collections.abc import Iterator

_HEADER_BOX = b"jp2h"
# Boxes that hold pixels, or how they are stored.
_STRUCTURE = (
    b"jP  ", b"ftyp", _HEADER_BOX, b"ihdr", b"bpcc", b"colr", b"pclr", b"cmap", b"cdef", b"jp2c",
    b"JXL ", b"jxlc", b"jxlp", b"jxll", b"jxli",
)  # fmt: skip
_CODESTREAM = b"\xff\x4f"  # of JPEG 2000, without boxes
_TILE = b"\xff\x90"
_COMMENT = re.compile(rb"\xff\x64..\x00\x01(?!Created by OpenJPEG)", re.DOTALL)


def metadata_names(data: bytes) -> dict[str, bool]:
    kinds = (kind.decode("latin-1").strip() for kind in _boxes(data) if kind not in _STRUCTURE)
    names = [f"box {kind}" for kind in kinds]
    is_jpeg_2000 = data[4:8] == b"jP  " or data.startswith(_CODESTREAM)
    if is_jpeg_2000 and _COMMENT.search(data.partition(_TILE)[0]):
        names.append("comment")
    return dict.fromkeys(names, False)


def _boxes(data: bytes) -> Iterator[bytes]:
    """Yield the types of the boxes of an ISO file; a bare stream of code has none."""
    at = 0
    while at + 8 <= len(data) and data[4:8] in (b"jP  ", b"JXL "):
        size, kind = int.from_bytes(data[at : at + 4]), data[at + 4 : at + 8]
        yield kind
        if kind == _HEADER_BOX:  # with boxes of its own
            size = 8
        elif size == 1:
            size = int.from_bytes(data[at + 8 : at + 16])
        if size < 8:  # up to the end of the file
            return
        at += size
