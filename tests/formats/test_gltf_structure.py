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
from beltrami_cli.formats.gltf import GltfDocument
from beltrami_cli.surface.records import ImageFile
from formats.gltf_compressed import draco_model, meshopt_model
from formats.gltf_showcase import showcase

WRONG = (None, 5, -1, "x", [], {}, True, 1.5, [[]], [{}], ["x"], {"a": []}, {"extensions": []}, 10**30)


@cache
def trees(folder):
    """JSON of models with nearly everything, and of compressed ones."""
    colours = np.arange(36 * 4, dtype=np.uint8).reshape(36, 4)
    models = [showcase("data"), draco_model(colours), meshopt_model(colours)]
    models = [model[0] if isinstance(model, tuple) else model for model in models]
    return [json.loads(model.written_to(folder, "data").read_bytes()) for model in models]


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
        document.patch(document.painted().colours * np.float32(0.5), "out", moved=True)
        document.repackaged(None, "out", "gltf", moved=True)
    for slot in document.slots():
        with contextlib.suppress(BeltramiError):
            images = {(slot, t.key): ImageFile(b"new", ".png") for t in document.textured(slot).textures}
            document.patch(None, "out", moved=False, images=images)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("models")


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_a_member_of_another_kind_is_refused_or_does_no_harm(folder, data):
    tree = copy.deepcopy(data.draw(st.sampled_from(trees(folder))))
    *parents, last = data.draw(st.sampled_from(list(places(tree))))
    holder = tree
    for key in parents:
        holder = holder[key]
    holder[last] = data.draw(st.sampled_from(WRONG))
    with contextlib.suppress(InputError):
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
