"""Show the kernel of one sample: on the mesh or in an image, bright where it is near, or as a table."""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beltrami_cli.arrays import Array, Float32s
from beltrami_cli.errors import UsageError
from beltrami_cli.flow.beltrami_flow import smooth_in_place
from beltrami_cli.flow.manifolds.grid.manifold import GridManifold
from beltrami_cli.flow.manifolds.iteration import SampledKernel
from beltrami_cli.flow.parameters import growth_at
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.image.writing import write_image
from beltrami_cli.formats.ply.writer import write_scalars_as_ply
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.opening import open_input
from beltrami_cli.jobs.writing.output import Output
from beltrami_cli.layers.layer import Layer, SampledVertices
from beltrami_cli.layers.selection import select
from beltrami_cli.layers.settings import DEFAULTS, IMAGE_SUFFIXES, SmoothSettings
from beltrami_cli.surface.atlas import EMPTY
from beltrami_cli.surface.colour_map import as_bytes, colour_by_value
from beltrami_cli.surface.colour_values import from_space
from beltrami_cli.surface.records import Cells

_ZOOM, _GAP = 28, 12  # pixels of a cell in an image, and between its panels
_SURROUNDINGS = 4  # cells that are shown around the window


class Place(NamedTuple):
    """Where a sample is."""

    name: str  # vertex 12, texel 3,4 of skin.png, or pixel 3,4
    sample: int  # its number
    columns: dict[str, Array]  # where all samples are, for the table


@dataclass(frozen=True)
class ShownKernel:
    """The kernel of one sample in one iteration; `table` has a row for each sample that it holds, the nearest first."""

    at: str  # the name of its place
    iterations: int
    beta: float
    radius: float
    cut_short: bool  # at max_samples
    table: dict[str, Array]  # which sample it is, its distance, weight, and colour in the working space


def kernel_file(
    source: str | os.PathLike[str], target: str | os.PathLike[str], at: str, settings: SmoothSettings = DEFAULTS,
    *, iteration: int = 1, job: Job = PLAIN_JOB,
) -> ShownKernel:  # fmt: skip
    """Write the kernel of the sample at a place, in an iteration counted from 1, as .ply, image or .csv."""
    source, target = os.fspath(source), os.fspath(target)
    suffix = ".csv" if target == "-" else Path(target).suffix.lower()
    if suffix not in (".ply", ".csv", *IMAGE_SUFFIXES):
        raise UsageError("a kernel is written as .ply, .png or .csv; end the name in one", target)
    output = Output(target, overwrite=job.overwrite, is_text=suffix == ".csv", what="kernel", reads=[source])
    document, layer = _only_layer(source, settings, output.files.watching(job.access))
    samples = layer.places()
    on_mesh = isinstance(samples, SampledVertices)
    if suffix != ".csv" and (suffix == ".ply") != on_mesh:
        drawn_as = ".ply" if on_mesh else ".png"
        raise UsageError(f"a kernel on {layer.label} is drawn as {drawn_as}, or written as .csv", target)
    plan = layer.plan()
    parameters = plan.parameters
    if iteration > max(parameters.iterations, 1):
        cause = f"--iteration {iteration} is not among the {parameters.iterations} of smoothing"
        raise UsageError(f"{cause}; lower it, or raise --iterations")
    place = _place_at(at, samples, document, layer.label)
    earlier = plan.stopped_before(iteration - 1)
    manifold = smooth_in_place(earlier, job.progress_of("iterations before")).manifold
    kernel = manifold.kernel_at(place.sample, plan.step(iteration - 1))
    table = _table(kernel, place, layer)
    nearness = 1 - kernel.distances / max(np.float32(parameters.radius), np.finfo(np.float32).tiny)
    if suffix == ".csv":
        written = _csv(table)
    elif isinstance(samples, SampledVertices):
        written = _mesh(samples, kernel, nearness, _greys(manifold.new_colours().table(), layer))
    else:
        written = _image(manifold, place.sample, kernel, nearness, layer, suffix)
    output.write(written)
    beta = plan.beta / layer.unit * growth_at(iteration - 1, parameters.beta_growth)
    cut_short = on_mesh and len(kernel.samples) == parameters.max_samples
    return ShownKernel(place.name, parameters.iterations, beta, parameters.radius, cut_short, table)


