"""Points as lines of numbers between blanks, tabs, commas or semicolons."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float64s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.tokens import Lines, read_numbers, without_comments
from beltrami_cli.formats.points.columns import column_names, is_header
from beltrami_cli.formats.points.unnamed_columns import example_of

_SEPARATORS = bytes.maketrans(b",;", b"  ")
_COMMENT = re.compile(rb"(?:#|//)([^\r\n]*)")
_HEAD = 4096  # bytes in which a comment may name the columns
_MAX_COLUMNS = 4096  # as for properties of PLY; real files have a hundred at most
_NO_TABLE = "is not a number, so this is not a table of points"


@dataclass(frozen=True)
class TextTable:
    names: tuple[str, ...]  # of the columns, in lower case, from a line above the points; or empty
    counts: tuple[int, ...]  # of the points that follow lines of a single number
    values: Float64s  # shape (P, K), maybe infinite or NaN
    starts: Int64s  # where they are in the file, shape (P, K)
    ends: Int64s


def read_table(data: bytes, name: str, given: Sequence[str]) -> TextTable:
    """Read points; the names of columns that are given count in the place of those in the file."""
    return _Reader(data, name).read(given)


class _Reader(Lines):
    def __init__(self, data: bytes, name: str) -> None:
        if b"\0" in data[:_HEAD]:
            raise InputError(name, "it is not plain text", "export its points as lines of numbers, or as PLY")
        self._comments = _COMMENT.findall(data[:_HEAD])
        super().__init__(data, without_comments(data.translate(_SEPARATORS), b"#", b"//"), name)

    def read(self, given: Sequence[str]) -> TextTable:
        if (wide := self.stops - self.heads > _MAX_COLUMNS).any():
            raise self._error(np.argmax(wide), f"there are more than {_MAX_COLUMNS} columns")
        names = self._take_names()
        sizes = self.stops - self.heads
        # Where every line has one number, that is what the points have.
        announcing = (sizes == 1) & bool((sizes > 1).any() or len(sizes) == 1)
        points = np.flatnonzero(~announcing)
        width = int(sizes[points[0]]) if len(points) else 0
        if width:
            self._require_numbers(int(points[0]))
        if (uneven := sizes[points] != width).any():
            row = points[int(np.argmax(uneven))]
            raise self._error(row, f"{sizes[row]} numbers, but the first point has {width}")
        tokens = self.heads[points][:, None] + np.arange(width)
        counts = self._counts(np.flatnonzero(announcing), len(points))
        values = self.numbers(tokens.ravel()).reshape(tokens.shape)
        if given and width:
            if len(given) != width:
                cause = f"its points have {width} numbers each, but --columns has {len(given)} names"
                raise InputError(self.name, cause, example_of(width))
            names = tuple(known.lower() for known in given)
        elif not names:
            said = map(column_names, self._comments)
            names = next((words for words in said if len(words) == width and is_header(words)), ())
        elif width not in (0, len(names)):
            raise InputError(self.name, f"the first line names {len(names)} columns, but there are {width}")
        return TextTable(names, counts, values, self.starts[tokens], self.ends[tokens])

    def _take_names(self) -> tuple[str, ...]:
        # The first line with more than a count, if it has words in place of numbers.
        for row in range(min(2, len(self.heads))):
            words = [self.word(token) for token in range(self.heads[row], self.stops[row])]
            if not any(len(read_numbers(word)) for word in words):
                line = self.data[self.starts[self.heads[row]] : self.ends[self.stops[row] - 1]]
                self.heads, self.stops = np.delete(self.heads, row), np.delete(self.stops, row)
                return column_names(line)
        return ()

    def _require_numbers(self, row: int) -> None:
        """Raise InputError if a line is none of a table: it has words, or commas within its numbers."""
        tokens = range(self.heads[row], self.stops[row])
        for token in tokens:
            if not len(read_numbers(self.word(token))):
                raise self.error(token, _NO_TABLE)
        gaps = [self.data[self.ends[token] : self.starts[token + 1]] for token in tokens[:-1]]
        if b"," in gaps and not all(b"," in gap for gap in gaps):
            cause = f"line {self.line(tokens[0])}: commas stand in some places and other separators in others"
            raise InputError(self.name, cause, "write decimals with a point, and use one separator")

    def _counts(self, rows: NDArray[np.intp], points: int) -> tuple[int, ...]:
        if not len(rows):
            return ()
        if rows[0] != 0:
            raise self._error(rows[0], "one number only, and it is not at the head of the points")
        values = self.numbers(self.heads[rows])
        # Between two announcements there are as many points as rows, less one.
        there = np.diff(np.append(rows, points + len(rows))) - 1
        if (wrong := values != there).any():
            row = int(np.argmax(wrong))
            cause = f"{values[row]:g} points are announced, but {there[row]} follow; the file is cut off or damaged"
            raise self._error(rows[row], cause)
        return tuple(there.tolist())

    def _error(self, row: int | np.intp, cause: str) -> InputError:
        return InputError(self.name, f"line {self.line(self.heads[row])}: {cause}")
