"""Level sets and their colours in NRRD files, whose headers pynrrd reads."""

from __future__ import annotations

import bz2
import io
import math
import warnings
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from beltrami_cli.arrays import Array, Float64s
from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.sidecars.model_folder import ModelFolder
from beltrami_cli.formats.volume.extra import require_package
from beltrami_cli.formats.volume.lattice import MAX_CHANNELS, MIN_SIDE, checked_lattice
from beltrami_cli.surface.level_sets import GridColours, Lattice, Volume

_VALUE_AND_COLOURS = (2, 4, 5)  # numbers of a sample: a value with grey, with RGB, or with RGB and opacity
_LONGEST_LIST = 5
_LONGEST_NUMBER = 8  # bytes of a double
_LONGEST_HEADER = 1 << 16
_SPATIAL_KINDS = ("domain", "space")
_UNKNOWN_KINDS = ("???", "none")
_REPAIR = "write the file again"
# What pynrrd raises for headers and data that it does not understand, besides errors of its own.
_DAMAGE = (ValueError, KeyError, IndexError, TypeError, AttributeError, OSError, OverflowError, StopIteration)


def read_nrrd(data: bytes, name: str, folder: ModelFolder, most: int) -> Volume:
    """Read a level set, with its colours if the file has them; as `read_volume`."""
    samples, lattice, kind = _read_samples(data, name, folder, most)
    if kind is None:
        return Volume(lattice, samples)
    if samples.shape[3] not in _VALUE_AND_COLOURS or kind.endswith("color"):
        found = f"each sample is a list of {samples.shape[3]} numbers ({kind})"
        cause = f"{found}, and not a value, or a value and its colour"
        raise InputError(name, cause, "give the values as INPUT and the colours with --colours")
    return Volume(lattice, samples[..., 0], colours=GridColours(lattice, samples[..., 1:]))


def read_nrrd_colours(data: bytes, name: str, folder: ModelFolder, most: int) -> GridColours:
    """Read colours on a grid; as `read_colours`."""
    samples, lattice, kind = _read_samples(data, name, folder, most)
    if kind is None:
        samples = samples[..., None]
    if samples.shape[3] > MAX_CHANNELS:
        cause = f"each sample is a list of {samples.shape[3]} numbers"
        raise InputError(name, cause, f"give 1 to {MAX_CHANNELS}")
    return GridColours(lattice, samples)


def _read_samples(
    data: bytes, name: str, folder: ModelFolder, most: int
) -> tuple[Array, Lattice, str | None]:
    """Return samples [x, y, z], or [x, y, z, list], their lattice, and the kind of the list axis or None."""
    nrrd = require_package("nrrd", "pynrrd", name, "to read NRRD files")
    header, body = _read_header(nrrd, data, name)
    sizes = [int(size) for size in header["sizes"]]
    listed = _list_axis(header, name)
    spatial = [axis for axis in range(len(sizes)) if axis != listed]
    voxels = math.prod(sizes[axis] for axis in spatial)
    if len(spatial) != 3 or min(sizes[axis] for axis in spatial) < MIN_SIDE:
        raise InputError(name, f"its sizes are {sizes}", "give 2 or more samples along x, y and z")
    if voxels > most:
        cause = f"its sizes are {sizes}, and {most} voxels are allowed"
        raise MemoryLimitError(name, cause, "raise --max-voxels or --max-memory")
    if listed is not None and not 1 <= sizes[listed] <= _LONGEST_LIST:
        cause = f"each sample is a list of {sizes[listed]} numbers"
        raise InputError(name, cause, f"give up to {_LONGEST_LIST}")
    lattice = _spatial_lattice(header, spatial, name)
    samples = _decoded(nrrd, header, _body_of(header, body, name, folder), name)
    if listed is None:
        return samples, lattice, None
    return np.moveaxis(samples, listed, -1), lattice, str(header.get("kinds", ["list"] * 4)[listed]).lower()


def _read_header(nrrd: Any, data: bytes, name: str) -> tuple[dict[str, Any], bytes]:
    file = io.BytesIO(data[:_LONGEST_HEADER])
    try:
        with warnings.catch_warnings(action="ignore"):
            header = dict(nrrd.read_header(file))
        if len(header["sizes"]) != header["dimension"]:
            raise ValueError("dimension and sizes differ")
        header["encoding"] = header["encoding"].lower()
    except (nrrd.NRRDError, *_DAMAGE) as error:
        raise InputError(name, f"the NRRD header is damaged ({_one_line(error)})", _REPAIR) from error
    return header, data[file.tell() :]


