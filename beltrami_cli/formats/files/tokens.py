"""Tokens of text files by their positions: find them, read them as numbers, and write lines of numbers."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator

import numpy as np

from beltrami_cli.arrays import Array, Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.large_arrays import blocks

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
# NaN and infinity as Microsoft's C library printed them until 2015.
_MICROSOFT_NAN = re.compile(rb"(?<!\S)[-+]?1\.#(?:[QS]NAN|IND|INF)\d*(?=[\s,;]|\Z)")
_SOLID = bytes(character not in b" \t\n\v\f\r" for character in range(256))
_MAX_SHOWN = 40  # bytes of a token in a message
_LONGEST_LINE = 1 << 22  # bytes: a polygon of some 200,000 corners
_BLOCK = 1 << 16  # lines at a time, which bounds the memory of the pieces


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


def number_lines(style: str, *tables: Array) -> Iterator[bytes]:
    """Yield lines for the rows of tables, side by side; "%s" is the shortest token that reads back as that number."""
    kinds = re.findall(r"%[.\d]*([sdf])", style)
    for block in blocks(len(tables[0]), _BLOCK):
        columns = zip(kinds, (column for table in tables for column in table[block].T), strict=True)
        tokens = [(each.astype("U32") if kind == "s" else each).tolist() for kind, each in columns]
        yield "".join([style % row for row in zip(*tokens, strict=True)]).encode()
