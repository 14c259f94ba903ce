"""Materials of USD scenes: where their images lie, which are replaced, and what other formats lose of them."""

import re

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.output_format import write_mesh
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.usd.preview_surface import SURFACE_SLOTS
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.surface.records import ImageFile, Material, MaterialMap, MeshContents, MeshImage
from beltrami_cli.surface.slots import COLOUR_SLOTS, SLOTS

pytest.importorskip("pxr", reason="usd-core is not installed")

from formats.tile_files import sheet
from formats.usd_files import (
    BOUND,
    GIVEN,
    PICTURE,
    block,
    material_text,
    mesh_text,
    scene,
    shader,
    smoothed,
)
from hostile.folders import write

# Its own process, and what it makes of damaged files, is tested in test_usd_packages.py.
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("usd_core_here")]


MOVED = shader(
    "move",
    "UsdTransform2d",
    "float2 inputs:in.connect = </scan/skin/st.outputs:result>",
    "float inputs:rotation = 90",
    "float2 inputs:scale = (2, 3)",
    "float2 inputs:translation = (0.5, 0.25)",
    "float2 outputs:result",
)


def test_coordinates_are_moved_and_images_wrapped_as_the_material_says(tmp_path):
    other = '        def GeomSubset "part" (prepend apiSchemas = ["MaterialBindingAPI"])\n        {\n'
    other += '            uniform token elementType = "face"\n            uniform token familyName = "materialBind"\n'
    other += "            int[] indices = [0, 1]\n            rel material:binding = </scan/two>\n        }\n"
    text = scene(
        mesh_text(BOUND + other),
        material_text("a.png", reader="move", extra=MOVED),
        material_text("b.png", "/scan/two"),
    )
    write(tmp_path, {"a.usda": text, "a.png": PICTURE, "b.png": PICTURE})
    surface = open_document(str(tmp_path / "a.usda")).textured("baseColor")
    names = np.array([texture.name for texture in surface.textures])[surface.texture_of]
    assert sorted(set(names[:4])) == ["b.png"]
    assert sorted(set(names[4:])) == ["a.png"]
    assert surface.textures[0].wrap == ("repeat", "mirror")
    st = (sheet()[1] / 2).round(6)[surface.faces]
    np.testing.assert_allclose(surface.uv[:4], np.stack([st[:4, :, 0], 1 - st[:4, :, 1]], axis=2), atol=1e-6)
    # Scaled, then turned to the left by 90 degrees, then moved.
    u, v = 0.5 - 3 * st[4:, :, 1], 0.25 + 2 * st[4:, :, 0]
    np.testing.assert_allclose(surface.uv[4:], np.stack([u, 1 - v], axis=2), atol=1e-5)


MTLX = block(
    "Material",
    "skin",
    "token outputs:mtlx:surface.connect = </scan/skin/surface.outputs:surface>",
    shader(
        "surface",
        "ND_standard_surface_surfaceshader",
        "color3f inputs:base_color.connect = </scan/skin/images.outputs:colour>",
        "token outputs:surface",
    ),
    block(
        "NodeGraph",
        "images",
        "color3f outputs:colour.connect = </scan/skin/images/image.outputs:out>",
        shader(
            "image",
            "ND_tiledimage_color3",
            "asset inputs:file = @a.png@",
            "float2 inputs:uvtiling = (2, 1)",
            "float2 inputs:uvoffset = (0.25, 0)",
            'string inputs:vaddressmode = "mirror"',
            "color3f outputs:out",
        ),
    ),
)


def test_materialx_networks_in_layers_show_their_image(tmp_path):
    write(tmp_path, {"a.usda": scene(mesh_text(BOUND), MTLX), "a.png": PICTURE})
    surface = open_document(str(tmp_path / "a.usda")).textured("baseColor")
    assert surface.textures[0].wrap == ("repeat", "mirror")
    _, uv, quads = sheet()
    plain = uv[quads.ravel()] / 2 * [2, 1] - [0.25, 0]
    assert {*map(tuple, surface.uv.reshape(-1, 2).round(4))} == {
        *map(tuple, (plain * [1, -1] + [0, 1]).round(4))
    }
    text = (tmp_path / "a.usda").read_bytes()
    assert smoothed(tmp_path).data == text.replace(b"@a.png@", b"@./b.png@")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("ND_tiledimage_color3", "ND_multiply_color3"), "a MaterialX surface whose colour is an image"),
        (
            ('def Material "skin"', 'def Material "skin" ( references = @a.mtlx@ )'),
            "is not a USD layer.*usdcat",
        ),
        (("@a.png@", "@../a.png@"), "leaves the model's folder.*copy its files into"),
    ],
)
def test_what_is_not_read_of_materials_is_said_with_the_way_out(change, words, tmp_path):
    text = scene(mesh_text(BOUND), MTLX).replace(*change)
    if "mtlx" in change[1]:
        text = text.replace("outputs:mtlx:surface.connect", "outputs:mtlx:other.connect")
    write(tmp_path / "in", {"a.usda": text, "a.png": PICTURE})
    with pytest.raises(InputError, match=words):
        smooth_file(tmp_path / "in" / "a.usda", tmp_path / "b.usda", GIVEN)


