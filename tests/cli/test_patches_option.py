"""--patches: when patches are estimated, the messages about them, and that an interrupt ends them."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from cli.commands import beltrami
from cli.pictures import painted_file
from formats.image_files import encode
from oracles import surfaces
from oracles.paintings import photograph, with_noise

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
    return painted_file(tmp_path / "noisy.ply", POSITIONS, FACES, NOISY.reshape(-1, 3))


def smoothed(source, *options):
    """Smooth a file into its folder; return the messages, the report on its colours, and the result."""
    target, report = source.with_stem("result"), source.with_name("report.json")
    run = beltrami("smooth", source, target, "-v", "--report", report, "--overwrite", *options, text=True)
    reported = json.loads(report.read_text())
    (part,) = (reported[name] for name in ("vertices", "image") if reported.get(name))
    return run.stderr, part, target.read_bytes()


@pytest.mark.parametrize("kind", ["picture", "mesh"])
def test_the_share_of_patches_is_said_and_reported(kind, request):
    source = request.getfixturevalue(kind)
    said, part, result = smoothed(source)
    assert said.startswith("work: parameters are tried on ")  # which comes before it starts
    (share,) = re.findall(r"^  patches +([\d.]+)$", said, re.MULTILINE)
    assert 0 < part["patches"] <= 1
    assert float(share) == pytest.approx(part["patches"], rel=1e-4)
    assert smoothed(source, "--patches", "auto")[2] == result
    said, part, kernel = smoothed(source, "--patches", "off")
    assert " patches " not in said
    assert part["patches"] is None
    assert kernel != result


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "has_patches"),
    [((), True), (("--patches", "off"), False), (("--fast",), False), (("-n", 3), False), (("--beta", 5), False),
     (("--beta", 5, "--patches", "on"), True)],
)  # fmt: skip
def test_by_default_there_are_none_where_the_kernel_is_set_by_hand_and_info_says_so(
    options, has_patches, mesh
):
    _, part, result = smoothed(mesh, *options)
    assert (part["patches"] is not None) == has_patches
    assert (smoothed(mesh, *options, "--patches", "off")[2] != result) == has_patches
    planned = json.loads(beltrami("info", mesh, "--json", *options).stdout)["smooth"]["patches"]
    assert planned == ("on" if has_patches else "off")
