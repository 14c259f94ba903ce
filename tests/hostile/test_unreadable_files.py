"""A sidecar file that cannot be read, at first or any later time: one line, or the file is left alone."""

from __future__ import annotations

import errno
import io
import os

import numpy as np
import pytest

from beltrami_cli.formats import access
from cli.commands import beltrami
from formats.image_files import encode
from formats.tile_files import tiled_model
from hostile.folders import snapshot
from hostile.textured_models import write_model

CODES = (errno.EACCES, errno.EISDIR, errno.ESTALE, errno.EMFILE)
MOST_READS = 40
# So large that it is not kept in memory, but read whenever it is needed.
LARGE = encode(np.random.default_rng(1).integers(0, 256, (600, 600, 3), np.uint8), "png")
RUNS = {
    "smooth": ("smooth", "{model}", "out/new{suffix}", "-n", "1", "--beta", "1"),
    "copy": ("smooth", "{model}", "out/new{suffix}", "-n", "0"),
    "convert": ("smooth", "{model}", "out/new.glb", "-n", "0"),
    "bake": ("bake", "{model}", "out/new.ply", "--to", "vertices"),
    "info": ("info", "{model}"),
    "compare": ("compare", "{model}", "{model}"),
    "check": ("check", "{model}", "{model}"),
    "render": ("render", "{model}", "out/new.png", "--size", "32x32"),
}


class Stale(io.BytesIO):
    """A file that can be opened, but not read."""

    def __init__(self, path, code):
        super().__init__()
        self.descriptor, self.code = os.open(path, os.O_RDONLY), code

    def fileno(self):
        return self.descriptor

    def read(self, *_):
        raise OSError(self.code, os.strerror(self.code))

    def close(self):
        if not self.closed:
            os.close(self.descriptor)
        super().close()


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
        *(("smooth", kind) for kind in ("obj", "ply", "gltf", "tiles")),
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
    for at in range(1, MOST_READS):
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
