"""Images at the inputs of surfaces: UsdUVTexture [1]_ and images of MaterialX [2]_, and how they are placed.

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
from beltrami_cli.formats.usd.stage import layer_of, placed
from beltrami_cli.surface.records import Slot, Wrap

_MTLX_IMAGES = ("ND_image_color3", "ND_image_color4", "ND_tiledimage_color3", "ND_tiledimage_color4")
_MTLX_READERS = {"ND_geompropvalue_vector2": "geomprop", "ND_UsdPrimvarReader_vector2": "varname"}
_MTLX_WRAPS = {"periodic": "repeat", "mirror": "mirror"}
_WRAPS = {"repeat": "repeat", "mirror": "mirror"}  # other modes show nothing beyond the image, or its border
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

    def is_at(self, other: ShownImage) -> bool:
        """Whether it is the same image in the same place; each may have a shader of its own."""
        return (self.file, self.mapping) == (other.file, other.mapping)


SlotImages = Mapping[Slot, ShownImage]
"""The images of a material."""


def sources_of(shader: Any, name: str) -> list[Any]:
    """Return the attributes that give an input its value, through node graphs and materials."""
    given = shader.GetInput(name)
    return list(given.GetValueProducingAttributes()) if given else []


def numbers_of(shader: Any, name: str) -> list[float]:
    """Return the numbers of an input; empty unless they are finite."""
    sources = sources_of(shader, name)
    try:
        numbers = np.array(sources[0].Get() if sources else [], np.float64).ravel()
    except (TypeError, ValueError):
        return []
    return numbers.tolist() if np.isfinite(numbers).all() else []


def _four(shader: Any, name: str, usual: float) -> tuple[float, ...] | None:
    """Return an input of four numbers, None if they are unknown."""
    if not sources_of(shader, name):
        return (usual,) * 4
    numbers = numbers_of(shader, name)
    return tuple(numbers) if len(numbers) == 4 else None


def image_at(surface: Any, name: str) -> ShownImage | None:
    """Return the image of an input of a surface; None if there is none, or it is not supported."""
    sources = sources_of(surface, name)
    if not sources:
        return None
    shader, output = UsdShade.Shader(sources[0].GetPrim()), sources[0].GetName()
    kind = shader.GetIdAttr().Get()
    is_mtlx = kind in _MTLX_IMAGES
    mapping = _mapping_of_materialx(shader) if is_mtlx else _mapping_of(shader)
    files = sources_of(shader, "file") if kind in ("UsdUVTexture", *_MTLX_IMAGES) else []
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
    u, v = (sources_of(shader, name)[:1] for name in names)
    modes: list[Any] = [modes_of.get(str(each[0].Get()), "clamp") if each else usual for each in (u, v)]
    return modes[0], modes[1]


def _mapping_of_materialx(shader: Any) -> UvMapping | None:
    """Return the mapping of a MaterialX image; None if it is not supported."""
    varname = "st"  # the first set of coordinates
    for source in sources_of(shader, "texcoord")[:1]:
        reader = UsdShade.Shader(source.GetPrim())
        kind = str(reader.GetIdAttr().Get())
        names = sources_of(reader, _MTLX_READERS.get(kind, ""))
        is_known = kind in (*_MTLX_READERS, "ND_texcoord_vector2")
        if not is_known or any(number.Get() for number in sources_of(reader, "index")):
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
        sources = sources_of(chain, name)
        if not sources:
            return None
        chain, name = UsdShade.Shader(sources[0].GetPrim()), "in"
        kind = chain.GetIdAttr().Get()
        if kind == "UsdPrimvarReader_float2":
            names = sources_of(chain, "varname")
            varname = str(names[0].Get()) if names else ""
            return UvMapping.of(varname, matrix, offset)
        if kind != "UsdTransform2d":
            return None
        scale, move = _pair(chain, "scale", 1), _pair(chain, "translation", 0)
        turns = sources_of(chain, "rotation")
        angle = np.deg2rad(float(turns[0].Get())) if turns else 0.0
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        step = np.diag(scale) @ turn
        matrix, offset = step @ matrix, move @ matrix + offset
    return None


def _pair(shader: Any, name: str, usual: int) -> Float64s:
    given = sources_of(shader, name)
    return np.array(given[0].Get() if given else (usual, usual), np.float64)
