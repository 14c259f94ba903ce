"""One kernel of one iteration, to be looked at: geodesic distances on the image manifold, and the weights they give."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class SampledKernel:
    """The K samples that the kernel of one sample p holds, p first and the others by their distance.

    Attributes
    ----------
    samples : ndarray of int64, shape (K,)
        Which samples: of a surface, or cells (flat indices) of an atlas's canvas.
    distances : ndarray of float32, shape (K,)
        d(p, q), in the unit of length of the parameters; 0 at p.
    weights : ndarray of float32, shape (K,)
        w_q exp(-d(p, q)^2 / (4 t)), eqs. (8, 9), not yet divided by their sum.
    colours : ndarray of float32, shape (K, N)
        I(q), before the iteration, in the working space.
    """

    samples: NDArray[np.int64]
    distances: NDArray[np.float32]
    weights: NDArray[np.float32]
    colours: NDArray[np.float32]

    @property
    def mean(self) -> NDArray[np.float64]:
        """The colour that the iteration gives p, shape (N,): sum w I / sum w."""
        weights = self.weights.astype(np.float64)
        if not weights.any():  # a sample that stands for no area, alone
            return np.asarray(self.colours[0], np.float64)
        return np.asarray(np.average(self.colours, axis=0, weights=weights), np.float64)


def kernel_values(distances: NDArray[np.float32], t: float) -> NDArray[np.float32]:
    """Return exp(-d^2 / (4 t)), eq. (8)."""
    return np.asarray(np.exp(-np.square(distances.astype(np.float64)) / (4 * t)), np.float32)
