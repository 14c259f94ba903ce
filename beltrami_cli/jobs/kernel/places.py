"""Find the sample that a user names: by the index of a vertex, a position, texture coordinates, or a pixel."""

from __future__ import annotations

from fnmatch import fnmatch
from typing import NamedTuple

import numpy as np

from beltrami_cli.arrays import Array
from beltrami_cli.errors import UsageError
from beltrami_cli.formats.document import Document
from beltrami_cli.layers.layer import SampledVertices
from beltrami_cli.surface.records import Cells


class Place(NamedTuple):
    """Where a sample is."""

    name: str  # vertex 12, texel 3,4 of skin.png, or pixel 3,4
    sample: int  # its number
    columns: dict[str, Array]  # where all samples are, for the table


def place_at(at: str, samples: SampledVertices | Cells, document: Document, label: str) -> Place:
    if isinstance(samples, SampledVertices):
        return _vertex_at(at, samples, document.name)
    # glTF counts v from the upper side of an image, other formats from the lower.
    return _texel_at(at, samples, label, is_flipped=document.format not in ("gltf", "glb"))


def _vertex_at(at: str, where: SampledVertices, name: str) -> Place:
    """Find the sample of a vertex, by its index or the nearest position."""
    numbers, positions, sample_of = _numbers(at), where.mesh.positions, where.sample_of
    if len(numbers) == 3:
        squared = np.where(sample_of >= 0, np.square(positions - numbers).sum(axis=1), np.inf)
        numbers = [float(np.nanargmin(squared))]
    if len(numbers) != 1 or numbers[0] not in range(len(positions)) or sample_of[int(numbers[0])] < 0:
        remedy = f"give its index, 0 to {len(positions) - 1}, or a position X,Y,Z"
        raise UsageError(f"--at {at} is not a coloured vertex of {name}; {remedy}")
    known, first = np.unique(sample_of, return_index=True)
    first, vertex = first[known >= 0], int(numbers[0])
    columns = {"vertex": first, **dict(zip("xyz", positions[first].T, strict=True))}
    return Place(f"vertex {vertex}", int(sample_of[vertex]), columns)


def _texel_at(at: str, cells: Cells, what: str, *, is_flipped: bool) -> Place:
    """Find the sample nearest to texture coordinates, or to a pixel of an image."""
    glob, _, place = at.rpartition(":")
    numbers, is_image, names = np.array(_numbers(place)), not cells.names, cells.names or [""]
    fitting = [index for index, name in enumerate(names) if fnmatch(name, glob or "*")]
    if len(fitting) != 1:
        which = "several textures" if fitting else "no texture"
        remedy = f"write one of {', '.join(names)} and a colon before the place"
        raise UsageError(f"--at {at} names {which}; {remedy}")
    in_texture, (row, column) = cells.of(fitting[0])
    size = np.array(cells.sizes[fitting[0]][::-1])
    if len(numbers) == 2 and not is_image:
        numbers = np.floor((numbers[0], 1 - numbers[1] if is_flipped else numbers[1]) * size)
    last = size - 1 if is_image else size
    if len(numbers) != 2 or not ((numbers >= 0) & (numbers <= last)).all() or not in_texture.any():
        form = "column and row as X,Y" if is_image else "texture coordinates U,V from 0 to 1"
        raise UsageError(f"--at {at} is not inside {what}, {size[0]} x {size[1]}; give {form}")
    nearest = np.square(np.stack([column, row], axis=1) - numbers).sum(axis=1).argmin()
    name, columns = f"{column[nearest]},{row[nearest]}", {"x": cells.column, "y": cells.row}
    if not is_image:
        columns = {"texture": np.array(names)[cells.image], **columns}
    name = f"pixel {name}" if is_image else f"texel {name} of {names[fitting[0]]}"
    return Place(name, int(np.flatnonzero(in_texture)[nearest]), columns)


def _numbers(at: str) -> list[float]:
    try:
        numbers = [float(part) for part in at.split(",")]
    except ValueError:
        numbers = []
    if not numbers or not np.isfinite(numbers).all():
        raise UsageError(
            f"--at {at} cannot be understood; give the index of a vertex, X,Y,Z, U,V, or a pixel X,Y"
        )
    return numbers
