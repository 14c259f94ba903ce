"""What `beltrami noise` is told; light enough for the command line to import."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from beltrami_cli.errors import UsageError

Kind = Literal["gaussian", "salt-pepper", "speckle", "poisson"]


@dataclass(frozen=True)
class NoiseSettings:
    """What noise is added.

    Attributes
    ----------
    sigma : float
        Of full scale 1, in [0, 1]: the standard deviation that colours of full scale get; for salt and pepper, the
        share of samples that change.
    kind : {"gaussian", "salt-pepper", "speckle", "poisson"}
        Of the same deviation everywhere; black and white samples; in proportion to the colour; to its square root.
    seed : int
        0 or more. The same seed gives the same noise.

    Raises
    ------
    UsageError
        If a value is out of its range.
    """

    sigma: float
    kind: Kind = "gaussian"
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.sigma) and 0 <= self.sigma <= 1):
            raise UsageError(f"sigma is {self.sigma:g} of full scale, but must be between 0 and 1")
        if self.kind not in get_args(Kind):
            raise UsageError(f"kind is {self.kind}, but must be {', '.join(get_args(Kind))}")
        if self.seed < 0:
            raise UsageError(f"seed is {self.seed}, but must be 0 or more")
