"""New places of vertices: positions and normals change in the file, and nothing else does."""

import re

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.gltf.document import GltfDocument
from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.ply.document import PlyDocument
from beltrami_cli.surface.records import MovedVertices
from formats.gltf_comparison import json_differences
from formats.gltf_files import Model, joined, numbers, unpacked
from formats.ply_files import ENCODINGS, Table, build

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
MOVES = np.array([[0, 0, 0], [0.25, 0, 0], [0, 0, -0.5], [0, 0.125, 0.0625]])


def ply(kind="float", normal="float", encoding="ascii"):
    properties = [("quality", "double"), *((name, kind) for name in "xyz")]
    properties += [("red", "uchar"), ("green", "uchar"), ("blue", "uchar")]
    properties += [(name, normal) for name in ("nx", "ny", "nz")] if normal else []
    places = CORNERS.astype(int if kind == "int" else float).tolist()
    rows = [[0.1 + i, *place, 10, 20, 30, *([0, 0, 1] if normal else [])] for i, place in enumerate(places)]
    faces = Table("face", [("vertex_indices", "uchar int")], [[[0, 1, 2]], [[0, 2, 3]]])
    return build([Table("vertex", properties, rows), faces], encoding)


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [(ENCODINGS[0], "float"), (ENCODINGS[0], "double"), (ENCODINGS[1], "double"), (ENCODINGS[2], "float")],
)
def test_only_coordinates_that_differ_change_in_a_ply_file(encoding, kind):
    built = ply(kind, encoding=encoding)
    document = PlyDocument(built.data, "model.ply", None)
    assert document.attributes() == ("normal", "quality", "nx", "ny", "nz")
    assert np.array_equal(document.attribute("Quality")[:, 0], 0.1 + np.arange(4))
    normals = np.full((4, 3), np.nan, np.float32)
    normals[2] = [0.6, 0, 0.8]
    places = MovedVertices(CORNERS + MOVES, normals)
    patched = joined(document.patch(None, Naming("out"), places=places))
    again = PlyDocument(patched, "model.ply", None)
    assert np.array_equal(again.coloured_vertices().positions, CORNERS + MOVES)
    assert np.allclose(again.attribute("normal"), [[0, 0, 1], [0, 0, 1], [0.6, 0, 0.8], [0, 0, 1]])
    assert joined(document.patch(None, Naming("out"), places=MovedVertices(CORNERS))) == built.data
    colours = 1 - document.coloured_vertices().colours
    both = PlyDocument(joined(document.patch(colours, Naming("out"), places=places)), "model.ply", None)
    assert np.array_equal(both.coloured_vertices().positions, CORNERS + MOVES)
    assert np.allclose(both.coloured_vertices().colours, colours, atol=1 / 510)
    changed = [("vertex", r, "xyz"[a]) for r, a in zip(*np.nonzero(MOVES), strict=True)]
    changed += [("vertex", 2, "nx"), ("vertex", 2, "nz")]
    assert built.is_same_but_at(changed, patched)


def test_whole_numbers_cannot_hold_smoothed_positions():
    document = PlyDocument(ply("int", None).data, "model.ply", None)
    with pytest.raises(InputError, match=r"x, y, z are whole numbers.*float"):
        document.require_movable()
    PlyDocument(ply().data, "model.ply", None).require_movable()


OBJ = """# a square
v 0 0 0 1 0 0
v 1.5 0 0 0 1 0   # stays in place
v 1 1 0 1.0 0 0 1
vn 0 0 2
v 0 1e0 0 1 1 1
f 1//1 2//1 3//1 4//1
"""


def test_only_coordinates_that_differ_change_in_an_obj_file():
    document = ObjDocument(OBJ.encode(), "model.obj", None)
    places = document.coloured_vertices().positions.copy()
    places[0, 2], places[2, 1], places[3, 1] = 0.1234567891, -1000.5, 1.25
    written = document.patch(None, Naming("out"), places=MovedVertices(places))
    expected = OBJ.replace("v 0 0 0 1", "v 0 0 0.1235 1", 1).replace("v 1 1 0", "v 1 -1000.5000 0")
    expected = expected.replace("1e0", "1.2500")
    assert joined(written).decode() == expected
    assert any("vn" in notice for notice in written.notices)


def test_decimals_of_an_obj_file_follow_the_size_of_the_model():
    for scale, token in ((1e-6, b"0.0000001250000"), (1.0, b"0.1250000"), (1e6, b"125000.0")):
        text = "".join(f"v {x * scale:g} {y * scale:g} 0 1 1 1\n" for x, y in ((0, 0), (1, 0), (0, 1)))
        document = ObjDocument((text + "f 1 2 3\n").encode(), "model.obj", None)
        places = document.coloured_vertices().positions.copy()
        places[0, 0] = 0.125 * scale
        assert token in joined(document.patch(None, Naming("out"), places=MovedVertices(places)))


def test_normals_of_an_obj_file_are_an_attribute_if_each_vertex_has_one():
    document = ObjDocument(OBJ.encode(), "model.obj", None)
    assert document.attributes() == ("normal",)
    assert not document.has_normals_by_vertex()
    assert np.array_equal(document.attribute("normal"), np.tile([0.0, 0, 1], (4, 1)))
    for text, said in (
        (OBJ + "vn 1 0 0\nf 1//2 2//1 3//1\n", r"line 9.*another normal"),
        (OBJ + "vn 1 0 0\nf 1//3 2//1 3//1\n", "refers to no normal"),
        (OBJ.replace("//1", ""), "vertex 1 has no normal"),
        (OBJ.replace("vn 0 0 2", "vn 0 0"), "three numbers"),
    ):
        with pytest.raises(InputError, match=said):
            ObjDocument(text.encode(), "model.obj", None).attribute("normal")


