"""The process that opens USD layers with usd-core: a scene as arrays, and its materials.

usd-core is not made for files that mean harm, so it runs as `python -m` of `layers` in this package, with a limit on
memory and time, in a folder that holds nothing but the layers that may be read. Of materials, the images that a
UsdPreviewSurface [1]_ or a surface of MaterialX [2]_ shows are read, and where these lie.

References
----------
.. [1] "UsdPreviewSurface specification", version 2.6. https://openusd.org/release/spec_usdpreviewsurface.html
.. [2] "MaterialX specification", version 1.39, and its nodes `image` and `tiledimage`. https://materialx.org
"""

from __future__ import annotations

import posixpath
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from beltrami_cli.arrays import Array, Float64s, Int64s

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
            if not path or placed(name, path) in layers:  # references within the layer have no path
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
    uses: list[dict[str, dict[str, Any]]] = field(default_factory=list)  # images of each material, by slot
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
        polygons = _Polygons.of(sizes, corners, len(points), turned=bool(turned))
        with np.errstate(over="ignore", invalid="ignore"):
            self.add(positions=points @ matrix[:3, :3] + matrix[3, :3])
        materials = self._materials_of(prim, len(sizes))
        rows = self._colour_rows(prim, polygons)
        of_corners = self._coordinates(prim, polygons, materials) | {
            "corners": polygons.vertex + self._vertices,
            "rows": rows,
            "normals": _normals(mesh, polygons, matrix),
        }
        uses = [self.uses[number] for number in np.unique(materials[materials >= 0]).tolist()]
        read = {use["coordinates"] for each in uses for use in each.values()} or {"st"}
        read |= {"normals", "displayColor", *(["displayOpacity"] if (rows >= 0).any() else [])}
        primvars = UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
        self.counts["further"] += int(any(each.GetPrimvarName() not in read for each in primvars))
        holes = np.array(mesh.GetHoleIndicesAttr().Get(time) or [], np.int64)
        is_kept = sizes >= 3
        is_kept[holes[(holes >= 0) & (holes < len(sizes))]] = False
        mesh_of = np.full(len(sizes), len(self.meshes))
        self.add(sizes=sizes[is_kept], mesh_of=mesh_of[is_kept], material_of=materials[is_kept])
        self.add(**{name: values[np.repeat(is_kept, sizes)] for name, values in of_corners.items()})
        self.meshes.append(prim.GetName())
        self._vertices += len(points)

    def _materials_of(self, prim: Any, count: int) -> Int64s:
        """Return the numbers of the materials that are bound to the polygons of a mesh, or to subsets of these."""
        binding = UsdShade.MaterialBindingAPI(prim)
        found = np.full(count, self._material(binding.ComputeBoundMaterial()[0]))
        for subset in binding.GetMaterialBindSubsets():
            bound = UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0]
            chosen = np.array(subset.GetIndicesAttr().Get() or [], np.int64)
            found[chosen[(chosen >= 0) & (chosen < count)]] = self._material(bound)
        return found

    def _coordinates(self, prim: Any, polygons: _Polygons, materials: Int64s) -> dict[str, Array]:
        """Return the texture coordinates of corners in every slot, and the usual ones."""
        plain, bare = _coordinates(prim, _AS_STORED, polygons), np.full((len(polygons.vertex), 2), np.nan)
        found: dict[str, Array] = {"uv": bare if plain is None else plain}
        for slot in INPUTS:
            uv = found[f"uv {slot}"] = bare.copy()
            for number in np.unique(materials[materials >= 0]).tolist():
                use = self.uses[number].get(slot)
                if use is None:
                    continue
                self.slots.add(slot)
                own = _coordinates(prim, use, polygons)
                if own is None:
                    self.counts["bare"] += 1
                    continue
                in_chosen = np.repeat(materials == number, polygons.sizes)
                uv[in_chosen] = own[in_chosen]
        return found

    def _material(self, material: Any) -> int:
        if not material:
            return -1
        path = str(material.GetPath())
        if path not in self._number_of:
            self._number_of[path] = len(self.materials)
            known, uses = read_material(material)
            self.counts["unread"] += int(known.pop("unread", False))
            self.uses.append(uses)
            self.materials.append(known)
        return self._number_of[path]

    def _colour_rows(self, prim: Any, polygons: _Polygons) -> Int64s:
        """Take the colours of a mesh; return which row of all colours each corner has, -1 where it has none."""
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
            place = {"attribute": str(primvar.GetAttr().GetPath()), "first": self._rows, "count": len(values)}
            self.blocks.append({**place, "type": stored})
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
    def of(cls, sizes: Int64s, corners: Int64s, points: int, *, turned: bool) -> _Polygons:
        ends = np.repeat(np.cumsum(sizes), sizes)
        corner = np.arange(len(corners))
        return cls(
            sizes, 2 * ends - np.repeat(sizes, sizes) - 1 - corner if turned else corner, corners, points
        )

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


