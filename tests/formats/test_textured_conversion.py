"""Textured models in another format: what both formats have a place for is kept, and the rest is said in one line."""

import io

import numpy as np
import pytest
import trimesh
from PIL import Image

from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.formats.image.sample_types import full_scale_one
from beltrami_cli.formats.meshes.writing import triangulated
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.surface.colour_values import linear_to_srgb
from cli.commands import SAMPLES
from formats.gltf_comparison import issues, needs_validator
from formats.gltf_files import Textured, opened
from formats.image_files import encode, noise
from formats.ply_files import Table, build
from hostile.folders import write

NAMES = ("skin", "glow", "bumps", "metal")
IMAGES = {name: encode(noise("uint8", 3, 8, 8, seed), "png") for seed, name in enumerate(NAMES)}
MTL = """newmtl outer skin
Kd 0.5 0.5 0.5
map_Kd -clamp on skin.png
map_Ke -clamp on glow.png
norm -clamp on bumps.png
map_Pr -imfchan g -clamp on metal.png
map_Pm -imfchan b -clamp on metal.png
newmtl glass
Kd 0.25 0.5 1
d 0.5
newmtl nowhere used
Kd 1 0 0
"""
OBJ = """mtllib m.mtl
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 1 1 0.25 0 0 1
v 0 1 0 1 1 0
v 0.5 0.5 1 0.2 0.4 0.6
vt -0.25 0
vt 1 0
vt 1 1.5
vt 0 1
vn 0 0 1
vn 1 0 0
vn 0 1 0
o left half
usemtl outer skin
f 1/1/1 2/2/1 3/3/2 4/4/3
usemtl glass
f 1//2 2//2 5//2
o right half
usemtl outer skin
f 2/1/1 3/2/2 5/3/3
f 3 4 5
"""
FILES = {"model.obj": OBJ, "m.mtl": MTL, **{f"{name}.png": data for name, data in IMAGES.items()}}


@pytest.fixture
def model(tmp_path):
    return write(tmp_path / "in", FILES) / "model.obj"


def converted(source, target):
    """Convert a file, and return the mesh that it then holds, and the warnings."""
    target.parent.mkdir(exist_ok=True)
    report = smooth_file(source, target, iterations=0)
    return open_document(str(target)).textured_mesh(), report.warnings


def corners(mesh, *, materials=True, groups=True, normals=True):
    """All triangles as rows of what they are like, in an order that does not depend on the file's."""
    mesh = triangulated(mesh)
    rows = [mesh.positions[mesh.corners].reshape(-1, 9), np.nan_to_num(mesh.uv.reshape(-1, 6), nan=9)]
    if normals:
        rows.append(np.nan_to_num(mesh.corner_normals.reshape(-1, 9), nan=9))
    if mesh.colours.size and normals:
        rows.append(mesh.colours[mesh.corners].reshape(-1, 9).round(4))
    columns = np.column_stack(rows).astype(np.float32).round(5) + 0.0
    names = [
        (
            mesh.groups[mesh.group_of[face]] if groups else "",
            mesh.materials[mesh.material_of[face]].name.removesuffix("-3") if materials else "",
        )
        for face in range(len(mesh.sizes))
    ]
    return sorted(zip(names, map(tuple, columns.tolist()), strict=True))


def shown(mesh):
    """The images that each material has in each slot, with how they are repeated."""
    return {
        (material.name, slot): (each.image.file.data, each.wrap)
        for material in mesh.materials
        for slot, each in material.maps.items()
    }


@pytest.mark.parametrize(
    "way", [("out.glb",), ("out.gltf",), ("mid.glb", "out.obj"), ("mid.gltf", "out.obj")]
)
def test_coordinates_normals_names_groups_maps_and_colours_come_through(way, model, tmp_path):
    before = open_document(str(model)).textured_mesh()
    source = model
    for number, name in enumerate(way):
        target = tmp_path / f"step {number}" / name
        after, _ = converted(source, target)
        source = target
    assert corners(after, normals=False) == corners(before, normals=False)
    assert shown(after) == shown(before)
    skin, glass = (next(m for m in after.materials if m.name == name and m.alpha == alpha)
                   for name, alpha in (("outer skin", "opaque"), ("glass", "blend")))  # fmt: skip
    assert set(skin.maps) == {"baseColor", "emissive", "normal", "metallicRoughness"}
    np.testing.assert_allclose(glass.colour, (0.25, 0.5, 1), atol=1e-5)
    assert glass.opacity == 0.5
    faces = (triangulated(mesh).corner_normals.reshape(-1, 3, 3) for mesh in (before, after))
    old, new = (normals[~np.isnan(normals).any(axis=(1, 2))] for normals in faces)
    assert {*map(tuple, new.reshape(-1, 9).tolist())} <= {*map(tuple, old.reshape(-1, 9).tolist())}
    assert len(new) == len(old) == 4
    if after.encoding == "srgb":
        tips = after.colours[(after.positions == [0.5, 0.5, 1]).all(axis=1)]
        np.testing.assert_allclose(tips.max(axis=0), (0.2, 0.4, 0.6), atol=2e-3)
        return
    tree = opened(source)[0]
    for primitive in (part for mesh in tree["meshes"] for part in mesh["primitives"]):
        # Colours beside a texture do not tint it, and survive.
        is_textured = "baseColorTexture" in tree["materials"][primitive["material"]]["pbrMetallicRoughness"]
        attributes = primitive["attributes"]
        assert ("_COLOR_0" in attributes) == is_textured != ("COLOR_0" in attributes)


