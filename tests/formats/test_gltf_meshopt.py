"""Views compressed by meshoptimizer: decoded as their extension defines, and compressed again without loss."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_comparison import json_differences
from formats.gltf_compressed import (
    CORNERS,
    DRACO,
    GRID,
    SIDE,
    UV,
    decompressed,
    draco_model,
    meshopt_model,
    packed_attribute,
    packed_view,
)
from formats.gltf_files import joined, numbers, picture, unpacked

EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
COLOURS = np.random.default_rng(7).integers(0, 256, (len(GRID), 4)).astype("u1")


def document(model, folder=None):
    return GltfDocument(model.glb(), "model.glb", folder)


def stored_after(opened, colours):
    """Return the numbers of all accessors of a GLB with new colours."""
    return decompressed(*unpacked(joined(opened.patch(colours, Naming("out")))))


@pytest.mark.parametrize(
    ("extension", "mode", "indices", "kind"),
    [("EXT", "TRIANGLES", "<u2", "<u1"), ("KHR", "INDICES", "<u4", "<u1"), ("EXT", "INDICES", "<u2", "<u2"),
     ("KHR", "TRIANGLES", "<u4", "<u2"), ("KHR", "TRIANGLES", "<u2", "<f4"), ("EXT", "INDICES", "<u4", "<f4")],
)  # fmt: skip
def test_compressed_models_are_what_they_were(extension, mode, indices, kind):
    colours = COLOURS.astype(kind) / (255 if kind == "<f4" else 1)
    extension = f"{extension}_meshopt_compression"
    model = meshopt_model(colours.astype(kind), indices=indices, mode=mode, extension=extension)
    material = model.material(baseColor=model.texture(model.image(picture(1))))
    model.tree["meshes"][0]["primitives"][0]["material"] = material
    painted, surface = document(model).painted(), document(model).textured("baseColor")
    turned = {tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in painted.faces}
    assert turned == {tuple(np.roll(face, -int(np.argmin(face))).tolist()) for face in CORNERS}
    full = 1 if kind == "<f4" else np.iinfo(kind).max
    np.testing.assert_array_equal(painted.positions, GRID)
    np.testing.assert_array_equal(painted.colours, (colours[:, :3] / full).astype(np.float32))
    rows = surface.positions[surface.faces][..., :2] @ [1, SIDE]
    np.testing.assert_allclose(surface.uv, UV[rows.astype(int)], atol=1 / 65535)


def octahedral(x, y, one, rest, top):
    """Return a normal as the extension's text spells it out."""
    x, y = x / one, y / one
    z = 1 - abs(x) - abs(y)
    shift = max(-z, 0)
    x += shift if x < 0 else -shift
    y += shift if y < 0 else -shift
    length = np.sqrt(x * x + y * y + z * z)
    return [round(value / length * top) for value in (x, y, z)] + [rest]


@pytest.mark.parametrize("kind", ["i1", "i2"])
def test_octahedral_normals_are_decoded(kind):
    top, rng = np.iinfo(kind).max, np.random.default_rng(0)
    packed = rng.integers(-top, top + 1, (len(GRID), 4))
    packed[:, 2] = top
    expected = np.array([octahedral(*row, top) for row in packed.tolist()])
    model = meshopt_model(COLOURS)
    normals = packed_attribute(
        model, expected.astype(f"<{kind}")[:, :3], filtered=packed.astype(f"<{kind}"), filter_name="OCTAHEDRAL",
        normalized=True,
    )  # fmt: skip
    model.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = normals
    found, exact = document(model).attribute("normal"), expected[:, :3].astype(float)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    np.testing.assert_allclose(
        found, exact, atol=2 / top
    )  # one level, for the decoder's own single precision


def test_exponents_of_positions_are_decoded():
    mantissas, exponents = np.rint(GRID * 8).astype("<i4"), -3
    packed = (mantissas & 0xFFFFFF) | (exponents << 24)
    model = meshopt_model(COLOURS)
    position = packed_attribute(
        model, GRID, filtered=packed.astype("<i4"), filter_name="EXPONENTIAL", bounds=True
    )
    model.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = position
    np.testing.assert_array_equal(document(model).painted().positions, GRID)


