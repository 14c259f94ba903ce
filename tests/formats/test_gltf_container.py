"""The container of glTF files: chunks, text, sidecar buffers; edited text keeps its words, and both forms all data.

Damaged files: cut off, of members of another kind, or of numbers that contradict each other. Whatever is asked of the
document, each is refused in one line that names the place, or does no harm.
"""

import copy
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.formats.gltf.json_text import parsed, revised
from formats.gltf_compressed import DRACO, decompressed, draco_model, meshopt_model
from formats.gltf_files import Model, Textured, coloured, joined, picture, unpacked
from formats.gltf_showcase import showcase
from fuzz.targets import attempt


def small(seed=0):
    return coloured("dense", np.random.default_rng(seed), count=5).model


def test_a_byte_order_mark_is_reported_and_kept():
    data = b"\xef\xbb\xbf" + small().data_text(indent=1)
    document = GltfDocument(data, "model.gltf", None)
    assert [notice for notice in document.notices if "byte order mark" in notice]
    assert joined(document.patch(1 - document.coloured_vertices().colours, Naming("out"))).startswith(
        data[:20]
    )


@pytest.mark.parametrize("uri", ["../up.bin", "%2e%2e/up.bin", "..%5cup.bin", "missing.bin", ""])
def test_buffers_outside_the_folder_are_never_read(tmp_path, uri):
    model = small()
    (tmp_path / "in").mkdir()
    (tmp_path / "up.bin").write_bytes(bytes(model.binary))
    document = GltfDocument(model.text(uri), "model.gltf", tmp_path / "in")
    assert not document.references()
    assert [notice for notice in document.notices if "buffers[0]" in notice]
    with pytest.raises(InputError, match=r"buffers\[0\].uri"):
        document.coloured_vertices()


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
    assert len(document.coloured_vertices().colours) == 5
    assert document.references() == ["sub dir/ü.bin", "x.png"]
    assert [notice for notice in document.notices if "'y.png' is missing" in notice]
    written = document.patch(1 - document.coloured_vertices().colours, Naming("out", in_place=True))
    assert list(written.sidecars) == ["sub dir/ü.bin"]
    moved = document.patch(1 - document.coloured_vertices().colours, Naming("out"))
    assert list(moved.sidecars) == ["sub dir/out.bin"]
    assert b'"sub%20dir/out.bin"' in joined(moved)


def test_two_buffers_over_one_file_stay_one_file(tmp_path):
    model = small()
    (tmp_path / "x.bin").write_bytes(bytes(model.binary))
    tree = json.loads(model.text("x.bin"))
    tree["buffers"].append({"uri": "./x.bin", "byteLength": len(model.binary)})
    tree["bufferViews"][-1]["buffer"] = 1  # the colours, seen through the second buffer
    document = GltfDocument(json.dumps(tree).encode(), "model.gltf", tmp_path)
    colours = 1 - document.coloured_vertices().colours
    written = document.patch(colours, Naming("out"))
    (tmp_path / "out.bin").write_bytes(bytes(written.sidecars["out.bin"]))
    again = GltfDocument(joined(written), "out.gltf", tmp_path)
    assert {buffer["uri"] for buffer in json.loads(joined(written))["buffers"]} == {"out.bin"}
    np.testing.assert_allclose(again.coloured_vertices().colours, colours, atol=0.5 / 255)


def test_percent_encoded_data_uris_are_read_and_rewritten():
    model = small()
    uri = "data:application/octet-stream," + "".join(f"%{octet:02x}" for octet in model.binary)
    document = GltfDocument(model.text(uri), "model.gltf", None)
    colours = 1 - document.coloured_vertices().colours
    again = GltfDocument(joined(document.patch(colours, Naming("out"))), "out.gltf", None)
    np.testing.assert_allclose(again.coloured_vertices().colours, colours, atol=0.5 / 255)


