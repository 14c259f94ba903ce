"""Write a mesh as a new USD layer or package, with vertex colours or with materials and their textures.

The layer is written as text, and turned into the binary form by usd-core.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np

from beltrami_cli.arrays import Array, Int32s
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.colours import linear_colours
from beltrami_cli.formats.meshes.writing import (
    image_names,
    material_names,
    normals_of_corners,
    not_converted,
    plain_name,
)
from beltrami_cli.formats.usd.layers import binary_layer
from beltrami_cli.formats.usd.package import packed
from beltrami_cli.formats.usd.preview_surface import SURFACE_SLOTS, SurfaceSlot, input_values
from beltrami_cli.surface.grouping import group_equal_rows
from beltrami_cli.surface.large_arrays import blocks
from beltrami_cli.surface.precision import shortest_type
from beltrami_cli.surface.records import Frame, Material, MeshContents, MeshImage

_BLOCK = 1 << 16  # rows written at a time
_UNFIT = re.compile(r"\W", re.ASCII)
_PLAIN = '        uniform token subdivisionScheme = "none"\n'
_BOUND = '        prepend apiSchemas = ["MaterialBindingAPI"]\n'
_UNSCALED = (1, 1, 1, 1)
_TYPES = {"rgb": "float3", "r": "float", "g": "float", "b": "float", "a": "float"}


def _written(suffix: str, mesh: MeshContents, stem: str) -> Written:
    names = _prim_names(
        material_names(mesh.materials), [f"mesh_{number}" for number in range(len(mesh.groups))]
    )
    file_of = dict(zip(mesh.images, image_names(mesh, stem), strict=True))
    root, notices = _identifier(stem), list[str]()
    shown = _colours(mesh, notices) if mesh.colours.shape[1] else []
    is_divided = len(np.unique(mesh.group_numbers)) > 1
    text = [_header(root, mesh.frame)]
    for number, group in enumerate(mesh.groups):
        polygons = np.flatnonzero(mesh.group_numbers == number)
        if len(mesh.groups) > 1 and not len(polygons):
            continue
        part = mesh.polygons(polygons)
        text += [_mesh_head(number, group, is_bound=bool(names))]
        text += _mesh(part, [] if is_divided else shown, notices)
        text += _subsets(part.material_numbers, names, root) if names else []
        text += [b"    }\n"]
    if shown and is_divided:
        parts = "since the mesh is in several parts"
        notices.append(f"Vertex colours are left out where there are textures, {parts}.")
    for name, material in zip(names, mesh.materials, strict=True):
        text += [_material(name, material, file_of, f"/{root}/{name}").encode()]
    text += [b"}\n"]
    images = {name: image.file.data for image, name in file_of.items()}
    notices += not_converted(mesh, keeps_frame=True)
    return _finished(suffix, b"".join(text), stem, images, notices)


def _finished(suffix: str, text: bytes, stem: str, images: dict[str, bytes], notices: list[str]) -> Written:
    if suffix == ".usda":
        return Written([text], images, tuple(notices))
    layer = binary_layer(text, stem)
    if suffix == ".usdc":
        return Written([layer], images, tuple(notices))
    return Written(packed({f"{stem}.usdc": layer, **images}), notices=tuple(notices))


def _header(name: str, frame: Frame) -> bytes:
    lines = [
        "#usda 1.0",
        f'(\n    defaultPrim = "{name}"\n    metersPerUnit = {frame.unit:.9g}\n    upAxis = "{frame.up}"\n)\n',
        f'def Xform "{name}" (\n    kind = "component"\n)\n{{\n',
    ]
    return "\n".join(lines).encode()


def _mesh_head(number: int, group: str, *, is_bound: bool) -> bytes:
    bound = f" (\n{_BOUND}    )" if is_bound else ""
    name = plain_name(group).replace("\\", "\\\\").replace('"', '\\"')
    shown_name = f'        string ui:displayName = "{name}"\n' if name else ""
    return f'    def Mesh "mesh_{number}"{bound}\n    {{\n{_PLAIN}{shown_name}'.encode()


def _mesh(mesh: MeshContents, shown: list[bytes], notices: list[str]) -> Iterator[bytes]:
    """Yield the lines of the geometry: used points, polygons, colours, texture coordinates and normals."""
    used: Array = np.arange(len(mesh.positions))
    corners: Array = mesh.corners
    if not shown:
        used, corners = np.unique(corners, return_inverse=True)
    yield from _array("point3f[] points", shortest_type(mesh.positions[used]), 3)
    yield from _array("int[] faceVertexCounts", mesh.sizes[:, None])
    yield from _array("int[] faceVertexIndices", corners.reshape(-1, 1))
    yield from shown
    on = 'interpolation = "faceVarying"'
    if mesh.uv is not None:
        # Corners without coordinates have no texture, so their values do not matter.
        uv = np.nan_to_num(mesh.uv) * [1, -1] + [0, 1]
        index_of, chosen = group_equal_rows(*uv.T)
        yield from _array("texCoord2f[] primvars:st", uv[chosen].astype(np.float32), 2, on)
        yield from _array("int[] primvars:st:indices", index_of[:, None])
    if mesh.normals is not None:
        yield from _array("normal3f[] normals", mesh.normals[used], 3, 'interpolation = "vertex"')
        return
    normals, lost = normals_of_corners(mesh)
    notices += lost
    if normals is not None:
        yield from _array("normal3f[] normals", normals, 3, on)


def _subsets(material_of: Int32s, names: list[str], root: str) -> Iterator[bytes]:
    """Yield the lines that bind materials: one for all triangles, or a subset for each."""
    shown = np.unique(material_of).tolist()
    if len(shown) == 1:
        yield f"        rel material:binding = </{root}/{names[shown[0]]}>\n".encode()
        return
    yield b'        uniform token subsetFamily:materialBind:familyType = "partition"\n'
    for number in shown:
        yield f'        def GeomSubset "of_{names[number]}" (\n    {_BOUND}        )\n        {{\n'.encode()
        yield b'            uniform token elementType = "face"\n'
        yield b'            uniform token familyName = "materialBind"\n'
        yield from _array("int[] indices", np.flatnonzero(material_of == number)[:, None])
        yield f"            rel material:binding = </{root}/{names[number]}>\n        }}\n".encode()


def _material(name: str, material: Material, file_of: dict[MeshImage, str], path: str) -> str:
    """Return the lines of a material with a UsdPreviewSurface."""
    values = input_values(material)
    inputs = {
        target: f"color3f inputs:{target} = {_row(value)}" if isinstance(value, list)
        else f"float inputs:{target} = {value:.6g}"
        for target, value in values.items()
    }  # fmt: skip
    shaders = []
    for slot, shown in material.maps.items():
        described, alpha = SURFACE_SLOTS[slot], 1.0
        outputs = {each.channel for each in described.inputs}
        for target, kind, channel in described.inputs:
            inputs[target] = f"{kind} inputs:{target}.connect = <{path}/{slot}.outputs:{channel}>"
        if slot == "baseColor":
            alpha = material.opacity
            if material.alpha != "opaque":
                outputs.add("a")
                inputs["opacity"] = f"float inputs:opacity.connect = <{path}/baseColor.outputs:a>"
        lines = [
            *_texture(file_of[shown.image], shown.wrap, described, path),
            *_scale_and_bias((*described.scale(values), alpha), described.bias),
            *(f"{_TYPES[output]} outputs:{output}" for output in sorted(outputs)),
        ]
        shaders.append(_shader(slot, lines))
    lines = ['uniform token info:id = "UsdPreviewSurface"', *inputs.values(), "token outputs:surface"]
    reader = ['uniform token info:id = "UsdPrimvarReader_float2"', 'string inputs:varname = "st"']
    shaders = [_shader("surface", lines), _shader("st", [*reader, "float2 outputs:result"]), *shaders]
    surface = f"        token outputs:surface.connect = <{path}/surface.outputs:surface>\n"
    return f'    def Material "{name}"\n    {{\n{surface}{"".join(shaders)}    }}\n'


def _texture(file: str, wrap: tuple[str, str], slot: SurfaceSlot, path: str) -> list[str]:
    return [
        'uniform token info:id = "UsdUVTexture"',
        f"asset inputs:file = @./{file}@",
        f"float2 inputs:st.connect = <{path}/st.outputs:result>",
        f'token inputs:wrapS = "{wrap[0]}"',
        f'token inputs:wrapT = "{wrap[1]}"',
        f'token inputs:sourceColorSpace = "{"sRGB" if slot.is_colour else "raw"}"',
    ]


def _scale_and_bias(scale: tuple[float, ...], bias: int) -> list[str]:
    lines = [f"float4 inputs:scale = {_row(scale)}"] if scale != _UNSCALED else []
    return lines + ([f"float4 inputs:bias = {_row((bias,) * 3 + (0,))}"] if bias else [])


def _shader(name: str, lines: Sequence[str]) -> str:
    body = "".join(f"            {line}\n" for line in lines)
    return f'        def Shader "{name}"\n        {{\n{body}        }}\n'


def _colours(contents: MeshContents, notices: list[str]) -> list[bytes]:
    """Return the lines of vertex colours, in linear light, and their opacity."""
    colours, conversions = linear_colours(contents, "USD has them")
    notices += conversions
    on = 'interpolation = "vertex"'
    lines = [*_array("color3f[] primvars:displayColor", colours, 3, on)]
    if contents.alpha is not None:
        lines += _array("float[] primvars:displayOpacity", contents.alpha[:, None], 1, on)
    return lines


def _array(name: str, rows: Array, width: int = 1, metadata: str = "") -> Iterator[bytes]:
    """Yield the lines of an attribute, with the shortest numbers that read back as the same values."""
    yield f"        {name} = [".encode()
    for block in blocks(len(rows), _BLOCK):
        columns: list[list[str]] = rows[block].T.astype("U32").tolist()
        joined = (", ".join(row) for row in zip(*columns, strict=True))
        text = ", ".join(f"({row})" if width > 1 else row for row in joined)
        yield ((", " if block.start else "") + text).encode()
    yield f"] (\n            {metadata}\n        )\n".encode() if metadata else b"]\n"


def _row(values: Sequence[float]) -> str:
    return "({})".format(", ".join(f"{value:.6g}" for value in values))


def _prim_names(names: Sequence[str], taken: Iterable[str]) -> list[str]:
    """Return identifiers for some names that differ from each other and from those that are taken."""
    prims, used = list[str](), set(taken)
    for number, name in enumerate(map(_identifier, names)):
        numbered = (f"{name}_{further}" for further in itertools.count(number))
        prims.append(next(each for each in itertools.chain([name], numbered) if each not in used))
        used.add(prims[-1])
    return prims


def _identifier(name: str) -> str:
    plain = _UNFIT.sub("_", name)
    return plain if plain[:1].isalpha() or plain[:1] == "_" else f"_{plain}"


write_usda, write_usdc, write_usdz = (partial(_written, suffix) for suffix in (".usda", ".usdc", ".usdz"))