def _body_of(header: dict[str, Any], body: bytes, name: str, folder: ModelFolder) -> bytes:
    """Return the data behind the header, or the content of the file that it names."""
    named = header.pop("data file", None) or header.pop("datafile", None)
    if named is None:
        return body
    found = folder.find(str(named))
    if found is None:
        cause = f"its data are in {named}, which is not a file in its folder"
        raise InputError(name, cause, "put both in one folder")
    try:
        return folder.read(found)
    except OSError as error:
        cause = f"its data in {named} cannot be read ({error.strerror})"
        raise InputError(name, cause, "check them") from error


def _decoded(nrrd: Any, header: dict[str, Any], data: bytes, name: str) -> Array:
    """Read the samples, fastest axis first, and no more than the header announces."""
    try:
        with warnings.catch_warnings(action="ignore"):
            if header["encoding"] in ("gzip", "gz", "bzip2", "bz2"):
                header, data = _inflated(header, data)
            samples: Array = nrrd.read_data(header, io.BytesIO(data))
    except (nrrd.NRRDError, *_DAMAGE, zlib.error, EOFError) as error:
        raise InputError(name, f"the NRRD data are damaged ({_one_line(error)})", _REPAIR) from error
    if samples.dtype.kind not in "uif":
        raise InputError(name, f"its samples are of type {header['type']}", "give numbers")
    return samples.astype(samples.dtype.newbyteorder("="), copy=False)


def _inflated(header: dict[str, Any], data: bytes) -> tuple[dict[str, Any], bytes]:
    """Decompress up to the size that the header announces; pynrrd would decompress without a bound."""
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


def _one_line(error: BaseException) -> str:
    return " ".join(f"{error}".split()) or type(error).__name__


def _list_axis(header: Mapping[str, Any], name: str) -> int | None:
    """Return the axis of the numbers of a sample, counted from the fastest; None if samples are single numbers."""
    count = len(header["sizes"])
    if count not in (3, 4):
        raise InputError(name, f"it has {count} axes", "give three, or four with one for colours")
    kinds = [str(kind).lower() for kind in header.get("kinds", [])]
    found = {axis for axis, kind in enumerate(kinds) if kind not in (*_SPATIAL_KINDS, *_UNKNOWN_KINDS)}
    directions = header.get("space directions")
    if directions is not None:
        found |= {axis for axis, row in enumerate(directions) if row is None or not np.isfinite(row).all()}
    if count == 3 and not found:
        return None
    if count == 4 and not found:
        found = {axis for axis, size in enumerate(header["sizes"]) if size == min(header["sizes"])}
    if len(found) != 1 or count == 3:
        cause = "it is not clear which three of its axes are spatial"
        raise InputError(name, cause, "set the kinds of these to domain")
    return found.pop()


def _spatial_lattice(header: Mapping[str, Any], axes: Sequence[int], name: str) -> Lattice:
    """Return the lattice of the three spatial axes: by space directions, or else at right angles."""
    directions = header.get("space directions")
    if directions is not None:
        rows = np.array([directions[axis] for axis in axes], float)
        origin = np.array(header.get("space origin", np.zeros(3)), float)
    else:
        spacing, origin = _along_axes(header, axes)
        rows = np.diag(spacing)
    if rows.shape != (3, 3) or origin.shape != (3,):
        raise InputError(name, "its space directions or origin are not of three dimensions", "repair them")
    return checked_lattice(rows, origin, name)


def _along_axes(header: Mapping[str, Any], axes: Sequence[int]) -> tuple[Float64s, Float64s]:
    """Return the spacings and the position of the first sample from `spacings`, `axis mins` and `axis maxs`."""
    lows = _numbers_along(_field(header, "axis mins", "axismins"), axes)
    highs = _numbers_along(_field(header, "axis maxs", "axismaxs"), axes)
    spacings = _numbers_along(header.get("spacings"), axes)
    centred = _field(header, "centerings", "centers") or []
    cells = np.array([axis < len(centred) and str(centred[axis]) == "cell" for axis in axes])
    sizes = np.array([int(header["sizes"][axis]) for axis in axes])
    with np.errstate(invalid="ignore"):
        # Cells fill the range; the outermost nodes lie on its ends.
        derived = (highs - lows) / np.where(cells, sizes, sizes - 1)
    steps = np.where(np.isfinite(spacings), spacings, np.where(np.isfinite(derived), derived, 1.0))
    start = np.where(np.isfinite(lows), lows + np.where(cells, steps / 2, 0), 0.0)
    return steps, start


def _field(header: Mapping[str, Any], *names: str) -> Any:
    return next((header[name] for name in names if name in header), None)


def _numbers_along(values: Any, axes: Sequence[int]) -> Float64s:
    """Return the entries of a per-axis field; NaN if it is missing."""
    if values is None or len(values) <= max(axes):
        return np.full(3, np.nan)
    return np.array([float(values[axis]) for axis in axes])
