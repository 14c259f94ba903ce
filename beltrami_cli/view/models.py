"""What was painted before and after on one model, packed for the viewer of pages: triangles, colours and images.

Tables of whole numbers take little space [1]_: vertices are sorted so that those of a triangle are near in the order
[2]_, of each number the difference from the mean of earlier neighbours is kept, and bytes of one rank lie together.
The script unpacking.js restores them.

References
----------
.. [1] M. Deering, "Geometry compression", SIGGRAPH 1995. https://doi.org/10.1145/218380.218391
.. [2] E. Cuthill, J. McKee, "Reducing the bandwidth of sparse symmetric matrices", ACM 1969.
   https://doi.org/10.1145/800195.805928
"""

from __future__ import annotations

import base64
import hashlib
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from beltrami_cli.arrays import Array, Float32s, Float64s, Int32s, Int64s, Uint8s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.image import Picture
from beltrami_cli.formats.image.picture import is_associated
from beltrami_cli.formats.image.reading import measure_image
from beltrami_cli.surface.colour_values import VIRIDIS, as_bytes, linear_to_srgb
from beltrami_cli.surface.grouping import group_equal_rows, group_places
from beltrami_cli.surface.records import PaintedVertices, Slot, Texture, TexturedSurface
from beltrami_cli.view.pages import data_address
from beltrami_cli.view.views import disc_radii, light_of, sheet_of, texture_sheet

Pair = tuple[Document, Document]

_MIME = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_FULL = 65535
_BYTE = 257  # of 16 bits, one of 8
_PARTS_OF_TEXEL = 16  # to which texture coordinates are rounded
_UNKNOWN_SIDE = 4096  # texels, of textures whose size is not known
_FARTHEST = (1 << 30) - 1
_LEAST_REACH, _MOST_REACH = 4, 128  # 255ths of full scale
VERTICES = "vertex colours"
_THOROUGH = 9  # of zlib