def test_a_reader_of_others_sees_the_same_triangles(model, tmp_path):
    converted(model, tmp_path / "out" / "out.glb")
    scene = trimesh.load(tmp_path / "out" / "out.glb")
    assert {name.rsplit("_", 1)[0] for name in scene.geometry} >= {"left half", "right half"}
    skins = [each for each in scene.geometry.values() if each.visual.material.name == "outer skin"]
    uv = np.concatenate([each.visual.uv for each in skins if each.visual.uv is not None])
    assert uv.min() == -0.25
    assert uv.max() == 1.5
    pixels = np.asarray(
        next(each for each in skins if each.visual.uv is not None).visual.material.baseColorTexture
    )
    assert np.array_equal(pixels, read_image(IMAGES["skin"], "skin.png").pixels)


def test_what_is_lost_is_said_in_one_line(model, tmp_path):
    (_, said) = converted(model, tmp_path / "out.ply")
    lines = [line for line in said if line.startswith("Not converted")]
    assert len(lines) == 1
    maps = (f"{slot} maps" for slot in ("emissive", "normal", "metallicRoughness"))
    assert all(what in lines[0] for what in (*maps, "materials, except", "groups"))
    (_, said) = converted(model, tmp_path / "out.glb")
    assert any("quads" in line for line in said)
    assert any("_COLOR_0" in line for line in said)
    (model.parent / "m.mtl").write_text(MTL + "map_Ks skin.png\nmap_refl skin.png\n")
    (model.parent / "skin.png").unlink()
    (_, said) = converted(model, tmp_path / "other.glb")
    assert any("baseColor map 'skin.png', which cannot be read" in line for line in said)


@pytest.mark.slow
@pytest.mark.parametrize(
    "way", [("out.ply",), ("out.ply", "out.obj"), ("out.usda",), ("out.usda", "out.obj")]
)
def test_quads_stay_quads_with_all_of_their_corners(way, model, tmp_path):
    if any(name.endswith("usda") for name in way):
        pytest.importorskip("pxr")
    before, source = open_document(str(model)).textured_mesh(), model
    for number, name in enumerate(way):
        after, said = converted(source, tmp_path / f"step {number}" / name)
        source = tmp_path / f"step {number}" / name
        assert not any("quads" in line for line in said)
    assert sorted(after.sizes.tolist()) == sorted(before.sizes.tolist()) == [3, 3, 3, 4]
    alone = {"materials": False, "groups": False, "normals": False}
    known = [row for row in corners(before, **alone) if 9 not in row[1][9:]]
    assert [row for row in corners(after, **alone) if row in known] == known


@needs_validator
@pytest.mark.parametrize("name", ["out.glb", "out.gltf"])
def test_the_validator_has_nothing_against_it(name, model, tmp_path):
    converted(model, tmp_path / "out" / name)
    converted(SAMPLES / "mirrored-noisy.obj", tmp_path / "other" / name)
    for found in issues(tmp_path / "out" / name, tmp_path / "other" / name):
        assert [issue for issue in found if issue[0] < 1] == []
        # Tangents are left to viewers, as in all files without them.
        assert {code for severity, code, *_ in found if severity == 1} <= {
            "MESH_PRIMITIVE_GENERATED_TANGENT_SPACE"
        }


