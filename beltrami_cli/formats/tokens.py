"""Tokens of text files by their positions: find and read numbers, and replace tokens while every other byte stays."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from beltrami_cli.arrays import Array, Float32s, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.large_arrays import blocks

PLACEHOLDER = b"\0"  # for values that may differ, in a part of a fingerprint
Spans = dict[tuple[int, int], bytes]  # new bytes, by start and end of the old ones
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
# NaN and infinity as Microsoft's C library printed them until 2015.
_MICROSOFT_NAN = re.compile(rb"(?<!\S)[-+]?1\.#(?:[QS]NAN|IND|INF)\d*(?=[\s,;]|\Z)")
_SOLID = bytes(character not in b" \t\n\v\f\r" for character in range(256))
_MAX_SHOWN = 40  # bytes of a token in a message
_LONGEST_LINE = 1 << 22  # bytes: a polygon of some 200,000 corners
_MIN_DIGITS, _MAX_DIGITS = 6, 9  # of full scale: as fine as 20 bits, and all that single precision has
_WITH_EXPONENT = b"%.9g"
_BLOCK = 1 << 16  # tokens or lines at a time, which bounds the memory of the pieces


def find_tokens(text: bytes) -> tuple[Int64s, Int64s]:
    """Return starts and ends, shape (T,), of the tokens between ASCII white space."""
    solid = np.frombuffer(text.translate(_SOLID), np.bool_)
    # Starts and ends of tokens, alternating.
    edges = np.flatnonzero(np.diff(solid, prepend=False, append=False))
    return edges[::2], edges[1::2]


def require_short_lines(text: bytes, name: str) -> None:
    """Raise InputError if a line exceeds the limit: parsing takes many times the memory of a line."""
    # A longer line spans at least one block of half the limit without a line end, which is searched for first.
    for block in blocks(len(text), _LONGEST_LINE // 2):
        if text.find(b"\n", block.start, block.stop) < 0 and text.find(b"\r", block.start, block.stop) < 0:
            begin = max(text.rfind(end, 0, block.start) for end in (b"\n", b"\r")) + 1
            ends = [at for end in (b"\n", b"\r") if (at := text.find(end, block.stop)) >= 0]
            if min(ends, default=len(text)) - begin > _LONGEST_LINE:
                line = text.count(b"\n", 0, begin) + 1
                cause = f"line {line} has more than {_LONGEST_LINE} characters"
                raise InputError(name, cause, "write one record a line")


def without_comments(text: bytes, *marks: bytes) -> bytes:
    """Blank a byte order mark, and each comment from its mark to the end of the line; offsets do not change."""
    if text.startswith(_BYTE_ORDER_MARK):
        text = b"   " + text[3:]
    text = _with_plain_nan(text)
    if any(mark in text for mark in marks):
        text = re.sub(rb"(?:%s)[^\r\n]*" % b"|".join(marks), lambda found: b" " * len(found[0]), text)
    return text


class Lines:
    """The tokens of a file by lines: non-empty line l has the tokens from `heads[l]` up to `stops[l]`."""

    def __init__(self, data: bytes, text: bytes, name: str) -> None:
        """`text`: the data with comments blanked."""
        require_short_lines(text, name)
        self.data, self.name = data, name
        self.characters = np.frombuffer(text, np.uint8)
        self.starts, self.ends = find_tokens(text)
        line_ends = np.flatnonzero(self.characters == ord("\n"))
        if b"\r" in text:
            line_ends = np.union1d(line_ends, np.flatnonzero(self.characters == ord("\r")))
        # The tokens before a line end start before it.
        stops = np.append(np.searchsorted(self.starts, line_ends), len(self.starts))
        heads = np.append(0, stops[:-1])
        self.heads, self.stops = heads[heads < stops], stops[heads < stops]

    def numbers(self, tokens: Int64s) -> Float64s:
        """Read tokens, given in file order, as numbers; InputError if one is not a number."""
        if not tokens.size:
            return np.empty(0)
        begin, end = int(self.starts[tokens[0]]), int(self.ends[tokens[-1]])
        only = self.characters[begin:end]
        if len(tokens) <= tokens[-1] - tokens[0]:  # other tokens lie between them
            inside = np.zeros(end - begin + 1, np.int8)
            inside[self.starts[tokens] - begin] = 1
            inside[self.ends[tokens] - begin] = -1
            np.cumsum(inside, out=inside)
            only = np.where(inside[:-1].view(np.bool_), only, np.uint8(ord(" ")))
        values = read_numbers(only.tobytes())
        if len(values) < len(tokens):
            raise self.error(tokens[len(values)], "is not a number")
        return values

    def word(self, token: int | np.int64) -> bytes:
        return self.data[int(self.starts[token]) : int(self.ends[token])]

    def error(self, token: int | np.int64, cause: str) -> InputError:
        shown = self.word(token)[:_MAX_SHOWN].decode("ascii", "backslashreplace")
        return InputError(self.name, f"line {self.line(token)}: '{shown}' {cause}")

    def line(self, token: int | np.int64) -> int:
        before = self.data[: int(self.starts[token])]
        return max(before.count(b"\n"), before.count(b"\r")) + 1


def read_numbers(text: bytes) -> Float64s:
    """Return the numbers ("nan" and "inf" included) at the start of a text, up to the first other token."""
    text = _with_plain_nan(text)
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


def _with_plain_nan(text: bytes) -> bytes:
    """Replace 1.#QNAN, -1.#IND, 1.#INF and the like by "nan(000)" of the same length."""
    if b".#" not in text:
        return text
    return _MICROSOFT_NAN.sub(lambda found: b"nan(%s)" % (b"0" * (len(found[0]) - len("nan()"))), text)


def _parse(text: bytes) -> Float64s | None:
    if not text or text.isspace():
        return np.empty(0)  # NumPy would return one number for blanks.
    with warnings.catch_warnings():
        # Older versions of NumPy warn instead of raising.
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


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
    """Replace the bytes of each span."""
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


def number_lines(style: str, *tables: Array) -> Iterator[bytes]:
    """Yield lines for the rows of tables, side by side; "%s" is the shortest token that reads back as that number."""
    kinds = re.findall(r"%[.\d]*([sdf])", style)
    for block in blocks(len(tables[0]), _BLOCK):
        columns = zip(kinds, (column for table in tables for column in table[block].T), strict=True)
        tokens = [(each.astype("U32") if kind == "s" else each).tolist() for kind, each in columns]
        yield "".join([style % row for row in zip(*tokens, strict=True)]).encode()


def zeroed(data: bytes, starts: Int64s, size: int) -> bytes:
    """Set `size` bytes at each of n offsets to zero."""
    octets: Array = np.frombuffer(data, np.uint8).copy()
    for step in range(size):
        octets[starts + step] = 0
    return octets.tobytes()