def _flat(primvar: Any) -> Float64s | None:
    if not primvar or not primvar.HasValue():
        return None
    values = primvar.ComputeFlattened(Usd.TimeCode.EarliestTime())
    return None if values is None else np.array(values, np.float64)


def _on_corners(primvar: Any, polygons: _Polygons) -> Float64s | None:
    """Return the values of a primvar at the corners of polygons; None if it has none that fit."""
    values = _flat(primvar)
    return None if values is None else polygons.spread(values, str(primvar.GetInterpolation()))


def _coordinates(prim: Any, use: dict[str, Any], polygons: _Polygons) -> Float64s | None:
    """Return the texture coordinates of the corners of polygons, v up, transforms applied."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(use["coordinates"])
    uv = _on_corners(primvar, polygons)
    if uv is None or uv.shape[1:] != (2,):
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        moved: Float64s = uv @ np.array(use["matrix"]) + np.array(use["offset"])
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


# The inputs of a UsdPreviewSurface by slot; the last ones are one image's green and blue.
INPUTS = {
    "baseColor": ("diffuseColor",),
    "emissive": ("emissiveColor",),
    "normal": ("normal",),
    "occlusion": ("occlusion",),
    "metallicRoughness": ("roughness", "metallic"),
}
# Colours of MaterialX surfaces that may be an image each.
_MTLX = {
    "ND_standard_surface_surfaceshader": {"baseColor": "base_color", "emissive": "emission_color"},
    "ND_open_pbr_surface_surfaceshader": {"baseColor": "base_color", "emissive": "emission_color"},
    "ND_gltf_pbr_surfaceshader": {"baseColor": "base_color", "emissive": "emissive"},
    "ND_UsdPreviewSurface_surfaceshader": {"baseColor": "diffuseColor", "emissive": "emissiveColor"},
}
_MTLX_IMAGES = ("ND_image_color3", "ND_image_color4", "ND_tiledimage_color3", "ND_tiledimage_color4")
_MTLX_READERS = {"ND_geompropvalue_vector2": "geomprop", "ND_UsdPrimvarReader_vector2": "varname"}
_MTLX_WRAPS = {"periodic": "repeat", "mirror": "mirror"}
_CHANNELS = {"occlusion": ("r",), "metallicRoughness": ("g", "b")}
_WRAPS = {"repeat": "repeat", "mirror": "mirror"}  # all else shows nothing, or the border
_NUMBERS = ("metallic", "roughness", "opacity", "opacityThreshold")
_COLOURS = ("diffuseColor", "emissiveColor")
_AS_STORED: dict[str, Any] = {"coordinates": "st", "matrix": [[1, 0], [0, 1]], "offset": [0, 0]}
# By slot, the least and most that glTF multiplies an image by, and what it adds; of others 0, 1 and 0.
_SCALES = {"normal": (2, 2, -1), "occlusion": (1, 1, 0)}
_UNFIT = " laid out otherwise than in glTF"
_DEEPEST = 8  # transforms of texture coordinates, one after the other


def placed(layer: str, path: str) -> str:
    """Return where a path in a layer leads, relative to the folder of the root."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))


