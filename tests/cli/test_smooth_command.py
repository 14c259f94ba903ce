"""`beltrami smooth` as a good citizen: streams, exit codes, and files that are whole or not there."""

from __future__ import annotations

import json
import os
import pty
import re
import shutil
import signal
import stat
import subprocess
import time

import numpy as np
import pytest

from beltrami_cli.formats.registry import open_document
from cli.commands import COMMAND, SAMPLES, beltrami, interrupted, refused
from cli.pictures import painted_file
from formats.image_files import encode
from hostile.folders import snapshot
from oracles import surfaces
from small_models import COLOURED, ply, textured_squares

NOISY = SAMPLES / "terrain-noisy.ply"


def colours(path):
    return open_document(str(path)).painted().colours


def psnr(path, truth):
    return -10 * np.log10(np.mean((colours(path) - colours(truth)) ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nonmanifold.ply", "nonmanifold.obj", "nonmanifold.glb"])
def test_samples_come_out_visibly_cleaner_without_any_flag(name, tmp_path):
    noisy, clean = (SAMPLES / name.replace(".", f"-{which}.") for which in ("noisy", "clean"))
    result = tmp_path / name
    beltrami("smooth", noisy, result)
    assert psnr(result, clean) > psnr(noisy, clean) + 6


def test_stdout_carries_data_only_and_messages_go_to_stderr(tmp_path):
    to_file = beltrami("smooth", NOISY, tmp_path / "out.ply", "-v", "--fast")
    assert to_file.stdout == b""
    assert b"beta" in to_file.stderr
    assert beltrami("smooth", NOISY, tmp_path / "quiet.ply", "-q", "--fast").stderr == b""
    through_pipe = beltrami("smooth", "-", "-", "--fast", stdin=NOISY.read_bytes())
    assert through_pipe.stdout == (tmp_path / "out.ply").read_bytes()


@pytest.mark.slow
def test_glb_goes_through_a_pipe_and_the_format_can_be_chosen(tmp_path):
    glb = SAMPLES / "terrain-noisy.glb"
    piped = beltrami("smooth", "-", "-", "--fast", stdin=glb.read_bytes())
    assert piped.stdout[:4] == b"glTF"
    converted = beltrami("smooth", "-", "-", "--fast", "--format", "ply", stdin=glb.read_bytes())
    assert converted.stdout[:4] == b"ply\n"


def test_an_existing_output_is_kept_unless_overwriting_is_asked_for(tmp_path):
    result = tmp_path / "out.ply"
    result.write_text("precious")
    refused(tmp_path, "smooth", NOISY, result, code=4, said="--overwrite")
    result.chmod(0o640)
    beltrami("smooth", NOISY, result, "--overwrite", "--fast")
    assert stat.S_IMODE(result.stat().st_mode) == 0o640
    assert [path.name for path in tmp_path.iterdir()] == ["out.ply"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("out/there.ply", "out/there.ply: exists already; choose another name, or --overwrite"),
        ("out", "out: is a folder; name a file"),
        ("", "OUTPUT: its name is empty; name a file, or - for standard output"),
        ("none/x.ply", "none/x.ply: the folder none does not exist; make it first"),
        ("out/there.ply/x.ply", "out/there.ply/x.ply: out/there.ply is no folder; choose another place"),
        ("out/" + 300 * "x" + ".ply", ".ply: no file can be called so (File name too long)"),
    ],
)
def test_an_output_that_cannot_be_is_named_as_the_user_named_it(target, words, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "there.ply").write_bytes(b"kept")
    line = refused(tmp_path, "smooth", SAMPLES / "knot-noisy.ply", target, code=4, said=words)
    assert line.startswith(f"beltrami: {target[:20]}")


def test_a_file_may_be_smoothed_in_place_when_overwriting_is_asked_for(tmp_path):
    scan, result = tmp_path / "scan.ply", tmp_path / "out.ply"
    shutil.copy(NOISY, scan)
    beltrami("smooth", NOISY, result, "--fast")
    beltrami("smooth", scan, scan, "--overwrite", "--fast")
    assert scan.read_bytes() == result.read_bytes()


def test_a_link_stays_and_what_it_points_to_is_replaced(tmp_path):
    real, link = tmp_path / "real.ply", tmp_path / "link.ply"
    real.write_text("old")
    link.symlink_to(real)
    beltrami("smooth", NOISY, link, "--overwrite", "--fast")
    assert link.is_symlink()
    assert real.read_bytes()[:3] == b"ply"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["missing.ply", "out.ply"], 3, "missing.ply"),
        ([".", "out.ply"], 3, "it is a folder"),
        ([str(NOISY), "out.abc"], 2, ".abc"),
        ([str(NOISY), "out.ply", "-t", "0"], 2, "--time-step is 0"),
        ([str(NOISY), "out.ply", "--beta", "-1"], 2, "beta"),
        ([str(NOISY), "out.ply", "--beta", "nan"], 2, "beta"),
        ([str(NOISY), "out.ply", "--threshold", "1"], 2, "threshold"),
        ([str(NOISY), "out.ply", "--channels", "infrared"], 2, "infrared"),
        ([str(NOISY), "out.ply", "--channels", "r", "--space", "oklab"], 2, "oklab"),
        ([str(NOISY), "out.ply", "--bogus"], 2, "--bogus"),
        ([str(NOISY)], 2, "OUTPUT"),
        ([str(NOISY), "out.ply", "--report", "nowhere/r.json"], 4, "nowhere"),
        ([str(NOISY), "out.ply", "--report", "-"], 4, "standard output is for OUTPUT"),
        ([str(NOISY), "out.ply", "--report", "."], 4, "folder"),
    ],
)
def test_failures_exit_with_the_documented_code_one_line_and_no_traces(arguments, code, words, tmp_path):
    refused(tmp_path, "smooth", *arguments, code=code, said=words)


