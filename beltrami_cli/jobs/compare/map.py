"""Where two files differ, as a picture or a mesh to look at: dark where they are equal, bright where they differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.document import Written
from beltrami_cli.samples.settings import IMAGE_SUFFIXES
from beltrami_cli.surface.colour_values import as_bytes, colour_by_value

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beltrami_cli.arrays import Float64s, Uint8s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.compare.figures import ComparedColours

# The brightest colour stands for this Delta E 2000 at least: 1 can hardly be seen.
_LEAST = 1.0
_GAP = 8  # pixels between images
_SCALAR = b"\nproperty uchar blue\nproperty float "  # of the header, where the numbers follow the colours
_SUFFIXES = (".ply", *IMAGE_SUFFIXES)


def require_map(target: str) -> None:
    """Raise UsageError if the name of a map ends in no format that one is drawn in."""
    if Path(target).suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{target}: a map is drawn as .png, or of vertices as .ply; end the name in one")


def is_map(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of a map of vertices; pictures have no mark."""
    return head.startswith(b"ply\n") and _SCALAR in head.partition(b"end_header\n")[0]


def draw_map(parts: Sequence[ComparedColours], model: Document, target: str) -> tuple[Written, float]:
    """Draw the images and textures among parts, or else the vertices of a model; return the scale, too."""
    # The scale is the Delta E, or 100 times the error of data, that the brightest colour stands for.
    images = [part for part in parts if part.size is not None]
    if parts[0].kind == "vertices" and (not images or target.lower().endswith(".ply")):
        return _draw_vertices(parts[0], model, target)
    return _draw_images(images, target)


def _draw_images(parts: Sequence[ComparedColours], target: str) -> tuple[Written, float]:
    """Draw the differences of images or textures side by side, grey where nothing is compared."""
    suffix = Path(target).suffix.lower()
    if suffix == ".ply":
        raise UsageError(f"{target}: the map of images and textures is drawn as .png; end its name so")
    from beltrami_cli.formats.image import write_image
    from beltrami_cli.formats.image.picture import new_picture

    scale = _scale(parts)
    drawn = [_image_of(part, scale) for part in parts]
    height = max(len(panel) for panel in drawn)
    columns = []
    for panel in drawn:
        columns += [_padded(panel, height), np.full((height, _GAP, 3), 255, np.uint8)]
    pixels = np.ascontiguousarray(np.hstack(columns[:-1]))
    return Written([write_image(new_picture(pixels, target), pixels, suffix=suffix).data]), scale


def _draw_vertices(part: ComparedColours, document: Document, target: str) -> tuple[Written, float]:
    """Draw the differences of vertices as a mesh, with delta_e and error (NaN where nothing is compared)."""
    if Path(target).suffix.lower() != ".ply":
        raise UsageError(f"{target}: the map of vertices is drawn as .ply; end its name so")
    from beltrami_cli.formats.ply.writer import write_scalars_as_ply

    painted, scale = document.painted(), _scale([part])
    values = np.full(len(painted.positions), np.nan, np.float32)
    errors = values.copy()
    values[part.index] = _amount(part)
    errors[part.index] = np.abs(part.test - part.reference).max(axis=1)
    held = np.isfinite(values)
    shades = as_bytes(
        colour_by_value(values / np.float32(scale), np.ones((len(values), 3), np.float32), held)
    )
    scalars = {"delta_e": values, "error": errors}
    if part.delta_e is None:
        del scalars["delta_e"]
    places = np.nan_to_num(painted.positions)
    return write_scalars_as_ply(places, painted.faces, shades, scalars), scale


def _amount(part: ComparedColours) -> Float64s:
    if part.delta_e is not None:
        return part.delta_e
    return np.asarray(100 * np.abs(part.test - part.reference).max(axis=1), np.float64)


def _scale(parts: Sequence[ComparedColours]) -> float:
    return max(_LEAST, *(float(_amount(part).max(initial=0)) for part in parts))


def _image_of(part: ComparedColours, scale: float) -> Uint8s:
    size = cast("tuple[int, int]", part.size)
    values, held = np.zeros(size, np.float32), np.zeros(size, bool)
    columns, rows = part.index.T
    values[rows, columns] = _amount(part) / scale
    held[rows, columns] = True
    return as_bytes(colour_by_value(values, np.ones((*size, 3), np.float32), held))


def _padded(panel: Uint8s, height: int) -> Uint8s:
    return np.pad(panel, ((0, height - len(panel)), (0, 0), (0, 0)), constant_values=255)
