"""Textures of OBJ files, in the dialects of programs: which image lies where, and only images and names change."""

import io

import numpy as np
import pytest
import trimesh

from beltrami_cli.errors import InputError
from beltrami_cli.formats.changes import Naming
from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.check import check_files
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.surface.records import ImageFile
from formats.gltf_files import joined
from formats.image_files import encode, noise
from hostile.folders import snapshot, write
from hostile.textured_models import ONCE, OTHER, PICTURE

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = "vt 0 0\nvt 1 0\nvt 1 0.75\nvt 0 1\n"
FACE = "f 1/1 2/2 3/3 4/4\n"
NEW = ImageFile(b"new image", ".png")


def model(folder, mtl="newmtl one\nmap_Kd a.png\n", obj=None, **files):
    write(folder, {"m.mtl": mtl, "a.png": b"image a", "b.png": b"image b", **files})
    text = obj if obj is not None else f"mtllib m.mtl\n{SQUARE}{CORNERS}usemtl one\n{FACE}"
    (folder / "model.obj").write_bytes(text.encode())
    document = open_document(str(folder / "model.obj"))
    assert isinstance(document, ObjDocument)
    return document


def test_reading_agrees_with_trimesh(tmp_path):
    random = np.random.default_rng(3)
    png = encode(noise("uint8", 3), "png")
    lines = ["v {} {} {}".format(*row) for row in random.random((40, 3)).round(4)]
    lines += ["vt {} {}".format(*row) for row in random.random((60, 2)).round(4)]
    corners = random.integers(0, (40, 60), (50, 3, 2)) + 1
    lines += ["usemtl one", *(" ".join(["f", *(f"{v}/{t}" for v, t in face)]) for face in corners.tolist())]
    surface = model(tmp_path, obj="\n".join(["mtllib m.mtl", *lines]), **{"a.png": png}).textured("baseColor")
    resolver = trimesh.resolvers.FilePathResolver(str(tmp_path))
    text = io.BytesIO((tmp_path / "model.obj").read_bytes())
    other = trimesh.load(text, file_type="obj", process=False, maintain_order=False, resolver=resolver)
    np.testing.assert_allclose(surface.positions[surface.faces], other.vertices[other.faces], atol=1e-12)
    uv = other.visual.uv[other.faces]
    np.testing.assert_allclose(surface.uv, np.stack([uv[..., 0], 1 - uv[..., 1]], axis=2), atol=1e-12)


def test_negative_indices_count_back_from_the_coordinates_before_the_face(tmp_path):
    obj = f"mtllib m.mtl\n{SQUARE}usemtl one\nvt 0 0\nvt 0.5 0\nvt 0 0.5\nf 1/-3 2/-2 3/-1\n"
    obj += f"{CORNERS}f 1/-4 2/-3/1 3/-2/\n"
    surface = model(tmp_path, obj=obj).textured("baseColor")
    assert surface.uv[0].tolist() == [[0, 1], [0.5, 1], [0, 0.5]]
    assert surface.uv[1].tolist() == [[0, 1], [1, 1], [1, 0.25]]


def test_concave_polygons_keep_each_corner_with_its_coordinates(tmp_path):
    points = [(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)]
    obj = "mtllib m.mtl\nusemtl one\n" + "".join(f"v {x} {y} 0\nvt {x / 2} {y / 2}\n" for x, y in points)
    surface = model(tmp_path, obj=obj + "f 1/1 2/2 3/3 4/4 5/5\n").textured("baseColor")
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
    said = " ".join([*document.notices, *surface.notices])
    assert "'c.png'" in said
    assert "3 triangles" in said


def test_options_scale_shift_and_clamp(tmp_path):
    mtl = "newmtl one\nmap_Kd -blendu on -mm 0 1 "
    mtl += "-s 2 3 1 -o .25 -1e-1 -clamp on -bm 1.5 -imfchan r sub dir\\4 a.png\r\n"
    document = model(tmp_path, mtl, **{"sub dir/4 a.png": b"image"})
    surface = document.textured("baseColor")
    plain = model(tmp_path).textured("baseColor")
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
    strange = model(tmp_path, "newmtl two\nmap_Kd a.png\n")
    with pytest.raises(InputError, match="no library has its material 'one'; correct the name at usemtl"):
        strange.textured("baseColor")


