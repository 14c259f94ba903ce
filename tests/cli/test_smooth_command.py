"""`beltrami smooth` as a good citizen: streams, exit codes, and files that are whole or not there."""

import json
import re

import numpy as np
import pytest

from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.registry import open_document
from cli.commands import SAMPLES, beltrami, colours_in
from formats.image_files import encode
from oracles.surfaces import icosphere
from small_models import COLOURED, ply, textured_squares

NOISY = SAMPLES / "terrain-noisy.ply"


def colours(path):
    return open_document(str(path)).coloured_vertices().colours


@pytest.mark.slow
@pytest.mark.parametrize("space", ["linear", "oklab"])
def test_noise_goes_in_spaces_that_are_not_that_of_the_file(space, tmp_path):
    beltrami("smooth", NOISY, tmp_path / "out.ply", "--space", space)
    truth = colours(SAMPLES / "terrain-clean.ply")
    before, after = (np.mean((colours(path) - truth) ** 2) for path in (NOISY, tmp_path / "out.ply"))
    assert after < before / 4


def test_the_report_holds_parameters_counts_times_memory_and_changes(tmp_path):
    report = tmp_path / "report.json"
    beltrami("smooth", NOISY, tmp_path / "out.ply", "-n", 2, "--fast", "--report", report)
    reported = json.loads(report.read_text())
    assert reported["parameters"]["iterations"] == 2
    assert reported["parameters"]["beta"] is None
    vertices = reported["vertices"]
    assert vertices["beta"] > 0
    assert vertices["counts"]["samples"] == vertices["counts"]["vertices"]
    assert set(reported["stages"]) == {"read", "smooth", "write"}
    assert reported["peak_memory"] > 1e6
    before, after = colours(NOISY), colours(tmp_path / "out.ply")
    # The report is made before the colours are rounded to 8 bit, which moves each by half a level at most.
    assert abs(vertices["change"]["mean"] - np.abs(after - before).mean()) < 0.5 / 255
    assert reported["written"] == [str(tmp_path / "out.ply")]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["one pixel", "one vertex", "three black vertices"])
@pytest.mark.parametrize("options", [(), ("--strength", "strong", "--patches", "on", "-n", 3)])
def test_what_is_too_small_for_an_estimate_is_no_error_and_has_no_figures(kind, options, tmp_path):
    source, report = tmp_path / f"in.{'png' if 'pixel' in kind else 'ply'}", tmp_path / "run.json"
    places = [(0, 0, 0), (1, 0, 0), (0, 1, 0)][: 3 if "three" in kind else 1]
    shade = [0 if "black" in kind else 90] * 3
    if "pixel" in kind:
        source.write_bytes(encode(np.uint8([[shade]]), "png"))
    else:
        source.write_bytes(ply(COLOURED, [[*place, *shade] for place in places]))
    words = ("--noise", 15, *options)
    done = beltrami("smooth", source, tmp_path / f"out{source.suffix}", *words, "--report", report, text=True)
    assert "Warning" not in done.stderr
    assert not re.search("Infinity|NaN", report.read_text())
    if not options:
        assert re.search(r"noise 15.0/255, (which smoothing would not reduce|but no colour)", done.stderr)
    assert "None" not in beltrami("info", source, *words, text=True).stdout


def test_the_guard_on_samples_warns_when_it_bites(tmp_path):
    run = beltrami("smooth", NOISY, tmp_path / "out.ply", "--max-samples", 5, "--fast")
    assert b"warning" in run.stderr
    assert b"--max-samples" in run.stderr


