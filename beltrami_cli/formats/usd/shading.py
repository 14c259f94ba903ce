"""The materials of a USD scene: the images that a UsdPreviewSurface shows, and where.

References
----------
.. [1] "UsdPreviewSurface specification", version 2.6. https://openusd.org/release/spec_usdpreviewsurface.html
"""

from __future__ import annotations

import posixpath
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

# The inputs of a UsdPreviewSurface by slot; those of the last are one image's green and blue.
INPUTS = {
    "baseColor": ("diffuseColor",),
    "emissive": ("emissiveColor",),
    "normal": ("normal",),
    "occlusion": ("occlusion",),
    "metallicRoughness": ("roughness", "metallic"),
}
_CHANNELS = {"occlusion": ("r",), "metallicRoughness": ("g", "b")}
_WRAPS = {"repeat": "repeat", "mirror": "mirror"}  # all else shows nothing, or the border
_NUMBERS = ("metallic", "roughness", "opacity", "opacityThreshold")
_COLOURS = ("diffuseColor", "emissiveColor")
_DEEPEST = 8  # transforms of texture coordinates, one after the other


def placed(layer: str, path: str) -> str:
    """Return where a path in a layer leads, relative to the folder of the root."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(layer), path))


def read_material(material: Any) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """Return the numbers of a material, and by slot the image that it shows."""
    surface = material.ComputeSurfaceSource()[0]
    known: dict[str, Any] = {"name": material.GetPrim().GetName(), "values": {}, "alpha": False}
    uses: dict[str, dict[str, Any]] = {}
    if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
        return known, uses
    for name in (*_NUMBERS, *_COLOURS):
        sources = _sources(surface, name)
        value = sources[0].Get() if sources and sources[0].GetTypeName() != "token" else None
        if isinstance(value, (int, float)):
            known["values"][name] = float(value)
        elif value is not None and len(value) == 3:
            known["values"][name] = [float(part) for part in value]
    known["alpha"] = bool(_textures(surface, "opacity"))
    for slot, inputs in INPUTS.items():
        found = [use for name in inputs for use in _textures(surface, name)]
        if len(found) != len(inputs) or len({use["shader"] for use in found}) != 1:
            continue
        if tuple(use["output"] for use in found) == _CHANNELS.get(slot, (found[0]["output"],)):
            uses[slot] = found[0]
    return known, uses


def _sources(shader: Any, name: str) -> list[Any]:
    """Return the attributes that an input of a shader gets its value from, through node graphs and materials."""
    found = shader.GetInput(name)
    return list(found.GetValueProducingAttributes()) if found else []


def image_of(shader: Any) -> dict[str, str]:
    """Return the attribute that names the image of a shader, with that image; nothing if it shows none."""
    files = _sources(shader, "file") if shader.GetIdAttr().Get() == "UsdUVTexture" else []
    authored: Any = files[0].Get() if files else None
    if not getattr(authored, "path", ""):
        return {}
    return {str(files[0].GetPath()): placed(_layer_of(files[0]), authored.path)}


def _textures(surface: Any, name: str) -> list[dict[str, Any]]:
    """Return the image that an input of a surface shows, in a list, if it does."""
    from pxr import UsdShade

    for attribute in _sources(surface, name)[:1]:
        shader = UsdShade.Shader(attribute.GetPrim())
        placing, shown = _placing(shader), image_of(shader)
        if not attribute.GetName().startswith("outputs:") or placing is None or not shown:
            continue
        ((path, file),) = shown.items()
        wraps = [_sources(shader, wrap)[:1] for wrap in ("wrapS", "wrapT")]
        return [
            {
                **placing,
                "shader": str(shader.GetPath()),
                "attribute": path,
                "file": file,
                "output": attribute.GetName().removeprefix("outputs:"),
                "wrap": [_WRAPS.get(str(wrap[0].Get()), "clamp") if wrap else "clamp" for wrap in wraps],
            }
        ]
    return []


def _placing(shader: Any) -> dict[str, Any] | None:
    """Return which coordinates a texture is shown at, and the matrix and offset that move them; acts on rows."""
    from pxr import UsdShade

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
        scale, move = (
            np.array(given[0].Get() if given else default, np.float64)
            for given, default in (
                (_sources(chain, "scale"), (1, 1)),
                (_sources(chain, "translation"), (0, 0)),
            )
        )
        turns = _sources(chain, "rotation")
        angle = np.deg2rad(float(turns[0].Get())) if turns else 0.0
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        own = np.diag(scale) @ turn
        matrix, offset = own @ matrix, move @ matrix + offset
    return None


def _layer_of(attribute: Any) -> str:
    """Return the layer that says the value of an attribute, relative to this folder."""
    here = Path.cwd().resolve()
    for spec in attribute.GetPropertyStack():
        if spec.HasInfo("default"):
            return PurePosixPath(Path(spec.layer.realPath).resolve().relative_to(here)).as_posix()
    return ""