def test_materials_that_share_a_file_share_a_texture(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nnewmtl two\nmap_Kd ./a.png\n"
    obj = f"mtllib m.mtl\n{SQUARE}{CORNERS}usemtl two\nf 1/1 2/2 3/3\nusemtl one\nf 1/1 2/2 3/3\n"
    (texture,) = model(tmp_path, mtl, obj).textured("baseColor").textures
    assert sorted(texture.materials) == ["one", "two"]


@pytest.mark.parametrize(
    ("line", "cause"),
    [("f 1/9 2/1 3/1", "'1/9' refers to no texture"), ("f 1/0 2/1 3/1", "index 0"), ("f 1/x 2/1 3/1", "'1/x'"),
     ("f 1/-5 2/1 3/1", "'1/-5' refers"), ("vt\nf 1/1 2/1 3/1", "no numbers"),
     ("vt a b\nf 1/1 2/1 3/1", "is not a number")],
)  # fmt: skip
def test_damaged_coordinates_are_refused_with_their_line_where_textures_are_wanted(tmp_path, line, cause):
    coloured = SQUARE.replace("\n", " 0.1 0.2 0.3\n")
    document = model(tmp_path, obj=f"mtllib m.mtl\n{coloured}{CORNERS}usemtl one\n{line}\n")
    assert document.has_vertex_colours()
    assert len(document.contents().colours) == 4
    for _ in range(2):
        with pytest.raises(InputError, match=cause) as raised:
            document.textured("baseColor")
        assert "line 11" in str(raised.value)


def test_an_image_in_two_slots_is_replaced_in_one(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nmap_Ke a.png\n"
    document = model(tmp_path, mtl)
    for moved in (True, False):
        written = document.patch(None, Naming("out", in_place=moved), images={("emissive", "a.png"): NEW})
        library = written.sidecars["m.mtl" if moved else "out.mtl"]
        assert library == b"newmtl one\nmap_Kd a.png\nmap_Ke out_a.png\n"
        assert written.sidecars["out_a.png"] == b"new image"
        assert "a.png" not in written.sidecars


def test_colours_that_show_the_image_of_the_base_colour_follow_and_other_maps_are_named(tmp_path):
    mtl = "newmtl one\nmap_Kd a.png\nmap_Ks a.png\nmap_Ns {}.png\nrefl {}.png\n"
    written = model(tmp_path, mtl.format("a", "a")).patch(
        None, Naming("out"), images={("baseColor", "a.png"): NEW}
    )
    assert written.sidecars["out.mtl"].decode().split("\n")[1:3] == ["map_Kd out_a.png", "map_Ks out_a.png"]
    for notice, keyword in zip(written.notices, ("map_ns", "refl"), strict=True):
        assert f"{keyword} of material one shows a.png" in notice
    shiny = model(tmp_path, mtl.format("a", "a"), **{"a.png": PICTURE})
    assert {"map_ks maps", "map_ns maps"} <= {
        *shiny.textured_mesh().left_out
    }  # which other formats lose all the same
    (tmp_path / "apart").mkdir()
    apart = model(tmp_path / "apart", mtl.format("b", "b"))
    assert not apart.patch(None, Naming("out"), images={("baseColor", "a.png"): NEW}).notices


COLOURED = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0 0 0 1\nv 0 1 0 0.5 0.5 0.5\n"


def test_colours_and_names_change_together_and_nothing_else(tmp_path):
    lines = ["mtllib m.mtl", "v 0 0 9 0.250000 0 1", "# mtllib m.mtl", "v 0 0 9 0.250000 0 1"]
    lines = [*lines, "mtllib  m.mtl  m.mtl # x", "", f"{COLOURED}{CORNERS}mtllib m.mtl", "usemtl one", FACE]
    document = model(tmp_path, obj="\n".join(lines))
    colours = document.coloured_vertices().colours.copy()
    colours[1, 0] = 0.75
    written = document.patch(colours, Naming("a longer"), images={("baseColor", "a.png"): NEW})
    lines[3] = "v 0 0 9 0.750000 0 1"
    expected = [line if line.startswith("#") else line.replace("m.mtl", "a longer.mtl") for line in lines]
    assert joined(written).decode() == "\n".join(expected)


ALL_SLOTS = (
    "# a comment with v 1 2 3\n"
    "mtllib first one.mtl second.mtl\n"
    "mtllib gone.mtl\n"
    "o the object\n" + SQUARE + CORNERS + "vn 0 0 1\n"
    "s 1\n"
    "g left side\n"
    "usemtl red brick\n"
    "f 1/1/1 \\\n  2/2/1 3/3/1\n"
    "usemtl slate\n"
    "f -4/-4 -2/-2 \\\n-1/-1\n"
    "l 1 2 3\n"
    "p 1 4\n"
    "g right f 1 2 3\n"
    "usemtl red brick\n"  # again
    "f 1//1 3//1 4//1\n"
    "usemtl unknown\n"
    "f 1/1 2/2 4/4\n"
    "cstype bezier\ncurv 0 1 1 2\n"
)
FIRST = (
    "# made by a program\n"
    "newmtl red brick\n"
    "Ka 1 1 1\n"
    "map_Kd -s 1 1 1 -o 0 0 0 -mm 0 1 -bm 0.5 -texres 512 -imfchan m -clamp on maps\\red brick.png\n"
    "map_Ka -blendu off -blendv off maps\\red brick.png\n"
    "bump -bm 0.2 maps/normal.png\n"
)
SECOND = "newmtl slate\r\nmap_Kd\tmaps/slate.png  \r\nillum 2"


def write_everything(folder, newline="\n"):
    (folder / "maps").mkdir(parents=True)
    (folder / "model.obj").write_bytes(ALL_SLOTS.replace("\n", newline).encode())
    (folder / "first one.mtl").write_bytes(FIRST.replace("\n", newline).encode())
    (folder / "second.mtl").write_bytes(SECOND.encode())
    for name, image in {"red brick": PICTURE, "slate": OTHER, "normal": OTHER}.items():
        (folder / "maps" / f"{name}.png").write_bytes(image)
    return folder / "model.obj"


@pytest.mark.slow
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_all_dialects_together(newline, tmp_path):
    model = write_everything(tmp_path, newline)
    before = snapshot(tmp_path)
    report = smooth_file(model, tmp_path / "clean.obj", ONCE)
    after = snapshot(tmp_path)
    assert {path: after[path] for path in before} == before
    changes = {
        "clean.obj": ("model.obj", b"first one.mtl second.mtl", b"clean.mtl clean-2.mtl"),
        "clean.mtl": ("first one.mtl", b"maps\\red brick", b"maps\\clean_red brick"),
        "clean-2.mtl": ("second.mtl", b"slate.png", b"clean_slate.png"),
    }
    assert after.keys() - before.keys() == {*changes, "maps/clean_red brick.png", "maps/clean_slate.png"}
    for name, (source, old, new) in changes.items():
        assert after[name][1] == before[source][1].replace(old, new)
    assert [found["name"] for found in report.textures[0].textures] == ["red brick.png", "slate.png"]
    assert any("'gone.mtl' is missing" in warning for warning in report.warnings)
    assert any("1 triangles of textured materials have no texture coordinates" in w for w in report.warnings)
    assert check_files(model, tmp_path / "clean.obj").faithful


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ("", "a.png"), ("-s 2 3 1 -o 0.5 -.25 0", "a.png"), ("-s 2", "a.png"), ("-o .5 1e-3", "7.png"),
        ("-t 1 1 1", "a b.png"),
        ("-clamp off -blendu on -cc off -boost 1.5 -texres 64 -imfchan l -mm 0 1 -bm -2", "a -s b.png"),
        ("-type sphere", "a.png"), ("-s none -o -1e", "a.png"),
    ],
)  # fmt: skip
def test_options_before_the_name_of_a_map(options, name, tmp_path):
    document = model(tmp_path, f"newmtl one\nmap_Kd {options} {name}\n", **{name: PICTURE})
    (texture,) = document.textured("baseColor").textures
    assert texture.name == name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["m a.mtl", '"m a.mtl"', "./m a.mtl", ".\\m a.mtl", "m a.mtl # why"])
