"""Patching glTF files changes colours, and nothing else."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_comparison import byte_differences, json_differences
from formats.gltf_files import ARRANGEMENTS, Model, coloured, data_uri, joined, numbers, unpacked

FORMS = ("glb", "gltf", "data")


@st.composite
def cases(draw, arrangement):
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    kind, width = draw(st.sampled_from(("u1", "u2", "f4"))), draw(st.sampled_from((3, 4)))
    case = coloured(arrangement, rng, kind, width, count=draw(st.integers(3, 9)), bounds=draw(st.booleans()))
    for primitive in case.model.tree["meshes"][0]["primitives"]:
        primitive["mode"] = draw(st.sampled_from((0, 1, 4, 5, 6)))
        if draw(st.booleans()):
            corners = rng.integers(0, len(case.stored), 3 * len(case.stored))
            corners = corners.astype(draw(st.sampled_from(("<u1", "<u2", "<u4"))))
            primitive["indices"] = case.model.indices(corners)
    return case


def opened(model, form, folder, **style):
    """Return the document and its bytes."""
    if form == "glb":
        data = model.glb((b"XTRA", b"kept"), **style)
    elif form == "data":
        data = model.data_text(**style)
    else:
        (folder / "a b.bin").write_bytes(bytes(model.binary))
        data = model.text("a%20b.bin", **style)
    return GltfDocument(data, "model", folder), data


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("gltf")


@pytest.mark.slow
@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@settings(max_examples=30, deadline=None)
@given(
    data=st.data(),
    form=st.sampled_from(FORMS),
    indent=st.sampled_from((None, 2, "\t")),
    moved=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_only_changed_colours_change_and_each_is_rounded_once(
    folder, arrangement, data, form, indent, moved, seed
):
    case = data.draw(cases(arrangement))
    document, data = opened(case.model, form, folder, indent=indent)
    painted = document.painted()
    for unchanged in (
        document.patch(painted.colours.copy(), Naming("out")),
        document.patch(None, Naming("out")),
    ):
        assert (joined(unchanged), unchanged.sidecars) == (data, {})
    scale = 1 if case.stored.dtype.kind == "f" else np.iinfo(case.stored.dtype).max
    np.testing.assert_array_equal(
        painted.colours, (case.stored[:, :3] / np.float64(scale)).astype(np.float32)
    )
    rng = np.random.default_rng(seed)
    changed = rng.random(painted.colours.shape) < 0.4
    colours = np.where(changed, rng.random(painted.colours.shape), painted.colours).astype(np.float32)

    written = document.patch(colours, Naming("out", keeps=moved))

    files = {"a%20b.bin": bytes(case.model.binary)} | dict(written.sidecars)
    files |= {name.replace(" ", "%20"): octets for name, octets in written.sidecars.items()}
    before = unpacked(data, files={"a%20b.bin": bytes(case.model.binary)})
    expected = case.stored.copy()
    exact = colours.astype(np.float64) * scale
    expected[:, :3][changed] = (exact if scale == 1 else np.rint(exact))[changed]
    check_rest(before, unpacked(joined(written), files), expected)
    if form == "gltf" and written.sidecars:
        assert set(written.sidecars) == ({"a b.bin"} if moved else {"out.bin"})
    if form == "glb" and written.main != [data]:
        assert joined(written).endswith(b"XTRAkept")


def check_rest(before, after, expected):
    """Nothing but colours and their accessors differs, and new accessors have views of their own."""
    (old, _), (new, new_buffers) = before, after
    assert byte_differences(before, after) <= {"COLOR_0"}
    free = r"buffers\[0\]\.(byteLength|uri)|meshes\[0\]\.primitives\[.\]\.attributes\.COLOR_0"
    pairs = zip(old["meshes"][0]["primitives"], new["meshes"][0]["primitives"], strict=True)
    for index, now in ((part["attributes"]["COLOR_0"] for part in pair) for pair in pairs):
        np.testing.assert_array_equal(numbers(new, new_buffers, now), expected)
        accessor = new["accessors"][now]
        bounds = {"min": expected.min(axis=0).tolist(), "max": expected.max(axis=0).tolist()}
        kept = [key for key in bounds if key in old["accessors"][index]]
        assert {key: accessor[key] for key in bounds if key in accessor} == {key: bounds[key] for key in kept}
        free += rf"|accessors\[{index}\]\.(bufferView|byteOffset|(min|max)\[.\])"
    for key in ("bufferViews", "accessors"):
        free += "".join(rf"|{key}\[{index}\]" for index in range(len(old[key]), len(new[key])))
    assert [place for place in json_differences(old, new) if not re.fullmatch(free, place)] == []
    for view in new["bufferViews"][len(old["bufferViews"]) :]:
        assert view["byteOffset"] % 4 == view.get("byteStride", 0) % 4 == 0
        assert "byteStride" in view or view["byteLength"] == expected.nbytes
        assert "byteStride" in view or expected[0].nbytes % 4 == 0


def test_sidecars_never_take_a_name_that_the_source_uses(tmp_path):
    model = Model()
    position = model.packed(np.eye(3, dtype="<f4"))
    model.mesh({"attributes": {"POSITION": position, "COLOR_0": model.packed(np.eye(3, dtype="<f4"))}})
    (tmp_path / "out.bin").write_bytes(bytes(model.binary))
    document = GltfDocument(model.text("out.bin"), "out.gltf", tmp_path)
    written = document.patch(1 - document.painted().colours, Naming("out"))
    assert list(written.sidecars) == ["out-2.bin"]
    assert json.loads(joined(written))["buffers"][0]["uri"] == "out-2.bin"


def test_no_view_is_added_where_something_names_one_that_is_not_there():
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": data_uri(np.eye(3, dtype=np.float32).tobytes(), "x/y")}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"componentType": 5126, "count": 3, "type": "VEC3"},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}}]}],
        "extras": {"bufferView": 2},
    }
    new = np.full((3, 3), 0.5, np.float32)
    GltfDocument(json.dumps(tree).encode(), "x.gltf", None).patch(new, Naming("x", keeps=True))
    tree["extras"]["bufferView"] = 1
    with pytest.raises(InputError, match=r"names bufferViews\[1\]"):
        GltfDocument(json.dumps(tree).encode(), "x.gltf", None).patch(new, Naming("x", keeps=True))
