"""The noise of a report as one number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from beltrami_cli.flow.noise_amount import COLOURS


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
