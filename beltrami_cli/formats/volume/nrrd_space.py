"""Where the samples of an NRRD file stand in space, by the fields of its header.

References
----------
.. [1] G. Kindlmann, "Definition of NRRD file format", sections "Space and orientation information" and "Per-axis field
   specifications", https://teem.sourceforge.net/nrrd/format.html
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.volume.checking import checked_lattice

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.surface.volume import Lattice

_SPATIAL_KINDS = ("domain", "space")
_UNKNOWN_KINDS = ("???", "none")


def list_axis(header: Mapping[str, Any], name: str) -> int | None:
    """Find the axis along which the numbers of one sample are listed.

    Parameters
    ----------
    header : mapping
        As pynrrd parses it.
    name : str
        The file as the user named it.

    Returns
    -------
    int or None
        The axis, counted from the fastest; None if there are three axes, and each is one of space.

    Raises
    ------
    InputError
        If there are other than three or four axes, or it cannot be told.
    """
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
        raise InputError(
            name,
            "it cannot be told which three of its axes are those of space",
            "set the kinds of these to domain",
        )
    return found.pop()


def spatial_lattice(header: Mapping[str, Any], axes: Sequence[int], name: str) -> Lattice:
    """Tell where samples stand.

    Parameters
    ----------
    header : mapping
        As pynrrd parses it.
    axes : sequence of int
        The three axes of space.
    name : str
        The file as the user named it.

    Returns
    -------
    Lattice
        In the file's own space. By `space directions` and `space origin`; or else by `spacings`, or `axis mins` and
        `axis maxs`, of which those that are missing are 1 and 0.

    Raises
    ------
    InputError
        If directions are missing for an axis, or cannot be computed with.
    """
    directions = header.get("space directions")
    if directions is not None:
        rows = np.array([directions[axis] for axis in axes], float)
        origin = np.array(header.get("space origin", np.zeros(3)), float)
    else:
        spacing, first = _along_axes(header, axes)
        rows, origin = np.diag(spacing), first
    if rows.shape != (3, 3) or origin.shape != (3,):
        raise InputError(name, "its space directions or origin are not of three dimensions", "repair them")
    return checked_lattice(rows, origin, name)


def _along_axes(
    header: Mapping[str, Any], axes: Sequence[int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the spacings, and the place of the first sample, on axes that are at right angles."""
    lows = _finite(_field(header, "axis mins", "axismins"), axes)
    highs = _finite(_field(header, "axis maxs", "axismaxs"), axes)
    spacings = _finite(header.get("spacings"), axes)
    centred = _field(header, "centerings", "centers") or []
    cells = np.array([axis < len(centred) and str(centred[axis]) == "cell" for axis in axes])
    sizes = np.array([int(header["sizes"][axis]) for axis in axes])
    with np.errstate(invalid="ignore"):
        # Cells fill the range from one end to the other; nodes stand on its ends.
        derived = (highs - lows) / np.where(cells, sizes, sizes - 1)
    steps = np.where(np.isfinite(spacings), spacings, np.where(np.isfinite(derived), derived, 1.0))
    start = np.where(np.isfinite(lows), lows + np.where(cells, steps / 2, 0), 0.0)
    return steps, start


def _field(header: Mapping[str, Any], *names: str) -> Any:
    return next((header[name] for name in names if name in header), None)


def _finite(values: Any, axes: Sequence[int]) -> NDArray[np.float64]:
    """Return the entries of a per-axis field; NaN where there is none."""
    if values is None or len(values) <= max(axes):
        return np.full(3, np.nan)
    return np.array([float(values[axis]) for axis in axes])
