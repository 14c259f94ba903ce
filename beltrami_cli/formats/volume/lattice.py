"""What all files of level sets must hold: a lattice that can be computed with."""

from __future__ import annotations

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.surface.level_sets import Lattice

MAX_CHANNELS = 4  # red, green, blue and opacity
MIN_SIDE = 2  # a cell has two samples along each axis
# Any unit of length from picometres to light hours; squares fit into float32.
_MIN_STEP, _MAX_STEP = 1e-12, 1e12
_MAX_ANISOTROPY = 1e4  # how much longer than others a step may be
_MAX_ORIGIN = 1e9  # steps from the origin: doubles resolve millionths of a step there
_FLAT = 1e-6  # directions closer to one plane than that are a mistake


def checked_lattice(axes: Float64s, origin: Float64s, name: str) -> Lattice:
    """Make a lattice; InputError if its steps are coplanar, or too small, too large or too unequal."""
    if not (np.isfinite(axes).all() and np.isfinite(origin).all()):
        raise InputError(name, "its spacing or origin is not finite", "repair it")
    longest = np.abs(axes).max(axis=1)
    if (
        longest.min() < _MIN_STEP
        or longest.max() > _MAX_STEP
        or longest.max() > _MAX_ANISOTROPY * longest.min()
    ):
        steps = ", ".join(f"{step:g}" for step in longest)
        cause = (
            f"its spacings are {steps}, but must be from {_MIN_STEP:g} to {_MAX_STEP:g} and of similar size"
        )
        raise InputError(name, cause, "choose another unit")
    if np.abs(origin).max() > _MAX_ORIGIN * longest.min():
        raise InputError(name, "its origin is too far away for its spacing", "move it")
    if abs(np.linalg.det(axes / np.linalg.norm(axes, axis=1)[:, None])) < _FLAT:
        raise InputError(name, "its space directions lie in one plane", "repair them")
    return Lattice(axes, origin)
