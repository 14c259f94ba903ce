"""What people try in their first hour: other names for things, folders, and commands that nearly fit."""

from __future__ import annotations

import json
import re
import shutil

import pytest

from cli.commands import SAMPLES, beltrami, refused

MODEL, TEXTURED = SAMPLES / "nonmanifold-noisy.ply", SAMPLES / "torus-two-noisy.gltf"


def test_denoise_is_smooth(tmp_path):
    for command in ("smooth", "denoise"):
        beltrami(command, MODEL, tmp_path / f"{command}.ply", "-n", 1, "--beta", 5, "--fast")
    assert (tmp_path / "smooth.ply").read_bytes() == (tmp_path / "denoise.ply").read_bytes()


def test_denoise_obeys_what_is_configured_for_smooth(tmp_path):
    (tmp_path / "beltrami.toml").write_text("[smooth]\nn = 0\n")
    beltrami("--config", tmp_path / "beltrami.toml", "denoise", MODEL, tmp_path / "same.ply")
    assert (tmp_path / "same.ply").read_bytes() == MODEL.read_bytes()


@pytest.mark.parametrize("name", ["basecolor", "Base_Color", "base-color", "diffuse", "ALBEDO", "all"])
def test_slots_have_many_names(name, tmp_path):
    report = tmp_path / "report.json"
    beltrami(
        "smooth",
        TEXTURED,
        tmp_path / "o.gltf",
        "--slots",
        name,
        "-n",
        1,
        "--beta",
        5,
        "--report",
        report,
        "--fast",
    )
    assert [each["slot"] for each in json.loads(report.read_text())["textures"]] == ["baseColor"]


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (
            ["smooth", TEXTURED, "o.gltf", "--slots", "normal"],
            3,
            r"it has no normal textures, but baseColor textures",
        ),
        (
            ["smooth", MODEL, "o.ply", "--slots", "normal"],
            3,
            r"it has no normal textures, but no textures at all",
        ),
        (["smooth", MODEL, "picture.png"], 2, r"beltrami render .*picture\.png draws it"),
        (["smooth", "frames", "out"], 3, r"it is a folder; .*beltrami batch frames --out-dir OUT"),
        (["batch", "frames", "--out-dir", "out"], 3, r"images and no model.*'frames/\*\.png'"),
        (["noise", MODEL, "o.ply", "--sigma", 300], 2, r"beltrami: --sigma is 300"),
    ],
)
def test_errors_say_what_does_it(words, code, said, tmp_path):
    (tmp_path / "frames").mkdir()
    shutil.copy(SAMPLES / "head-tex-clean.png", tmp_path / "frames" / "1.png")
    line = refused(tmp_path, *words, code=code)
    assert re.search(said, line), line


def test_a_conversion_is_called_one(tmp_path):
    done = beltrami("smooth", MODEL, tmp_path / "o.obj", "-n", 0, text=True)
    assert "converted to obj" in done.stderr


def test_check_counts_what_is_on_the_surface_and_around_charts(tmp_path):
    beltrami("smooth", TEXTURED, tmp_path / "o.gltf", "-n", 1, "--beta", 5, "--gutter", "keep", "--fast")
    lines = beltrami("check", TEXTURED, tmp_path / "o.gltf", text=True).stdout.splitlines()
    assert sum("on the surface" in line for line in lines) == 2
    assert all("around charts none of" in line for line in lines if "on the surface" in line)


def test_batch_reports_a_failure_once(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "bad.ply").write_text("no model")
    done = beltrami("batch", tmp_path / "in", "--out-dir", tmp_path / "out", code=1, text=True)
    assert done.stderr.count("the content is of no known format") == 1
