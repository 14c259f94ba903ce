"""Geometry compressed with Draco or meshoptimizer: read as before compression, and recoloured.

Data of Draco stay, and new colours lie beside them; views of meshoptimizer are compressed again without loss.
"""

import json
import sys
from functools import partial

import DracoPy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.surface.records import ImageFile
from formats.gltf_comparison import byte_differences, json_differences
from formats.gltf_compressed import (
    CORNERS,
    DRACO,
    GRID,
    UV,
    decompressed,
    draco_bytes,
    draco_model,
    draco_primitive,
    meshopt_model,
    packed_attribute,
    packed_view,
)
from formats.gltf_files import Textured, joined, numbers, picture, unpacked

EXTENSIONS = ("EXT_meshopt_compression", "KHR_meshopt_compression")
COLOURS = np.random.default_rng(7).integers(0, 256, (len(GRID), 4)).astype("u1")


def by_point(positions, values):
    """Return values by the points of the grid, whatever the order of the vertices."""
    points = map(tuple, np.rint(positions).astype(int).tolist())
    return dict(zip(points, map(tuple, np.asarray(values).tolist()), strict=True))


def triangles(positions, faces):
    """Return triangles as three points of the grid, the least one first."""
    corners = np.rint(positions[faces]).astype(int).tolist()
    turned = ([*map(tuple, face)] for face in corners)
    return {tuple(face[(at := face.index(min(face))) :] + face[:at]) for face in turned}


def of_meshopt(kind, indices, mode, extension):
    colours = (COLOURS / (255 if kind == "f4" else 1)).astype(f"<{kind}")
    return partial(meshopt_model, colours, indices=indices, mode=mode, extension=extension)


COMPRESSED = [
    (partial(draco_model, COLOURS[:, :3].copy(), in_order=True), 255),
    (partial(draco_model, COLOURS, in_order=True, mode=5), 255),
    (partial(draco_model, COLOURS[:, :3].copy(), mode=5), 255), (partial(draco_model, COLOURS), 255),
    (of_meshopt("u1", "<u2", "TRIANGLES", EXTENSIONS[0]), 255),
    (of_meshopt("u1", "<u4", "INDICES", EXTENSIONS[1]), 255),
    (of_meshopt("u2", "<u2", "INDICES", EXTENSIONS[0]), 65535),
    (of_meshopt("u2", "<u4", "TRIANGLES", EXTENSIONS[1]), 65535),
    (of_meshopt("f4", "<u2", "TRIANGLES", EXTENSIONS[1]), 255),
    (of_meshopt("f4", "<u4", "INDICES", EXTENSIONS[0]), 255),
]  # fmt: skip


@pytest.mark.parametrize(("make", "full"), COMPRESSED)
def test_colours_triangles_and_coordinates_are_those_that_were_compressed(make, full):
    model = make()
    model.tree["meshes"][0]["primitives"][0]["material"] = model.material(
        baseColor=model.texture(model.image(picture(1)))
    )
    vertices, surface = model.document().coloured_vertices(), model.document().textured("baseColor")
    assert triangles(vertices.positions, vertices.faces) == triangles(GRID, CORNERS)
    stored = np.rint(vertices.colours * np.float64(full)).astype(int)
    assert by_point(vertices.positions, stored) == by_point(GRID, COLOURS[:, :3])
    where = by_point(GRID, UV)
    corners = np.rint(surface.positions[surface.faces]).astype(int).tolist()
    expected = np.array([[where[tuple(corner)] for corner in face] for face in corners])
    np.testing.assert_allclose(surface.uv, expected, atol=2**-15)


