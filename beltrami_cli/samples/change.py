"""How much colours changed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


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
