"""USD scenes as programs write them, made by usd-core itself where they are binary or packages."""

import zipfile

import numpy as np

from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.sidecars.tile_names import tile_name
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from formats.image_files import encode
from formats.tile_files import TILES, part, phantom, sheet

GIVEN = SmoothSettings(KernelParameters(iterations=1, beta=20))
HEADER = '#usda 1.0\n(\n    defaultPrim = "scan"\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n'
PICTURE = encode(phantom(), "png")
POINTS, _, QUADS = sheet()
COLOURS = np.random.default_rng(5).random((64, 3)).astype(np.float32).round(3)


def rows(values):
    """Return an array as the text of a layer."""
    table = np.asarray(values)
    if table.ndim == 1:
        return "[" + ", ".join(map(repr, table.tolist())) + "]"
    return "[" + ", ".join("(" + ", ".join(map(repr, row)) + ")" for row in table.tolist()) + "]"


def mesh_text(extra="", name="mesh", metadata=""):
    """Return the waved sheet of `tile_files` as a prim; its coordinates are from 0 to 1, of corners, with indices."""
    positions, uv, quads = sheet()
    return (
        f'    def Mesh "{name}" ({metadata} prepend apiSchemas = ["MaterialBindingAPI"] )\n    {{\n'
        f"        point3f[] points = {rows(positions.round(6))}\n"
        f"        int[] faceVertexCounts = {rows(np.full(len(quads), 4))}\n"
        f"        int[] faceVertexIndices = {rows(quads.ravel())}\n"
        f'        texCoord2f[] primvars:st = {rows((uv / 2).round(6))} ( interpolation = "faceVarying" )\n'
        f"        int[] primvars:st:indices = {rows(quads.ravel())}\n{extra}    }}\n"
    )


def block(kind, name, *lines):
    """Return a prim below another one, of a material, with these lines, which may be prims."""
    body = "".join(line if line.endswith("\n") else f"            {line}\n" for line in lines)
    return f'        def {kind} "{name}"\n        {{\n{body}        }}\n'


def shader(name, kind, *lines):
    return block("Shader", name, f'uniform token info:id = "{kind}"', *lines)


def material_text(image, path="/scan/skin", reader="st", extra=""):
    surface = shader(
        "surface",
        "UsdPreviewSurface",
        f"color3f inputs:diffuseColor.connect = <{path}/diffuse.outputs:rgb>",
        "float inputs:roughness = 1",
        "token outputs:surface",
    )
    diffuse = shader(
        "diffuse",
        "UsdUVTexture",
        f"asset inputs:file = @{image}@",
        f"float2 inputs:st.connect = <{path}/{reader}.outputs:result>",
        'token inputs:wrapS = "repeat"',
        'token inputs:wrapT = "mirror"',
        "float3 outputs:rgb",
    )
    st = shader("st", "UsdPrimvarReader_float2", 'token inputs:varname = "st"', "float2 outputs:result")
    shown = f"token outputs:surface.connect = <{path}/surface.outputs:surface>"
    return block("Material", path.rpartition("/")[2], shown, surface, diffuse, st, extra)


BOUND = "        rel material:binding = </scan/skin>\n"


def scene(*prims, header=HEADER):
    return header + 'def Xform "scan" ( kind = "component" )\n{\n' + "".join(prims) + "}\n"


def coloured(colours, kind="color3f", on="vertex", indices=""):
    """Return the lines of vertex colours."""
    lines = f'        {kind}[] primvars:displayColor = {rows(colours)} ( interpolation = "{on}" )\n'
    return lines + (f"        int[] primvars:displayColor:indices = {indices}\n" if indices else "")


def smoothed(folder, **settings):
    """Smooth a scene, of which nothing but colours may change; return what it is then."""
    report = smooth_file(folder / "a.usda", folder / "b.usda", GIVEN, **settings)
    assert check_files(folder / "a.usda", report.output).faithful
    return open_document(report.output)


def phone_scan(folder, *, udim=False):
    """Write a package to the layout of Object Capture: a binary layer, and its images in a folder."""
    from pxr import Sdf, UsdUtils

    (folder / "0").mkdir(parents=True)
    pattern = "0/baked_tex0.<UDIM>.png" if udim else "0/baked_tex0.png"
    mesh = mesh_text(BOUND)
    if udim:
        for tile in TILES:
            (folder / tile_name(pattern, tile)).write_bytes(encode(part(phantom(), tile), "png"))
        mesh = mesh.replace(rows((sheet()[1] / 2).round(6)), rows(sheet()[1].round(6)))
    else:
        (folder / pattern).write_bytes(encode(phantom(), "png"))
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString(scene(mesh, material_text(pattern)))
    layer.Export(str(folder / "baked.usdc"))
    assert UsdUtils.CreateNewUsdzPackage(str(folder / "baked.usdc"), str(folder / "scan.usdz"))
    return folder / "scan.usdz"


def members(path):
    """Return the files of a package; each must be stored at a multiple of 64 bytes."""
    found = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            data = archive.read(entry)
            start = path.read_bytes().index(data, entry.header_offset)
            assert (entry.compress_type, start % 64) == (zipfile.ZIP_STORED, 0)
            found[entry.filename] = data
    return found


def package(path, files, method=zipfile.ZIP_STORED):
    """Write a package that need not be right."""
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files:
            archive.writestr(name, data)
    return path