def test_a_library_is_found_however_it_is_named(name, tmp_path):
    (tmp_path / "a.png").write_bytes(PICTURE)
    (tmp_path / "m a.mtl").write_text('newmtl m\nmap_Kd "a.png"\n')
    source = f"mtllib {name}\n{SQUARE}{CORNERS}usemtl m\nf 1/1 2/2 3/3 4/4\n"
    (tmp_path / "x.obj").write_text(source)
    smooth_file(tmp_path / "x.obj", tmp_path / "y.obj")
    assert (tmp_path / "y.obj").read_text() == source.replace("m a.mtl", "y.mtl")
    assert (tmp_path / "y.mtl").read_text() == 'newmtl m\nmap_Kd "y_a.png"\n'


def test_the_first_library_that_has_a_material_counts(tmp_path):
    obj = f"mtllib m.mtl\nmtllib other.mtl\n{SQUARE}{CORNERS}usemtl one\nf 1/1 2/2 3/3\n"
    document = model(tmp_path, obj=obj, **{"other.mtl": "newmtl one\nmap_Kd b.png\n"})
    (texture,) = document.textured("baseColor").textures
    assert texture.name == "a.png"


def two_squares(folder, mtl=b"newmtl m\nmap_Kd t.png\n", v="v 3 0 0", vt="vt 1 1", colour=""):
    """A textured square, and another one that has a corner and coordinates of its own."""
    square = "".join(f"{line}{colour}\n" for line in SQUARE.splitlines())
    faces = "usemtl m\nf 1/1 2/2 3/3 4/4\nf 2/2 5/5 3/3\n"
    (folder / "in.obj").write_text(f"mtllib in.mtl\n{square}{v}{colour}\n{CORNERS}{vt}\n{faces}")
    (folder / "in.mtl").write_bytes(mtl)
    pixels = np.rint(120 + 20 * np.random.default_rng(5).standard_normal((24, 24, 3))).astype(np.uint8)
    (folder / "t.png").write_bytes(encode(pixels, "png"))
    return folder / "t.png"


