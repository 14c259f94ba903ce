"""ZBrush's polypaint: colours of vertices in the comments of an OBJ file.

They are MMRRGGBB in hexadecimal digits. MM is a mask, which is kept. Lines start with ``#MRGB`` and hold up to 64
entries, in the order of the `v` lines.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Int64s, Uint8s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.colours import quantised
from beltrami_cli.formats.files.edits import zeroed

MARK = b"#MRGB"
_LINE = re.compile(rb"^[ \t]*#MRGB[ \t]+(\S*)", re.MULTILINE)
_ENTRY, _MASK = 8, 2  # digits of an entry, and of the mask that it starts with
_UPPER, _LOWER = (np.frombuffer(digits, np.uint8) for digits in (b"0123456789ABCDEF", b"0123456789abcdef"))
# By ASCII code, the value of a hexadecimal digit, 255 for anything else.
_VALUES = np.full(256, 255, np.uint8)
_VALUES[_UPPER] = _VALUES[_LOWER] = np.arange(16)


@dataclass(frozen=True)
class Polypaint:
    """The entries of a file."""

    colours: Uint8s  # (N, 3)
    starts: Int64s  # (N,) where the first digit of every entry stands in the file


def read_polypaint(data: bytes, vertices: int, name: str) -> Polypaint | None:
    lines = [match.span(1) for match in _LINE.finditer(data)]
    if not lines:
        return None
    starts = np.concatenate([np.arange(begin, end, _ENTRY) for begin, end in lines])
    text = np.frombuffer(data, np.uint8)
    if len(starts) != vertices:
        cause = f"there are {len(starts)} colours in its #MRGB lines, but {vertices} vertices"
        raise InputError(name, cause, "export the mesh again")
    for begin, end in lines:
        if (end - begin) % _ENTRY or (_VALUES[text[begin:end]] > 15).any():
            line = data.count(b"\n", 0, begin) + 1
            cause = f"line {line}: its #MRGB colours are not of {_ENTRY} hexadecimal digits each"
            raise InputError(name, cause)
    digits = _VALUES[text[starts[:, None] + np.arange(_MASK, _ENTRY)]].reshape(-1, 3, 2)
    return Polypaint(digits[:, :, 0] * np.uint8(16) + digits[:, :, 1], starts)


def with_entries(data: bytes, starts: Int64s, colours: Float32s, changed: Bools) -> bytes:
    """Replace the digits of changed colours, (N, 3), rounded to 8 bits; other bytes stay unchanged."""
    text = np.frombuffer(data, np.uint8).copy()
    written = text[starts[:, None] + np.arange(_ENTRY)]
    digits = _LOWER if (written >= ord("a")).any() else _UPPER
    rows, channels = np.nonzero(changed)
    values = quantised(colours[rows, channels], np.uint8)
    places = starts[rows] + _MASK + 2 * channels
    text[places], text[places + 1] = digits[values >> 4], digits[values & 15]
    return text.tobytes()


def without_entries(data: bytes, starts: Int64s) -> bytes:
    """Replace the digits of all colours by zero bytes."""
    return zeroed(data, starts + _MASK, _ENTRY - _MASK)
