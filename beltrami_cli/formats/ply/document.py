"""PLY files whose vertex colours and textures can be replaced, every other byte staying as it is."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from beltrami_cli.errors import InputError
from beltrami_cli.formats.access import EVERYTHING_INSIDE, Access
from beltrami_cli.formats.beside import Beside, is_outside
from beltrami_cli.formats.document import NO_IMAGES, Document, Written
from beltrami_cli.formats.ply.body import values_in_bytes
from beltrami_cli.formats.ply.header import read_header
from beltrami_cli.formats.ply.paint import find_paint, finite_columns, read_colours, store_colours
from beltrami_cli.formats.ply.polygons import VERTEX_LISTS, read_polygons
from beltrami_cli.formats.ply.repainting import renamed_images
from beltrami_cli.formats.ply.tables import indices, read_tables
from beltrami_cli.formats.ply.texturing import find_coordinates, gather_textured, read_comments
from beltrami_cli.formats.tokens import exchange_spans, exchange_tokens, find_tokens
from beltrami_cli.mesh.painted import MeshContents, PaintedVertices
from beltrami_cli.mesh.polygons import triangulate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from beltrami_cli.formats.ply.paint import Colours, Paint
    from beltrami_cli.formats.ply.tables import Places, Table
    from beltrami_cli.formats.ply.texturing import TextureComment
    from beltrami_cli.mesh.textured import ImageFile, Slot, TexturedSurface

_POSITION = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")


class PlyDocument(Document):
    """A PLY file, text or binary.

    Parameters
    ----------
    data : bytes
        The file.
    name : str
        Its name for messages.
    folder : pathlib.Path or None
        Where it lies, for the images that its comments name.
    access : Access
        What may be read.

    Raises
    ------
    InputError
        If it is not a PLY file or its header is damaged.
    """

    format: ClassVar[str] = "ply"

    def __init__(
        self,
        data: bytes,
        name: str,
        folder: Path | None = None,
        access: Access = EVERYTHING_INSIDE,
    ) -> None:
        super().__init__(name)
        self._data = data
        self._beside = Beside(folder, access)
        self._header = read_header(data, name)

    def painted(self) -> PaintedVertices:
        """Return the vertex colours and their surface; see `Document.painted`."""
        return self._painted

    @cached_property
    def _painted(self) -> PaintedVertices:
        corners, offsets = self._polygons
        return PaintedVertices(
            positions=self._positions,
            faces=triangulate(self._positions, corners, offsets),
            colours=self._colours.values,
            channels=self._paint.channels,
            encoding="srgb",
            stored=str(np.dtype(self._paint.type)),
        )

    def has_vertex_colours(self) -> bool:
        """Tell whether the vertices have colours."""
        try:
            return bool(self._paint.names)
        except InputError:
            return False

    def slots(self) -> tuple[Slot, ...]:
        """Return the base colour if there are images and coordinates; see `Document.slots`."""
        there = self._images and self._header.element("vertex") and find_coordinates(self._tables)
        return ("baseColor",) if there else ()

    def textured(self, slot: Slot) -> TexturedSurface:
        """Return the textures and their surface; see `Document.textured`."""
        if slot != "baseColor":
            return super().textured(slot)
        return self._textured

    @cached_property
    def _textured(self) -> TexturedSurface:
        mesh = self._positions, *self._polygons
        surface, notices = gather_textured(mesh, self._tables, self._images, self._beside, self.name)
        self.notices += notices
        return surface

    def patch(
        self,
        colours: NDArray[np.float32] | None,
        stem: str,
        *,
        moved: bool,
        images: Mapping[tuple[Slot, str], ImageFile] = NO_IMAGES,
    ) -> Written:
        """Return the files with other colours and images; see `Document.patch`."""
        sidecars, spans = renamed_images(self._images, images, Path(self.name).stem, stem, moved=moved)
        header = exchange_spans(self._data[: self._header.end], spans)
        body = memoryview(self._data)[self._header.end :]
        if colours is None or not (changed := colours != self._colours.values).any():
            return Written([header, body] if spans else [self._data], sidecars)
        places = [self._vertices.places(known) for known in self._paint.names]
        if self._header.order:
            patched = memoryview(self._patch_bytes(colours, changed, places))[self._header.end :]
            return Written([header, patched], sidecars)
        return Written([header, *self._patch_text(colours, changed, places)], sidecars)

    def _patch_bytes(
        self, colours: NDArray[np.float32], changed: NDArray[np.bool_], places: Sequence[Places]
    ) -> bytearray:
        data = bytearray(self._data)
        everywhere = values_in_bytes(data, self._header.order + self._paint.type)
        for channel, where in enumerate(places):
            rows = changed[:, channel]
            stored = store_colours(colours[rows, channel], self._colours.scale, self._paint.type)
            if isinstance(where, slice):
                everywhere[where][rows] = stored
            else:
                everywhere[where[rows]] = stored
        return data

    def _patch_text(
        self, colours: NDArray[np.float32], changed: NDArray[np.bool_], places: Sequence[Places]
    ) -> list[bytes | memoryview]:
        text = self._data[self._header.end :]
        starts, ends = find_tokens(text)
        tokens = np.column_stack([indices(where) for where in places])[changed]
        order = np.argsort(tokens)  # Columns may stand in any order; tokens are exchanged from first to last.
        stored = store_colours(colours[changed][order], self._colours.scale, self._paint.type)

        def spell(block: slice) -> list[bytes]:
            if self._paint.type[0] == "u":
                return [b"%d" % value for value in stored[block].tolist()]
            spelled: list[bytes] = (
                stored[block].astype("S32").tolist()
            )  # the shortest that reads back the same
            return spelled

        there = tokens[order]
        return exchange_tokens(text, starts[there], ends[there], spell)

    def references(self) -> Sequence[str]:
        """Return the images that comments name."""
        return list(
            dict.fromkeys(
                image.path for image in self._images if image.path is not None and not is_outside(image.path)
            )
        )

    def contents(self) -> MeshContents:
        """Return the mesh for conversion; see `Document.contents`."""
        corners, offsets = self._polygons
        known = {known.name for known in self._vertices.element.properties if not known.count}
        has_normals = known.issuperset(_NORMAL)
        return MeshContents(
            positions=self._positions,
            corners=corners,
            offsets=offsets,
            colours=self._colours.values,
            encoding="srgb",
            stored=str(np.dtype(self._paint.type)),
            alpha=self._alpha(),
            normals=self._normals() if has_normals else None,
            left_out=self._left_out(has_normals),
        )

    def facts(self) -> dict[str, object]:
        """Return what the header says."""
        return {
            "format": self.format,
            "encoding": self._header.encoding,
            "elements": {element.name: element.count for element in self._header.elements},
            "properties": {
                element.name: [known.name for known in element.properties]
                for element in self._header.elements
            },
            "comments": self._header.comments,
        }

    @cached_property
    def _tables(self) -> dict[str, Table]:
        return dict(read_tables(self._data, self._header, self.name))

    @cached_property
    def _images(self) -> list[TextureComment]:
        comments = read_comments(self._data[: self._header.end], self._beside)
        self.notices += [f"'{comment.name}' {comment.reason}" for comment in comments if comment.reason]
        return comments

    @cached_property
    def _vertices(self) -> Table:
        element = self._header.element("vertex")
        if element is None or element.count == 0:
            raise InputError(self.name, "there are no vertices", "nothing in it can be smoothed")
        missing = set(_POSITION) - {known.name for known in element.properties if not known.count}
        if missing:
            raise InputError(self.name, f"vertices have no property {', '.join(sorted(missing))}")
        return self._tables["vertex"]

    @cached_property
    def _paint(self) -> Paint:
        return find_paint(self._header, self._vertices, self.name)

    @cached_property
    def _colours(self) -> Colours:
        colours = read_colours(self._vertices, self._paint, self.name)
        self.notices += [colours.notice] if colours.notice else []
        return colours

    @cached_property
    def _positions(self) -> NDArray[np.float64]:
        return self._columns(_POSITION, "position")

    @cached_property
    def _polygons(self) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        return read_polygons(self._tables, self._vertices.element.count, self.name)

    def _columns(self, names: tuple[str, ...], what: str) -> NDArray[np.float64]:
        return finite_columns(self._vertices, names, what, self.name)

    def _alpha(self) -> NDArray[np.float32] | None:
        if not self._paint.alpha:
            return None
        alpha = self._columns((self._paint.alpha,), "alpha")[:, 0]
        kind = next(p.type for p in self._vertices.element.properties if p.name == self._paint.alpha)
        scale = float(np.iinfo(kind).max) if kind[0] != "f" else 1.0
        if kind == self._paint.type:
            scale = self._colours.scale
        return np.clip(alpha / scale, 0, 1).astype(np.float32)

    def _normals(self) -> NDArray[np.float32]:
        largest = np.finfo(np.float32).max
        return np.clip(self._columns(_NORMAL, "normal"), -largest, largest).astype(np.float32)

    def _left_out(self, has_normals: bool) -> tuple[str, ...]:
        used = {*_POSITION, *self._paint.names, self._paint.alpha, *(_NORMAL if has_normals else ())}
        dropped = []
        for element in self._header.elements:
            known = used if element.name == "vertex" else VERTEX_LISTS.get(element.name, ())
            others = [other.name for other in element.properties if other.name not in known]
            if element.name != "vertex" and element.name not in VERTEX_LISTS:
                dropped.append(f"element {element.name}")
            elif others:
                dropped.append(f"{element.name} properties {', '.join(others)}")
        return (*dropped, *(["comments"] if self._header.comments else []))