def same(first, second):
    for before, after in zip(first, second, strict=True):
        np.testing.assert_array_equal(before, after)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 99),
    compressed=st.booleans(),
    indent=st.sampled_from((None, 2)),
    changed=st.booleans(),
)
def test_binary_to_text_and_back_gives_the_same_file(tmp_path_factory, seed, compressed, indent, changed):
    folder = tmp_path_factory.mktemp("repackaged")
    data = (meshopt_model(COLOURS) if compressed else small(seed)).glb(indent=indent)
    document = GltfDocument(data, "a.glb", folder)
    colours = document.coloured_vertices().colours
    wanted = 1 - colours if changed else colours
    text = document.patch(wanted, Naming("b"), form="gltf")
    (folder / "b.bin").write_bytes(bytes(text.sidecars["b.bin"]))
    tree, buffers = unpacked(joined(text), text.sidecars)
    assert tree["buffers"][0] == {"byteLength": len(buffers[0]), "uri": "b.bin"}
    if not changed:
        same(decompressed(*unpacked(data)), decompressed(tree, buffers))
    middle = GltfDocument(joined(text), "b.gltf", folder)
    np.testing.assert_allclose(middle.coloured_vertices().colours, wanted, atol=0.5 / 255)
    back = joined(middle.patch(colours, Naming("c"), form="glb"))
    assert unpacked(back)[0] == unpacked(data)[0]
    same(decompressed(*unpacked(back)), decompressed(*unpacked(data)))
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
    written = document.patch(document.coloured_vertices().colours, Naming("b", in_place=True), form="glb")
    after, buffers = unpacked(joined(written))
    assert not written.sidecars
    assert len(after["buffers"]) == len(buffers) == 1
    same(decompressed(tree, [files["one.bin"], files["two.bin"]]), decompressed(after, buffers))
    image = after["images"][0]
    place = after["bufferViews"][image.pop("bufferView")]
    assert image == {"name": "x", "mimeType": "image/png"}
    assert buffers[0][place["byteOffset"] :][: place["byteLength"]] == png
    assert after["images"][1:] == tree["images"][1:]
    assert len([notice for notice in written.notices if "stays outside" in notice]) == 2
    colours = 1 - document.coloured_vertices().colours
    again = GltfDocument(joined(document.patch(colours, Naming("b"), form="glb")), "b.glb", None)
    np.testing.assert_allclose(again.coloured_vertices().colours, colours, atol=0.002)


def test_lost_chunks_are_reported():
    document = GltfDocument(small().glb((b"XTRA", b"1234")), "a.glb", None)
    written = document.patch(document.coloured_vertices().colours, Naming("b"), form="gltf")
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
json_trees = st.dictionaries(st.text(max_size=3), values, max_size=4)
styles = st.sampled_from(
    [
        {}, {"indent": 2}, {"indent": "\t"}, {"separators": (",", ":")}, {"indent": 0},
        {"indent": 1, "separators": (",", " : ")},
    ]
)  # fmt: skip


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(old=json_trees, new=json_trees, style=styles, ascii_only=st.booleans(), crlf=st.booleans())
def test_revised_text_parses_to_the_new_tree_in_the_style_of_the_source(old, new, style, ascii_only, crlf):
    text = json.dumps(old, ensure_ascii=ascii_only, **style)
    text = text.replace("\n", "\r\n") if crlf else text
    assert revised(text, parsed(text, "")) == text
    assert parsed(revised(text, new), "") == new
    plain = {"a": 1, "b": ["x", 3], "c": {}, "d": [], "e": 0}
    added = {
        "a": 1, "b": ["x", 4, {"y": 2}], "c": {"x": 1}, "d": [2], "f": {"x": 1, "y": 2},
    }  # and one removed  # fmt: skip
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


WRONG = (
    None, 0, 5, -1, "x", [], {}, True, 1.5, [[]], [{}], ["x"], [None], [0, 1], 10**30,
    {"a": []}, {"extensions": []}, {"bufferView": 0},
)  # fmt: skip
COLOURS = np.arange(36 * 4, dtype=np.uint8).reshape(36, 4)


