"""Images that cannot be processed in the memory that a command may take are refused before they are decoded."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from cli.commands import refused
from formats.image_files import encode, png_chunk
from hostile.textured_models import write_model

# The largest that is read; there are no pixels behind the header, so decoding would say "damaged".
SIDE = 16384
# Decoded, one takes 256 MB, which fits, and for every use at least 2 bytes per pixel more, which do not.
LIMIT = "512M"
# Jobs that recolour keep their arrays in files then; other jobs on all pixels take at least 30 bytes per pixel.
LIMIT_IN_MEMORY = "8G"


def header_only(width, height):
    header = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    data = png_chunk(b"IDAT", zlib.compress(b"")) + png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + header + data


COMMANDS = [
    "info large.png",
    "smooth large.png out.png",
    "smooth large.png out.jpg -n 0",
    "noise large.png out.png --sigma 5%",
    "kernel large.png out.png --at 5,5",
    "compare large.png large.png",
    "report large.png large.png out.html",
    "render large.png out.png",
    "sweep large.png out.png --beta 1,2",
    "view large.png --no-open",
    "smooth small.png out.png --height large.png",
    "smooth small.png out.png --positions large.png",
    "smooth small.png out.png --mask large.png",
    "smooth small.png out.png --guide large.png",
    "smooth small.png out.png --noise large.png",
    "info model.obj",
    "smooth model.obj out.obj",
    "smooth model.obj out.glb --unwrap",
    "level model.obj out.obj",
    "noise model.obj out.obj --sigma 5%",
    "kernel model.obj out.png --at 0.5,0.5",
    "check model.obj other.obj",
    "compare model.obj other.obj",
    "report model.obj other.obj out.html",
    "render model.obj out.png",
    "bake model.obj out.ply --to vertices",
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("large")
    (folder / "large.png").write_bytes(header_only(SIDE, SIDE))
    (folder / "other.png").write_bytes(header_only(SIDE, SIDE) + b"\0")
    (folder / "small.png").write_bytes(encode(np.full((8, 8, 1), 99, np.uint8), "png"))
    for name, image in (("other", "other.png"), ("model", "large.png")):
        write_model(folder, "obj", image, f"{name}.mtl").rename(folder / f"{name}.obj")
    return folder


_JOBS = tuple(f"{name} large" for name in ("noise", "kernel", "compare", "report"))
IN_MEMORY = [each for each in COMMANDS if each.startswith(_JOBS)]


@pytest.mark.parametrize(
    ("command", "limit"),
    [*((each, LIMIT) for each in COMMANDS), *((each, LIMIT_IN_MEMORY) for each in IN_MEMORY)],
)
def test_what_does_not_fit_is_refused_before_it_is_decoded(command, limit, folder):
    said = refused(folder, *command.split(), "--max-memory", limit, code=3)
    assert "fit into memory" in said, said
    assert "raise --max-memory" in said
