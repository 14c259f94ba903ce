"""Text headers of Radiance HDR and Netpbm files; a new file keeps comments and variables.

References
----------
.. [1] Radiance File Formats, Greg Ward: lines of text up to an empty one, then the resolution and the pixels.
.. [2] ppm(5), Netpbm: comments reach from # to the end of a line, anywhere in the header.
"""

from __future__ import annotations

import re

import numpy as np

_RADIANCE = b"#?"
_END = b"\n\n"  # of the header of an HDR file
_GAP = rb"(?:\s|#[^\n]*\n)+"
# P1 and P4 give width and height, the others the largest value, too, or in PFM files the scale.
_NETPBM = re.compile(rb"P(?:[14]%b\d+%b\d+|[^14]%b\d+%b\d+%b(\S+))\s" % ((_GAP,) * 5))
_AFTER_MARK = 3  # bytes: "P6" and the end of the line
_NETPBM_TEXT, _NETPBM_FLOATS = (b"1", b"2", b"3"), (b"F", b"f")
_MADE_BY_ENCODERS = (_RADIANCE, b"FORMAT=")


def carried_over(source: bytes, encoded: bytes) -> bytes:
    """Return an image with the comments and variables of another file of its format."""
    if source.startswith(_RADIANCE):
        head, end, _ = source.partition(_END)
        return b"".join([head, end, encoded.partition(_END)[2]])
    comments, old_header, header = _comments(source), _NETPBM.match(source), _NETPBM.match(encoded)
    further = b""  # images, or other data
    if old_header and header and source[1:2] == encoded[1:2] not in _NETPBM_TEXT:
        further = source[old_header.end() + len(encoded) - header.end() :]
        if source[1:2] in _NETPBM_FLOATS:
            return b"".join([old_header[0], _unscaled(source, encoded, old_header, header), further])
    return b"".join([encoded[:_AFTER_MARK], *comments, encoded[_AFTER_MARK:], further])


def _unscaled(source: bytes, encoded: bytes, old: re.Match[bytes], new: re.Match[bytes]) -> bytes:
    """Return the numbers of a PFM file before the scale in its header, which OpenImageIO applies and replaces by 1.

    Many programs read the numbers without it, as disparities.
    """
    orders = ["<f4" if header[1].startswith(b"-") else ">f4" for header in (old, new)]
    values = np.frombuffer(encoded, orders[1], offset=new.end())
    before = np.frombuffer(source, orders[0], len(values), old.end())
    scale = np.float32(abs(float(old[1])))
    is_old = before * scale == values  # and keeps all bits
    return np.where(is_old, before, values / scale).astype(orders[0]).tobytes()


def has_usual_scale(data: bytes) -> bool:
    """Whether the scale of a PFM file is a normal number of single precision; True for other files."""
    header = _NETPBM.match(data)
    if header is None or data[1:2] not in _NETPBM_FLOATS:
        return True
    try:
        scale = abs(float(header[1]))
    except ValueError:
        return False
    limits = np.finfo(np.float32)  # in which OpenImageIO multiplies
    return bool(limits.tiny <= scale <= limits.max)


def metadata_names(data: bytes) -> dict[str, bool]:
    lines = [line.strip() for line in _comments(data)]
    if data.startswith(_RADIANCE):
        header = data.partition(_END)[0].splitlines()
        lines = [line for line in header if not line.startswith(_MADE_BY_ENCODERS)]
    return {line.decode("latin-1"): False for line in lines}


def _comments(data: bytes) -> list[bytes]:
    header = _NETPBM.match(data)
    return re.findall(rb"#[^\n]*\n", header[0]) if header else []
