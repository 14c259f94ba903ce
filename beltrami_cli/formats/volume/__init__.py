"""Level sets and their colours, from NRRD files and NumPy archives.

`nrrd` and `npz` read them; `lattice` checks what both must hold, and `extra` imports optional packages.
"""

from __future__ import annotations

from beltrami_cli.errors import InputError
from beltrami_cli.formats.files.numpy_files import NpzArchive, is_npz
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.formats.volume.npz import npz_colours, read_npz
from beltrami_cli.formats.volume.nrrd import read_nrrd, read_nrrd_colours
from beltrami_cli.surface.level_sets import GridColours, NearColours, Volume

_NRRD = b"NRRD000"
_OPENVDB = b" BDV\0\0\0\0"


def is_volume(data: bytes, name: str) -> bool:
    """Whether a file is marked as a level set; InputError if it is a damaged archive of arrays."""
    if data.startswith((_NRRD, _OPENVDB)):
        return True
    return is_npz(data) and NpzArchive(data, name).kind() == "level set"


def read_volume(data: bytes, name: str, folder: ModelFolder, most: int) -> Volume:
    """Read a level set; InputError if it is damaged or has more than `most` samples."""
    if data.startswith(_OPENVDB):
        cause = "it is an OpenVDB file, for which there is no Python package to read it"
        remedy = "save its grid as .npz with the arrays values, colours, spacing and origin, or as .nrrd"
        raise InputError(name, cause, remedy)
    if data.startswith(_NRRD):
        return read_nrrd(data, name, folder, most)
    return read_npz(NpzArchive(data, name), most)


def read_colours(data: bytes, name: str, folder: ModelFolder, most: int) -> GridColours | NearColours | None:
    """Read the colours of a level set from a file, as `read_volume`; None if it is neither NRRD nor an archive."""
    if data.startswith(_NRRD):
        return read_nrrd_colours(data, name, folder, most)
    if not is_npz(data):
        return None
    colours = npz_colours(NpzArchive(data, name), most)
    if colours is None:
        raise InputError(name, "there is no array colours in it", "name it so, or points and point_colours")
    return colours
