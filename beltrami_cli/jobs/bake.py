"""Bake the colours of vertices into a new texture, or the colours of textures into vertices."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beltrami_cli.arrays import Bools, Float32s, Float64s, Int32s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image.decoded_image import DecodedImage
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.output_format import write_mesh
from beltrami_cli.jobs.file_job import FileReport, open_file_job
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.new_texture.from_textures import as_rgba
from beltrami_cli.jobs.new_texture.from_vertices import texture_from_vertices
from beltrami_cli.jobs.new_texture.texture import texture_description
from beltrami_cli.jobs.settings import BakeSettings, BakeTo
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.settings import DEFAULTS
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.grouping import group_equal_rows, group_places
from beltrami_cli.surface.lookups import look_up, noise_around
from beltrami_cli.surface.records import Encoding, MeshContents, TexturedSurface

_DEFAULTS = BakeSettings()
# A step that can hardly be seen, and that texels of several triangles' colours make anyway.
_INVISIBLE_STEP = 8 / 255
_SIGMAS = 4 * np.sqrt(2)  # of the difference of two noisy values
_MEDIAN = 1.4826  # from the median magnitude to the standard deviation
_FINENESS = ("uint8", "uint16", "float16", "float32")  # types of stored colours, the coarsest first


@dataclass(frozen=True, kw_only=True)
class BakeReport(FileReport):
    """What was done to a file; `dataclasses.asdict` gives JSON types.

    Attributes
    ----------
    counts, texture : dict, str
        How many triangles, charts or coloured vertices were written, and what kind of texture; empty if none was.
    input, output, format, parameters, stages, peak_memory, written, warnings
        As for `SmoothReport`.
    """

    counts: dict[str, int]
    texture: str


def bake_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    to: BakeTo,
    settings: BakeSettings = _DEFAULTS,
    job: Job = PLAIN_JOB,
) -> BakeReport:
    """Write a new file whose colours are in a texture, or in the vertices."""
    file = open_file_job(os.fspath(source), os.fspath(target), DEFAULTS, job, models_only=True)
    document, kind = file.document, file.format.name
    with file.watch.stage("read"):
        job.check_document(document)
        stem = file.reserve_new(".png" if to == "texture" else None)
    notices: tuple[str, ...]
    with file.watch.stage("bake"):
        if to == "texture":
            new = texture_from_vertices(document, settings, job.progress)
            counts = {"triangle": len(new.faces), **({} if new.charts is None else {"chart": new.charts})}
            image = new.encoded()
            written = write_mesh(new.mesh(image), kind, stem)
            notices, texture = new.notices, texture_description(image)
        else:
            Selection(document, DEFAULTS, slots=("baseColor",)).require_memory()
            contents, notices = _colours_from_textures(document)
            counts = {"coloured vertex": len(contents.positions), "triangle": len(contents.offsets) - 1}
            written, texture = write_mesh(contents, kind, stem), ""
    report = file.write(written, {"to": to, **dataclasses.asdict(settings)}, notices)
    return BakeReport(**vars(report), counts=counts, texture=texture)


def _colours_from_textures(document: Document) -> tuple[MeshContents, tuple[str, ...]]:
    """Return the base colour at every vertex."""
    # Where a seam runs through a vertex each side is looked up, and if they agree within the noise the vertex has
    # their mean. Otherwise there is a real colour edge, and the vertex stays split.
    surface = document.textured("baseColor")
    images = [read_texture(texture) for texture in surface.textures]
    corners, textured = surface.faces.ravel(), np.repeat(surface.texture_of >= 0, 3)
    values, noise = _corner_colours(surface, images)
    place = group_places(surface.positions, surface.space_of, surface.faces)[0][corners]
    uv = np.where(textured[:, None], surface.uv.reshape(-1, 2), 0.0)
    side, _ = group_equal_rows(place, np.repeat(surface.texture_of, 3), *uv.T)
    split = (_spread(values, place, textured) > _INVISIBLE_STEP + _SIGMAS * noise).any(axis=1)[place]
    vertex_of, first = group_equal_rows(place, np.where(split, side, -1))
    colours = _mean(values, vertex_of, textured, len(first))
    left_out, mesh_notices = _left_out(document)
    contents = MeshContents(
        positions=surface.positions[corners[first]],
        corners=vertex_of,
        offsets=np.arange(0, len(corners) + 1, 3, dtype=np.int64),
        colours=colours[:, :3],
        encoding=_encoding(images),
        stored=max((image.stored for image in images), key=_FINENESS.index),
        alpha=colours[:, 3] if any(image.alpha is not None for image in images) else None,
        left_out=left_out,
        frame=document.frame,
        notices=(*surface.notices, *mesh_notices),
    )
    notices, untextured = [], int((~textured).sum()) // 3
    if split.any():
        notices = [f"{int(split.sum())} corners lie at real colour edges, where vertices stay split."]
    if untextured:
        notices.append(f"{untextured} triangles have no texture; their own vertices are white.")
    return contents, tuple(notices)


def _left_out(document: Document) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Name the contents of a textured model other than triangles and the base colour; return also its notices."""
    mesh = document.textured_mesh()
    has_normals = mesh.corner_normals is not None or mesh.normals is not None
    found = ["texture coordinates", "textures", "materials", *(["normals"] if has_normals else [])]
    found += ["vertex colours"] if mesh.colours.size else []
    return (*found, *mesh.left_out, *document.hidden_places()), mesh.notices


def _encoding(images: Sequence[DecodedImage]) -> Encoding:
    return "linear" if all(image.encoding == "linear" for image in images) else "srgb"


def _corner_colours(surface: TexturedSurface, images: Sequence[DecodedImage]) -> tuple[Float64s, Float64s]:
    """Return red, green, blue and alpha at every corner, white where there is no texture, and their noise."""
    texture_of = np.repeat(surface.texture_of, 3)
    uv = surface.uv.reshape(-1, 2)
    values, residues = np.ones((len(uv), 4)), np.zeros((len(uv), 4))
    common = _encoding(images)
    for index, image in enumerate(images):
        in_texture = texture_of == index
        rgba, wrap = as_rgba(image), surface.textures[index].wrap
        looked_up = look_up(rgba, uv[in_texture], wrap, None if image.alpha is None else 3)
        if image.encoding != common:
            looked_up[:, :3] = linear_to_srgb(looked_up[:, :3])
        values[in_texture], residues[in_texture] = looked_up, noise_around(rgba, uv[in_texture], wrap)
    known = residues[texture_of >= 0]
    return values, _MEDIAN * np.median(np.abs(known), axis=0) if len(known) else np.zeros(4)


def _spread(values: Float64s, place: Int32s, textured: Bools) -> Float64s:
    """Return the range of the textured corners at each place, shape (places, 4)."""
    low = np.full((int(place.max()) + 1, 4), np.inf)
    high = -low
    np.minimum.at(low, place[textured], values[textured])
    np.maximum.at(high, place[textured], values[textured])
    return np.maximum(np.where(np.isfinite(low), high - low, 0), 0)


def _mean(values: Float64s, vertex_of: Int32s, textured: Bools, count: int) -> Float32s:
    """Return the mean over the corners of each vertex; those without texture count only where there are no others."""
    any_textured = np.bincount(vertex_of[textured], minlength=count) > 0
    used = textured | ~any_textured[vertex_of]
    weight = np.bincount(vertex_of[used], minlength=count)
    sums = [np.bincount(vertex_of[used], column, count) for column in values[used].T]
    return (np.stack(sums, axis=1) / weight[:, None]).astype(np.float32)