class ModelPacker:
    """Collects the layers of a model: the textures of a slot each, the vertex colours, or an image."""

    def __init__(self) -> None:
        self._buffers: dict[str, dict[str, Any]] = {}
        self.row_of: Int64s | None = None  # of vertices, on the page; -1: it has not those
        self._textures: list[dict[str, Any]] = []
        self._number_of: dict[str, int] = {}
        self._layers: list[dict[str, Any]] = []

    def add(self, documents: Pair, slot: Slot | None) -> None:
        """Add the textures of a slot, or the vertex colours, of two documents that differ in colours."""
        if slot is None:
            self._painted(*(document.painted() for document in documents))
            return
        surface, other = (document.textured(slot) for document in documents)
        numbers = [[self.texture(each, slot) for each in both.textures] for both in (surface, other)]
        box = Box(surface.positions)
        chart_of, seams = charts_of(surface)
        parts = []
        for number in np.unique(surface.texture_of).tolist():
            pair = None if number < 0 else [side[number] for side in numbers]
            borders = seams[surface.texture_of[seams[:, 0]] == number]
            parts.append(self._part(surface, box, number, chart_of, pair, borders))
        edges = box.places(_ends(surface.positions[surface.faces], seams))
        self._layers.append(
            {
                "name": f"{slot} textures", "slot": slot, "parts": parts, "middle": box.middle,
                "numbers": numbers[0], "seams": self._table(edges) if len(edges) else None,
            }
        )  # fmt: skip

    def add_image(self, documents: tuple[Document, Document]) -> None:
        numbers = [
            self.texture(Texture("", each.name, each.data), "baseColor", sheet_of(each.picture()))
            for each in documents
        ]
        sheet = {"kind": "sheet", "textures": numbers}
        self._layers.append(
            {"name": "image", "flatOnly": True, "numbers": numbers[:1], "parts": [sheet], "middle": [0, 0, 0]}
        )

    def packed(self, reach: float) -> dict[str, Any]:
        """Return everything in JSON types; `reach`: the change in 255ths that is shown brightest."""
        return {
            "buffers": self._buffers, "textures": self._textures, "layers": self._layers,
            "scale": VIRIDIS.tolist(),
            "reach": int(np.clip(np.ceil(round(reach, 2)), _LEAST_REACH, _MOST_REACH)),
        }  # fmt: skip

    def texture(self, texture: Texture, slot: Slot, sheet: Float32s | None = None) -> int:
        source = source_of(texture, slot, sheet)
        key = f"{source} {texture.wrap} {texture.alpha_hides}"
        if key not in self._number_of:
            self._number_of[key] = len(self._textures)
            self._textures.append({"source": source, "wrap": texture.wrap, "hides": texture.alpha_hides})
        return self._number_of[key]

    def _painted(self, one: PaintedVertices, other: PaintedVertices) -> None:
        finite = np.asarray(np.isfinite(np.hstack([one.positions, other.positions])).all(axis=1))
        box, part = Box(one.positions[finite]), dict[str, Any]()
        if len(one.faces):
            rows, index = _sorted(one.faces, len(finite))
            part |= {"kind": "mesh", "index": self._triangles(index)}
        else:
            rows, index = np.flatnonzero(finite), None
            radius = float(np.median(disc_radii(one.positions[finite])))
            part |= {"kind": "points", "size": 2 * radius / box.size}
        self.row_of = np.full(len(finite), -1, np.int64)
        self.row_of[rows] = np.arange(len(rows))
        colours = [displayed_colours(each)[rows] for each in (one, other)]
        depth = _BYTE if not any((each % _BYTE).any() for each in colours) else 1
        part |= {
            "position": self._table(box.places(one.positions[rows]), index), "depth": depth,
            "colours": [self._table(each // depth, index) for each in colours],
        }  # fmt: skip
        if not np.array_equal(one.positions, other.positions):
            part["moved"] = self._table(box.places(other.positions[rows]), index)
        self._layers.append({"name": VERTICES, "parts": [part], "middle": box.middle})

    def _part(
        self, surface: TexturedSurface, box: Box, number: int, chart_of: Int32s, textures: list[int] | None,
        borders: Int64s,
    ) -> dict[str, Any]:  # fmt: skip
        """Return the triangles of one texture, with a vertex for each place, texture coordinate and chart."""
        mine = surface.texture_of == number
        corners, uv = surface.faces[mine].reshape(-1), surface.uv[mine].reshape(-1, 2).astype(np.float32)
        charts = np.repeat(chart_of[mine], 3)
        vertex_of, rows = group_equal_rows(corners, *np.nan_to_num(uv).T, charts)
        order, index = _sorted(vertex_of.reshape(-1, 3), len(rows))
        rows = rows[order]
        part = {
            "kind": "mesh", "index": self._triangles(index), "textures": textures,
            "position": self._table(box.places(surface.positions[corners[rows]]), index),
        }  # fmt: skip
        if textures is not None:
            size = measure_image(surface.textures[number].data)
            sides = (_UNKNOWN_SIDE,) * 2 if size is None else (size.width, size.height)
            steps = _PARTS_OF_TEXEL * np.array(sides)
            part["steps"] = steps.tolist()
            part["uv"] = self._table(_rounded(uv[rows], steps), index)
            part["charts"] = self._table(charts[rows, None], index)
            part["borders"] = self._table(_rounded(_ends(surface.uv, borders), steps))
        return part

    def _triangles(self, index: Int64s) -> str:
        """Keep triangles: of the second and third vertex, how far they are from the first in the order."""
        return self._table(np.column_stack([index[:, 0], index[:, 1:] - index[:, :1]]))

    def _table(self, rows: Array, index: Int64s | None = None) -> str:
        """Keep whole numbers, shape (K, C), less the mean of earlier rows in triangles with them, or the row before."""
        rows = rows.astype(np.int64)
        left = rows - _predicted(rows, index)
        unsigned = np.where(left < 0, -2 * left - 1, 2 * left).T
        most = int(unsigned.max(initial=0))
        kind = next(kind for kind in (np.uint8, np.uint16, np.uint32) if most <= np.iinfo(kind).max)
        split = unsigned.astype(np.dtype(kind).newbyteorder("<"))[..., None].view(np.uint8)
        packed = packed_array(split.transpose(0, 2, 1), _THOROUGH)
        key = hashlib.sha256(packed.encode()).hexdigest()[:16]
        self._buffers[key] = {"data": packed, "columns": rows.shape[1], "bytes": split.shape[2]}
        return key


class Box:
    """The box around a model, whose longest side becomes 1."""

    def __init__(self, positions: Float64s) -> None:
        positions = positions[np.isfinite(positions).all(axis=1)]
        self.low, high = positions.min(axis=0), positions.max(axis=0)
        self.size = max(float((high - self.low).max()), np.finfo(float).tiny)
        self.middle = ((high - self.low) / self.size / 2).tolist()

    def places(self, positions: Float64s) -> NDArray[np.uint16]:
        """Return positions in the box in 16 bits each."""
        share = np.nan_to_num((positions - self.low) / self.size)
        return np.asarray(np.rint(_FULL * np.clip(share, 0, 1)), np.uint16)


def _sorted(faces: NDArray[np.integer[Any]], count: int) -> tuple[Int64s, Int64s]:
    """Return vertices in an order in which neighbours are near, and the triangles of these, in order, too."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([sides, sides[:, ::-1]]).T
    graph = coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), (count, count)).tocsr()
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    number = np.empty(count, np.int64)
    number[order] = np.arange(count)
    index = number[faces]
    index = np.take_along_axis(index, (index.argmin(axis=1)[:, None] + np.arange(3)) % 3, 1)
    return order, index[np.lexsort((index[:, 1], index[:, 0]))]


def _predicted(rows: Int64s, index: Int64s | None) -> Int64s:
    """Return for each row the mean of those before it that are in triangles with it, or else the one before."""
    before = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
    if index is None:
        return before
    sides = np.sort(np.concatenate([index[:, [0, 1]], index[:, [1, 2]], index[:, [2, 0]]]), axis=1)
    sides = sides[sides[:, 0] < sides[:, 1]]
    counts = np.bincount(sides[:, 1], minlength=len(rows))
    sums = [np.bincount(sides[:, 1], column[sides[:, 0]], len(rows)) for column in rows.T]
    means = np.floor(np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None])
    return np.asarray(np.where(counts[:, None] > 0, means, before), np.int64)


def _rounded(uv: NDArray[np.floating[Any]], steps: Int64s) -> Int64s:
    """Return texture coordinates in steps of a small part of a texel."""
    near = np.clip(np.nan_to_num(uv * steps.astype(np.float64)), -_FARTHEST, _FARTHEST)
    return np.asarray(np.rint(near), np.int64)


def source_of(texture: Texture, slot: Slot, sheet: Float32s | None = None) -> str:
    """Return a data URL of a texture, as it is if browsers show its format, or else as PNG."""
    mime = next((mime for mark, mime in _MIME.items() if texture.data.startswith(mark)), None)
    if mime is not None:
        return f"data:{mime};base64,{base64.b64encode(texture.data).decode()}"
    return data_address(_as_bytes(texture_sheet(texture, slot) if sheet is None else sheet))


def displayed_pixels(picture: Picture) -> Uint8s:
    """Return a picture as display values with opacity, (H, W, 4)."""
    pixels = picture.pixels
    if pixels.dtype != np.uint8 or is_associated(picture):
        return _as_bytes(sheet_of(picture))
    shown = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    shown[..., :3] = pixels[..., picture.colour if len(picture.colour) == 3 else picture.colour[:1] * 3]
    if picture.alpha is not None:
        shown[..., 3] = pixels[..., picture.alpha]
    return shown


def _as_bytes(sheet: Float32s) -> Uint8s:
    return as_bytes(np.concatenate([linear_to_srgb(sheet[..., :3]), sheet[..., 3:]], axis=2))


def packed_array(values: Array, level: int) -> str:
    """Return the bytes of an array for a page, compressed."""
    data = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()
    return base64.b64encode(zlib.compress(data, level)).decode()


def displayed_colours(painted: PaintedVertices) -> NDArray[np.uint16]:
    """Return vertex colours as display values of 16 bits, (V, 3)."""
    return np.asarray(np.rint(_FULL * linear_to_srgb(light_of(painted))), np.uint16)


def charts_of(surface: TexturedSurface) -> tuple[Int32s, Int64s]:
    """Return the chart of each triangle, and the seams, (K, 2), as triangles and the corners they begin at."""
    count = len(surface.faces)
    place_of, _ = group_places(surface.positions, surface.space_of, surface.faces)
    starts = place_of[surface.faces]
    ends = np.roll(starts, -1, axis=1)
    uv = np.stack([surface.uv, np.roll(surface.uv, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    turned = (starts > ends).reshape(-1)
    uv[turned] = uv[turned, ::-1]
    low, high = np.minimum(starts, ends).reshape(-1), np.maximum(starts, ends).reshape(-1)
    order = np.lexsort((high, low))
    alike = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    here, there = order[:-1][alike], order[1:][alike]
    same = surface.texture_of[here // 3] == surface.texture_of[there // 3]
    same &= (uv[here] == uv[there]).all(axis=(1, 2))
    joined = coo_array((np.ones(int(same.sum())), (here[same] // 3, there[same] // 3)), (count, count))
    cut = np.concatenate([here[~same], there[~same]])
    cut = cut[surface.texture_of[cut // 3] >= 0]
    return connected_components(joined, directed=False)[1], np.stack([cut // 3, cut % 3], axis=1)


def _ends(corners: Float64s, edges: Int64s) -> Float64s:
    """Return both ends of edges that begin at corners of triangles, (2 K, X)."""
    face, corner = edges.T
    pairs = np.stack([corners[face, corner], corners[face, (corner + 1) % 3]], axis=1)
    return np.asarray(pairs.reshape(-1, corners.shape[2]), np.float64)
