"""The records that volume formats hand to the pipeline: a level set sampled on a lattice, and colours to paint it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from beltrami_cli.surface.painted import Encoding


@dataclass(frozen=True)
class Lattice:
    """Where the samples of a grid stand in space: sample (i, j, k) at ``origin + (i, j, k) @ axes``.

    Attributes
    ----------
    axes : ndarray of float64, shape (3, 3)
        Row a is the step in space from a sample to the next one along index a; invertible.
    origin : ndarray of float64, shape (3,)
        Place of sample (0, 0, 0), which is the centre of its voxel.
    """

    axes: NDArray[np.float64]
    origin: NDArray[np.float64]


@dataclass(frozen=True)
class GridColours:
    """Colours on a lattice of their own, which may be that of the level set.

    Attributes
    ----------
    lattice : Lattice
        Where they stand.
    samples : ndarray, shape (X, Y, Z, C)
        Numbers as stored, of any integer or floating type; C is 1 or 3, and one more if there is opacity. Voxels
        with a number that is not finite, or of opacity 0, have no colour.
    """

    lattice: Lattice
    samples: NDArray[Any]


@dataclass(frozen=True)
class NearColours:
    """Colours at points near the surface.

    Attributes
    ----------
    points : ndarray of float64, shape (P, 3)
        Finite places, in the space of the level set.
    samples : ndarray, shape (P, C)
        Numbers as stored, as in `GridColours`.
    encoding : {"srgb", "linear"}
        What the numbers mean.
    stored : str, optional
        Type in the file where `samples` are already of full scale 1; empty: that of `samples`.
    """

    points: NDArray[np.float64]
    samples: NDArray[Any]
    encoding: Encoding = "srgb"
    stored: str = ""


@dataclass(frozen=True)
class Volume:
    """A level set sampled on a lattice.

    Attributes
    ----------
    lattice : Lattice
        Where the samples stand.
    values : ndarray, shape (X, Y, Z)
        Of any integer, floating or boolean type. What is not finite is unknown.
    known : ndarray of bool, shape (X, Y, Z), or None
        False where the value is unknown whatever it is; None: nowhere.
    level : float or None
        Value on the surface, where the file says so.
    colours : GridColours, NearColours or None
        What paints the surface, where the file says so.
    """

    lattice: Lattice
    values: NDArray[Any]
    known: NDArray[np.bool_] | None = None
    level: float | None = None
    colours: GridColours | NearColours | None = None
