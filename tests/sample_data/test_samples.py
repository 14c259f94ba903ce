"""The files are what the script makes, and what SOURCES.md claims about them is true."""

import sys

import pytest

import beltrami_cli
from cli.commands import SAMPLES
from formats.image_files import encode, stored

PLAIN = beltrami_cli.SmoothSettings(beltrami_cli.KernelParameters())  # in which nothing is chosen by the data


# 4 s: all samples are made.
@pytest.mark.slow
def test_the_files_are_what_the_script_makes(make, capsys):
    assert make.main(["--check"]) == 0, capsys.readouterr().err


@pytest.mark.slow
def test_check_reports_a_changed_and_a_missing_file_and_writes_nothing(make, capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(make, "TEXTURED", {})
    for name, data in make.files():
        (tmp_path / name).write_bytes(data)
    changed, missing = tmp_path / "knot-noisy.ply", tmp_path / "head-clean.obj"
    changed.write_bytes(changed.read_bytes()[:-1] + b"!")
    before = changed.read_bytes()
    missing.unlink()
    monkeypatch.setattr(make, "FOLDER", tmp_path)
    assert make.main(["--check"]) == 1
    assert capsys.readouterr().err.splitlines() == ["knot-noisy.ply: differs", "head-clean.obj: is missing"]
    assert changed.read_bytes() == before
    assert not missing.exists()


def test_check_looks_at_pixels_not_at_how_they_are_packed(make):
    clean, made = stored(SAMPLES / "mirrored-clean.png"), (SAMPLES / "mirrored-clean.png").read_bytes()
    for change, expected in ((0, True), (1, False)):
        clean[5, 7] += change
        again = encode(clean, "png", png__compressionLevel=1)
        assert again != made
        assert sys.modules["comparison"].same(again, made, ".png") is expected


def test_check_sees_what_changes_in_a_glb_besides_the_packing_of_its_images(make):
    same = sys.modules["comparison"].same
    data = (SAMPLES / "scan-clean.glb").read_bytes()
    start = 28 + int.from_bytes(data[12:16], "little")  # behind the heads and the JSON text
    assert same(data, data, ".glb")
    moved = bytearray(data)
    moved[start] ^= 1
    assert not same(bytes(moved), data, ".glb")
    assert not same(data[:1000], data, ".glb")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "triangles", "charts", "euler"),
    [
        ("knot-clean.ply", 10_368, None, 0),
        ("head-clean.ply", 13_520, None, 2),
        ("terrain-clean.ply", 4844, None, None),
        ("nonmanifold-clean.ply", 2594, None, None),
        ("head-tex-clean.glb", 3380, 24, 2),
        ("torus-two-clean.gltf", 3072, 2, 0),
        ("mirrored-clean.obj", 2880, 2, None),  # both halves on the same texels
        ("tiled-clean.glb", 3072, 1, None),
        ("sphere-exr-clean.obj", 2352, 6, 2),
        ("scan-clean.ply", 4010, 100, None),
    ],
)
def test_surfaces_are_as_stated(name, triangles, charts, euler):
    facts = beltrami_cli.inspect_file(SAMPLES / name, PLAIN)
    surface, is_special = facts["surface"], name.startswith("nonmanifold")
    assert surface["triangles"] == triangles
    assert (surface["boundary_edges"] == 0) == (euler is not None)
    vertices = surface["vertices"] - surface["coincident_vertices"]
    assert euler in (None, vertices - surface["edges"] + surface["triangles"])
    assert (surface["non_manifold_edges"] > 0) == (surface.get("hard_edge_samples", 0) > 0) == is_special
    for fault in ("duplicate_faces", "degenerate_faces", "isolated_vertices"):
        assert surface[fault] == is_special
    if charts is not None:
        (slot,) = facts["textures"]
        assert slot["charts"] == charts
        shared = slot["overlapped"] / slot["covered"]
        assert shared == (1 if name.startswith(("mirrored", "tiled")) else pytest.approx(0, abs=1e-3))
        # Paintings are continuous across seams: one chart half as bright would be found.
        assert not (slot["exposure"] or {}).get("is_exposure")


@pytest.mark.slow
def test_the_exposed_scan_has_exposure_steps():
    (slot,) = beltrami_cli.inspect_file(SAMPLES / "scan-exposed.glb", PLAIN)["textures"]
    assert slot["charts"] == 100
    assert slot["exposure"]["is_exposure"]


@pytest.mark.parametrize("kind", ["clean", "noisy"])
def test_glb_files_hold_the_same_images_as_the_files_beside_them(kind):
    for name, suffix in (("head-tex", ".png"), ("scan", ".jpg")):
        image = (SAMPLES / f"{name}-{kind}{suffix}").read_bytes()
        assert image in (SAMPLES / f"{name}-{kind}.glb").read_bytes()