def smoothed(folder, out="out.obj", **settings):
    """Smooth and check; return what was said."""
    report = smooth_file(folder / "in.obj", folder / out, ONCE, Job(overwrite=True), **settings)
    assert check_files(folder / "in.obj", folder / out).faithful
    return " ".join(report.warnings)


def test_a_byte_order_mark_of_a_library_is_kept(tmp_path):
    two_squares(tmp_path, b"\xef\xbb\xbfnewmtl m\nmap_Kd t.png\n")
    smoothed(tmp_path)
    assert (tmp_path / "out.mtl").read_bytes() == b"\xef\xbb\xbfnewmtl m\nmap_Kd out_t.png\n"


PATHS = ["C:\\Users\\someone\\t.png", "/home/someone/t.png", "..\\maps\\t.png", "\\\\server\\share\\t.png"]


@pytest.mark.parametrize("name", PATHS)
@pytest.mark.parametrize("place", [".", "elsewhere"])
def test_the_image_beside_the_model_is_taken_for_one_on_another_machine(tmp_path, name, place):
    two_squares(tmp_path, f"newmtl m\nmap_Kd {name}\n".encode())
    (tmp_path / "elsewhere").mkdir()
    said = smoothed(tmp_path, f"{place}/out.obj")
    assert f"'{name}' is not followed; 't.png' in the model's folder is taken" in said
    assert (tmp_path / place / "out.mtl").read_text() == "newmtl m\nmap_Kd out_t.png\n"


def test_a_library_in_a_folder_names_the_image_beside_the_model_from_there(tmp_path):
    two_squares(tmp_path)
    (tmp_path / "mats").mkdir()
    (tmp_path / "in.mtl").rename(tmp_path / "mats" / "in.mtl")
    text = (tmp_path / "in.obj").read_text().replace("mtllib in.mtl", "mtllib mats/in.mtl")
    (tmp_path / "in.obj").write_text(text)
    assert "'t.png' in the model's folder is taken" in smoothed(tmp_path)
    assert (tmp_path / "mats" / "out.mtl").read_text() == "newmtl m\nmap_Kd ../out_t.png\n"


@pytest.mark.parametrize(
    ("name", "encoding"), [("颜色", "gbk"), ("表面", "cp932"), ("été", "cp1252"), ("é", "utf-8")]
)
def test_names_in_the_encoding_of_an_exporter_are_those_in_the_folder(tmp_path, name, encoding):
    two_squares(tmp_path, f"newmtl m\nmap_Kd maps\\{name}.png\n".encode(encoding))
    (tmp_path / "maps").mkdir()
    (tmp_path / "t.png").rename(tmp_path / "maps" / f"{name}.png")
    assert ("is taken for it" in smoothed(tmp_path)) == (encoding != "utf-8")
    assert (tmp_path / "maps" / f"out_{name}.png").exists()


@pytest.mark.parametrize(
    ("what", "number", "colour"),
    [("v", "nan", ""), ("vt", "nan", " 0.2 0.3 0.4"), ("v", "-nan(ind)", " 0.2 0.3 0.4"), ("vt", "-nan(ind)", ""),
     ("vt", "1.#QNAN", " 0.2 0.3 0.4"), ("v", "inf", " 0.2 0.3 0.4"), ("vt", "inf", "")],
)  # fmt: skip
def test_numbers_that_are_not_finite_leave_out_their_corners_alone(tmp_path, what, number, colour):
    two_squares(tmp_path, colour=colour, **{what: f"{what} {number} 0{' 0' if what == 'v' else ''}"})
    whole = open_document(str(tmp_path / "in.obj")).textured("baseColor")
    assert (whole.texture_of >= 0).sum() == 2
    assert np.isfinite(whole.positions).all()
    assert np.isfinite(whole.uv).all()
    said = smoothed(tmp_path)
    causes = ("1 of 5 vertices have no finite position", "1 triangles of textured materials have no")
    assert any(cause in said for cause in causes)
    smooth_file(tmp_path / "in.obj", tmp_path / "o.glb", ONCE)
    if colour:
        smoothed(tmp_path, on="vertices")
