"""The visible meshes of a USD scene as arrays: positions, polygons, colours, texture coordinates and normals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from beltrami_cli.arrays import Array, Int64s
from beltrami_cli.formats.usd.contents import ColourBlock, Count
from beltrami_cli.formats.usd.materials import Materials
from beltrami_cli.formats.usd.mesh import (
    Polygons,
    VertexColours,
    are_shown,
    attribute_values,
    coordinates_of,
    normals_of,
)
from beltrami_cli.formats.usd.preview_surface import SURFACE_SLOTS
from beltrami_cli.formats.usd.shown_images import AS_STORED, SlotImages
from beltrami_cli.surface.records import Slot


@dataclass
class Geometry:
    """The visible geometry, collected mesh by mesh; lists of arrays are joined in the end."""

    arrays: dict[str, list[Array]] = field(default_factory=dict)
    materials: Materials = field(default_factory=Materials)
    blocks: list[ColourBlock] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    counts: Counter[Count] = field(default_factory=Counter)
    slots: set[Slot] = field(default_factory=set)
    _seen: set[str] = field(default_factory=set)
    _vertices: int = 0
    _rows: int = 0

    def add(self, **arrays: Array) -> None:
        for name, values in arrays.items():
            self.arrays.setdefault(name, []).append(values)

    def joined(self) -> dict[str, Array]:
        return {name: np.concatenate(values) for name, values in self.arrays.items()}

    def take(self, prim: Any) -> None:
        """Add a mesh, at the first place where it is shown."""
        shown = UsdGeom.Imageable(prim)
        if shown.ComputePurpose() not in ("default", "render") or shown.ComputeVisibility() == "invisible":
            self.counts["hidden"] += 1
            return
        path = str(prim.GetPrimInPrototype().GetPath()) if prim.IsInstanceProxy() else str(prim.GetPath())
        if path in self._seen:
            self.counts["instanced"] += 1
            return
        self._seen.add(path)
        self._add_mesh(prim)

    def _add_mesh(self, prim: Any) -> None:
        mesh, time = UsdGeom.Mesh(prim), Usd.TimeCode.EarliestTime()
        points = attribute_values(mesh.GetPointsAttr()).reshape(-1, 3)
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
        polygons = Polygons.of(mesh, len(points), is_mirrored=bool(np.linalg.det(matrix[:3, :3]) < 0))
        material_of = self.materials.of_polygons(prim, len(polygons.sizes))
        numbers = np.unique(material_of[material_of >= 0]).tolist()
        images = {number: self.materials.images[number] for number in numbers}
        rows = self._colour_rows(prim, polygons)
        self._note_further_primvars(prim, images.values(), has_colours=bool((rows >= 0).any()))
        of_polygons = {
            "sizes": polygons.sizes,
            "material_of": material_of,
            "mesh_of": np.full(len(material_of), len(self.meshes)),
        }
        of_corners = self._coordinates_by_slot(prim, polygons, material_of, images) | {
            "corners": polygons.vertex + self._vertices,
            "rows": rows,
            "normals": normals_of(mesh, polygons, matrix),
        }
        with np.errstate(over="ignore", invalid="ignore"):
            self.add(positions=points @ matrix[:3, :3] + matrix[3, :3])
        is_kept = are_shown(mesh, polygons.sizes)
        self.add(**{name: values[is_kept] for name, values in of_polygons.items()})
        in_kept = np.repeat(is_kept, polygons.sizes)
        self.add(**{name: values[in_kept] for name, values in of_corners.items()})
        self.meshes.append(prim.GetName())
        self._vertices += len(points)

    def _coordinates_by_slot(
        self, prim: Any, polygons: Polygons, material_of: Int64s, images: Mapping[int, SlotImages]
    ) -> dict[str, Array]:
        """Return the texture coordinates of corners in every slot, and the usual ones."""
        plain, bare = coordinates_of(prim, AS_STORED, polygons), np.full((len(polygons.vertex), 2), np.nan)
        arrays: dict[str, Array] = {"uv": bare if plain is None else plain}
        for slot in SURFACE_SLOTS:
            uv = arrays[f"uv {slot}"] = bare.copy()
            shown_by = {number: by_slot[slot] for number, by_slot in images.items() if slot in by_slot}
            self.slots |= {slot} if shown_by else set()
            for number, shown in shown_by.items():
                coordinates = coordinates_of(prim, shown.mapping, polygons)
                if coordinates is None:
                    self.counts["bare"] += 1
                    continue
                in_chosen = np.repeat(material_of == number, polygons.sizes)
                uv[in_chosen] = coordinates[in_chosen]
        return arrays

    def _note_further_primvars(self, prim: Any, images: Iterable[SlotImages], *, has_colours: bool) -> None:
        read = {shown.mapping.primvar for by_slot in images for shown in by_slot.values()} or {"st"}
        read |= {"normals", "displayColor", *(["displayOpacity"] if has_colours else [])}
        primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
        self.counts["further"] += int(any(each.GetPrimvarName() not in read for each in primvars))

    def _colour_rows(self, prim: Any, polygons: Polygons) -> Int64s:
        """Add the colours of a mesh; return the row of each corner among all colours, -1: the mesh has none."""
        read = VertexColours.of(prim, polygons)
        if not isinstance(read, VertexColours):
            self.counts[read] += 1
            return np.full(len(polygons.vertex), -1)
        count, first = len(read.colours), self._rows
        alpha = np.broadcast_to(1.0 if read.opacity is None else read.opacity, count)
        self.counts["further"] += int(read.has_unfit_opacity)
        self.counts["transparent"] += int((alpha < 1).any())
        self.add(colours=read.colours, colour_vertex=read.vertex + self._vertices, opacity=alpha)
        self.blocks.append(ColourBlock(read.attribute, first, count, read.stored))
        self._rows += count
        return read.row + first
