"""Files outside the model's own folder are neither read, unless allowed, nor written; unreadable ones cost one line."""

import errno
import io
import os
from pathlib import Path

import numpy as np
import pytest

from beltrami_cli.errors import InputError, OutputError
from beltrami_cli.formats.changes import Written
from beltrami_cli.formats.files import access
from beltrami_cli.formats.files.access import Access
from beltrami_cli.formats.registry import open_document
from beltrami_cli.formats.sidecars.model_folder import ModelFolder, UnfitReferenceError
from beltrami_cli.jobs.job import Job
from beltrami_cli.jobs.smooth import smooth_file
from beltrami_cli.jobs.writing.output import Output
from cli.commands import beltrami
from formats.image_files import encode
from formats.tile_files import tiled_model
from hostile.folders import snapshot
from hostile.textured_models import KINDS, ONCE, OTHER, PICTURE, write_model

OUTSIDE = Access(outside=True)


@pytest.fixture
def world(tmp_path):
    """A folder of a model, and a secret folder next to it."""
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "key.png").write_bytes(PICTURE)
    (tmp_path / "secret" / "other.png").write_bytes(OTHER)
    (tmp_path / "in").mkdir()
    return tmp_path


def hidden_names(world):
    """Names that must not be followed, by the words that say why."""
    inside = world / "in"
    os.mkfifo(inside / "fifo.png")
    (inside / "folder.png").mkdir()
    (inside / "zero.png").symlink_to("/dev/zero")
    (inside / "link.png").symlink_to(world / "secret" / "key.png")
    (inside / "loop.png").symlink_to("loop.png")
    (inside / "linked").symlink_to(world / "secret")
    (inside / ".hidden.png").write_bytes(PICTURE)
    return {
        "../secret/key.png": "leaves the model's folder",
        "a/../../secret/key.png": "leaves the model's folder",
        str(world / "secret" / "key.png"): "leaves the model's folder",
        "http://127.0.0.1:9/key.png": "is not a relative path",
        "https://127.0.0.1:9/key.png": "is not a relative path", "file:///etc/passwd": "is not a relative path",
        "//127.0.0.1/share/key.png": "is not a relative path", "C:/secret/key.png": "is not a relative path",
        "link.png": "leads out of the model's folder", "linked/key.png": "leads out of the model's folder",
        "fifo.png": "is not a regular file", "folder.png": "is not a regular file",
        "zero.png": "leads out of the model's folder", "loop.png": "cannot be the name of a file",
        ".hidden.png": "is a hidden file", "absent.png": "is missing", "a" * 5000: "cannot be the name of a file",
    }  # fmt: skip


def test_names_that_lead_elsewhere_are_refused_with_the_reason(world):
    inside = ModelFolder(world / "in")
    for name, reason in hidden_names(world).items():
        with pytest.raises(UnfitReferenceError, match=reason):
            inside.locate(name)
    for name in ("..\\secret\\key.png", "\\\\127.0.0.1\\share\\key.png", "\\etc\\passwd"):
        with pytest.raises(UnfitReferenceError, match=r"leaves the model's folder|is not a relative path"):
            inside.locate(name)


@pytest.mark.parametrize(
    ("kind", "name"), [("obj", "link.png"), ("ply", "../secret/key.png"), ("gltf", "fifo.png")]
)
def test_no_format_follows_such_names(kind, name, world):
    reason = hidden_names(world)[name]
    model = write_model(world / "in", kind, name)
    before = snapshot(world)
    with pytest.raises(InputError) as caught:
        smooth_file(model, world / f"out.{kind}")
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)
    assert snapshot(world) == before


@pytest.mark.parametrize("library", ["../secret/m.mtl", "/dev/zero", "http://127.0.0.1:9/m.mtl", "fifo.mtl"])
def test_material_libraries_elsewhere_are_left_alone(library, world):
    (world / "secret" / "m.mtl").write_text("newmtl m\nmap_Kd key.png\n")
    model = write_model(world / "in", "obj", "key.png", library if "fifo" not in library else "m.mtl")
    if "fifo" in library:
        os.mkfifo(world / "in" / "fifo.mtl")
        model.write_text(model.read_text().replace("m.mtl", "fifo.mtl"))
    document = open_document(str(model))
    assert document.slots() == ()
    assert list(document.references()) == []
    assert any(library in notice for notice in document.notices)


def test_networks_and_devices_are_not_read_even_if_more_is_allowed(world):
    folder = ModelFolder(world / "in", OUTSIDE)
    os.mkfifo(world / "secret" / "fifo")
    remote = ("http://127.0.0.1:9/key.png", "//127.0.0.1/key.png")
    for name in (*remote, "/dev/zero", "../secret/fifo", "../.netrc"):
        with pytest.raises(UnfitReferenceError):
            folder.locate(name)


def test_a_file_that_becomes_a_fifo_is_not_waited_for(world):
    path = world / "in" / "a.png"
    path.write_bytes(PICTURE)
    folder = ModelFolder(world / "in")
    located = folder.locate("a.png")
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(OSError, match="not a regular file"):
        folder.read(located)


@pytest.mark.parametrize(
    ("kind", "absolute", "moved"),
    [("obj", True, True), ("obj", False, False), ("ply", True, False), ("ply", False, True), ("gltf", False, True),
     ("gltf", True, False)],
)  # fmt: skip
def test_when_allowed_they_are_read_and_new_ones_written_inside(kind, absolute, moved, world):
    name = str(world / "secret" / "key.png") if absolute else "../secret/key.png"
    model = write_model(world / "in", kind, name)
    target = (world / "out" if moved else world / "in") / f"result.{kind}"
    target.parent.mkdir(exist_ok=True)
    before = snapshot(world)
    report = smooth_file(model, target, ONCE, job=Job(access=OUTSIDE))
    assert report.warnings == []
    after = snapshot(world)
    assert {path: after[path] for path in before} == before
    new = sorted(set(after) - set(before))
    assert all(Path(path).parent.name == target.parent.name for path in new)
    images = [path for path in new if path.endswith(".png")]
    assert images == [f"{target.parent.name}/result_key.png"]
    # Alone, in a folder of its own, the result is whole.
    (texture,) = open_document(str(target)).textured("baseColor").textures
    assert texture.data == after[images[0]][1] != PICTURE