@pytest.mark.parametrize("kind", ["u1", "u2"])
def test_luma_and_chroma_are_decoded_and_stored_as_colours_again(kind):
    """By hand: with all bits in use, red = y + co - cg, green = y + cg, blue = y - co - cg."""
    top = np.iinfo(kind).max
    half = top // 2
    packed = np.array([[half, 30, 10, top], [half, -40, -20, top], [half, 0, 0, half + 1]] * 12)
    expected = np.array(
        [
            [half + 20, half + 10, half - 40, top],
            [half - 20, half - 20, half + 60, top],
            [half, half, half, 0],
        ]
        * 12
    )
    model = meshopt_model(COLOURS)
    colour = packed_attribute(
        model,
        expected.astype(f"<{kind}"),
        filtered=packed.astype(f"<{kind}"),
        filter_name="COLOR",
        normalized=True,
    )
    model.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = colour
    opened = document(model)
    contents = opened.contents()
    found = np.column_stack([contents.colours, contents.alpha]).astype(float)
    np.testing.assert_array_equal(np.rint(found * top), expected)
    expected[:, :3] = top - expected[:, :3]
    np.testing.assert_array_equal(stored_after(opened, 1 - contents.colours)[colour], expected)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    extension=st.sampled_from(EXTENSIONS),
    seed=st.integers(0, 99),
    fallback=st.booleans(),
    steps=st.lists(st.sampled_from(("noise", "flat", "turned")), min_size=1, max_size=3),
)
def test_only_the_compressed_colours_change(tmp_path_factory, extension, seed, fallback, steps):
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("packed")
    model = meshopt_model(COLOURS, extension=extension)
    if fallback:
        model.tree["buffers"][1]["uri"] = "plain.bin"
        (folder / "plain.bin").write_bytes(bytes(model.fallback))
    data = model.glb()
    for step in steps:
        opened = GltfDocument(data, "model.glb", folder)
        colours = opened.painted().colours
        made = {
            "noise": rng.random(colours.shape),
            "flat": np.full(colours.shape, 0.5),
            "turned": 1 - colours,
        }
        written = opened.patch(made[step].astype(np.float32), Naming("out", keeps=True))
        for name, octets in written.sidecars.items():
            (folder / name).write_bytes(bytes(octets))
        data = joined(written)
        files = {"plain.bin": (folder / "plain.bin").read_bytes()} if fallback else {}
        (old, old_buffers), (new, new_buffers) = (unpacked(octets, files) for octets in (model.glb(), data))
        before, after = decompressed(old, old_buffers), decompressed(new, new_buffers)
        expected = np.rint(made[step].astype(np.float32).astype(float) * 255)
        np.testing.assert_array_equal(after[1][:, :3], expected)
        np.testing.assert_array_equal(after[1][:, 3], COLOURS[:, 3])
        for index in (0, 2, 3):
            np.testing.assert_array_equal(after[index], before[index])
        if fallback:  # viewers that do not know the extension read the same numbers
            for index in range(3):  # not the triangles, which the codec turns round
                np.testing.assert_array_equal(numbers(new, new_buffers, index), after[index])
    free = ("buffers[0].byteLength", "bufferViews[1].extensions", "accessors[1].m")
    assert [place for place in json_differences(old, new) if not place.startswith(free)] == []
    place = old["bufferViews"][1]["extensions"][extension]  # all other bytes of the first buffer stay
    start, end, size = (
        place["byteOffset"],
        place["byteOffset"] + place["byteLength"],
        old["buffers"][0]["byteLength"],
    )
    assert (
        new_buffers[0][:start] + new_buffers[0][end:size] == old_buffers[0][:start] + old_buffers[0][end:size]
    )


def test_colours_interleaved_with_other_attributes_leave_these_alone():
    model = meshopt_model(COLOURS)
    octets = np.concatenate([GRID.view(np.uint8).reshape(len(GRID), 12), COLOURS], axis=1)
    view = packed_view(model, octets.tobytes(), 16, "ATTRIBUTES")
    attributes = model.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["POSITION"] = model.accessor(GRID, view, bounds=True)
    attributes["COLOR_0"] = model.accessor(COLOURS, view, offset=12, normalized=True)
    opened = document(model)
    after = stored_after(opened, 1 - opened.painted().colours)
    np.testing.assert_array_equal(after[attributes["COLOR_0"]][:, :3], 255 - COLOURS[:, :3])
    np.testing.assert_array_equal(after[attributes["POSITION"]], GRID)


