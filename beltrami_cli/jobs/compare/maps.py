"""Maps of differences: images, or meshes of vertices, dark where files are equal and bright where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Float64s, Uint8s
from beltrami_cli.errors import UsageError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.ply.writer import write_scalars_as_ply
from beltrami_cli.jobs.compare.measured import ComparedPart, Measured
from beltrami_cli.jobs.writing.output import Output, Overwrite
from beltrami_cli.layers.settings import IMAGE_SUFFIXES, SmoothSettings
from beltrami_cli.surface import large_arrays
from beltrami_cli.surface.colour_map import as_bytes, colour_by_value

# The brightest colour stands for this Delta E 2000 at least: 1 can hardly be seen.
_MIN_SCALE = 1.0
_GAP = 8  # pixels between images
_ROWS = 256  # of an image, drawn at a time
_SCALAR = b"\nproperty uchar blue\nproperty float "  # of the header, where the numbers follow the colours
_SUFFIXES = (".ply", *IMAGE_SUFFIXES)


def open_map(target: str, names: tuple[str, str], settings: SmoothSettings, overwrite: Overwrite) -> Output:
    """Check that a map can be written before anything is compared."""
    if Path(target).suffix.lower() not in _SUFFIXES:
        raise UsageError("a map is drawn as .png, or of vertices as .ply; end the name in one", target)
    output = Output(target, overwrite=overwrite, what="map", is_own=is_map, reads=names)
    output.files.guard(settings.input_files())
    return output


def is_map(head: bytes) -> bool:
    """Whether the first bytes of a file belong to a map of vertices; images have no mark."""
    return head.startswith(b"ply\n") and _SCALAR in head.partition(b"end_header\n")[0]


def draw_map(parts: Sequence[Measured], model: Document, target: str) -> tuple[Written, float]:
    """Draw images and textures side by side, or else the vertices; return also what the brightest colour stands for."""
    images, suffix = [each for each in parts if each.part.size is not None], Path(target).suffix.lower()
    on_vertices = parts[0].part.kind == "vertices" and (not images or suffix == ".ply")
    if on_vertices != (suffix == ".ply"):
        form = "vertices is drawn as .ply" if on_vertices else "images and textures is drawn as .png"
        raise UsageError(f"the map of {form}; end its name so", target)
    shown = parts[:1] if on_vertices else images
    # Delta E, or the error in per cent where Delta E is undefined.
    amounts = [np.where(np.isnan(each.delta_e), 100 * each.errors, each.delta_e) for each in shown]
    scale = max(_MIN_SCALE, *(float(each.max(initial=0)) for each in amounts))
    if on_vertices:
        return _draw_vertices(shown[0], amounts[0], scale, model), scale
    panels = [_image_of(each.part, values / scale) for each, values in zip(shown, amounts, strict=True)]
    width = sum(panel.shape[1] + _GAP for panel in panels) - _GAP
    pixels, left = np.full((max(map(len, panels)), width, 3), 255, np.uint8), 0
    for panel in panels:
        pixels[: len(panel), left : left + panel.shape[1]] = panel
        left += panel.shape[1] + _GAP
    return Written([write_image(new_image(pixels, target), pixels, suffix=suffix).data]), scale


def _draw_vertices(measured: Measured, amounts: Float64s, scale: float, document: Document) -> Written:
    """Draw the differences of vertices as a mesh, with delta_e and error (NaN where nothing is compared)."""
    vertices = document.coloured_vertices()
    drawn, delta_e, error = np.full((3, len(vertices.positions)), np.nan, np.float32)
    for table, values in ((drawn, amounts / scale), (delta_e, measured.delta_e), (error, measured.errors)):
        table[measured.part.index] = values
    shades = as_bytes(colour_by_value(drawn, np.ones((len(drawn), 3), np.float32), np.isfinite(drawn)))
    scalars = {"error": error} if np.isnan(delta_e).all() else {"delta_e": delta_e, "error": error}
    return write_scalars_as_ply(np.nan_to_num(vertices.positions), vertices.faces, shades, scalars)


def _image_of(part: ComparedPart, values: Float64s) -> Uint8s:
    """Draw values of samples, white where nothing is compared."""
    covered, drawn = part.covered(), np.empty((*part.covered().shape, 3), np.uint8)
    plane = np.zeros(covered.shape, np.float32)
    plane.reshape(-1)[part.index] = values
    for rows in large_arrays.blocks(len(drawn), _ROWS):
        grey = np.ones(drawn[rows].shape, np.float32)
        drawn[rows] = as_bytes(colour_by_value(plane[rows], grey, covered[rows]))
    return drawn
