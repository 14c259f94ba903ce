"""Two models are compared in all that is coloured, and a notice names the rest."""

import json
import shutil

import numpy as np
import pytest

from beltrami_cli.errors import InputError
from beltrami_cli.jobs.compare.files import compare_files
from beltrami_cli.jobs.settings import Limits
from beltrami_cli.layers.settings import SmoothSettings
from cli.commands import SAMPLES, beltrami
from formats.image_files import encode

SLOTS = {"baseColor": "colour.png", "emissive": "glow.png", "normal": "bumps.png"}
PLACES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]


def write(folder, *, seed=0, other="", places=PLACES, without="", opacity=False):
    """Write a square with vertex colours and textures in three slots; one may differ, or be missing."""
    folder.mkdir()
    shade = 0.75 if other == "vertex colours" else 0.25
    vertices = [f"v {x} {y} {z} {shade} 0.5 0.5" for x, y, z in places]
    corners = ["vt 0 0", "vt 1 0", "vt 1 1", "vt 0 1", "usemtl m", "f 1/1 2/2 3/3", "f 1/1 3/3 4/4"]
    (folder / "m.obj").write_text("\n".join(["mtllib m.mtl", *vertices, *corners]) + "\n")
    maps = zip(("map_Kd", "map_Ke", "norm"), SLOTS.items(), strict=True)
    lines = [f"{keyword} {file}" for keyword, (slot, file) in maps if slot != without]
    (folder / "m.mtl").write_text("\n".join(["newmtl m", *lines]) + "\n")
    for number, (slot, file) in enumerate(SLOTS.items()):
        rng = np.random.default_rng([seed, number, slot == other])
        pixels = rng.integers(0, 256, (32, 32, 4 if opacity else 3), np.uint8)
        if opacity:
            pixels[..., 3] = 200 if other == "opacity" else 100
            pixels[..., :3] = 9
        (folder / file).write_bytes(encode(pixels, "png"))
    return folder / "m.obj"


@pytest.mark.parametrize("other", ["emissive", "normal", "vertex colours", "baseColor"])
def test_whatever_differs_is_found_and_held_to_the_limits(other, tmp_path):
    one, test = write(tmp_path / "a"), write(tmp_path / "b", other=other)
    compared = compare_files(one, test, Limits(min_psnr=60))
    broken = [verdict.part.split()[0] for verdict in compared.limits if not verdict.kept]
    assert broken == [other.split()[0]]
    assert compared.notices == []
    unequal = [part for part in compared.parts if not (part["identical"] or part["psnr"] is None)]
    assert [part["name"].split()[0] for part in unequal] == broken
    assert len(compared.parts) == 1 + len(SLOTS)
    beltrami("compare", one, test, "--min-psnr", 60, "-q", code=1)
    page = beltrami("report", one, test, tmp_path / "page.html")
    assert b"nothing differs" not in page.stderr
    assert b"are equal" not in page.stderr


@pytest.mark.parametrize(
    ("options", "compared", "left_out"),
    [
        ("--slots baseColor", ["baseColor colour.png"], "vertex colours, emissive textures, normal textures"),
        ("--on vertices", ["vertex colours"], "baseColor textures, emissive textures, normal textures"),
        ("--on both --slots emissive", ["vertex colours", "emissive glow.png"], "baseColor textures, normal textures"),
        ("--texture glow*", ["emissive glow.png"], "vertex colours, baseColor textures, normal textures, "),
    ],
)  # fmt: skip
def test_what_is_not_compared_is_said(options, compared, left_out, tmp_path):
    one, test = write(tmp_path / "a"), write(tmp_path / "b", seed=1)
    run = beltrami("compare", one, test, "--json", *options.split())
    assert [part["name"] for part in json.loads(run.stdout)["parts"]] == compared
    assert f"not compared: {left_out}".encode() in run.stderr


def unfit(kind, folder):
    """Write two files that cannot be compared, or not as asked; return the arguments."""
    if kind == "a slot in one file alone":
        return write(folder / "a"), write(folder / "b", without="normal")
    if kind == "a missing image":
        pair = write(folder / "a"), write(folder / "b")
        (pair[0].parent / SLOTS["emissive"]).unlink()
        return pair
    if kind == "Delta E of a normal map":
        return write(folder / "a"), write(folder / "b", other="normal"), Limits(max_delta_e=5)
    if kind == "other texture coordinates":
        pair = write(folder / "a"), write(folder / "b")
        pair[1].write_text(pair[1].read_text().replace("vt 1 1", "vt 0.9 1"))
        return pair
    if kind == "points elsewhere":
        places, colours = np.random.default_rng(1).random((2, 30, 3))
        for name, order in (("a", 1), ("b", -1)):
            np.savez(folder / f"{name}.npz", positions=places[::order], colours=colours)
        return folder / "a.npz", folder / "b.npz"
    if kind == "nothing that is seen":
        (folder / "a.png").write_bytes(encode(np.uint8([[[9, 9, 9, 0]]]), "png"))
        return folder / "a.png", folder / "a.png", Limits(min_psnr=30)
    (folder / "line.obj").write_text("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 2 0 0 0 0 1\nf 1 2 3\n")
    return folder / "line.obj", folder / "line.obj", Limits(min_psnr=99)


