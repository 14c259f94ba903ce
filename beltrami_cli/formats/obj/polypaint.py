"""ZBrush's polypaint: colours of vertices in comments of an OBJ file, as MMRRGGBB in hexadecimal digits.

MM is a mask, which is kept. Lines start with ``#MRGB`` and hold up to 64 entries, in the order of the `v` lines.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.obj.statements import Statements
    from beltrami_cli.formats.obj.vertices import Vertices

MARK = b"#MRGB"
_LINE = re.compile(rb"^[ \t]*#MRGB[ \t]+(\S*)", re.MULTILINE)
_DIGITS = 8  # of an entry
_UPPER, _LOWER = (np.frombuffer(digits, np.uint8) for digits in (b"0123456789ABCDEF", b"0123456789abcdef"))
# By ASCII code, the value of a hexadecimal digit, 255 for anything else.
_VALUES = np.full(256, 255, np.uint8)
_VALUES[_UPPER] = _VALUES[_LOWER] = np.arange(16)


@dataclass(frozen=True)
class Polypaint:
    """The entries of a file.

    Attributes
    ----------
    colours : ndarray of uint8, shape (N, 3)
        Red, green and blue.
    starts : ndarray of int64, shape (N,)
        Where the first digit of every entry stands in the file.
    """

    colours: NDArray[np.uint8]
    starts: NDArray[np.int64]


def read_polypaint(data: bytes, vertices: int, name: str) -> Polypaint | None:
    """Read all entries of an OBJ file; None if it has none.

    Parameters
    ----------
    data : bytes
        The file.
    vertices : int
        How many vertices it has.
    name : str
        Its name for messages.

    Raises
    ------
    InputError
        If a line does not hold whole entries, or there is not one for every vertex.
    """
    lines = [match.span(1) for match in _LINE.finditer(data)]
    if not lines:
        return None
    starts = np.concatenate([np.arange(begin, end, _DIGITS) for begin, end in lines])
    text = np.frombuffer(data, np.uint8)
    if len(starts) != vertices:
        cause = f"there are {len(starts)} colours in its #MRGB lines, but {vertices} vertices"
        raise InputError(name, cause, "export the mesh again")
    for begin, end in lines:
        if (end - begin) % _DIGITS or (_VALUES[text[begin:end]] > 15).any():
            line = data.count(b"\n", 0, begin) + 1
            raise InputError(
                name, f"line {line}: its #MRGB colours are not of {_DIGITS} hexadecimal digits each"
            )
    digits = _VALUES[text[starts[:, None] + np.arange(2, _DIGITS)]].reshape(-1, 3, 2)
    return Polypaint(digits[:, :, 0] * np.uint8(16) + digits[:, :, 1], starts)


def painted_by(paint: Polypaint, vertices: Vertices, statements: Statements) -> Vertices:
    """Return vertices without colours of their own with those of the polypaint; only positions have tokens."""
    tokens, offsets = statements.arguments(statements.select(b"v"))
    places = tokens[offsets[:-1, None] + np.arange(3)]
    return replace(
        vertices,
        coloured=np.arange(len(vertices.positions)),
        colours=paint.colours.astype(np.float64),
        token_starts=statements.starts[places],
        token_ends=statements.ends[places],
    )


def repainted_entries(
    data: bytes, starts: NDArray[np.int64], colours: NDArray[np.float32], changed: NDArray[np.bool_]
) -> bytes:
    """Exchange the digits of the colours that changed, and keep every other byte.

    Parameters
    ----------
    data : bytes
        The file.
    starts : ndarray of int64, shape (N,)
        Where the entries stand.
    colours : ndarray of float32, shape (N, 3)
        New colours, full scale 1; clipped to [0, 1] and rounded to 8 bit, to the nearest.
    changed : ndarray of bool, shape (N, 3)
        Which of them differ from the old ones.
    """
    text = np.frombuffer(data, np.uint8).copy()
    written = text[starts[:, None] + np.arange(_DIGITS)]
    digits = _LOWER if (written >= ord("a")).any() else _UPPER
    rows, channels = np.nonzero(changed)
    values = np.rint(np.clip(colours[rows, channels].astype(np.float64), 0, 1) * 255).astype(np.uint8)
    places = starts[rows] + 2 + 2 * channels
    text[places], text[places + 1] = digits[values >> 4], digits[values & 15]
    return text.tobytes()
