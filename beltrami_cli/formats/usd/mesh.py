"""A mesh of a USD scene: its polygons, and the values of its primvars at their corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from beltrami_cli.arrays import Array, Bools, Float64s, Int64s
from beltrami_cli.formats.usd.contents import Count
from beltrami_cli.formats.usd.shown_images import UvMapping

_SMOOTH = ("vertex", "varying")


@dataclass(frozen=True)
class Polygons:
    """All polygons of a mesh, with the same winding."""

    sizes: Int64s
    order: Int64s  # which of the stored corners each corner is
    stored_vertex: Int64s  # of the stored corners
    point_count: int

    @classmethod
    def of(cls, mesh: Any, point_count: int, *, is_mirrored: bool) -> Polygons:
        """Read the polygons of a mesh of so many points; ValueError if they do not fit."""
        sizes = attribute_values(mesh.GetFaceVertexCountsAttr()).astype(np.int64)
        vertex = attribute_values(mesh.GetFaceVertexIndicesAttr()).astype(np.int64)
        name, order = mesh.GetPath(), np.arange(len(vertex))
        if (sizes < 0).any() or sizes.sum() != len(vertex):
            raise ValueError(f"{name}: its polygons have {sizes.sum()} corners, but there are {len(vertex)}")
        if len(vertex) and (vertex.min() < 0 or vertex.max() >= point_count):
            raise ValueError(f"{name}: a polygon names a vertex beyond the {point_count} of its mesh")
        if (mesh.GetOrientationAttr().Get() == "leftHanded") != is_mirrored:
            order = 2 * np.repeat(np.cumsum(sizes), sizes) - np.repeat(sizes, sizes) - 1 - order
        return cls(sizes, order, vertex, point_count)

    @property
    def vertex(self) -> Int64s:
        return self.stored_vertex[self.order]

    def spread(self, values: Array, kind: str) -> Array | None:
        """Return values at the corners, by the kind of interpolation; None if they do not fit."""
        if kind == "faceVarying" and len(values) == len(self.order):
            return values[self.order]
        return values[self.vertex] if kind in _SMOOTH and len(values) == self.point_count else None


@dataclass(frozen=True)
class VertexColours:
    """The n colours of a mesh, in linear light."""

    colours: Float64s  # (n, 3)
    opacity: Float64s | None  # (n,) or (1,); None: all are opaque
    vertex: Int64s  # (n,): the vertex of each
    row: Int64s  # (K,): which of them each corner has
    attribute: str  # path of its displayColor
    stored: str  # type, by NumPy's name
    has_unfit_opacity: bool

    @classmethod
    def of(cls, prim: Any, polygons: Polygons) -> VertexColours | Count:
        """Read the colours of a mesh, or return why they are left as they are."""
        shown = UsdGeom.Gprim(prim)
        primvar, opacity = shown.GetDisplayColorPrimvar(), flattened(shown.GetDisplayOpacityPrimvar())
        colours = flattened(primvar)
        if colours is None:
            return "uncoloured"
        if primvar.GetAttr().GetNumTimeSamples():
            return "animated"
        kind = str(primvar.GetInterpolation())
        row = polygons.spread(np.arange(len(colours)), kind)
        if row is None or colours.shape[1:] != (3,):
            return "flat" if kind in ("constant", "uniform") else "unfit"
        is_unfit = opacity is not None and len(opacity) not in (1, len(colours))
        return cls(
            colours,
            opacity=None if is_unfit else opacity,
            vertex=polygons.stored_vertex if kind == "faceVarying" else np.arange(polygons.point_count),
            row=row,
            attribute=str(primvar.GetAttr().GetPath()),
            stored=np.array(primvar.Get(Usd.TimeCode.EarliestTime())).dtype.name,
            has_unfit_opacity=is_unfit,
        )


def attribute_values(attribute: Any) -> Float64s:
    return np.array(attribute.Get(Usd.TimeCode.EarliestTime()) if attribute.HasValue() else [], np.float64)


def are_shown(mesh: Any, sizes: Int64s) -> Bools:
    """Return which polygons are faces, and no holes."""
    is_shown = sizes >= 3
    holes = np.array(mesh.GetHoleIndicesAttr().Get(Usd.TimeCode.EarliestTime()) or [], np.int64)
    is_shown[holes[(holes >= 0) & (holes < len(sizes))]] = False
    return is_shown


def flattened(primvar: Any) -> Float64s | None:
    if not primvar or not primvar.HasValue():
        return None
    values = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime())
    return None if values is None else np.array(values, np.float64)


def at_corners(primvar: Any, polygons: Polygons) -> Float64s | None:
    """Return the values of a primvar at the corners of polygons; None if it has none that fit."""
    values = flattened(primvar)
    return None if values is None else polygons.spread(values, str(primvar.GetInterpolation()))


def coordinates_of(prim: Any, mapping: UvMapping, polygons: Polygons) -> Float64s | None:
    """Return the texture coordinates of the corners of polygons, v up, transforms applied."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(mapping.primvar)
    uv = at_corners(primvar, polygons)
    if uv is None or uv.shape[1:] != (2,):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        moved: Float64s = uv @ np.array(mapping.matrix) + np.array(mapping.offset)
    return moved


def normals_of(mesh: Any, polygons: Polygons, matrix: Float64s) -> Float64s:
    """Return the unit normals of the corners of polygons in the world, NaN where there are none."""
    primvar = UsdGeom.PrimvarsAPI(mesh.GetPrim()).GetPrimvar("normals")
    stored = at_corners(primvar, polygons)
    if stored is None:
        values = mesh.GetNormalsAttr().Get()
        plain = np.array(values if values is not None else [], np.float64).reshape(-1, 3)
        stored = polygons.spread(plain, str(mesh.GetNormalsInterpolation()))
    if stored is None or stored.shape[1:] != (3,) or np.linalg.det(matrix[:3, :3]) == 0:
        return np.full((len(polygons.vertex), 3), np.nan)
    turned = stored @ np.linalg.inv(matrix[:3, :3]).T
    lengths = np.linalg.norm(turned, axis=1, keepdims=True)
    return turned / np.where(lengths > 0, lengths, np.nan)
