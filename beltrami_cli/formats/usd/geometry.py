"""The visible meshes of a USD scene as arrays: positions, polygons, colours, texture coordinates and normals."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdShade

from beltrami_cli.arrays import Array, Bools, Float64s, Int64s
from beltrami_cli.formats.usd.contents import ColourBlock, Count
from beltrami_cli.formats.usd.materials import read_material
from beltrami_cli.formats.usd.preview_surface import SURFACE_SLOTS, MaterialInputs
from beltrami_cli.formats.usd.shown_images import AS_STORED, ShownImage, UvMapping
from beltrami_cli.surface.records import Slot

_SMOOTH = ("vertex", "varying")


@dataclass
class Geometry:
    """The visible geometry, collected mesh by mesh; lists of arrays are joined in the end."""

    arrays: dict[str, list[Array]] = field(default_factory=dict)
    images: list[dict[Slot, ShownImage]] = field(default_factory=list)  # of each material
    materials: list[MaterialInputs] = field(default_factory=list)
    blocks: list[ColourBlock] = field(default_factory=list)
    meshes: list[str] = field(default_factory=list)
    counts: Counter[Count] = field(default_factory=Counter)
    slots: set[Slot] = field(default_factory=set)
    _number_of: dict[str, int] = field(default_factory=dict)
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
        points = _values(mesh.GetPointsAttr()).reshape(-1, 3)
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
        polygons = _Polygons.of(mesh, len(points), is_mirrored=bool(np.linalg.det(matrix[:3, :3]) < 0))
        with np.errstate(over="ignore", invalid="ignore"):
            self.add(positions=points @ matrix[:3, :3] + matrix[3, :3])
        materials = self._materials_of(prim, len(polygons.sizes))
        rows = self._colour_rows(prim, polygons)
        of_corners = self._coordinates_by_slot(prim, polygons, materials) | {
            "corners": polygons.vertex + self._vertices,
            "rows": rows,
            "normals": _normals(mesh, polygons, matrix),
        }
        images = [self.images[number] for number in np.unique(materials[materials >= 0]).tolist()]
        read = {shown.mapping.primvar for each in images for shown in each.values()} or {"st"}
        read |= {"normals", "displayColor", *(["displayOpacity"] if (rows >= 0).any() else [])}
        primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
        self.counts["further"] += int(any(each.GetPrimvarName() not in read for each in primvars))
        of_polygons = {
            "sizes": polygons.sizes,
            "material_of": materials,
            "mesh_of": np.full(len(materials), len(self.meshes)),
        }
        is_kept = _are_shown(mesh, polygons.sizes)
        self.add(**{name: values[is_kept] for name, values in of_polygons.items()})
        in_kept = np.repeat(is_kept, polygons.sizes)
        self.add(**{name: values[in_kept] for name, values in of_corners.items()})
        self.meshes.append(prim.GetName())
        self._vertices += len(points)

    def _materials_of(self, prim: Any, count: int) -> Int64s:
        """Return the numbers of the materials that are bound to the polygons of a mesh, or to subsets of these."""
        binding = UsdShade.MaterialBindingAPI(prim)
        number_of = np.full(count, self._material(binding.ComputeBoundMaterial()[0]))
        for subset in binding.GetMaterialBindSubsets():
            bound = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0]
            chosen = np.array(subset.GetIndicesAttr().Get() or [], np.int64)
            number_of[chosen[(chosen >= 0) & (chosen < count)]] = self._material(bound)
        return number_of

    def _coordinates_by_slot(self, prim: Any, polygons: _Polygons, materials: Int64s) -> dict[str, Array]:
        """Return the texture coordinates of corners in every slot, and the usual ones."""
        plain, bare = _coordinates(prim, AS_STORED, polygons), np.full((len(polygons.vertex), 2), np.nan)
        arrays: dict[str, Array] = {"uv": bare if plain is None else plain}
        for slot in SURFACE_SLOTS:
            uv = arrays[f"uv {slot}"] = bare.copy()
            for number in np.unique(materials[materials >= 0]).tolist():
                shown = self.images[number].get(slot)
                if shown is None:
                    continue
                self.slots.add(slot)
                coordinates = _coordinates(prim, shown.mapping, polygons)
                if coordinates is None:
                    self.counts["bare"] += 1
                    continue
                in_chosen = np.repeat(materials == number, polygons.sizes)
                uv[in_chosen] = coordinates[in_chosen]
        return arrays

    def _material(self, material: Any) -> int:
        if not material:
            return -1
        path = str(material.GetPath())
        if path not in self._number_of:
            self._number_of[path] = len(self.materials)
            inputs, images = read_material(material)
            self.counts["unread"] += int(inputs.is_unread)
            self.images.append(images)
            self.materials.append(inputs)
        return self._number_of[path]

    def _colour_rows(self, prim: Any, polygons: _Polygons) -> Int64s:
        """Add the colours of a mesh; return the row of each corner among all colours, -1: the mesh has none."""
        primvar = UsdGeom.Gprim(prim).GetDisplayColorPrimvar()
        values = _flat(primvar)
        kind = str(primvar.GetInterpolation()) if primvar else ""
        rows = None if values is None else polygons.spread(np.arange(len(values)), kind)
        if values is None:
            self.counts["uncoloured"] += 1
        elif primvar.GetAttr().GetNumTimeSamples():
            self.counts["animated"] += 1
        elif rows is None or values.shape[1:] != (3,):
            self.counts["flat" if kind in ("constant", "uniform") else "unfit"] += 1
        else:
            vertex = polygons.stored if kind == "faceVarying" else np.arange(polygons.points)
            opacity = _flat(UsdGeom.Gprim(prim).GetDisplayOpacityPrimvar())
            fit = opacity is None or len(opacity) in (1, len(values))
            self.counts["further"] += int(not fit)
            alpha = np.broadcast_to(opacity if opacity is not None and fit else 1.0, len(values))
            self.counts["transparent"] += int((alpha < 1).any())
            self.add(colours=values, colour_vertex=vertex + self._vertices, opacity=alpha)
            stored = np.array(primvar.Get(Usd.TimeCode.EarliestTime())).dtype.name
            attribute = str(primvar.GetAttr().GetPath())
            self.blocks.append(ColourBlock(attribute, self._rows, len(values), stored))
            self._rows += len(values)
            return rows + self._rows - len(values)
        return np.full(len(polygons.vertex), -1)


@dataclass(frozen=True)
class _Polygons:
    """All polygons of a mesh, with the same winding."""

    sizes: Int64s
    corner: Int64s  # which of the stored corners each is
    stored: Int64s  # the vertices of the stored corners
    points: int  # how many vertices there are

    @classmethod
    def of(cls, mesh: Any, points: int, *, is_mirrored: bool) -> _Polygons:
        """Read the polygons of a mesh of so many points; ValueError if they do not fit."""
        sizes = _values(mesh.GetFaceVertexCountsAttr()).astype(np.int64)
        stored = _values(mesh.GetFaceVertexIndicesAttr()).astype(np.int64)
        name, corner = mesh.GetPath(), np.arange(len(stored))
        if (sizes < 0).any() or sizes.sum() != len(stored):
            raise ValueError(f"{name}: its polygons have {sizes.sum()} corners, but there are {len(stored)}")
        if len(stored) and (stored.min() < 0 or stored.max() >= points):
            raise ValueError(f"{name}: a polygon names a vertex beyond the {points} of its mesh")
        if (mesh.GetOrientationAttr().Get() == "leftHanded") != is_mirrored:
            corner = 2 * np.repeat(np.cumsum(sizes), sizes) - np.repeat(sizes, sizes) - 1 - corner
        return cls(sizes, corner, stored, points)

    @property
    def vertex(self) -> Int64s:
        return self.stored[self.corner]

    def spread(self, values: Array, kind: str) -> Array | None:
        """Return values at the corners, by the kind of interpolation; None if they do not fit."""
        if kind == "faceVarying" and len(values) == len(self.stored):
            return values[self.corner]
        return values[self.vertex] if kind in _SMOOTH and len(values) == self.points else None


def _values(attribute: Any) -> Float64s:
    return np.array(attribute.Get(Usd.TimeCode.EarliestTime()) if attribute.HasValue() else [], np.float64)


def _are_shown(mesh: Any, sizes: Int64s) -> Bools:
    """Return which polygons are faces, and no holes."""
    is_shown = sizes >= 3
    holes = np.array(mesh.GetHoleIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or [], np.int64)
    is_shown[holes[(holes >= 0) & (holes < len(sizes))]] = False
    return is_shown


def _flat(primvar: Any) -> Float64s | None:
    if not primvar or not primvar.HasValue():
        return None
    values = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime())
    return None if values is None else np.array(values, np.float64)


def _on_corners(primvar: Any, polygons: _Polygons) -> Float64s | None:
    """Return the values of a primvar at the corners of polygons; None if it has none that fit."""
    values = _flat(primvar)
    return None if values is None else polygons.spread(values, str(primvar.GetInterpolation()))


def _coordinates(prim: Any, mapping: UvMapping, polygons: _Polygons) -> Float64s | None:
    """Return the texture coordinates of the corners of polygons, v up, transforms applied."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(mapping.primvar)
    uv = _on_corners(primvar, polygons)
    if uv is None or uv.shape[1:] != (2,):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        moved: Float64s = uv @ np.array(mapping.matrix) + np.array(mapping.offset)
    return moved


def _normals(mesh: Any, polygons: _Polygons, matrix: Float64s) -> Float64s:
    """Return the unit normals of the corners of polygons in the world, NaN where there are none."""
    primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).GetPrimvar("normals")
    normals = _on_corners(primvar, polygons)
    if normals is None:
        values = mesh.GetNormalsAttr().Get()
        plain = np.array(values if values is not None else [], np.float64).reshape(-1, 3)
        normals = polygons.spread(plain, str(mesh.GetNormalsInterpolation()))
    if normals is None or normals.shape[1:] != (3,) or np.linalg.det(matrix[:3, :3]) == 0:
        return np.full((len(polygons.vertex), 3), np.nan)
    turned = normals @ np.linalg.inv(matrix[:3, :3]).T
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    return turned / np.where(lengths > 0, lengths, np.nan)