@pytest.mark.parametrize("in_order", [True, False])
def test_new_colours_lie_beside_the_compressed_data_which_stays(in_order):
    model = draco_model(COLOURS, in_order=in_order)
    opened = model.document()
    vertices = opened.coloured_vertices()
    after = joined(opened.patch(1 - vertices.colours, Naming("out")))
    (old, old_buffers), (new, new_buffers) = unpacked(model.glb()), unpacked(after)
    primitive = new["meshes"][0]["primitives"][0]
    found = numbers(new, new_buffers, primitive["attributes"]["COLOR_0"])
    assert by_point(vertices.positions, found) == by_point(
        GRID, np.concatenate([255 - COLOURS[:, :3], COLOURS[:, 3:]], axis=1)
    )
    assert new_buffers[0].startswith(old_buffers[0][: old["buffers"][0]["byteLength"]])
    colour = primitive["attributes"]["COLOR_0"]
    changed = {
        "buffers[0].byteLength", "bufferViews[1]", f"accessors[{colour}].bufferView",
        f"meshes[0].primitives[0].extensions.{DRACO}.attributes.COLOR_0",
    }  # fmt: skip
    bounds = {place for place in json_differences(old, new) if ".min[" in place or ".max[" in place}
    assert set(json_differences(old, new)) == changed | bounds
    accessor = new["accessors"][colour]
    assert (accessor["min"], accessor["max"]) == (found.min(axis=0).tolist(), found.max(axis=0).tolist())
    again = GltfDocument(after, "out.glb", None)
    assert triangles(again.coloured_vertices().positions, again.coloured_vertices().faces) == triangles(
        GRID, CORNERS
    )
    np.testing.assert_allclose(again.coloured_vertices().colours, 1 - vertices.colours, atol=1e-6)
    second = joined(again.patch(vertices.colours, Naming("out")))  # in place
    assert len(second) == len(after)
    np.testing.assert_array_equal(
        GltfDocument(second, "out.glb", None).coloured_vertices().colours, vertices.colours
    )


@settings(max_examples=20, deadline=None)
@given(same=st.booleans(), stranger=st.booleans(), seed=st.integers(0, 99))
def test_accessors_that_describe_several_meshes_are_kept_apart(same, stranger, seed):
    """Exporters merge equal descriptions, though each compressed mesh has colours of its own."""
    rng, model = np.random.default_rng(seed), Textured()
    first = draco_primitive(model, COLOURS)
    other = rng.integers(0, 256, COLOURS.shape).astype("u1")
    second = draco_primitive(model, other, view=0 if same else None)
    for name in ("min", "max"):
        model.tree["accessors"][first["attributes"]["COLOR_0"]].pop(name)
    second["attributes"] = first["attributes"]
    if stranger:
        first["attributes"]["_KEPT"] = first["attributes"]["COLOR_0"]
        first["extensions"][DRACO]["attributes"]["_KEPT"] = first["extensions"][DRACO]["attributes"][
            "COLOR_0"
        ]
    model.mesh(first)
    model.mesh(second, translation=[9, 0, 0])
    opened = model.document()
    vertices = opened.coloured_vertices()
    assert len(vertices.positions) == len(GRID) * (1 if same else 2)
    data = joined(opened.patch(1 - vertices.colours, Naming("out")))
    after, tree = GltfDocument(data, "out.glb", None), unpacked(data)[0]
    np.testing.assert_allclose(after.coloured_vertices().colours, 1 - vertices.colours, atol=1e-6)
    if stranger:
        kept = tree["meshes"][0]["primitives"][0]["attributes"]["_KEPT"]
        assert "bufferView" not in tree["accessors"][kept]


def test_textures_on_compressed_meshes_are_replaced():
    model = Textured()
    material = model.material(baseColor=model.texture(model.image(picture(1))))
    model.mesh(draco_primitive(model, COLOURS, material=material))
    new = ImageFile(picture(2, size=400), ".png")
    images = {("baseColor", "image 0"): new}
    after = joined(model.document().patch(None, Naming("out"), images=images))
    before, now = unpacked(model.glb()), unpacked(after)
    assert byte_differences(before, now) == {"image"}
    assert set(json_differences(before[0], now[0])) <= {
        "buffers[0].byteLength", "bufferViews[0].byteLength", "bufferViews[0].byteOffset"
    }  # fmt: skip
    assert GltfDocument(after, "out.glb", None).textured("baseColor").textures[0].data == new.data