def test_a_fifo_is_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "scan.ply")
    run = beltrami("smooth", tmp_path / "scan.ply", tmp_path / "out.ply", code=3)
    assert b"pipe" in run.stderr


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("terrain-noisy.ply", ()),
        ("mirrored-noisy.obj", ()),
        ("nonmanifold-noisy.obj", ("--unwrap", "--texture-size", "64")),
    ],
)
def test_a_dry_run_reports_and_writes_nothing(name, options, tmp_path):
    report, out = tmp_path / "report.json", (tmp_path / name).with_stem("out")
    run = beltrami(
        "smooth", SAMPLES / name, out, "--dry-run", "-n", 1, "--fast", *options, "--report", report
    )
    assert re.search(rb"peak memory: [1-9][0-9.]*M\n", run.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    assert json.loads(report.read_text())["written"] == []


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
def test_noise_that_is_given_is_not_said_to_be_rounding_where_nothing_is_smoothed(tmp_path):
    (tmp_path / "one.png").write_bytes(encode(np.full((1, 1, 3), 100, np.uint8), "png"))
    done = beltrami("smooth", tmp_path / "one.png", tmp_path / "out.png", "--noise", 15, text=True)
    assert "noise 15.0/255, which smoothing would not reduce" in done.stderr
    assert "Warning" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("count", "colour"), [(1, 90), (3, 0)])
def test_noise_is_given_for_vertices_that_have_no_neighbours_or_hold_none(tmp_path, count, colour):
    places = [(0, 0, 0), (1, 0, 0), (0, 1, 0)][:count]
    (tmp_path / "in.ply").write_bytes(ply(COLOURED, [[*place, *[colour] * 3] for place in places]))
    report = tmp_path / "run.json"
    for options in ([], ["--strength", "strong", "--patches", "on", "-n", 3]):
        done = beltrami("smooth", tmp_path / "in.ply", tmp_path / "out.ply", "--noise", 15, "--report", report,
                        "--overwrite", *options, text=True)  # fmt: skip
        assert "Warning:" not in done.stderr
        assert not re.search("Infinity|NaN", report.read_text())


@pytest.mark.slow
def test_reports_of_one_sample_are_json_and_hold_no_estimate(tmp_path):
    (tmp_path / "one.png").write_bytes(encode(np.full((1, 1, 3), 100, np.uint8), "png"))
    report = tmp_path / "run.json"
    beltrami("smooth", tmp_path / "one.png", tmp_path / "out.png", "--noise", 15, "--report", report)
    assert not re.search("Infinity|NaN", report.read_text())
    printed = beltrami("info", tmp_path / "one.png", "--noise", 15, text=True).stdout
    assert "PSNR is undefined for a single sample" in printed


def test_the_guard_on_samples_warns_when_it_bites(tmp_path):
    run = beltrami("smooth", NOISY, tmp_path / "out.ply", "--max-samples", 5, "--fast")
    assert b"warning" in run.stderr
    assert b"--max-samples" in run.stderr


def test_channels_that_were_not_chosen_keep_their_bytes(tmp_path):
    beltrami("smooth", NOISY, tmp_path / "out.ply", "--channels", "g", "--fast")
    before, after = colours(NOISY), colours(tmp_path / "out.ply")
    assert np.array_equal(before[:, [0, 2]], after[:, [0, 2]])
    assert not np.array_equal(before[:, 1], after[:, 1])