def test_smoothed_textures_and_colours_are_those_of_the_own_format(model, tmp_path):
    for target in ("own/model.obj", "out.glb"):
        (tmp_path / target).parent.mkdir(exist_ok=True)
        smooth_file(model, tmp_path / target, iterations=1, t=1.0, beta=2.0, on="both")
    own, other = (
        open_document(str(tmp_path / name)).textured_mesh() for name in ("own/model.obj", "out.glb")
    )
    assert shown(own) == shown(other)
    assert shown(own)["outer skin", "baseColor"][0] != IMAGES["skin"]
    assert shown(own)["outer skin", "emissive"][0] == IMAGES["glow"]
    assert corners(own, normals=False) == corners(other, normals=False)


def test_images_that_gltf_cannot_hold_become_png_with_the_same_pixels(tmp_path):
    pixels = noise("uint8", 3, 8, 8)
    mtl = MTL.replace("skin.png", "skin.tga")
    folder = write(tmp_path / "in", {**FILES, "m.mtl": mtl, "skin.tga": encode(pixels, "targa")})
    mesh, said = converted(folder / "model.obj", tmp_path / "out.glb")
    image = next(m for m in mesh.materials if m.maps).maps["baseColor"].image
    assert image.file.suffix == ".png"
    assert np.array_equal(read_image(image.file.data, "x.png").pixels, pixels)
    assert any("written as PNG" in line for line in said)


def test_images_that_become_png_keep_data_as_numbers_and_name_what_they_lose(tmp_path):
    half, frames = np.full((8, 8, 3), 0.5, np.float32), io.BytesIO()
    Image.new("RGB", (8, 8)).save(
        frames, "gif", save_all=True, append_images=[Image.new("RGB", (8, 8), "red")]
    )
    mtl = (
        MTL.replace("skin.png", "skin.gif").replace("glow.png", "glow.exr").replace("bumps.png", "bumps.exr")
    )
    glow, bumps = (encode(value * half, "openexr") for value in (1.0, 0.9))
    files = {"m.mtl": mtl, "skin.gif": frames.getvalue(), "glow.exr": glow, "bumps.exr": bumps}
    mesh, said = converted(write(tmp_path / "in", {**FILES, **files}) / "model.obj", tmp_path / "out.glb")
    maps = next(m for m in mesh.materials if m.maps).maps
    values = {slot: full_scale_one(read_image(maps[slot].image.file.data, slot).pixels) for slot in maps}
    np.testing.assert_allclose(values["normal"], 0.45, atol=1e-4)
    np.testing.assert_allclose(values["emissive"], linear_to_srgb(half), atol=1e-4)
    assert any("skin.gif holds several images" in line for line in said)


@pytest.mark.parametrize(
    ("values", "mode"), [((0, 255), "mask"), ((0, 90, 255), "blend"), ((255,), "opaque")]
)
def test_transparent_images_stay_transparent_and_cut_outs_sharp(values, mode, tmp_path):
    pixels = noise("uint8", 4, 8, 8)
    pixels[..., 3] = np.resize(np.array(values, np.uint8), (8, 8))
    obj = OBJ.replace("outer skin", "skin").replace("map_Ke", "#")
    mtl = "newmtl skin\nmap_Kd skin.png\n"
    folder = write(tmp_path / "in", {"model.obj": obj, "m.mtl": mtl, "skin.png": encode(pixels, "png")})
    mesh, _ = converted(folder / "model.obj", tmp_path / "out.glb")
    assert {m.alpha for m in mesh.materials if m.maps} == {mode}
    back, _ = converted(tmp_path / "out.glb", tmp_path / "back.obj")
    assert {m.alpha for m in back.materials if m.maps} == {mode}
    assert ("map_d" in (tmp_path / "back.mtl").read_text()) == (mode != "opaque")


