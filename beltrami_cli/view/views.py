"""Views of a file: a coloured surface, points drawn as discs, or an image."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from PIL import Image

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, MemoryLimitError
from beltrami_cli.formats.access import Access
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import DecodedImage, read_texture, to_float, without_alpha
from beltrami_cli.formats.image.decoded_image import full_scale_one, is_associated
from beltrami_cli.formats.image.sizes import measure_image
from beltrami_cli.jobs.file_job import open_input
from beltrami_cli.jobs.progress import Progress, tracked
from beltrami_cli.layers.settings import COLOUR_SLOTS, DEFAULTS, SLOTS, SmoothSettings
from beltrami_cli.surface.colour_values import srgb_to_linear
from beltrami_cli.surface.geometry import triangle_areas, vertex_areas
from beltrami_cli.surface.grouping import connected, group_equal_rows
from beltrami_cli.surface.ranges import expanded, runs_of
from beltrami_cli.surface.records import ColouredVertices, Slot
from beltrami_cli.view.settings import RenderSettings
from beltrami_cli.view.tracing import (
    SAMPLES,
    Camera,
    InterpolatedColours,
    Sheet,
    SurfaceView,
    TextureColours,
    Window,
)

# Models beyond 2^128 or below 2^-128 are rescaled, which keeps their fourth powers within 2^256.
_MAX_EXPONENT = 128
_MAX_OUTLIER_SHARE = 0.01  # of the surface or the points, so that parts of some size are always framed
_MIN_OUTLIER_GAP = 0.5  # sizes of the rest; with smaller gaps, the rest fills at least half of the view
_RGB = ("red", "green", "blue")
_NEIGHBOURS = 4  # on a square grid, all at the same distance
_SHARE = (
    0.75  # of the distance to the farthest neighbour: a little more than half the diagonal of a grid cell
)
_MAX_RADIUS_RATIO = 3.0  # times the median radius
_LONE_RADIUS = 0.02  # radius of a point without neighbours, in widths of the view
_SMALLEST = 0.75  # radius in samples; smaller points would fall between samples
_SHEET_BYTES = 22  # of a texel: four floats, and a third more for smaller copies


class CloudView:
    """Points in linear light, as small discs that face the eye, to be looked at from anywhere."""

    def __init__(self, positions: Float64s, colours: Float64s) -> None:
        self.positions, self.faces = positions, np.zeros((0, 3), np.int32)
        self._colours = colours.astype(np.float32)
        self._radii = disc_radii(positions)

    def draw(self, camera: Camera, size: tuple[int, int], window: Window, *, lit: bool) -> Float32s:
        """Draw as `SurfaceView.draw` does, but unlit: points have no normals."""
        width, height = (side * SAMPLES for side in size)
        places, depths = camera.project(self.positions)
        share = np.array([window[2] - window[0], window[3] - window[1]])
        at = (places - window[:2]) / share * (width, height)
        radii = self._radii / camera.breadth(depths) / share[0] * width
        radii[self._radii == 0] = _LONE_RADIUS * width
        radii = np.maximum(radii, _SMALLEST)
        near = (depths > 0) & (at > -radii[:, None]).all(axis=1)
        near &= (at < np.array([width, height]) + radii[:, None]).all(axis=1)
        chosen = np.flatnonzero(near)
        # Farthest first, so that the nearest is written last and stays.
        chosen = chosen[np.lexsort((chosen, -depths[chosen]))]
        image = _discs(at[chosen], radii[chosen], self._colours[chosen], (width, height))
        return np.asarray(image.reshape(size[1], SAMPLES, size[0], SAMPLES, 4).mean(axis=(1, 3)), np.float32)


class ImageView:
    """An image, which looks the same from all directions."""

    def __init__(self, sheet: Sheet) -> None:
        self._sheet = sheet
        sheet[..., :3] *= sheet[..., 3:]

    def draw(self, size: tuple[int, int], window: Window) -> Float32s:
        """Draw a window of a view; the image fits into the view, with its proportions; see `SurfaceView.draw`."""
        shape, begin, end = np.array(self._sheet.shape[1::-1]), np.array(window[:2]), np.array(window[2:])
        view = np.array(size) / (end - begin)
        scale = (view / shape).min()
        shift = begin * view - np.round((view - shape * scale) / 2)  # of the drawing on the enlarged image
        first = np.clip(np.round(-shift), 0, size).astype(int)
        last = np.clip(np.round(shape * scale - shift), first, size).astype(int)
        drawn = np.zeros((size[1], size[0], 4), np.float32)
        if (first < last).all():
            box = np.clip(np.concatenate([first + shift, last + shift]) / scale, 0, np.tile(shape, 2))
            # Means of some places in each pixel, which see squares, so that single pixels can be judged, or areas.
            places = tuple(SAMPLES * (last - first))
            for channel in range(4):
                plane = Image.fromarray(self._sheet[..., channel])
                part = plane.resize(places, Image.Resampling.BOX, box=tuple(box)).reduce(SAMPLES)
                drawn[first[1] : last[1], first[0] : last[0], channel] = np.asarray(part)
        return drawn


Drawable = SurfaceView | CloudView | ImageView


def open_views(
    sources: Sequence[str],
    settings: RenderSettings,
    access: Access,
    reading: SmoothSettings = DEFAULTS,
    progress: Progress | None = None,
) -> list[Drawable]:
    """Read files, or "-" for standard input, as views; `reading`: how level sets are read."""
    documents = [open_input(source, reading, access) for source in sources]
    require_memory_to_draw(documents, settings, access)
    return [view_of(document, settings) for document in tracked(documents, "reading", progress)]


def require_memory_to_draw(
    documents: Sequence[Document], settings: RenderSettings, access: Access, remedy: str = ""
) -> None:
    """Raise InputError if the visible images of documents do not fit into memory together, before any is decoded."""
    if access.memory is None:
        return
    texels = largest = 0
    for document in documents:
        for data, name in image_files(document, () if settings.on == "vertices" else (settings.slot,)):
            size = measure_image(data, name)
            if size is not None:  # otherwise the decoder reports the error
                texels, largest = texels + size.texels, max(largest, size.decoded)
        if _SHEET_BYTES * texels + largest > access.memory:
            cause = f"{texels / 1e6:.3g} million texels do not fit into memory to be drawn"
            raise MemoryLimitError(document.name, cause, f"raise --max-memory{remedy}")


def view_of(document: Document, settings: RenderSettings) -> Drawable:
    """Return the view of an image, or else of the textures, the vertex colours or the points of a document."""
    if document.kind == "image":
        return ImageView(sheet_of(document.image()))
    slot: Slot = settings.slot  # type: ignore[assignment]
    has_texture = slot in document.slots()
    if has_texture and settings.on == "auto":
        has_texture = bool(document.readable([slot]))
    if settings.on == "texture" and not has_texture:
        raise InputError(document.name, f"it has no {slot} texture", "leave out --show")
    if has_texture and settings.on != "vertices":
        surface = document.textured(slot)
        is_data = slot not in COLOUR_SLOTS
        sheets = [sheet_of(read_texture(texture), is_data=is_data) for texture in surface.textures]
        positions = within_reach(surface.positions)
        areas = triangle_areas(positions, surface.faces)
        return SurfaceView(positions, surface.faces, TextureColours(surface, sheets, areas))
    vertices = document.coloured_vertices()
    light, finite = light_of(vertices), np.isfinite(vertices.positions).all(axis=1)
    positions = within_reach(vertices.positions)
    if len(vertices.faces):
        return SurfaceView(positions, vertices.faces, InterpolatedColours(vertices.faces, light))
    return CloudView(positions[finite], light[finite])


def image_files(document: Document, slots: Collection[str] = SLOTS) -> list[tuple[bytes, str]]:
    """Return the image files of a document, with their names; of a model, the textures of some slots."""
    if document.kind == "image":
        return [(document.data, document.name)]
    readable = document.readable(slot for slot in document.slots() if slot in slots)
    textures = [texture for slot in readable for texture in document.textured(slot).textures]
    return [(texture.data, texture.name) for texture in textures]


def sheet_of(picture: DecodedImage, *, is_data: bool = False) -> Float32s:
    """Return an image in linear light with opacity, (H, W, 4); data are shown as if they were display values."""
    channels = picture.colour if len(picture.colour) == 3 else picture.colour[:1] * 3
    pixels = picture.pixels
    if pixels.dtype.kind == "u" and not is_associated(picture):
        # Each level of integers is turned into linear light once.
        levels = full_scale_one(np.arange(np.iinfo(pixels.dtype).max + 1, dtype=pixels.dtype))
        light = srgb_to_linear(levels).astype(np.float32)
        sheet = np.ones((*pixels.shape[:2], 4), np.float32)
        for number, channel in enumerate(channels):
            sheet[..., number] = light.take(pixels[..., channel])
        if picture.alpha is not None:
            sheet[..., 3] = levels.take(pixels[..., picture.alpha])
        return sheet
    # Floats are clipped to the visible range, and transparent if not finite.
    values = to_float(picture) if is_data else without_alpha(picture, to_float(picture))
    colours = values[..., channels]
    seen = np.isfinite(colours).all(axis=2, keepdims=True)
    colours = np.clip(np.where(seen, colours, 0), 0, 1)
    light = srgb_to_linear(colours) if picture.encoding == "srgb" or is_data else colours
    opacity = np.clip(values[..., picture.alpha], 0, 1)[..., None] if picture.alpha is not None else 1.0
    opacity = np.where(seen, opacity, 0).astype(np.float32)
    return np.concatenate([light, np.nan_to_num(opacity)], axis=2).astype(np.float32)


def light_of(vertices: ColouredVertices) -> Float64s:
    """Return vertex colours in linear light, (V, 3); channels other than red, green and blue are shown as grey."""
    is_rgb = set(_RGB) <= set(vertices.channels)
    chosen = [vertices.channels.index(name) for name in _RGB] if is_rgb else [0, 0, 0]
    colours = np.clip(vertices.colours[:, chosen].astype(np.float64), 0, 1)
    return np.asarray(srgb_to_linear(colours) if vertices.encoding == "srgb" else colours, np.float64)


def within_reach(positions: Float64s) -> Float64s:
    """Return positions, scaled by a power of two if squares of areas would overflow or underflow."""
    largest = np.max(np.abs(positions), where=np.isfinite(positions), initial=0.0)
    exponent = np.frexp(largest)[1]
    if abs(exponent) < _MAX_EXPONENT:
        return positions
    return np.asarray(np.ldexp(positions, -_MAX_EXPONENT * round(exponent / _MAX_EXPONENT)), np.float64)


def framed(positions: Float64s, faces: Int32s) -> Float64s:
    """Return the finite positions that views are framed by: without outliers, which are parts far from the rest."""
    places = within_reach(positions)
    is_finite = np.isfinite(places).all(axis=1)
    weights = vertex_areas(places, faces).astype(np.float64) if len(faces) else np.ones(len(places))
    weights[~(is_finite & np.isfinite(weights))] = 0
    if not weights.any():
        return np.asarray(positions[is_finite])
    ends = [_MAX_OUTLIER_SHARE / 2, 1 - _MAX_OUTLIER_SHARE / 2]
    known, shares = places[is_finite], weights[is_finite]
    low, high = np.transpose(
        [np.quantile(axis, ends, weights=shares, method="inverted_cdf") for axis in known.T]
    )
    reach = _MIN_OUTLIER_GAP * (high - low).max()
    is_near = is_finite & ((places >= low - reach) & (places <= high + reach)).all(axis=1)
    if (
        len(faces) and not is_near.all()
    ):  # parts that are connected to the rest, at places of vertices, are framed
        place_of, _ = group_equal_rows(*np.nan_to_num(places).T)
        corners = place_of[faces]
        part_of = connected(len(places), np.concatenate([corners[:, :2], corners[:, 1:]]))[place_of]
        is_near = is_finite & np.isin(part_of, part_of[is_near & (weights > 0)])
    return np.asarray(positions[is_near])


def disc_radii(positions: Float64s) -> Float64s:
    """Return the radius of each disc, so that neighbours leave no holes in a surface; 0 for a single place."""
    from scipy.spatial import cKDTree

    places, which = np.unique(positions, axis=0, return_inverse=True)
    if len(places) < 2:
        return np.zeros(len(positions))
    found: Float64s = np.asarray(cKDTree(places).query(places, k=min(_NEIGHBOURS + 1, len(places)))[0])
    radii = _SHARE * found[:, -1]
    # Points far from all others would hide the points around them.
    limited = np.minimum(radii, _MAX_RADIUS_RATIO * np.median(radii))
    return np.asarray(limited[which.reshape(-1)], np.float64)


def _discs(at: Float64s, radii: Float64s, colours: Float32s, size: tuple[int, int]) -> Float32s:
    """Return discs drawn over each other, (height, width, 4); later ones are nearer and hide earlier ones."""
    width, height = size
    front = np.full(height * width, -1, np.int64)  # index of the visible disc
    first, heights = _cells(at[:, 1], radii, height)
    for block in runs_of(heights):
        row, disc = expanded(first[block], heights[block])
        disc += block.start
        half = np.sqrt(np.maximum(radii[disc] ** 2 - (row + 0.5 - at[disc, 1]) ** 2, 0))
        left, widths = _cells(at[disc, 0], half, width)
        for run in runs_of(widths):
            column, span = expanded(left[run], widths[run])
            front[row[run][span] * width + column] = disc[run][span]  # the last one stays
    image = np.zeros((height * width, 4), np.float32)
    filled = front >= 0
    image[filled, :3] = colours[front[filled]]
    image[filled, 3] = 1
    return image.reshape(height, width, 4)


def _cells(middles: Float64s, reach: Float64s, count: int) -> tuple[Int64s, Int64s]:
    """Return the first of `count` cells whose centres are within reach of each place, and their number."""
    first = np.clip(np.ceil(middles - reach - 0.5), 0, count).astype(np.int64)
    end = np.clip(np.floor(middles + reach + 0.5), 0, count).astype(np.int64)
    return first, np.maximum(end - first, 0)
