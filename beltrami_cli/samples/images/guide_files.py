"""Files that guide: tables with a row for each vertex, and images with a pixel for each texel."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import read_source
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.image.picture import full_scale_one
from beltrami_cli.formats.npz import NPY_MAGIC, NpzArchive, read_npy
from beltrami_cli.formats.registry import document_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.formats.access import Access

_MOST_NUMBERS = 1 << 31  # of an array, before it is known that it fits
_ONE_ROW = "a guide needs one row for each coloured vertex, in the order of the file"


def read_table(path: str, rows: int, model: str, access: Access) -> NDArray[np.float64]:
    """Read a guide for vertices.

    Parameters
    ----------
    path : str
        A file of one array (.npy, .npz), or a model whose vertex colours guide.
    rows : int
        How many vertices there are to guide.
    model : str
        Where they come from, for messages.
    access : Access
        What may be read.

    Returns
    -------
    ndarray of float64, shape (rows, G)
        The numbers of the array as they are; colours with full scale 1.

    Raises
    ------
    InputError
        If it cannot be read, is of another number of rows, or has numbers that are not finite.
    """
    data = read_source(path, access)
    if data[: len(NPY_MAGIC)] == NPY_MAGIC:
        table = read_npy(data, path)
    elif NpzArchive.recognises(data) and (archive := NpzArchive(data, path)).kind() != "points":
        if len(archive.names) != 1:
            which = ", ".join(archive.names)
            raise InputError(path, f"which of its arrays {which} guides cannot be told", "save it alone")
        table = archive.read(archive.names[0], _MOST_NUMBERS)
    else:
        table = document_of(data, path, access).painted().colours
    if table.ndim == 1:
        table = table[:, None]
    if table.ndim != 2 or table.shape[0] != rows or not table.shape[1]:
        shape = " x ".join(map(str, table.shape))
        raise InputError(path, f"its {shape} numbers do not fit the {rows} vertices of {model}", _ONE_ROW)
    numbers = table.astype(np.float64)
    require_finite(numbers, path, "row")
    return numbers


def read_map(path: str, access: Access) -> NDArray[np.float32]:
    """Read a guide for texels or pixels.

    Parameters
    ----------
    path : str
        An image.
    access : Access
        What may be read.

    Returns
    -------
    ndarray of float32, shape (H, W, G)
        All channels but the opacity, as they are stored, full scale 1; not necessarily finite.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    picture = read_image(read_source(path, access), path, finite=False)
    channels = [i for i in range(picture.pixels.shape[2]) if i != picture.alpha]
    return np.asarray(full_scale_one(picture.pixels[..., channels]), np.float32)


def require_size(image: NDArray[Any], size: tuple[int, int], path: str, of: str) -> None:
    """Check that an image guides another pixel by pixel.

    Parameters
    ----------
    image : ndarray, shape (H, W, G)
        What guides.
    size : (int, int)
        Rows and columns of what is guided.
    path, of : str
        Both names, for the message.

    Raises
    ------
    InputError
        If they are of different sizes.
    """
    if image.shape[:2] != size:
        rows, columns = image.shape[:2]
        raise InputError(
            path,
            f"its {columns} x {rows} pixels do not fit the {size[1]} x {size[0]} of {of}",
            "both must have the same size, pixel by pixel",
        )


def require_finite(table: NDArray[np.floating[Any]], name: str, what: str) -> None:
    """Raise InputError if a number of a table, shape (S, G), is not finite; `what` its rows are."""
    finite = np.isfinite(table).all(axis=1)
    if not finite.all():
        raise InputError(name, f"{what} {int(np.argmin(finite))} of the guide is not finite")


def exists(path: str) -> bool:
    """Tell whether there is something of this name that may be a file."""
    return path == "-" or Path(path).exists()
