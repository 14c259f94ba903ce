"""Results: data on standard output and messages on standard error, through a pipe as to a file, nothing replaced."""

import dataclasses
import json
import re
import shutil
import stat

import pytest

import beltrami_cli
from cli.commands import SAMPLES, beltrami, refused
from formats.volume_files import sphere_file

NOISY, TEXTURED = SAMPLES / "nonmanifold-noisy.ply", SAMPLES / "tiled-clean.glb"
# What each command needs to write a file, without its name.
WRITERS = {
    "smooth": ("smooth", NOISY, "out.ply", "--fast"), "noise": ("noise", NOISY, "out.ply", "--sigma", 5),
    "level": ("level", TEXTURED, "out.glb"),
    "bake": ("bake", NOISY, "out.ply", "--to", "texture", "--size", 64),
    "kernel": ("kernel", NOISY, "out.csv", "--at", 100, "--fast"),
    "render": ("render", NOISY, "out.png", "--size", 30), "report": ("report", NOISY, NOISY, "out.html"),
    "sweep": ("sweep", NOISY, "out.csv", "--format", "csv", "-n", 1, "--fast"),
    "map": ("compare", NOISY, NOISY, "--map", "out.ply"),
    "junit": ("compare", NOISY, NOISY, "--min-psnr", 20, "--junit", "out.xml"),
    "blender-extension": ("blender-extension", "out.zip"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRITERS)
def test_an_existing_output_is_kept_unless_overwriting_is_asked_for(name, tmp_path):
    if name == "render":
        pytest.importorskip("embreex")
    words = WRITERS[name]
    (target,) = (tmp_path / word for word in map(str, words) if word.startswith("out."))
    target.write_text("precious")
    target.chmod(0o640)
    refused(tmp_path, *words, code=4, said="exists already")
    beltrami(*words, "--overwrite", cwd=tmp_path)
    assert target.read_bytes() != b"precious"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    made = {path.name for path in tmp_path.iterdir()}
    # Its own sidecar files are replaced, under the names that they have.
    beltrami(*words, "--overwrite", cwd=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == made


@pytest.fixture(scope="module")
def volume(tmp_path_factory):
    return sphere_file(tmp_path_factory.mktemp("volume"), 0.3)


@pytest.mark.parametrize(
    ("words", "source", "target"),
    [
        ("smooth {} {} --fast", NOISY, "out.ply"),
        ("smooth {} {} --fast", NOISY.with_suffix(".glb"), "out.glb"),
        ("smooth {} {} --fast", NOISY.with_suffix(".glb"), "avatar.vrm"),
        ("smooth {} {} --fast --format ply", SAMPLES / "terrain-noisy.glb", "out"),
        ("smooth {} {} --fast", SAMPLES / "torus-two-noisy-dough.png", "out.png"),
        ("smooth {} {} --fast --format exr", SAMPLES / "torus-two-noisy-dough.png", "out"),
        ("smooth {} {} --fast", "volume", "out.ply"),
        ("kernel {} {} --at 100 --fast", NOISY, "out.csv"),
        ("noise {} {} --sigma 5", NOISY, "out.ply"),
        ("render {} {} --size 40 --lit --background transparent", NOISY, "out.png"),
    ],
)
def test_a_pipe_carries_the_bytes_of_the_file_and_no_message(words, source, target, volume, tmp_path):
    if words.startswith("render"):
        pytest.importorskip("embreex")
    source = volume if source == "volume" else source
    to_file = beltrami(*words.format(source, target).split(), cwd=tmp_path)
    assert to_file.stdout == b""
    piped = beltrami(*words.format("-", "-").split(), "-q", stdin=source.read_bytes(), cwd=tmp_path)
    assert piped.stdout == (tmp_path / target).read_bytes()
    assert piped.stderr == b""


@pytest.mark.parametrize("overwritten", ["itself", "link"])
def test_a_file_is_smoothed_in_place_and_a_link_stays(overwritten, tmp_path):
    scan, link = tmp_path / "scan.ply", tmp_path / "link.ply"
    shutil.copy(NOISY, scan)
    link.symlink_to(scan)
    beltrami("smooth", scan, tmp_path / "out.ply", "--fast")
    beltrami("smooth", scan, link if overwritten == "link" else scan, "--overwrite", "--fast")
    assert link.is_symlink()
    assert scan.read_bytes() == (tmp_path / "out.ply").read_bytes()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("terrain-noisy.ply", ()),
        ("mirrored-noisy.obj", ()),
        ("mirrored-noisy.obj", ("--level",)),
        ("nonmanifold-noisy.obj", ("--unwrap", "--texture-size", "64")),
    ],
)
def test_a_dry_run_reports_and_writes_nothing(name, options, tmp_path):
    report, out = tmp_path / "report.json", (tmp_path / name).with_stem("out")
    words = ("--dry-run", "-n", 1, "--fast", *options, "--report", report)
    run = beltrami("smooth", SAMPLES / name, out, *words)
    assert re.search(rb"peak memory: [1-9][0-9.]*M\n", run.stderr)
    results = [line for line in run.stderr.decode().splitlines() if line.startswith(f"{out}: ")]
    assert results
    assert all("not written (dry run)" in line for line in results)
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    assert json.loads(report.read_text())["written"] == []


RECORDS = {
    "smooth": "SmoothReport", "level": "LevelFileReport", "bake": "BakeReport", "noise": "NoiseReport",
    "compare": "Comparison", "check": "CheckReport",
}  # fmt: skip
CALLS = {**WRITERS, "compare": ("compare", NOISY, NOISY), "check": ("check", NOISY, NOISY)}


@pytest.mark.parametrize("name", RECORDS)
def test_json_has_the_documented_keys_and_nothing_else_is_printed_with_it(name, tmp_path):
    record = getattr(beltrami_cli, RECORDS[name])
    run = beltrami(*CALLS[name], "--json", cwd=tmp_path, text=True)
    printed = json.loads(run.stdout)
    assert {field.name for field in dataclasses.fields(record)} <= set(printed)
    described = record.__doc__ + beltrami_cli.SmoothReport.__doc__ * ("SmoothReport" in record.__doc__)
    assert [
        key for key in printed if not re.search(rf"^    (?:\w+, )*{key}\b", described, re.MULTILINE)
    ] == []


@pytest.mark.parametrize("name", ["smooth", "level", "bake", "noise"])
def test_the_report_is_the_same_in_a_file_and_printed(name, tmp_path):
    run = beltrami(*WRITERS[name], "--report", "run.json", "--json", cwd=tmp_path, text=True)
    assert run.stdout == (tmp_path / "run.json").read_text()
    dashed = beltrami(*WRITERS[name], "--report", "-", "--overwrite", "-q", cwd=tmp_path, text=True)
    assert json.loads(dashed.stdout).keys() == json.loads(run.stdout).keys()
    assert dashed.stderr == ""
