"""The container of glTF files: chunks, text, sidecar buffers, and damage of every kind."""

from __future__ import annotations

import json
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_files import Model, joined


def small(sparse=False):
    model = Model()
    colours = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]], "<u1")
    colour = (
        model.sparse(colours, [1], None, normalized=True)
        if sparse
        else model.packed(colours, normalized=True)
    )
    attributes = {"POSITION": model.packed(np.eye(3, dtype="<f4")), "COLOR_0": colour}
    primitive = {"attributes": attributes, "indices": model.indices(np.array([0, 1, 2], "<u2"))}
    model.mesh(primitive, translation=[1, 2, 3])
    return model


def everything(data):
    """Ask a document for everything that it has, and patch it."""
    document = GltfDocument(data, "model", None)
    document.facts()
    document.references()
    document.contents()
    colours = (1 - document.painted().colours).clip(-1e30, 1e30)
    document.patch(colours, Naming("out"))
    for form in ("glb", "gltf"):
        document.patch(colours, Naming("out", keeps=True), form=form)


GLB = small(sparse=True).glb()
TEXT = small().data_text(indent=1)


@settings(max_examples=150, deadline=None)
@given(cut=st.integers(0, len(GLB) - 1), text=st.booleans())
def test_truncated_files_raise_input_errors(cut, text):
    data = (TEXT if text else GLB)[:cut]
    if text or cut:
        with pytest.raises(InputError):
            everything(data)


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


def test_a_byte_order_mark_is_reported_and_kept():
    data = b"\xef\xbb\xbf" + TEXT
    document = GltfDocument(data, "model.gltf", None)
    assert [notice for notice in document.notices if "byte order mark" in notice]
    assert joined(document.patch(1 - document.painted().colours, Naming("out"))).startswith(data[:20])


def test_form_is_recognised_by_content():
    assert GltfDocument(GLB, "model.gltf", None).format == "glb"
    assert GltfDocument(TEXT, "model.glb", None).format == "gltf"


OUTSIDE = ["/etc/hosts", "../up.bin", "a/../../up.bin", "%2e%2e/up.bin", "..%5cup.bin", "file:///up.bin",
           "http://x/up.bin", "C:\\up.bin", "link.bin", "", ".", "fifo", "missing.bin", "sub"]  # fmt: skip


@pytest.mark.parametrize("uri", OUTSIDE)
def test_buffers_outside_the_folder_are_never_read(tmp_path, uri):
    model = small()
    folder = tmp_path / "in"
    (folder / "sub").mkdir(parents=True)
    (tmp_path / "up.bin").write_bytes(bytes(model.binary))
    (folder / "link.bin").symlink_to(tmp_path / "up.bin")
    os.mkfifo(folder / "fifo")
    document = GltfDocument(model.text(uri), "model.gltf", folder)
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
    assert len(document.painted().colours) == 3
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
    tree["bufferViews"][0]["buffer"] = 1  # the colours, seen through the second buffer
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
