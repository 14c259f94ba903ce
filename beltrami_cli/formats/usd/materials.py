"""Materials of USD scenes: the images that a UsdPreviewSurface [1]_ or a surface of MaterialX [2]_ shows, and where.

References
----------
.. [1] "UsdPreviewSurface specification", version 2.6. https://openusd.org/release/spec_usdpreviewsurface.html
.. [2] "MaterialX specification", version 1.39, and its nodes `image` and `tiledimage`. https://materialx.org
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import UsdShade

from beltrami_cli.arrays import Float64s
from beltrami_cli.formats.usd.stage import layer_of, placed

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
AS_STORED: dict[str, Any] = {"coordinates": "st", "matrix": [[1, 0], [0, 1]], "offset": [0, 0]}
# By slot, the least and most that glTF multiplies an image by, and what it adds; of others 0, 1 and 0.
_SCALES = {"normal": (2, 2, -1), "occlusion": (1, 1, 0)}
_UNFIT = " laid out otherwise than in glTF"
_DEEPEST = 8  # transforms of texture coordinates, one after the other


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
        if use["output"] == "a" and all(use[key] == base.get(key) for key in ("file", *AS_STORED)):
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


def _image_of(shader: Any) -> dict[str, str]:
    """Return the attribute that names the image of a shader, with that image; nothing if it shows none."""
    files = _sources(shader, "file") if shader.GetIdAttr().Get() in ("UsdUVTexture", *_MTLX_IMAGES) else []
    authored: Any = files[0].Get() if files else None
    if not getattr(authored, "path", ""):
        return {}
    return {str(files[0].GetPath()): placed(layer_of(files[0]), authored.path)}


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