@pytest.mark.parametrize("source", ["a.jpg", "a.webp", "model.obj"])
def test_an_image_kept_as_coding_it_again_would_be_worse_has_no_change(source, tmp_path):
    noise = np.random.default_rng(0).normal(0, 8, (64, 64, 3))
    pixels = np.rint(120 + 60 * np.sin(np.arange(64))[:, None] + noise).clip(0, 255).astype(np.uint8)
    for name, known in (("a.jpg", "jpeg"), ("a.webp", "webp")):
        (tmp_path / name).write_bytes(encode(pixels, known, compression=f"{known}:95"))
    textured_squares(tmp_path / "model.obj", ("a.jpg", 0, (0.0, 1.0)))
    target, report = tmp_path / "out" / source, tmp_path / "report.json"
    target.parent.mkdir()
    # The coarsest steps of JPEG, many times as large as the noise.
    options = ("-n", 1, "--jpeg-quality", 1, "--report", report)
    run = beltrami("smooth", tmp_path / source, target, *options, text=True)
    assert " stays as it is: " in run.stderr
    assert colours_in(report)["change"] == {"mean": 0, "rms": 0, "largest": 0}
    (image,) = (path for path in target.parent.iterdir() if path.suffix in (".jpg", ".webp"))
    assert image.read_bytes() == (tmp_path / f"a{image.suffix}").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "options"), [("intensity", ()), ("quality", ("--channels", "quality"))])
def test_a_scalar_of_a_mesh_is_smoothed_alike_in_any_unit_and_nothing_else_changes(name, options, tmp_path):
    positions, faces = icosphere(4)
    clean = 2.5 + np.sin(3 * positions[:, 0]) * positions[:, 1]
    noisy = clean + 0.2 * np.random.default_rng(0).standard_normal(len(clean))
    results = []
    for unit in (1, 1024):  # a power of two, so that no digit is rounded
        source, target = tmp_path / f"{unit}.ply", tmp_path / f"{unit}-out.ply"
        rows = np.column_stack([positions, unit * noisy, noisy]).tolist()
        layout = f"float x y z {name} label"
        source.write_bytes(ply(layout, rows, faces.tolist(), "binary_little_endian"))
        beltrami("smooth", source, target, "--fast", *options)
        assert beltrami("check", source, target, *options, text=True).stdout.endswith(
            "nothing else differs\n"
        )
        beltrami("compare", source, target, *options)
        facts = json.loads(beltrami("info", source, "--fast", "--json", *options).stdout)
        assert list(facts["noise"]) == [name]
        document = open_document(str(target), Access(channels=(name,)))
        vertices = document.coloured_vertices()
        results.append(vertices.colours[:, 0].astype(np.float64) * vertices.full_scale / unit)
    np.testing.assert_allclose(results[0], results[1], rtol=1e-6)
    assert np.sqrt(np.mean(np.square(results[0] - clean))) < 0.07  # of 0.2


def test_a_file_that_has_scalars_alone_says_how_to_name_one(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply("float x y z quality", np.eye(3, 4).tolist(), [[0, 1, 2]]))
    said = beltrami("smooth", "a.ply", "out.ply", cwd=tmp_path, code=3, text=True).stderr
    assert "x, y, z, quality" in said
    assert "--channels" in said


@pytest.mark.parametrize("mode", ["auto", "keep"])
def test_wrong_samples_are_counted_in_messages_reports_and_info(tmp_path, mode):
    source, peppered = SAMPLES / "torus-two-clean-dough.png", tmp_path / "peppered.png"
    beltrami("noise", source, peppered, "--kind", "salt-pepper", "--sigma", "3%")
    output, report, done = (
        tmp_path / "out.png",
        tmp_path / "report.json",
        {"auto": "replaced"}.get(mode, "kept"),
    )
    said = beltrami("smooth", peppered, output, "--outliers", mode, "--report", report, text=True).stderr
    found = json.loads(report.read_text())["image"]["wrong_samples"]
    assert found["replaced"] == (mode == "auto")
    words = f"{found['count']} wrong pixels ({100 * found['share']:.2g} %) {done}"
    assert words in said
    assert (
        words.replace("pixels", "samples") in beltrami("info", peppered, "--outliers", mode, text=True).stdout
    )
    assert (output.read_bytes() == peppered.read_bytes()) == (mode == "keep")
