"""Materials of USD scenes: the images of a UsdPreviewSurface [1]_ or a MaterialX surface [2]_, and their mappings.

References
----------
.. [1] "UsdPreviewSurface specification", version 2.6. https://openusd.org/release/spec_usdpreviewsurface.html
.. [2] "MaterialX specification", version 1.39, and its nodes `image` and `tiledimage`. https://materialx.org
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pxr import UsdShade

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.usd.contents import INPUTS, MaterialInputs
from beltrami_cli.formats.usd.stage import layer_of, placed
from beltrami_cli.surface.records import Slot, Wrap

# The colour inputs of MaterialX surfaces; an image may be connected to each.
_MTLX: dict[str, dict[Slot, str]] = {
    "ND_standard_surface_surfaceshader": {"baseColor": "base_color", "emissive": "emission_color"},
    "ND_open_pbr_surface_surfaceshader": {"baseColor": "base_color", "emissive": "emission_color"},
    "ND_gltf_pbr_surfaceshader": {"baseColor": "base_color", "emissive": "emissive"},
    "ND_UsdPreviewSurface_surfaceshader": {"baseColor": "diffuseColor", "emissive": "emissiveColor"},
}
_MTLX_IMAGES = ("ND_image_color3", "ND_image_color4", "ND_tiledimage_color3", "ND_tiledimage_color4")
_MTLX_READERS = {"ND_geompropvalue_vector2": "geomprop", "ND_UsdPrimvarReader_vector2": "varname"}
_MTLX_WRAPS = {"periodic": "repeat", "mirror": "mirror"}
_WRAPS = {"repeat": "repeat", "mirror": "mirror"}  # other modes show nothing beyond the image, or its border
_NUMBERS = ("metallic", "roughness", "opacity", "opacityThreshold")
_COLOURS = ("diffuseColor", "emissiveColor")
# The scale and bias of an image by slot. In other slots the scale becomes a factor of the material, and the bias is 0.
_SCALES: dict[Slot, tuple[int, int]] = {"normal": (2, -1), "occlusion": (1, 0)}
# Further inputs of a UsdPreviewSurface, and the values by which they have no effect [1]_.
_NEUTRAL = {"useSpecularWorkflow": 0.0, "clearcoat": 0.0, "ior": 1.5, "displacement": 0.0}
_UNFIT = " laid out otherwise than in glTF"
_MAX_TRANSFORMS = 8  # of texture coordinates in a chain, which may be a cycle


@dataclass(frozen=True)
class UvMapping:
    """The texture coordinates of an image, and the affine map that is applied to them as rows."""

    primvar: str
    matrix: tuple[tuple[float, ...], ...]  # (2, 2)
    offset: tuple[float, ...]  # (2,)

    @classmethod
    def of(cls, primvar: str, matrix: Float64s, offset: Float64s) -> UvMapping:
        return cls(primvar, tuple(map(tuple, matrix.tolist())), tuple(offset.tolist()))


AS_STORED = UvMapping("st", ((1, 0), (0, 1)), (0, 0))


@dataclass(frozen=True)
class ShownImage:
    """An image as an input of a surface shows it."""

    file: str  # relative to the folder of the root layer
    attribute: str  # path of the attribute that names the file
    shader: str  # path of the texture's shader
    output: str  # "rgb", or one channel
    wrap: tuple[Wrap, Wrap]
    mapping: UvMapping
    scale: tuple[float, ...] | None  # (4,); None: not known
    bias: tuple[float, ...] | None

    @property
    def factors(self) -> tuple[float, ...]:
        return self.scale or (1.0,) * 4


def read_material(material: Any) -> tuple[MaterialInputs, dict[Slot, ShownImage]]:
    """Return the inputs of a material, and the image that it shows in each slot."""
    inputs, images = MaterialInputs(material.GetPrim().GetName()), dict[Slot, ShownImage]()
    surface = material.ComputeSurfaceSource()[0]
    if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
        images = _of_materialx(material)
        inputs.is_unread = not images and bool(material.GetPrim().GetChildren())
        inputs.values = _factors(images)
        return inputs, images
    for name in (*_NUMBERS, *_COLOURS):
        numbers = _floats(surface, name)
        if len(numbers) == (3 if name in _COLOURS else 1):
            inputs.values[name] = numbers if name in _COLOURS else numbers[0]
    for slot, wanted in INPUTS.items():
        found = [(shown, each) for each in wanted if (shown := _image_at(surface, each.name)) is not None]
        is_one = len(found) == len(wanted) and len({shown.shader for shown, _ in found}) == 1
        if is_one and all(each.type != "float" or shown.output == each.channel for shown, each in found):
            images[slot] = found[0][0]
        elif found:
            inputs.lost.append(f"{slot} maps{_UNFIT}")
    opacity, base = _image_at(surface, "opacity"), images.get("baseColor")
    if opacity is not None:
        is_of_base = base is not None and (opacity.file, opacity.mapping) == (base.file, base.mapping)
        if opacity.output == "a" and is_of_base:
            inputs.has_alpha, inputs.values["opacity"] = True, opacity.factors[3]
        else:
            inputs.lost.append(f"opacity maps{_UNFIT}")
    unusual = [slot for slot, shown in images.items() if not _is_scale_expressible(slot, shown)]
    inputs.lost += [f"the scale or bias of {slot} maps" for slot in unusual]
    inputs.lost += [name for name, neutral in _NEUTRAL.items() if _has_effect(surface, name, neutral)]
    inputs.values |= _factors(images)
    return inputs, images


def _is_scale_expressible(slot: Slot, shown: ShownImage) -> bool:
    """Whether a `Material` can express the scale and bias of an image."""
    if shown.scale is None or shown.bias is None:
        return False
    scale, bias = _SCALES.get(slot, (None, 0))
    return {*shown.bias[:3]} == {bias} and (scale is None or {*shown.scale[:3]} == {scale})


def _has_effect(surface: Any, name: str, neutral: float) -> bool:
    return bool(_sources(surface, name)) and _floats(surface, name) != [neutral]


def _factors(images: Mapping[Slot, ShownImage]) -> dict[str, Any]:
    """Return the scales of images as values of the inputs that the images replace."""
    colours: tuple[Slot, ...] = ("baseColor", "emissive")
    factors: dict[str, Any] = {
        INPUTS[slot][0].name: [*images[slot].factors[:3]] for slot in colours if slot in images
    }
    if "metallicRoughness" in images:
        data = images["metallicRoughness"].factors[1:3]
        factors |= zip(("roughness", "metallic"), data, strict=True)
    return factors


def _of_materialx(material: Any) -> dict[Slot, ShownImage]:
    """Return the colour images of a MaterialX surface, by slot."""
    surface = material.ComputeSurfaceSource("mtlx")[0]
    inputs = _MTLX.get(str(surface.GetIdAttr().Get()), {}) if surface else {}
    shown_in = {slot: _image_at(surface, name) for slot, name in inputs.items()}
    return {slot: shown for slot, shown in shown_in.items() if shown is not None}


def _sources(shader: Any, name: str) -> list[Any]:
    """Return the attributes that give an input its value, through node graphs and materials."""
    given = shader.GetInput(name)
    return list(given.GetValueProducingAttributes()) if given else []


def _floats(shader: Any, name: str) -> list[float]:
    """Return the numbers of an input; empty unless they are finite."""
    sources = _sources(shader, name)
    try:
        numbers = np.array(sources[0].Get() if sources else [], np.float64).ravel()
    except (TypeError, ValueError):
        return []
    return numbers.tolist() if np.isfinite(numbers).all() else []


def _four(shader: Any, name: str, usual: float) -> tuple[float, ...] | None:
    """Return an input of four numbers, None if they are unknown."""
    if not _sources(shader, name):
        return (usual,) * 4
    numbers = _floats(shader, name)
    return tuple(numbers) if len(numbers) == 4 else None


def _image_at(surface: Any, name: str) -> ShownImage | None:
    """Return the image of an input of a surface; None if there is none, or it is not supported."""
    sources = _sources(surface, name)
    if not sources:
        return None
    shader, output = UsdShade.Shader(sources[0].GetPrim()), sources[0].GetName()
    kind = shader.GetIdAttr().Get()
    is_mtlx = kind in _MTLX_IMAGES
    mapping = _mapping_of_materialx(shader) if is_mtlx else _mapping_of(shader)
    files = _sources(shader, "file") if kind in ("UsdUVTexture", *_MTLX_IMAGES) else []
    authored: Any = files[0].Get() if files else None
    if not output.startswith("outputs:") or mapping is None or not getattr(authored, "path", ""):
        return None
    return ShownImage(
        file=placed(layer_of(files[0]), authored.path),
        attribute=str(files[0].GetPath()),
        shader=str(shader.GetPath()),
        output=output.removeprefix("outputs:"),
        wrap=_wraps(shader, is_mtlx=is_mtlx),
        mapping=mapping,
        scale=_four(shader, "scale", 1.0),
        bias=_four(shader, "bias", 0.0),
    )


def _wraps(shader: Any, *, is_mtlx: bool) -> tuple[Wrap, Wrap]:
    """Return the wrap modes of an image along u and v."""
    names, modes_of, usual = ("wrapS", "wrapT"), _WRAPS, "clamp"
    if is_mtlx:
        names, modes_of, usual = ("uaddressmode", "vaddressmode"), _MTLX_WRAPS, "repeat"
    u, v = (_sources(shader, name)[:1] for name in names)
    modes: list[Any] = [modes_of.get(str(each[0].Get()), "clamp") if each else usual for each in (u, v)]
    return modes[0], modes[1]


def _mapping_of_materialx(shader: Any) -> UvMapping | None:
    """Return the mapping of a MaterialX image; None if it is not supported."""
    varname = "st"  # the first set of coordinates
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
    return UvMapping.of(varname, matrix, moved)


def _mapping_of(shader: Any) -> UvMapping | None:
    """Return the mapping of a texture, through a chain of transforms; None if it is not supported."""
    matrix, offset = np.eye(2), np.zeros(2)
    chain, name = shader, "st"
    for _ in range(_MAX_TRANSFORMS):
        sources = _sources(chain, name)
        if not sources:
            return None
        chain, name = UsdShade.Shader(sources[0].GetPrim()), "in"
        kind = chain.GetIdAttr().Get()
        if kind == "UsdPrimvarReader_float2":
            names = _sources(chain, "varname")
            varname = str(names[0].Get()) if names else ""
            return UvMapping.of(varname, matrix, offset)
        if kind != "UsdTransform2d":
            return None
        scale, move = _pair(chain, "scale", 1), _pair(chain, "translation", 0)
        turns = _sources(chain, "rotation")
        angle = np.deg2rad(float(turns[0].Get())) if turns else 0.0
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        step = np.diag(scale) @ turn
        matrix, offset = step @ matrix, move @ matrix + offset
    return None


def _pair(shader: Any, name: str, usual: int) -> Float64s:
    given = _sources(shader, name)
    return np.array(given[0].Get() if given else (usual, usual), np.float64)
