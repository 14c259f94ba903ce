"""The colours before and after of one model, as one binary glTF file for the viewer of pages.

Each layer is a scene, with its triangles, points or lines in a box of size 1. Vertex colours are display values in the
attributes _BEFORE and _AFTER; `extras` name both textures of a part, and whether opacity hides it.

Vertices are sorted so that the corners of a triangle are close in the file [1]_. Pages keep differences of
neighbouring elements, which compress well.

References
----------
.. [1] E. Cuthill, J. McKee, "Reducing the bandwidth of sparse symmetric matrices", ACM 1969.
   https://doi.org/10.1145/800195.805928
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from beltrami_cli.arrays import Array, Float64s, Int32s, Int64s
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.gltf.buffers import INDEX_DATA
from beltrami_cli.formats.gltf.container import BIN_CHUNK, JSON_CHUNK, Chunk, glb_pieces
from beltrami_cli.formats.gltf.images import WRAPS
from beltrami_cli.formats.gltf.writer import Arrays
from beltrami_cli.surface.colour_map import VIRIDIS
from beltrami_cli.surface.geometry import edges_of
from beltrami_cli.surface.grouping import connected, group_equal_rows, group_places
from beltrami_cli.surface.records import ColouredVertices, Slot, Texture, TexturedSurface
from beltrami_cli.view.drawing.cameras import framed
from beltrami_cli.view.drawing.cloud_view import disc_radii
from beltrami_cli.view.light import displayed_colours
from beltrami_cli.view.pages.images import ImageBytes, image_of, resized, textures_of
from beltrami_cli.view.pages.rendering import packed_array

Pair = tuple[Document, Document]

VERTICES = "vertex colours"
_TRIANGLES, _POINTS, _LINES = 4, 0, 1  # modes of glTF primitives
_FULL_SCALE = 65535
_MAX_DISTANCE = 1e9  # sizes of the model or texture, beyond which nothing is visible
_BYTE = 257  # 16-bit value of one 8-bit step
_MIN_PICTURES = 1 << 20  # bytes of pictures, however large the meshes are
_FILLED = 0.99  # target share of the space for pictures: PNG adds at most 1 %
_MIN_SHARE = 1e-4  # of the width of pictures: 10,000 pixels become one
_MIN_REACH, _MAX_REACH = 4, 128  # 255ths of full scale


class Box:
    """The bounding box of a model without outliers, whose longest side becomes 1."""

    def __init__(self, model: ColouredVertices | TexturedSurface) -> None:
        positions = framed(model.positions, model.faces)
        self.low, high = positions.min(axis=0), positions.max(axis=0)
        self.size = max(float((high - self.low).max()), np.finfo(float).tiny)
        self.middle = ((high - self.low) / self.size / 2).tolist()

    def shares(self, positions: Float64s) -> Float64s:
        """Return positions in units of the box, 0 where they are not finite."""
        return _finite((positions - self.low) / self.size)


@dataclass(frozen=True)
class Placement:
    """Where the positions of a layer went in the file."""

    box: Box
    row_of: Int64s | None = None  # row of each vertex; -1: omitted; None: a layer of textures


class ModelWriter:
    """Collects the layers of a model, and then writes it once, by `glb` or by `packed`."""

    def __init__(self, *, is_live: bool = False) -> None:
        self._is_live = is_live  # colours will change to arbitrary 16-bit values
        self._arrays = Arrays()
        self._tree: dict[str, list[Any]] = {name: [] for name in ("scenes", "nodes", "meshes")}
        self._textures: dict[Any, int] = {}
        self._images: list[Callable[[], ImageBytes]] = []

    def add(self, documents: Pair, slot: Slot | None) -> Placement | None:
        """Add the textures of a slot, the vertex colours, or the image of two documents that differ in colours.

        Return where positions went; None for images.
        """
        if documents[0].kind == "image":
            self._add_images(documents)
            return None
        if slot is None:
            return self._add_vertices(*(document.coloured_vertices() for document in documents))
        return self._add_textures(documents, slot)

    def _add_images(self, documents: Pair) -> None:
        images = [
            self._texture(texture, partial(image_of, texture, "baseColor", each.image))
            for each in documents
            for texture in textures_of(each, None)
        ]
        self._scene("image", [], middle=[0, 0, 0], pairs=[images], flatOnly=True)

    def _add_textures(self, documents: Pair, slot: Slot) -> Placement:
        surface, other = (document.textured(slot) for document in documents)
        pairs = [
            [self._texture(each, partial(image_of, each, slot)) for each in both]
            for both in zip(surface.textures, other.textures, strict=True)
        ]
        box, (chart_of, seams) = Box(surface), _charts_of(surface)
        nodes = []
        for number in np.unique(surface.texture_of).tolist():
            pair = None if number < 0 else pairs[number]
            nodes.append(self._part(surface, box, number, chart_of, pair))
            borders = seams[surface.texture_of[seams[:, 0]] == number]
            if pair is not None and len(borders):
                uv = _finite(_ends_of(surface.uv, borders)) * (1, -1) + (-0.5, 0.5)
                flat = self._arrays.add(
                    np.column_stack([uv, np.full(len(uv), 0.002)]).astype("<f4"), bounds=True
                )
                nodes.append(self._node({"POSITION": flat}, _LINES, {"textures": pair}))
        if len(seams):
            ends = self._positions(box.shares(_ends_of(surface.positions[surface.faces], seams)))
            nodes.append(self._node({"POSITION": ends}, _LINES, {}))
        self._scene(f"{slot} textures", nodes, middle=box.middle, pairs=pairs)
        return Placement(box)

    def glb(self, reach: float) -> bytes:
        """Return the file; `reach`: change in 255ths that is shown brightest."""
        return self._written([image() for image in self._images], reach)

    def packed(self, reach: float, limit: float = np.inf) -> tuple[dict[str, Any], float]:
        """Return the file for a page, of about `limit` characters, and the scale of its pictures."""
        arrays, tables = self._arrays, _replace_by_differences(self._arrays)
        images, share = [image() for image in self._images], 1.0
        room = max(3 / 4 * limit - len(zlib.compress(bytes(arrays.binary))), _MIN_PICTURES)
        while (size := sum(len(content) for _, content in images)) > room and share > _MIN_SHARE:
            share *= _FILLED * float(np.sqrt(room / size))
            images = [resized(image(), share) for image in self._images]
        file = np.frombuffer(self._written(images, reach), np.uint8)
        first = len(file) - len(arrays.binary)
        moved = [(first + start, length, stride) for start, length, stride in tables]
        return {"tables": moved, "data": packed_array(file, 9)}, share

    def _written(self, images: list[ImageBytes], reach: float) -> bytes:
        arrays = self._arrays
        shown = [{"bufferView": arrays.add_bytes(data), "mimeType": mime} for mime, data in images]
        arrays.binary += bytes(-len(arrays.binary) % 4)
        tree = {
            **self._tree, "images": shown,
            "samplers": [{"wrapS": WRAPS[wrap[0]], "wrapT": WRAPS[wrap[1]]} for _, wrap, _ in self._textures],
            "textures": [{"sampler": number, "source": number} for number in range(len(shown))],
            "accessors": arrays.accessors, "bufferViews": arrays.views,
        }  # fmt: skip
        quantised = ["KHR_mesh_quantization"]
        whole = {
            "asset": {"version": "2.0", "generator": "beltrami"},
            "extensionsUsed": quantised, "extensionsRequired": quantised,
            **{name: entries for name, entries in tree.items() if entries},
            "buffers": [{"byteLength": len(arrays.binary)}],
            "extras": {
                "scale": VIRIDIS.tolist(),
                "reach": int(np.clip(np.ceil(round(reach, 2)), _MIN_REACH, _MAX_REACH)),
            },
        }  # fmt: skip
        chunks = [Chunk(JSON_CHUNK, json.dumps(whole).encode()), Chunk(BIN_CHUNK, bytes(arrays.binary))]
        return b"".join(glb_pieces(chunks))

    def _texture(self, texture: Texture, image: Callable[[], ImageBytes]) -> int:
        key = texture.data, texture.wrap, texture.alpha_hides
        if key not in self._textures:
            self._textures[key] = len(self._textures)
            self._images.append(image)
        return self._textures[key]

    def _add_vertices(self, one: ColouredVertices, other: ColouredVertices) -> Placement:
        finite = np.asarray(np.isfinite(np.hstack([one.positions, other.positions])).all(axis=1))
        box, size = Box(one), 0.0
        if len(one.faces):
            rows, index = _sorted(one.faces, len(finite))
        else:
            rows, index = np.flatnonzero(finite), None
            size = 2 * float(np.median(disc_radii(one.positions[finite]))) / box.size
        row_of = np.full(len(finite), -1, np.int64)
        row_of[rows] = np.arange(len(rows))
        colours = [np.pad(displayed_colours(each)[rows], [(0, 0), (0, 1)]) for each in (one, other)]
        if not self._is_live and not any((each % _BYTE).any() for each in colours):
            colours = [(each // _BYTE).astype("<u1") for each in colours]
        attributes = {"POSITION": self._positions(box.shares(one.positions[rows]))}
        attributes |= {
            name: self._arrays.add(each) for name, each in zip(("_BEFORE", "_AFTER"), colours, strict=True)
        }
        if not np.array_equal(one.positions, other.positions):
            attributes["_MOVED"] = self._arrays.add(box.shares(other.positions[rows]).astype("<f4"))
        node = self._node(attributes, _POINTS if index is None else _TRIANGLES, {"size": size}, index)
        self._scene(VERTICES, [node], middle=box.middle)
        return Placement(box, row_of)

    def _part(
        self, surface: TexturedSurface, box: Box, number: int, chart_of: Int32s, pair: list[int] | None
    ) -> int:
        """Add the triangles of one texture, with a vertex for each place, texture coordinate and chart."""
        mine = surface.texture_of == number
        corners, uv = surface.faces[mine].reshape(-1), surface.uv[mine].reshape(-1, 2).astype(np.float32)
        charts = np.repeat(chart_of[mine], 3)
        vertex_of, rows = group_equal_rows(corners, *np.nan_to_num(uv).T, charts)
        order, index = _sorted(vertex_of.reshape(-1, 3), len(rows))
        rows = rows[order]
        attributes = {"POSITION": self._positions(box.shares(surface.positions[corners[rows]]))}
        if pair is None:
            return self._node(attributes, _TRIANGLES, {}, index)
        attributes["TEXCOORD_0"] = self._arrays.add(_quantised(_finite(uv[rows])))
        attributes["_CHART"] = self._arrays.add(charts[rows, None].astype("<f4"))
        hides = surface.textures[number].alpha_hides
        return self._node(attributes, _TRIANGLES, {"textures": pair, "hides": hides}, index)

    def _scene(self, name: str, nodes: list[int], **extras: Any) -> None:
        self._tree["scenes"].append({"name": name, "nodes": nodes, "extras": {"name": name, **extras}})
        if not nodes:
            del self._tree["scenes"][-1]["nodes"]

    def _node(
        self, attributes: dict[str, int], mode: int, extras: dict[str, Any], index: Int64s | None = None
    ) -> int:
        primitive: dict[str, Any] = {"attributes": attributes, "mode": mode}
        if index is not None:
            kind = "<u2" if index.max(initial=0) < _FULL_SCALE else "<u4"
            primitive["indices"] = self._arrays.add(index.reshape(-1, 1).astype(kind), target=INDEX_DATA)
        self._tree["meshes"].append({"primitives": [primitive]})
        self._tree["nodes"].append({"mesh": len(self._tree["meshes"]) - 1, "extras": extras})
        return len(self._tree["nodes"]) - 1

    def _positions(self, shares: Float64s) -> int:
        return self._arrays.add(_quantised(shares), bounds=True)


def _replace_by_differences(arrays: Arrays) -> list[tuple[int, int, int]]:
    """Replace elements by their differences from the one before, with the bytes of one rank together.

    Return offset, length and bytes of an element for each array that is not empty.
    """
    data, tables = np.frombuffer(arrays.binary, np.uint8).copy(), []
    for accessor in arrays.accessors:
        view = arrays.views[accessor["bufferView"]]
        start, length = view["byteOffset"], view["byteLength"]
        if not length:
            continue
        # Indices are grouped by triangle.
        stride = length // accessor["count"] * (3 if view["target"] == INDEX_DATA else 1)
        rows = data[start : start + length].reshape(-1, stride)
        rows[1:] -= rows[:-1].copy()
        data[start : start + length] = rows.T.ravel()
        tables.append((start, length, stride))
    arrays.binary[:] = data.tobytes()
    return tables


def _finite(values: Array) -> Float64s:
    """Replace numbers that are not finite by 0, and clip the others to the range of single precision."""
    finite = np.nan_to_num(values.astype(np.float64), nan=0, posinf=0, neginf=0)
    return np.clip(finite, -_MAX_DISTANCE, _MAX_DISTANCE)


def _quantised(values: Float64s) -> Array:
    """Return values in 16 bits if they lie in [0, 1], else in single precision."""
    if values.min(initial=0) >= 0 and values.max(initial=1) <= 1:
        return np.rint(_FULL_SCALE * values).astype("<u2")
    return values.astype("<f4")


def _sorted(faces: Int32s, count: int) -> tuple[Int64s, Int64s]:
    """Return vertices in an order that keeps neighbours together, and their triangles, ordered likewise."""
    sides = edges_of(faces)
    ends = np.concatenate([sides, sides[:, ::-1]]).T
    graph = coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), (count, count)).tocsr()
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    number = np.empty(count, np.int64)
    number[order] = np.arange(count)
    index = number[faces]
    index = np.take_along_axis(index, (index.argmin(axis=1)[:, None] + np.arange(3)) % 3, 1)
    return order, index[np.lexsort((index[:, 1], index[:, 0]))]


def _charts_of(surface: TexturedSurface) -> tuple[Int32s, Int64s]:
    """Return the chart of each triangle, and the seams, (K, 2), as triangles and the corners they begin at."""
    place_of, _ = group_places(surface.positions, surface.space_of, surface.faces)
    starts = place_of[surface.faces]
    ends = np.roll(starts, -1, axis=1)
    uv = np.stack([surface.uv, np.roll(surface.uv, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    turned = (starts > ends).reshape(-1)
    uv[turned] = uv[turned, ::-1]
    low, high = np.minimum(starts, ends).reshape(-1), np.maximum(starts, ends).reshape(-1)
    order = np.lexsort((high, low))
    equal = (np.diff(low[order]) == 0) & (np.diff(high[order]) == 0)
    here, there = order[:-1][equal], order[1:][equal]
    same = surface.texture_of[here // 3] == surface.texture_of[there // 3]
    same &= (uv[here] == uv[there]).all(axis=(1, 2))
    chart_of = connected(len(surface.faces), np.stack([here[same] // 3, there[same] // 3], axis=1))
    cut = np.concatenate([here[~same], there[~same]])
    cut = cut[surface.texture_of[cut // 3] >= 0]
    return chart_of, np.stack([cut // 3, cut % 3], axis=1)


def _ends_of(corners: Float64s, edges: Int64s) -> Float64s:
    """Return both ends of edges, given by triangle and first corner, (2 K, X)."""
    face, corner = edges.T
    pairs = np.stack([corners[face, corner], corners[face, (corner + 1) % 3]], axis=1)
    return np.asarray(pairs.reshape(-1, corners.shape[2]), np.float64)
