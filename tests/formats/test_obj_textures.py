"""Textures of OBJ files: which image lies where, and that only images and their names change."""

from __future__ import annotations

import io

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.surface.records import ImageFile
from formats.image_files import encode, noise

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = "vt 0 0\nvt 1 0\nvt 1 0.75\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"
NEW = ImageFile(b"new image", ".png")


def folder_with(folder, files):
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder


def model(folder, mtl, obj=None, **files):
    folder_with(folder, {"m.mtl": mtl, "a.png": b"image a", "b.png": b"image b", **files})
    text = obj if obj is not None else f"mtllib m.mtl\n{SQUARE}{CORNERS}usemtl one\n{FACE}"
    (folder / "model.obj").write_bytes(text.encode())
    document = open_document(str(folder / "model.obj"))
    assert isinstance(document, ObjDocument)
    return document


def test_coordinates_are_those_of_the_corners_with_v_turned_down(tmp_path):
    document = model(tmp_path, "newmtl one\nmap_Kd a.png\n")
    assert not document.has_vertex_colours()
    assert document.slots() == ("baseColor",)
    surface = document.textured("baseColor")
    assert document.textured("baseColor") is surface
    wanted = {0: (0, 1), 1: (1, 1), 2: (1, 0.25), 3: (0, 0)}
    for face, uv in zip(surface.faces.tolist(), surface.uv.tolist(), strict=True):
        assert [tuple(corner) for corner in uv] == [wanted[vertex] for vertex in face]
    assert surface.texture_of.tolist() == [0, 0]
    (texture,) = surface.textures
    assert (texture.data, texture.name, texture.materials) == (b"image a", "a.png", ("one",))
    assert texture.wrap == ("repeat", "repeat")


def test_reading_agrees_with_trimesh(tmp_path):
    random = np.random.default_rng(3)
    png = encode(noise("uint8", 3), "png")
    lines = ["v {} {} {}".format(*row) for row in random.random((40, 3)).round(4)]
    lines += ["vt {} {}".format(*row) for row in random.random((60, 2)).round(4)]
    corners = random.integers(0, (40, 60), (50, 3, 2)) + 1
    lines += ["usemtl one", *(" ".join(["f", *(f"{v}/{t}" for v, t in face)]) for face in corners.tolist())]
    document = model(
        tmp_path, "newmtl one\nmap_Kd skin.png\n", "mtllib m.mtl\n" + "\n".join(lines), **{"skin.png": png}
    )
    surface = document.textured("baseColor")
    resolver = trimesh.resolvers.FilePathResolver(str(tmp_path))
    text = io.BytesIO((tmp_path / "model.obj").read_bytes())
    other = trimesh.load(text, file_type="obj", process=False, maintain_order=False, resolver=resolver)
    np.testing.assert_allclose(surface.positions[surface.faces], other.vertices[other.faces], atol=1e-12)
    uv = other.visual.uv[other.faces]
    np.testing.assert_allclose(surface.uv, np.stack([uv[..., 0], 1 - uv[..., 1]], axis=2), atol=1e-12)


def test_negative_indices_count_back_from_the_coordinates_before_the_face(tmp_path):
    obj = f"mtllib m.mtl\n{SQUARE}usemtl one\nvt 0 0\nvt 0.5 0\nvt 0 0.5\nf 1/-3 2/-2 3/-1\n"
    obj += f"{CORNERS}f 1/-4 2/-3/1 3/-2/\n"
    surface = model(tmp_path, "newmtl one\nmap_Kd a.png\n", obj).textured("baseColor")
    assert surface.uv[0].tolist() == [[0, 1], [0.5, 1], [0, 0.5]]
    assert surface.uv[1].tolist() == [[0, 1], [1, 1], [1, 0.25]]


def test_concave_polygons_keep_each_corner_with_its_coordinates(tmp_path):
    points = [(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)]
    obj = "mtllib m.mtl\nusemtl one\n" + "".join(f"v {x} {y} 0\nvt {x / 2} {y / 2}\n" for x, y in points)
    surface = model(tmp_path, "newmtl one\nmap_Kd a.png\n", obj + "f 1/1 2/2 3/3 4/4 5/5\n").textured(
        "baseColor"
    )
    plane = surface.positions[surface.faces][..., :2] / 2
    np.testing.assert_allclose(surface.uv, np.stack([plane[..., 0], 1 - plane[..., 1]], axis=2))
    assert len(surface.faces) == 3