def rare_uses():
    """Return a small model with rare uses of the numbers of accessors and views."""
    model = Model()
    colour = model.sparse(np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "<u1"), [1], None, normalized=True)
    position = model.packed(np.eye(3, dtype="<f4"))
    model.mesh({"attributes": {"POSITION": position, "COLOR_0": colour}}, translation=[1, 2, 3])
    model.mesh({"attributes": {"POSITION": position}, "targets": [{"POSITION": position}]})
    model.tree["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}
    model.tree["bufferViews"][0]["extensions"] = {"EXT_any": {"buffer": 0, "byteLength": 4}}
    model.tree["materials"] = [{"extensions": {"EXT_any": {"bufferView": 1}}}]
    return model


@cache
def trees():
    """Return the JSON of models with nearly everything, of compressed ones, and of a small one."""
    models = [showcase("data"), draco_model(COLOURS), meshopt_model(COLOURS), rare_uses()]
    return [json.loads(model.data_text()) for model in models]


def places(tree, place=()):
    """Give the place of everything in a tree but the tree itself."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in children:
        yield (*place, key)
        yield from places(value, (*place, key))


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_a_member_of_another_kind_is_refused_or_does_no_harm(data):
    tree = copy.deepcopy(data.draw(st.sampled_from(trees())))
    *parents, last = data.draw(st.sampled_from(list(places(tree))))
    holder = tree
    for key in parents:
        holder = holder[key]
    holder[last] = data.draw(st.sampled_from(WRONG))
    attempt("gltf", json.dumps(tree).encode())


FILES = rare_uses().glb(), rare_uses().data_text(indent=1)


@settings(max_examples=100, deadline=None)
@given(form=st.sampled_from([0, 1]), share=st.floats(0, 1, exclude_max=True))
@example(form=0, share=0.005)  # within the header
def test_truncated_files_raise_input_errors(form, share):
    cut = max(1, int(share * len(FILES[form])))
    with pytest.raises(InputError):
        GltfDocument(FILES[form][:cut], "model", None).coloured_vertices()


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (b"[]", "not an object"),
        (b'{"asset": {"version": "2.0"}, "asset": {}}', "twice"),
        (b'{"asset": NaN}', "NaN"),
        (b'{"asset": {"version": 1}}', "asset.version: is 1, but only glTF 2 can be read; export the model"),
        (b'{"asset": {"version": "1.0"}}', "asset.version: is '1.0', but only glTF 2"),
        (b'{"a":' * 5000 + b"1" + b"}" * 5000, "nested"), (b'{"a":' * 150 + b"1" + b"}" * 150, "nested"),
        (b'{"a": ' + b"9" * 5000 + b"}", "damaged"), (b"\xff\xfe{}", "UTF-8"), (b"", "damaged"), ],
)  # fmt: skip
def test_what_is_no_gltf_is_refused(text, cause):
    with pytest.raises(InputError, match=cause):
        GltfDocument(text, "model.gltf", None)


def plain():
    """Return a coloured and textured triangle: accessors and views 0 of positions, 1 of colours, 2 of coordinates."""
    model = Textured()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    position, colour, uv = map(model.packed, (corners, np.eye(3, dtype="<f4"), corners[:, :2]))
    attributes = {"POSITION": position, "COLOR_0": colour, "TEXCOORD_0": uv}
    texture = model.texture(model.image(picture(1)), wrap=(10497, 10497))
    info = {"index": texture, "extensions": {"KHR_texture_transform": {}}}
    corners = model.indices(np.array([0, 1, 2], "<u1"))
    model.mesh({"attributes": attributes, "indices": corners, "material": model.material(baseColor=info)})
    return model


def put(path, value, make=plain):
    """Return a model with another value of one member of its JSON, given by its path."""
    model = make()
    tree = model.tree
    *parents, last = path.split(".")
    for key in parents:
        tree = tree[int(key) if key.isdigit() else key]
    tree[int(last) if last.isdigit() else last] = value
    return model


def with_bytes(view, at, data):
    """Return a model with other bytes in a view."""
    model = plain()
    start = model.tree["bufferViews"][view]["byteOffset"] + at
    model.binary[start : start + len(data)] = data
    return model


def with_sparse_rows(rows):
    model = plain()
    indices, values = model.view(rows), model.view(bytes(24))
    sparse = {"bufferView": indices, "componentType": 5123}
    model.tree["accessors"][1]["sparse"] = {"count": 2, "indices": sparse, "values": {"bufferView": values}}
    return model


def draco(path, value):
    return put(path, value, lambda: draco_model(COLOURS, in_order=True))


def meshopt(key, value):
    return put(
        f"bufferViews.1.extensions.EXT_meshopt_compression.{key}", value, lambda: meshopt_model(COLOURS)
    )


PART = "meshes.0.primitives.0"
INFO = "materials.0.pbrMetallicRoughness.baseColorTexture"
TRANSFORM = f"{INFO}.extensions.KHR_texture_transform"
ZEROS = {"componentType": 5126, "type": "VEC3", "count": 10**9}
NOT_FINITE = b"\x01\x00\x80\x7f"  # a signalling NaN, which the processor would warn about
DAMAGES = [
    ("no vertex colours", put(f"{PART}.attributes", {"POSITION": 1})),
    ("meshes[0].primitives[0].attributes.COLOR_0", put(f"{PART}.attributes.COLOR_0", 99)),
    ("attributes.COLOR_0: has 2 elements, but POSITION has 3", put("accessors.1.count", 2)),
    ("attributes.POSITION: is missing", put(f"{PART}.attributes", {"COLOR_0": 1})),
    ("primitives[0].indices: names vertex", with_bytes(4, 1, b"\3")),
    ("primitives[0].mode", put(f"{PART}.mode", 7)),
    ("KHR_draco_mesh_compression", put(f"{PART}.extensions", {DRACO: {}})),
    ("EXT_meshopt_compression", put("bufferViews.1.extensions", {"EXT_meshopt_compression": {}})),
    ("accessors[1]: 400 elements need", put("accessors.1.count", 400)),
    ("accessors[1].count: is '3'", put("accessors.1.count", "3")),
    ("accessors[1].count: is True", put("accessors.1.count", True)),
    ("accessors[1].componentType: is 5124", put("accessors.1.componentType", 5124)),
    ("is VEC3 of int16, not a colour", put("accessors.1.componentType", 5122)),
    ("accessors[1].type", put("accessors.1.type", "VEC5")),
    ("accessors[1]: its elements of 12 bytes overlap", put("bufferViews.1.byteStride", 4)),
    ("bufferViews[1]: its bytes", put("bufferViews.1.byteOffset", 1 << 40)),
    ("bufferViews[1].byteLength", put("bufferViews.1.byteLength", -1)),
    ("nodes[0] is reached twice", put("nodes.0.children", [0])),
    ("has another parent", put("nodes", [{"mesh": 0}, {"children": [0]}, {"children": [0]}])),
    ("nodes[0].rotation", put("nodes.0.rotation", [0, 0, 0, 0])),
    ("nodes[0].matrix: must be 16 finite numbers", put("nodes.0.matrix", [1] * 15)),
    ("nodes[0].mesh", put("nodes.0.mesh", -1)), ("meshes: is 3 instead of an array", put("meshes", 3)),
    ("meshes[0]: is None instead of an object", put("meshes.0", None)),
    ("accessors[1].sparse.indices: must increase", with_sparse_rows(b"\2\0\1\0")),
    ("zeros are more than the file has bytes", put("accessors", [ZEROS] * 4)),
    ("1 is not finite", with_bytes(0, 12, NOT_FINITE)), ("1 is not finite", with_bytes(1, 12, NOT_FINITE)),
    ("index", put(f"{INFO}.index", 7)), ("TEXCOORD_0", put(f"{PART}.attributes.TEXCOORD_0", 0)),
    ("element 1 is not finite", with_bytes(2, 8, NOT_FINITE)), ("wrapS", put("samplers.0.wrapS", 1)),
    ("rotation", put(f"{TRANSFORM}.rotation", "left")),
    ("infinity", put(TRANSFORM, {"scale": [1e308, 1e308], "offset": [1.7e308, 0]})),
    ("primitives[0].attributes: is list instead of", put(f"{PART}.attributes", [])),
    ("attributes.A: is True instead of", put(f"{PART}.attributes.A", True)),
    ("extensionsUsed[0]: is list instead of", put("extensionsUsed", [["KHR_x"]])),
    ("bufferView: is 'x'", draco(f"{PART}.extensions.{DRACO}.bufferView", "x")),
    ("COLOR_0: is 77, but there is no such", draco(f"{PART}.extensions.{DRACO}.attributes.COLOR_0", 77)),
    ("count: is 35 of 4, but 36 elements of 4 numbers were decoded", draco("accessors.1.count", 35)),
    ("does not fit the decoded numbers of uint8", draco("accessors.1.componentType", 5126)),
    ("bufferViews[1].extensions.EXT_meshopt_compression.buffer: is 2", meshopt("buffer", 2)),
    ("leave buffers[0]", meshopt("byteOffset", 1 << 40)),
    ("its compressed data is damaged", meshopt("byteLength", 5)),
    ("count: is 35: 140 bytes, but the view has 144", meshopt("count", 35)),
    ("byteStride: is 6", meshopt("byteStride", 6)), ("mode: is 'SPHERES'", meshopt("mode", "SPHERES")),
    ("its compressed data is damaged", meshopt("mode", "TRIANGLES")),
    ("filter: is 'SEPIA'", meshopt("filter", "SEPIA")), ("byteStride: is 4", meshopt("filter", "QUATERNION")),
]  # fmt: skip


@pytest.mark.parametrize(("message", "model"), DAMAGES)
def test_damage_is_named_with_its_place(message, model):
    with pytest.raises(InputError, match=r"^model\.glb: [^\n]*$") as caught:  # noqa: PT012
        document = GltfDocument(model.glb(), "model.glb", None)
        document.coloured_vertices()
        document.textured("baseColor")
    assert message in str(caught.value)
