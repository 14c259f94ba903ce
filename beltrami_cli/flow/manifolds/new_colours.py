"""New colours that are written back to a document."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Indices


@dataclass(frozen=True)
class NewColours:
    """Colours of S samples, read block by block, and the colours that extend them beyond seams."""

    take: Callable[[slice, Bools | slice], Float32s]  # rows of a block, all or masked
    places: Indices  # shape (S,): texels or pixels of the samples
    beyond_places: Indices  # shape (G,): texels or pixels around charts
    beyond: Float32s  # their colours, shape (G, N)
    positions: Float64s | None = None  # of the samples, shape (S, 3), if they moved

    @classmethod
    def of(
        cls,
        rows: Float32s,
        places: Indices | None = None,
        beyond_places: Indices | None = None,
        beyond: Float32s | None = None,
    ) -> NewColours:
        """Wrap the rows of a table, shape (S, N)."""
        none = np.zeros(0, np.int64)
        return cls(
            lambda block, inside: rows[block][inside],
            np.arange(len(rows)) if places is None else places,
            none if beyond_places is None else beyond_places,
            np.zeros((0, rows.shape[1]), np.float32) if beyond is None else beyond,
        )

    def mapped(self, each: Callable[[Float32s], Float32s]) -> NewColours:
        """Apply a function to rows of colours."""
        take = self.take
        return dataclasses.replace(
            self, take=lambda block, inside: each(take(block, inside)), beyond=each(self.beyond)
        )

    def with_kept(self, samples: Indices, channels: Bools, colours: Float32s) -> NewColours:
        """Replace the marked channels of K samples by `colours`."""
        take, row_of = self.take, np.full(len(self.places), -1, np.int32)
        row_of[samples] = np.arange(len(samples))

        def kept(block: slice, inside: Bools | slice) -> Float32s:
            row = row_of[block][inside]
            return np.where(channels[row] & (row >= 0)[:, None], colours[row], take(block, inside))

        return dataclasses.replace(self, take=kept)

    def table(self) -> Float32s:
        """Return all rows as an array of shape (S, N)."""
        return self.take(slice(None), slice(None))
