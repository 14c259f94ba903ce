"""All files of a run are put in place together or not at all; what they may replace, the command line says."""

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from batch.batches import without_workers
from beltrami_cli.cli.outputs import is_report
from beltrami_cli.formats.image.reading import read_image
from beltrami_cli.jobs.compare.maps import is_map
from beltrami_cli.view import before_after
from beltrami_cli.view.before_after import is_preview
from beltrami_cli.view.settings import RenderSettings
from cli.commands import SAMPLES, beltrami, copy_samples, refused
from formats.image_files import encode

NOISY = SAMPLES / "nonmanifold-noisy.ply"
PHOTO = SAMPLES / "mirrored-noisy.png"
QUICK = ("-n", "1", "--beta", "8", "--fast")
FULL = Path("/dev/full")


@pytest.fixture
def textured(tmp_path):
    """Return a folder with a model of three files."""
    return copy_samples(tmp_path / "textured", "mirrored-noisy*")


# With a preview 3 s, as it is drawn at its full size.
@pytest.mark.slow
@pytest.mark.skipif(not FULL.exists(), reason="there is no device that is always full")
@pytest.mark.parametrize(("option", "exists"), [("--report", False), ("--report", True), ("--preview", True)])
def test_what_cannot_be_written_leaves_output_as_it_was(option, exists, tmp_path):
    if exists:
        (tmp_path / "out.png").write_text("precious")
    link = tmp_path / "full.png"  # a preview needs a name with an extension
    link.symlink_to(FULL)
    line = refused(tmp_path, "smooth", PHOTO, "out.png", *QUICK, option, link, "--overwrite", code=4)
    assert "No space left" in line


SMOOTH = ("smooth", "mirrored-noisy.obj", "out.obj", *QUICK)
REPORTED = ("mirrored-noisy.obj", "mirrored-noisy.mtl", "mirrored-noisy.png", "out.obj", "out.mtl", "out.png")


@pytest.mark.parametrize(
    "arguments",
    [
        *((*SMOOTH, "--report", name) for name in REPORTED),
        *((*SMOOTH, "--preview", name) for name in ("mirrored-noisy.png", "out.png")),
        (*SMOOTH, "--report", "both.png", "--preview", "link/both.png"),
        ("smooth", "mirrored-noisy.png", "guide.png", *QUICK, "--guide", "guide.png"),
        ("compare", "a.ply", "b.ply", "--map", "b.ply"),
        ("compare", "mirrored-noisy.obj", "other/mirrored-noisy.obj", "--map", "other/mirrored-noisy.png"),
        ("kernel", "a.ply", "a.ply", "--at", "7"),
        ("render", "mirrored-noisy.png", "mirrored-noisy.png"),
        ("sweep", "a.ply", "sheet.html", "--beta", "4", "--reference", "sheet.html"),
        ("report", "a.ply", "b.ply", "page.html", "--parameters", "page.html"),
    ],
)
def test_no_command_replaces_what_it_reads_or_writes_besides(arguments, textured):
    for name in ("a.ply", "b.ply", "sheet.html", "page.html"):
        shutil.copy(NOISY, textured / name)
    shutil.copy(PHOTO, textured / "guide.png")
    shutil.copytree(textured, textured / "other")
    (textured / "link").symlink_to(textured)
    refused(textured, *arguments, "--overwrite", code=4, said="would replace")


@pytest.mark.slow
def test_a_preview_is_drawn_of_files_that_are_not_in_place_yet(textured, monkeypatch):
    small = (160, 90)  # at its full size, drawing takes seconds
    monkeypatch.setattr(before_after, "RenderSettings", partial(RenderSettings, size=small))
    (textured.parent / "before").mkdir()
    before = shutil.copytree(textured, textured.parent / "before" / "model")
    target = "mirrored-noisy.obj"
    smooth = ("smooth", target, target, *QUICK, "--preview", "p.png", "--overwrite")
    beltrami(*smooth, cwd=textured)
    drawn = ("render", before / "mirrored-noisy.obj", target, "expected.png", "--crop", "auto")
    beltrami(*drawn, "--size", "160x90", "--label", "before", "--label", "after", cwd=textured)
    preview, expected = textured / "p.png", textured / "expected.png"
    assert is_preview(preview.read_bytes())
    assert not is_preview(expected.read_bytes())
    shown, drawn = (read_image(file.read_bytes(), file.name).pixels for file in (preview, expected))
    assert np.array_equal(shown, drawn)
    assert not list(textured.rglob("*.tmp"))


