"""What was painted before and after on one model, packed for the viewer of pages: triangles, colours and images."""

from __future__ import annotations

import base64
import hashlib
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from beltrami_cli.formats.image.picture import is_associated
from beltrami_cli.surface.colour_values import VIRIDIS, linear_to_srgb
from beltrami_cli.surface.grouping import distinct_corners, group_places
from beltrami_cli.surface.records import Texture
from beltrami_cli.view.pages import data_address
from beltrami_cli.view.views import disc_radii, light_of, sheet_of, texture_sheet

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from beltrami_cli.arrays import Array, Bools, Float32s, Float64s, Int32s, Int64s, Uint8s
    from beltrami_cli.formats.document import Document
    from beltrami_cli.formats.image import Picture
    from beltrami_cli.formats.image.document import ImageDocument
    from beltrami_cli.surface.records import PaintedVertices, Slot, TexturedSurface

    Pair = tuple[Document, Document]

_MIME = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg"}
_FULL = 65535
_LEAST_REACH, _MOST_REACH = 4, 128  # 255ths of full scale
VERTICES = "vertex colours"


class ModelPacker:
    """Collects the layers of a model: the textures of a slot each, the vertex colours, or an image."""

    def __init__(self) -> None:
        self._buffers: dict[str, str] = {}
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
        box = _Box(surface.positions)
        chart_of, seams = charts_of(surface)
        parts = []
        for number in np.unique(surface.texture_of).tolist():
            mine = surface.texture_of == number
            pair = None if number < 0 else [side[number] for side in numbers]
            borders = seams[mine[seams[:, 0]]]
            parts.append(self._part(surface, box, mine, chart_of[mine], pair, borders))
        edges = box.places(_ends(surface.positions[surface.faces], seams))
        self._layers.append(
            {
                "name": f"{slot} textures", "slot": slot, "parts": parts, "middle": box.middle,
                "numbers": numbers[0], "seams": self._steps(edges) if len(edges) else None,
            }
        )  # fmt: skip

    def add_image(self, documents: tuple[ImageDocument, ImageDocument]) -> None:
        """Add two images as flat textures."""
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
            "buffers": self._buffers,
            "textures": self._textures,
            "layers": self._layers,
            "scale": VIRIDIS.tolist(),
            "reach": int(np.clip(np.ceil(round(reach, 2)), _LEAST_REACH, _MOST_REACH)),
        }

    def texture(self, texture: Texture, slot: Slot, sheet: Float32s | None = None) -> int:
        """Add a texture once; return its number."""
        source = source_of(texture, slot, sheet)
        key = f"{source} {texture.wrap} {texture.alpha_hides}"
        if key not in self._number_of:
            self._number_of[key] = len(self._textures)
            described = {"source": source, "wrap": texture.wrap, "hides": texture.alpha_hides}
            self._textures.append(described)
        return self._number_of[key]

    def _painted(self, one: PaintedVertices, other: PaintedVertices) -> None:
        finite = np.isfinite(one.positions).all(axis=1) & np.isfinite(other.positions).all(axis=1)
        rows = slice(None) if len(one.faces) else finite
        box = _Box(one.positions[finite])
        part: dict[str, Any] = {
            "kind": "mesh" if len(one.faces) else "points",
            "position": self._steps(box.places(one.positions[rows])),
            "colours": [self._kept(displayed_colours(each)[rows]) for each in (one, other)],
        }
        if len(one.faces):
            part["index"] = self._steps(one.faces.astype(np.uint32))
        else:
            part["size"] = 2 * float(np.median(disc_radii(one.positions[finite]))) / box.size
        if not np.array_equal(one.positions, other.positions):
            part["moved"] = self._steps(box.places(other.positions[rows]))
        self._layers.append({"name": VERTICES, "parts": [part], "middle": box.middle})

    def _part(
        self,
        surface: TexturedSurface,
        box: _Box,
        mine: Bools,
        chart_of: Int32s,
        textures: list[int] | None,
        borders: Int64s,
    ) -> dict[str, Any]:
        """Return the triangles of one texture, with a vertex for each place, texture coordinate and chart."""
        corners, uv = surface.faces[mine].reshape(-1), surface.uv[mine].reshape(-1, 2).astype(np.float32)
        charts = np.repeat(chart_of, 3)
        rows, index = distinct_corners(corners, np.nan_to_num(uv[:, 0]), np.nan_to_num(uv[:, 1]), charts)
        part = {
            "kind": "mesh", "position": self._steps(box.places(surface.positions[corners[rows]])),
            "index": self._steps(index.reshape(-1, 3).astype(np.uint32)), "textures": textures,
        }  # fmt: skip
        if textures is not None:
            part["uv"] = self._kept(uv[rows])
            part["charts"] = self._kept(charts[rows].astype(np.uint16))
            part["borders"] = self._kept(_ends(surface.uv, borders).astype(np.float32))
        return part

    def _steps(self, rows: NDArray[np.unsignedinteger[Any]]) -> str:
        """Keep the differences between rows, column by column, which take a fraction of the space."""
        before = np.concatenate([np.zeros_like(rows[:1]), rows[:-1]])
        return self._kept((rows - before).T)

    def _kept(self, values: Array) -> str:
        packed = packed_array(values)
        key = hashlib.sha256(packed.encode()).hexdigest()[:16]
        self._buffers[key] = packed
        return key


