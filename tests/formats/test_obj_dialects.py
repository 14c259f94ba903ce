"""Dialects of OBJ and MTL files as programs write them: each is read, and nothing but colours comes out changed."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beltrami_cli.errors import InputError
from beltrami_cli.flow.parameters import KernelParameters
from beltrami_cli.formats.document import Naming
from beltrami_cli.formats.obj.document import ObjDocument
from beltrami_cli.formats.registry import open_document
from beltrami_cli.jobs.inspect import check_files
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.layers.settings import SmoothSettings
from cli.commands import beltrami
from formats.image_files import encode
from hostile.folders import snapshot
from hostile.textured_models import OTHER, PICTURE

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
EVERYTHING = (
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
    (folder / "model.obj").write_bytes(EVERYTHING.replace("\n", newline).encode())
    (folder / "first one.mtl").write_bytes(FIRST.replace("\n", newline).encode())
    (folder / "second.mtl").write_bytes(SECOND.encode())
    for name, image in {"red brick": PICTURE, "slate": OTHER, "normal": OTHER}.items():
        (folder / "maps" / f"{name}.png").write_bytes(image)
    return folder / "model.obj"


@pytest.mark.slow
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_all_dialects_together_in_another_folder(newline, tmp_path):
    model = write_everything(tmp_path / "in", newline)
    (tmp_path / "out").mkdir()
    report = smooth_file(model, tmp_path / "out" / "clean.obj")
    before, after = snapshot(tmp_path / "in"), snapshot(tmp_path / "out")
    assert len(after) == len(before)
    assert all("clean" in path for path in after if path != "maps")
    differences = check_files(model, tmp_path / "out" / "clean.obj").differences
    assert all(difference.of_colour for difference in differences)
    changed = {difference.detail.partition(":")[0] for difference in differences}
    assert changed == {
        "maps\\red brick.png, now maps\\clean_red brick.png",
        "maps/slate.png, now maps/clean_slate.png",
    }
    assert [t["name"] for slot in report.textures for t in slot.textures] == ["red brick.png", "slate.png"]
    assert any("'gone.mtl' is missing" in warning for warning in report.warnings)
    assert any("1 triangles of textured materials have no texture coordinates" in w for w in report.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_all_dialects_together_beside_the_source(newline, tmp_path):
    model = write_everything(tmp_path, newline)
    before = snapshot(tmp_path)
    smooth_file(model, tmp_path / "clean.obj")
    after = snapshot(tmp_path)
    assert {path: after[path] for path in before} == before
    new = sorted(set(after) - set(before))
    assert new == [
        "clean-2.mtl",
        "clean.mtl",
        "clean.obj",
        "maps/clean_red brick.png",
        "maps/clean_slate.png",
    ]

    def text(name):
        return after[name][1]

    assert text("clean.obj") == before["model.obj"][1].replace(
        b"first one.mtl second.mtl", b"clean.mtl clean-2.mtl"
    )
    assert text("clean.mtl") == before["first one.mtl"][1].replace(
        b"maps\\red brick", b"maps\\clean_red brick"
    )
    assert text("clean-2.mtl") == before["second.mtl"][1].replace(b"slate.png", b"clean_slate.png")
    assert open_document(str(tmp_path / "clean.obj")).textured("baseColor").textures[0].data == text(
        "maps/clean_red brick.png"
    )


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ("", "a.png"),
        ("-s 2 3 1 -o 0.5 -.25 0", "a.png"),
        ("-s 2", "a.png"),
        ("-o .5 1e-3", "7.png"),
        ("-t 1 1 1", "a b.png"),
        ("-clamp off -blendu on -cc off -boost 1.5 -texres 64 -imfchan l -mm 0 1 -bm -2", "a -s b.png"),
        ("-type sphere", "a.png"),
        ("-s none -o -1e", "a.png"),
    ],
)
def test_options_before_the_name_of_a_map(options, name, tmp_path):
    (tmp_path / name).write_bytes(PICTURE)
    (tmp_path / "m.mtl").write_text(f"newmtl m\nmap_Kd {options} {name}\n")
    (tmp_path / "x.obj").write_text(f"mtllib m.mtl\n{SQUARE}{CORNERS}usemtl m\nf 1/1 2/2 3/3 4/4\n")
    (texture,) = open_document(str(tmp_path / "x.obj")).textured("baseColor").textures
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
    for name, image in {"a": PICTURE, "b": OTHER}.items():
        (tmp_path / f"{name}.png").write_bytes(image)
        (tmp_path / f"{name}.mtl").write_text(f"newmtl m\nmap_Kd {name}.png\n")
    (tmp_path / "x.obj").write_text(f"mtllib a.mtl\nmtllib b.mtl\n{SQUARE}{CORNERS}usemtl m\nf 1/1 2/2 3/3\n")
    (texture,) = open_document(str(tmp_path / "x.obj")).textured("baseColor").textures
    assert texture.data == PICTURE


def test_without_its_library_a_file_with_colours_is_smoothed_all_the_same(tmp_path):
    lines = [f"{line} {i / 4} 0 1" for i, line in enumerate(SQUARE.splitlines())]
    model = tmp_path / "x.obj"
    model.write_text("\n".join(["mtllib gone.mtl", *lines, "usemtl m", "f 1 2 3 4"]))
    settings = SmoothSettings(KernelParameters(beta=1, iterations=2))
    report = smooth_file(model, tmp_path / "y.obj", settings)
    assert any("'gone.mtl' is missing" in warning for warning in report.warnings)
    colours = re.compile(rb"^(v \S+ \S+ \S+).*$", re.MULTILINE)
    after = (tmp_path / "y.obj").read_bytes()
    assert colours.sub(rb"\1", after) == colours.sub(rb"\1", model.read_bytes())
    assert after != model.read_bytes()


PAINTED = (
    SQUARE
    + "# The following block is polypaint\n#MRGB ff102030FFaAbBcC\n#MRGB 00000000ff7f80ff\n# End\nf 1 2 3 4\n"
)


def test_polypaint_is_read_entry_by_entry():
    document = ObjDocument(PAINTED.encode(), "x.obj", None)
    levels = [[0x10, 0x20, 0x30], [0xAA, 0xBB, 0xCC], [0, 0, 0], [0x7F, 0x80, 0xFF]]
    painted = document.painted()
    np.testing.assert_array_equal(np.rint(painted.colours * 255), levels)
    assert (painted.stored, len(painted.faces)) == ("uint8", 2)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_polypaint_keeps_masks_and_every_byte_that_is_no_changed_colour(data):
    count = data.draw(st.integers(3, 140))
    levels = np.random.default_rng(count).integers(0, 256, (count, 4), np.uint8)
    style = data.draw(st.sampled_from(["{:02x}", "{:02X}"]))
    newline = data.draw(st.sampled_from(["\n", "\r\n"]))
    entries = ["".join(style.format(value) for value in row) for row in levels.tolist()]
    blocks = [f"#MRGB {''.join(entries[first : first + 64])}" for first in range(0, count, 64)]
    lines = [*(f"v 0 0 {i}" for i in range(count)), *blocks, "f 1 2 3", ""]
    source = newline.join(lines).encode()
    document = ObjDocument(source, "x.obj", None)
    new = levels[:, 1:] / np.float32(255)
    rows = data.draw(st.lists(st.integers(0, count - 1), max_size=5))
    new[rows] = np.random.default_rng(1).random((len(rows), 3), np.float32)
    written = b"".join(document.patch(new.astype(np.float32), Naming("out")).main)
    kept = {(i, c) for i in range(count) for c in range(4) if c == 0 or i not in rows}
    again = np.array(
        [
            list(bytes.fromhex(entry))
            for block in re.findall(rb"#MRGB (\w+)", written)
            for entry in re.findall("........", block.decode())
        ],
        np.uint8,
    )
    np.testing.assert_array_equal(again[:, 1:], np.rint(new * 255))
    assert all(again[i, c] == levels[i, c] for i, c in kept)
    assert re.sub(rb"#MRGB \w+", b"", written) == re.sub(rb"#MRGB \w+", b"", source)
    if not rows:
        assert written == source


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("#MRGB ffffffff\n", "there are 1 colours in its #MRGB lines, but 4 vertices"),
        ("#MRGB " + "ffffffff" * 3 + "fffffff\n", "line 5: its #MRGB colours"),
        ("#MRGB " + "ffffffff" * 3 + "fffffffg\n", "line 5: its #MRGB colours"),
        ("#MRGB \n", "0 colours"),
    ],
)
def test_damaged_polypaint_is_refused(lines, message):
    with pytest.raises(InputError, match=re.escape(message)):
        ObjDocument((SQUARE + lines).encode(), "x.obj", None).painted()


def test_colours_of_vertices_go_before_polypaint_which_stays_and_is_mentioned():
    source = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n#MRGB ff000000ff000000ff000000\nf 1 2 3\n"
    document = ObjDocument(source.encode(), "x.obj", None)
    written = b"".join(document.patch(document.painted().colours * np.float32(0.5), Naming("out")).main)
    assert b"#MRGB ff000000ff000000ff000000\n" in written
    assert any("#MRGB" in notice for notice in document.notices)


def two_squares(folder, mtl=b"newmtl m\nmap_Kd t.png\n", v="v 3 0 0", vt="vt 1 1", colour=""):
    """A textured square, and another one that has a corner and coordinates of its own."""
    square = "".join(f"{line}{colour}\n" for line in SQUARE.splitlines())
    faces = "usemtl m\nf 1/1 2/2 3/3 4/4\nf 2/2 5/5 3/3\n"
    (folder / "in.obj").write_text(f"mtllib in.mtl\n{square}{v}{colour}\n{CORNERS}{vt}\n{faces}")
    (folder / "in.mtl").write_bytes(mtl)
    pixels = np.rint(120 + 20 * np.random.default_rng(5).standard_normal((24, 24, 3))).astype(np.uint8)
    (folder / "t.png").write_bytes(encode(pixels, "png"))
    return folder / "t.png"


def smoothed(folder, *options):
    run = beltrami(
        "smooth", "in.obj", "out.obj", "--noise", 20, "--overwrite", *options, cwd=folder, text=True
    )
    beltrami("check", "in.obj", "out.obj", cwd=folder)
    return run.stderr


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
    run = beltrami("smooth", "in.obj", f"{place}/out.obj", "--noise", 20, cwd=tmp_path, text=True)
    assert f"'{name}' is not followed; 't.png' in the model's folder is taken" in run.stderr
    assert (tmp_path / place / "out.mtl").read_text() == "newmtl m\nmap_Kd out_t.png\n"
    beltrami("check", "in.obj", f"{place}/out.obj", cwd=tmp_path)


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
    assert (
        "1 of 5 vertices have no finite position" in said
        or "1 triangles of textured materials have no" in said
    )
    beltrami("smooth", "in.obj", "o.glb", "--noise", 20, cwd=tmp_path)
    if colour:
        smoothed(tmp_path, "--on", "vertices")