def read_material(material: Any) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the numbers of a material, and by slot the image that it shows."""
    known: dict[str, Any] = {"name": material.GetPrim().GetName(), "values": {}, "alpha": False, "lost": []}
    uses: dict[str, dict[str, Any]] = {}
    surface = material.ComputeSurfaceSource()[0]
    if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
        uses = _of_materialx(material)
        known["unread"] = not uses and bool(material.GetPrim().GetChildren())
        known["values"] = _factors(uses)
        return known, uses
    for name in (*_NUMBERS, *_COLOURS):
        numbers = _floats(surface, name)
        if len(numbers) == (3 if name in _COLOURS else 1):
            known["values"][name] = numbers if name in _COLOURS else numbers[0]
    for slot, inputs in INPUTS.items():
        found = [use for name in inputs for use in _textures(surface, name)]
        outputs = tuple(use["output"] for use in found)
        is_one = len(found) == len(inputs) and len({use["shader"] for use in found}) == 1
        if is_one and outputs == _CHANNELS.get(slot, outputs):
            uses[slot] = found[0]
        elif found:
            known["lost"].append(f"{slot} maps{_UNFIT}")
    for use in _textures(surface, "opacity"):
        base = uses.get("baseColor", {})
        if use["output"] == "a" and all(use[key] == base.get(key) for key in ("file", *_AS_STORED)):
            known["alpha"], known["values"]["opacity"] = True, use["scale"][3]
        else:
            known["lost"].append(f"opacity maps{_UNFIT}")
    unusual = [slot for slot, use in uses.items() if not _has_usual_scale(slot, use)]
    known["lost"] += [f"the scale or bias of {slot} maps" for slot in unusual]
    known["values"] |= _factors(uses)
    return known, uses


def _has_usual_scale(slot: str, use: dict[str, Any]) -> bool:
    """Return whether materials of glTF can say what the colours of an image are multiplied by, and added to."""
    least, most, bias = _SCALES.get(slot, (0, 1, 0))
    is_scale_fit = all(least <= part <= most for part in use["scale"][:3])
    return is_scale_fit and all(part == bias for part in use["bias"][:3])


def _factors(uses: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Return what images are multiplied by, as the inputs of a surface that they stand for."""
    colours = {slot: INPUTS[slot][0] for slot in ("baseColor", "emissive") if slot in uses}
    factors = {name: uses[slot]["scale"][:3] for slot, name in colours.items()}
    data = "metallicRoughness"
    return factors | (dict(zip(INPUTS[data], uses[data]["scale"][1:3], strict=True)) if data in uses else {})


def _of_materialx(material: Any) -> dict[str, dict[str, Any]]:
    """Return by slot the image that is the colour of a surface of MaterialX."""
    surface = material.ComputeSurfaceSource("mtlx")[0]
    inputs = _MTLX.get(str(surface.GetIdAttr().Get()), {}) if surface else {}
    found = {slot: _textures(surface, name) for slot, name in inputs.items()}
    return {slot: uses[0] for slot, uses in found.items() if uses}


def _sources(shader: Any, name: str) -> list[Any]:
    """Return the attributes that an input of a shader gets its value from, through node graphs and materials."""
    found = shader.GetInput(name)
    return list(found.GetValueProducingAttributes()) if found else []


def _floats(shader: Any, name: str) -> list[float]:
    """Return the numbers of an input of a shader; none if it has no value, or others than finite numbers."""
    sources = _sources(shader, name)
    try:
        numbers = np.array(sources[0].Get() if sources else [], np.float64).ravel()
    except (TypeError, ValueError):
        return []
    return numbers.tolist() if np.isfinite(numbers).all() else []


def _four(shader: Any, name: str, usual: float) -> list[float]:
    """Return an input of four numbers; infinite if they are not known."""
    if not _sources(shader, name):
        return [usual] * 4
    numbers = _floats(shader, name)
    return numbers if len(numbers) == 4 else [np.inf] * 4


def files_of(prim: Any) -> dict[str, str]:
    """Return the attributes of a prim that name a file, each with that file."""
    found = {}
    for attribute in prim.GetAuthoredAttributes():
        value: Any = attribute.Get() if attribute.GetTypeName() == "asset" else None
        if getattr(value, "path", ""):
            found[str(attribute.GetPath())] = placed(_layer_of(attribute), value.path)
    return found


def files_in_variants(stage: Any, layers: list[str]) -> dict[str, str]:
    """Return the files that variants name which are not selected, each by its layer and place there."""
    prims = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    shown = {
        (spec.layer, spec.path)
        for prim in prims
        for attribute in prim.GetAuthoredAttributes()
        if attribute.GetTypeName() == "asset"
        for spec in attribute.GetPropertyStack()
    }
    found: dict[str, str] = {}

    def take(layer: Any, name: str, path: Any) -> None:
        is_shown = not path.ContainsPrimVariantSelection() or (layer, path) in shown
        spec = None if is_shown else layer.GetAttributeAtPath(path)
        value: Any = spec.default if spec and spec.HasInfo("default") else None
        if isinstance(value, Sdf.AssetPath) and value.path:
            where = "" if layer == stage.GetRootLayer() else name  # whatever the root layer is called
            found[f"{where}{path}"] = placed(name, value.path)

    for name in layers:
        layer = Sdf.Layer.FindOrOpen(str(Path.cwd() / name))
        layer.Traverse("/", partial(take, layer, name))
    return found


