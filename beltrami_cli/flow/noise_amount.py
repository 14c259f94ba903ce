"""How much noise counts as visible, and the noise of a report as one number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from beltrami_cli.quantities import BYTE_STEP

# Probability, of no noise or of some noise, below which that case is ignored: one in ten.
NEGLIGIBLE = 0.1

# Visible noise, of full scale: with less, most samples are within a step of 8 bits of their value.
VISIBLE = 2 * BYTE_STEP

# Number of channels of a colour. Further channels, such as alpha, follow them.
COLOURS = 3


def noise_size(part: Mapping[str, Any]) -> float:
    """Return the noise of a part of a report, or of `info`, as one number of full scale 1; 0: none is removed.

    Where noise was estimated, this is the median of the estimate, while the noise by channel is the removed one.
    """
    noise, reading = part["noise"], part.get("reading")  # None in older records of a batch
    if reading is None or not any(noise.values()):
        return root_mean_square(noise)
    return float(reading["median"])


def root_mean_square(noise: Mapping[str, float]) -> float:
    """Return the root mean square of noise by channel, without that of alpha."""
    colours = [*noise.values()][:COLOURS]
    return math.sqrt(sum(sigma**2 for sigma in colours) / max(1, len(colours)))
