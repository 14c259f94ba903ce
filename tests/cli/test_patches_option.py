"""--patches: when patches are estimated, the messages about them, and that an interrupt ends them."""

import re

import numpy as np
import pytest

from cli.commands import beltrami, colours_in
from cli.pictures import coloured_file
from formats.image_files import encode
from oracles import surfaces
from oracles.pictures import photograph, with_noise

SIDE = 40
POSITIONS, FACES = surfaces.plane(SIDE, SIDE)
NOISY = with_noise(photograph(SIDE), 20 / 255)


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "noisy.png"
    path.write_bytes(encode(np.uint8(np.round(255 * NOISY)), "png"))
    return path


@pytest.fixture
def mesh(tmp_path):
    return coloured_file(tmp_path / "noisy.ply", POSITIONS, FACES, NOISY.reshape(-1, 3))


def smoothed(source, *options):
    """Smooth a file into its folder; return the messages, the report on its colours, and the result."""
    target, report = source.with_stem("result"), source.with_name("report.json")
    run = beltrami("smooth", source, target, "-v", "--report", report, "--overwrite", *options, text=True)
    return run.stderr, colours_in(report), target.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["picture", "mesh"])
def test_the_share_of_patches_is_said_and_reported(kind, request):
    source = request.getfixturevalue(kind)
    said, part, result = smoothed(source)
    assert said.startswith("parameters are tried on ")  # which comes before it starts
    (share,) = re.findall(r"^  share from similar patches +([\d.]+)$", said, re.MULTILINE)
    assert 0 < part["patches"] <= 1
    assert float(share) == pytest.approx(part["patches"], rel=1e-4)
    assert smoothed(source, "--patches", "auto")[2] == result
    said, part, kernel = smoothed(source, "--patches", "off")
    assert " similar patches " not in said
    assert part["patches"] is None
    assert kernel != result