@pytest.mark.parametrize("moved", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_what_stays_outside_is_told_if_the_output_is_elsewhere(kind, moved, world):
    model = write_model(world / "in", kind, "../secret/key.png")
    target = (world / "out" if moved else world / "in") / f"result.{kind}"
    target.parent.mkdir(exist_ok=True)
    report = smooth_file(model, target, ONCE, job=Job(access=OUTSIDE), iterations=0)
    warnings = [text for text in report.warnings if "lies outside the model's folder" in text]
    assert [text.split("'")[1] for text in warnings] == ["../secret/key.png"] * moved
    assert sorted(path.name for path in target.parent.glob("result*png")) == []


@pytest.mark.parametrize("moved", [True, False])
def test_a_library_from_outside_comes_inside_with_all_its_images(moved, world):
    (world / "secret" / "m.mtl").write_text(
        "newmtl m\nmap_Kd key.png\nmap_Bump other.png\nnewmtl n\nmap_Kd ../in/own.png\n"
    )
    (world / "in" / "own.png").write_bytes(OTHER)
    model = write_model(world / "in", "obj", "", "../secret/m.mtl")
    target = (world / "out" if moved else world / "in") / "result.obj"
    target.parent.mkdir(exist_ok=True)
    before = snapshot(world)
    report = smooth_file(model, target, ONCE, job=Job(access=OUTSIDE))
    assert report.warnings == []
    after = snapshot(world)
    assert {path: after[path] for path in before} == before
    document = open_document(str(target))
    assert document.notices == ()
    assert document.textured("normal").textures[0].data == OTHER
    assert (target.parent / "result.mtl").is_file()


@pytest.mark.parametrize("name", ["/tmp/x.png", "../x.png", "a/../../x.png"])
def test_the_last_door_is_shut_as_well(name, tmp_path):
    output = Output(str(tmp_path / "out.obj"), overwrite=True)
    with pytest.raises(OutputError, match="outside the output's folder"):
        output.write(Written([b""], {name: b""}))
    assert list(tmp_path.iterdir()) == []


CODES = (errno.EACCES, errno.EISDIR, errno.ESTALE, errno.EMFILE)
MAX_READS = 40
# So large that it is not kept in memory, but read whenever it is needed.
LARGE = encode(np.random.default_rng(1).integers(0, 256, (600, 600, 3), np.uint8), "png")
RUNS = {
    "noise": ("noise", "{model}", "out/new{suffix}", "--sigma", "5"),
    "copy": ("smooth", "{model}", "out/new{suffix}", "-n", "0"),
    "convert": ("smooth", "{model}", "out/new.glb", "-n", "0"),
    "bake": ("bake", "{model}", "out/new.ply", "--to", "vertices"),
    "info": ("info", "{model}", "--fast"),
    "compare": ("compare", "{model}", "{model}"),
    "check": ("check", "{model}", "{model}"),
    "render": ("render", "{model}", "out/new.png", "--size", "32x32"),
}


class Stale(io.FileIO):
    """A file that can be opened, but not read."""

    def __init__(self, path, code):
        super().__init__(path)
        self.code = code

    def read(self, *_):
        raise OSError(self.code, os.strerror(self.code))


def model_in(folder, kind):
    if kind == "tiles":
        return tiled_model(folder, size=1)
    model = write_model(folder, kind, "skin.png")
    (folder / "skin.png").write_bytes(LARGE)
    return model


@pytest.mark.slow
@pytest.mark.parametrize(
    ("run", "kind"),
    [
        *(("noise", kind) for kind in (*KINDS, "tiles")),
        *(("check", kind) for kind in ("gltf", "tiles")),
        ("copy", "tiles"), ("convert", "ply"), ("bake", "gltf"),
        ("info", "obj"), ("compare", "tiles"), ("render", "ply"),
    ],
)  # fmt: skip
def test_a_file_beside_a_model_that_cannot_be_read(run, kind, tmp_path, monkeypatch):
    model = model_in(tmp_path, kind)
    (tmp_path / "out").mkdir()
    before = snapshot(tmp_path)
    arguments = [word.format(model=model.name, suffix=model.suffix) for word in RUNS[run]]
    opened = access.open_regular
    for at in range(1, MAX_READS):
        reads = 0

        def fail(path, at=at):
            nonlocal reads
            reads += path.name != model.name
            if path.name == model.name or reads != at:
                return opened(path)
            code = CODES[at % len(CODES)]
            if at % 2:
                raise OSError(code, os.strerror(code))
            return Stale(path, code)

        monkeypatch.setattr(access, "open_regular", fail)
        done = beltrami(*arguments, code=None, cwd=tmp_path, text=True)
        assert "unexpected" not in done.stderr, at
        if reads < at:
            return
        if done.returncode:
            # `check` may also say on standard output what differs, as if the file was not there.
            assert done.returncode == 3 or (run, done.returncode) == ("check", 1), done.stderr
            assert done.stderr.count("beltrami: ") == (done.returncode == 3)
            assert snapshot(tmp_path) == before
        for path in (tmp_path / "out").iterdir():
            path.unlink()
    raise AssertionError("there are more reads than expected")
