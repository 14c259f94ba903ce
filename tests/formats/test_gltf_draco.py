"""Geometry compressed with Draco: read as before compression, painted, and never compressed a second time."""

from __future__ import annotations

import DracoPy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.surface.records import ImageFile
from formats.gltf_comparison import byte_differences, json_differences
from formats.gltf_compressed import CORNERS, DRACO, GRID, UV, draco_bytes, draco_model, draco_primitive
from formats.gltf_files import Textured, joined, numbers, picture, unpacked

COLOURS = np.random.default_rng(7).integers(0, 256, (len(GRID), 4)).astype("u1")


def document(model):
    return GltfDocument(model.glb(), "model.glb", None)


def triangles(positions, faces):
    """Return triangles as sets of points of the grid, whatever the order of their vertices."""
    return {frozenset(map(tuple, corners)) for corners in np.rint(positions[faces]).astype(int).tolist()}


def by_point(positions, values):
    return {
        tuple(point): tuple(value)
        for point, value in zip(np.rint(positions).astype(int).tolist(), values, strict=True)
    }


EXPECTED = triangles(GRID, CORNERS)


@pytest.mark.parametrize(
    ("in_order", "width", "mode"), [(True, 3, 4), (True, 4, 5), (False, 3, 5), (False, 4, 4)]
)
def test_colours_and_triangles_are_those_that_were_compressed(in_order, width, mode):
    model = draco_model(COLOURS[:, :width].copy(), in_order=in_order, mode=mode)
    painted = document(model).painted()
    assert painted.stored == "uint8"
    assert triangles(painted.positions, painted.faces) == EXPECTED
    stored = np.rint(painted.colours * 255).astype(int).tolist()
    assert by_point(painted.positions, stored) == by_point(GRID, COLOURS[:, :3].tolist())


@pytest.mark.parametrize("in_order", [True, False])
def test_new_colours_lie_beside_the_compressed_data_which_stays(in_order):
    model = draco_model(COLOURS, in_order=in_order)
    opened = document(model)
    painted = opened.painted()
    after = joined(opened.patch(1 - painted.colours, Naming("out")))
    (old, old_buffers), (new, new_buffers) = unpacked(model.glb()), unpacked(after)
    primitive = new["meshes"][0]["primitives"][0]
    found = numbers(new, new_buffers, primitive["attributes"]["COLOR_0"])
    assert by_point(painted.positions, found.tolist()) == by_point(
        GRID, np.concatenate([255 - COLOURS[:, :3], COLOURS[:, 3:]], axis=1).tolist()
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


def test_what_was_patched_is_read_back_and_then_patched_in_place():
    opened = document(draco_model(COLOURS))
    colours = opened.painted().colours
    first = joined(opened.patch(1 - colours, Naming("out")))
    again = GltfDocument(first, "out.glb", None)
    painted = again.painted()
    assert triangles(painted.positions, painted.faces) == EXPECTED
    np.testing.assert_allclose(painted.colours, 1 - colours, atol=1e-6)
    second = joined(again.patch(colours, Naming("out")))
    assert len(second) == len(first)
    np.testing.assert_array_equal(GltfDocument(second, "out.glb", None).painted().colours, colours)


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
    opened = document(model)
    painted = opened.painted()
    assert len(painted.positions) == len(GRID) * (1 if same else 2)
    data = joined(opened.patch(1 - painted.colours, Naming("out")))
    after, tree = GltfDocument(data, "out.glb", None), unpacked(data)[0]
    np.testing.assert_allclose(after.painted().colours, 1 - painted.colours, atol=1e-6)
    if stranger:
        kept = tree["meshes"][0]["primitives"][0]["attributes"]["_KEPT"]
        assert "bufferView" not in tree["accessors"][kept]


def test_textures_on_compressed_meshes_are_laid_out_and_replaced():
    model = Textured()
    material = model.material(baseColor=model.texture(model.image(picture(1))))
    model.mesh(draco_primitive(model, COLOURS, material=material))
    opened = document(model)
    surface = opened.textured("baseColor")
    corners = np.rint(surface.positions[surface.faces]).astype(int)
    where = {tuple(point): uv for point, uv in zip(GRID.astype(int).tolist(), UV, strict=True)}
    expected = np.array([[where[tuple(corner)] for corner in face] for face in corners.tolist()])
    np.testing.assert_allclose(surface.uv, expected, atol=2**-16)
    new = ImageFile(picture(2, size=400), ".png")
    after = joined(opened.patch(None, Naming("out"), images={("baseColor", "image 0"): new}))
    before, now = unpacked(model.glb()), unpacked(after)
    assert byte_differences(before, now) == {"image"}
    assert set(json_differences(before[0], now[0])) <= {
        "buffers[0].byteLength", "bufferViews[0].byteLength", "bufferViews[0].byteOffset"
    }  # fmt: skip
    again = GltfDocument(after, "out.glb", None).textured("baseColor")
    assert again.textures[0].data == new.data
    np.testing.assert_array_equal(again.uv, surface.uv)


def with_fallback(turned):
    """Give a compressed primitive its geometry uncompressed, too, perhaps with its vertices turned round."""
    model = Textured()
    primitive = draco_primitive(model, COLOURS, in_order=True)
    mesh, rows = (
        DracoPy.decode(draco_bytes(COLOURS, in_order=True)),
        np.arange(len(GRID))[:: -1 if turned else 1],
    )
    corners = np.argsort(rows)[mesh.faces].astype("<u4").reshape(-1, 1)
    found = {key: mesh.get_attribute_by_type(kind)["data"] for key, kind in (("POSITION", 0), ("COLOR_0", 2))}
    plain = {"POSITION": found["POSITION"].astype("<f4"), "COLOR_0": found["COLOR_0"].astype("<u1")}
    for key, array in plain.items():
        view = model.view(np.ascontiguousarray(array[rows]).tobytes())
        model.tree["accessors"][primitive["attributes"][key]]["bufferView"] = view
    model.tree["accessors"][primitive["indices"]]["bufferView"] = model.view(corners.tobytes())
    model.mesh(primitive)
    return model


def test_an_uncompressed_substitute_gets_the_same_colours():
    model = with_fallback(turned=False)
    opened = document(model)
    after = joined(opened.patch(1 - opened.painted().colours, Naming("out")))
    tree, buffers = unpacked(after)
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    points = numbers(tree, buffers, attributes["POSITION"])
    found = by_point(points, numbers(tree, buffers, attributes["COLOR_0"])[:, :3].tolist())
    assert found == by_point(GRID, (255 - COLOURS[:, :3]).tolist())


def test_a_substitute_in_another_order_is_refused_rather_than_painted_wrong():
    opened = document(with_fallback(turned=True))
    colours = opened.painted().colours
    with pytest.raises(InputError, match="another order than its uncompressed fallback"):
        opened.patch(1 - colours, Naming("out"))


@pytest.mark.parametrize("claimed", [None, b"\xff\xff\xff\x7f"])
def test_points_are_refused_however_many_they_claim_to_be(claimed):
    model = draco_model(COLOURS)
    points = bytearray(DracoPy.encode(GRID))
    if claimed is not None:
        points[11 : 11 + len(claimed)] = claimed  # the number of points, for which memory would be taken
    model.tree["meshes"][0]["primitives"][0]["extensions"][DRACO]["bufferView"] = model.view(bytes(points))
    with pytest.raises(InputError, match="holds points, not triangles"):
        document(model).painted()