@pytest.mark.parametrize(
    ("form", "lost"), [("obj", "alpha cutoffs"), ("ply", "materials, except"), ("usda", "sharp")]
)
def test_numbers_of_materials_are_kept_or_reported(form, lost, tmp_path, usd_core_here):
    model = Textured()
    model.texture(model.image(IMAGES["skin"]), wrap=(33071, 10497))
    model.tree["samplers"][0]["magFilter"] = 9728
    slots = {"baseColor": 0, "emissive": 0, "metallicRoughness": 0, "normal": {"index": 0, "scale": 0.5}}
    numbers = {"baseColorFactor": [0.2, 0.4, 0.6, 0.7], "metallicFactor": 0.3, "roughnessFactor": 0.8}
    for number, (mode, cutoff) in enumerate((("OPAQUE", 0.5), ("BLEND", 0.5), ("MASK", 0.25), ("MASK", 0.0))):
        material = model.tree["materials"][model.material(mode, **slots)]
        material |= {"alphaMode": mode, "alphaCutoff": cutoff, "emissiveFactor": [0.1, 0.3, 0.5]}
        material["pbrMetallicRoughness"] |= numbers
        model.triangles(2 * np.eye(3, dtype="f4"), 2 * np.eye(3, 2, dtype="f4"), number)
    model.tree["scenes"][0]["nodes"] = [0, 1, 2, 3]
    before = model.document().textured_mesh()
    after, said = converted(model.written_to(tmp_path), tmp_path / f"out.{form}")
    assert all(what in str(said) for what in (lost, "the scale of normal maps", "sharp texels"))
    assert ("how textures are repeated" in str(said)) == (form != "usda")
    if form == "obj":
        assert (tmp_path / "out.mtl").read_text().count("\nd 0.7\n") == 2
    for mesh in (after, converted(tmp_path / "out.usda", tmp_path / "out.glb")[0]) if form == "usda" else ():
        assert [each.alpha for each in mesh.materials] == ["opaque", "blend", "mask", "opaque"]
        for name in ("cutoff", "opacity", "colour", "emission", "metalness", "roughness"):
            old, new = ([getattr(each, name) for each in some.materials] for some in (before, mesh))
            np.testing.assert_allclose(new, old, atol=1e-5)


@pytest.mark.slow  # six conversions
def test_emission_brighter_than_white_is_kept(tmp_path, usd_core_here):
    model, strength = Textured(), "KHR_materials_emissive_strength"
    model.texture(model.image(IMAGES["skin"]))
    for factor in (0.5, 1.0):  # alone, and of an image
        shown = {"emissive": 0} if factor == 1 else {}
        material = model.tree["materials"][model.material(f"lamp {factor}", baseColor=0, **shown)]
        material |= {"emissiveFactor": [factor, 1, 1], "extensions": {strength: {"emissiveStrength": 6.5}}}
        model.triangles(2 * np.eye(3, dtype="f4"), 2 * np.eye(3, 2, dtype="f4"), len(model.tree["meshes"]))
    model.tree |= {"extensionsUsed": [strength], "scenes": [{"nodes": [0, 1]}]}
    before, source = model.document().textured_mesh(), model.written_to(tmp_path)
    assert [each.emission_strength for each in before.materials] == [6.5, 6.5]
    for number, form in enumerate(("obj", "usda", "glb", "usda", "obj", "gltf")):
        target = tmp_path / str(number) / f"out.{form}"
        after, said = converted(source, target)
        assert "emi" not in str(said)
        for old, new in zip(before.materials, after.materials, strict=True):
            np.testing.assert_allclose(new.emission, old.emission, atol=1e-5)
            assert new.emission_strength == pytest.approx(6.5, abs=1e-5)
        source = target


def test_emission_that_overflows_stays_finite(tmp_path):
    model, strength = Textured(), "KHR_materials_emissive_strength"
    model.texture(model.image(IMAGES["skin"]))
    material = model.tree["materials"][model.material("sun", baseColor=0)]
    material |= {"emissiveFactor": [1, 100, 0], "extensions": {strength: {"emissiveStrength": 1e308}}}
    model.triangles(2 * np.eye(3, dtype="f4"), 2 * np.eye(3, 2, dtype="f4"), 0)
    (sun,) = model.document().textured_mesh().materials
    assert np.isfinite([*sun.emission, np.float32(sun.emission_strength)]).all()


FACTORS = ("colour", "emission", "opacity", "metalness", "roughness")


@pytest.mark.parametrize("form", ["gltf", "obj"])
def test_factors_that_no_format_has_are_clipped_and_said_to_be_lost(form, tmp_path):
    if form == "obj":
        numbers = "newmtl outer skin\nKd 0.5 2 0\nKe 0 -1 0\nPm -1\nPr 3\nd 2\nnorm bumps.png\n"
        source = write(tmp_path, {**FILES, "m.mtl": numbers}) / "model.obj"
    else:
        model = Textured()
        model.texture(model.image(IMAGES["skin"]))
        material = model.tree["materials"][model.material("odd", baseColor=0)]
        base = material["pbrMetallicRoughness"]
        base |= {"baseColorFactor": [0.5, 2, 0, 2], "metallicFactor": -1, "roughnessFactor": 3}
        material |= {"alphaMode": "BLEND", "emissiveFactor": [0, -1, 0]}
        model.triangles(2 * np.eye(3, dtype="f4"), 2 * np.eye(3, 2, dtype="f4"), 0)
        source = model.written_to(tmp_path)
    mesh = open_document(str(source)).textured_mesh()
    assert {f"{name} of materials outside 0 to 1" for name in FACTORS} <= {*mesh.left_out}
    odd = mesh.materials[-1]
    assert odd.colour[1:] == (1, 0)
    assert (odd.emission, odd.opacity, odd.metalness, odd.roughness) == ((0, 0, 0), 1, 0, 1)