def test_what_goes_on_to_show_an_image_of_the_base_colour_is_named(tmp_path):
    rough = shader("rough", "UsdUVTexture", "asset inputs:file = @a.png@", "float outputs:r")
    write(
        tmp_path, {"a.usda": scene(mesh_text(BOUND), material_text("a.png", extra=rough)), "a.png": PICTURE}
    )
    result = smooth_file(tmp_path / "a.usda", tmp_path / "b.usda", GIVEN)
    (notice,) = [each for each in result.warnings if "keeps the old" in each]
    assert "rough.inputs:file shows a.png" in notice


def glowing(shader, extra=""):
    """Return a material that glows with what a shader reads."""
    return material_text("a.png", extra=extra).replace(
        "            float inputs:roughness",
        f"            color3f inputs:emissiveColor.connect = </scan/skin/{shader}.outputs:rgb>\n"
        "            float inputs:roughness",
    )


def test_a_map_that_lies_otherwise_than_the_base_colour_is_not_converted(tmp_path):
    moved = "float2 inputs:st.connect = </scan/skin/move.outputs:result>"
    outputs = "float3 outputs:rgb", "float outputs:a"
    lamp = shader("lamp", "UsdUVTexture", "asset inputs:file = @b.png@", moved, *outputs)
    text = scene(mesh_text(BOUND), mesh_text(name="bare"), glowing("lamp", MOVED + lamp)).replace(
        "float inputs:roughness = 1",
        "float inputs:roughness.connect = </scan/skin/lamp.outputs:rgb>\n"
        "            float inputs:opacity.connect = </scan/skin/lamp.outputs:a>",
    )
    write(tmp_path, {"a.usda": text, "a.png": PICTURE, "b.png": PICTURE})
    mesh = open_document(str(tmp_path / "a.usda")).textured_mesh()
    assert [sorted(material.maps) for material in mesh.materials] == [["baseColor"], []]
    assert np.isfinite(mesh.uv).all()  # also without an image
    assert "emissive maps that are placed otherwise than the base colour" in mesh.left_out
    for slot in ("metallicRoughness", "opacity"):
        assert f"{slot} maps laid out otherwise than in glTF" in mesh.left_out
    assert {material.alpha for material in mesh.materials} == {"opaque"}
    # A shader of its own reads the opacity from the image of the colours.
    write(tmp_path, {"c.usda": text.replace("@b.png@", "@a.png@").replace("move.outputs", "st.outputs")})
    assert open_document(str(tmp_path / "c.usda")).textured_mesh().materials[0].alpha == "blend"


@pytest.mark.parametrize(
    ("line", "lost"),
    [
        ("float4 inputs:scale = (4, 1, 1, 1)", "colour of materials outside 0 to 1"),
        *((line, "the scale or bias of baseColor maps") for line in (
            "float4 inputs:scale = (nan, 1, 1, 1)", "float inputs:scale = 0.5",
            "float4 inputs:scale.timeSamples = { 0: (1, 0.5, 1, 1) }", "float4 inputs:bias = (0.1, 0, 0, 0)",
        )),
    ],
)  # fmt: skip
def test_factors_of_images_that_gltf_does_not_have_are_said_to_be_lost(line, lost, tmp_path):
    file = "asset inputs:file = @a.png@"
    text = scene(mesh_text(BOUND), material_text("a.png").replace(file, f"{file}\n            {line}"))
    write(tmp_path, {"a.usda": text, "a.png": PICTURE})
    mesh = open_document(str(tmp_path / "a.usda")).textured_mesh()
    assert mesh.left_out.count(lost) == 1
    assert mesh.materials[0].colour == pytest.approx((1, 1, 1))


