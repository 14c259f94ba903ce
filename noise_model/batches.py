"""Observations as arrays, from which batches for training are taken."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beltrami_cli.flow.noise.candidates import candidates_of, starts_of
from beltrami_cli.flow.noise.network import Weights
from observations import Observation

Arrays = dict[str, np.ndarray]

ROWS = 100_000  # of features that are standardised at a time


@dataclass(frozen=True)
class Batch:
    """Concatenated observations; the features of neighbourhoods are in half precision."""

    counts: np.ndarray  # neighbourhoods of each observation
    parts: Arrays

    @classmethod
    def of(cls, observations: list[Observation]) -> Batch:
        parts: Arrays = {
            "local": np.concatenate([each.features.local for each in observations]).astype(np.float16),
            "quiet": np.concatenate([each.features.quiet for each in observations]).astype(np.float16),
            "places": np.concatenate([each.places for each in observations]).astype(np.float32)[:, None],
        }
        for name in ("even", "even_deviations"):
            parts[name] = np.stack([getattr(each.features, name) for each in observations])
        for name in ("total", "deviations", "correlations"):
            parts[name] = np.stack([getattr(each, name) for each in observations]).astype(np.float32)
        parts["total"] = parts["total"][:, None]
        return cls(np.array([len(each.features.local) for each in observations]), parts)

    @classmethod
    def joined(cls, batches: list[Batch]) -> Batch:
        parts = {name: np.concatenate([each.parts[name] for each in batches]) for name in batches[0].parts}
        return cls(np.concatenate([each.counts for each in batches]), parts)

    @cached_property
    def starts(self) -> np.ndarray:
        """The first neighbourhood of each observation, and the number of all neighbourhoods."""
        return np.append(0, np.cumsum(self.counts))

    def standard(self) -> tuple[Arrays, Arrays]:
        """Return the means and standard deviations of features."""
        some = self.parts["local"][:: max(1, len(self.parts["local"]) // 200_000)].astype(np.float32)
        kinds = {"local": some, "even": self.parts["even"]}
        means = {name: rows.mean(axis=0) for name, rows in kinds.items()}
        return means, {name: rows.std(axis=0) + 1e-3 for name, rows in kinds.items()}

    def standardise_in_place(self, weights: Weights) -> None:
        """Standardise the features of neighbourhoods; a copy would not fit into memory."""
        rows = self.parts["local"]
        for first in range(0, len(rows), ROWS):
            block = rows[first : first + ROWS]
            block[:] = weights.standardised("local", block.astype(np.float32))

    def take(self, chosen: np.ndarray, weights: Weights) -> tuple[Arrays, Arrays, Arrays]:
        """Return the arguments of `forward` for some observations, the truths, and the candidates."""
        rows = np.concatenate([np.arange(self.starts[each], self.starts[each + 1]) for each in chosen])
        counts, even = self.counts[chosen], self.parts["even"][chosen]
        given = {
            "local": self.parts["local"][rows].astype(np.float32),
            "counts": counts,
            "even": weights.standardised("even", even),
        }
        quiet = self.parts["quiet"][rows].astype(np.float32)
        candidates = candidates_of(self.parts["even_deviations"][chosen], quiet, counts)
        truths = {name: self.parts[name][chosen] for name in ("total", "deviations", "correlations")}
        # Neighbourhoods are read relative to their mean, since often only the mean is uncertain.
        places, starts = self.parts["places"][rows], starts_of(counts)
        means = np.add.reduceat(np.nan_to_num(places), starts) / np.maximum(
            np.add.reduceat(np.isfinite(places), starts, dtype=np.float32), 1
        )
        truths["places"] = places - np.repeat(means, counts, axis=0)
        return given, truths, candidates
