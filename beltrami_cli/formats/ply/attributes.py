"""What the vertices of a PLY file have beside their places and colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.formats.ply.paint import finite_columns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from beltrami_cli.formats.ply.tables import Table

POSITION = ("x", "y", "z")
NORMAL = ("nx", "ny", "nz")


def attribute_names(kinds: Mapping[str, str], colours: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of attributes: "normal" if there are three real components of one, and single properties.

    Parameters
    ----------
    kinds : mapping of str to str
        NumPy codes of the scalar properties by their names.
    colours : tuple of str
        Those that are colours.
    """
    others = tuple(name for name in kinds if name not in (*POSITION, *colours))
    real = all(kinds.get(name, "")[:1] == "f" for name in NORMAL)
    return (*(("normal",) if real else ()), *others)


def read_attribute(vertices: Table, name: str, file: str) -> NDArray[np.float64]:
    """Read an attribute of all vertices, shape (V, G).

    Parameters
    ----------
    vertices : Table
        The vertex element with its rows.
    name : str
        As `attribute_names` gives it.
    file : str
        The file's name for messages.

    Raises
    ------
    InputError
        If a number is not finite.
    """
    if name != "normal":
        return finite_columns(vertices, (name,), name, file)
    normals = finite_columns(vertices, NORMAL, name, file)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, length, out=np.zeros_like(normals), where=length > 0))
