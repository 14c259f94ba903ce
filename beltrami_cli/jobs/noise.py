"""Add noise to the colours of a file: for tests, and to show what smoothing takes away again."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from beltrami_cli.arrays import Float32s, Float64s, Int32s
from beltrami_cli.errors import ProcessingError, UsageError
from beltrami_cli.flow.manifolds.canvas import on_canvas
from beltrami_cli.flow.manifolds.new_colours import NewColours
from beltrami_cli.formats.image.writing import noise_losses
from beltrami_cli.jobs.file_job import FileReport
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.noise_kinds import NumberedSamples, add_grain, add_noise, as_jpeg, seen_by_camera
from beltrami_cli.jobs.recolour import ColourFilter, FilterResult, recolour
from beltrami_cli.jobs.settings import NoiseSettings
from beltrami_cli.layers.image_layer import ImageLayer
from beltrami_cli.layers.layer import Layer
from beltrami_cli.layers.pixel_layer import PixelLayer
from beltrami_cli.layers.settings import DEFAULTS, SLOTS, SmoothSettings
from beltrami_cli.layers.storing import StoredColours
from beltrami_cli.layers.texture_layer import TextureLayer
from beltrami_cli.layers.vertex_layer import VertexLayer, change_of
from beltrami_cli.surface.baking import places_of_texels
from beltrami_cli.surface.colour_values import from_space, to_space
from beltrami_cli.surface.grouping import group_places
from beltrami_cli.surface.records import Cells, ColouredVertices


@dataclass(frozen=True)
class Added:
    """What noise changed: which colours, how many samples, and the root mean square change in the file."""

    what: str
    samples: int
    rms: float


@dataclass(frozen=True, kw_only=True)
class NoiseReport(FileReport):
    """What was done to a file.

    Attributes
    ----------
    added : list
        For each kind of colours "what" they are, how many "samples", and the "rms" change, full scale 1.
    input, output, format, parameters, stages, peak_memory, written, warnings
        As for `SmoothReport`.
    """

    added: list[Added]


@dataclass(frozen=True, kw_only=True)
class NoisyResult(FilterResult):
    """Samples with noise, and what it changed."""

    added: Added


@dataclass(frozen=True)
class NoiseFilter(ColourFilter[NoisyResult]):
    """A filter that adds noise."""

    works_in_files: ClassVar[bool] = False
    noise: NoiseSettings

    @property
    def changes(self) -> bool:
        return self.noise.sigma != 0

    def apply(self, layer: Layer, job: Job) -> NoisyResult:
        del job
        samples = _samples_of(layer)
        after = _with_noise(layer, samples, self.noise)
        stored = _stored(layer, samples, after)
        what = "vertex colours" if isinstance(layer, VertexLayer) else layer.label
        return NoisyResult(stored=stored, added=Added(what, len(after), stored.change.summary()["rms"]))

    def check_results(self, source: str, results: Sequence[NoisyResult]) -> None:
        changes = [each.stored.change for each in results]
        if any(each.count for each in changes) and not any(each.largest for each in changes):
            remedy = "add more, or choose a format without loss"
            raise ProcessingError(f"nothing of the noise would be left in the file; {remedy}", source)


def noise_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    noise: NoiseSettings,
    settings: SmoothSettings = DEFAULTS,
    job: Job = PLAIN_JOB,
) -> NoiseReport:
    """Add noise to the selected colours of a model, points, a level set or an image, and change nothing else.

    Parameters
    ----------
    source, target : path
        As for `smooth_file`.
    noise : NoiseSettings
        Its kind, how much, and the seed.
    settings : SmoothSettings
        Which colours, and how textures are written; the kernel does not matter.
    job : Job
        What may be read, and whether files are written and replaced.

    Returns
    -------
    NoiseReport
        What was changed by how much, and the files that were written.

    Raises
    ------
    UsageError, InputError, OutputError
        As for `smooth_file`.
    """
    report, results = recolour(os.fspath(source), os.fspath(target), settings, NoiseFilter(noise), job)
    parameters = dataclasses.asdict(noise)
    return NoiseReport(**{**vars(report), "parameters": parameters}, added=[each.added for each in results])


def _samples_of(layer: Layer) -> NumberedSamples:
    """Return the colours of the vertices, texels or pixels of a layer."""
    space = layer.settings.space
    if isinstance(layer, VertexLayer):
        vertices, rows = layer.vertices, _rows_of(layer)
        before = to_space(vertices.colours[rows][:, layer.channels.changing], vertices.encoding, space)
        return NumberedSamples(before, _places_of(vertices, rows), space=space)
    if isinstance(layer, ImageLayer):
        before = layer.colours.working(layer.image, np.flatnonzero(layer.valid))
        return NumberedSamples(before, np.arange(len(before)), space=space)
    assert isinstance(layer, TextureLayer)
    atlas = layer.atlas
    # Texels are numbered by their place in the textures, and not on the canvas.
    number = np.empty(len(atlas.owned_texels), np.int64)
    number[np.argsort(atlas.owned_texels)] = np.arange(len(number))
    is_grey = np.array([len(image.colour) == 1 for image in layer.images], bool)
    return NumberedSamples(
        colours=layer.all_texel_colours(),
        number_of=number,
        stream=1 + SLOTS.index(layer.slot),
        is_grey=is_grey[np.searchsorted(atlas.texture_offsets, atlas.owned_texels, side="right") - 1],
        space=layer.colours.space,
    )


def _stored(layer: Layer, samples: NumberedSamples, after: Float32s) -> StoredColours:
    """Put new colours of samples into the form of the document."""
    if isinstance(layer, VertexLayer):
        vertices, changing = layer.vertices, layer.channels.changing
        colours, places = vertices.colours.copy(), (_rows_of(layer)[:, None], changing)
        # Conversion to the working space and back is not exact: unchanged colours keep their bits.
        back = from_space(after, vertices.encoding, samples.space)
        colours[places] = np.where(after != samples.colours, back, colours[places])
        return StoredColours(change_of(vertices, colours), colours)
    if isinstance(layer, ImageLayer):
        new = NewColours.of(after, np.flatnonzero(layer.valid))
        remedy = "an OUTPUT in .png keeps all"
    else:
        assert isinstance(layer, TextureLayer)
        atlas = layer.atlas
        planes = on_canvas(atlas, after)
        beyond = np.ascontiguousarray(planes.reshape(len(planes), -1)[:, atlas.gutter_cells].T)
        new = NewColours.of(after, atlas.owned_texels, atlas.gutter_texels, beyond)
        remedy = "--texture-format png keeps all"
    encoded = layer.encode(new)
    losses = [loss for each in layer.images for loss in noise_losses(each, layer.suffix, remedy)]
    return dataclasses.replace(encoded, notices=(*encoded.notices, *losses))


def _rows_of(layer: VertexLayer) -> NDArray[np.intp]:
    return layer.vertices.coloured_rows(in_triangles=layer.in_triangles)


def _places_of(vertices: ColouredVertices, rows: NDArray[np.intp]) -> Int32s:
    spaces = None if vertices.space_of is None else vertices.space_of[rows]
    return group_places(vertices.positions[rows], spaces)[0]


def _with_noise(layer: Layer, samples: NumberedSamples, settings: NoiseSettings) -> Float32s:
    if not samples.colours.size or settings.sigma == 0:
        return samples.colours.copy()
    if settings.kind == "jpeg":
        return _coded_as_jpeg(layer, settings.quality)
    if settings.kind == "camera":
        where = layer.places()
        return seen_by_camera(samples, where if isinstance(where, Cells) else None, settings)
    if settings.kind == "grain":
        return add_grain(samples, *_positions_of(layer), settings)
    return add_noise(samples, settings)


def _positions_of(layer: Layer) -> tuple[Float64s, Float64s]:
    """Return the positions of the samples, (K, 3), and their distance from neighbours, (K,)."""
    if isinstance(layer, VertexLayer):
        rows = _rows_of(layer)
        return layer.vertices.positions[rows], _spacing(layer.vertices, rows)
    cells = layer.places()
    assert isinstance(cells, Cells)
    if isinstance(layer, TextureLayer):
        return places_of_texels(layer.surface, cells)
    places = np.column_stack([cells.column, cells.row, np.zeros_like(cells.row)])
    return places.astype(np.float64), np.ones(len(places))


def _spacing(vertices: ColouredVertices, rows: NDArray[np.intp]) -> Float64s:
    """Return the mean length of the sides at each vertex's place, or of points the distance to the next place."""
    place_of = _places_of(vertices, rows)
    count = int(place_of.max(initial=-1)) + 1
    first = np.zeros(count, np.int64)
    first[place_of] = np.arange(len(rows))
    places = vertices.positions[rows[first]]
    if not len(vertices.faces) and count > 1:
        from scipy.spatial import cKDTree

        apart = np.asarray(cKDTree(places).query(places, k=2)[0], np.float64)
        return np.asarray(apart[place_of, 1])
    number = np.full(len(vertices.positions), -1)
    number[rows] = place_of
    corners = number[vertices.faces]
    sides = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    sides = sides[(sides >= 0).all(axis=1) & (sides[:, 0] != sides[:, 1])]
    lengths = np.linalg.norm(places[sides[:, 0]] - places[sides[:, 1]], axis=1)
    total = np.bincount(sides.ravel(), np.repeat(lengths, 2), count)
    ends = np.bincount(sides.ravel(), minlength=count)
    return np.asarray((total / np.maximum(ends, 1))[place_of], np.float64)


def _coded_as_jpeg(layer: Layer, quality: int) -> Float32s:
    """Return the colours of the samples as they are after their images went through JPEG."""
    if not isinstance(layer, PixelLayer):
        remedy = "put the colours into a texture first: `beltrami bake --to texture`"
        raise UsageError(f"{layer.label}: JPEG codes images; {remedy}")
    if layer.names not in (("red", "green", "blue"), ("grey",)):
        cause = f"{layer.label}: JPEG codes all channels together; leave out --channels and --alpha"
        raise UsageError(cause)
    cells, space = layer.places(), layer.colours.space
    assert isinstance(cells, Cells)
    coded = np.empty((len(cells.row), len(layer.names)), np.float32)
    for index, image in enumerate(layer.images):
        working = layer.colours.working(image, np.arange(image.pixels[..., 0].size))
        shown = from_space(working, "srgb", space).reshape(*image.pixels.shape[:2], -1)
        inside, place = cells.of(index)
        coded[inside] = to_space(as_jpeg(shown, quality)[place], "srgb", space)
    return coded
