"""Where two files differ, as a picture or a mesh to look at: dark where they are equal, bright where they differ."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from beltrami_cli.errors import UsageError
from beltrami_cli.formats.document import Written
from beltrami_cli.jobs.colour_map import colour_by_value
from beltrami_cli.samples.settings.smooth import IMAGE_SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.document import Document
    from beltrami_cli.jobs.compare.paired_colours import PairedColours

# The brightest colour stands for this Delta E 2000 at least: 1 can hardly be seen.
_LEAST = 1.0
_GAP = 8  # pixels between images
_SUFFIXES = (".ply", *IMAGE_SUFFIXES)


def require_map(target: str) -> None:
    """Raise UsageError if the name of a map ends in no format that one is drawn in."""
    if Path(target).suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{target}: a map is drawn as .png, or of vertices as .ply; end the name in one")


def draw_images(parts: Sequence[tuple[PairedColours, tuple[int, int]]], target: str) -> tuple[Written, float]:
    """Draw the differences of images or textures side by side, grey where nothing is compared.

    Parameters
    ----------
    parts : sequence of (PairedColours, (int, int))
        With the rows and columns of each.
    target : str
        Its extension chooses the format.

    Returns
    -------
    written : Written
        One file.
    scale : float
        The Delta E (or 100 times the error of data) that the brightest colour stands for.

    Raises
    ------
    UsageError
        If the extension is of a mesh.
    """
    suffix = Path(target).suffix.lower()
    if suffix == ".ply":
        raise UsageError(f"{target}: the map of images and textures is drawn as .png; end its name so")
    from beltrami_cli.formats.image import write_image
    from beltrami_cli.formats.image.picture import new_picture

    scale = _scale([pair for pair, _ in parts])
    drawn = [_image_of(pair, size, scale) for pair, size in parts]
    height = max(len(panel) for panel in drawn)
    columns = []
    for panel in drawn:
        columns += [_padded(panel, height), np.full((height, _GAP, 3), 255, np.uint8)]
    pixels = np.ascontiguousarray(np.hstack(columns[:-1]))
    return Written([write_image(new_picture(pixels, target), pixels, suffix=suffix).data]), scale


def draw_vertices(pair: PairedColours, document: Document, target: str) -> tuple[Written, float]:
    """Draw the differences of vertices as a mesh, with the properties delta_e and error (NaN where none is compared).

    Parameters
    ----------
    pair : PairedColours
        Of vertices.
    document : Document
        The reference.
    target : str
        Must end in .ply.

    Returns
    -------
    written, scale
        As for `draw_images`.

    Raises
    ------
    UsageError
        If the extension is another.
    """
    if Path(target).suffix.lower() != ".ply":
        raise UsageError(f"{target}: the map of vertices is drawn as .ply; end its name so")
    from beltrami_cli.formats.ply.writer import write_scalars_as_ply

    painted, scale = document.painted(), _scale([pair])
    values = np.full(len(painted.positions), np.nan, np.float32)
    errors = values.copy()
    values[pair.place] = _amount(pair)
    errors[pair.place] = np.abs(pair.test - pair.reference).max(axis=1)
    held = np.isfinite(values)
    shades = _bytes(colour_by_value(values / np.float32(scale), np.ones((len(values), 3), np.float32), held))
    scalars = {"delta_e": values, "error": errors}
    if pair.delta_e is None:
        del scalars["delta_e"]
    places = np.nan_to_num(painted.positions)
    return write_scalars_as_ply(places, painted.faces, shades, scalars), scale


def _amount(pair: PairedColours) -> NDArray[np.float64]:
    if pair.delta_e is not None:
        return pair.delta_e
    return np.asarray(100 * np.abs(pair.test - pair.reference).max(axis=1), np.float64)


def _scale(pairs: Sequence[PairedColours]) -> float:
    return max(_LEAST, *(float(_amount(pair).max(initial=0)) for pair in pairs))


def _image_of(pair: PairedColours, size: tuple[int, int], scale: float) -> NDArray[np.uint8]:
    values, held = np.zeros(size, np.float32), np.zeros(size, bool)
    columns, rows = pair.place.T
    values[rows, columns] = _amount(pair) / scale
    held[rows, columns] = True
    return _bytes(colour_by_value(values, np.ones((*size, 3), np.float32), held))


def _padded(panel: NDArray[np.uint8], height: int) -> NDArray[np.uint8]:
    return np.pad(panel, ((0, height - len(panel)), (0, 0), (0, 0)), constant_values=255)


def _bytes(colours: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(255 * colours).astype(np.uint8)
