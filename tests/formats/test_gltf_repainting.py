"""Properties of replacing images in glTF files: the asked ones change, and nothing else does."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.source import open_document
from beltrami_cli.mesh.textured import ImageFile
from formats.gltf_files import JPEG, PNG, SLOT_PATHS, WEBP, Textured, data_uri, joined, picture, unpacked

HEADS = {".png": PNG, ".jpg": JPEG, ".webp": WEBP}
MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".webp": "image/webp"}
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "<f4")


def new_image(number, suffix=".png", size=70):
    return ImageFile(picture(1000 + number, HEADS[suffix], size), suffix)


def save(written, name, folder):
    """Write what a patch returned; return the path of the main file."""
    for sidecar, data in written.sidecars.items():
        (folder / sidecar).parent.mkdir(parents=True, exist_ok=True)
        (folder / sidecar).write_bytes(bytes(data))
    (folder / name).write_bytes(joined(written))
    return folder / name


def copied(document, source, folder):
    for name in document.references():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes((source.parent / name).read_bytes())


def shown(path):
    """Return the bytes that every textureInfo of a file shows, by material and slot, the plain way."""
    files = {file.relative_to(path.parent).as_posix(): file.read_bytes() for file in path.parent.rglob("*.*")}
    tree, buffers = unpacked(path.read_bytes(), files)
    found = {}
    for number, material in enumerate(tree.get("materials", [])):
        for slot, keys in SLOT_PATHS.items():
            info = material
            for key in keys:
                info = info.get(key, {})
            if info:
                found[number, slot] = image_of(tree, buffers, files, tree["textures"][info["index"]])
    return found


def image_of(tree, buffers, files, texture):
    webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
    return image_bytes(tree, buffers, files, webp.get("source", texture.get("source")))


def image_bytes(tree, buffers, files, index):
    image = tree["images"][index]
    if "bufferView" in image:
        view = tree["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        return buffers[view["buffer"]][start : start + view["byteLength"]]
    if image["uri"].startswith("data:"):
        return unpacked(json.dumps({"buffers": [{"uri": image["uri"], "byteLength": 1}]}).encode())[1][0]
    return files[image["uri"].replace("%20", " ")]


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


@settings(max_examples=150, deadline=None)
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
    written = document.patch(None, "out", moved=moved, images=wanted)
    folder = tmp_path_factory.mktemp("target") if moved else source.parent
    if moved:
        copied(document, source, folder)
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


def check_rest(source, path):
    """What is neither an image nor a texture is the same, and every other view holds the same bytes."""
    trees = []
    for file in (source, path):
        files = {f.relative_to(file.parent).as_posix(): f.read_bytes() for f in file.parent.rglob("*.*")}
        trees.append(unpacked(file.read_bytes(), files))
    (old, old_buffers), (new, new_buffers) = trees
    pictures = {image.get("bufferView") for image in old["images"]}
    assert all(view["byteOffset"] % 4 == 0 for view in new["bufferViews"][len(old["bufferViews"]) :])
    for index, view in enumerate(old["bufferViews"]):
        if index not in pictures:
            assert new["bufferViews"][index] == view
            span = slice(view["byteOffset"], view["byteOffset"] + view["byteLength"])
            assert new_buffers[0][span] == old_buffers[0][span]
    for tree in (old, new):
        for material in tree["materials"]:
            strip_indices(material)
        for key in ("images", "textures", "bufferViews", "buffers", "extensionsUsed", "extensionsRequired"):
            tree.pop(key, None)
    assert new == old


def strip_indices(value):
    for child in value.values() if isinstance(value, dict) else ():
        if isinstance(child, dict):
            child.pop("index", None)
            strip_indices(child)


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
    written = document.patch(None, "out", moved=False, images=images if same else {})
    assert joined(written) == source.read_bytes()
    assert not written.sidecars


def with_images(folder, count, form="glb", place="view"):
    model = Textured(place)
    for number in range(count):
        texture = model.texture(model.image(picture(number, size=300), f"{number}.png"))
        model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture), translation=[number, 0, 0])
    return model.written_to(folder, form)


@pytest.mark.parametrize("form", ["glb", "gltf", "data"])
@pytest.mark.parametrize("every", [True, False])
def test_repeated_patches_do_not_grow_the_file_without_bound(tmp_path, form, every):
    source, rng, runs, largest = with_images(tmp_path, 3, form), np.random.default_rng(5), 40, 400
    start = open_document(str(source)).buffers.lengths[0]
    path = source
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
        copied(document, path, folder)
        path = save(document.patch(None, "m", moved=True, images=images), "m" + source.suffix, folder)
        after = open_document(str(path))
        got = {texture.key: texture.data for texture in after.textured("baseColor").textures}
        assert all(got[key] == file.data for (_, key), file in images.items())
        if every:
            sizes = sum(-(-len(file.data) // 4) * 4 for file in images.values())
            assert after.buffers.lengths[0] <= start + sizes + 8
    assert after.buffers.lengths[0] < start + 3 * 5 * largest
    assert len(after.root.entries("images")) == 3
    assert len(after.root.entries("bufferViews")) == len(
        open_document(str(source)).root.entries("bufferViews")
    )


def test_an_image_at_the_end_is_cut_and_written_over(tmp_path):
    model = Textured()
    model.triangles(SQUARE, SQUARE[:, :2], 0)
    model.material(baseColor=model.texture(model.image(picture(1, size=500))))
    source = model.written_to(tmp_path)
    patch = open_document(str(source)).patch
    smaller = joined(patch(None, "o", moved=True, images={("baseColor", "image 0"): new_image(1, size=100)}))
    assert 390 <= source.stat().st_size - len(smaller) <= 410
    same = joined(patch(None, "o", moved=True, images={("baseColor", "image 0"): new_image(1, size=500)}))
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
    patched = save(open_document(str(path)).patch(None, "o", moved=False, images=wanted), "o.glb", tmp_path)
    check_rest(path, patched)
    assert shown(patched) == {(0, "baseColor"): wanted["baseColor", "image 0"].data}
    if reader == "all of it":
        (_, old), (tree, new) = unpacked(path.read_bytes()), unpacked(patched.read_bytes())
        start = model.tree["bufferViews"][index]["byteOffset"]
        assert new[0][start : start + 88] == old[0][start : start + 88]
        assert tree["images"][0]["bufferView"] != index


def test_images_that_grow_and_shrink_by_turns_keep_their_room(tmp_path):
    path, lengths = with_images(tmp_path, 2), []
    for run in range(12):
        document = open_document(str(path))
        images = {("baseColor", f"image {run % 2}"): new_image(run, size=(300, 350)[run // 2 % 2])}
        path = save(document.patch(None, "m", moved=False, images=images), "m.glb", tmp_path)
        lengths.append(open_document(str(path)).buffers.lengths[0])
    assert max(lengths[8:]) <= max(lengths[4:8]) <= lengths[0] + 2 * 370


def test_an_image_that_lights_the_scene_is_kept_for_it(tmp_path):
    model = Textured()
    model.triangles(SQUARE, SQUARE[:, :2], 0)
    model.material(baseColor=model.texture(model.image(picture(1))))
    model.tree["extensions"] = {"EXT_lights_image_based": {"lights": [{"specularImages": [[0, 0]]}]}}
    path = model.written_to(tmp_path)
    wanted = {("baseColor", "image 0"): new_image(2)}
    patched = save(open_document(str(path)).patch(None, "o", moved=False, images=wanted), "o.glb", tmp_path)
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
    written = document.patch(None, "out", moved=False, images={("baseColor", texture.key): new_image(1)})
    (old, _), (new, _) = unpacked(source.read_bytes()), unpacked(joined(written))
    assert [old[key] for key in ("images", "textures", "materials")] == [
        new[key] for key in ("images", "textures", "materials")
    ]
    assert set(shown(save(written, "out.glb", tmp_path)).values()) == {new_image(1).data}


def test_a_slot_apart_gets_a_texture_and_an_image_of_its_own(tmp_path):
    model = Textured()
    texture = model.texture(model.image(picture(1)), wrap=(33071, 33071), name="shared")
    model.triangles(SQUARE, SQUARE[:, :2], model.material(occlusion=texture, metallicRoughness=texture))
    source = model.written_to(tmp_path)
    wanted = {("occlusion", "image 0"): new_image(1, ".jpg")}
    tree, _ = unpacked(joined(open_document(str(source)).patch(None, "o", moved=True, images=wanted)))
    assert tree["textures"] == [
        {"source": 0, "sampler": 0, "name": "shared"},
        {"source": 1, "sampler": 0, "name": "shared"},
    ]
    assert tree["materials"][0]["occlusionTexture"] == {"index": 1}
    assert tree["images"][0] == model.tree["images"][0]
    assert tree["images"][1]["mimeType"] == "image/jpeg"
    assert tree["bufferViews"][-1]["byteOffset"] >= len(model.binary)


@pytest.mark.parametrize("place", ["view", "data", "file"])
@pytest.mark.parametrize("suffix", sorted(HEADS))
def test_the_type_is_told_wherever_it_stands(tmp_path, place, suffix):
    source = with_images(tmp_path, 1, "gltf", place)
    wanted = {("baseColor", "image 0"): new_image(1, suffix)}
    written = open_document(str(source)).patch(None, "out", moved=True, images=wanted)
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
    model = Textured()
    plain = model.image(picture(1)) if fallback else None
    better = model.image(picture(2, WEBP), "b.webp", "image/webp")
    texture = model.texture(plain, extensions={"EXT_texture_webp": {"source": better}})
    model.triangles(SQUARE, SQUARE[:, :2], model.material(baseColor=texture))
    model.tree["extensionsUsed"] = ["KHR_other", "EXT_texture_webp"]
    if not fallback:
        model.tree["extensionsRequired"] = ["EXT_texture_webp"]
    document = open_document(str(model.written_to(tmp_path)))
    (key,) = (texture.key for texture in document.textured("baseColor").textures)
    written = document.patch(None, "o", moved=True, images={("baseColor", key): new_image(1, suffix)})
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
    written = document.patch(None, "o", moved=True, images={("baseColor", "image 0"): new_image(1)})
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
    written = document.patch(None, "out", moved=moved, images=images)
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
    written = open_document(str(source)).patch(None, "out", moved=True, images=images)
    assert joined(written) == source.read_bytes()
    assert written.sidecars == {"skin,(1).png": new_image(1).data}


def test_writing_beside_itself_spares_the_source_too(tmp_path):
    source = with_images(tmp_path, 1, "gltf", "file")
    wanted = {("baseColor", "image 0"): new_image(1)}
    first = open_document(str(source)).patch(None, "model", moved=False, images=wanted)
    assert list(first.sidecars) == ["maps/model_0.png"]
    again = open_document(str(save(first, "model.gltf", tmp_path)))
    second = again.patch(None, "model", moved=False, images={("baseColor", "image 0"): new_image(2)})
    assert list(second.sidecars) == ["maps/model_0-2.png"]


@pytest.mark.parametrize("place", ["view", "data", "file"])
@pytest.mark.parametrize("form", ["glb", "gltf"])
def test_images_are_replaced_on_the_way_to_the_other_form(tmp_path, place, form):
    source = with_images(tmp_path, 2, form, place)
    document = open_document(str(source))
    wanted = {("baseColor", "image 1"): new_image(1, ".jpg")}
    other = "gltf" if form == "glb" else "glb"
    written = document.repackaged(None, "out", other, moved=False, images=wanted)
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
    path = save(document.patch(colours, "o", moved=False, images=wanted), "o.glb", tmp_path)
    after = open_document(str(path))
    np.testing.assert_array_equal(after.painted().colours, colours)
    assert after.textured("baseColor").textures[0].data == new_image(1, size=900).data


def test_types_that_gltf_cannot_hold_are_refused(tmp_path):
    document = open_document(str(with_images(tmp_path, 1)))
    with pytest.raises(OutputError, match=r"cannot hold \.exr textures.*--texture-format"):
        document.patch(None, "o", moved=True, images={("baseColor", "image 0"): ImageFile(b"v/1", ".exr")})


@pytest.mark.parametrize("key", [("baseColor", "image 9"), ("normal", "image 0"), ("baseColor", "x")])
def test_images_that_were_not_handed_out_are_not_taken_back(tmp_path, key):
    document = open_document(str(with_images(tmp_path, 1)))
    with pytest.raises(ValueError, match="image"):
        document.patch(None, "o", moved=True, images={key: new_image(1)})
