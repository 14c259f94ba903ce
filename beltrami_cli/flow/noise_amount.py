"""Which noise counts: how probable, how large, and of which channels."""

from __future__ import annotations

from beltrami_cli.quantities import BYTE_STEP

# Probability, of no noise or of some noise, below which that case is ignored: one in ten.
NEGLIGIBLE = 0.1

# Visible noise, of full scale: with less, most samples are within a step of 8 bits of their value.
VISIBLE = 2 * BYTE_STEP

# Number of channels of a colour. Further channels, such as alpha, follow them.
COLOURS = 3
