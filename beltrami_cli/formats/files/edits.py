"""New numbers and other new bytes in a file whose other bytes stay."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Int64s
from beltrami_cli.surface.large_arrays import blocks

PLACEHOLDER = b"\0"  # for values that may differ, in a part of a fingerprint
Spans = dict[tuple[int, int], bytes]  # new bytes, by start and end of the old ones
_MIN_DIGITS, _MAX_DIGITS = 6, 9  # of full scale: as fine as 20 bits, and all that single precision has
_WITH_EXPONENT = b"%.9g"
_BLOCK = 1 << 16  # tokens at a time, which bounds the memory of the pieces


def exchange_tokens(
    text: bytes, starts: Int64s, ends: Int64s, spell: Callable[[slice], Sequence[bytes]]
) -> list[bytes | memoryview]:
    """Replace T tokens at ascending offsets; return the text in pieces. `spell` formats a slice of the new tokens."""
    whole = memoryview(text)
    pieces: list[bytes | memoryview] = []
    done = 0
    for block in blocks(len(starts), _BLOCK):
        begins, stops = starts[block].tolist(), ends[block].tolist()
        kept = [text[a:b] for a, b in zip([done, *stops[:-1]], begins, strict=True)]
        pieces.append(b"".join(chain.from_iterable(zip(kept, spell(block), strict=True))))
        done = stops[-1]
    pieces.append(whole[done:])
    return pieces


@dataclass(frozen=True)
class NewNumbers:
    """Tokens of a text and the numbers that replace them."""

    starts: Int64s  # (K,) offsets of the tokens
    ends: Int64s
    values: Array
    style: bytes = b""  # %-format of a number; empty: the shortest that reads back as the same number

    def spelled(self, chosen: Int64s) -> list[bytes]:
        values = self.values[chosen]
        if self.style:
            return [self.style % value for value in values.tolist()]
        shortest: list[bytes] = values.astype("S32").tolist()
        return shortest


def renumbered(text: bytes, parts: Sequence[NewNumbers]) -> list[bytes | memoryview]:
    """Replace tokens by numbers, each token once; return the text in pieces."""
    starts, ends = (
        np.concatenate(both) for both in zip(*((part.starts, part.ends) for part in parts), strict=True)
    )
    order = np.argsort(starts)
    firsts = np.cumsum([0, *(len(part.starts) for part in parts)])

    def spell(block: slice) -> list[bytes]:
        wanted = order[block]
        spelled = np.empty(len(wanted), object)
        for part, first, stop in zip(parts, firsts[:-1], firsts[1:], strict=True):
            mine = (wanted >= first) & (wanted < stop)
            spelled[mine] = part.spelled(wanted[mine] - first)
        in_order: list[bytes] = spelled.tolist()
        return in_order

    return exchange_tokens(text, starts[order], ends[order], spell) if len(starts) else [text]


def new_colours(
    text: bytes, starts: Int64s, ends: Int64s, before: Float32s, after: Float32s, scale: float
) -> NewNumbers:
    """Format the changed colours like the old ones; arrays have shape (V, C), and `scale` is full scale."""
    changed, values, style = after != before, after.astype(np.float64) * scale, _WITH_EXPONENT
    characters = np.frombuffer(text, np.uint8)
    exponents = np.append(np.flatnonzero((characters == ord("e")) | (characters == ord("E"))), len(text))
    if not (exponents[np.searchsorted(exponents, starts)] < ends).any():
        decimals = _colour_decimals(text, starts.ravel(), ends.ravel(), scale)
        style = b"%%.%df" % max(decimals, 0)
        if decimals < 0:
            low, high = min(0, before.min()) * scale, max(1, before.max()) * scale
            values = np.rint(np.clip(values, low, high)) + 0.0  # no -0
            changed &= values != np.rint(before.astype(np.float64) * scale)
    return NewNumbers(starts[changed], ends[changed], values[changed], style)


def most_decimals(text: bytes, starts: Int64s, ends: Int64s) -> int:
    """Return the largest number of decimals of a token; negative if no token has a decimal point."""
    points = np.append(np.flatnonzero(np.frombuffer(text, np.uint8) == ord(".")), len(text))
    return int((ends - points[np.searchsorted(points, starts)] - 1).max())


def _colour_decimals(text: bytes, starts: Int64s, ends: Int64s, scale: float) -> int:
    """Return the number of decimals for new colours: that of the old ones, within the precision of float32.

    Negative if all old colours are integers, so that the new ones should be, too.
    """
    found = most_decimals(text, starts, ends)
    if found < 0 and scale > 1:
        return -1
    left = int(np.floor(np.log10(scale)))  # digits before the point, but for one
    return min(max(found, _MIN_DIGITS - left, 0), max(_MAX_DIGITS - left, 0))


def without_tokens(text: bytes, starts: Int64s, ends: Int64s) -> bytes:
    """Replace tokens by placeholders; arguments as for `exchange_tokens`."""
    pieces = exchange_tokens(text, starts, ends, lambda block: [PLACEHOLDER] * (block.stop - block.start))
    return b"".join(pieces)


def exchange_spans(data: bytes, spans: Spans) -> bytes:
    pieces, done = [], 0
    for (start, end), new in sorted(spans.items()):
        pieces += [data[done:start], new]
        done = end
    return b"".join([*pieces, data[done:]]) if spans else data


def shifted(places: Int64s, spans: Spans) -> Int64s:
    """Return new offsets of places outside of the spans after `exchange_spans`."""
    ordered = sorted(spans.items())
    growth = np.cumsum([0, *(len(new) - (end - start) for (start, end), new in ordered)])
    moved: Int64s = places + growth[np.searchsorted([start for (start, _), _ in ordered], places)]
    return moved


def zeroed(data: bytes, starts: Int64s, size: int) -> bytes:
    """Set `size` bytes at each of n offsets to zero."""
    octets: Array = np.frombuffer(data, np.uint8).copy()
    for step in range(size):
        octets[starts + step] = 0
    return octets.tobytes()
