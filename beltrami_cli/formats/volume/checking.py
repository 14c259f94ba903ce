"""What the lattice of a volume must fulfil, so that its samples stand apart and lengths can be computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.surface.volume import Lattice

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SMALLEST, _LARGEST = (
    1e-12,
    1e12,
)  # any unit of length from picometres to light hours; squares fit into float32
_UNLIKE = 1e4  # how much longer than others a step may be
_FURTHEST = 1e9  # steps from the origin: doubles tell millionths of a step apart there
_FLAT = 1e-6  # directions closer to one plane than that are a mistake


def checked_lattice(axes: NDArray[np.float64], origin: NDArray[np.float64], name: str) -> Lattice:
    """Make a lattice.

    Parameters
    ----------
    axes : ndarray of float64, shape (3, 3)
        As in `Lattice`.
    origin : ndarray of float64, shape (3,)
        As in `Lattice`.
    name : str
        The file as the user named it.

    Returns
    -------
    Lattice

    Raises
    ------
    InputError
        If steps are not finite, lie in one plane, or are too small, large or unlike to compute with.
    """
    if not (np.isfinite(axes).all() and np.isfinite(origin).all()):
        raise InputError(name, "its spacing or origin is not finite", "repair it")
    longest = np.abs(axes).max(axis=1)
    if longest.min() < _SMALLEST or longest.max() > _LARGEST or longest.max() > _UNLIKE * longest.min():
        steps = ", ".join(f"{step:g}" for step in longest)
        cause = f"its spacings are {steps}, but must be from {_SMALLEST:g} to {_LARGEST:g} and much alike"
        raise InputError(name, cause, "choose another unit")
    if np.abs(origin).max() > _FURTHEST * longest.min():
        raise InputError(name, "its origin is too far away for its spacing", "move it")
    if abs(np.linalg.det(axes / np.linalg.norm(axes, axis=1)[:, None])) < _FLAT:
        raise InputError(name, "its space directions lie in one plane", "repair them")
    return Lattice(axes, origin)
