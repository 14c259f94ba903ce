"""A quick estimate of the clean colours in neighbourhoods, whose residual shows the structure of the noise.

The pilot averages neighbouring samples. Weights fall to 0 at differences that noise rarely reaches, so edges are
preserved. The pilot is too coarse for a result, but it is even where the picture is even, and its levels are nearly
free of noise.
"""

from __future__ import annotations

from beltrami_cli._native import pilot_of_graph, pilot_of_squares
from beltrami_cli.arrays import Bools, Float32s, Int64s


def smoothed_squares(colours: Float32s, filled: Bools | None, variances: Float32s) -> Float32s:
    """Return the pilot of squares of a grid, shape (3, P, S, S), for noise of variances of shape (P, S, S) or (1,)."""
    return pilot_of_squares(colours, filled, variances.ravel())


def smoothed_graph(colours: Float32s, edges: Int64s, variances: Float32s) -> Float32s:
    """Return the pilot of samples joined by edges, shape (3, n), for noise of variances of shape (n,) or (1,)."""
    return pilot_of_graph(colours, edges, variances)
