"""Single precision, in which surfaces are smoothed: what fits into it, and how coarse it is."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError

# Squares of lengths are stored in single precision, with a range of 1.2e-38 to 3.4e38: lengths of 1e-19 to 2e19. Texels
# and edges vary in size, and kernels reach further; a margin of five decades covers that.
_MIN_LENGTH, _MAX_LENGTH = 1e-14, 1e14
_SAMPLED_FACES = 100_000  # for a median accurate to about a per cent


def require_finite(rows: Array, name: str, what: str, numbers: Int64s | None = None) -> None:
    """Raise InputError if a row is not finite, with `what` and its number, or that in `numbers`."""
    finite = np.isfinite(rows).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        number = bad if numbers is None else numbers[bad]
        raise InputError(name, f"{what} {number} is not finite", "replace or remove it")


# Half the range of single precision, so that the difference of any two numbers is finite.
_MAX_SINGLE = np.float64(np.finfo(np.float32).max) / 2


def fits_single(values: Array) -> Bools:
    """Whether numbers of any type are finite in single precision, in which surfaces are smoothed."""
    return np.asarray((values >= -_MAX_SINGLE) & (values <= _MAX_SINGLE))


def require_single(
    rows: Array, name: str, what: str, numbers: Int64s | None = None, *, holes: bool = False
) -> None:
    """Raise InputError as `require_finite`, or if a number exceeds single precision.

    `holes`: allow rows with non-finite numbers.
    """
    if not holes:
        require_finite(rows, name, what, numbers)
    large = np.isfinite(rows) & ~fits_single(rows)
    if large.any():
        bad = int(np.argmax(large.any(axis=1)))
        number, value = bad if numbers is None else numbers[bad], rows[bad][large[bad]][0]
        cause = f"{what} {number} is {value:.3g}, which is too large for single precision"
        raise InputError(name, cause, "replace it, or scale all down")


def require_scale(positions: Float64s, faces: Int32s, name: str) -> None:
    """Reject positions or a median edge that cannot be squared in single precision."""
    typical = typical_edge(positions, faces)
    if typical == 0 or _MIN_LENGTH <= typical <= _MAX_LENGTH:
        require_single(positions, name, "the position of vertex", holes=True)
        return
    shown = f"{typical:.0e}" if np.isfinite(typical) else "more than 1e+308"
    what = "edges are" if len(faces) else "points are apart"
    kind = "small" if typical < _MIN_LENGTH else "large"
    cause = f"its {what} {shown} units, which is too {kind} to be squared in single precision"
    raise InputError(name, cause, "scale it, for example to metres")


def typical_edge(positions: Float64s, faces: Int32s) -> float:
    """Return the median of non-zero edge lengths, along their longest axes; 0 if there are none."""
    with np.errstate(over="ignore", invalid="ignore"):
        if len(faces):
            # The longest coordinate of each edge, since squares could overflow here.
            corners = positions[faces[:: 1 + len(faces) // _SAMPLED_FACES]]
            steps = np.abs(corners - np.roll(corners, 1, axis=1)).max(axis=2)
            steps = steps[np.isfinite(corners).all(axis=(1, 2))]
        else:
            # Points are treated as spread evenly over a surface of their extent.
            finite = positions[np.isfinite(positions).all(axis=1)]
            extent = np.ptp(finite, axis=0).max(initial=0, keepdims=True) if len(finite) else np.zeros(1)
            steps = extent / np.sqrt(max(1, len(finite)))
    return upper_median(steps[steps > 0])


def upper_median(values: Float64s) -> float:
    """Return the median, or the larger of the two middle numbers; 0 without numbers."""
    # numpy.median imports modules of NumPy for longer than a small mesh takes to smooth.
    return float(np.partition(values, len(values) // 2)[len(values) // 2]) if len(values) else 0.0


def shortest_type(positions: Float64s) -> Float32s | Float64s:
    """Return positions as float32 if exact, to save memory and digits in files."""
    with np.errstate(over="ignore"):  # Beyond float32 they become infinite, which is not equal.
        single = positions.astype(np.float32)
    return single if bool((single == positions).all()) else positions


# Steps of stored positions larger than this share of an edge bend the surface; half a step is rounded away.
_COARSE = 0.25


def coarse_rounding(positions: Float64s, faces: Int32s) -> list[str]:
    """Return a notice, if any, that single precision has rounded positions about as coarsely as their spacing.

    The stored type is inferred from the numbers: doubles have more digits than single precision holds.
    """
    edge = typical_edge(positions, faces)
    if edge == 0 or shortest_type(positions).dtype != np.float32:
        return []
    # The median vertex, since a single vertex may be anywhere.
    step = float(np.spacing(np.float32(upper_median(np.abs(positions).max(axis=1)))))
    if step < _COARSE * edge:
        return []
    return [
        f"Positions are rounded to steps of {step:.2g} in single precision, {step / edge:.2g} times the median edge: "
        "store them in double precision, or subtract an offset before they are stored."
    ]
