"""Opening volumes: which format it is, by content; and what both formats need.

NumPy archives and NRRD files hold level sets sampled on a grid, and colours for them.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.npz import NpzArchive
from beltrami_cli.surface.volume import Lattice

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from beltrami_cli.surface.volume import GridColours, NearColours, Volume

_NRRD = b"NRRD000"
_OPENVDB = b" BDV\0\0\0\0"
# Any unit of length from picometres to light hours; squares fit into float32.
_SMALLEST, _LARGEST = 1e-12, 1e12
_UNLIKE = 1e4  # how much longer than others a step may be
_FURTHEST = 1e9  # steps from the origin: doubles resolve millionths of a step there
_FLAT = 1e-6  # directions closer to one plane than that are a mistake


def is_volume(data: bytes, name: str) -> bool:
    """Whether a file is a level set, or claims to be one; InputError if it is a damaged archive of arrays."""
    if data.startswith((_NRRD, _OPENVDB)):
        return True
    return NpzArchive.recognises(data) and NpzArchive(data, name).kind() == "level set"


def read_volume(data: bytes, name: str, folder: Path | None, most: int) -> Volume:
    """Read a level set of at most `most` samples; the data of an NRRD header may lie in the folder.

    InputError if the file is damaged, too large, or of a kind that cannot be read, or a package is missing.
    """
    if data.startswith(_OPENVDB):
        raise InputError(
            name,
            "it is an OpenVDB file, for which there is no Python package to read it",
            "save its grid as .npz with the arrays values, colours, spacing and origin, or as .nrrd",
        )
    if data.startswith(_NRRD):
        from beltrami_cli.formats.volume.nrrd import read_nrrd

        return read_nrrd(data, name, folder, most)
    from beltrami_cli.formats.volume.arrays import read_npz

    return read_npz(NpzArchive(data, name), name, most)


def read_colours(data: bytes, name: str, folder: Path | None, most: int) -> GridColours | NearColours | None:
    """Read a file of colours for a level set as `read_volume`; None if it is no volume and no archive."""
    if data.startswith(_NRRD):
        from beltrami_cli.formats.volume.nrrd import read_nrrd_colours

        return read_nrrd_colours(data, name, folder, most)
    if not NpzArchive.recognises(data):
        return None
    from beltrami_cli.formats.volume.arrays import read_npz_colours

    colours = read_npz_colours(NpzArchive(data, name), name, most)
    if colours is None:
        raise InputError(name, "there is no array colours in it", "name it so, or points and point_colours")
    return colours


def checked_lattice(axes: NDArray[np.float64], origin: NDArray[np.float64], name: str) -> Lattice:
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
        raise InputError(
            name,
            f"{purpose}, the package {package} is needed",
            "install it with: pip install 'beltrami-cli[volumes]'",
        ) from error
