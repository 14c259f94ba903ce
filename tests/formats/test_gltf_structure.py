"""Members of a glTF file of the wrong kind: each is a refusal or does no harm, whatever is asked of the document."""

from __future__ import annotations

import contextlib
import copy
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import BeltramiError, InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.surface.records import ImageFile
from formats.gltf_compressed import draco_model, meshopt_model
from formats.gltf_files import Model, only_input_errors
from formats.gltf_showcase import showcase

WRONG = (
    None, 0, 5, -1, "x", [], {}, True, 1.5, [[]], [{}], ["x"], [None], [0, 1], 10**30,
    {"a": []}, {"extensions": []}, {"bufferView": 0},
)  # fmt: skip


@cache
def trees(folder):
    """JSON of models with nearly everything, of compressed ones, and of a small one with rare uses of its numbers."""
    colours = np.arange(36 * 4, dtype=np.uint8).reshape(36, 4)
    models = [showcase("data"), draco_model(colours), meshopt_model(colours), rare_uses()]
    return [json.loads(model.written_to(folder, "data").read_bytes()) for model in models]


def rare_uses():
    model = Model()
    colour = model.sparse(np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "<u1"), [1], None, normalized=True)
    position = model.packed(np.eye(3, dtype="<f4"))
    model.mesh({"attributes": {"POSITION": position, "COLOR_0": colour}}, translation=[1, 2, 3])
    model.mesh({"attributes": {"POSITION": position}, "targets": [{"POSITION": position}]})
    model.tree["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}}
    model.tree["bufferViews"][0]["extensions"] = {"EXT_any": {"buffer": 0, "byteLength": 4}}
    model.tree["materials"] = [{"extensions": {"EXT_any": {"bufferView": 1}}}]
    return model


def places(tree, place=()):
    """Give the place of everything in a tree but the tree itself."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in children:
        yield (*place, key)
        yield from places(value, (*place, key))


def use_all(document):
    """Ask for everything that a document can be asked for."""
    for name in ("facts", "references", "slots", "contents", "attributes", "fingerprint"):
        with contextlib.suppress(InputError):
            getattr(document, name)()
    with contextlib.suppress(BeltramiError):
        document.patch(document.painted().colours * np.float32(0.5), Naming("out", keeps=True))
        document.patch(None, Naming("out", keeps=True), form="gltf")
    for slot in document.slots():
        with contextlib.suppress(BeltramiError):
            images = {(slot, t.key): ImageFile(b"new", ".png") for t in document.textured(slot).textures}
            document.patch(None, Naming("out"), images=images)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("models")


@pytest.mark.slow
@given(data=st.data())
@settings(max_examples=150, deadline=None)
def test_a_member_of_another_kind_is_refused_or_does_no_harm(folder, data):
    tree = copy.deepcopy(data.draw(st.sampled_from(trees(folder))))
    *parents, last = data.draw(st.sampled_from(list(places(tree))))
    holder = tree
    for key in parents:
        holder = holder[key]
    holder[last] = data.draw(st.sampled_from(WRONG))
    with only_input_errors():
        use_all(GltfDocument(json.dumps(tree).encode(), "x.gltf", folder))


@pytest.mark.parametrize(
    ("tree", "place"),
    [
        ({"meshes": [{"primitives": [{"attributes": []}]}]}, r"meshes\[0\].primitives\[0\].attributes"),
        ({"meshes": [{"primitives": [{"attributes": {"A": True}}]}]}, r"attributes\.A"),
        ({"textures": [{"extensions": []}]}, r"textures\[0\].extensions"),
        ({"textures": [{"extensions": {"EXT_texture_webp": 1}}]}, "EXT_texture_webp"),
        ({"extensionsUsed": [["KHR_x"]]}, r"extensionsUsed\[0\]"),
        ({"images": {}}, "images"),
    ],
)
def test_the_message_names_the_place(tree, place):
    with pytest.raises(InputError, match=f"{place}: is .* instead of"):
        GltfDocument(json.dumps({"asset": {"version": "2.0"}, **tree}).encode(), "x.gltf", None)
