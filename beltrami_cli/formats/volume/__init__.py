"""Opening volumes: which format it is, by content; and what both formats need.

NumPy archives and NRRD files hold level sets sampled on a grid, and colours for them.
"""

from __future__ import annotations

from pathlib import Path

from beltrami_cli.errors import InputError
from beltrami_cli.formats.archives import NpzArchive
from beltrami_cli.surface.level_set import GridColours, NearColours, Volume

_NRRD = b"NRRD000"
_OPENVDB = b" BDV\0\0\0\0"


def is_volume(data: bytes, name: str) -> bool:
    """Whether a file is a level set, or claims to be one; InputError if it is a damaged archive of arrays."""
    if data.startswith((_NRRD, _OPENVDB)):
        return True
    return NpzArchive.recognises(data) and NpzArchive(data, name).kind() == "level set"


def read_volume(data: bytes, name: str, folder: Path | None, most: int) -> Volume:
    """Read a level set of at most `most` samples; InputError if it cannot be read."""
    if data.startswith(_OPENVDB):
        cause = "it is an OpenVDB file, for which there is no Python package to read it"
        remedy = "save its grid as .npz with the arrays values, colours, spacing and origin, or as .nrrd"
        raise InputError(name, cause, remedy)
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
