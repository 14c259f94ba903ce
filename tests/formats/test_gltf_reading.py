"""Colours and textures of a glTF file: rows, faces, places and texture coordinates."""

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.formats.image.reading import read_texture
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.slots import SLOTS
from formats.gltf_files import JPEG, KTX2, Model, Textured, picture
from formats.gltf_showcase import showcase
from formats.image_files import encode

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")


def triangle(model, colours=None, positions=TRIANGLE, **more):
    colours = np.eye(3, dtype="<f4") if colours is None else colours
    attributes = {"POSITION": model.packed(positions), "COLOR_0": model.packed(colours)}
    return {"attributes": attributes, **more}


def drawn(mode, corners):
    """Triangles as the specification lists them, one by one."""
    n = len(corners)
    if mode == 4:
        found = [(corners[i], corners[i + 1], corners[i + 2]) for i in range(0, n - 2, 3)]
    elif mode == 5:
        found = [
            (corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2])
            for i in range(n - 2)
            if len({corners[i], corners[i + 1], corners[i + 2]}) == 3
        ]
    elif mode == 6:
        found = [(corners[i + 1], corners[i + 2], corners[0]) for i in range(n - 2)]
    else:
        found = []
    return np.array(found, np.int32).reshape(-1, 3)


@settings(max_examples=60, deadline=None)
@given(
    mode=st.integers(0, 6),
    kind=st.sampled_from(("<u1", "<u2", "<u4", None)),
    size=st.integers(1, 20),
    seed=st.integers(0, 99),
)
def test_every_mode_draws_the_triangles_of_the_specification(mode, kind, size, seed):
    rng, model = np.random.default_rng(seed), Model()
    primitive = triangle(model, rng.random((7, 3)).astype("<f4"), rng.random((7, 3)).astype("<f4"), mode=mode)
    corners = np.arange(7)
    if kind is not None:
        corners = rng.integers(0, 7, size).astype(kind)
        primitive["indices"] = model.indices(corners)
    model.mesh(primitive)
    np.testing.assert_array_equal(model.document().coloured_vertices().faces, drawn(mode, corners.tolist()))


@pytest.mark.parametrize("seed", range(10))
def test_world_positions_agree_with_trimesh_on_node_hierarchies(seed):
    model, rng = Model(), np.random.default_rng(seed)
    count = 1 + seed % 5
    for _ in range(count):
        points = rng.normal(size=(3, 3)).astype("<f4")
        model.mesh(triangle(model, positions=points, indices=model.indices(np.arange(3, dtype="<u2"))))
    nodes = model.tree["nodes"]
    model.tree["scenes"][0]["nodes"] = []
    for index in range(count):
        if rng.random() < 0.5:
            nodes[index]["matrix"] = np.vstack([rng.normal(size=(3, 4)), [0, 0, 0, 1]]).T.ravel().tolist()
        else:
            turn = rng.normal(size=4)
            nodes[index] |= {"translation": rng.normal(size=3).tolist(), "scale": rng.normal(size=3).tolist()}
            nodes[index]["rotation"] = (turn / np.linalg.norm(turn)).tolist()
        parent = int(rng.integers(-1, index))
        holder = nodes[parent].setdefault("children", []) if parent >= 0 else model.tree["scenes"][0]["nodes"]
        holder.append(index)
    found = model.document().coloured_vertices().positions.reshape(count, 3, 3)
    scene = trimesh.load(trimesh.util.wrap_as_stream(model.glb()), file_type="glb", process=False)
    other = np.array([mesh.triangles[0] for mesh in scene.dump()])
    for place in found:
        distance = min(np.abs(np.sort(place, axis=0) - np.sort(item, axis=0)).max() for item in other)
        assert distance < 1e-5 * (1 + np.abs(place).max())


def test_a_skinned_mesh_stays_where_it_is_stored():
    model = Model()
    model.mesh(triangle(model), translation=[5, 6, 7], skin=0)
    model.tree["skins"] = [{"joints": [0]}]
    np.testing.assert_array_equal(model.document().coloured_vertices().positions, TRIANGLE)