NAMED = {
    "report": (("smooth", NOISY, "out.ply", *QUICK), "BELTRAMI_SMOOTH_REPORT", "file.json"),
    "preview": (("smooth", PHOTO, "out.png", *QUICK), "BELTRAMI_SMOOTH_PREVIEW", "file.png"),
    "map": (("compare", NOISY, NOISY), "BELTRAMI_COMPARE_MAP", "file.ply"),
    "record": (("batch", NOISY, "--out-dir", "out", *QUICK), "BELTRAMI_BATCH_REPORT", "file.jsonl"),
}
OPTIONS = {"report": "--report", "preview": "--preview", "map": "--map", "record": "--report"}


@pytest.mark.slow
@pytest.mark.parametrize("kind", NAMED)
@without_workers()
def test_a_file_of_others_is_replaced_only_if_the_command_line_names_it(kind, tmp_path):
    arguments, variable, name = NAMED[kind]
    (tmp_path / "out").mkdir()
    (tmp_path / Path(arguments[2]).name).write_text("old")
    file = tmp_path / name
    file.write_text("precious")
    table = f"[{arguments[0]}]\n{variable.rpartition('_')[2].lower()} = {json.dumps(name)}\n"
    configuration = tmp_path.parent / f"{tmp_path.name}.toml"
    configuration.write_text(table)
    overwriting = {variable.rpartition("_")[0] + "_OVERWRITE": "1"}
    for given, variables in (
        (("--overwrite",), {variable: name}),
        ((OPTIONS[kind], name), overwriting),
        ((), {variable: name, **overwriting}),
        (("--overwrite",), {"BELTRAMI_CONFIG": str(configuration)}),
    ):
        assert "is not a " in refused(tmp_path, *arguments, *given, code=4, said="remove it", env=variables)
    if kind == "record":  # among many files, one that a model needs is named too easily
        refused(tmp_path, *arguments, OPTIONS[kind], name, "--overwrite", code=4, said="remove it")
        file.unlink()
    beltrami(*arguments, OPTIONS[kind], name, "--overwrite", cwd=tmp_path)
    assert file.read_bytes()[:8] != b"precious"
    # From now on it is one of ours.
    assert is_preview(file.read_bytes()) == (kind == "preview")
    named = {"cwd": tmp_path, "env": {variable: name}}
    beltrami(*arguments, "--overwrite", **named)
    if kind != "preview":  # which takes seconds to draw
        file.write_bytes(b"")  # in which nothing can be lost
        beltrami(*arguments, "--overwrite", **named)
        assert file.stat().st_size
    beltrami(*arguments, code=4, **named)  # without --overwrite nothing is replaced


def test_what_is_like_one_of_ours_is_not_taken_for_one(tmp_path):
    photo = SAMPLES / "mirrored-noisy.png"
    beltrami("smooth", photo, "out.png", *QUICK, cwd=tmp_path)
    (tmp_path / "screen.png").write_bytes(
        encode(np.zeros((1013, 1288, 3), np.uint8), "png")
    )  # as large as a preview
    for path in (NOISY, photo, tmp_path / "out.png", tmp_path / "screen.png"):
        assert not is_preview(path.read_bytes())
        assert not is_map(path.read_bytes())
    for text in ("{}", '{\n  "input": "a"\n}', "[]", "# ~/.bashrc", '{"input": "a", "output": "b"}'):
        assert not is_report(text.encode())
