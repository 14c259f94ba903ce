"""Comments and variables in the text headers of Radiance HDR and Netpbm files, which OpenImageIO leaves out.

References
----------
.. [1] Radiance File Formats, Greg Ward: lines of text up to an empty one, then the resolution and the pixels.
.. [2] ppm(5), Netpbm: comments reach from # to the end of a line, anywhere in the header.
"""

from __future__ import annotations

import re

_END = b"\n\n"  # of the header of an HDR file
_GAP = rb"(?:\s|#[^\n]*\n)+"
# P1 and P4 give width and height, the others the largest value, too, or in PFM files the scale.
_NETPBM = re.compile(rb"P(?:[14]%b\d+%b\d+|[^14]%b\d+%b\d+%b[-+.\deE]+)\s" % ((_GAP,) * 5))
_AFTER_MARK = 3  # bytes: "P6" and the end of the line
_MADE_BY_ENCODERS = (b"#?", b"FORMAT=")


def with_header(source: bytes, encoded: bytes, known: str) -> bytes:
    """Return an HDR or Netpbm image with the comments and variables of another file."""
    if known == "hdr":
        head, end, _ = source.partition(_END)
        return b"".join([head, end, encoded.partition(_END)[2]])
    comments = _comments(source)
    return b"".join([encoded[:_AFTER_MARK], *comments, encoded[_AFTER_MARK:]])


def header_lines(data: bytes, known: str) -> list[str]:
    """Return the comments and variables of an HDR or Netpbm file."""
    if known == "hdr":
        lines = data.partition(_END)[0].splitlines()
        return [line.decode("latin-1") for line in lines if not line.startswith(_MADE_BY_ENCODERS)]
    return [line.decode("latin-1").strip() for line in _comments(data)]


def _comments(data: bytes) -> list[bytes]:
    header = _NETPBM.match(data)
    return re.findall(rb"#[^\n]*\n", header[0]) if header else []
