"""What is painted in a glTF file: rows, faces, places."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.formats.gltf.document import GltfDocument
from formats.gltf_files import Model

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")


def document(model):
    return GltfDocument(model.glb(), "model.glb", None)


def triangle(model, colours=None, positions=TRIANGLE, **more):
    colours = np.eye(3, dtype="<f4") if colours is None else colours
    attributes = {"POSITION": model.packed(positions), "COLOR_0": model.packed(colours)}
    return {"attributes": attributes, **more}


def drawn(mode, corners):
    """Triangles as the specification lists them, one by one."""
    n = len(corners)
    if mode == 4:
        found = [(corners[i], corners[i + 1], corners[i + 2]) for i in range(0, n - 2, 3)]
    elif mode == 5:
        found = [
            (corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2])
            for i in range(n - 2)
            if len({corners[i], corners[i + 1], corners[i + 2]}) == 3
        ]
    elif mode == 6:
        found = [(corners[i + 1], corners[i + 2], corners[0]) for i in range(n - 2)]
    else:
        found = []
    return np.array(found, np.int32).reshape(-1, 3)


@settings(max_examples=60, deadline=None)
@given(
    mode=st.integers(0, 6),
    kind=st.sampled_from(("<u1", "<u2", "<u4", None)),
    size=st.integers(1, 20),
    seed=st.integers(0, 99),
)
def test_every_mode_draws_the_triangles_of_the_specification(mode, kind, size, seed):
    rng, model = np.random.default_rng(seed), Model()
    primitive = triangle(model, rng.random((7, 3)).astype("<f4"), rng.random((7, 3)).astype("<f4"), mode=mode)
    corners = np.arange(7)
    if kind is not None:
        corners = rng.integers(0, 7, size).astype(kind)
        primitive["indices"] = model.indices(corners)
    model.mesh(primitive)
    np.testing.assert_array_equal(document(model).painted().faces, drawn(mode, corners.tolist()))


numbers = st.floats(-4, 4, width=32)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_world_positions_agree_with_trimesh_on_node_hierarchies(data):
    model, rng = Model(), np.random.default_rng(data.draw(st.integers(0, 99)))
    count = data.draw(st.integers(1, 4))
    for _ in range(count):
        points = rng.normal(size=(3, 3)).astype("<f4")
        model.mesh(triangle(model, positions=points, indices=model.indices(np.arange(3, dtype="<u2"))))
    nodes = model.tree["nodes"]
    model.tree["scenes"][0]["nodes"] = []
    for index in range(count):
        if data.draw(st.booleans()):
            nodes[index]["matrix"] = np.vstack([rng.normal(size=(3, 4)), [0, 0, 0, 1]]).T.ravel().tolist()
        else:
            turn = rng.normal(size=4)
            nodes[index] |= {"translation": rng.normal(size=3).tolist(), "scale": rng.normal(size=3).tolist()}
            nodes[index]["rotation"] = (turn / np.linalg.norm(turn)).tolist()
        parent = data.draw(st.integers(-1, index - 1))
        siblings = (
            nodes[parent].setdefault("children", []) if parent >= 0 else model.tree["scenes"][0]["nodes"]
        )
        siblings.append(index)
    found = document(model).painted().positions.reshape(count, 3, 3)
    scene = trimesh.load(trimesh.util.wrap_as_stream(model.glb()), file_type="glb", process=False)
    other = np.array([mesh.triangles[0] for mesh in scene.dump()])
    for place in found:
        distance = min(np.abs(np.sort(place, axis=0) - np.sort(item, axis=0)).max() for item in other)
        assert distance < 1e-5 * (1 + np.abs(place).max())


def test_a_skinned_mesh_stays_where_it_is_stored():
    model = Model()
    model.mesh(triangle(model), translation=[5, 6, 7], skin=0)
    model.tree["skins"] = [{"joints": [0]}]
    np.testing.assert_array_equal(document(model).painted().positions, TRIANGLE)


def test_a_mirrored_node_keeps_its_outside():
    model = Model()
    model.mesh(triangle(model), scale=[-1, 1, 1])
    painted = document(model).painted()
    a, b, c = painted.positions[painted.faces[0]]
    assert np.cross(b - a, c - a)[2] > 0


def test_primitives_that_share_a_pair_share_rows():
    model = Model()
    first = triangle(model, indices=model.indices(np.array([0, 1, 2], "<u1")))
    second = {"attributes": first["attributes"], "indices": model.indices(np.array([2, 1, 0], "<u1"))}
    model.mesh(first, second, second)
    painted = document(model).painted()
    assert len(painted.positions) == 3
    np.testing.assert_array_equal(painted.faces, [[0, 1, 2], [2, 1, 0]])


def test_colours_used_at_two_places_have_one_row_and_a_notice():
    model = Model()
    first = triangle(model)
    second = {"attributes": first["attributes"] | {"POSITION": model.packed(TRIANGLE + 5)}}
    model.mesh(first, second)
    opened = document(model)
    painted = opened.painted()
    assert opened.painted() is painted
    np.testing.assert_array_equal(painted.positions, TRIANGLE)
    assert [notice for notice in opened.notices if "other positions" in notice]
    assert painted.faces.tolist() == [[0, 1, 2]]


def test_an_instanced_mesh_is_taken_once_at_its_first_node():
    model = Model()
    model.mesh(triangle(model), translation=[1, 0, 0])
    model.tree["nodes"].append({"mesh": 0, "translation": [9, 0, 0]})
    model.tree["scenes"][0]["nodes"].append(1)
    opened = document(model)
    np.testing.assert_array_equal(opened.painted().positions, TRIANGLE + np.array([1, 0, 0]))
    assert [notice for notice in opened.notices if "several nodes" in notice]


def test_scenes_and_meshes_outside_them_are_spaces_of_their_own():
    model = Model()
    for shift in range(4):
        model.mesh(triangle(model), translation=[shift, 0, 0], node=shift != 3)
    model.tree["scenes"] = [{"nodes": [0]}, {"nodes": [1, 2]}]
    model.tree["scene"] = 1
    painted = document(model).painted()
    space = painted.space_of.reshape(4, 3)
    assert (space == space[:, :1]).all()
    assert space[1, 0] == space[2, 0] == 0
    assert len(set(space[:, 0].tolist())) == 3
    np.testing.assert_array_equal(painted.positions[9:], TRIANGLE)
    del model.tree["scene"]
    assert set(document(model).painted().space_of[:9]) == {0}


def test_mixed_types_are_called_by_the_coarsest():
    model = Model()
    model.mesh(
        triangle(model),
        triangle(model, np.eye(3, dtype="<u2") * 65535),
        triangle(model, np.eye(3, 4, dtype="<f4")),
    )
    model.tree["accessors"][3]["normalized"] = True
    painted = document(model).painted()
    assert painted.stored == "uint16"
    assert (painted.encoding, painted.space_of) == ("linear", None)
    np.testing.assert_array_equal(painted.colours, np.tile(np.eye(3, dtype=np.float32), (3, 1)))


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
        "POSITION": model.packed(np.eye(4, 3, dtype="<f4")),
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