def test_primitives_that_share_a_pair_share_rows():
    model = Model()
    first = triangle(model, indices=model.indices(np.array([0, 1, 2], "<u1")))
    second = {"attributes": first["attributes"], "indices": model.indices(np.array([2, 1, 0], "<u1"))}
    model.mesh(first, second, second)
    vertices = model.document().coloured_vertices()
    assert len(vertices.positions) == 3
    np.testing.assert_array_equal(vertices.faces, [[0, 1, 2], [2, 1, 0]])


def test_colours_used_at_two_places_have_one_row_and_a_notice():
    model = Model()
    first = triangle(model)
    second = {"attributes": first["attributes"] | {"POSITION": model.packed(TRIANGLE + 5)}}
    model.mesh(first, second)
    opened = model.document()
    vertices = opened.coloured_vertices()
    assert opened.coloured_vertices() is vertices
    np.testing.assert_array_equal(vertices.positions, TRIANGLE)
    assert [notice for notice in vertices.notices if "other positions" in notice]
    assert vertices.faces.tolist() == [[0, 1, 2]]


def test_scenes_and_meshes_outside_them_are_spaces_of_their_own():
    model = Model()
    for shift in range(4):
        model.mesh(triangle(model), translation=[shift, 0, 0], node=shift != 3)
    model.tree["scenes"] = [{"nodes": [0]}, {"nodes": [1, 2]}]
    model.tree["scene"] = 1
    vertices = model.document().coloured_vertices()
    space = vertices.space_of.reshape(4, 3)
    assert (space == space[:, :1]).all()
    assert space[1, 0] == space[2, 0] == 0
    assert len(set(space[:, 0].tolist())) == 3
    np.testing.assert_array_equal(vertices.positions[9:], TRIANGLE)
    del model.tree["scene"]
    assert set(model.document().coloured_vertices().space_of[:9]) == {0}


def test_mixed_types_are_called_by_the_coarsest():
    model = Model()
    model.mesh(
        triangle(model),
        triangle(model, np.eye(3, dtype="<u2") * 65535),
        triangle(model, np.eye(3, 4, dtype="<f4")),
    )
    model.tree["accessors"][3]["normalized"] = True
    vertices = model.document().coloured_vertices()
    assert vertices.stored == "uint16"
    assert (vertices.encoding, vertices.space_of) == ("linear", None)
    np.testing.assert_array_equal(vertices.colours, np.tile(np.eye(3, dtype=np.float32), (3, 1)))


def test_normals_turn_as_surfaces_do_under_uneven_and_mirrored_scales():
    rng, model = np.random.default_rng(3), Model()
    for scale in ([1, 2, 5], [-1, 2, 0.5]):
        corners = rng.normal(size=(3, 3)).astype("<f4")
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normals = np.tile(normal / np.linalg.norm(normal), (3, 1)).astype("<f4")
        attributes = {
            "POSITION": model.packed(corners),
            "NORMAL": model.packed(normals),
            "COLOR_0": model.packed(np.eye(3, dtype="<f4")),
        }
        turn = rng.normal(size=4)
        model.mesh({"attributes": attributes}, scale=scale, rotation=(turn / np.linalg.norm(turn)).tolist())
    contents = GltfDocument(model.glb(), "x", None).contents()
    for a, b, c in contents.corners.reshape(-1, 3):
        place = contents.positions
        outside = np.cross(place[b] - place[a], place[c] - place[a])
        np.testing.assert_allclose(contents.normals[a], outside / np.linalg.norm(outside), atol=1e-5)


def test_what_is_dropped_is_listed():
    model = showcase()
    model.mesh({"attributes": {"POSITION": 0}})
    model.mesh({"attributes": {"POSITION": 0, "COLOR_0": 0, "NORMAL": 0}})
    model.tree["nodes"].append({"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}})
    model.tree["extensions"] = {"VRMC_vrm": {}}
    assert {*model.document().contents().left_out} == {
        "materials", "textures", "skins", "animations", "cameras", "morph targets", "texture coordinates",
        "further vertex attributes", "node hierarchy", "uncoloured meshes",
        "further places of a mesh", "normals, which some parts lack", "VRMC_vrm", "EXT_mesh_gpu_instancing",
        "KHR_lights_punctual", "ACME_notes",
    }  # fmt: skip


SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")
CORNERS = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0.125, 0.25], [0.5, -1], [2, 0.75], [0, 1]], "<f4")


