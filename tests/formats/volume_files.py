"""Files of level sets, made of arrays."""

import io
import zipfile

import nrrd
import numpy as np

from oracles.level_sets import directions, pattern, places, sphere


def npz(compressed=True, **arrays):
    """Return the bytes of an archive."""
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return file.getvalue()


def npz_of_members(**members):
    """Return the bytes of an archive of raw members, which need not be arrays."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for key, data in members.items():
            archive.writestr(f"{key}.npy", data)
    return file.getvalue()


def header_only(shape, dtype="<f4", data=b""):
    """Return a member whose header announces an array."""
    file = io.BytesIO()
    described = {"descr": dtype, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, described)
    return file.getvalue() + data


def nrrd_file(samples, encoding="raw", **fields):
    """Return the bytes of an NRRD file; the fastest axis of `samples` is the first."""
    file = io.BytesIO()
    header = {name.replace("_", " "): value for name, value in fields.items()}
    nrrd.write(file, np.asarray(samples), {"encoding": encoding, **header})
    return file.getvalue()


def lattice_fields(axes, origin, listed=None):
    """Return the fields that say where samples stand; `listed` is the axis of colours, first or last."""
    rows = [list(row) for row in np.asarray(axes, float)]
    if listed is not None:
        rows.insert(listed, [np.nan] * 3)
    return {
        "space_dimension": 3,
        "space_directions": np.array(rows),
        "space_origin": np.asarray(origin, float),
    }


def write(path, data):
    path.write_bytes(data)
    return path


def sphere_file(folder, spacing, colours=None, **arrays):
    """Write a sphere with the colours of a function of places."""
    values, steps, origin = sphere(spacing)
    at = places(values.shape, steps, origin)
    shades = pattern(directions(at)) if colours is None else colours(at)
    arrays = {"values": values, "colours": shades, "spacing": steps, "origin": origin} | arrays
    return write(folder / "sphere.npz", npz(**arrays))