def square(model, *, positions=None, colours=None, **more):
    """A coloured square with normals; `more` is for its positions."""
    positions = CORNERS.astype("<f4") if positions is None else positions
    colours = np.tile(np.array([10, 20, 30], "u1"), (4, 1)) if colours is None else colours
    attributes = {
        "POSITION": model.packed(positions, bounds=True, **more),
        "NORMAL": model.packed(np.tile(np.array([0, 0, 1], "<f4"), (4, 1))),
        "COLOR_0": model.packed(colours, normalized=True),
        "_QUALITY": model.packed(np.arange(4, dtype="<f4")[:, None]),
    }
    return {"attributes": attributes, "indices": model.indices(np.array([0, 1, 2, 0, 2, 3], "<u2"))}


TURNED = {"rotation": [0, 0, 0.5**0.5, 0.5**0.5], "scale": [2, 3, 4], "translation": [5, 6, 7]}


def to_world(points):
    """What a node that is `TURNED` makes of points: (x, y, z) to (-3 y, 2 x, 4 z), and then moved."""
    x, y, z = np.asarray(points).T
    return np.column_stack([5 - 3 * y, 6 + 2 * x, 7 + 4 * z])


@pytest.mark.parametrize("form", ["glb", "data"])
def test_places_in_a_gltf_file_go_back_through_its_nodes(form):
    model = Model()
    model.mesh(square(model), **TURNED)
    source = model.glb() if form == "glb" else model.data_text()
    document = GltfDocument(source, f"model.{form}", None)
    document.require_movable()
    assert np.allclose(document.coloured_vertices().positions, to_world(CORNERS))
    assert document.attributes() == ("normal", "_QUALITY")
    assert np.array_equal(document.attribute("_quality")[:, 0], np.arange(4))
    # The normal of a plane that is tilted in its own space, and in the world by the inverse transpose.
    own = np.array([0.6, 0, 0.8])
    world = np.array([0, own[0] / 2, own[2] / 4])
    normals = np.full((4, 3), np.nan, np.float32)
    normals[1] = world / np.linalg.norm(world)
    places = MovedVertices(to_world(CORNERS + MOVES), normals)
    tree, buffers = unpacked(joined(document.patch(None, Naming("out"), places=places)))
    before, old_buffers = unpacked(source)
    assert np.allclose(numbers(tree, buffers, 0), CORNERS + MOVES, atol=1e-6)
    assert np.array_equal(numbers(tree, buffers, 0)[0], CORNERS[0])
    assert np.allclose(numbers(tree, buffers, 1), [[0, 0, 1], own, [0, 0, 1], [0, 0, 1]], atol=1e-6)
    for kept in (2, 3, 4):
        assert np.array_equal(numbers(tree, buffers, kept), numbers(before, old_buffers, kept))
    # In place: as many bytes, and no new accessor or view; the bounds follow the new positions.
    assert [len(data) for data in buffers] == [len(data) for data in old_buffers]
    new = numbers(tree, buffers, 0)
    assert tree["accessors"][0]["min"] == new.min(axis=0).tolist()
    assert tree["accessors"][0]["max"] == new.max(axis=0).tolist()
    assert all(
        re.match(r"accessors\[0\]\.(min|max)|buffers", place) for place in json_differences(before, tree)
    )


def moved(model, moves=MOVES):
    """Return the JSON, the buffers and the notices of a model whose positions moved."""
    document = GltfDocument(model.glb(), "model.glb", None)
    places = MovedVertices(document.coloured_vertices().positions + moves)
    written = document.patch(None, Naming("out"), places=places)
    return *unpacked(joined(written)), written.notices


def test_an_accessor_that_something_else_uses_is_spared():
    model = Model()
    primitive = square(model)
    primitive["targets"] = [{"POSITION": primitive["attributes"]["POSITION"]}]
    model.mesh(primitive)
    tree, buffers, _ = moved(model)
    (primitive,) = tree["meshes"][0]["primitives"]
    assert np.array_equal(numbers(tree, buffers, primitive["targets"][0]["POSITION"]), CORNERS)
    assert np.allclose(numbers(tree, buffers, primitive["attributes"]["POSITION"]), CORNERS + MOVES)


def test_what_has_the_same_positions_moves_along_or_is_refused():
    model = Model()
    first, second = square(model), square(model, colours=np.tile(np.array([90, 80, 70], "u1"), (4, 1)))
    second["attributes"]["POSITION"] = first["attributes"]["POSITION"]
    outline = {"attributes": {"POSITION": first["attributes"]["POSITION"]}, "mode": 2}
    model.mesh(first, second, outline)
    tree, buffers, notices = moved(model, np.concatenate([MOVES, MOVES]))
    assert tree["meshes"] == model.tree["meshes"]
    assert np.allclose(numbers(tree, buffers, 0), CORNERS + MOVES)
    assert any("normals" in notice for notice in notices)
    with pytest.raises(InputError, match=r"accessors\[0\].*move apart"):
        moved(model, np.concatenate([MOVES, 0 * MOVES]))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"positions": CORNERS.astype("<u2")}, r"accessors\[0\].*uint16 \(KHR_mesh_quantization\).*floats"),
        ({"node": {"scale": [1, 0, 1]}}, "scales the positions to nothing"),
    ],
)
def test_positions_that_cannot_be_replaced_are_reported_before_anything_is_computed(arguments, said):
    model = Model()
    model.mesh(square(model, positions=arguments.get("positions")), **arguments.get("node", {}))
    with pytest.raises(InputError, match=said):
        GltfDocument(model.glb(), "model.glb", None).require_movable()
