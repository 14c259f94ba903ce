"""All files of a run are put in place together or not at all, and none replaces another or an input."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from beltrami_cli.errors import OutputError
from beltrami_cli.formats.document import Written
from beltrami_cli.jobs.output import FileSet, Output
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


def test_a_report_whose_folder_disappears_leaves_everything_as_it_was(tmp_path):
    (tmp_path / "gone").mkdir()
    (tmp_path / "out.ply").write_text("precious")
    with FileSet() as files:
        report = Output(str(tmp_path / "gone" / "r.json"), overwrite=True, what="report", files=files)
        output = Output(str(tmp_path / "out.ply"), overwrite=True, files=files)
        output.write(Written([b"new"]))
        report.write(Written([b"new"]))
        shutil.rmtree(tmp_path / "gone")
        with pytest.raises(OutputError, match="cannot be written"):
            files.put_in_place()
    assert [path.name for path in tmp_path.iterdir()] == ["out.ply"]
    assert (tmp_path / "out.ply").read_text() == "precious"


def test_what_is_not_put_in_place_is_removed(tmp_path):
    with FileSet() as files:
        output = Output(str(tmp_path / "out.obj"), overwrite=False, files=files)
        output.write(Written([b"new"], {"new/a.png": b"new"}))
        assert len(list(tmp_path.rglob("*.tmp"))) == 3  # one is the journal
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("option", "names"),
    [
        ("--report", ("noisy.obj", "noisy.mtl", "noisy.png", "out.obj", "out.mtl", "out.png")),
        ("--preview", ("noisy.png", "out.png")),
    ],
)
def test_a_report_or_preview_replaces_nothing_that_is_read_or_written(option, names, textured):
    run = ("smooth", "mirrored-noisy.obj", "out.obj", *QUICK, "--overwrite")
    beltrami(*run, cwd=textured)
    for name in names:
        refused(textured, *run, option, name.replace("noisy", "mirrored-noisy"), code=4)


@pytest.mark.parametrize("exists", [False, True])
def test_a_report_and_a_preview_are_two_files(exists, tmp_path):
    if exists:
        (tmp_path / "both.png").write_text("precious")
    (tmp_path / "link").symlink_to(tmp_path)
    two = ("--report", "both.png", "--preview", "link/both.png")
    assert "would replace" in refused(
        tmp_path, "smooth", NOISY, "out.ply", *QUICK, *two, "--overwrite", code=4
    )


def test_output_does_not_replace_a_guide(tmp_path):
    for name in ("photo.png", "guide.png"):
        shutil.copy(SAMPLES / "mirrored-noisy.png", tmp_path / name)
    guided = ("smooth", "photo.png", "guide.png", *QUICK, "--guide", "guide.png", "--overwrite")
    assert "would replace" in refused(tmp_path, *guided, code=4)
    beltrami(*guided[:2], "photo.png", *guided[3:], cwd=tmp_path)


@pytest.mark.parametrize(
    "arguments",
    [
        ("compare", "a.ply", "b.ply", "--map", "b.ply"),
        ("kernel", "a.ply", "a.ply", "--at", "7"),
        ("render", "picture.png", "picture.png"),
        ("sweep", "a.ply", "sheet.html", "--beta", "4", "--reference", "sheet.html"),
        ("report", "a.ply", "b.ply", "page.html", "--parameters", "page.html"),
    ],
)
def test_no_command_replaces_what_it_reads(arguments, tmp_path):
    for name in ("a.ply", "b.ply", "sheet.html", "page.html"):
        shutil.copy(NOISY, tmp_path / name)
    shutil.copy(SAMPLES / "mirrored-noisy.png", tmp_path / "picture.png")
    refused(tmp_path, *arguments, "--overwrite", code=4)


def test_a_map_does_not_replace_a_texture_of_what_it_compares(textured):
    shutil.copytree(textured, textured / "other")
    compared = ("compare", "mirrored-noisy.obj", "other/mirrored-noisy.obj")
    refused(textured, *compared, "--map", "other/mirrored-noisy.png", "--overwrite", code=4)
    beltrami(*compared, "--map", "map.png", cwd=textured)


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