def test_data_that_two_views_share_is_not_written_over():
    model = meshopt_model(COLOURS)
    views, accessors = model.tree["bufferViews"], model.tree["accessors"]
    views.append(json.loads(json.dumps(views[1])))
    accessors.append({**accessors[1], "bufferView": len(views) - 1})
    model.tree["meshes"][0]["primitives"][0]["attributes"]["_KEPT"] = len(accessors) - 1
    opened = document(model)
    flat = np.full_like(opened.painted().colours, 0.5)  # which takes less room than noise
    after = stored_after(opened, flat)
    np.testing.assert_array_equal(after[-1], COLOURS)
    assert set(after[1][:, 0].tolist()) == {128}


@pytest.mark.parametrize("changed", [False, True])
def test_compressed_views_survive_the_way_to_text_and_back(tmp_path, changed):
    model = meshopt_model(COLOURS)
    opened = document(model)
    colours = 1 - opened.painted().colours if changed else None
    text = opened.patch(colours, Naming("out", keeps=True), form="gltf")
    for name, octets in text.sidecars.items():
        (tmp_path / name).write_bytes(bytes(octets))
    between = GltfDocument(joined(text), "out.gltf", tmp_path)
    tree, buffers = unpacked(joined(between.patch(None, Naming("out", keeps=True), form="glb")))
    expected = decompressed(*unpacked(model.glb()))
    if changed:
        expected[1][:, :3] = 255 - expected[1][:, :3]
    for now, then in zip(decompressed(tree, buffers), expected, strict=True):
        np.testing.assert_array_equal(now, then)
    assert tree["bufferViews"][0]["extensions"]


def test_a_substitute_that_becomes_part_of_the_file_is_no_substitute_any_more(tmp_path):
    model = meshopt_model(COLOURS)
    model.tree["buffers"].reverse()
    for view in model.tree["bufferViews"]:
        view["buffer"] = 0
        view["extensions"]["EXT_meshopt_compression"]["buffer"] = 1
    model.tree["buffers"][0]["uri"] = "plain.bin"
    model.tree["buffers"][1] = {"uri": "packed.bin", "byteLength": len(model.binary)}
    (tmp_path / "plain.bin").write_bytes(bytes(model.fallback))
    (tmp_path / "packed.bin").write_bytes(bytes(model.binary))
    opened = GltfDocument(json.dumps(model.tree).encode(), "model.gltf", tmp_path)
    merged = joined(opened.patch(None, Naming("out", keeps=True), form="glb"))
    (buffer,) = unpacked(merged)[0]["buffers"]
    assert "extensions" not in buffer
    again = GltfDocument(merged, "out.glb", None)
    np.testing.assert_array_equal(again.painted().colours, opened.painted().colours)


@pytest.mark.parametrize(
    ("make", "module", "extra", "extension"),
    [
        (meshopt_model, "meshoptimizer", "meshopt", "EXT_meshopt_compression"),
        (draco_model, "DracoPy", "draco", DRACO),
    ],
)
def test_without_a_package_its_extra_is_named(make, module, extra, extension, monkeypatch):
    opened = document(make(COLOURS))
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError) as caught:
        opened.painted()
    assert extension in str(caught.value)
    assert f"pip install 'beltrami-cli[{extra}]'" in str(caught.value)
    assert opened.facts()["extensions required"] == [extension]


@pytest.mark.parametrize("mode", ["TRIANGLES", "INDICES"])
def test_colours_compressed_as_indices_are_refused_rather_than_damaged(mode):
    model = meshopt_model(COLOURS)
    view = packed_view(model, np.arange(len(GRID), dtype="<u4").tobytes(), 4, mode)
    model.tree["accessors"][1]["bufferView"] = view
    opened = document(model)
    colours = opened.painted().colours
    with pytest.raises(InputError, match=f"mode: is {mode}, which is not for vertex data"):
        opened.patch(1 - colours, Naming("out"))
