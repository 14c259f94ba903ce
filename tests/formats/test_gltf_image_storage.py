"""New images in the buffers of a glTF file: no bytes are wasted, and nothing that is in use moves."""

from __future__ import annotations

import numpy as np
import pytest

from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.registry import open_document
from formats.gltf_files import Textured, joined, opened, picture, unpacked
from formats.gltf_images import SQUARE, check_rest, copied, image_bytes, new_image, save, shown, with_images


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
