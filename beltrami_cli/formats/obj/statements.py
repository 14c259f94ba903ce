"""The statements of a Wavefront OBJ file, parsed in bulk.

References
----------
.. [1] Wavefront Technologies, "Advanced Visualizer manual, appendix B1: object files (.obj)".
"""

from __future__ import annotations

import re

import numpy as np

from beltrami_cli.arrays import Bools, Float64s, Int64s
from beltrami_cli.formats.files.tokens import Lines, without_comments
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.precision import fits_single

_INDICES = {
    b"v": (0, "vertex", "is not a vertex index"),
    b"vt": (1, "texture coordinates", "has no index of texture coordinates behind its first '/'"),
    b"vn": (2, "normal", "has no index of a normal behind its second '/'"),
}
"""By kind of index: the number of "/" before it in a corner, its target, and the error without it."""

_DIGITS = 18  # of an index, no more than an int64 can hold
_LINE_END = re.compile(rb"[\r\n]")
_BLOCK = 1 << 18  # indices parsed at a time, which bounds the memory for their digits


class Statements(Lines):
    """The statements of a file: s has the keyword `heads[s]` and the tokens up to `stops[s]`."""

    def __init__(self, data: bytes, name: str) -> None:
        super().__init__(data, _plain(data), name)

    def select(self, keyword: bytes) -> Int64s:
        chosen = np.flatnonzero(self.ends[self.heads] - self.starts[self.heads] == len(keyword))
        for place, character in enumerate(keyword):
            chosen = chosen[self.characters[self.starts[self.heads[chosen]] + place] == character]
        return chosen

    def arguments(self, chosen: Int64s) -> tuple[Int64s, Int64s]:
        """Return the K tokens after the keywords of N statements, and their N + 1 offsets by statement."""
        firsts = self.heads[chosen] + 1
        sizes = self.stops[chosen] - firsts
        offsets = np.append(0, np.cumsum(sizes))
        return np.repeat(firsts - offsets[:-1], sizes) + np.arange(offsets[-1]), offsets

    def require_finite(self, tokens: Int64s, values: Float64s, rows: Int64s) -> None:
        finite = fits_single(values[rows])
        if not finite.all():
            raise self.error(
                tokens[rows[int(np.argmin(finite))]], "is not a finite number of single precision"
            )

    def corners(self, keyword: bytes) -> tuple[Int64s, Int64s, Int64s]:
        """Return the rows of a keyword (v, vt, vn) at K corners, -1: none, their tokens, and polygon offsets."""
        targets, polygons = self.select(keyword), self.select(b"f")
        tokens, offsets = self.arguments(polygons)
        place, what, cause = _INDICES[keyword]
        index = self._indices(tokens, place, cause)
        before = np.repeat(np.searchsorted(targets, polygons), np.diff(offsets))
        rows = np.where(index < 0, before + index, index - 1)
        outside = (rows < 0) | (rows >= len(targets))
        if place:
            outside &= index != 0
        if outside.any():
            wrong = tokens[int(np.argmax(outside))]
            raise self.error(wrong, f"refers to no {what}; there are {len(targets)}")
        return np.where(index == 0, -1, rows), tokens, offsets

    def _indices(self, tokens: Int64s, slash: int, cause: str) -> Int64s:
        """Read the whole numbers that tokens start with, or have behind their first or second "/"; else 0."""
        values = np.zeros(len(tokens), np.int64)
        slashes = np.empty(0, np.int64)
        if slash:
            slashes = np.flatnonzero(self.characters == ord("/"))
            slashes = np.append(slashes, np.full(slash, len(self.characters)))
        for block in blocks(len(tokens), _BLOCK):
            chosen = tokens[block]
            begins, given = self.starts[chosen], np.ones(len(chosen), np.bool_)
            if slash:
                begins = slashes[np.searchsorted(slashes[:-slash], begins) + slash - 1] + 1
                given = begins < self.ends[chosen]
                given[given] = self.characters[begins[given]] != ord("/")
            values[block][given], zeros = self._whole(chosen[given], begins[given], cause)
            if slash and zeros.any():
                wrong = chosen[given][int(np.argmax(zeros))]
                raise self.error(wrong, "has the index 0; indices count from 1")
        return values

    def _whole(self, tokens: Int64s, first: Int64s, cause: str) -> tuple[Int64s, Bools]:
        """Read whole numbers that start at some places in tokens; return them, and which of them are 0."""
        ends = self.ends[tokens]
        negative = self.characters[first] == ord("-")
        at = first + negative
        begin = at.copy()
        values = np.zeros(len(tokens), np.int64)
        going = np.ones(len(tokens), np.bool_)
        for _ in range(_DIGITS):
            digits = self.characters[at] - np.uint8(ord("0"))
            going &= digits < 10
            if not going.any():
                break
            values = np.where(going, 10 * values + digits, values)
            at += going
        wrong = (at == begin) | ((at < ends) & (self.characters[at] != ord("/")))
        if wrong.any():
            raise self.error(tokens[int(np.argmax(wrong))], cause)
        return np.where(negative, -values, values), values == 0

    def rest(self, statement: int | np.int64) -> tuple[bytes, int]:
        """Return the unchanged text after the keyword of a statement, to the end of the line, and its offset."""
        begin = int(self.ends[self.heads[statement]])
        end = _LINE_END.search(self.data, begin)
        line = self.data[begin : end.start() if end else len(self.data)]
        return line.strip(), begin + len(line) - len(line.lstrip())


def _plain(data: bytes) -> bytes:
    """Blank comments, a byte order mark and joints of continued lines, and end with a line end; no byte moves."""
    text = without_comments(data if data.endswith(b"\n") else data + b"\n", b"#")
    if b"\\" in text:
        text = text.replace(b"\\\r\n", b"   ").replace(b"\\\n", b"  ")
    return text if text.endswith(b"\n") else text + b"\n"
