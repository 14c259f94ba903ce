"""The process that opens USD layers with usd-core: a scene as arrays.

usd-core is not made for files that mean harm, so it runs as `python -m` of `layers` in this package, with a limit on
memory and time, in a folder that holds nothing but the layers that may be read.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from beltrami_cli.arrays import Array, Float64s, Int64s
from beltrami_cli.formats.usd.shading import INPUTS, placed, read_material

_SMOOTH = ("vertex", "varying")
_OPEN: list[Any] = []  # layers, which USD would read again without a reference


class NeedsLayersError(Exception):
    """Layers that the stage is composed of and that are not there, as (layer, path as it is written there)."""

    def __init__(self, needs: list[tuple[str, str]]) -> None:
        super().__init__()
        self.needs = needs


def opened(root: str, layers: list[str], refused: list[list[str]]) -> Any:
    """Open the stage of a layer in this folder, from the layers that are known; those refused are left out."""
    needs: list[tuple[str, str]] = []
    here = Path.cwd()
    for name in layers:
        layer = Sdf.Layer.FindOrOpen(str(here / name))
        if layer is None:
            raise ValueError(f"{name} cannot be opened")
        _OPEN.append(layer)
        for path in layer.GetCompositionAssetDependencies():
            if placed(name, path) in layers:
                continue
            if [name, path] not in refused:
                needs.append((name, path))
            layer.UpdateCompositionAssetDependency(path, "")
        _without_clips(layer)
    if needs:
        raise NeedsLayersError(needs)
    stage = Usd.Stage.Open(Sdf.Layer.FindOrOpen(str(here / root)), None, Usd.Stage.LoadAll)
    if stage is None:
        raise ValueError("it cannot be composed")
    return stage


def _without_clips(layer: Any) -> None:
    """Take out values in further files, which are of other times than the first."""

    def take_out(path: Any) -> None:
        spec = layer.GetObjectAtPath(path)
        if path.IsPrimPath() and spec.HasInfo("clips"):
            spec.ClearInfo("clips")

    layer.Traverse("/", take_out)


@dataclass
class Scene:
    """The visible geometry, collected mesh by mesh; lists of arrays are joined in the end."""

    arrays: dict[str, list[Array]] = field(default_factory=dict)
    uses: list[dict[str, Any]] = field(default_factory=list)  # textures of materials in slots
    materials: list[dict[str, Any]] = field(default_factory=list)
    blocks: list[dict[str, Any]] = field(default_factory=list)  # of coloured rows
    meshes: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    slots: set[str] = field(default_factory=set)
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
        """Take a mesh, where it stands first."""
        shown = UsdGeom.Imageable(prim)
        if shown.ComputePurpose() not in ("default", "render") or shown.ComputeVisibility() == "invisible":
            self.counts["hidden"] += 1
            return
        path = str(prim.GetPrimInPrototype().GetPath()) if prim.IsInstanceProxy() else str(prim.GetPath())
        if path in self._seen:
            self.counts["instanced"] += 1
            return
        self._seen.add(path)
        mesh, time = UsdGeom.Mesh(prim), Usd.TimeCode.EarliestTime()
        points = _values(mesh.GetPointsAttr()).reshape(-1, 3)
        sizes = _values(mesh.GetFaceVertexCountsAttr()).astype(np.int64)
        corners = _values(mesh.GetFaceVertexIndicesAttr()).astype(np.int64)
        name = prim.GetPath()
        if (sizes < 0).any() or sizes.sum() != len(corners):
            raise ValueError(f"{name}: its polygons have {sizes.sum()} corners, but there are {len(corners)}")
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            raise ValueError(f"{name}: a polygon names a vertex that is none of the {len(points)}")
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time))
        turned = (mesh.GetOrientationAttr().Get() == "leftHanded") != (np.linalg.det(matrix[:3, :3]) < 0)
        polygons = _Polygons.of(sizes, corners, mesh.GetHoleIndicesAttr().Get(time), turned)
        with np.errstate(over="ignore", invalid="ignore"):
            self.add(positions=points @ matrix[:3, :3] + matrix[3, :3])
        self.add(sizes=polygons.sizes, corners=polygons.vertex + self._vertices)
        self.add(mesh_of=np.full(len(polygons.sizes), len(self.meshes)))
        self._take_materials(prim, polygons, len(points))
        self._take_colours(prim, polygons, len(points))
        self.add(normals=_normals(mesh, polygons, len(points), matrix))
        self.meshes.append(prim.GetName())
        self._vertices += len(points)

    def _take_materials(self, prim: Any, polygons: _Polygons, points: int) -> None:
        """Take the materials bound to a mesh or its subsets, with the texture coordinates of every slot."""
        binding = UsdShade.MaterialBindingAPI(prim)
        parts = [(self._material(binding.ComputeBoundMaterial()[0]), np.arange(polygons.total))]
        for subset in binding.GetMaterialBindSubsets():
            bound = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0]
            chosen = np.array(subset.GetIndicesAttr().Get() or [], np.int64)
            parts.append((self._material(bound), chosen[(chosen >= 0) & (chosen < polygons.total)]))
        of_polygon = np.full(polygons.total, -1)
        for number, chosen in parts:
            of_polygon[chosen] = number
        of_polygon = of_polygon[polygons.kept]
        self.add(material_of=of_polygon)
        for slot in INPUTS:
            uv = np.full((len(polygons.vertex), 2), np.nan)
            use_of = np.full(len(polygons.sizes), -1)
            for number in np.unique(of_polygon[of_polygon >= 0]).tolist():
                use = self.materials[number]["uses"].get(slot)
                if use is None:
                    continue
                self.slots.add(slot)
                own = _coordinates(prim, self.uses[use], polygons, points)
                if own is None:
                    self.counts["bare"] += 1
                    continue
                chosen = of_polygon == number
                use_of[chosen] = use
                in_chosen = np.repeat(chosen, polygons.sizes)
                uv[in_chosen] = own[in_chosen]
            self.add(**{f"uv {slot}": uv, f"use {slot}": use_of})

    def _material(self, material: Any) -> int:
        if not material:
            return -1
        path = str(material.GetPath())
        if path not in self._number_of:
            self._number_of[path] = len(self.materials)
            known, uses = read_material(material)
            self.counts["unread"] += int(known.pop("unread", False))
            known["uses"] = {slot: len(self.uses) + number for number, slot in enumerate(uses)}
            self.uses += [{**use, "material": known["name"]} for use in uses.values()]
            self.materials.append(known)
        return self._number_of[path]

    def _take_colours(self, prim: Any, polygons: _Polygons, points: int) -> None:
        rows = np.full(len(polygons.vertex), -1)
        primvar = UsdGeom.Gprim(prim).GetDisplayColorPrimvar()
        values = _flat(primvar)
        kind = str(primvar.GetInterpolation()) if primvar else ""
        fits = {"faceVarying": polygons.all_corners, **dict.fromkeys(_SMOOTH, points)}
        if values is None:
            self.counts["uncoloured"] += 1
        elif primvar.GetAttr().GetNumTimeSamples():
            self.counts["animated"] += 1
        elif len(values) != fits.get(kind, -1) or values.shape[1:] != (3,):
            self.counts["flat" if kind in ("constant", "uniform") else "unfit"] += 1
        else:
            by_corner = kind == "faceVarying"
            rows = (polygons.corner if by_corner else polygons.vertex) + self._rows
            vertex = polygons.all_vertices if by_corner else np.arange(points)
            opacity = _flat(UsdGeom.Gprim(prim).GetDisplayOpacityPrimvar())
            fit = opacity is not None and len(opacity) == len(values)
            self.add(colours=values, colour_vertex=vertex + self._vertices)
            self.add(opacity=opacity if opacity is not None and fit else np.ones(len(values)))
            self.counts["transparent"] += int(fit)
            stored = np.array(primvar.Get(Usd.TimeCode.EarliestTime())).dtype.name
            place = {"attribute": str(primvar.GetAttr().GetPath()), "first": self._rows, "count": len(values)}
            self.blocks.append({**place, "type": stored})
            self._rows += len(values)
        self.add(rows=rows)


@dataclass(frozen=True)
class _Polygons:
    """Polygons without holes, all with the same winding."""

    sizes: Int64s
    kept: Int64s  # which of all polygons of the mesh they are
    corner: Int64s  # which of all corners of the mesh each of theirs is
    vertex: Int64s  # and its vertex
    all_vertices: Int64s  # of all corners

    @classmethod
    def of(cls, sizes: Int64s, corners: Int64s, holes: Any, turned: bool) -> _Polygons:
        starts = np.cumsum(sizes) - sizes
        is_kept = sizes >= 3
        holes = np.array(holes if holes is not None else [], np.int64)
        is_kept[holes[(holes >= 0) & (holes < len(sizes))]] = False
        kept = np.flatnonzero(is_kept)
        own = sizes[kept]
        within = np.arange(own.sum()) - np.repeat(np.cumsum(own) - own, own)
        corner = np.repeat(starts[kept], own) + (np.repeat(own, own) - 1 - within if turned else within)
        return cls(own, kept, corner, corners[corner], corners)

    @property
    def total(self) -> int:
        """All polygons of the mesh, the end of each being that of its last corner."""
        return int(self.kept[-1]) + 1 if len(self.kept) else 0

    @property
    def all_corners(self) -> int:
        return len(self.all_vertices)

    def spread(self, values: Float64s, kind: str, points: int) -> Float64s | None:
        """Return values at the corners, by the kind of interpolation; None if they do not fit."""
        if kind == "faceVarying" and len(values) == self.all_corners:
            return values[self.corner]
        return values[self.vertex] if kind in _SMOOTH and len(values) == points else None


def _values(attribute: Any) -> Float64s:
    return np.array(attribute.Get(Usd.TimeCode.EarliestTime()) if attribute.HasValue() else [], np.float64)


def _flat(primvar: Any) -> Float64s | None:
    if not primvar or not primvar.HasValue():
        return None
    values = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime())
    return None if values is None else np.array(values, np.float64)


def _on_corners(primvar: Any, polygons: _Polygons, points: int) -> Float64s | None:
    """Return the values of a primvar at the corners of polygons; None if it has none that fit."""
    values = _flat(primvar)
    return None if values is None else polygons.spread(values, str(primvar.GetInterpolation()), points)


def _coordinates(prim: Any, use: dict[str, Any], polygons: _Polygons, points: int) -> Float64s | None:
    """Return the texture coordinates of the corners of polygons, v up, transforms applied."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(use["coordinates"])
    uv = _on_corners(primvar, polygons, points)
    if uv is None or uv.shape[1:] != (2,):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        moved: Float64s = uv @ np.array(use["matrix"]) + np.array(use["offset"])
    return moved


def _normals(mesh: Any, polygons: _Polygons, points: int, matrix: Float64s) -> Float64s:
    """Return the unit normals of the corners of polygons in the world, NaN where there are none."""
    primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).GetPrimvar("normals")
    normals = _on_corners(primvar, polygons, points)
    if normals is None:
        values = mesh.GetNormalsAttr().Get()
        plain = np.array(values if values is not None else [], np.float64).reshape(-1, 3)
        normals = polygons.spread(plain, str(mesh.GetNormalsInterpolation()), points)
    if normals is None or normals.shape[1:] != (3,) or np.linalg.det(matrix[:3, :3]) == 0:
        return np.full((len(polygons.vertex), 3), np.nan)
    turned = normals @ np.linalg.inv(matrix[:3, :3]).T
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    return turned / np.where(lengths > 0, lengths, np.nan)
