"""Guides: channels that count as distance and are not changed.

For vertices they are attributes, or tables in files with one row per vertex; for images, images of the same size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.flow.embedding import Guide, centred
from beltrami_cli.formats.access import Access, is_there, read_source
from beltrami_cli.formats.image import read_image
from beltrami_cli.formats.image.picture import full_scale_one
from beltrami_cli.formats.npz import NPY_MAGIC, NpzArchive, read_npy
from beltrami_cli.formats.registry import document_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int64s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.samples.settings import SmoothSettings

_MOST_NUMBERS = 1 << 31  # of an array, before it is known that it fits
_ONE_ROW = "a guide needs one row for each coloured vertex, in the order of the file"


def vertex_guides(document: Document, settings: SmoothSettings, access: Access) -> list[Guide]:
    """Read all guides for the vertex colours of a document."""
    return [
        Guide(name, centred(_values(document, name, access)), beta)
        for name, beta in settings.embedding.weighted_guides
    ]


def _values(document: Document, name: str, access: Access) -> Float64s:
    known = document.attributes()
    if name.lower() in {attribute.lower() for attribute in known}:
        values = document.attribute(name)
        require_finite(values, document.name, "vertex")
        return values
    if not exists(name):
        attributes = ", ".join(known) or "no others"
        raise InputError(
            name, f"no such file, and no attribute of the vertices of {document.name}, which has {attributes}"
        )
    return read_table(name, len(document.painted().positions), document.name, access)


def read_table(path: str, rows: int, model: str, access: Access) -> Float64s:
    """Read a guide for vertices, shape (V, G), from an array, an archive with one, or the vertex colours of a model."""
    data = read_source(path, access)
    if data[: len(NPY_MAGIC)] == NPY_MAGIC:
        table = read_npy(data, path)
    elif NpzArchive.recognises(data) and (archive := NpzArchive(data, path)).kind() != "points":
        if len(archive.names) != 1:
            which = ", ".join(archive.names)
            raise InputError(path, f"which of its arrays {which} guides is not clear", "save it alone")
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


def read_map(path: str, access: Access) -> Float32s:
    """Read a guide for texels or pixels, shape (H, W, G)."""
    picture = read_image(read_source(path, access), path, finite=False)
    channels = [i for i in range(picture.pixels.shape[2]) if i != picture.alpha]
    return np.asarray(full_scale_one(picture.pixels[..., channels]), np.float32)


def require_size(image: Array, size: tuple[int, int], path: str, of: str) -> None:
    """Check that an image has the size of the one that it guides."""
    if image.shape[:2] != size:
        rows, columns = image.shape[:2]
        raise InputError(
            path,
            f"its {columns} x {rows} pixels do not fit the {size[1]} x {size[0]} of {of}",
            "both must have the same size, pixel by pixel",
        )


def require_finite(table: NDArray[np.floating[Any]], name: str, what: str) -> None:
    """Raise InputError if a number of a table, shape (S, G), is not finite; `what` names a row."""
    finite = np.isfinite(table).all(axis=1)
    if not finite.all():
        raise InputError(name, f"{what} {int(np.argmin(finite))} of the guide is not finite")


def exists(path: str) -> bool:
    """Return whether a file of this name exists, or it is standard input."""
    return path == "-" or is_there(path)


@dataclass(frozen=True)
class GuideImage:
    """A guide with one row per pixel."""

    name: str
    image: Float32s
    beta: float | None

    def at(self, pixels: Int64s) -> Guide:
        return Guide(self.name, self.image.reshape(-1, self.image.shape[2])[pixels], self.beta)


def read_guide_images(
    picture: Picture, valid: Bools, settings: SmoothSettings, access: Access
) -> tuple[GuideImage, ...]:
    """Read all guides for an image."""
    guides = []
    for path, beta in settings.embedding.weighted_guides:
        image = read_map(path, access)
        require_size(image, valid.shape, path, picture.name)
        finite = np.isfinite(image).all(axis=2) | ~valid
        if not finite.all():
            row, column = np.unravel_index(int(np.argmin(finite)), finite.shape)
            remedy = "leave such pixels out with --mask"
            raise InputError(
                path, f"its pixel {column},{row} is not finite, so it cannot guide there", remedy
            )
        guides.append(GuideImage(path, image, beta))
    return tuple(guides)