def square(model, material, *, uv=UV, **placed):
    return model.triangles(SQUARE, uv, material, corners=CORNERS, **placed)


def surface(model, folder, slot="baseColor", form="glb"):
    return open_document(str(model.written_to(folder, form))).textured(slot)


@pytest.mark.parametrize(
    ("form", "place", "slot"),
    [("glb", "view", "baseColor"), ("glb", "data", "normal"), ("glb", "file", "emissive"),
     ("gltf", "view", "occlusion"), ("gltf", "data", "baseColor"), ("gltf", "file", "metallicRoughness"),
     ("data", "view", "normal"), ("data", "data", "emissive"), ("data", "file", "baseColor")],
)  # fmt: skip
def test_every_slot_is_read_from_every_container(tmp_path, form, place, slot):
    model = Textured(place)
    data = picture(1, JPEG)
    square(model, model.material("skin", **{slot: model.texture(model.image(data))}))
    document = open_document(str(model.written_to(tmp_path, form)))
    assert document.slots() == (slot,)
    assert document.facts()["slots"] == [slot]
    assert (document.facts()["images"], document.facts()["textures"]) == (1, 1)
    found = document.textured(slot)
    assert document.textured(slot) is found
    np.testing.assert_array_equal(found.positions[found.faces], SQUARE[CORNERS])
    np.testing.assert_array_equal(found.uv, UV[CORNERS])
    np.testing.assert_array_equal(found.texture_of, [0, 0])
    (texture,) = found.textures
    assert (texture.data, texture.name, texture.materials) == (data, "a b.png", ("skin",))
    assert texture.wrap == ("repeat", "repeat")
    for other in set(SLOTS) - {slot}:
        with pytest.raises(InputError, match=f"no {other} texture"):
            document.textured(other)


def test_a_document_that_keeps_images_decodes_each_once_until_it_is_replaced(tmp_path):
    images = [encode(np.full((2, 2, 3), level, np.uint8), "png") for level in (1, 2)]
    model = Textured()
    square(model, model.material("skin", baseColor=model.texture(model.image(images[0]))))
    document = open_document(str(model.written_to(tmp_path))).keeping_images()
    (texture,) = document.textured("baseColor").textures
    assert read_texture(texture) is read_texture(texture)
    (new,) = (
        document.with_colours(None, {("baseColor", texture.key): images[1]}).textured("baseColor").textures
    )
    assert not np.array_equal(read_texture(new).pixels, read_texture(texture).pixels)


def test_all_triangles_are_there_and_one_image_is_one_texture(tmp_path):
    model = Textured()
    image = model.image(picture(1))
    first, second = (
        model.material(name, baseColor=model.texture(image, wrap=wrap))
        for name, wrap in (("a", (33071, 33648)), ("b", (10497, 10497)))
    )
    other = model.material(baseColor=model.texture(model.image(picture(2), "other.png")))
    square(model, first)
    square(model, None)
    square(model, second, translation=[5, 0, 0])
    square(model, other, node=False)
    document = open_document(str(model.written_to(tmp_path)))
    found = document.textured("baseColor")
    np.testing.assert_array_equal(found.texture_of, np.repeat([0, -1, 0, 1], 2))
    assert [texture.materials for texture in found.textures] == [("a", "b"), ("material 2",)]
    assert found.textures[0].wrap == ("clamp", "mirror")
    assert [notice for notice in found.notices if "wrap modes" in notice]
    np.testing.assert_array_equal(found.positions[found.faces[4:6]], SQUARE[CORNERS] + [5, 0, 0])
    assert (
        len(set(found.space_of[found.faces[6:]].ravel()) & set(found.space_of[found.faces[:6]].ravel())) == 0
    )


