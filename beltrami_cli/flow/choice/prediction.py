"""Prediction of the PSNR of a result.

The error of the result f is predicted from the variance of the noise and the divergence of f:

    E |f(y) - x|^2 = sigma^2 div f(y).

This holds where f is the mean of x given y (the second-order formula of Tweedie [1]_). It is far less sensitive to an
error of sigma^2 than Stein's estimate, which subtracts sigma^2 from what was removed: an error of a tenth of sigma^2 is
as large as the error that remains. Stein's estimate at the least and the largest plausible noise bounds the prediction.

References
----------
.. [1] B. Efron, "Tweedie's formula and selection bias", J. American Statistical Association 106(496), 2011.
   https://doi.org/10.1198/jasa.2011.tm11181
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from beltrami_cli.flow.choice.risk import Risk
from beltrami_cli.flow.noise.model import NoiseModel

# Error of predictions in dB with a certainty of 90 %, if the noise is known. Together with the uncertainty of the noise
# it makes intervals that hold 70 of 74 results of `benchmarks/bench_regret.py`, and 94 of 126 with images of four
# packages. A larger value would make most intervals wider than `_MAX_INTERVAL_WIDTH`.
_PREDICTION_ERROR = 2.5

# A prediction is reported if its interval is at most this wide, in dB.
_MAX_INTERVAL_WIDTH = 8.0


@dataclass(frozen=True)
class Prediction:
    """The PSNR of a result against noise-free colours, and that of the input, in dB."""

    before: float
    psnr: float
    least: float  # `least` and `most`: interval of the PSNR with a certainty of 90 %
    most: float

    def in_unit(self, unit: float) -> Prediction:
        """Return the prediction for colours that are multiplied by `unit`."""
        shift = 20 * math.log10(unit)
        return Prediction(*(value - shift for value in dataclasses.astuple(self)))

    @property
    def is_useful(self) -> bool:
        return self.most - self.least <= _MAX_INTERVAL_WIDTH and self.least >= self.before


def predict(risk: Risk, variance: float, noise: NoiseModel, *, patches: bool) -> Prediction | None:
    """Predict the PSNR of a result; None if the noise is not known well enough.

    Shared noise is never predicted: its correlation may differ from the model, and then most of it remains.
    """
    reading, low, median, high = noise.reading, 1.0, 1.0, 1.0
    if noise.is_shared or not np.isfinite(risk.error) or variance <= 0:
        return None
    if reading is not None:
        if reading.is_doubtful or not noise.overall:
            return None
        low, median, high = (size / noise.overall for size in (reading.low, reading.median, reading.high))
    share = risk.divergence / (2 * variance)
    # Stein's estimate for the least and the largest plausible noise.
    bounds = [risk.value + (2 * share - 1) * (size**2 - 1) * variance for size in (low, high)]
    chance = NormalDist().inv_cdf(0.95) * risk.error
    least = 0.0 if patches else min(bounds) - chance  # patches may have a smaller error
    error = np.clip(share * median**2 * variance, least, max(max(bounds) + chance, least))
    if not error > 0:
        return None
    psnr = -10 * math.log10(error)
    below, above = (
        math.hypot(_PREDICTION_ERROR, 20 * math.log10(ratio)) for ratio in (high / median, median / low)
    )
    before = -10 * math.log10(median**2 * variance)
    prediction = Prediction(before=before, psnr=psnr, least=psnr - below, most=psnr + above)
    return prediction if prediction.is_useful else None
