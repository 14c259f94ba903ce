"""New positions and colours on the `v` lines of an OBJ file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.tokens import exchange_tokens

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Bytes

_DECIMALS = {1.0: (6, 9), 255.0: (4, 7)}  # by full scale, the least that lose nothing and the most of float32
_DIGITS = 8  # of the largest coordinate, at least: a little more than float32 has
_MOST_DECIMALS = 17


@dataclass(frozen=True)
class NewNumbers:
    """Tokens of a file and the numbers that replace them.

    Attributes
    ----------
    starts, ends : ndarray of int64, shape (K,)
        Where the tokens stand.
    values : ndarray of float64, shape (K,)
        The numbers.
    decimals : int
        How many each is written with.
    """

    starts: NDArray[np.int64]
    ends: NDArray[np.int64]
    values: NDArray[np.float64]
    decimals: int


def new_colours(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    colours: NDArray[np.float32],
    changed: NDArray[np.bool_],
    scale: float,
) -> NewNumbers:
    """Spell the colours that changed as the old ones are, within what is sensible.

    Parameters
    ----------
    data : bytes
        The file.
    starts, ends : ndarray of int64, shape (V, 3)
        Where the colours stand.
    colours : ndarray of float32, shape (V, 3)
        New colours, full scale 1.
    changed : ndarray of bool, shape (V, 3)
        Which of them differ from the old ones.
    scale : float
        The stored number that is full scale, 1 or 255.

    Returns
    -------
    NewNumbers
    """
    values = colours[changed].astype(np.float64) * scale
    decimals = 0
    found = _most_decimals(data, starts, ends) if len(values) else 0
    if found < 0 and scale != 1:
        values = np.clip(np.rint(values), 0, scale)
    else:
        least, most = _DECIMALS[scale]
        decimals = min(max(found, least), most)
    return NewNumbers(starts[changed], ends[changed], values, decimals)


def new_positions(
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    positions: NDArray[np.float64],
    changed: NDArray[np.bool_],
) -> NewNumbers:
    """Spell the coordinates that changed with as many decimals as the old ones, and no less than float32 has.

    Parameters
    ----------
    data : bytes
        The file.
    starts, ends : ndarray of int64, shape (V, 3)
        Where the coordinates stand.
    positions : ndarray of float64, shape (V, 3)
        New positions.
    changed : ndarray of bool, shape (V, 3)
        Which coordinates differ from the old ones.

    Returns
    -------
    NewNumbers
    """
    largest = float(np.abs(positions).max(initial=0)) or 1.0
    enough = _DIGITS - 1 - int(np.floor(np.log10(largest)))
    found = _most_decimals(data, starts, ends) if changed.any() else 0
    decimals = min(max(found, enough, 0), _MOST_DECIMALS)
    return NewNumbers(starts[changed], ends[changed], positions[changed], decimals)


def renumbered(data: bytes, parts: Sequence[NewNumbers]) -> list[Bytes]:
    """Exchange tokens for numbers, and keep every other byte.

    Parameters
    ----------
    data : bytes
        The file.
    parts : sequence of NewNumbers
        What is new; each token once.

    Returns
    -------
    list of bytes-like
        The new file, in pieces.
    """
    starts = np.concatenate([part.starts for part in parts])
    if not len(starts):
        return [data]
    ends = np.concatenate([part.ends for part in parts])
    values = np.concatenate([part.values for part in parts])
    decimals = np.repeat([part.decimals for part in parts], [len(part.starts) for part in parts])
    order = np.argsort(starts)

    def spell(block: slice) -> list[bytes]:
        chosen = order[block]
        pairs = zip(decimals[chosen].tolist(), values[chosen].tolist(), strict=True)
        return [b"%.*f" % pair for pair in pairs]

    return [*exchange_tokens(data, starts[order], ends[order], spell)]


def _most_decimals(data: bytes, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> int:
    """Return how many characters stand behind the point at most; negative if no token has one."""
    points = np.append(np.flatnonzero(np.frombuffer(data, np.uint8) == ord(".")), len(data))
    return int((ends - points[np.searchsorted(points, starts)] - 1).max())