class _Box:
    """The box around a model, whose longest side becomes 1."""

    def __init__(self, positions: Float64s) -> None:
        positions = positions[np.isfinite(positions).all(axis=1)]
        self._low, high = positions.min(axis=0), positions.max(axis=0)
        self.size = max(float((high - self._low).max()), np.finfo(float).tiny)
        self.middle = ((high - self._low) / self.size / 2).tolist()

    def places(self, positions: Float64s) -> NDArray[np.uint16]:
        """Return positions in the box in 16 bits each."""
        share = np.nan_to_num((positions - self._low) / self.size)
        return np.asarray(np.rint(_FULL * np.clip(share, 0, 1)), np.uint16)


def source_of(texture: Texture, slot: Slot, sheet: Float32s | None = None) -> str:
    """Return a data URL of a texture, as it is if browsers show its format, or else as PNG."""
    mime = next((mime for mark, mime in _MIME.items() if texture.data.startswith(mark)), None)
    if mime is not None:
        return f"data:{mime};base64,{base64.b64encode(texture.data).decode()}"
    return data_address(_as_bytes(texture_sheet(texture, slot) if sheet is None else sheet))


def displayed_pixels(picture: Picture, *, is_data: bool = False) -> Uint8s:
    """Return a picture as display values with opacity, (H, W, 4)."""
    pixels = picture.pixels
    if pixels.dtype != np.uint8 or is_associated(picture):
        return _as_bytes(sheet_of(picture, is_data=is_data))
    shown = np.full((*pixels.shape[:2], 4), 255, np.uint8)
    shown[..., :3] = pixels[..., picture.colour if len(picture.colour) == 3 else picture.colour[:1] * 3]
    if picture.alpha is not None:
        shown[..., 3] = pixels[..., picture.alpha]
    return shown


def _as_bytes(sheet: Float32s) -> Uint8s:
    shown = np.concatenate([linear_to_srgb(sheet[..., :3]), sheet[..., 3:]], axis=2)
    return np.asarray(np.rint(255 * shown), np.uint8)


def packed_array(values: Array, level: int = -1) -> str:
    """Return the bytes of an array for a page, compressed."""
    data = np.ascontiguousarray(values.astype(values.dtype.newbyteorder("<"))).tobytes()
    return base64.b64encode(zlib.compress(data, level)).decode()


def displayed_colours(painted: PaintedVertices) -> NDArray[np.uint16]:
    """Return vertex colours as display values of 16 bits, (V, 3)."""
    return np.asarray(np.rint(_FULL * linear_to_srgb(light_of(painted))), np.uint16)


def charts_of(surface: TexturedSurface) -> tuple[Int32s, Int64s]:
    """Return the chart of each triangle, and the seams, (K, 2), as triangles and the corners they begin at."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(surface.faces)
    place_of, _ = group_places(surface.positions, surface.space_of)
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
