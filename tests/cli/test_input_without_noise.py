"""What has no noise is left as it is, to the last byte, and that is said."""

import re

import numpy as np
import pytest

from cli.commands import SAMPLES, beltrami, colours_in
from formats.image_files import encode
from small_models import textured_squares


@pytest.fixture
def square(tmp_path):
    """Make a square that shows the middle of a JPEG picture, whose edges a gutter would change."""
    folder = tmp_path / "source"
    folder.mkdir()
    pixels = np.full((64, 64, 3), 60, np.uint8)
    pixels[:, 32:] = 200
    (folder / "square.jpg").write_bytes(encode(pixels, "jpeg", compression="jpeg:80"))
    return textured_squares(folder / "square.obj", ("square.jpg", 0, (0.3, 0.7)))


def test_a_mesh_at_one_place_is_said_to_have_no_area(tmp_path):
    colours = np.random.default_rng(2).random((30, 3)).round(3).tolist()
    lines = [f"v 1 2 3 {' '.join(map(str, colour))}" for colour in colours]
    lines += [f"f {i} {i + 1} {i + 2}" for i in range(1, 29)]
    (tmp_path / "point.obj").write_text("\n".join(lines) + "\n")
    run = beltrami("smooth", tmp_path / "point.obj", tmp_path / "out.obj", text=True)
    assert run.stderr.endswith("30 vertices, no face has an area, so the colours are left as they are\n")
    assert (tmp_path / "out.obj").read_bytes() == (tmp_path / "point.obj").read_bytes()
    shown = beltrami("info", tmp_path / "point.obj", text=True).stdout
    assert "nothing to smooth: no face has an area\n" in shown


@pytest.mark.parametrize("name", ["other.obj", "square.obj"])
def test_beside_the_source_no_files_pile_up(name, square):
    before = {path.name: path.read_bytes() for path in square.parent.iterdir()}
    for _ in range(2):
        beltrami("smooth", square, square.with_name(name), "--overwrite")
    after = {path.name: path.read_bytes() for path in square.parent.iterdir()}
    assert after == before | {name: before["square.obj"]}


@pytest.mark.parametrize(
    "name",
    [
        "nonmanifold-clean.ply",
        pytest.param("tiled-clean.glb", marks=pytest.mark.slow),
        pytest.param("torus-two-clean-dough.png", marks=pytest.mark.slow),
    ],
)
def test_a_clean_file_comes_out_as_it_was_and_the_report_says_why(name, tmp_path):
    result, report = tmp_path / name, tmp_path / "report.json"
    run = beltrami("smooth", SAMPLES / name, result, "--report", report)
    assert re.search(rb"left as (they are|it is)", run.stderr)
    assert result.read_bytes() == (SAMPLES / name).read_bytes()
    done = colours_in(report)
    assert done["iterations"] == 0


@pytest.mark.slow
def test_the_table_of_a_batch_and_info_say_it_too(tmp_path):
    common = "batch", SAMPLES / "head-clean.ply", "-j", 1, "--out-dir"
    assert b"left as it is" in beltrami(*common, "out", cwd=tmp_path).stderr
    assert b"left as it is" not in beltrami(*common, "given", "-n", 0, cwd=tmp_path).stderr
    assert b"nothing to smooth" in beltrami("info", SAMPLES / "head-clean.ply").stdout


def test_where_there_are_no_samples_no_strength_is_advised(tmp_path):
    pixels = np.full((8, 8, 4), 90, np.uint8)
    pixels[..., 3] = 0
    (tmp_path / "a.png").write_bytes(encode(pixels, "png"))
    run = beltrami("smooth", tmp_path / "a.png", tmp_path / "b.png", "--strength", "strong")
    assert b"a.png has no pixel but holes, so nothing was changed; --alpha smooth takes" in run.stderr
    assert b"left as they are" in run.stderr
    shown = beltrami("info", tmp_path / "a.png").stdout
    assert b"nothing to smooth: there are no samples" in shown
    assert b"--strength" not in run.stderr + shown


def test_iterations_that_are_asked_for_are_run_all_the_same(square, tmp_path):
    result, report = tmp_path / "result.obj", tmp_path / "report.json"
    beltrami("smooth", square, result, "-n", 2, "-t", 1, "--beta", 0, "--report", report)
    assert colours_in(report)["iterations"] == 2
    assert (tmp_path / "result.jpg").read_bytes() != (square.parent / "square.jpg").read_bytes()
