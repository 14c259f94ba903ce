"""Numbers in text files: where they stand, what they are, and how some are exchanged for others."""

from __future__ import annotations

import warnings
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

Spans = dict[tuple[int, int], bytes]
"""New bytes by where the old ones start and end."""

_SOLID = bytes(character not in b" \t\n\v\f\r" for character in range(256))
_BLOCK = 1 << 16  # tokens exchanged at a time, which bounds the memory that the pieces take


def find_tokens(text: bytes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the runs of bytes other than white space (blank, tab, line ends, vertical tab, form feed).

    Parameters
    ----------
    text : bytes
        N bytes.

    Returns
    -------
    starts, ends : ndarray of int64, shape (T,)
        Token t is ``text[starts[t]:ends[t]]``.
    """
    solid = np.frombuffer(text.translate(_SOLID), np.bool_)
    if not solid.size:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    edges = np.flatnonzero(solid[1:] != solid[:-1]) + 1  # where tokens start and end, by turns
    if solid[0]:
        edges = np.insert(edges, 0, 0)
    if solid[-1]:
        edges = np.append(edges, len(text))
    return edges[::2], edges[1::2]


def read_numbers(text: bytes) -> NDArray[np.float64]:
    """Read the numbers that a text starts with, up to the first token that is none.

    Parameters
    ----------
    text : bytes
        Tokens between white space.

    Returns
    -------
    ndarray of float64, shape (T,)
        As many values as tokens if all are decimal numbers (or "nan", "inf"), otherwise fewer.
    """
    values = _parse(text)
    if values is not None:
        return values
    starts, _ = find_tokens(text)
    bounds = np.append(starts, len(text))
    good, bad = 0, len(starts)  # The first `good` tokens are numbers; one of those up to `bad` is not.
    parts = [np.empty(0)]
    while good < bad:
        middle = (good + bad + 1) // 2
        part = _parse(text[bounds[good] : bounds[middle]])
        if part is None:
            bad = middle - 1
        else:
            parts.append(part)
            good = middle
    return np.concatenate(parts)


def _parse(text: bytes) -> NDArray[np.float64] | None:
    if not text or text.isspace():
        return np.empty(0)  # NumPy would make one number of blanks.
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # what NumPy 1.26 does instead of raising
        try:
            return np.fromstring(text, np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def exchange_tokens(
    text: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    spell: Callable[[slice], Sequence[bytes]],
) -> list[bytes | memoryview]:
    """Exchange some tokens of a text and keep every other byte.

    Parameters
    ----------
    text : bytes
        The text.
    starts, ends : ndarray of int64, shape (T,)
        Where the tokens to be exchanged stand, in ascending order.
    spell : callable
        Gives for a slice of ``range(T)`` the tokens to be put there.

    Returns
    -------
    list of bytes-like
        The new text, in pieces.
    """
    whole = memoryview(text)
    pieces: list[bytes | memoryview] = []
    done = 0
    for first in range(0, len(starts), _BLOCK):
        block = slice(first, min(first + _BLOCK, len(starts)))
        begins, stops = starts[block].tolist(), ends[block].tolist()
        kept = [text[a:b] for a, b in zip([done, *stops[:-1]], begins, strict=True)]
        pieces.append(b"".join(chain.from_iterable(zip(kept, spell(block), strict=True))))
        done = stops[-1]
    pieces.append(whole[done:])
    return pieces


def exchange_spans(data: bytes, spans: Spans) -> bytes:
    """Return data with the bytes at some spans exchanged for others."""
    pieces, done = [], 0
    for (start, end), new in sorted(spans.items()):
        pieces += [data[done:start], new]
        done = end
    return b"".join([*pieces, data[done:]]) if spans else data
