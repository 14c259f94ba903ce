"""New textures of meshes, from vertex colours or textures; and `bake`, which moves colours to a texture or back."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError
from beltrami_cli.formats.conversion import vertex_mesh
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import DecodedImage, read_texture, to_float, without_alpha, write_image
from beltrami_cli.formats.image.decoded_image import new_image
from beltrami_cli.formats.registry import write_mesh
from beltrami_cli.jobs.job import PLAIN_JOB, Job
from beltrami_cli.jobs.progress import Progress
from beltrami_cli.jobs.recolour import FileReport, begin
from beltrami_cli.jobs.settings import BakeSettings
from beltrami_cli.layers.selection import Selection
from beltrami_cli.layers.settings import DEFAULTS, BakeTo
from beltrami_cli.surface.baking import (
    bake,
    interpolated,
    look_up,
    noise_around,
    overlap,
    texels_for_vertices,
)
from beltrami_cli.surface.colour_values import linear_to_srgb
from beltrami_cli.surface.geometry import triangulate
from beltrami_cli.surface.grouping import group_equal_rows, group_places
from beltrami_cli.surface.records import (
    Encoding,
    Frame,
    ImageFile,
    Material,
    MaterialMap,
    MeshContents,
    MeshImage,
    Texture,
    TexturedSurface,
)
from beltrami_cli.surface.unwrap import Unwrapped, require_few_faces, unwrap

Depth = type[np.uint8] | type[np.uint16]

_ON_A_LEVEL = 0.05  # of an 8-bit step: numbers this close to levels are taken for 8-bit values
_SHARED = 0.01  # share of texels at several places that rounding at chart boundaries may cause


@dataclass(frozen=True)
class NewTexture:
    """A mesh with its new texture."""

    positions: Float64s
    faces: Int32s
    uv: Float64s  # (F, 3, 2), as in `TexturedSurface`
    space_of: Int32s | None  # as in `ColouredVertices`
    pixels: Array  # uint8 or uint16, (H, W, 3) or (H, W, 4): the texture, sRGB
    charts: int | None  # number of charts, if it was unwrapped
    notices: tuple[str, ...]
    frame: Frame

    @property
    def in_words(self) -> str:
        height, width = self.pixels.shape[:2]
        return f"{'an 8-bit' if self.pixels.itemsize == 1 else 'a 16-bit'} texture of {width} x {height}"

    def encoded(self, suffix: str | None = None, jpeg_quality: int = 98, *, small: bool = False) -> ImageFile:
        """Return the texture as a file, PNG by default; options as for `write_image`."""
        picture = new_image(self.pixels, "the new texture")
        return write_image(picture, self.pixels, suffix=suffix, jpeg_quality=jpeg_quality, small=small)

    def surface(self) -> TexturedSurface:
        """Return the textured surface, as a document would."""
        texture = Texture("new", "the new texture", self.encoded().data, wrap=("clamp", "clamp"))
        texture_of = np.zeros(len(self.faces), np.int32)
        return TexturedSurface(self.positions, self.faces, self.uv, texture_of, (texture,), self.space_of)

    def mesh(self, image: ImageFile) -> MeshContents:
        """Return the mesh with the texture as an image file, for the writers."""
        alpha = self.pixels[..., 3:]
        transparent = bool(alpha.size and (alpha < alpha.max()).any())
        shown = MaterialMap(MeshImage(image), ("clamp", "clamp"))
        material = Material(maps={"baseColor": shown}, alpha="blend" if transparent else "opaque")
        return MeshContents(
            positions=self.positions,
            corners=self.faces.ravel(),
            offsets=3 * np.arange(len(self.faces) + 1),
            colours=np.empty((len(self.positions), 0), np.float32),
            frame=self.frame,
            uv=self.uv.reshape(-1, 2),
            materials=(material,),
        )


def texture_from_vertices(
    document: Document,
    wanted: BakeSettings,
    progress: Progress | None = None,
    colours: Float32s | None = None,
) -> NewTexture:
    """Interpolate vertex colours, or the given ones, shape (V, C), at the texels of a new texture."""
    # The stored numbers (in glTF linear light) are interpolated, and rounded once.
    contents = vertex_mesh(document, colours)
    faces = triangulate(contents.positions, contents.corners, contents.offsets)
    if not len(faces):
        remedy = "a texture needs a surface; mesh the points first"
        raise InputError(document.name, "it has no triangles", remedy)
    space_of = document.coloured_vertices().space_of
    charts = None
    if wanted.keep_uv:
        uv, size = _kept_uv(document, contents.positions[faces], wanted.size)
    else:
        texels = texels_for_vertices(contents.positions, faces)
        made = _unwrapped(document, contents.positions, faces, space_of, texels, wanted, progress)
        uv, size, charts = made.uv, made.size, made.charts
    dtype = _depth(contents)
    values = _vertex_values(contents)
    corners = values[faces]

    def shade(owners: Int64s, weights: Float64s) -> Array:
        return _rounded(_as_srgb(interpolated(corners, owners, weights), contents.encoding), dtype)

    pixels = bake(uv, size, shade, values.shape[1], dtype)
    notices = tuple(_lost_contents(contents))
    return NewTexture(contents.positions, faces, uv, space_of, pixels, charts, notices, contents.frame)


def texture_from_textures(
    document: Document,
    wanted: BakeSettings,
    progress: Progress | None = None,
) -> NewTexture:
    """Move all base colour textures to one new atlas."""
    old = document.textured("baseColor")
    pictures = [read_texture(texture) for texture in old.textures]
    texels = texels_of(old, np.array([picture.pixels.shape[1::-1] for picture in pictures]))
    made = _unwrapped(document, old.positions, old.faces, old.space_of, texels, wanted, progress)
    channels = 4 if any(picture.alpha is not None for picture in pictures) else 3
    images = [as_rgba(picture) for picture in pictures]
    dtype = np.uint8 if all(picture.stored == "uint8" for picture in pictures) else np.uint16

    def shade(owners: Int64s, weights: Float64s) -> Array:
        seen = np.ones((len(owners), 4))
        # Points outside a triangle are moved into it, since its texture shows other things there.
        inside = np.clip(weights, 0, 1)
        uv = interpolated(old.uv, owners, inside / np.maximum(inside.sum(axis=1, keepdims=True), 1))
        for index, (picture, texture) in enumerate(zip(pictures, old.textures, strict=True)):
            mine = old.texture_of[owners] == index
            values = look_up(images[index], uv[mine], texture.wrap, None if picture.alpha is None else 3)
            seen[mine] = _as_srgb(values, picture.encoding)
        return _rounded(seen[:, :channels], dtype)

    pixels = bake(made.uv, made.size, shade, channels, dtype)
    notices = _lost_of_textures(document, old, pictures)
    return NewTexture(
        old.positions, old.faces, made.uv, old.space_of, pixels, made.charts, notices, document.frame
    )


def _unwrapped(
    document: Document, positions: Float64s, faces: Int32s, space_of: Int32s | None, texels: float,
    wanted: BakeSettings, progress: Progress | None,
) -> Unwrapped:  # fmt: skip
    require_few_faces(len(faces), wanted.max_unwrap_faces, document.name)
    return unwrap(
        positions, faces, wanted.size, wanted.padding, document.name, space_of=space_of, texels=texels,
        progress=None if progress is None else partial(progress, "unwrapping"),
    )  # fmt: skip


def _kept_uv(document: Document, corners: Float64s, side: int | None) -> tuple[Float64s, tuple[int, int]]:
    """Return the document's own texture coordinates, if they do not overlap, and the texture's size."""
    surface = document.textured("baseColor")
    cause = ""
    if surface.faces.shape[0] != len(corners) or (surface.positions[surface.faces] != corners).any():
        cause = "not all of its triangles have vertex colours"
    elif len(surface.textures) > 1 or (surface.texture_of < 0).any():
        cause = "its triangles do not all show one texture"
    elif surface.uv.min() < 0 or surface.uv.max() > 1:
        cause = "its texture coordinates leave the image"
    if not cause:
        height, width = read_texture(surface.textures[0]).pixels.shape[:2]
        scale = 1.0 if side is None else side / max(width, height)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        if overlap(surface.uv, size) <= _SHARED:
            return surface.uv, size
        cause = "its charts overlap in the image"
    raise InputError(document.name, f"its texture coordinates cannot be kept: {cause}", "leave out --keep-uv")


def _vertex_values(contents: MeshContents) -> Float32s:
    colours = contents.colours
    colours = np.repeat(colours, 3, axis=1) if colours.shape[1] == 1 else colours
    if contents.alpha is None or (contents.alpha >= 1).all():
        return colours
    return np.column_stack([colours, contents.alpha])


def _depth(contents: MeshContents) -> Depth:
    """Return the type of the texture: that of the colours, or one that holds them if they are text or linear light."""
    if contents.encoding == "srgb" and contents.stored in ("uint8", "uint16"):
        return np.uint8 if contents.stored == "uint8" else np.uint16
    levels = 255 * _as_srgb(_vertex_values(contents).astype(np.float64), contents.encoding)
    return np.uint8 if np.abs(levels - np.rint(levels)).max(initial=0) < _ON_A_LEVEL else np.uint16


def _lost_contents(contents: MeshContents) -> list[str]:
    left = [*contents.left_out, *(["normals"] if contents.normals is not None else [])]
    notices = [f"Not in the new file: {'; '.join(left)}."] if left else []
    if np.any(np.diff(contents.offsets) > 3):
        notices.append("Quads and polygons are cut into triangles.")
    if contents.colours.size and (contents.colours.min() < 0 or contents.colours.max() > 1):
        notices.append("Colours outside [0, 1] are clipped.")
    return notices


def _lost_of_textured(document: Document) -> tuple[str, ...]:
    """Return what a textured model has besides triangles and the base colour."""
    mesh = document.textured_mesh()
    has_normals = mesh.corner_normals is not None or mesh.normals is not None
    found = ["texture coordinates", "textures", "materials", *(["normals"] if has_normals else [])]
    found += ["vertex colours"] if mesh.colours.size else []
    return (*found, *mesh.left_out, *document.hidden_places())


def _lost_of_textures(
    document: Document, old: TexturedSurface, pictures: list[DecodedImage]
) -> tuple[str, ...]:
    what = f"{document.format.upper()} content other than triangles and the base colour"
    notices = [f"{what} is not in the new file.", *(f"Nor are {each}." for each in document.hidden_places())]
    if bare := int((old.texture_of < 0).sum()):
        notices.append(f"{bare} triangles have no texture, and are white in the new one.")
    if any(picture.encoding == "linear" for picture in pictures):
        notices.append("Float textures become 16-bit sRGB, clipped to 0..1.")
    return tuple(notices)


def texels_of(surface: TexturedSurface, sizes: Int64s) -> float:
    """Return the total number of texels of the textured triangles."""
    is_textured = surface.texture_of >= 0
    corners = surface.uv[is_textured] * sizes[surface.texture_of[is_textured]][:, None]
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(np.abs(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0]).sum() / 2)


def as_rgba(picture: DecodedImage) -> Float32s:
    """Return a picture as red, green, blue and opacity of full scale 1."""
    values = without_alpha(picture, to_float(picture))
    colour = values[..., [*picture.colour] * (3 // len(picture.colour))]
    alpha = np.ones_like(values[..., :1]) if picture.alpha is None else values[..., [picture.alpha]]
    return np.concatenate([colour, alpha], axis=2)


def _as_srgb(values: Float64s, encoding: Encoding) -> Float64s:
    """Return colours, shape (N, 3) or (N, 4) with opacity, as display values."""
    if encoding == "srgb":
        return values
    return np.column_stack([linear_to_srgb(values[:, :3]), values[:, 3:]])


def _rounded(values: Float64s, dtype: Depth) -> Array:
    return np.rint(np.clip(values, 0, 1) * np.iinfo(dtype).max).astype(dtype)


_DEFAULTS = BakeSettings()
_INVISIBLE_STEP = (
    8 / 255
)  # a step that can hardly be seen, and that texels of several triangles' colours make anyway
_SIGMAS = 4 * np.sqrt(2)  # of the difference of two noisy values
_MEDIAN = 1.4826  # from the median magnitude to the standard deviation
_FINENESS = ("uint8", "uint16", "float16", "float32")


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
    file = begin(os.fspath(source), os.fspath(target), DEFAULTS, job, models_only=True)
    document, kind = file.document, file.format.name
    with file.watch.stage("read"):
        stem = file.reserve_new(".png" if to == "texture" else None)
    notices: tuple[str, ...]
    with file.watch.stage("bake"):
        if to == "texture":
            made = texture_from_vertices(document, settings, job.progress)
            counts = {"triangle": len(made.faces), **({} if made.charts is None else {"chart": made.charts})}
            written, notices, texture = (
                write_mesh(made.mesh(made.encoded()), kind, stem),
                made.notices,
                made.in_words,
            )
        else:
            Selection(document, DEFAULTS, file.job.access, slots=("baseColor",)).require_memory()
            contents, notices = _colours_from_textures(document)
            counts = {"coloured vertex": len(contents.positions), "triangle": len(contents.offsets) - 1}
            written, texture = write_mesh(contents, kind, stem), ""
    done = {**vars(file.write(written, notices)), "parameters": {"to": to, **dataclasses.asdict(settings)}}
    return BakeReport(**done, counts=counts, texture=texture)


def _colours_from_textures(document: Document) -> tuple[MeshContents, tuple[str, ...]]:
    """Return the base colour at every vertex."""
    # Where a seam runs through a vertex each side is looked up, and if they agree within the noise the vertex has
    # their mean. Otherwise there is a real colour edge, and the vertex stays split.
    surface = document.textured("baseColor")
    pictures = [read_texture(texture) for texture in surface.textures]
    corners, textured = surface.faces.ravel(), np.repeat(surface.texture_of >= 0, 3)
    values, noise = _corner_colours(surface, pictures)
    place = group_places(surface.positions, surface.space_of, surface.faces)[0][corners]
    uv = np.where(textured[:, None], surface.uv.reshape(-1, 2), 0.0)
    side, _ = group_equal_rows(place, np.repeat(surface.texture_of, 3), *uv.T)
    split = (_spread(values, place, textured) > _INVISIBLE_STEP + _SIGMAS * noise).any(axis=1)[place]
    vertex_of, first = group_equal_rows(place, np.where(split, side, -1))
    colours = _mean(values, vertex_of, textured, len(first))
    contents = MeshContents(
        positions=surface.positions[corners[first]],
        corners=vertex_of,
        offsets=np.arange(0, len(corners) + 1, 3, dtype=np.int64),
        colours=colours[:, :3],
        encoding=_encoding(pictures),
        stored=max((picture.stored for picture in pictures), key=_FINENESS.index),
        alpha=colours[:, 3] if any(picture.alpha is not None for picture in pictures) else None,
        left_out=_lost_of_textured(document),
        frame=document.frame,
    )
    notices, bare = [], int((~textured).sum()) // 3
    if split.any():
        notices = [f"{int(split.sum())} corners lie at real colour edges, where vertices stay split."]
    if bare:
        notices.append(f"{bare} triangles have no texture; their own vertices are white.")
    return contents, tuple(notices)


def _encoding(pictures: Sequence[DecodedImage]) -> Encoding:
    return "linear" if all(picture.encoding == "linear" for picture in pictures) else "srgb"


def _corner_colours(surface: TexturedSurface, pictures: Sequence[DecodedImage]) -> tuple[Float64s, Float64s]:
    """Return red, green, blue and alpha at every corner, white where there is no texture, and their noise."""
    texture_of = np.repeat(surface.texture_of, 3)
    uv = surface.uv.reshape(-1, 2)
    values, residues = np.ones((len(uv), 4)), np.zeros((len(uv), 4))
    common = _encoding(pictures)
    for index, picture in enumerate(pictures):
        in_texture = texture_of == index
        image, wrap = as_rgba(picture), surface.textures[index].wrap
        found = look_up(image, uv[in_texture], wrap, None if picture.alpha is None else 3)
        if picture.encoding != common:
            found[:, :3] = linear_to_srgb(found[:, :3])
        values[in_texture], residues[in_texture] = found, noise_around(image, uv[in_texture], wrap)
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
