"""New images of glTF files: they replace the asked ones in the asked slots; no other byte moves, and none is wasted."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.records import ImageFile
from formats.gltf_comparison import (
    HEADS,
    SQUARE,
    check_rest,
    image_bytes,
    image_of,
    new_image,
    save,
    shown,
    with_better_image,
    with_images,
)
from formats.gltf_files import (
    SLOT_PATHS,
    WEBP,
    Textured,
    joined,
    opened,
    picture,
    unpacked,
)


@st.composite
def models(draw):
    model = Textured(draw(st.sampled_from(("view", "data", "file"))))
    images = []
    for number in range(draw(st.integers(1, 3))):
        images.append(model.image(picture(number, size=40 + 17 * number), f"map {number}.png"))
        if draw(st.booleans()):
            model.view(b"something else")
    textures = [
        model.texture(draw(st.sampled_from(images)), wrap=(33071, 33648), name=f"texture {number}")
        for number in range(draw(st.integers(1, 4)))
    ]
    slots = draw(st.lists(st.sampled_from(sorted(SLOT_PATHS)), min_size=2, max_size=6, unique=True))
    for number in range(draw(st.integers(1, 3))):
        chosen = {slot: draw(st.sampled_from(textures)) for slot in slots if draw(st.booleans())}
        material = model.material(**chosen)
        model.triangles(SQUARE + number, SQUARE[:, :2], material)
    return model


def shown_textures(document):
    """Return the textures of a document by slot and key."""
    textures = ((slot, document.textured(slot).textures) for slot in document.slots())
    return {(slot, texture.key): texture for slot, found in textures for texture in found}


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
    for (slot, key), texture in shown_textures(document).items():
        if data.draw(st.booleans()):
            file = new_image(data.draw(st.integers(0, 3)), data.draw(st.sampled_from(sorted(HEADS))))
            wanted[slot, key] = file
            for (number, name), (octets, others) in old.items():
                same = name == slot or (name, slot) == ("diffuse", "baseColor")
                if same and octets == texture.data:
                    expected[number, name] = file.data, others
    present = {key: ImageFile(texture.data, ".png") for key, texture in shown_textures(document).items()}
    for images in ({}, present):
        unchanged = document.patch(None, Naming("out"), images=images)
        assert (joined(unchanged), unchanged.sidecars) == (source.read_bytes(), {})
    written = document.patch(None, Naming("out", is_moved=moved), images=wanted)
    folder = tmp_path_factory.mktemp("target") if moved else source.parent
    path = save(written, "out" + source.suffix, folder, source)
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


def with_image(source, new, key="image 0", **naming):
    """Replace an image of a file."""
    return open_document(str(source)).patch(None, Naming("out", **naming), images={("baseColor", key): new})


@pytest.mark.parametrize("name", ["sheenColorTexture", "shadeMultiplyTexture", "diffuseTexture", "albedoMap"])
@pytest.mark.parametrize("is_data_elsewhere", [False, True])
def test_colours_of_extensions_follow_the_slot_that_shows_their_image(name, is_data_elsewhere, tmp_path):
    model = with_images()
    place = ("materials", 0, "extensions", "UNKNOWN_shader")
    model.tree = put(model.tree, (*place, name), {"index": 0})
    if is_data_elsewhere:
        model.tree = put(model.tree, (*place, "maskTexture"), {"index": 0})
    written = with_image(model.written_to(tmp_path), new_image(1))
    tree, *_ = opened(save(written, "o.glb", tmp_path))
    material, shader = tree["materials"][0], tree["materials"][0]["extensions"]["UNKNOWN_shader"]
    assert shader[name] == material["pbrMetallicRoughness"]["baseColorTexture"]
    assert len(tree["textures"]) == 1 + is_data_elsewhere
    said = [each for each in written.notices if "maskTexture" in each and "keeps the old" in each]
    assert len(said) == len(written.notices) == is_data_elsewhere


@pytest.mark.parametrize("path", INDICES)
def test_only_what_shows_a_texture_keeps_it_as_it_was(tmp_path, path):
    model = with_images()
    model.tree = put(model.tree, path, {"index": 0, "weight": 1})
    source = model.written_to(tmp_path)
    target = save(with_image(source, new_image(1)), "o.glb", tmp_path)
    tree, *_ = opened(target)
    assert len(tree["textures"]) == (2 if INDICES[path] else 1)
    assert tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"] == INDICES[path]
    if not INDICES[path]:
        assert tree["materials"] == model.tree["materials"]
    before, after = (open_document(str(path)).fingerprint().parts for path in (source, target))
    assert after == before


@pytest.mark.parametrize("fallback", [True, False])
@pytest.mark.parametrize("suffix", [".webp", ".png"])
def test_webp_stays_webp_or_leaves_no_trace(tmp_path, fallback, suffix):
    model = with_better_image("webp", picture(2, WEBP), picture(1) if fallback else None)
    model.tree["extensionsUsed"].insert(0, "KHR_other")
    (better,) = model.tree["textures"][0]["extensions"]["EXT_texture_webp"].values()
    written = with_image(model.written_to(tmp_path), new_image(1, suffix), f"image {better}", in_place=True)
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


@pytest.mark.parametrize(
    ("name", "suffix", "moved", "expected"),
    [
        ("model.png", ".png", False, "out.png"),
        ("maps/model_base color.png", ".png", False, "maps/out_base color.png"),
        ("remodelled.png", ".png", False, "out_remodelled.png"),
        ("maps/skin.png", ".jpg", False, "maps/out_skin.jpg"), ("maps/skin.JPEG", ".jpg", True, "maps/skin.JPEG"),
        ("maps/skin.png", ".webp", True, "maps/skin.webp"), ("100%.png", ".png", True, "100%.png"),
        ("100%.png", ".png", False, "out_100%.png"), ("skin", ".png", True, "skin.png"),
        ("TAKEN.png", ".jpg", True, "TAKEN-2.jpg"), ("out_skin.png", ".png", False, "out_out_skin.png"), ],
)  # fmt: skip
def test_image_files_are_named_after_the_output_and_spare_the_sources(
    tmp_path, name, suffix, moved, expected
):
    model = with_images(place="file")
    model.tree["images"][0]["uri"] = name.replace("%", "%25").replace(" ", "%20")
    model.tree["images"].append({"uri": "Taken.jpg"})
    model.files = {name: picture(1), "Taken.jpg": picture(3)}
    written = with_image(model.written_to(tmp_path, "gltf"), new_image(1, suffix), in_place=moved)
    assert list(written.sidecars) == [expected]
    uri = json.loads(joined(written))["images"][0]["uri"]
    assert uri == expected.replace("%", "%25").replace(" ", "%20")


def test_a_name_that_stays_keeps_its_spelling(tmp_path):
    model = with_images(place="file")
    model.tree["images"][0]["uri"] = "sk%69n,(1).png"
    model.files = {"skin,(1).png": picture(1)}
    source = model.written_to(tmp_path, "gltf")
    written = with_image(source, new_image(1), in_place=True)
    assert joined(written) == source.read_bytes()
    assert written.sidecars == {"skin,(1).png": new_image(1).data}


@pytest.mark.parametrize(
    ("form", "place"),
    [("glb", "view"), ("glb", "file"), ("gltf", "view"), ("gltf", "data"), ("gltf", "file")],
)
def test_images_are_replaced_on_the_way_to_the_other_form(tmp_path, place, form):
    document = open_document(str(with_images(2, place, 300).written_to(tmp_path, form)))
    other = "gltf" if form == "glb" else "glb"
    images = {("baseColor", "image 1"): new_image(1, ".jpg")}
    written = document.patch(None, Naming("out"), form=other, images=images)
    found = shown(save(written, f"out.{other}", tmp_path))
    assert [data for data, _ in found.values()] == [picture(1, size=300), new_image(1, ".jpg").data]


def test_types_that_gltf_cannot_hold_are_refused(tmp_path):
    with pytest.raises(OutputError, match=r"cannot hold \.exr textures.*--texture-format"):
        with_image(with_images().written_to(tmp_path), ImageFile(b"v/1", ".exr"))


@pytest.mark.slow
@pytest.mark.parametrize(("form", "every"), [("glb", True), ("glb", False), ("gltf", True), ("data", False)])
def test_repeated_patches_do_not_grow_the_file_without_bound(tmp_path, form, every):
    path, rng, largest = with_images(3, size=300).written_to(tmp_path, form), np.random.default_rng(5), 400
    first = opened(path)[0]
    start = first["buffers"][0]["byteLength"]
    for run in range(40):
        document = open_document(str(path))
        textures = document.textured("baseColor").textures
        images = {
            ("baseColor", texture.key): new_image(rng.integers(1 << 30), size=int(rng.integers(50, largest)))
            for texture in (textures if every else [textures[run % 3]])
        }
        folder = tmp_path / str(run)
        folder.mkdir()
        written = document.patch(None, Naming("m", is_moved=True), images=images)
        path = save(written, "m" + path.suffix, folder, path)
        after = opened(path)[0]
        assert {file.data for file in images.values()} <= {data for data, _ in shown(path).values()}
        if every:
            sizes = sum(-(-len(file.data) // 4) * 4 for file in images.values())
            assert after["buffers"][0]["byteLength"] <= start + sizes + 8
    assert after["buffers"][0]["byteLength"] < start + 3 * 5 * largest
    assert len(after["images"]) == 3
    assert len(after["bufferViews"]) == len(first["bufferViews"])


@pytest.mark.parametrize("reader", ["part of it", "all of it", "right behind it", "lights of the scene"])
def test_bytes_that_something_else_reads_stay_where_they_are(tmp_path, reader):
    model = with_images(size=80)
    index = model.tree["images"][0]["bufferView"]
    view = model.tree["bufferViews"][index]
    if reader == "part of it":
        model.tree["bufferViews"].append(view | {"byteOffset": view["byteOffset"] + 8, "byteLength": 40})
    elif reader == "all of it":
        model.accessor(np.zeros((10, 1), "<u1"), index)
    elif reader == "lights of the scene":
        model.tree["extensions"] = {"EXT_lights_image_based": {"lights": [{"specularImages": [[0, 0]]}]}}
    else:
        model.tree["images"][0]["bufferView"] = model.view(picture(1, size=80))
        model.view(b"tiny")
    path, new = model.written_to(tmp_path), new_image(2, size=60)
    patched = save(with_image(path, new), "o.glb", tmp_path)
    check_rest(path, patched)
    assert shown(patched) == {(0, "baseColor"): (new.data, {})}
    (_, (old,), _), (tree, buffers, _) = opened(path), opened(patched)
    if reader == "all of it":
        at = slice(view["byteOffset"], view["byteOffset"] + 88)
        assert buffers[0][at] == old[at]
        assert tree["images"][0]["bufferView"] != index
    if reader == "lights of the scene":
        assert image_bytes(tree, buffers, {}, 0) == picture(1, size=80)


@pytest.mark.parametrize("place", ["at the end", "in front of others"])
def test_bytes_that_nothing_names_are_kept(tmp_path, place):
    model = with_images(size=80)
    model.binary += 20 * b"nameless"
    if place == "in front of others":
        model.view(b"tiny")
    written = with_image(model.written_to(tmp_path), new_image(2, size=100))
    assert 20 * b"nameless" in joined(written)


def test_a_second_buffer_over_one_file_keeps_its_bytes(tmp_path):
    model = with_images(size=80)
    model.tree["images"][0]["bufferView"] = model.view(picture(1, size=80))  # the last bytes
    path = model.written_to(tmp_path, "gltf")
    tree = json.loads(path.read_text())
    tree["buffers"] *= 2
    path.write_text(json.dumps(tree))
    written = with_image(path, new_image(2, size=20))
    (data,) = written.sidecars.values()
    assert all(each["byteLength"] <= len(data) for each in json.loads(joined(written))["buffers"])


def test_images_that_share_bytes_are_one_and_all_stay_in_use(tmp_path):
    """Some exporters describe the same image once for every texture."""
    model = Textured()
    view = model.view(picture(1))
    model.tree["images"] += [{"bufferView": view, "mimeType": "image/png"} for _ in range(3)]
    for number in range(3):
        model.triangles(SQUARE + number, SQUARE[:, :2], model.material(baseColor=model.texture(number)))
    source = model.written_to(tmp_path)
    (texture,) = open_document(str(source)).textured("baseColor").textures
    target = save(with_image(source, new_image(1), texture.key), "out.glb", tmp_path)
    assert all(opened(target)[0][key] == model.tree[key] for key in ("images", "textures", "materials"))
    assert {data for data, _ in shown(target).values()} == {new_image(1).data}


@pytest.mark.parametrize("place", ["view", "file"])
@pytest.mark.parametrize("others", ["emissive", "nothing"])
def test_an_image_over_the_bytes_of_another_changes_unless_something_shows_it(tmp_path, place, others):
    model = Textured(place)
    first = model.image(picture(1))
    model.tree["images"].append(dict(model.tree["images"][first], name="again"))
    slots = {"baseColor": model.texture(first)}
    if others != "nothing":
        slots[others] = model.texture(first + 1)
    model.triangles(SQUARE, SQUARE[:, :2], model.material(**slots))
    source, new = model.written_to(tmp_path), new_image(1)
    (tmp_path / "out").mkdir()
    target = save(with_image(source, new, in_place=True), source.name, tmp_path / "out")
    for name in model.files:
        (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
        if not (tmp_path / "out" / name).exists():
            (tmp_path / "out" / name).write_bytes(model.files[name])
    tree, buffers, files = opened(target)
    kept = picture(1) if others != "nothing" else new.data
    assert [image_bytes(tree, buffers, files, index) for index in (0, 1)] == [new.data, kept]
    assert len(tree["images"]) == 2