@settings(max_examples=50, deadline=None)
@given(
    offset=st.tuples(*[st.floats(-3, 3)] * 2),
    angle=st.floats(-7, 7),
    scale=st.tuples(*[st.floats(-30, 30)] * 2),
)
def test_transforms_scale_then_turn_then_shift(tmp_path_factory, offset, angle, scale):
    """Counter-clockwise is meant as seen, with v down: (1, 0) turns towards (0, -1)."""
    model = Textured()
    transform = {"offset": offset, "rotation": angle, "scale": scale}
    info = {
        "index": model.texture(model.image(picture(1))),
        "extensions": {"KHR_texture_transform": transform},
    }
    square(model, model.material(baseColor=info))
    seen = UV.astype(float) * scale @ [1, -1j]  # the plane as complex numbers with the imaginary axis up
    seen = seen * complex(math.cos(angle), math.sin(angle)) + np.array(offset) @ [1, -1j]
    expected = np.stack([seen.real, -seen.imag], axis=1)[CORNERS]
    found = surface(model, tmp_path_factory.mktemp("transform"))
    np.testing.assert_allclose(found.uv, expected, atol=1e-12 * (1 + np.abs(expected).max()))


@pytest.mark.parametrize("kind", ["f4", "u1", "u2", "i1", "i2", "plain u1", "plain i2"])
@pytest.mark.parametrize("chosen", ["info", "transform"])
def test_coordinates_of_every_type_and_set_are_read(tmp_path, kind, chosen):
    model, rng = Textured(), np.random.default_rng(3)
    code = kind.split()[-1]
    if code == "f4":
        stored = rng.normal(size=(4, 2)).astype("<f4")
        expected, normalised = stored, {}
    else:
        limits = np.iinfo(code)
        stored = rng.integers(limits.min, limits.max + 1, (4, 2)).astype(f"<{code}")
        stored[0] = limits.min, limits.max  # the least value stands for -1, too
        plain = kind.startswith("plain")
        expected = stored if plain else np.maximum(stored / float(limits.max), -1)
        normalised = {} if plain else {"normalized": True}
    attributes = {"TEXCOORD_0": model.packed(UV), "TEXCOORD_1": model.packed(stored, **normalised)}
    info = {"index": model.texture(model.image(picture(1))), "texCoord": 1}
    if chosen == "transform":
        info |= {"texCoord": 0, "extensions": {"KHR_texture_transform": {"texCoord": 1}}}
    square(model, model.material(baseColor=info), uv=attributes)
    np.testing.assert_array_equal(surface(model, tmp_path).uv, np.asarray(expected, float)[CORNERS])


def test_instances_are_taken_once_and_mirrored_nodes_turned(tmp_path):
    model = Textured()
    material = model.material(baseColor=model.texture(model.image(picture(1))))
    attributes = {"TEXCOORD_0": model.packed(UV), "COLOR_0": model.packed(np.eye(4, 3, dtype="<f4"))}
    mesh = square(model, material, uv=attributes, scale=[-2, 1, 1])
    model.tree["nodes"].append({"mesh": mesh, "translation": [9, 9, 9]})
    model.tree["scenes"][0]["nodes"].append(1)
    document = open_document(str(model.written_to(tmp_path)))
    vertices, found = document.coloured_vertices(), document.textured("baseColor")
    for each in (vertices, found):
        np.testing.assert_array_equal(each.positions[each.faces], (SQUARE * [-2, 1, 1])[CORNERS[:, ::-1]])
    np.testing.assert_array_equal(found.uv, UV[CORNERS[:, ::-1]])
    assert any("several nodes" in notice for notice in vertices.notices)
    assert any("several places" in notice for notice in found.notices)


def test_the_same_triangles_with_another_texture_are_taken_too(tmp_path):
    model = Textured()
    mesh = square(model, model.material(baseColor=model.texture(model.image(picture(1)))))
    primitive = model.tree["meshes"][mesh]["primitives"][0]
    other = model.material(baseColor=model.texture(model.image(picture(2))))
    model.mesh(primitive | {"material": other}, translation=[1, 0, 0])
    model.mesh(dict(primitive), translation=[2, 0, 0])
    np.testing.assert_array_equal(surface(model, tmp_path).texture_of, [0, 0, 1, 1])


