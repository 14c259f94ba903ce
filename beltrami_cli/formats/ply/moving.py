"""New places of the vertices of a PLY file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.ply.attributes import NORMAL, POSITION, attribute_names
from beltrami_cli.formats.ply.patching import Change

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.ply.tables import Table
    from beltrami_cli.surface.records import MovedVertices


def require_real(kinds: Mapping[str, str], names: tuple[str, ...], file: str) -> None:
    """Refuse properties that are whole numbers.

    Raises
    ------
    InputError
        If one of them is.
    """
    whole = [name for name in names if kinds[name][0] != "f"]
    if whole:
        cause = f"the coordinates {', '.join(whole)} are whole numbers, which cannot hold smoothed positions"
        raise InputError(file, cause, "store them as float or double")


def moved_changes(vertices: Table, kinds: Mapping[str, str], places: MovedVertices) -> list[Change]:
    """Return what changes when vertices move, for `patch_body`.

    Parameters
    ----------
    vertices : Table
        The vertex element with its rows.
    kinds : mapping of str to str
        NumPy codes of its scalar properties by their names.
    places : MovedVertices
        New positions, and normals where there are some.
    """
    changes = list(_changes(vertices, kinds, POSITION, places.positions))
    if places.normals is not None and "normal" in attribute_names(kinds, ()):
        changes += _changes(vertices, kinds, NORMAL, places.normals)
    return changes


def _changes(
    vertices: Table, kinds: Mapping[str, str], names: tuple[str, ...], new: NDArray[Any]
) -> Iterator[Change]:
    for name, column in zip(names, new.T, strict=True):
        old = vertices.scalars(name)
        rows = (column != old) & ~np.isnan(column)
        yield Change(name, rows, column[rows].astype(kinds[name]))
