"""Colours put among the pixels of a picture, in its type, and how much they changed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.image.picture import as_stored
from beltrami_cli.surface.colour_values import store_integers

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.image import Picture
    from beltrami_cli.surface.atlas import Indices


@dataclass(frozen=True)
class Change:
    """How much colour values changed: how many there are, the sums of changes and of their squares, the largest."""

    count: int = 0
    total: float = 0.0
    squares: float = 0.0
    largest: float = 0.0

    @classmethod
    def between(cls, before: NDArray[np.float32], after: NDArray[np.float32]) -> Change:
        """Compare two arrays of the same shape."""
        difference = np.abs(after - before)
        if not difference.size:
            return cls()
        squares = float(np.einsum("i,i->", difference.ravel(), difference.ravel(), dtype=np.float64))
        return cls(difference.size, float(difference.sum(dtype=np.float64)), squares, float(difference.max()))

    @classmethod
    def joined(cls, changes: Iterable[Change]) -> Change:
        """Take several together."""
        parts = [dataclasses.astuple(change) for change in changes]
        counts, totals, squares, largest = zip(*parts, strict=True) if parts else ((), (), (), (0.0,))
        return cls(sum(counts), sum(totals), sum(squares), max(largest))

    def summary(self) -> dict[str, float]:
        """Return the mean, the root mean square and the largest change."""
        count = max(1, self.count)
        return {"mean": self.total / count, "rms": (self.squares / count) ** 0.5, "largest": self.largest}


def store(
    picture: Picture,
    table: NDArray[Any],
    pixels: Indices,
    values: NDArray[np.float32],
    channels: Sequence[int],
    threads: int,
) -> Change:
    """Put values of full scale 1, shape (K, M), into pixels like a picture's, in place, each rounded once.

    They go into the M channels of the K pixels, and are clipped to the range of the stored type. Those that equal
    what is stored leave its bits as they are.
    """
    if table.dtype.kind == "f":
        before = table[pixels[:, None], channels]
        for channel, old, new in zip(channels, before.T, values.T, strict=True):
            moved = new != old  # -0 stays what it is
            table[pixels[moved], channel] = as_stored(new[moved], picture.kinds[channel])
        return Change.between(before, table[pixels[:, None], channels])
    return Change(values.size, *store_integers(table, pixels, values, channels, threads))
