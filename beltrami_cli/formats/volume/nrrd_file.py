"""Level sets and their colours in NRRD files, through pynrrd.

A file of three axes holds the values. One of four holds on its axis that is not spatial either the value and the
colours of each sample, or colours alone; the latter goes with the values in another file.

References
----------
.. [1] G. Kindlmann, "Definition of NRRD file format", https://teem.sourceforge.net/nrrd/format.html
"""

from __future__ import annotations

import bz2
import io
import math
import warnings
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.model_folder import ModelFolder
from beltrami_cli.formats.volume.nrrd_space import list_axis, spatial_lattice
from beltrami_cli.formats.volume.packages import require
from beltrami_cli.surface.volume import GridColours, Volume

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from beltrami_cli.surface.volume import Lattice

_CHANNELS = 4
_VALUE_AND_COLOURS = (2, 4, 5)  # a value with grey, with red, green and blue, and with opacity besides
_LONGEST_LIST = 5
_LONGEST_NUMBER = 8  # bytes of a double
_LONGEST_HEADER = 1 << 16
_REPAIR = "write the file again"
# What pynrrd raises for headers and data that it does not understand, besides errors of its own.
_DAMAGE = (ValueError, KeyError, IndexError, TypeError, AttributeError, OSError, OverflowError, StopIteration)


def read_nrrd(data: bytes, name: str, folder: Path | None, most: int) -> Volume:
    """Read a level set, and its colours if they are in the same file; as `read_volume`."""
    samples, lattice, kind = _read(data, name, folder, most)
    if kind is None:
        return Volume(lattice, samples)
    if samples.shape[3] not in _VALUE_AND_COLOURS or kind.endswith("color"):
        raise InputError(
            name,
            f"each sample is a list of {samples.shape[3]} numbers ({kind}), and not a value, or a value and its colour",
            "give the values as INPUT and the colours with --colours",
        )
    return Volume(lattice, samples[..., 0], colours=GridColours(lattice, samples[..., 1:]))


def read_nrrd_colours(data: bytes, name: str, folder: Path | None, most: int) -> GridColours:
    """Read colours on a grid; as `read_colours`."""
    samples, lattice, kind = _read(data, name, folder, most)
    if kind is None:
        samples = samples[..., None]
    if samples.shape[3] > _CHANNELS:
        raise InputError(
            name, f"each sample is a list of {samples.shape[3]} numbers", f"give 1 to {_CHANNELS}"
        )
    return GridColours(lattice, samples)


def _read(data: bytes, name: str, folder: Path | None, most: int) -> tuple[NDArray[Any], Lattice, str | None]:
    """Return the samples, where they stand, and of which kind the list in each is; None if each is one number.

    Samples are indexed [x, y, z], and last in the list.
    """
    nrrd = require("nrrd", "pynrrd", name, "to read NRRD files")
    header, rest = _header(nrrd, data, name)
    sizes = [int(size) for size in header["sizes"]]
    listed = list_axis(header, name)
    spatial = [axis for axis in range(len(sizes)) if axis != listed]
    voxels = math.prod(sizes[axis] for axis in spatial)
    if len(spatial) != 3 or min(sizes[axis] for axis in spatial) < 2:
        raise InputError(name, f"its sizes are {sizes}", "give 2 or more samples along x, y and z")
    if voxels > most:
        raise InputError(
            name,
            f"its sizes are {sizes}, and {most} voxels are allowed",
            "raise --max-voxels or --max-memory",
        )
    if listed is not None and not 1 <= sizes[listed] <= _LONGEST_LIST:
        raise InputError(
            name, f"each sample is a list of {sizes[listed]} numbers", f"give up to {_LONGEST_LIST}"
        )
    lattice = spatial_lattice(header, spatial, name)
    samples = _samples(nrrd, header, _data(header, rest, name, folder), name)
    if listed is None:
        return samples, lattice, None
    return np.moveaxis(samples, listed, -1), lattice, str(header.get("kinds", ["list"] * 4)[listed]).lower()


def _header(nrrd: Any, data: bytes, name: str) -> tuple[dict[str, Any], bytes]:
    """Parse the header; return it, and what follows it."""
    file = io.BytesIO(data[:_LONGEST_HEADER])
    try:
        with warnings.catch_warnings(action="ignore"):
            header = dict(nrrd.read_header(file))
        if len(header["sizes"]) != header["dimension"]:
            raise ValueError("dimension and sizes differ")
        header["encoding"] = header["encoding"].lower()
    except (nrrd.NRRDError, *_DAMAGE) as error:
        raise InputError(name, f"the NRRD header is damaged ({_line(error)})", _REPAIR) from error
    return header, data[file.tell() :]


def _data(header: dict[str, Any], rest: bytes, name: str, folder: Path | None) -> bytes:
    """Return the data behind the header, or those of the file beside it that it names."""
    named = header.pop("data file", None) or header.pop("datafile", None)
    if named is None:
        return rest
    beside = ModelFolder(folder)
    found = beside.find(str(named))
    if found is None:
        raise InputError(
            name, f"its data are in {named}, which is no file in its folder", "put both in one folder"
        )
    try:
        return beside.read(found)
    except OSError as error:
        raise InputError(
            name, f"its data in {named} cannot be read ({error.strerror})", "check them"
        ) from error


def _samples(nrrd: Any, header: dict[str, Any], data: bytes, name: str) -> NDArray[Any]:
    """Read the numbers, with the fastest axis first; never more of them than the header tells."""
    try:
        with warnings.catch_warnings(action="ignore"):
            if header["encoding"] in ("gzip", "gz", "bzip2", "bz2"):
                header, data = _inflated(header, data)
            samples: NDArray[Any] = nrrd.read_data(header, io.BytesIO(data))
    except (nrrd.NRRDError, *_DAMAGE, zlib.error, EOFError) as error:
        raise InputError(name, f"the NRRD data are damaged ({_line(error)})", _REPAIR) from error
    if samples.dtype.kind not in "uif":
        raise InputError(name, f"its samples are of type {header['type']}", "give numbers")
    return samples.astype(samples.dtype.newbyteorder("="), copy=False)


def _inflated(header: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Undo the compression as far as the header says that there are data, since pynrrd would go on to any end."""
    lines = int(header.get("line skip", header.get("lineskip", 0)))
    skipped = int(header.get("byte skip", header.get("byteskip", 0)))
    if skipped < 0 or lines < 0:
        raise ValueError("compressed data cannot be counted from their end")
    file = io.BytesIO(data)
    for _ in range(lines):
        file.readline()
    most = skipped + _LONGEST_NUMBER * math.prod(int(size) for size in header["sizes"])
    compressed = data[file.tell() :]
    if header["encoding"].startswith("g"):
        plain = zlib.decompressobj(zlib.MAX_WBITS | 16).decompress(compressed, most)
    else:
        plain = bz2.BZ2Decompressor().decompress(compressed, most)
    kept = {key: value for key, value in header.items() if key not in ("line skip", "lineskip")}
    return {**kept, "encoding": "raw"}, plain


def _line(error: BaseException) -> str:
    return " ".join(f"{error}".split()) or type(error).__name__