def test_factors_that_no_format_has_are_said_to_be_lost(tmp_path):
    plain = "float inputs:roughness = 1"
    odd = {"roughness": "3", "metallic": "-1", "opacity": "2"}
    lines = "\n".join(f"float inputs:{name} = {value}" for name, value in odd.items())
    lines += "\ncolor3f inputs:emissiveColor = (0, -1, 0)"
    text = scene(mesh_text(BOUND), material_text("a.png").replace(plain, lines))
    write(tmp_path, {"a.usda": text, "a.png": PICTURE})
    mesh = open_document(str(tmp_path / "a.usda")).textured_mesh()
    names = ("roughness", "metalness", "opacity", "emission")
    assert all(f"{name} of materials outside 0 to 1" in mesh.left_out for name in names)
    assert [getattr(mesh.materials[0], name) for name in names] == [1, 0, 1, (0, 0, 0)]


INPUTS = ("int inputs:useSpecularWorkflow = 1", "float inputs:clearcoat = 0.5", "float inputs:ior = 1.2",
          "float inputs:displacement.connect = </scan/skin/diffuse.outputs:rgb>")  # fmt: skip


def test_inputs_of_surfaces_that_other_formats_lack_are_said_to_be_lost_unless_they_have_no_effect(tmp_path):
    plain = "float inputs:roughness = 1"
    neutral = "\n".join([plain, "float inputs:clearcoat = 0", "float inputs:ior = 1.5"])
    text = scene(mesh_text(BOUND), material_text("a.png"))
    names = [re.split(r"[:. ]", line)[2] for line in INPUTS]
    for lines, lost in ((neutral, []), ("\n".join([plain, *INPUTS]), names)):
        write(tmp_path, {"a.usda": text.replace(plain, lines), "a.png": PICTURE})
        left_out = open_document(str(tmp_path / "a.usda")).textured_mesh().left_out
        assert [name for name in names if name in left_out] == lost


def test_an_image_that_is_shown_twice_is_named_once_in_the_root(tmp_path):
    base = scene(mesh_text(BOUND), glowing("diffuse"))
    root = "#usda 1.0\n( subLayers = [@./base.usda@] )\n"
    write(tmp_path, {"a.usda": root, "base.usda": base, "a.png": PICTURE})
    assert smoothed(tmp_path, slots=("baseColor", "emissive")).data.count(b"@./b.png@") == 1


@pytest.mark.parametrize("names", [("a b", "a_b", "a_b_1", "a-b"), ("mesh_0", "mesh_0_1", "mesh 0", "m")])
def test_every_mesh_and_material_that_is_written_is_a_prim_of_its_own(names):
    contents = MeshContents(
        positions=np.eye(3), corners=np.tile(np.arange(3, dtype=np.int32), 4), offsets=np.arange(0, 13, 3),
        colours=np.zeros((3, 0), np.float32), uv=np.zeros((12, 2)),
        materials=tuple(Material(name=name) for name in names), material_of=np.arange(4, dtype=np.int32),
    )  # fmt: skip
    text = b"".join(map(bytes, write_mesh(contents, "usda", "model").main)).decode()
    prims = re.findall(r'^    def \w+ "(\w+)"', text, re.MULTILINE)
    assert len(set(prims)) == len(prims) == 1 + len(names)


@pytest.mark.parametrize("slot", SLOTS)
def test_images_are_written_as_colours_in_the_slots_of_colours_and_their_scale_stands_for_factors(slot):
    described = SURFACE_SLOTS[slot]
    factors = {each.name: [0.25, 0.5, 3.0] if each.channel == "rgb" else 0.25 for each in described.inputs}
    kept = described.values(described.scale(factors))
    assert kept == (factors if described.fixed_scale is None else {})
    image = MeshImage(ImageFile(PICTURE, ".png"), "a.png", "a.png")
    contents = MeshContents(
        positions=np.eye(3), corners=np.arange(3, dtype=np.int32), offsets=np.array([0, 3]),
        colours=np.zeros((3, 0), np.float32), uv=np.zeros((3, 2)),
        materials=(Material(maps={slot: MaterialMap(image)}),),
    )  # fmt: skip
    text = b"".join(map(bytes, write_mesh(contents, "usda", "model").main)).decode()
    assert re.findall(r'sourceColorSpace = "(\w+)"', text) == ["sRGB" if slot in COLOUR_SLOTS else "raw"]