def _image_of(shader: Any) -> dict[str, str]:
    """Return the attribute that names the image of a shader, with that image; nothing if it shows none."""
    files = _sources(shader, "file") if shader.GetIdAttr().Get() in ("UsdUVTexture", *_MTLX_IMAGES) else []
    authored: Any = files[0].Get() if files else None
    if not getattr(authored, "path", ""):
        return {}
    return {str(files[0].GetPath()): placed(_layer_of(files[0]), authored.path)}


def _textures(surface: Any, name: str) -> list[dict[str, Any]]:
    """Return the image that an input of a surface shows, in a list, if it does."""
    found = []
    for attribute in _sources(surface, name)[:1]:
        shader, output = UsdShade.Shader(attribute.GetPrim()), attribute.GetName()
        is_mtlx = shader.GetIdAttr().Get() in _MTLX_IMAGES
        placing = _placed_by_materialx(shader) if is_mtlx else _placing(shader)
        if not output.startswith("outputs:") or placing is None:
            continue
        shown: dict[str, Any] = {"shader": str(shader.GetPath()), "output": output.removeprefix("outputs:")}
        shown |= {"wrap": _wraps(shader, is_mtlx=is_mtlx)}
        shown |= {"scale": _four(shader, "scale", 1.0), "bias": _four(shader, "bias", 0.0)}
        for path, file in _image_of(shader).items():
            found.append({**placing, **shown, "attribute": path, "file": file})
    return found


def _wraps(shader: Any, *, is_mtlx: bool) -> list[str]:
    """Return what an image shows beyond 0 and 1, along u and along v."""
    names, known, usual = ("wrapS", "wrapT"), _WRAPS, "clamp"
    if is_mtlx:
        names, known, usual = ("uaddressmode", "vaddressmode"), _MTLX_WRAPS, "repeat"
    sources = [_sources(shader, name)[:1] for name in names]
    return [known.get(str(each[0].Get()), "clamp") if each else usual for each in sources]


def _placed_by_materialx(shader: Any) -> dict[str, Any] | None:
    """Return which coordinates an image of MaterialX is shown at, and what moves them, as `_placing`."""
    varname = "st"  # the first coordinates
    for source in _sources(shader, "texcoord")[:1]:
        reader = UsdShade.Shader(source.GetPrim())
        kind = str(reader.GetIdAttr().Get())
        names = _sources(reader, _MTLX_READERS.get(kind, ""))
        is_known = kind in (*_MTLX_READERS, "ND_texcoord_vector2")
        if not is_known or any(number.Get() for number in _sources(reader, "index")):
            return None
        varname = str(names[0].Get()) if names else varname
    inputs = {"uvtiling": 1, "uvoffset": 0, "realworldimagesize": 1, "realworldtilesize": 1}
    tiling, offset, image, tile = (_pair(shader, name, usual) for name, usual in inputs.items())
    if (image == 0).any():
        return None
    scale = tile / image
    matrix, moved = np.diag(tiling * scale), -offset * scale
    return {"coordinates": varname, "matrix": matrix.tolist(), "offset": moved.tolist()}


def _placing(shader: Any) -> dict[str, Any] | None:
    """Return which coordinates a texture is shown at, and the matrix and offset that move them; acts on rows."""
    matrix, offset = np.eye(2), np.zeros(2)
    chain, name = shader, "st"
    for _ in range(_DEEPEST):
        found = _sources(chain, name)
        if not found:
            return None
        chain, name = UsdShade.Shader(found[0].GetPrim()), "in"
        kind = chain.GetIdAttr().Get()
        if kind == "UsdPrimvarReader_float2":
            names = _sources(chain, "varname")
            varname = str(names[0].Get()) if names else ""
            return {"coordinates": varname, "matrix": matrix.tolist(), "offset": offset.tolist()}
        if kind != "UsdTransform2d":
            return None
        scale, move = _pair(chain, "scale", 1), _pair(chain, "translation", 0)
        turns = _sources(chain, "rotation")
        angle = np.deg2rad(float(turns[0].Get())) if turns else 0.0
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        own = np.diag(scale) @ turn
        matrix, offset = own @ matrix, move @ matrix + offset
    return None


def _pair(shader: Any, name: str, usual: int) -> Float64s:
    given = _sources(shader, name)
    return np.array(given[0].Get() if given else (usual, usual), np.float64)


def _layer_of(attribute: Any) -> str:
    """Return the layer that says the value of an attribute, relative to this folder."""
    here = Path.cwd().resolve()
    for spec in attribute.GetPropertyStack():
        if spec.HasInfo("default"):
            return PurePosixPath(Path(spec.layer.realPath).resolve().relative_to(here)).as_posix()
    return ""
