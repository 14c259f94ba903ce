"""Level sets and their colours in NumPy archives.

Arrays, by their names; all but the first are optional:

========================================  ============================================================================
``values`` (``sdf``, ``tsdf``,            (X, Y, Z) numbers, indexed [x, y, z]
``level_set``)
``mask``                                  (X, Y, Z), 0 or false where the value is unknown; so is any that is not finite
``colours`` (``colors``)                  (X, Y, Z, C): grey or red, green and blue, then opacity if there is one more;
                                          uint8, uint16, or floats of 0 to 1 or 0 to 255
``points``, ``point_colours``             (P, 3) and (P, C): colours near the surface, in place of those on the grid
(``point_colors``)
``spacing`` (``voxel_size``)              a number, or one for each of x, y and z; else 1
``origin``                                (3,): the place of sample [0, 0, 0], which is the centre of its voxel; else 0
``level``                                 a number: the value on the surface; else 0
========================================  ============================================================================
"""

from __future__ import annotations

import importlib
import math
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.archives import LEVEL_SET_KEYS, NpzArchive
from beltrami_cli.surface.level_set import GridColours, Lattice, NearColours, Volume

_COLOURS = ("colours", "colors")
_POINT_COLOURS = ("point_colours", "point_colors")
_CHANNELS = 4
_SIDE = 2  # a cell has two samples along each axis
# Any unit of length from picometres to light hours; squares fit into float32.
_SMALLEST, _LARGEST = 1e-12, 1e12
_UNLIKE = 1e4  # how much longer than others a step may be
_FURTHEST = 1e9  # steps from the origin: doubles resolve millionths of a step there
_FLAT = 1e-6  # directions closer to one plane than that are a mistake


def read_npz(archive: NpzArchive, name: str, most: int) -> Volume:
    """Read a level set and its colours, as `read_volume`."""
    key = archive.first(LEVEL_SET_KEYS)
    if key is None:
        cause = f"there is no array of values among {', '.join(archive.names)}"
        raise InputError(name, cause, "name it values")
    shape = archive.header(key).shape
    if len(shape) != 3 or min(shape) < _SIDE:
        cause = f"the array {key} is of shape {shape}"
        raise InputError(name, cause, "give 2 or more samples along x, y and z")
    mask = None
    if "mask" in archive.names:
        _require(archive.header("mask").shape == shape, name, f"the array mask is not of the shape {shape}")
        mask = archive.read("mask", most) != 0
    level = _numbers(archive, "level", (1,), name)
    return Volume(
        _lattice(archive, name),
        archive.read(key, most),
        mask,
        None if level is None else float(level[0]),
        read_npz_colours(archive, name, most, shape),
    )


def read_npz_colours(
    archive: NpzArchive, name: str, most: int, shape: tuple[int, ...] | None = None
) -> GridColours | NearColours | None:
    """Read colours on the grid, of a given shape, or at points; None if the archive has none."""
    if "points" in archive.names:
        return _near(archive, name, most)
    key = archive.first(_COLOURS)
    if key is None:
        return None
    found = archive.header(key).shape
    fits = len(found) == 4 and 1 <= found[3] <= _CHANNELS and (shape is None or found[:3] == shape)
    wanted = "(X, Y, Z" if shape is None else str(shape)[:-1]
    _require(fits, name, f"the array {key} is of shape {found}, not {wanted}, 1 to {_CHANNELS})")
    return GridColours(_lattice(archive, name), archive.read(key, _CHANNELS * most))


def _near(archive: NpzArchive, name: str, most: int) -> NearColours:
    key = archive.first((*_POINT_COLOURS, *_COLOURS))
    if key is None:
        cause = "there are points but no array point_colours"
        raise InputError(name, cause, "add it, or leave the points out")
    points, colours = archive.header("points").shape, archive.header(key).shape
    fits = len(points) == len(colours) == 2 and points[1] == 3 and 1 <= colours[1] <= _CHANNELS
    shapes = f"{points} and {colours}, not (P, 3) and (P, 1 to {_CHANNELS})"
    cause = f"the arrays points and {key} are of the shapes {shapes}"
    _require(fits and points[0] == colours[0], name, cause)
    places = archive.read("points", 3 * most).astype(np.float64)
    _require(bool(np.isfinite(places).all()), name, "a point is not finite")
    return NearColours(places, archive.read(key, _CHANNELS * most))


def _lattice(archive: NpzArchive, name: str) -> Lattice:
    key = archive.first(("spacing", "voxel_size"))
    spacing = None if key is None else _numbers(archive, key, (1, 3), name)
    origin = _numbers(archive, "origin", (3,), name)
    steps = np.ones(3) if spacing is None else np.broadcast_to(spacing, 3)
    _require(bool((steps > 0).all()), name, f"the spacing is {steps.tolist()}, but must be positive")
    return checked_lattice(np.diag(steps), np.zeros(3) if origin is None else origin, name)


def _numbers(archive: NpzArchive, key: str, counts: tuple[int, ...], name: str) -> Float64s | None:
    if key not in archive.names:
        return None
    wanted = " or ".join(map(str, counts))
    shape = archive.header(key).shape
    cause = f"the array {key} is of shape {shape}, not of {wanted} numbers"
    _require(math.prod(shape) in counts, name, cause)
    numbers: Float64s = archive.read(key, max(counts)).astype(np.float64).ravel()
    _require(bool(np.isfinite(numbers).all()), name, f"the array {key} is not finite")
    return numbers


def _require(holds: Any, name: str, cause: str) -> None:
    if not holds:
        raise InputError(name, cause, "see the arrays that a level set has in `beltrami smooth --help`")


def checked_lattice(axes: Float64s, origin: Float64s, name: str) -> Lattice:
    """Make a lattice; InputError if steps lie in one plane, or are too small, large or unlike to compute with."""
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


def require_package(module: str, package: str, name: str, purpose: str) -> Any:
    """Import a module of the extra for volumes; InputError that names the extra if it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        cause = f"{purpose}, the package {package} is needed"
        raise InputError(name, cause, "install it with: pip install 'beltrami-cli[volumes]'") from error