@pytest.mark.parametrize("is_turned", [False, True])
def test_an_uncompressed_substitute_gets_the_same_colours_if_its_vertices_are_in_the_same_order(is_turned):
    model, rows = Textured(), np.arange(len(GRID))[:: -1 if is_turned else 1]
    primitive = draco_primitive(model, COLOURS, in_order=True)
    mesh = DracoPy.decode(draco_bytes(COLOURS, in_order=True))
    plain = {
        primitive["attributes"]["POSITION"]: mesh.get_attribute_by_type(0)["data"].astype("<f4")[rows],
        primitive["attributes"]["COLOR_0"]: mesh.get_attribute_by_type(2)["data"].astype("<u1")[rows],
        primitive["indices"]: np.argsort(rows)[mesh.faces].astype("<u4"),
    }
    for accessor, array in plain.items():
        model.tree["accessors"][accessor]["bufferView"] = model.view(array.tobytes())
    model.mesh(primitive)
    opened = model.document()
    colours = 1 - opened.coloured_vertices().colours
    if is_turned:
        with pytest.raises(InputError, match="another order than its uncompressed fallback"):
            opened.patch(colours, Naming("out"))
        return
    tree, buffers = unpacked(joined(opened.patch(colours, Naming("out"))))
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    points = numbers(tree, buffers, attributes["POSITION"])
    found = by_point(points, numbers(tree, buffers, attributes["COLOR_0"])[:, :3])
    assert found == by_point(GRID, 255 - COLOURS[:, :3])


@pytest.mark.parametrize("claimed", [None, b"\xff\xff\xff\x7f"])
def test_points_are_refused_however_many_they_claim_to_be(claimed):
    model = draco_model(COLOURS)
    points = bytearray(DracoPy.encode(GRID))
    if claimed is not None:
        points[11 : 11 + len(claimed)] = claimed  # the number of points, for which memory would be taken
    model.tree["meshes"][0]["primitives"][0]["extensions"][DRACO]["bufferView"] = model.view(bytes(points))
    with pytest.raises(InputError, match="holds points, not triangles"):
        model.document().coloured_vertices()


def stored_after(opened, colours):
    """Return the numbers of all accessors of a GLB with new colours."""
    return decompressed(*unpacked(joined(opened.patch(colours, Naming("out")))))


@pytest.mark.parametrize("kind", ["i1", "i2"])
def test_octahedral_normals_are_decoded(kind):
    """Axes lie in the middle of the square, in the middle of its sides, and in its corners."""
    top, model = np.iinfo(kind).max, meshopt_model(COLOURS)
    places = np.array([[0, 0, 1, 0], [1, 0, 1, 0], [-1, 0, 1, 0], [0, 1, 1, 0], [0, -1, 1, 0], [1, -1, 1, 0]])
    axes = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]])
    filtered, normals = (np.tile(top * each, (6, 1)).astype(f"<{kind}") for each in (places, axes))
    index = packed_attribute(model, normals, filtered=filtered, filter_name="OCTAHEDRAL", normalized=True)
    model.tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = index
    # One level: the decoder is of single precision.
    np.testing.assert_allclose(model.document().attribute("normal"), np.tile(axes, (6, 1)), atol=2 / top)


def test_exponents_of_positions_are_decoded():
    mantissas, exponents = np.rint(GRID * 8).astype("<i4"), -3
    packed = (mantissas & 0xFFFFFF) | (exponents << 24)
    model = meshopt_model(COLOURS)
    position = packed_attribute(
        model, GRID, filtered=packed.astype("<i4"), filter_name="EXPONENTIAL", bounds=True
    )
    model.tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = position
    np.testing.assert_array_equal(model.document().coloured_vertices().positions, GRID)


