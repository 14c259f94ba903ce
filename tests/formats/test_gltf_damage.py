"""Damaged glTF files: cut off, of members of another kind, or of numbers that contradict each other.

Whatever is asked of the document, each is refused in one line that names the place, or does no harm.
"""

from __future__ import annotations

import copy
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_compressed import DRACO, draco_model, meshopt_model
from formats.gltf_files import Model, Textured, picture
from formats.gltf_showcase import showcase
from fuzz.targets import attempt

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
        GltfDocument(FILES[form][:cut], "model", None).painted()


@pytest.mark.parametrize(
    ("text", "cause"),
    [
        (b"[]", "not an object"),
        (b'{"asset": {"version": "2.0"}, "asset": {}}', "twice"),
        (b'{"asset": NaN}', "NaN"),
        (b'{"asset": {"version": 1}}', "asset.version: is 1, but only glTF 2 can be read; export the model"),
        (b'{"asset": {"version": "1.0"}}', "asset.version: is '1.0', but only glTF 2"),
        (b'{"a":' * 5000 + b"1" + b"}" * 5000, "nested"),
        (b'{"a":' * 150 + b"1" + b"}" * 150, "nested"),
        (b'{"a": ' + b"9" * 5000 + b"}", "damaged"),
        (b"\xff\xfe{}", "UTF-8"),
        (b"", "damaged"),
    ],
)
def test_what_is_no_gltf_is_refused(text, cause):
    with pytest.raises(InputError, match=cause):
        GltfDocument(text, "model.gltf", None)


def plain():
    """Return a painted and textured triangle: accessors and views 0 of positions, 1 of colours, 2 of coordinates."""
    model = Textured()
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
    position, colour, uv = (
        model.packed(array) for array in (corners, np.eye(3, dtype="<f4"), corners[:, :2])
    )
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
NOT_FINITE = b"\x01\x00\x80\x7f"  # a NaN that signals, of which the processor would warn
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
    ("nodes[0].mesh", put("nodes.0.mesh", -1)),
    ("meshes: is 3 instead of an array", put("meshes", 3)),
    ("meshes[0]: is None instead of an object", put("meshes.0", None)),
    ("accessors[1].sparse.indices: must increase", with_sparse_rows(b"\2\0\1\0")),
    ("zeros are more than the file has bytes", put("accessors", [ZEROS] * 4)),
    ("1 is not finite", with_bytes(0, 12, NOT_FINITE)),
    ("1 is not finite", with_bytes(1, 12, NOT_FINITE)),
    ("index", put(f"{INFO}.index", 7)),
    ("TEXCOORD_0", put(f"{PART}.attributes.TEXCOORD_0", 0)),
    ("element 1 is not finite", with_bytes(2, 8, NOT_FINITE)),
    ("wrapS", put("samplers.0.wrapS", 1)),
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
    ("byteStride: is 6", meshopt("byteStride", 6)),
    ("mode: is 'SPHERES'", meshopt("mode", "SPHERES")),
    ("its compressed data is damaged", meshopt("mode", "TRIANGLES")),
    ("filter: is 'SEPIA'", meshopt("filter", "SEPIA")),
    ("byteStride: is 4", meshopt("filter", "QUATERNION")),
]


@pytest.mark.parametrize(("message", "model"), DAMAGES)
def test_damage_is_named_with_its_place(message, model):
    with pytest.raises(InputError, match=r"^model\.glb: [^\n]*$") as caught:  # noqa: PT012
        document = GltfDocument(model.glb(), "model.glb", None)
        document.painted()
        document.textured("baseColor")
    assert message in str(caught.value)
