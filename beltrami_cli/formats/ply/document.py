"""PLY files whose vertex colours and textures can be replaced, every other byte staying as it is."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from beltrami_cli.arrays import Float32s, Float64s, Int32s, Int64s
from beltrami_cli.errors import InputError, Obstacle
from beltrami_cli.formats.changes import Changes, Naming, PlannedImages, Written
from beltrami_cli.formats.colours import quantised
from beltrami_cli.formats.document import Document
from beltrami_cli.formats.files import edits
from beltrami_cli.formats.fingerprint import Fingerprint, labelled
from beltrami_cli.formats.meshes.coloured_polygons import ColouredPolygons, colours_of_vertices
from beltrami_cli.formats.meshes.scene import Scene
from beltrami_cli.formats.meshes.scene_mesh import textured_mesh
from beltrami_cli.formats.ply import texturing
from beltrami_cli.formats.ply.colours import (
    ColourProperties,
    Colours,
    find_colours,
    read_colours,
    require_no_splats,
)
from beltrami_cli.formats.ply.header import NORMAL, POSITION, Header, read_header
from beltrami_cli.formats.ply.polygons import POLYGONS, VERTEX_LISTS, read_grid, read_polygons
from beltrami_cli.formats.ply.tables import Body, NewValues, Table, indices, read_body, read_tables
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, is_outside
from beltrami_cli.surface.geometry import unit_vectors
from beltrami_cli.surface.polygons import dual, polygons_of
from beltrami_cli.surface.precision import require_single
from beltrami_cli.surface.records import MeshContents, MovedVertices, Slot

_CENTRES = "Its faces have the colours; each is a sample at the centre of its face."
_MEANS = "Vertices get the mean of the colours of their faces."


class PlyDocument(Document):
    """A PLY file, text or binary."""

    format = "ply"

    def _open(self, folder: Path | None) -> None:
        self._folder = ModelFolder(folder, self.access)
        self._header = read_header(self.data, self.name)
        require_no_splats(self._header, self.name)

    @property
    def notices(self) -> tuple[str, ...]:
        return tuple(comment.notice for comment in self._images if comment.notice)

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        return tuple(comment.obstacle for comment in self._images if comment.obstacle)

    @cached_property
    def _mesh(self) -> MeshContents:
        corners, offsets = self._polygons
        positions, notices = self._positions if len(corners) else self._measured, list[str]()
        if self._has_face_colours:
            positions, corners = dual(positions, *self._coloured_faces)
            offsets, corners = 3 * np.arange(len(corners) + 1), corners.ravel()
            notices.append(_CENTRES)
        notices += [self._colours.notice] if self._colours.notice else []
        return MeshContents(
            positions, corners, offsets, self._colours.values, "srgb", self._stored, notices=tuple(notices)
        )

    @property
    def _stored(self) -> str:
        return str(np.dtype(self._properties.type))

    @property
    def _channels(self) -> tuple[str, ...]:
        return self._properties.channels

    @property
    def _scale(self) -> float:
        return self._colours.scale

    def grid(self) -> Int64s | None:
        return read_grid(self.data[: self._header.end], self._tables)

    def has_vertex_colours(self) -> bool:
        try:
            return bool(self._properties.names)
        except InputError:
            return False

    def slots(self) -> tuple[Slot, ...]:
        has_textures = self._images and self._header.vertex and texturing.find_coordinates(self._tables)
        return ("baseColor",) if has_textures else ()

    def _why_untextured(self) -> Obstacle:
        return next(iter(self.obstacles), Obstacle("no face shows one"))

    @cached_property
    def _scene(self) -> Scene:
        mesh = self._positions, *self._polygons
        return texturing.read_scene(mesh, self._tables, self._images, self._folder, self.name)

    def _patched(self, new: Changes, naming: Naming) -> Written:
        sidecars, spans = texturing.renamed_images(self._images, new.images, self.name, naming)
        header = edits.exchange_spans(self.data[: self._header.end], spans)
        changes = [] if new.colours is None else self._recoloured(new.colours)
        if new.places is not None:
            changes += self._moved(new.places)
        if any(change.rows.any() for change in changes):
            pieces = [header, *self._body.patched(changes)]
        else:
            pieces = [header, memoryview(self.data)[self._header.end :]] if spans else [self.data]
        return dataclasses.replace(sidecars, main=pieces)

    def sidecar_names(self, images: PlannedImages, naming: Naming, **_: object) -> list[str]:
        return texturing.renamed_images(self._images, images, self.name, naming)[0].sidecar_names

    def _recoloured(self, colours: Float32s) -> list[NewValues]:
        columns = zip(self._properties.names, self._colours.values.T, colours.T, strict=True)
        kind, scale = self._properties.type, self._scale
        return [
            NewValues(self._coloured.places(name), new != old, quantised(new[new != old], kind, scale))
            for name, old, new in columns
        ]

    def _moved(self, places: MovedVertices) -> list[NewValues]:
        columns = dict(zip(POSITION, places.positions.T, strict=True))
        if places.normals is not None and self._has_real_normals:
            columns |= zip(NORMAL, places.normals.T, strict=True)
        changes = []
        for name, column in columns.items():
            rows = (column != self._vertices.scalars(name)) & ~np.isnan(column)
            new = column[rows].astype(self._kinds[name])
            changes.append(NewValues(self._vertices.places(name), rows, new))
        return changes

    def attributes(self) -> tuple[str, ...]:
        colours: tuple[str, ...] = ()
        if self.has_vertex_colours():
            if self._has_face_colours:
                return ()
            colours = self._properties.names
        scalars = tuple(name for name in self._kinds if name not in (*POSITION, *colours))
        return (*(["normal"] if self._has_real_normals else []), *scalars)

    def _attribute(self, name: str) -> Float64s:
        if name == "normal" and self._has_real_normals:
            return unit_vectors(self._vertices.columns(NORMAL, name))
        return self._vertices.columns((name,), name)

    def require_movable(self) -> None:
        if self._has_face_colours:
            raise InputError(
                self.name, "its colours are of faces, which do not move", "leave --smooth-geometry out"
            )
        whole = ", ".join(name for name in POSITION if self._kinds[name][0] != "f")
        if whole:
            cause = f"the coordinates {whole} are whole numbers, which cannot hold smoothed positions"
            raise InputError(self.name, cause, "store them as float or double")

    def references(self) -> Sequence[str]:
        paths = (image.path for image in self._images)
        return list(dict.fromkeys(path for path in paths if path is not None and not is_outside(path)))

    def contents(self) -> MeshContents:
        of_faces = self._properties.names if self._has_face_colours else ()
        corners, offsets = self._coloured_faces if self._has_face_colours else self._polygons
        return dataclasses.replace(
            self._mesh,
            positions=self._positions,
            corners=corners,
            offsets=offsets,
            colours=self.colours_at_vertices(self._colours.values),
            alpha=self._alpha(),
            normals=self._normals(),
            left_out=_omitted(self._header, self._converted, of_faces),
            notices=(*self._mesh.notices, *([_MEANS] if self._has_face_colours else [])),
        )

    def colours_at_vertices(self, colours: Float32s) -> Float32s:
        if not self._has_face_colours:
            return colours
        corners, offsets = self._coloured_faces
        shown = colours[polygons_of(offsets)]
        polygons = ColouredPolygons(self._positions, corners.astype(np.int64), offsets, shown, self._stored)
        return colours_of_vertices(polygons)[0]

    def textured_mesh(self, colours: Float32s | None = None) -> MeshContents:
        used = self._converted | {*texturing.find_coordinates(self._tables)}
        dropped = _omitted(self._header, used, {texturing.NUMBER, *used})
        has_others = self._header.comments > len(self._images)
        left_out = [what for what in dropped if what != "comments" or has_others]
        mesh = dataclasses.replace(textured_mesh(self._scene, left_out), normals=self._normals())
        return self._with_vertex_colours(mesh, colours)

    @property
    def _converted(self) -> set[str]:
        """The properties of vertices that all conversions keep."""
        colours = (
            {*self._properties.names, self._properties.alpha} if self.has_vertex_colours() else set[str]()
        )
        return {*POSITION, *colours, *(NORMAL if self._has_normals else ())}

    def facts(self) -> dict[str, object]:
        return {
            "format": self.format,
            "encoding": self._header.encoding,
            "elements": {element.name: element.count for element in self._header.elements},
            "properties": {each.name: [p.name for p in each.properties] for each in self._header.elements},
            "comments": self._header.comments,
        }

    def fingerprint(self) -> Fingerprint:
        spans = {(each.start, each.end): edits.PLACEHOLDER for each in self._images if each.path is not None}
        parts = {"header": edits.exchange_spans(self.data[: self._header.end], spans)}
        hidden, kind, colours = np.empty(0, np.int64), "u1", {}
        if self.has_vertex_colours():
            places = [indices(self._coloured.places(name)) for name in self._properties.names]
            hidden, kind = np.concatenate(places), self._properties.type
            colours = {f"{self._properties.element} colours": self._colours.values}
        parts[f"elements {', '.join(self._tables)}"] = self._body.without(hidden, kind)
        shown = {f"texture {n}": image.path for n, image in enumerate(self._images) if image.path is not None}
        return Fingerprint(parts, colours, labelled(shown, self._folder.content))

    @cached_property
    def _body(self) -> Body:
        return read_body(self.data, self._header, self.name)

    @cached_property
    def _tables(self) -> dict[str, Table]:
        return read_tables(self._body, self._header)

    @cached_property
    def _images(self) -> list[texturing.TextureComment]:
        return texturing.read_comments(self.data[: self._header.end], self._folder)

    @cached_property
    def _vertices(self) -> Table:
        element = self._header.vertex
        if element is None or element.count == 0:
            raise InputError(self.name, "there are no vertices", "nothing in it can be smoothed")
        missing = set(POSITION) - element.scalars.keys()
        if missing:
            raise InputError(self.name, f"vertices have no property {', '.join(sorted(missing))}")
        return self._tables["vertex"]

    @cached_property
    def _kinds(self) -> dict[str, str]:
        return self._vertices.element.scalars

    @cached_property
    def _properties(self) -> ColourProperties:
        tables = self._header, self._vertices, self._tables.get("face")
        return find_colours(*tables, self.access.channels)

    @property
    def _coloured(self) -> Table:
        return self._tables[self._properties.element]

    @property
    def _has_face_colours(self) -> bool:
        return self._properties.element == "face"

    @property
    def _coloured_faces(self) -> tuple[Int32s, Int64s]:
        corners, offsets = self._polygons  # triangles of strips follow the faces
        offsets = offsets[: self._coloured.element.count + 1]
        return corners[: offsets[-1]], offsets

    @cached_property
    def _colours(self) -> Colours:
        return read_colours(self._coloured, self._properties)

    @cached_property
    def _positions(self) -> Float64s:
        return self._vertices.columns(POSITION, "position")

    @cached_property
    def _measured(self) -> Float64s:
        """Positions of a range image or of points; unmeasured ones are not finite."""
        with np.errstate(invalid="ignore"):
            columns = [self._vertices.scalars(name) for name in POSITION]
            return np.column_stack(columns).astype(np.float64)

    @cached_property
    def _polygons(self) -> tuple[Int32s, Int64s]:
        return read_polygons(self._tables, self._vertices.element.count, self.name)

    def _alpha(self) -> Float32s | None:
        if not self._properties.alpha or self._has_face_colours:
            return None
        alpha = self._vertices.columns((self._properties.alpha,), "alpha")[:, 0]
        kind = self._kinds[self._properties.alpha]
        scale = float(np.iinfo(kind).max) if kind[0] != "f" else 1.0
        scale = self._scale if kind == self._properties.type else scale
        return np.clip(alpha / scale, 0, 1).astype(np.float32)

    @property
    def _has_normals(self) -> bool:
        return self._kinds.keys() >= {*NORMAL}

    @property
    def _has_real_normals(self) -> bool:
        return all(self._kinds.get(name, "")[:1] == "f" for name in NORMAL)

    def _normals(self) -> Float32s | None:
        if not self._has_normals:
            return None
        normals = self._vertices.columns(NORMAL, "normal")
        require_single(normals, self.name, "the normal of vertex")
        return normals.astype(np.float32)


def _omitted(header: Header, of_vertices: Collection[str], of_faces: Collection[str]) -> tuple[str, ...]:
    """Return what a conversion loses that uses these properties of vertices and faces."""
    dropped = []
    of_vertices, of_faces = ({name.partition(" ")[0] for name in names} for names in (of_vertices, of_faces))
    for element in header.elements:
        used = of_vertices if element.name == "vertex" else (*VERTEX_LISTS, *of_faces)
        unused = [other.name for other in element.properties if other.name not in used]
        if element.name not in ("vertex", *POLYGONS):
            dropped.append(f"element {element.name}")
        elif unused:
            dropped.append(f"{element.name} properties {', '.join(unused)}")
    return (*dropped, *(["comments"] if header.comments else []))
