"""Properties of textured surfaces as they are read from glTF files."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.registry import open_document
from formats.gltf_files import JPEG, KTX2, Textured, picture

SLOTS = ("baseColor", "emissive", "normal", "occlusion", "metallicRoughness")
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
    assert [notice for notice in document.notices if "wrap modes" in notice]
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
    mesh = square(model, model.material(baseColor=model.texture(model.image(picture(1)))), scale=[-2, 1, 1])
    model.tree["nodes"].append({"mesh": mesh, "translation": [9, 9, 9]})
    model.tree["scenes"][0]["nodes"].append(1)
    document = open_document(str(model.written_to(tmp_path)))
    found = document.textured("baseColor")
    np.testing.assert_array_equal(found.positions[found.faces], (SQUARE * [-2, 1, 1])[CORNERS[:, ::-1]])
    np.testing.assert_array_equal(found.uv, UV[CORNERS[:, ::-1]])
    assert [notice for notice in document.notices if "several places" in notice]


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


@pytest.mark.parametrize("reason", ["missing", "outside", "web", "coordinates", "no image", "packed", "dds"])
def test_what_cannot_be_read_is_reported_and_left_out(tmp_path, reason, monkeypatch):
    monkeypatch.setattr("beltrami_cli.formats.gltf.textures.missing_package", lambda known: "alktx2")
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
    assert [n for n in document.notices if ("coordinates" if reason == "coordinates" else "'torn'") in n]
