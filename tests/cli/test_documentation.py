"""Every command and option is documented, and the commands that the pages show work."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import numpy as np
import pytest
import trimesh

from beltrami_cli.cli.documentation import notes_on, pages
from beltrami_cli.cli.registry import COMMANDS
from cli.commands import COMMAND, SAMPLES, beltrami, command, copy_samples
from formats.image_files import encode
from formats.tiff_files import exr_file
from formats.volume_files import sphere_file
from oracles import surfaces

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def typed(text):
    """The calls of beltrami in lines of shell, as lists of words, without redirections."""
    lines = re.sub(r"\\\n\s*", " ", text).splitlines()
    for line in lines:
        words = shlex.split(line, comments=True)
        for start in [k for k, word in enumerate(words) if word == "beltrami"]:
            rest = words[start + 1 :]
            ends = [k for k, word in enumerate(rest) if word in {"|", ">", "<", "&&", "||", ";"}]
            yield rest[: min(ends, default=len(rest))]


def shell_blocks(page):
    return "\n".join(re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL))


WRITTEN = [(page.name, words) for page in PAGES for words in typed(shell_blocks(page))]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_a_place_on_a_page_and_examples_and_each_option_is_described(name):
    assert any(f"beltrami {name} " in page.read_text(encoding="utf-8") for page in PAGES)
    assert len(command(name).help) > 60
    assert notes_on(name).startswith("\b\nExamples:\n")
    options = [parameter for parameter in command(name).params if isinstance(parameter, click.Option)]
    assert [option.name for option in options if not option.help] == []


def parsed(words):
    """Check names and values as the command line does, and run nothing."""
    own = next((k for k, word in enumerate(words) if not word.startswith("-") and word in COMMANDS), None)
    assert own is not None, words
    context = command(words[own]).make_context(words[own], list(words[own + 1 :]))
    assert context.args == []


@pytest.mark.parametrize(
    ("page", "words"), WRITTEN, ids=lambda value: " ".join(value) if isinstance(value, list) else value
)
def test_what_pages_say_is_understood(page, words):
    if words[0] not in {"--help", "--version"}:
        parsed(words)


def ramp(channels):
    return np.linspace(0, 1, 24 * 24 * channels, dtype=np.float32).reshape(24, 24, channels)


@pytest.fixture(scope="module")
def stand_ins(tmp_path_factory):
    """A small file for every name of an input that the README and the pages of `RUN` use."""
    folder = tmp_path_factory.mktemp("inputs")
    copy_samples(folder, "mirrored-noisy.*")
    copies = {
        "nonmanifold-noisy.ply": "scan.ply clean.ply truth.ply face.ply scans/a.ply scans/b.ply",
        "nonmanifold-noisy.obj": "scan.obj",
        "mirrored-noisy.obj": "photoscan.obj",
        "tiled-noisy.glb": "model.glb clean.glb noisy.glb truth.glb reference.glb result.glb",
    }
    (folder / "scans").mkdir()
    for sample, names in copies.items():
        for name in names.split():
            shutil.copy(SAMPLES / sample, folder / name)
    images = {
        "photo.jpg": ("jpeg", 3), "photo.png": ("png", 3), "colour.png": ("png", 3), "mask.png": ("png", 1),
        "valid.png": ("png", 1), "depth.exr": ("openexr", 1), "xyz.exr": ("openexr", 3), "render.exr": ("openexr", 3),
        "albedo.png": ("png", 3), "render.png": ("png", 3),
    }  # fmt: skip
    for name, (kind, channels) in images.items():
        pixels = ramp(channels)
        whole = np.uint8(255 * pixels)
        (folder / name).write_bytes(encode(pixels if kind == "openexr" else whole, kind))
    layers = {f"ViewLayer.{name}.{c}": ramp(1)[..., 0] for name in ("Combined", "Albedo") for c in "RGB"}
    (folder / "layers.exr").write_bytes(exr_file(layers))
    points = (f"{x} {y} {(x + y) % 3 / 20} {20 * x} {20 * y} 90\n" for x, y in np.ndindex(12, 12))
    (folder / "cloud.pts").write_text("".join(["144\n", *points]))
    shutil.copy(sphere_file(folder, 0.2), folder / "fusion.npz")
    beltrami("smooth", folder / "scan.ply", "-", "--fast", "--report", folder / "run.json")
    return folder


RUN_PAGES = {"README.md", "configuration.md", "index.md", "tuning.md"}
# Of the page of commands the first example of each.
FIRST = {words[0]: words for page, words in reversed(WRITTEN) if page == "commands.md"}
# Of the page of inputs the first block, which is about images.
IMAGES = [*typed(shell_blocks(ROOT / "docs" / "inputs.md").partition("\n\n")[0])]
# Neither calls with pipes nor the live view, which runs until its page is closed; tests/view has its tests.
FOUND = [
    words
    for words in (*FIRST.values(), *IMAGES, *(words for page, words in WRITTEN if page in RUN_PAGES))
    if not {"-", "{}", "view"} & set(words)
]
RUN = list({" ".join(words): words for words in FOUND}.values())


@pytest.mark.slow
@pytest.mark.parametrize("words", RUN, ids=" ".join)
def test_the_commands_of_the_readme_and_of_pages_to_start_with_run(words, stand_ins, tmp_path, monkeypatch):
    if {"render", "sweep", "report", "--preview"} & set(words):
        pytest.importorskip("embreex")
    folder = shutil.copytree(stand_ins, tmp_path / "work")
    monkeypatch.chdir(folder)
    (folder / "other.toml").write_text("[smooth]\nbeta = 8\n")
    for each in ("SMOOTH", "BATCH", "INFO", "KERNEL", "SWEEP"):
        monkeypatch.setenv(f"BELTRAMI_{each}_FAST", "1")  # the choice is not the point here
    name = next(word for word in words if word in COMMANDS)
    small = ["--size", "40"] if name in ("render", "sweep") else []  # the last one counts
    overwriting = ["--overwrite"] if "overwrite" in {each.name for each in command(name).params} else []
    beltrami(*words, *small, *overwriting)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["README.md", "docs/api.md"])
def test_the_python_of_pages_runs(name, stand_ins, tmp_path, monkeypatch):
    folder = shutil.copytree(stand_ins, tmp_path / "work")
    shutil.copy(SAMPLES / "tiled-noisy.glb", folder / "scan.glb")
    (folder / "clean.ply").unlink()
    (folder / "clean.glb").unlink()
    monkeypatch.chdir(folder)
    values = ramp(3)
    positions, faces = surfaces.plane(len(values), len(values))
    known = {
        "positions": positions, "points": positions, "faces": faces, "colours": values.reshape(-1, 3),
        "pixels": values, "depth": values[..., 0],
        "mesh": trimesh.Trimesh(positions, faces, vertex_colors=values.reshape(-1, 3), process=False),
        "uv": positions[:, :2] / len(values), "first": values, "second": values,
        "image_of_face": np.arange(len(faces)) % 2,
    }  # fmt: skip
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(encoding="utf-8"), re.DOTALL)
    for block in blocks:
        exec(compile(block, name, "exec"), known)
    assert known["result"].colours.shape == (len(positions), 3)


def test_docs_lists_every_page_of_the_site_with_its_title():
    listed = dict(line.split(None, 1) for line in beltrami("docs", text=True).stdout.splitlines())
    assert set(listed) == {page.stem for page in PAGES[1:]} - {"index", "changelog"}
    assert listed["levelling"] == "Exposure steps"


@pytest.mark.parametrize("name", pages())
def test_docs_writes_pages_as_markdown_without_the_markup_of_the_site(name):
    shown = beltrami("docs", name, text=True).stdout
    assert shown.startswith("# ")
    assert not re.search(r"^(:::|<!--|    options: {)", shown, re.MULTILINE)


@pytest.mark.parametrize("name", ["api.md", "commands.md", "parameters.md"])
def test_the_parts_of_pages_that_are_made_from_the_code_are_current(name, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import reference

    # Compared as a whole, so that pytest does not search for a long difference.
    is_current = reference.page(name) == (ROOT / "docs" / name).read_text(encoding="utf-8")
    assert is_current, "run `make reference`"


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_docs_formats_pages_in_a_terminal():
    ours, theirs = os.openpty()
    environment = {**os.environ, "PAGER": "cat"}
    with subprocess.Popen([*COMMAND, "docs", "ci"], stdout=theirs, stderr=theirs, env=environment):
        os.close(theirs)
        shown = os.read(ours, 4096).decode(errors="replace")  # the rest has no reader
        os.close(ours)
    assert "Colours in continuous integration" in shown
    assert "# Colours" not in shown


@pytest.mark.parametrize("name", COMMANDS)
def test_topics_that_help_names_exist(name):
    shown = beltrami(name, "--help-all", text=True).stdout
    assert "docs/" not in shown
    assert set(re.findall(r"beltrami docs ([a-z][\w-]+)", shown)) <= set(pages())
