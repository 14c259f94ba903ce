"""Replacing images in glTF files: the asked ones change, nothing else does or moves, and no bytes are wasted."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.records import ImageFile
from formats.gltf_files import SLOT_PATHS, WEBP, Textured, data_uri, joined, opened, picture, unpacked
from formats.gltf_images import (
    HEADS,
    MEDIA,
    SQUARE,
    check_rest,
    copied,
    image_bytes,
    image_of,
    new_image,
    save,
    shown,
    with_better_image,
    with_images,
)


@st.composite
def models(draw):
    model = Textured(draw(st.sampled_from(("view", "data", "file"))))
    images = []
    for number in range(draw(st.integers(1, 3))):
        images.append(model.image(picture(number, size=40 + 17 * number), f"map {number}.png"))
        if draw(st.booleans()):
            model.view(b"something else")
    textures = [model.texture(draw(st.sampled_from(images))) for _ in range(draw(st.integers(1, 4)))]
    slots = draw(st.lists(st.sampled_from(sorted(SLOT_PATHS)), min_size=2, max_size=6, unique=True))
    for number in range(draw(st.integers(1, 3))):
        chosen = {slot: draw(st.sampled_from(textures)) for slot in slots if draw(st.booleans())}
        material = model.material(**chosen)
        model.triangles(SQUARE + number, SQUARE[:, :2], material)
    return model


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(
    model=models(),
    form=st.sampled_from(("glb", "gltf", "data")),
    moved=st.booleans(),
    data=st.data(),
)
def test_only_the_asked_images_of_the_asked_slots_change(tmp_path_factory, model, form, moved, data):
    source = model.written_to(tmp_path_factory.mktemp("source"), form)
    before = {file: file.read_bytes() for file in source.parent.rglob("*.*")}
    document = open_document(str(source))
    wanted, expected, old = {}, shown(source), shown(source)
    for slot in document.slots():
        for texture in document.textured(slot).textures:
            if data.draw(st.booleans()):
                file = new_image(data.draw(st.integers(0, 3)), data.draw(st.sampled_from(sorted(HEADS))))
                wanted[slot, texture.key] = file
                for (number, name), octets in old.items():
                    same = name == slot or (name, slot) == ("diffuse", "baseColor")
                    if same and octets == texture.data:
                        expected[number, name] = file.data
    written = document.patch(None, Naming("out", copies=moved), images=wanted)
    folder = tmp_path_factory.mktemp("target") if moved else source.parent
    copied(written, source, folder)
    path = save(written, "out" + source.suffix, folder)
    assert {file: file.read_bytes() for file in before} == before
    assert shown(path) == expected
    check_rest(source, path)
    for slot in document.slots():
        ours, now = document.textured(slot), open_document(str(path)).textured(slot)
        np.testing.assert_array_equal(now.positions[now.faces], ours.positions[ours.faces])
        np.testing.assert_array_equal(now.uv, ours.uv)
        for face, (then, later) in enumerate(zip(ours.texture_of, now.texture_of, strict=True)):
            assert (then < 0) == (later < 0)
            if then >= 0:
                key = slot, ours.textures[then].key
                then_data = wanted[key].data if key in wanted else ours.textures[then].data
                assert now.textures[later].data == then_data, face


@settings(max_examples=30, deadline=None)
@given(model=models(), form=st.sampled_from(("glb", "gltf", "data")), same=st.booleans())
def test_nothing_new_gives_back_the_same_bytes(tmp_path_factory, model, form, same):
    source = model.written_to(tmp_path_factory.mktemp("source"), form)
    document = open_document(str(source))
    images = {
        (slot, texture.key): ImageFile(texture.data, ".png")
        for slot in document.slots()
        for texture in document.textured(slot).textures
    }
    written = document.patch(None, Naming("out"), images=images if same else {})
    assert joined(written) == source.read_bytes()
    assert not written.sidecars


def test_a_slot_apart_gets_a_texture_and_an_image_of_its_own(tmp_path):
    model = Textured()
    texture = model.texture(model.image(picture(1)), wrap=(33071, 33071), name="shared")
    model.triangles(SQUARE, SQUARE[:, :2], model.material(occlusion=texture, metallicRoughness=texture))
    source = model.written_to(tmp_path)
    wanted = {("occlusion", "image 0"): new_image(1, ".jpg")}
    tree, _ = unpacked(joined(open_document(str(source)).patch(None, Naming("o", keeps=True), images=wanted)))
    assert tree["textures"] == [
        {"source": 0, "sampler": 0, "name": "shared"},
        {"source": 1, "sampler": 0, "name": "shared"},
    ]
    assert tree["materials"][0]["occlusionTexture"] == {"index": 1}
    assert tree["images"][0] == model.tree["images"][0]
    assert tree["images"][1]["mimeType"] == "image/jpeg"
    assert tree["bufferViews"][-1]["byteOffset"] >= len(model.binary)


# Where an object with an `index` stands, besides the texture of the base colour, and whether it is that of a texture.
INDICES = {
    ("extensions", "VRM", "blendShapeMaster", "blendShapeGroups", 0, "binds", 0): False,
    ("extensions", "VRMC_vrm", "expressions", "preset", "aa", "morphTargetBinds", 0): False,
    ("materials", 0, "extras", "order"): False,
    ("meshes", 0, "extras"): False,
    ("materials", 0, "extensions", "UNKNOWN_lightmap"): True,
    ("materials", 0, "extensions", "UNKNOWN_sheen", "map"): True,
    ("materials", 0, "extras", "lightTexture"): True,
    ("extensions", "EXT_structural_metadata", "propertyTextures", 0, "properties", "height"): True,
}


def put(value, path, last):
    """Return a value with another one at a path below it."""
    if not path:
        return last
    key, *rest = path
    if key == 0:
        return [put(value[0] if value else {}, rest, last)]
    return (value or {}) | {key: put((value or {}).get(key), rest, last)}


@pytest.mark.parametrize("path", INDICES)
def test_only_what_shows_a_texture_keeps_it_as_it_was(tmp_path, path):
    model = Textured()
    texture = model.texture(model.image(picture(1)))
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture))
    model.tree = put(model.tree, path, {"index": texture, "weight": 1})
    source = model.written_to(tmp_path)
    written = open_document(str(source)).patch(
        None, Naming("o", keeps=True), images={("baseColor", "image 0"): new_image(1, ".png")}
    )
    (tmp_path / "o.glb").write_bytes(joined(written))
    tree, _ = unpacked(joined(written))
    index = tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"]
    assert (index == texture) != INDICES[path]
    assert len(tree["textures"]) == (2 if INDICES[path] else 1)
    if not INDICES[path]:
        assert tree["materials"] == model.tree["materials"]
    assert (
        open_document(str(tmp_path / "o.glb")).fingerprint().parts
        == open_document(str(source)).fingerprint().parts
    )


@pytest.mark.parametrize("place", ["view", "data", "file"])
@pytest.mark.parametrize("suffix", sorted(HEADS))
def test_the_type_is_given_wherever_it_stands(tmp_path, place, suffix):
    source = with_images(tmp_path, 1, "gltf", place)
    wanted = {("baseColor", "image 0"): new_image(1, suffix)}
    written = open_document(str(source)).patch(None, Naming("out", keeps=True), images=wanted)
    tree = json.loads(joined(written))
    (image,), (texture,) = tree["images"], tree["textures"]
    if place == "view":
        assert image["mimeType"] == MEDIA[suffix]
    elif place == "data":
        assert image["uri"] == data_uri(new_image(1, suffix).data, MEDIA[suffix])
    else:
        assert list(written.sidecars) == [f"maps/0{suffix}"]
        assert image["uri"] == f"maps/0{suffix}"
    if suffix == ".webp":
        assert texture == {"extensions": {"EXT_texture_webp": {"source": 0}}}
        assert tree["extensionsUsed"] == tree["extensionsRequired"] == ["EXT_texture_webp"]
    else:
        assert texture == {"source": 0}
        assert "extensionsUsed" not in tree


@pytest.mark.parametrize("fallback", [True, False])
@pytest.mark.parametrize("suffix", [".webp", ".png"])
def test_webp_stays_webp_or_leaves_no_trace(tmp_path, fallback, suffix):
    model = with_better_image("webp", picture(2, WEBP), picture(1) if fallback else None)
    model.tree["extensionsUsed"].insert(0, "KHR_other")
    (better,) = model.tree["textures"][0]["extensions"]["EXT_texture_webp"].values()
    document = open_document(str(model.written_to(tmp_path)))
    (key,) = (texture.key for texture in document.textured("baseColor").textures)
    written = document.patch(None, Naming("o", keeps=True), images={("baseColor", key): new_image(1, suffix)})
    tree, buffers = unpacked(joined(written))
    assert image_of(tree, buffers, {}, tree["textures"][0]) == new_image(1, suffix).data
    if suffix == ".webp":
        assert tree["textures"] == model.tree["textures"]
        assert tree["extensionsUsed"] == ["KHR_other", "EXT_texture_webp"]
        assert bool(written.notices) == fallback
    else:
        assert tree["textures"] == [{"source": better}]
        assert tree["extensionsUsed"] == ["KHR_other"]
        assert "extensionsRequired" not in tree


def test_images_of_types_that_are_not_read_do_not_outlive_their_replacement(tmp_path):
    model = Textured()
    texture = model.texture(model.image(picture(1)), extensions={"KHR_texture_basisu": {"source": 0}})
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture))
    model.tree["extensionsUsed"] = ["KHR_texture_basisu"]
    document = open_document(str(model.written_to(tmp_path)))
    written = document.patch(None, Naming("o", keeps=True), images={("baseColor", "image 0"): new_image(1)})
    tree, _ = unpacked(joined(written))
    assert tree["textures"] == [{"source": 0}]
    assert "extensionsUsed" not in tree
    assert any("KTX2" in notice for notice in written.notices)


@pytest.mark.parametrize(
    ("name", "suffix", "moved", "expected"),
    [
        ("model.png", ".png", False, "out.png"),
        ("maps/model_base color.png", ".png", False, "maps/out_base color.png"),
        ("skin.png", ".png", False, "out_skin.png"),
        ("remodelled.png", ".png", False, "out_remodelled.png"),
        ("maps/skin.png", ".jpg", False, "maps/out_skin.jpg"),
        ("maps/skin.JPEG", ".jpg", True, "maps/skin.JPEG"),
        ("maps/skin.png", ".webp", True, "maps/skin.webp"),
        ("100%.png", ".png", True, "100%.png"),
        ("100%.png", ".png", False, "out_100%.png"),
        ("skin", ".png", True, "skin.png"),
        ("taken.png", ".jpg", True, "taken-2.jpg"),
    ],
)
def test_image_files_are_named_after_the_output_and_spare_the_sources(
    tmp_path, name, suffix, moved, expected
):
    model = Textured("file")
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=model.texture(model.image(picture(1)))))
    model.tree["images"][0]["uri"] = name.replace("%", "%25").replace(" ", "%20")
    model.tree["images"].append({"uri": "Taken.jpg"})
    model.files = {name: picture(1), "Taken.jpg": picture(3)}
    document = open_document(str(model.written_to(tmp_path, "gltf")))
    images = {("baseColor", "image 0"): new_image(1, suffix)}
    written = document.patch(None, Naming("out", keeps=moved), images=images)
    assert list(written.sidecars) == [expected]
    uri = json.loads(joined(written))["images"][0]["uri"]
    assert uri == expected.replace("%", "%25").replace(" ", "%20")


def test_a_name_that_stays_keeps_its_spelling(tmp_path):
    model = Textured("file")
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=model.texture(model.image(picture(1)))))
    model.tree["images"][0]["uri"] = "sk%69n,(1).png"
    model.files = {"skin,(1).png": picture(1)}
    source = model.written_to(tmp_path, "gltf")
    images = {("baseColor", "image 0"): new_image(1)}
    written = open_document(str(source)).patch(None, Naming("out", keeps=True), images=images)
    assert joined(written) == source.read_bytes()
    assert written.sidecars == {"skin,(1).png": new_image(1).data}


def test_writing_beside_itself_spares_the_source_too(tmp_path):
    source = with_images(tmp_path, 1, "gltf", "file")
    wanted = {("baseColor", "image 0"): new_image(1)}
    first = open_document(str(source)).patch(None, Naming("model"), images=wanted)
    assert list(first.sidecars) == ["maps/model_0.png"]
    again = open_document(str(save(first, "model.gltf", tmp_path)))
    second = again.patch(None, Naming("model"), images={("baseColor", "image 0"): new_image(2)})
    assert list(second.sidecars) == ["maps/model_0-2.png"]


@pytest.mark.parametrize(
    ("form", "place"),
    [("glb", "view"), ("glb", "file"), ("gltf", "view"), ("gltf", "data"), ("gltf", "file")],
)
def test_images_are_replaced_on_the_way_to_the_other_form(tmp_path, place, form):
    source = with_images(tmp_path, 2, form, place)
    document = open_document(str(source))
    wanted = {("baseColor", "image 1"): new_image(1, ".jpg")}
    other = "gltf" if form == "glb" else "glb"
    written = document.patch(None, Naming("out"), form=other, images=wanted)
    found = open_document(str(save(written, f"out.{other}", tmp_path))).textured("baseColor")
    assert [texture.data for texture in found.textures] == [picture(0, size=300), new_image(1, ".jpg").data]
    if form == "gltf":
        tree, _ = unpacked(joined(written))
        assert place == "data" or [image["mimeType"] for image in tree["images"]] == [
            "image/png",
            "image/jpeg",
        ]


def test_colours_and_images_are_replaced_together(tmp_path):
    model = Textured()
    mesh = model.triangles(
        SQUARE, SQUARE[:, :2], model.material(baseColor=model.texture(model.image(picture(1))))
    )
    attributes = model.tree["meshes"][mesh]["primitives"][0]["attributes"]
    attributes["COLOR_0"] = attributes["_KEPT"] = model.packed(np.eye(3, dtype="<f4"))
    document = open_document(str(model.written_to(tmp_path)))
    wanted = {("baseColor", "image 0"): new_image(1, size=900)}
    colours = 1 - document.painted().colours
    path = save(document.patch(colours, Naming("o"), images=wanted), "o.glb", tmp_path)
    after = open_document(str(path))
    np.testing.assert_array_equal(after.painted().colours, colours)
    assert after.textured("baseColor").textures[0].data == new_image(1, size=900).data


def test_types_that_gltf_cannot_hold_are_refused(tmp_path):
    document = open_document(str(with_images(tmp_path, 1)))
    with pytest.raises(OutputError, match=r"cannot hold \.exr textures.*--texture-format"):
        document.patch(
            None, Naming("o", keeps=True), images={("baseColor", "image 0"): ImageFile(b"v/1", ".exr")}
        )


@pytest.mark.parametrize("key", [("baseColor", "image 9"), ("normal", "image 0"), ("baseColor", "x")])
def test_images_that_were_not_handed_out_are_not_taken_back(tmp_path, key):
    document = open_document(str(with_images(tmp_path, 1)))
    with pytest.raises(ValueError, match="image"):
        document.patch(None, Naming("o", keeps=True), images={key: new_image(1)})


@pytest.mark.slow
@pytest.mark.parametrize("form", ["glb", "gltf", "data"])
@pytest.mark.parametrize("every", [True, False])
def test_repeated_patches_do_not_grow_the_file_without_bound(tmp_path, form, every):
    source, rng, runs, largest = with_images(tmp_path, 3, form), np.random.default_rng(5), 40, 400
    first, path = opened(source)[0], source
    start = first["buffers"][0]["byteLength"]
    for run in range(runs):
        document = open_document(str(path))
        textures = document.textured("baseColor").textures
        chosen = textures if every else [textures[run % 3]]
        images = {
            ("baseColor", texture.key): new_image(rng.integers(1 << 30), size=int(rng.integers(50, largest)))
            for texture in chosen
        }
        folder = tmp_path / str(run)
        folder.mkdir()
        written = document.patch(None, Naming("m", copies=True), images=images)
        copied(written, path, folder)
        path = save(written, "m" + source.suffix, folder)
        got = {
            texture.key: texture.data for texture in open_document(str(path)).textured("baseColor").textures
        }
        after = opened(path)[0]
        assert all(got[key] == file.data for (_, key), file in images.items())
        if every:
            sizes = sum(-(-len(file.data) // 4) * 4 for file in images.values())
            assert after["buffers"][0]["byteLength"] <= start + sizes + 8
    assert after["buffers"][0]["byteLength"] < start + 3 * 5 * largest
    assert len(after["images"]) == 3
    assert len(after["bufferViews"]) == len(first["bufferViews"])


def test_an_image_at_the_end_is_cut_and_written_over(tmp_path):
    model = Textured()
    model.triangles(SQUARE, SQUARE[:, :2], 0)
    model.material(baseColor=model.texture(model.image(picture(1, size=500))))
    source = model.written_to(tmp_path)
    patch = open_document(str(source)).patch
    smaller = joined(
        patch(None, Naming("o", keeps=True), images={("baseColor", "image 0"): new_image(1, size=100)})
    )
    assert 390 <= source.stat().st_size - len(smaller) <= 410
    same = joined(
        patch(None, Naming("o", keeps=True), images={("baseColor", "image 0"): new_image(1, size=500)})
    )
    size = int.from_bytes(same[12:16], "little")
    assert same[: 20 + size] == source.read_bytes()[: 20 + size]


@pytest.mark.parametrize("reader", ["part of it", "all of it", "right behind it"])
def test_bytes_that_something_else_reads_stay_where_they_are(tmp_path, reader):
    model = Textured()
    image = model.image(picture(1, size=80))
    index = model.tree["images"][image]["bufferView"]
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=model.texture(image)))
    if reader == "part of it":
        view = dict(model.tree["bufferViews"][index])
        model.tree["bufferViews"].append(view | {"byteOffset": view["byteOffset"] + 8, "byteLength": 40})
    elif reader == "all of it":
        model.accessor(np.zeros((10, 1), "<u1"), index)
    else:
        model.tree["images"][image]["bufferView"] = model.view(picture(1, size=80))
        model.view(b"tiny")
    path = model.written_to(tmp_path)
    wanted = {("baseColor", "image 0"): new_image(2, size=60)}
    patched = save(open_document(str(path)).patch(None, Naming("o"), images=wanted), "o.glb", tmp_path)
    check_rest(path, patched)
    assert shown(patched) == {(0, "baseColor"): wanted["baseColor", "image 0"].data}
    if reader == "all of it":
        (_, old), (tree, new) = unpacked(path.read_bytes()), unpacked(patched.read_bytes())
        start = model.tree["bufferViews"][index]["byteOffset"]
        assert new[0][start : start + 88] == old[0][start : start + 88]
        assert tree["images"][0]["bufferView"] != index


def test_images_that_grow_and_shrink_by_turns_reuse_their_bytes(tmp_path):
    path, lengths = with_images(tmp_path, 2), []
    for run in range(12):
        document = open_document(str(path))
        images = {("baseColor", f"image {run % 2}"): new_image(run, size=(300, 350)[run // 2 % 2])}
        path = save(document.patch(None, Naming("m"), images=images), "m.glb", tmp_path)
        lengths.append(opened(path)[0]["buffers"][0]["byteLength"])
    assert max(lengths[8:]) <= max(lengths[4:8]) <= lengths[0] + 2 * 370


def test_an_image_that_lights_the_scene_is_kept_for_it(tmp_path):
    model = Textured()
    model.triangles(SQUARE, SQUARE[:, :2], 0)
    model.material(baseColor=model.texture(model.image(picture(1))))
    model.tree["extensions"] = {"EXT_lights_image_based": {"lights": [{"specularImages": [[0, 0]]}]}}
    path = model.written_to(tmp_path)
    wanted = {("baseColor", "image 0"): new_image(2)}
    patched = save(open_document(str(path)).patch(None, Naming("o"), images=wanted), "o.glb", tmp_path)
    tree, buffers = unpacked(patched.read_bytes())
    assert image_bytes(tree, buffers, {}, 0) == picture(1)
    assert shown(patched) == {(0, "baseColor"): new_image(2).data}


def test_images_that_share_bytes_all_stay_in_use(tmp_path):
    """Some exporters describe the same image once for every texture."""
    model = Textured()
    view = model.view(picture(1))
    model.tree["images"] += [{"bufferView": view, "mimeType": "image/png"} for _ in range(3)]
    for number in range(3):
        model.triangles(SQUARE + number, SQUARE[:, :2], model.material(baseColor=model.texture(number)))
    source = model.written_to(tmp_path)
    document = open_document(str(source))
    (texture,) = document.textured("baseColor").textures
    written = document.patch(None, Naming("out"), images={("baseColor", texture.key): new_image(1)})
    (old, _), (new, _) = unpacked(source.read_bytes()), unpacked(joined(written))
    assert [old[key] for key in ("images", "textures", "materials")] == [
        new[key] for key in ("images", "textures", "materials")
    ]
    assert set(shown(save(written, "out.glb", tmp_path)).values()) == {new_image(1).data}