def test_faces_without_coordinates_material_or_map_have_no_texture(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nnewmtl plain\nKd 1 1 1\nnewmtl two # b\nmap_Kd b.png\nnewmtl lost\nmap_Kd c.png\n"
    obj = (
        f"mtllib m.mtl\n{SQUARE}{CORNERS}f 1/1 2/2 3/3\nusemtl one\nf 1/1 2/2 3/3\nf 1 2 3\nf 1//1 2//1 3//1\n"
        "f 1/1 2 3/3\nusemtl plain\nf 1/1 2/2 3/3\nusemtl nowhere\nf 1/1 2/2 3/3\nusemtl two # b\nf 1/1 2/2 3/3\n"
        "usemtl lost\nf 1/1 2/2 3/3\nusemtl one # again\nf 1/1 2/2 3/3\n"
    )
    document = model(tmp_path, mtl, obj)
    surface = document.textured("baseColor")
    names = [surface.textures[i].name if i >= 0 else "" for i in surface.texture_of]
    assert names == ["", "a.png", "", "", "", "", "", "b.png", "", "a.png"]
    said = " ".join(document.notices)
    assert "'c.png'" in said
    assert "3 triangles" in said


def test_options_scale_shift_and_clamp(tmp_path):
    mtl = "newmtl one\nmap_Kd -blendu on -mm 0 1 "
    mtl += "-s 2 3 1 -o .25 -1e-1 -clamp on -bm 1.5 -imfchan r sub dir\\4 a.png\r\n"
    document = model(tmp_path, mtl, **{"sub dir/4 a.png": b"image"})
    surface = document.textured("baseColor")
    plain = model(tmp_path, "newmtl one\nmap_Kd a.png\n").textured("baseColor")
    np.testing.assert_allclose(surface.uv[..., 0], 2 * plain.uv[..., 0] + 0.25)
    np.testing.assert_allclose(1 - surface.uv[..., 1], 3 * (1 - plain.uv[..., 1]) - 0.1)
    assert surface.textures[0].wrap == ("clamp", "clamp")
    assert surface.textures[0].key == "sub dir/4 a.png"


def test_slots_are_recognised_by_their_keywords(tmp_path):
    mtl = "newmtl one\nmap_Ks b.png\nmap_Ke b.png\nmap_Bump -bm 0.5 b.png\nnorm a.png\n"
    document = model(tmp_path, mtl)
    assert document.slots() == ("emissive", "normal")
    assert document.textured("emissive").textures[0].name == "b.png"
    assert document.textured("normal").textures[0].name == "a.png"
    with pytest.raises(InputError, match="no baseColor texture"):
        document.textured("baseColor")


def test_materials_that_share_a_file_share_a_texture(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nnewmtl two\nmap_Kd ./a.png\n"
    obj = f"mtllib m.mtl\n{SQUARE}{CORNERS}usemtl two\nf 1/1 2/2 3/3\nusemtl one\nf 1/1 2/2 3/3\n"
    (texture,) = model(tmp_path, mtl, obj).textured("baseColor").textures
    assert sorted(texture.materials) == ["one", "two"]


def test_a_missing_texture_is_an_error_only_if_there_is_no_other(tmp_path):
    for name in ("gone.png", "../gone.png", "/etc/passwd", "http://a.b/c.png", "sub"):
        (tmp_path / "sub").mkdir(exist_ok=True)
        document = model(tmp_path, f"newmtl one\nmap_Kd {name}\n")
        with pytest.raises(InputError, match="missing"):
            document.textured("baseColor")
    document = model(tmp_path, "newmtl two\nmap_Kd a.png\n")
    with pytest.raises(
        InputError, match="because no library has its material 'one'; correct the name at usemtl"
    ):
        document.textured("baseColor")
    document = model(tmp_path, "", f"mtllib none.mtl\n{SQUARE}{CORNERS}usemtl one\n{FACE}")
    assert document.slots() == ()


@pytest.mark.parametrize(
    ("line", "cause"),
    [("f 1/9 2/1 3/1", "'1/9' refers to no texture"), ("f 1/0 2/1 3/1", "index 0"), ("f 1/x 2/1 3/1", "'1/x'"),
     ("f 1/-5 2/1 3/1", "'1/-5' refers"), ("vt\nf 1/1 2/1 3/1", "no numbers"),
     ("vt a b\nf 1/1 2/1 3/1", "is no number")],
)  # fmt: skip
def test_damaged_coordinates_are_refused_with_their_line(tmp_path, line, cause):
    obj = f"mtllib m.mtl\n{SQUARE}{CORNERS}usemtl one\n{line}\n"
    with pytest.raises(InputError, match=cause) as raised:
        model(tmp_path, "newmtl one\nmap_Kd a.png\n", obj).textured("baseColor")
    assert "line 11" in str(raised.value)


def test_moved_files_keep_their_names_and_the_obj_its_bytes(tmp_path):
    document = model(tmp_path, "newmtl one\nKd 1 1 1\nmap_Kd -o 1 1 a.png # c\n".replace(" # c", ""))
    written = document.patch(None, Naming("out", keeps=True), images={("baseColor", "a.png"): NEW})
    assert b"".join(written.main) == (tmp_path / "model.obj").read_bytes()
    assert dict(written.sidecars) == {"a.png": b"new image"}
    other = ImageFile(b"new", ".exr")
    written = document.patch(None, Naming("out", keeps=True), images={("baseColor", "a.png"): other})
    assert b"".join(written.main) == (tmp_path / "model.obj").read_bytes()
    assert dict(written.sidecars) == {
        "a.exr": b"new",
        "m.mtl": b"newmtl one\nKd 1 1 1\nmap_Kd -o 1 1 a.exr\n",
    }


def test_beside_the_source_only_names_change(tmp_path):
    mtl = "# t\r\nnewmtl one\r\n"
    mtl += "map_Kd -s 1 2 3 maps\\old model_Skin.png\t\r\nmap_Ka maps\\old model_Skin.png\r\nnorm a.png\r\n"
    obj = f"# x\nmtllib my lib.mtl m.mtl\nmtllib my lib.mtl\n{SQUARE}{CORNERS}usemtl one\n{FACE}"
    files = {
        "my lib.mtl": mtl,
        "m.mtl": "newmtl x\n",
        "maps/old model_Skin.png": b"skin",
        "a.png": b"",
        "old model.obj": obj,
    }
    folder_with(tmp_path, files)
    document = open_document(str(tmp_path / "old model.obj"))
    document.textured("baseColor")
    key = "maps/old model_Skin.png"
    written = document.patch(None, Naming("new"), images={("baseColor", key): NEW})
    assert b"".join(written.main).decode() == obj.replace("my lib.mtl", "new.mtl")
    assert dict(written.sidecars) == {
        "maps/new_Skin.png": b"new image",
        "new.mtl": mtl.replace("old model_Skin", "new_Skin").encode(),
    }
    for name, content in files.items():
        assert (tmp_path / name).read_bytes() == (content if isinstance(content, bytes) else content.encode())
    assert sorted(document.references()) == ["a.png", "m.mtl", "maps/old model_Skin.png", "my lib.mtl"]


def test_names_without_the_models_stem_get_the_new_one_in_front_and_none_is_taken_twice(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nmap_Ke model.png\nnorm out_a.png\n"
    document = model(tmp_path, mtl, **{"out_a.png": b"", "model.png": b"", "out.mtl": b""})
    images = {("baseColor", "a.png"): NEW, ("emissive", "model.png"): ImageFile(b"light", ".jpg")}
    written = document.patch(None, Naming("out"), images=images)
    assert dict(written.sidecars) == {
        "out_a-2.png": b"new image",
        "out.jpg": b"light",
        "out.mtl": b"newmtl one\nmap_Kd out_a-2.png\nmap_Ke out.jpg\nnorm out_a.png\n",
    }
    same = document.patch(None, Naming("model"), images={("emissive", "model.png"): NEW})
    assert "model.png" not in same.sidecars
    assert "m.mtl" not in same.sidecars


def test_an_image_in_two_slots_is_replaced_in_one(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nmap_Ke a.png\n"
    document = model(tmp_path, mtl)
    for moved in (True, False):
        written = document.patch(None, Naming("out", keeps=moved), images={("emissive", "a.png"): NEW})
        library = written.sidecars["m.mtl" if moved else "out.mtl"]
        assert library == b"newmtl one\nmap_Kd a.png\nmap_Ke out_a.png\n"
        assert written.sidecars["out_a.png"] == b"new image"
        assert "a.png" not in written.sidecars


COLOURED = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 0.5 0.5 0.5\n"


@given(
    st.lists(
        st.sampled_from(["mtllib m.mtl", "v", "# mtllib m.mtl", "mtllib  m.mtl  m.mtl # x"]), max_size=8
    ),
    st.data(),
)
@settings(max_examples=60, deadline=None)
def test_colours_and_names_change_together_and_nothing_else(tmp_path_factory, lines, data):
    folder = tmp_path_factory.mktemp("m")
    rows, wanted, count = [], [], 4
    new = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0.5]], np.float32)
    for line in lines:
        if line == "v":
            count += 1
            change = data.draw(st.booleans())
            rows.append("v 0 0 9 0.250000 0 1")
            wanted.append("v 0 0 9 0.750000 0 1" if change else rows[-1])
            new = np.vstack([new, np.float32([0.75 if change else 0.25, 0, 1])])
        else:
            rows.append(line)
            wanted.append(line if line[0] == "#" else line.replace("m.mtl", "a longer.mtl"))
    tail = f"{COLOURED}{CORNERS}mtllib m.mtl\nusemtl one\n{FACE}"
    new = np.vstack([new[4:], new[:4]])
    document = model(folder, "newmtl one\nmap_Kd a.png\n", "\n".join([*rows, tail]))
    assert document.has_vertex_colours()
    patched = document.patch(new, Naming("a longer"), images={("baseColor", "a.png"): NEW})
    assert b"".join(patched.main).decode() == "\n".join([*wanted, tail.replace("m.mtl", "a longer.mtl")])
