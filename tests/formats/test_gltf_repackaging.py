"""GLB to text glTF and back, without loss."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_files import Model, joined, numbers, unpacked


def model_with_colours(seed=0, count=5):
    rng, model = np.random.default_rng(seed), Model()
    attributes = {
        "POSITION": model.packed(rng.normal(size=(count, 3)).astype("<f4")),
        "COLOR_0": model.packed(rng.integers(0, 256, (count, 4)).astype("<u1"), normalized=True),
    }
    model.mesh({"attributes": attributes, "indices": model.indices(np.array([0, 1, 2], "<u1"))})
    return model


def decoded(tree, buffers):
    return [numbers(tree, buffers, index) for index in range(len(tree["accessors"]))]


def same(first, second):
    for before, after in zip(first, second, strict=True):
        np.testing.assert_array_equal(before, after)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 99), indent=st.sampled_from((None, 2)), changed=st.booleans())
def test_binary_to_text_and_back_gives_the_same_file(tmp_path_factory, seed, indent, changed):
    folder = tmp_path_factory.mktemp("repackaged")
    data = model_with_colours(seed).glb(indent=indent)
    document = GltfDocument(data, "a.glb", folder)
    colours = document.painted().colours
    wanted = 1 - colours if changed else colours
    text = document.patch(wanted, Naming("b"), form="gltf")
    (folder / "b.bin").write_bytes(bytes(text.sidecars["b.bin"]))
    tree, buffers = unpacked(joined(text), text.sidecars)
    assert tree["buffers"][0] == {"byteLength": len(buffers[0]), "uri": "b.bin"}
    if not changed:
        same(decoded(*unpacked(data)), decoded(tree, buffers))
    middle = GltfDocument(joined(text), "b.gltf", folder)
    back = joined(middle.patch(colours, Naming("c"), form="glb"))
    assert unpacked(back)[0] == unpacked(data)[0]
    same(decoded(*unpacked(back)), decoded(*unpacked(data)))
    if not changed:
        assert back == data


@pytest.mark.parametrize("changed", [False, True])
def test_several_buffers_and_images_become_one_chunk(tmp_path, changed):
    model = model_with_colours()
    tree = json.loads(model.text("one.bin", indent=1))
    other = Model()
    colour = other.packed(np.arange(15, dtype="<f4").reshape(5, 3) / 20)
    view = other.tree["bufferViews"][0] | {"buffer": 1}
    tree["buffers"].append({"uri": "two.bin", "byteLength": len(other.binary)})
    tree["bufferViews"].append(view)
    tree["accessors"].append(other.tree["accessors"][colour] | {"bufferView": len(tree["bufferViews"]) - 1})
    tree["meshes"][0]["primitives"].append(
        {"attributes": {"POSITION": 0, "COLOR_0": len(tree["accessors"]) - 1}}
    )
    tree["images"] = [{"uri": "x.png", "name": "x"}, {"uri": "../y.png"}, {"uri": "z.png"}]
    files = {
        "one.bin": bytes(model.binary) + b"more",
        "two.bin": bytes(other.binary),
        "x.png": b"\x89PNG\r\n\x1a\n",
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    data = json.dumps(tree, indent=1).encode()
    document = GltfDocument(data, "a.gltf", tmp_path)
    colours = 1 - document.painted().colours if changed else document.painted().colours
    written = document.patch(colours, Naming("b", keeps=True), form="glb")
    after, buffers = unpacked(joined(written))
    assert not written.sidecars
    assert len(after["buffers"]) == len(buffers) == 1
    np.testing.assert_allclose(
        GltfDocument(joined(written), "b.glb", None).painted().colours, colours, atol=0.002
    )
    if not changed:
        same(decoded(tree, [files["one.bin"], files["two.bin"]]), decoded(after, buffers))
    image = after["images"][0]
    place = after["bufferViews"][image.pop("bufferView")]
    assert image == {"name": "x", "mimeType": "image/png"}
    assert buffers[0][place["byteOffset"] :][: place["byteLength"]] == files["x.png"]
    assert after["images"][1:] == tree["images"][1:]
    assert len([notice for notice in written.notices if "stays outside" in notice]) == 2


def test_lost_chunks_are_reported():
    document = GltfDocument(model_with_colours().glb((b"XTRA", b"1234")), "a.glb", None)
    written = document.patch(document.painted().colours, Naming("b"), form="gltf")
    assert [notice for notice in written.notices if "unknown type" in notice]