@pytest.mark.parametrize("kind", ["u1", "u2"])
def test_luma_and_chroma_are_decoded_and_stored_as_colours_again(kind):
    """By hand: with all bits in use, red = y + co - cg, green = y + cg, blue = y - co - cg."""
    top = np.iinfo(kind).max
    half = top // 2
    packed = np.array([[half, 30, 10, top], [half, -40, -20, top], [half, 0, 0, half + 1]] * 12)
    changes = [[20, 10, -40, top - half], [-20, -20, 60, top - half], [0, 0, 0, -half]]
    expected = half + np.array(changes * 12)
    model, filtered = meshopt_model(COLOURS), packed.astype(f"<{kind}")
    stored = expected.astype(f"<{kind}")
    colour = packed_attribute(model, stored, filtered=filtered, filter_name="COLOR", normalized=True)
    model.tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = colour
    opened = model.document()
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
        colours = opened.coloured_vertices().colours
        flat = np.full(colours.shape, 0.5)
        made = {"noise": rng.random(colours.shape), "flat": flat, "turned": 1 - colours}
        written = opened.patch(made[step].astype(np.float32), Naming("out", in_place=True))
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
    start, size = place["byteOffset"], old["buffers"][0]["byteLength"]
    others = np.delete(np.arange(size), np.arange(start, start + place["byteLength"]))
    before, after = (np.frombuffer(buffers[0], np.uint8) for buffers in (old_buffers, new_buffers))
    np.testing.assert_array_equal(after[others], before[others])


def test_colours_interleaved_with_other_attributes_leave_these_alone():
    model = meshopt_model(COLOURS)
    octets = np.concatenate([GRID.view(np.uint8).reshape(len(GRID), 12), COLOURS], axis=1)
    view = packed_view(model, octets.tobytes(), 16, "ATTRIBUTES")
    attributes = model.tree["meshes"][0]["primitives"][0]["attributes"]
    attributes["POSITION"] = model.accessor(GRID, view, bounds=True)
    attributes["COLOR_0"] = model.accessor(COLOURS, view, offset=12, normalized=True)
    opened = model.document()
    after = stored_after(opened, 1 - opened.coloured_vertices().colours)
    np.testing.assert_array_equal(after[attributes["COLOR_0"]][:, :3], 255 - COLOURS[:, :3])
    np.testing.assert_array_equal(after[attributes["POSITION"]], GRID)


def test_data_that_two_views_share_is_not_written_over():
    model = meshopt_model(COLOURS)
    views, accessors = model.tree["bufferViews"], model.tree["accessors"]
    views.append(json.loads(json.dumps(views[1])))
    accessors.append({**accessors[1], "bufferView": len(views) - 1})
    model.tree["meshes"][0]["primitives"][0]["attributes"]["_KEPT"] = len(accessors) - 1
    opened = model.document()
    flat = np.full_like(opened.coloured_vertices().colours, 0.5)  # which takes less room than noise
    after = stored_after(opened, flat)
    np.testing.assert_array_equal(after[-1], COLOURS)
    assert set(after[1][:, 0].tolist()) == {128}


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
    merged = joined(opened.patch(None, Naming("out", in_place=True), form="glb"))
    (buffer,) = unpacked(merged)[0]["buffers"]
    assert "extensions" not in buffer
    again = GltfDocument(merged, "out.glb", None)
    np.testing.assert_array_equal(again.coloured_vertices().colours, opened.coloured_vertices().colours)


@pytest.mark.parametrize(
    ("make", "module", "extra", "extension"),
    [
        (meshopt_model, "meshoptimizer", "meshopt", "EXT_meshopt_compression"),
        (draco_model, "DracoPy", "draco", DRACO),
    ],
)
def test_without_a_package_its_extra_is_named(make, module, extra, extension, monkeypatch):
    opened = make(COLOURS).document()
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError) as caught:
        opened.coloured_vertices()
    assert extension in str(caught.value)
    assert f"pip install 'beltrami-cli[{extra}]'" in str(caught.value)
    assert opened.facts()["extensions required"] == [extension]


@pytest.mark.parametrize("mode", ["TRIANGLES", "INDICES"])
def test_colours_compressed_as_indices_are_refused_rather_than_damaged(mode):
    model = meshopt_model(COLOURS)
    view = packed_view(model, np.arange(len(GRID), dtype="<u4").tobytes(), 4, mode)
    model.tree["accessors"][1]["bufferView"] = view
    opened = model.document()
    colours = opened.coloured_vertices().colours
    with pytest.raises(InputError, match=f"mode: is {mode}, which is not for vertex data"):
        opened.patch(1 - colours, Naming("out"))