def _only_layer(source: str, settings: SmoothSettings, access: Access) -> tuple[Document, Layer]:
    """Open a file, and return it and its selected layer; UsageError if there are several."""
    document = open_input(source, settings, access)
    selection = select(document, settings)
    selection.require_scale()
    if selection.vertices + len(selection.slots) + selection.image > 1:
        remedy = "choose --on vertices, or --on texture and one of --slots"
        raise UsageError(f"a kernel is of one image; {remedy}", document.name)
    selection.require_memory("smoothed" if selection.image else "recoloured")
    (layer,) = selection.layers()
    return document, layer.normalised()


def _table(kernel: SampledKernel, place: Place, layer: Layer) -> dict[str, Array]:
    table = {column: values[kernel.samples] for column, values in place.columns.items()}
    table |= {"distance": kernel.distances, "weight": kernel.weights}
    channels = ("L", "a", "b", *layer.names[3:]) if layer.settings.space == "oklab" else layer.names
    return table | dict(zip(channels, layer.unit * kernel.colours.T, strict=True))


def _csv(table: dict[str, Array]) -> Written:
    text = io.StringIO()
    rows = zip(*(values.tolist() for values in table.values()), strict=True)
    csv.writer(text, lineterminator="\n").writerows([list(table), *rows])
    return Written([text.getvalue().encode()])


def _place_at(at: str, samples: SampledVertices | Cells, document: Document, label: str) -> Place:
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


def _greys(colours: Float32s, layer: Layer) -> Float32s:
    """Convert working colours, (S, N), to display values, (S, 3); data by the range of the first channel."""
    if layer.names[0] in ("red", "grey"):
        shown = from_space(colours[:, : 3 if len(layer.names) > 2 else 1], "srgb", layer.settings.space)
    else:
        low, high = colours[:, :1].min(initial=np.inf), colours[:, :1].max(initial=-np.inf)
        shown = (colours[:, :1] - low) / max(high - low, np.float32(1e-30))
    return np.clip(np.broadcast_to(shown, (len(shown), 3)), 0, 1)


def _mesh(where: SampledVertices, kernel: SampledKernel, nearness: Float32s, greys: Float32s) -> Written:
    """Colour the whole mesh by nearness, with distance (NaN beyond the kernel) and weight as properties."""
    rows = np.full((len(greys), 3), [np.nan, np.nan, 0], np.float32)
    rows[kernel.samples] = np.column_stack([nearness, kernel.distances, kernel.weights])
    near, distance, weight = rows.T
    shades = as_bytes(colour_by_value(near, greys, np.isfinite(near)))
    sample_of, mesh = where.sample_of, where.mesh
    scalars = {"distance": distance[sample_of], "weight": weight[sample_of]}
    return write_scalars_as_ply(mesh.positions, mesh.faces, shades[sample_of], scalars)


def _image(
    manifold: GridManifold, index: int, kernel: SampledKernel, nearness: Float32s, layer: Layer, suffix: str
) -> Written:
    """Draw the canvas around a sample three times: its colours, the nearness, the weights."""
    atlas, offsets = manifold.geometry.atlas, kernel.offsets
    assert offsets is not None
    around = manifold.parameters.window // 2 + _SURROUNDINGS
    row, column = divmod(int(atlas.owned_cells[index]), atlas.kind.shape[1])
    place = np.s_[..., row : row + 2 * around + 1, column : column + 2 * around + 1]
    edge = [(around, around)] * 2
    filled = np.pad(atlas.kind, edge, constant_values=EMPTY)[place] != EMPTY
    colours = np.pad(manifold.colours, [(0, 0), *edge])[place]
    working = manifold.noise.to_input(colours.reshape(len(colours), -1).T)
    greys = _greys(working, layer).reshape(*filled.shape, 3)
    panels = [greys.astype(np.float64)]
    for values in (nearness, kernel.weights / kernel.weights.max()):
        shown = np.full(filled.shape, np.nan, np.float32)
        shown[tuple(offsets.T + around)] = values
        panels.append(colour_by_value(shown, greys, np.isfinite(shown)))
    drawn = [np.where(filled[..., None], panel, 1.0).repeat(_ZOOM, 0).repeat(_ZOOM, 1) for panel in panels]
    gap = np.ones((len(drawn[0]), _GAP, 3))
    pixels = as_bytes(np.hstack([drawn[0], gap, drawn[1], gap, drawn[2]]))
    return Written([write_image(new_image(pixels, "kernel"), pixels, suffix=suffix).data])