HEAD = SAMPLES / "head-clean.ply"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("a slot in one file alone", r"b.m\.obj: it has no normal textures.*choose what both have"),
        ("a missing image", "emissive"),
        ("Delta E of a normal map", r"normal bumps\.png: --max-delta-e cannot be tested"),
        ("other texture coordinates", "texture coordinates"),
        ("points elsewhere", "points are at other places"),
        ("nothing that is seen", "nothing of it can be compared"),
        ("no area", "no area"),
        ((HEAD, SAMPLES / "knot-clean.ply"), r"knot-clean.*coloured vertices.*head-clean"),
        ((SAMPLES / "head-tex-clean.obj", SAMPLES / "mirrored-clean.obj"), "mirrored-clean.*triangles"),
        ((SAMPLES / "head-tex-clean.png", SAMPLES / "mirrored-clean.png"), "mirrored-clean.*pixels"),
        ((HEAD, SAMPLES / "head-tex-clean.png"), "head-tex-clean.*an image"),
        # Vertices have no windows of pixels; numbers that are not colours, or two channels of some, have no Delta E.
        ((HEAD, HEAD, Limits(min_ssim=0.5)), "head-clean.*--min-ssim cannot be tested.*leave that limit out"),
        ((HEAD, HEAD, Limits(max_delta_e=50.0), SmoothSettings(space="data")), "--max-delta-e cannot be tested"),
        ((HEAD, HEAD, Limits(max_delta_e=50.0), SmoothSettings(channels=("red", "green"))), "--max-delta-e cannot"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_no_success(arguments, said, tmp_path):
    if isinstance(arguments, str):
        arguments = unfit(arguments, tmp_path)
    one, other, *more = arguments
    weights = "area" if said == "no area" else "uniform"
    with pytest.raises(InputError, match=said):
        compare_files(one, other, *more, weights=weights)
    with pytest.raises(InputError):
        compare_files(other, one, *more, weights=weights)


def test_a_slot_that_neither_can_be_read_in_is_left_out(tmp_path):
    pair = write(tmp_path / "a"), write(tmp_path / "b")
    for model in pair:
        (model.parent / SLOTS["emissive"]).unlink()
    compared = compare_files(*pair)
    assert not any("emissive" in part["name"] for part in compared.parts)
    assert len(compared.parts) == 3


@pytest.mark.parametrize("on", ["vertices", "texture"])
def test_vertices_that_moved_break_every_comparison_with_limits_but_their_own(on, tmp_path):
    moved = [(0, 0, 0), (1, 0, 0), (1, 1.002, 0), (0, 1, 0)]
    one, test = write(tmp_path / "a"), write(tmp_path / "b", places=moved)
    options = ("compare", one, test, "--on", on)
    said = beltrami(*options)
    assert b"moved by up to 0.198 %" in said.stderr  # the size counts the distance from the origin a little
    assert b"geometry: equal" not in said.stdout
    broken = beltrami(*options, "--min-psnr", 30, code=1)
    assert b"BROKEN  geometry: largest move" in broken.stdout
    beltrami(*options, "--min-psnr", 30, "--max-move", "0.5%")
    beltrami(*options, "--max-move", "0.001", code=1)
    assert b"nothing differs" not in beltrami("report", one, test, tmp_path / "page.html").stderr


def test_opacity_that_differs_is_said(tmp_path):
    one = write(tmp_path / "a", opacity=True)
    test = write(tmp_path / "b", opacity=True, other="opacity")
    assert any("opacity differs" in notice for notice in compare_files(one, test).notices)
    assert compare_files(one, one).notices == []
    images = one.parent / "colour.png", test.parent / "colour.png"
    assert any("opacity differs" in notice for notice in compare_files(*images).notices)


def test_textures_of_one_name_are_kept_apart(tmp_path):
    models = [write(tmp_path / name) for name in ("a", "b")]
    for model in models:
        text = model.read_text()
        model.write_text(f"{text}v 5 0 0 1 1 1\nusemtl n\nf 1/1 2/2 5/3\n")
        library = model.parent / "m.mtl"
        library.write_text("newmtl m\nmap_Kd one/skin.png\nnewmtl n\nmap_Kd two/skin.png\n")
        for folder in ("one", "two"):
            (model.parent / folder).mkdir()
            shutil.copy(model.parent / "colour.png", model.parent / folder / "skin.png")
    names = [part["name"] for part in compare_files(*models).parts]
    assert names == ["vertex colours", "baseColor one/skin.png", "baseColor two/skin.png"]
