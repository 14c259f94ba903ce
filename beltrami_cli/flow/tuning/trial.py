"""A part of a manifold on which iterations are tried, with perturbations of its colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.flow.manifold import Manifold, Step


@dataclass(frozen=True)
class SampleTrial:
    """A `Trial` on a part of a manifold.

    `start` is the stack of its noisy colours, and `signs` are stacks like it. Samples in `scored` count; None: all.
    `correlated`: neighbours have noise in common, and so have the perturbations.
    """

    part: Manifold
    start: NDArray[np.float32]
    signs: NDArray[np.float32]
    scored_samples: NDArray[np.int64] | None
    correlated: bool = False

    @property
    def samples(self) -> int:
        """How many samples count."""
        return len(self.scored(self.start))

    def step(self, state: NDArray[np.float32], step: Step) -> NDArray[np.float32]:
        """Return the colours after an iteration."""
        self.part.measure(state, step)
        return self.part.average([state]).stacks[0]

    def scored(self, state: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the colours of the samples that count, shape (S, N)."""
        return state if self.scored_samples is None else self.part.take(state, self.scored_samples)
