"""The container of glTF files: chunks, text, sidecar buffers; edited text keeps its words, and both forms all data."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.container import parsed, revised
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_files import Model, coloured, joined, numbers, unpacked


def small(seed=0):
    return coloured("dense", np.random.default_rng(seed), count=5).model


def test_a_byte_order_mark_is_reported_and_kept():
    data = b"\xef\xbb\xbf" + small().data_text(indent=1)
    document = GltfDocument(data, "model.gltf", None)
    assert [notice for notice in document.notices if "byte order mark" in notice]
    assert joined(document.patch(1 - document.painted().colours, Naming("out"))).startswith(data[:20])


@pytest.mark.parametrize("uri", ["../up.bin", "%2e%2e/up.bin", "..%5cup.bin", "missing.bin", ""])
def test_buffers_outside_the_folder_are_never_read(tmp_path, uri):
    model = small()
    (tmp_path / "in").mkdir()
    (tmp_path / "up.bin").write_bytes(bytes(model.binary))
    document = GltfDocument(model.text(uri), "model.gltf", tmp_path / "in")
    assert not document.references()
    assert [notice for notice in document.notices if "buffers[0]" in notice]
    with pytest.raises(InputError, match=r"buffers\[0\].uri"):
        document.painted()


SPELLINGS = [
    "sub%20dir/%C3%BC.bin",
    "sub dir\\ü.bin",
    "sub%20dir/%C3%BC.bin?v=3#x",
    "sub%2520dir/%25C3%25BC.bin",
]


@pytest.mark.parametrize("uri", SPELLINGS)
def test_files_inside_the_folder_are_found_and_listed(tmp_path, uri):
    model = small()
    (tmp_path / "sub dir").mkdir()
    (tmp_path / "sub dir" / "ü.bin").write_bytes(bytes(model.binary))
    (tmp_path / "x.png").write_bytes(b"\x89PNG")
    model.tree["images"] = [{"uri": "x.png"}, {"uri": "y.png"}, {"uri": "data:image/png;base64,AA=="}]
    document = GltfDocument(model.text(uri), "model.gltf", tmp_path)
    assert len(document.painted().colours) == 5
    assert document.references() == ["sub dir/ü.bin", "x.png"]
    assert [notice for notice in document.notices if "'y.png' is missing" in notice]
    written = document.patch(1 - document.painted().colours, Naming("out", keeps=True))
    assert list(written.sidecars) == ["sub dir/ü.bin"]
    moved = document.patch(1 - document.painted().colours, Naming("out"))
    assert list(moved.sidecars) == ["sub dir/out.bin"]
    assert b'"sub%20dir/out.bin"' in joined(moved)


def test_two_buffers_over_one_file_stay_one_file(tmp_path):
    model = small()
    (tmp_path / "x.bin").write_bytes(bytes(model.binary))
    tree = json.loads(model.text("x.bin"))
    tree["buffers"].append({"uri": "./x.bin", "byteLength": len(model.binary)})
    tree["bufferViews"][-1]["buffer"] = 1  # the colours, seen through the second buffer
    document = GltfDocument(json.dumps(tree).encode(), "model.gltf", tmp_path)
    colours = 1 - document.painted().colours
    written = document.patch(colours, Naming("out"))
    (tmp_path / "out.bin").write_bytes(bytes(written.sidecars["out.bin"]))
    again = GltfDocument(joined(written), "out.gltf", tmp_path)
    assert {buffer["uri"] for buffer in json.loads(joined(written))["buffers"]} == {"out.bin"}
    np.testing.assert_allclose(again.painted().colours, colours, atol=0.5 / 255)


def test_percent_encoded_data_uris_are_read_and_rewritten():
    model = small()
    uri = "data:application/octet-stream," + "".join(f"%{octet:02x}" for octet in model.binary)
    document = GltfDocument(model.text(uri), "model.gltf", None)
    colours = 1 - document.painted().colours
    again = GltfDocument(joined(document.patch(colours, Naming("out"))), "out.gltf", None)
    np.testing.assert_allclose(again.painted().colours, colours, atol=0.5 / 255)


def decoded(tree, buffers):
    return [numbers(tree, buffers, index) for index in range(len(tree["accessors"]))]


def same(first, second):
    for before, after in zip(first, second, strict=True):
        np.testing.assert_array_equal(before, after)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 99), indent=st.sampled_from((None, 2)), changed=st.booleans())
def test_binary_to_text_and_back_gives_the_same_file(tmp_path_factory, seed, indent, changed):
    folder = tmp_path_factory.mktemp("repackaged")
    data = small(seed).glb(indent=indent)
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


def test_several_buffers_and_images_become_one_chunk(tmp_path):
    model, other = small(), Model()
    tree = json.loads(model.text("one.bin", indent=1))
    colour = other.packed(np.arange(15, dtype="<f4").reshape(5, 3) / 20)
    tree["buffers"].append({"uri": "two.bin", "byteLength": len(other.binary)})
    tree["bufferViews"].append(other.tree["bufferViews"][0] | {"buffer": 1})
    tree["accessors"].append(other.tree["accessors"][colour] | {"bufferView": len(tree["bufferViews"]) - 1})
    attributes = {"POSITION": 0, "COLOR_0": len(tree["accessors"]) - 1}
    tree["meshes"][0]["primitives"].append({"attributes": attributes})
    tree["images"] = [{"uri": "x.png", "name": "x"}, {"uri": "../y.png"}, {"uri": "z.png"}]
    png = b"\x89PNG\r\n\x1a\n"
    files = {"one.bin": bytes(model.binary) + b"more", "two.bin": bytes(other.binary), "x.png": png}
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    document = GltfDocument(json.dumps(tree, indent=1).encode(), "a.gltf", tmp_path)
    written = document.patch(document.painted().colours, Naming("b", keeps=True), form="glb")
    after, buffers = unpacked(joined(written))
    assert not written.sidecars
    assert len(after["buffers"]) == len(buffers) == 1
    same(decoded(tree, [files["one.bin"], files["two.bin"]]), decoded(after, buffers))
    image = after["images"][0]
    place = after["bufferViews"][image.pop("bufferView")]
    assert image == {"name": "x", "mimeType": "image/png"}
    assert buffers[0][place["byteOffset"] :][: place["byteLength"]] == png
    assert after["images"][1:] == tree["images"][1:]
    assert len([notice for notice in written.notices if "stays outside" in notice]) == 2
    colours = 1 - document.painted().colours
    again = GltfDocument(joined(document.patch(colours, Naming("b"), form="glb")), "b.glb", None)
    np.testing.assert_allclose(again.painted().colours, colours, atol=0.002)


def test_lost_chunks_are_reported():
    document = GltfDocument(small().glb((b"XTRA", b"1234")), "a.glb", None)
    written = document.patch(document.painted().colours, Naming("b"), form="gltf")
    assert [notice for notice in written.notices if "unknown type" in notice]


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-9, 9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=12,
)
trees = st.dictionaries(st.text(max_size=3), values, max_size=4)
styles = st.sampled_from(
    [
        {},
        {"indent": 2},
        {"indent": "\t"},
        {"separators": (",", ":")},
        {"indent": 0},
        {"indent": 1, "separators": (",", " : ")},
    ]
)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(old=trees, new=trees, style=styles, ascii_only=st.booleans(), crlf=st.booleans())
def test_revised_text_parses_to_the_new_tree_in_the_style_of_the_source(old, new, style, ascii_only, crlf):
    text = json.dumps(old, ensure_ascii=ascii_only, **style)
    text = text.replace("\n", "\r\n") if crlf else text
    assert revised(text, parsed(text, "")) == text
    assert parsed(revised(text, new), "") == new
    plain = {"a": 1, "b": ["x", 3], "c": {}, "d": [], "e": 0}
    added = {
        "a": 1,
        "b": ["x", 4, {"y": 2}],
        "c": {"x": 1},
        "d": [2],
        "f": {"x": 1, "y": 2},
    }  # and one removed
    text = json.dumps(plain, ensure_ascii=False, **style)
    assert revised(text, added) == json.dumps(added, ensure_ascii=False, **style)


def test_numbers_escapes_and_spacing_of_the_rest_stay():
    text = '{ "a":1.50E+2 ,\n  "caf\\u00e9" : [ 0.10, 2e-3,3 ],\t"b": {"x": 1 , "y":2}  }'
    tree = parsed(text, "")
    tree["b"]["y"] = 7
    tree["café"][2] = 4
    assert revised(text, tree) == text.replace('"y":2', '"y":7').replace("2e-3,3", "2e-3,4")


def test_half_characters_stay_escaped():
    text = '{"a": ["\\ud800"], "b": 1}'
    tree = parsed(text, "x.gltf")
    tree["a"].append({"name": tree["a"][0]})
    tree["b"] = "ü"
    assert revised(text, tree).encode() == '{"a": ["\\ud800",{"name": "\\ud800"}], "b": "ü"}'.encode()