def test_ply_with_several_images_keeps_which_face_shows_which(tmp_path):
    places = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    properties = [("vertex_indices", "uchar int"), ("texcoord", "uchar float"), ("texnumber", "int")]
    wedges = [
        [[0, 1, 2], [0, 0, 1, 0, 1, 1], 1],
        [[0, 2, 3], [0, 0, 1, 1, 0, 1], 0],
        [[1, 2, 3], [0] * 6, -1],
    ]
    tables = [Table("vertex", [(axis, "float") for axis in "xyz"], places), Table("face", properties, wedges)]
    data = build(tables, comments=["TextureFile skin.png", "TextureFile glow.png"]).data
    folder = write(tmp_path / "in", {"x.ply": data, "skin.png": IMAGES["skin"], "glow.png": IMAGES["glow"]})
    before = open_document(str(folder / "x.ply")).textured_mesh()
    assert [before.materials[index].name for index in before.material_of] == ["glow", "skin", "untextured"]
    alone = {"materials": False, "groups": False, "normals": False}
    for name in ("out.glb", "out.obj", "out.ply"):
        after, said = converted(folder / "x.ply", tmp_path / name)
        assert corners(after, **alone) == corners(before, **alone)
        used = (after.materials[index].maps for index in after.material_of)
        images = {maps["baseColor"].image.file.data for maps in used if maps}
        assert images == {IMAGES["skin"], IMAGES["glow"]}
        assert not any("comments" in line for line in said)


def test_every_place_where_a_gltf_mesh_is_shown_is_in_the_obj(tmp_path):
    model = Textured()
    place = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "f4")
    uv = np.array([[0, 0], [1, 0], [0, 1]], "f4")
    material = model.material("colour", baseColor=model.texture(model.image(IMAGES["skin"])))
    model.triangles(place, uv, material)
    model.tree["nodes"][0]["name"] = "first"
    model.tree["nodes"].append({"mesh": 0, "translation": [0, 0, 5], "name": "second"})
    model.tree["scenes"][0]["nodes"] = [0, 1]
    source = model.written_to(tmp_path)
    mesh, _ = converted(source, tmp_path / "out.obj")
    assert mesh.groups[-2:] == ("first", "second")
    assert sorted({z for _, _, z in mesh.positions.tolist()}) == [0, 5]
    assert mesh.sizes.tolist() == [3, 3]


def test_names_that_are_no_utf_8_and_coordinates_beyond_single_precision_are_no_obstacle(tmp_path):
    obj = OBJ.replace("outer skin", "Haut \xe4").replace("o left half", "o H\xe4lfte")
    obj = obj.replace("vt 1 1.5", "vt 1e300 1")
    mtl = MTL.replace("outer skin", "Haut \xe4")
    folder = write(
        tmp_path / "in", {**FILES, "model.obj": obj.encode("latin-1"), "m.mtl": mtl.encode("latin-1")}
    )
    for name in ("out.glb", "out.gltf", "out.ply", "back/out.obj"):
        source = folder / "model.obj" if "obj" not in name else tmp_path / "out.glb"
        mesh, _ = converted(source, tmp_path / name)
        if not name.endswith("ply"):
            assert "Haut \xe4" in {material.name for material in mesh.materials}
            assert "H\xe4lfte" in mesh.groups


def test_a_name_with_a_line_end_cannot_add_statements(tmp_path):
    model = Textured()
    place = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "f4")
    material = model.material(
        "a\nmap_Ks /etc/x", baseColor=model.texture(model.image(IMAGES["skin"], "a\nb/../c.png"))
    )
    model.triangles(place, np.eye(3, 2, dtype="f4"), material)
    model.tree["nodes"][0]["name"] = "x\nmtllib /etc/passwd"
    converted(model.written_to(tmp_path), tmp_path / "out.obj")
    lines = ((tmp_path / "out.obj").read_text() + (tmp_path / "out.mtl").read_text()).splitlines()
    assert not any(line.startswith(("map_Ks", "mtllib /")) for line in lines)
    assert {path.name for path in tmp_path.iterdir()} >= {"out.obj", "out.mtl", "out_c.png"}
    assert (tmp_path / "out_c.png").read_bytes() == IMAGES["skin"]
