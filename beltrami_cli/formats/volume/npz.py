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

import math
from typing import Any

import numpy as np

from beltrami_cli.arrays import Float64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.numpy_files import LEVEL_SET_KEYS, NpzArchive
from beltrami_cli.formats.volume.lattice import MAX_CHANNELS, MIN_SIDE, checked_lattice
from beltrami_cli.surface.level_sets import GridColours, Lattice, NearColours, Volume

_COLOURS = ("colours", "colors")
_POINT_COLOURS = ("point_colours", "point_colors")


def read_npz(archive: NpzArchive, most: int) -> Volume:
    key = archive.first(LEVEL_SET_KEYS)
    if key is None:
        cause = f"there is no array of values among {', '.join(archive.names)}"
        raise InputError(archive.name, cause, "name it values")
    shape = archive.header(key).shape
    if len(shape) != 3 or min(shape) < MIN_SIDE:
        cause = f"the array {key} is of shape {shape}"
        raise InputError(archive.name, cause, "give 2 or more samples along x, y and z")
    mask = None
    if "mask" in archive.names:
        fits = archive.header("mask").shape == shape
        _require(fits, archive, f"the array mask is not of the shape {shape}")
        mask = archive.array("mask", most) != 0
    level = _numbers(archive, "level", (1,))
    return Volume(
        _lattice(archive),
        archive.array(key, most),
        mask,
        None if level is None else float(level[0]),
        npz_colours(archive, most, shape),
    )


def npz_colours(
    archive: NpzArchive, most: int, shape: tuple[int, ...] | None = None
) -> GridColours | NearColours | None:
    if "points" in archive.names:
        return _colours_near(archive, most)
    key = archive.first(_COLOURS)
    if key is None:
        return None
    found = archive.header(key).shape
    fits = len(found) == 4 and 1 <= found[3] <= MAX_CHANNELS and (shape is None or found[:3] == shape)
    wanted = "(X, Y, Z" if shape is None else str(shape)[:-1]
    _require(fits, archive, f"the array {key} is of shape {found}, not {wanted}, 1 to {MAX_CHANNELS})")
    return GridColours(_lattice(archive), archive.array(key, MAX_CHANNELS * most))


def _colours_near(archive: NpzArchive, most: int) -> NearColours:
    key = archive.first((*_POINT_COLOURS, *_COLOURS))
    if key is None:
        cause = "there are points but no array point_colours"
        raise InputError(archive.name, cause, "add it, or leave the points out")
    points, colours = archive.header("points").shape, archive.header(key).shape
    fits = len(points) == len(colours) == 2 and points[1] == 3 and 1 <= colours[1] <= MAX_CHANNELS
    shapes = f"{points} and {colours}, not (P, 3) and (P, 1 to {MAX_CHANNELS})"
    cause = f"the arrays points and {key} are of the shapes {shapes}"
    _require(fits and points[0] == colours[0], archive, cause)
    places = archive.array("points", 3 * most).astype(np.float64)
    _require(bool(np.isfinite(places).all()), archive, "a point is not finite")
    return NearColours(places, archive.array(key, MAX_CHANNELS * most))


def _lattice(archive: NpzArchive) -> Lattice:
    key = archive.first(("spacing", "voxel_size"))
    spacing = None if key is None else _numbers(archive, key, (1, 3))
    origin = _numbers(archive, "origin", (3,))
    steps = np.ones(3) if spacing is None else np.broadcast_to(spacing, 3)
    _require(bool((steps > 0).all()), archive, f"the spacing is {steps.tolist()}, but must be positive")
    return checked_lattice(np.diag(steps), np.zeros(3) if origin is None else origin, archive.name)


def _numbers(archive: NpzArchive, key: str, counts: tuple[int, ...]) -> Float64s | None:
    if key not in archive.names:
        return None
    wanted = " or ".join(map(str, counts))
    shape = archive.header(key).shape
    cause = f"the array {key} is of shape {shape}, not of {wanted} numbers"
    _require(math.prod(shape) in counts, archive, cause)
    numbers: Float64s = archive.array(key, max(counts)).astype(np.float64).ravel()
    _require(bool(np.isfinite(numbers).all()), archive, f"the array {key} is not finite")
    return numbers


def _require(holds: Any, archive: NpzArchive, cause: str) -> None:
    if not holds:
        raise InputError(
            archive.name, cause, "see the arrays that a level set has in `beltrami smooth --help`"
        )
