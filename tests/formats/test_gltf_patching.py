"""Properties of patching glTF files: colours change, and nothing else does."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_comparison import byte_differences, json_differences
from formats.gltf_files import Model, data_uri, joined, numbers, unpacked

ARRANGEMENTS = [
    "dense",
    "interleaved",
    "sparse",
    "sparse on zeros",
    "zeros",
    "shared",
    "overlapping",
    "twice",
]
FORMS = ("glb", "gltf", "data")


@dataclass
class Case:
    model: Model
    colour: int
    stored: np.ndarray


def random_colours(rng, kind, count, width):
    if kind == "f4":
        return rng.random((count, width)).astype("<f4")
    return rng.integers(0, np.iinfo(kind).max + 1, (count, width)).astype(f"<{kind}")


@st.composite
def cases(draw, arrangement):
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    kind, width = draw(st.sampled_from(("u1", "u2", "f4"))), draw(st.sampled_from((3, 4)))
    bounds, count = draw(st.booleans()), draw(st.integers(3, 9))
    more = {"bounds": bounds} | ({"normalized": True} if kind != "f4" else {})
    model = Model()
    positions = rng.normal(size=(count, 3)).astype("<f4")
    stored = random_colours(rng, kind, count, width)
    model.view(b"\x89PNG image, opaque")
    if arrangement == "interleaved":
        normals = np.tile(np.array([0, 0, 1], "<f4"), (count, 1))
        position, normal, colour = model.interleaved(positions, normals, stored, **more)
        attributes = {"POSITION": position, "NORMAL": normal}
    else:
        attributes = {"POSITION": model.packed(positions)}
        if arrangement.startswith("sparse"):
            base = None if "zeros" in arrangement else random_colours(rng, kind, count, width)
            rows = np.flatnonzero(rng.random(count) < 0.5) if count > 3 else np.array([1])
            rows = rows if len(rows) else np.array([0])
            full = np.zeros_like(stored) if base is None else base.copy()
            full[rows] = stored[rows]
            stored = full
            colour = model.sparse(stored, rows, base, **more)
        elif arrangement == "zeros":
            stored = np.zeros_like(stored)
            colour = model.accessor(stored, None, **more)
        else:
            colour = model.packed(stored, **more)
    attributes["COLOR_0"] = colour
    if arrangement == "shared":
        attributes["_KEPT"] = colour
    if arrangement == "overlapping":
        part = model.tree["accessors"][colour] | {"count": count - 1}
        model.tree["accessors"].append({key: part[key] for key in part if key not in ("min", "max")})
        attributes["_KEPT"] = len(model.tree["accessors"]) - 1
    primitive = {"attributes": attributes, "mode": draw(st.sampled_from((0, 1, 4, 5, 6)))}
    if draw(st.booleans()):
        corners = rng.integers(0, count, 3 * count).astype(draw(st.sampled_from(("<u1", "<u2", "<u4"))))
        primitive["indices"] = model.indices(corners)
    model.mesh(primitive, *([again(model, primitive, colour)] if arrangement == "twice" else []))
    return Case(model, colour, stored)


def again(model, primitive, colour):
    """Return a primitive with an accessor of its own for the same colours."""
    model.tree["accessors"].append(dict(model.tree["accessors"][colour]))
    other = json.loads(json.dumps(primitive))
    other["attributes"]["COLOR_0"] = len(model.tree["accessors"]) - 1
    return other


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
@given(data=st.data(), form=st.sampled_from(FORMS), moved=st.booleans(), seed=st.integers(0, 2**32))
def test_only_changed_colours_change_and_each_is_rounded_once(folder, arrangement, data, form, moved, seed):
    case = data.draw(cases(arrangement))
    document, data = opened(case.model, form, folder)
    painted = document.painted()
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


@pytest.mark.parametrize("arrangement", ARRANGEMENTS)
@settings(max_examples=10, deadline=None)
@given(data=st.data(), form=st.sampled_from(FORMS), indent=st.sampled_from((None, 2, "\t")))
def test_unchanged_colours_give_back_the_same_bytes(folder, arrangement, data, form, indent):
    case = data.draw(cases(arrangement))
    document, data = opened(case.model, form, folder, indent=indent)
    written = document.patch(document.painted().colours.copy(), Naming("out"))
    assert joined(written) == data
    assert not written.sidecars


def test_colours_of_their_own_bytes_leave_the_json_verbatim(folder):
    model = Model()
    rng = np.random.default_rng(1)
    positions = rng.normal(size=(6, 3)).astype("<f4")
    colours = rng.integers(0, 256, (6, 4)).astype("<u1")
    position, colour = model.interleaved(positions, colours, normalized=True)
    model.mesh({"attributes": {"POSITION": position, "COLOR_0": colour}})
    document, data = opened(model, "glb", folder, indent=3)
    after = joined(document.patch(1 - document.painted().colours, Naming("out")))
    length = int.from_bytes(data[12:16], "little")
    assert after[: 20 + length] == data[: 20 + length]
    assert len(after) == len(data)


def test_new_colours_must_be_finite_and_fit(folder):
    model = Model()
    position = model.packed(np.eye(3, dtype="<f4"))
    model.mesh({"attributes": {"POSITION": position, "COLOR_0": model.packed(np.eye(3, dtype="<f4"))}})
    document, _ = opened(model, "glb", folder)
    with pytest.raises(ValueError, match="finite"):
        document.patch(np.full((3, 3), np.nan, np.float32), Naming("out"))
    with pytest.raises(ValueError, match="shape"):
        document.patch(np.zeros((4, 3), np.float32), Naming("out"))


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