def test_diffuse_is_the_base_colour_alone_or_beside_another(tmp_path):
    model = Textured()
    plain, gloss = (model.texture(model.image(picture(n))) for n in (1, 2))
    square(model, model.material(diffuse=gloss))
    square(model, model.material(diffuse=gloss, baseColor=plain), translation=[1, 0, 0])
    square(model, model.material(diffuse=plain, baseColor=plain), translation=[2, 0, 0])
    found = surface(model, tmp_path)
    assert [texture.data for texture in found.textures] == [picture(2), picture(1)]
    places = found.positions[found.faces][:, :, 0].min(axis=1)
    shown = list(zip(places.tolist(), found.texture_of.tolist(), strict=True))
    assert sorted(shown) == [(0, 0)] * 2 + [(1, 0)] * 2 + [(1, 1)] * 2 + [(2, 1)] * 2
    spaces = found.space_of[found.faces[:, 0]]
    assert [set(spaces[places == place]) for place in (0, 2)] == [{0}, {0}]
    assert len(set(spaces[places == 1])) == 2


def test_every_variant_of_a_material_is_a_surface_of_its_own(tmp_path):
    model = Textured()
    materials = [model.material(baseColor=model.texture(model.image(picture(n)))) for n in range(3)]
    mappings = [
        {"material": 1, "variants": [0, 2]},
        {"material": 2, "variants": [1]},
        {"material": 0, "variants": [3]},
    ]
    for shift in (0, 1):
        mesh = square(model, materials[0], translation=[shift, 0, 0])
        primitive = model.tree["meshes"][mesh]["primitives"][0]
        primitive["extensions"] = {"KHR_materials_variants": {"mappings": mappings}}
    found = surface(model, tmp_path)
    spaces = found.space_of[found.faces[:, 0]]
    assert [texture.data for texture in found.textures] == [picture(n) for n in range(3)]
    for number in range(3):
        shown = found.texture_of == number
        assert (
            np.count_nonzero(shown) == 4
        )  # both squares, once each, though two variants show the second image
        assert len(set(spaces[shown])) == 1
    assert len(set(spaces)) == 3


def test_primitives_over_the_same_positions_bring_their_vertices_alone(tmp_path):
    model = Textured()
    material = model.material(baseColor=model.texture(model.image(picture(1))))
    mesh = square(model, material)
    (primitive,) = model.tree["meshes"][mesh]["primitives"]
    halves = [primitive | {"indices": model.indices(half.astype("<u2"))} for half in CORNERS]
    model.tree["meshes"][mesh]["primitives"] = halves
    converted = open_document(str(model.written_to(tmp_path))).textured_mesh()
    np.testing.assert_array_equal(converted.positions[converted.corners], SQUARE[CORNERS.ravel()])
    np.testing.assert_array_equal(converted.uv, UV[CORNERS.ravel()])
    assert len(converted.positions) == CORNERS.size


@pytest.mark.parametrize("reason", ["missing", "outside", "web", "coordinates", "no image", "packed", "dds"])
def test_what_cannot_be_read_is_reported_and_left_out(tmp_path, reason, monkeypatch):
    monkeypatch.setattr("beltrami_cli.formats.gltf.images.missing_package", lambda known: "alktx2")
    model = Textured("file")
    broken = model.image(picture(1, KTX2 if reason == "packed" else JPEG), "gone.png")
    uris = {"outside": "../gone.png", "web": "https://example.org/gone.png", "missing": "elsewhere.png"}
    model.tree["images"][broken]["uri"] = uris.get(reason, "maps/gone.png")
    dds = {"extensions": {"MSFT_texture_dds": {"source": broken}}} if reason == "dds" else {}
    texture = model.texture(None if reason in ("no image", "dds") else broken, **dds)
    square(model, model.material("torn", baseColor=texture), uv={} if reason == "coordinates" else UV)
    said = r"is a DDS image \(MSFT_texture_dds\), which is not read" if dds else "baseColor texture"
    with pytest.raises(InputError, match=said):
        surface(model, tmp_path)
    square(
        model,
        model.material("whole", baseColor=model.texture(model.image(picture(2)))),
        translation=[1, 0, 0],
    )
    document = open_document(str(model.written_to(tmp_path)))
    found = document.textured("baseColor")
    np.testing.assert_array_equal(found.texture_of, [-1, -1, 0, 0])
    assert [n for n in found.notices if ("coordinates" if reason == "coordinates" else "'torn'") in n]
