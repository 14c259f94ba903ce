"""New colours of glTF files: only the asked ones change, and each is rounded once."""

import contextlib
import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.records import MovedVertices
from formats.gltf_comparison import (
    byte_differences,
    json_differences,
    save,
)
from formats.gltf_files import (
    ARRANGEMENTS,
    Model,
    coloured,
    joined,
    numbers,
    opened,
)

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
    source = case.model.written_to(folder, form, (b"XTRA", b"kept"), indent=indent)
    document, data, before = open_document(str(source)), source.read_bytes(), opened(source)
    vertices = document.coloured_vertices()
    for unchanged in (
        document.patch(vertices.colours.copy(), Naming("out")),
        document.patch(None, Naming("out")),
    ):
        assert (joined(unchanged), unchanged.sidecars) == (data, {})
    scale = 1 if case.stored.dtype.kind == "f" else np.iinfo(case.stored.dtype).max
    np.testing.assert_array_equal(
        vertices.colours, (case.stored[:, :3] / np.float64(scale)).astype(np.float32)
    )
    rng = np.random.default_rng(seed)
    changed = rng.random(vertices.colours.shape) < 0.4
    colours = np.where(changed, rng.random(vertices.colours.shape), vertices.colours).astype(np.float32)

    written = document.patch(colours, Naming("out", in_place=moved))

    expected = case.stored.copy()
    exact = colours.astype(np.float64) * scale
    expected[:, :3][changed] = (exact if scale == 1 else np.rint(exact))[changed]
    check_colours(before, opened(save(written, f"out{source.suffix}", folder)), expected)
    if form == "gltf" and written.sidecars:
        assert set(written.sidecars) == ({"model.bin"} if moved else {"out.bin"})
    if form == "glb" and written.main != [data]:
        assert joined(written).endswith(b"XTRAkept")


def check_colours(before, after, expected):
    """Nothing but colours and their accessors differs, and new accessors have views of their own."""
    (old, *_), (new, new_buffers, _) = before, after
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
    model = coloured("dense", np.random.default_rng(0)).model
    (tmp_path / "out.bin").write_bytes(bytes(model.binary))
    document = GltfDocument(model.text("out.bin"), "out.gltf", tmp_path)
    written = document.patch(1 - document.coloured_vertices().colours, Naming("out"))
    assert list(written.sidecars) == ["out-2.bin"]
    assert json.loads(joined(written))["buffers"][0]["uri"] == "out-2.bin"


def test_planned_names_are_those_of_all_files_that_change(tmp_path):
    triangle = np.eye(3, dtype="<f4")
    for name in ("places.bin", "colours.bin"):
        (tmp_path / name).write_bytes(triangle.tobytes())
    tree = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": f"{name}.bin", "byteLength": 36} for name in ("places", "colours")],
        "bufferViews": [{"buffer": number, "byteLength": 36} for number in (0, 1)],
        "accessors": [
            {"bufferView": number, "componentType": 5126, "count": 3, "type": "VEC3"} for number in (0, 1)
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}}]}],
    }
    document, naming = GltfDocument(json.dumps(tree).encode(), "in.gltf", tmp_path), Naming("out")
    for places in (None, MovedVertices(2 * triangle.astype(float), None)):
        written = document.patch(1 - triangle, naming, places=places)
        planned = document.sidecar_names({}, naming, colours=True, places=places is not None)
        assert planned == [*written.sidecars]
        assert len(planned) == (1 if places is None else 2)


@pytest.mark.parametrize("is_free", [True, False])
def test_a_new_view_never_takes_the_number_that_something_unknown_names(is_free):
    model = Model()
    places, zeros = model.packed(np.eye(3, dtype="<f4")), model.accessor(np.zeros((3, 3), "<f4"))
    model.mesh({"attributes": {"POSITION": places, "COLOR_0": zeros}})
    model.tree["extras"] = {"bufferView": len(model.tree["bufferViews"]) + is_free}
    with contextlib.nullcontext() if is_free else pytest.raises(InputError, match=r"names bufferViews\[1\]"):
        model.document().patch(np.full((3, 3), 0.5, np.float32), Naming("x"))