@pytest.mark.slow
def test_spaces_differ_and_all_denoise(tmp_path):
    results = {}
    for space in ("srgb", "linear", "oklab"):
        beltrami("smooth", NOISY, tmp_path / f"{space}.ply", "--space", space)
        results[space] = colours(tmp_path / f"{space}.ply")
        assert psnr(tmp_path / f"{space}.ply", SAMPLES / "terrain-clean.ply") > 25
    assert not np.array_equal(results["srgb"], results["linear"])
    assert not np.array_equal(results["srgb"], results["oklab"])
    beltrami("smooth", NOISY, tmp_path / "data.ply", "--space", "data")
    assert np.array_equal(colours(tmp_path / "data.ply"), results["srgb"])  # PLY colours are sRGB already


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "number"),
    [("vertices", signal.SIGTERM), ("texture", signal.SIGINT)],
)
def test_an_interrupt_ends_soon_and_leaves_nothing_behind(kind, number, tmp_path):
    if kind == "vertices":
        positions, faces = surfaces.plane(700, 700)
        painted_file(tmp_path / "in.ply", positions, faces, np.random.default_rng(0).random(positions.shape))
        arguments = ["in.ply", "out.ply", "-n", "100", "--beta", "0", "-t", "8"]
    else:
        for path in SAMPLES.glob("mirrored-noisy.*"):
            shutil.copy(path, tmp_path)
        arguments = ["mirrored-noisy.obj", "out.obj", "-n", "2000"]
    before = snapshot(tmp_path)
    with subprocess.Popen([*COMMAND, "smooth", *arguments], cwd=tmp_path, stderr=subprocess.PIPE) as process:
        time.sleep(1.5)
        interrupted(process, number)
    assert snapshot(tmp_path) == before


@pytest.mark.slow
def test_the_bar_is_drawn_on_a_terminal_only(tmp_path):
    arguments = ["smooth", str(NOISY), str(tmp_path / "out.ply"), "-n", "60", "--overwrite"]
    assert b"\x1b" not in beltrami(*arguments).stderr
    controller, terminal = pty.openpty()
    with subprocess.Popen(
        [*COMMAND, *arguments], stderr=terminal, env={**os.environ, "TERM": "xterm"}
    ) as process:
        os.close(terminal)
        shown = b""
        while True:
            try:
                shown += os.read(controller, 4096)
            except OSError:
                break
    os.close(controller)
    assert process.returncode == 0
    assert b"\x1b" in shown
    assert b"%" in shown


def test_options_of_the_program_are_said_to_go_before_the_command():
    run = beltrami("smooth", "scan.ply", "clean.ply", "--config", "mine.toml", code=2)
    assert b"--config goes before the command: beltrami --config FILE smooth ...\n" in run.stderr
    assert b"-V goes before the command: beltrami -V\n" in beltrami("info", "scan.ply", "-V", code=2).stderr


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("smoth", b"Did you mean smooth?"),
        ("scan.ply", b"beltrami smooth scan.ply OUTPUT"),
        ("frob", b"'frob'.\n"),
    ],
)
def test_a_command_that_is_none_is_answered_with_those_like_it(word, said):
    run = beltrami(word, "clean.ply", code=2)
    assert said in run.stderr


@pytest.mark.slow
@pytest.mark.parametrize("option", ["-v", "--dry-run"])
def test_the_work_ahead_is_reported_before_it_starts(option, tmp_path):
    run = beltrami("smooth", SAMPLES / "knot-noisy.ply", tmp_path / "out.ply", option, text=True)
    said = run.stderr.splitlines()
    assert said[0].startswith("work: parameters are tried on ")
    assert "iterations, at most some" in said[1]
    again = beltrami("smooth", SAMPLES / "knot-noisy.ply", tmp_path / "again.ply", "--fast", text=True)
    assert "work:" not in again.stderr


@pytest.mark.parametrize("source", ["a.jpg", "a.webp", "model.obj"])
def test_an_image_kept_as_coding_it_again_would_be_worse_has_no_change(source, tmp_path):
    noise = np.random.default_rng(0).normal(0, 8, (64, 64, 3))
    pixels = np.rint(120 + 60 * np.sin(np.arange(64))[:, None] + noise).clip(0, 255).astype(np.uint8)
    for name, known in (("a.jpg", "jpeg"), ("a.webp", "webp")):
        (tmp_path / name).write_bytes(encode(pixels, known, compression=f"{known}:95"))
    textured_squares(tmp_path / "model.obj", ("a.jpg", 0, (0.0, 1.0)))
    target, report = tmp_path / "out" / source, tmp_path / "report.json"
    target.parent.mkdir()
    run = beltrami(
        "smooth", tmp_path / source, target, "-n", 1, "--jpeg-quality", 1, "--report", report, text=True
    )  # the coarsest steps of JPEG, many times as large as the noise
    written = json.loads(report.read_text())
    change = (written["image"] or written["textures"][0])["change"]
    assert " stays as it is: " in run.stderr
    assert "mean change 0.0/255" in run.stderr
    assert change == {"mean": 0, "rms": 0, "largest": 0}
    (image,) = (path for path in target.parent.iterdir() if path.suffix in (".jpg", ".webp"))
    assert image.read_bytes() == (tmp_path / f"a{image.suffix}").read_bytes()
