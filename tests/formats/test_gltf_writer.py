"""Meshes written as new glTF files, and glTF meshes handed to other formats."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.formats.gltf.writer import write_glb, write_gltf
from beltrami_cli.surface.records import MeshContents, linear_to_srgb
from formats.gltf_files import Model, joined, numbers, unpacked

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)


def mesh(colours=None, encoding="srgb", stored="uint8", positions=SQUARE, **more):
    colours = np.linspace(0, 1, 3 * len(positions)).reshape(-1, 3) if colours is None else colours
    corners = {"corners": np.array([0, 1, 2, 3], np.int32), "offsets": np.array([0, 4], np.int64)}
    return MeshContents(
        positions=positions,
        colours=colours.astype(np.float32),
        encoding=encoding,
        stored=stored,
        **(corners | more),
    )


def points(colours, **more):
    count = len(colours)
    corners, offsets = np.empty(0, np.int32), np.zeros(1, np.int64)
    return mesh(colours, positions=np.zeros((count, 3)), corners=corners, offsets=offsets, **more)


@pytest.mark.parametrize("stored", ["uint8", "uint16"])
def test_every_srgb_level_comes_back(stored):
    top = np.iinfo(stored).max
    levels = np.arange(top + 1)
    grey = np.repeat((levels / top)[:, None], 3, axis=1)
    written = write_glb(points(grey, stored=stored, alpha=grey[:, 0].astype(np.float32)), "grey")
    contents = GltfDocument(joined(written), "grey.glb", None).contents()
    back = np.rint(linear_to_srgb(contents.colours.astype(np.float64)) * top)
    np.testing.assert_array_equal(back, np.repeat(levels[:, None], 3, axis=1))
    np.testing.assert_array_equal(np.rint(contents.alpha.astype(np.float64) * top), levels)


@pytest.mark.parametrize(("stored", "kind"), [("uint8", "<u1"), ("uint16", "<u2"), ("float32", "<f4")])
def test_linear_colours_keep_their_type(stored, kind):
    rng = np.random.default_rng(0)
    colours = rng.random((9, 3)).astype("<f4")
    if kind != "<f4":
        colours = (np.rint(colours * np.iinfo(stored).max) / np.iinfo(stored).max).astype(np.float32)
    written = write_glb(points(colours, encoding="linear", stored=stored), "c")
    painted = GltfDocument(joined(written), "c.glb", None).painted()
    assert painted.stored == stored
    np.testing.assert_array_equal(painted.colours, colours)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 99),
    normals=st.booleans(),
    alpha=st.booleans(),
    encoding=st.sampled_from(("srgb", "linear")),
)
def test_what_is_written_reads_back(tmp_path_factory, seed, normals, alpha, encoding):
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("written")
    up = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    contents = mesh(
        rng.random((4, 3)),
        encoding,
        "float32",
        normals=up if normals else None,
        alpha=rng.random(4).astype(np.float32) if alpha else None,
    )
    text, binary = write_gltf(contents, "s t"), write_glb(contents, "s t")
    (folder / "s t.bin").write_bytes(bytes(text.sidecars["s t.bin"]))
    for document in (GltfDocument(joined(text), "x", folder), GltfDocument(joined(binary), "x", None)):
        back = document.contents()
        np.testing.assert_array_equal(back.positions, SQUARE)
        assert back.corners.reshape(-1, 3).shape == (2, 3)
        assert (back.normals is not None, back.alpha is not None) == (normals, alpha)
        colours = linear_to_srgb(back.colours) if encoding == "srgb" else back.colours
        np.testing.assert_allclose(colours, contents.colours, atol=1e-6)
        if alpha:
            np.testing.assert_array_equal(back.alpha, contents.alpha)


def test_the_file_is_what_others_read_too():
    loaded = trimesh.load(
        trimesh.util.wrap_as_stream(joined(write_glb(mesh(), "x"))), file_type="glb", process=False
    )
    (geometry,) = loaded.geometry.values()
    assert geometry.area == pytest.approx(1)
    tree, buffers = unpacked(joined(write_glb(mesh(), "x")))
    accessor = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    assert (accessor["min"], accessor["max"]) == ([0, 0, 0], [1, 1, 0])
    assert numbers(tree, buffers, tree["meshes"][0]["primitives"][0]["indices"]).dtype == np.uint16


def test_losses_are_reported():
    far = SQUARE + 0.1
    notices = " ".join(
        write_glb(mesh(mesh().colours * 2, positions=far, left_out=("materials",)), "x").notices
    )
    for word in ("single precision", "cut into triangles", "clipped", "materials", "linear light"):
        assert word in notices
    assert not write_glb(points(np.eye(3), encoding="linear"), "x").notices
    assert "Grey" in " ".join(write_glb(mesh(np.ones((4, 1))), "x").notices)


def test_positions_beyond_float32_are_refused():
    with pytest.raises(InputError, match="too large"):
        write_glb(mesh(positions=SQUARE * 1e300), "x")


def test_points_stay_points():
    tree, _ = unpacked(joined(write_glb(points(np.eye(3)), "x")))
    primitive = tree["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert "indices" not in primitive


def test_normals_turn_as_surfaces_do_under_uneven_and_mirrored_scales():
    rng, model = np.random.default_rng(3), Model()
    for scale in ([1, 2, 5], [-1, 2, 0.5]):
        corners = rng.normal(size=(3, 3)).astype("<f4")
        normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        normals = np.tile(normal / np.linalg.norm(normal), (3, 1)).astype("<f4")
        attributes = {
            "POSITION": model.packed(corners),
            "NORMAL": model.packed(normals),
            "COLOR_0": model.packed(np.eye(3, dtype="<f4")),
        }
        turn = rng.normal(size=4)
        model.mesh({"attributes": attributes}, scale=scale, rotation=(turn / np.linalg.norm(turn)).tolist())
    contents = GltfDocument(model.glb(), "x", None).contents()
    for a, b, c in contents.corners.reshape(-1, 3):
        place = contents.positions
        outside = np.cross(place[b] - place[a], place[c] - place[a])
        np.testing.assert_allclose(contents.normals[a], outside / np.linalg.norm(outside), atol=1e-5)


def test_what_is_dropped_is_listed():
    model = Model()
    attributes = {
        "POSITION": model.packed(SQUARE.astype("<f4")),
        "COLOR_0": model.packed(np.eye(4, 3, dtype="<f4")),
    }
    model.mesh(
        {"attributes": attributes | {"TEXCOORD_0": 0}}, {"attributes": {"POSITION": 0}}, translation=[1, 0, 0]
    )
    model.tree |= {"materials": [{}], "animations": [{"samplers": []}], "cameras": [{}]}
    contents = GltfDocument(model.glb(), "x", None).contents()
    expected = {
        "materials",
        "animations",
        "cameras",
        "uncoloured meshes",
        "texture coordinates",
        "node hierarchy",
    }
    assert set(contents.left_out) == expected
    assert contents.alpha is None
    assert json.dumps(contents.left_out)
