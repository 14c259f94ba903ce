"""All files of a run are put in place together or not at all, and none replaces another or an input."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli.commands import SAMPLES, beltrami, refused

NOISY = SAMPLES / "nonmanifold-noisy.ply"
PHOTO = SAMPLES / "mirrored-noisy.png"
QUICK = ("-n", "1", "--beta", "8", "--fast")
FULL = Path("/dev/full")


@pytest.fixture
def textured(tmp_path):
    """Return a folder with a model of three files."""
    folder = tmp_path / "textured"
    folder.mkdir()
    for path in SAMPLES.glob("mirrored-noisy*"):
        shutil.copy(path, folder)
    return folder


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
def test_a_preview_is_drawn_of_files_that_are_not_in_place_yet(textured):
    """Takes 3 s: a preview is drawn twice at its full size."""
    (textured.parent / "before").mkdir()
    before = shutil.copytree(textured, textured.parent / "before" / "model")
    target = "mirrored-noisy.obj"
    smooth = ("smooth", target, target, *QUICK, "--preview", "p.png", "--overwrite")
    beltrami(*smooth, cwd=textured)
    drawn = ("render", before / "mirrored-noisy.obj", target, "expected.png", "--crop", "auto")
    beltrami(*drawn, "--label", "before", "--label", "after", cwd=textured)
    assert (textured / "p.png").read_bytes() == (textured / "expected.png").read_bytes()
    assert not list(textured.rglob("*.tmp"))
