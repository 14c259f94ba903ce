"""--patches: when patches are estimated, the messages about them, and that an interrupt ends them."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from cli.commands import SAMPLES, beltrami, interrupted
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
    (share,) = re.findall(
        r"^patches: (\d+) % of the result, the rest from the kernel alone$", said, re.MULTILINE
    )
    assert 0 < part["patches"] <= 1
    assert round(100 * part["patches"]) == int(share)
    assert smoothed(source, "--patches", "auto")[2] == result
    said, part, kernel = smoothed(source, "--patches", "off")
    assert "\npatches:" not in said
    assert part["patches"] is None
    assert kernel != result


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [("--beta", 5), ("--fast",)],
    ids=str,
)
def test_by_default_there_are_none_where_the_kernel_is_set_by_hand(options, mesh):
    _, part, result = smoothed(mesh, *options)
    assert part["patches"] is None
    assert smoothed(mesh, *options, "--patches", "off")[2] == result
    _, part, result_with = smoothed(mesh, *options, "--patches", "on")
    assert part["patches"] is not None
    assert result_with != result


@pytest.mark.slow
def test_a_texture_reports_its_share_and_takes_a_bound_on_memory(tmp_path):
    report = tmp_path / "report.json"
    options = ["--report", report, "--overwrite", "--max-memory", "2G"]
    beltrami("smooth", SAMPLES / "mirrored-noisy.obj", tmp_path / "out.obj", *options, text=True)
    (slot,) = json.loads(report.read_text())["textures"]
    assert 0 <= slot["patches"] <= 1


@pytest.mark.slow
def test_info_shows_what_would_be_done(mesh):
    for options, shown in (
        ((), "on"),
        (("--patches", "off"), "off"),
        (("--fast",), "off"),
        (("-n", 3), "off"),
    ):
        run = beltrami("info", mesh, "--json", *options, text=True)
        assert json.loads(run.stdout)["smooth"]["patches"] == shown, options
    assert re.search(r"^ +patches +on$", beltrami("info", mesh, "-v", text=True).stdout, re.MULTILINE)


def test_a_bad_value_is_refused(mesh):
    run = beltrami("smooth", mesh, mesh.with_stem("other"), "--patches", "some", text=True, code=2)
    assert "'auto', 'on', 'off'" in run.stderr


@pytest.mark.slow
def test_configuration_variables_and_manifests_take_it(mesh):
    _, _, kernel = smoothed(mesh, "--patches", "off")
    (mesh.parent / "beltrami.toml").write_text('[smooth]\npatches = "off"\n')

    def smooth(name, **variables):
        beltrami("smooth", mesh.name, name, cwd=mesh.parent, env=variables, text=True)
        return (mesh.parent / name).read_bytes()

    assert smooth("a.ply") == kernel
    assert smooth("b.ply", BELTRAMI_SMOOTH_PATCHES="on") != kernel
    (mesh.parent / "beltrami.toml").unlink()
    (mesh.parent / "jobs.jsonl").write_text(
        '{"input": "noisy.ply", "output": "c.ply", "patches": "off"}\n{"input": "noisy.ply", "output": "d.ply"}\n'
    )
    beltrami("batch", "jobs.jsonl", "--out-dir", "out", cwd=mesh.parent, text=True)
    assert (mesh.parent / "out" / "c.ply").read_bytes() == kernel
    assert (mesh.parent / "out" / "d.ply").read_bytes() == smooth("e.ply")


@pytest.mark.parametrize("name", ["head-clean.ply", "head-tex-clean.png"])
def test_clean_files_stay_byte_for_byte(name, tmp_path):
    beltrami("smooth", SAMPLES / name, tmp_path / name, "--patches", "on")
    assert (tmp_path / name).read_bytes() == (SAMPLES / name).read_bytes()


# Says when the patches begin, and runs the command.
REPORTING = """
import sys
from beltrami_cli.cli.main import main
from beltrami_cli.flow.{module} import {manifold}

own = {manifold}.collaborate

def reported(*arguments, **others):
    print("patches begin", file=sys.stderr, flush=True)
    return own(*arguments, **others)

{manifold}.collaborate = reported
main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("source", "module", "manifold"),
    [("big.png", "grid_manifold", "GridManifold"), ("big.ply", "mesh_manifold", "MeshManifold")],
)
def test_an_interrupt_while_patches_are_estimated_ends_at_once(source, module, manifold, tmp_path):
    side = 500 if source == "big.png" else 280
    noisy = with_noise(photograph(side), 20 / 255)
    if source == "big.png":
        (tmp_path / source).write_bytes(encode(np.uint8(np.round(255 * noisy)), "png"))
    else:
        painted_file(tmp_path / source, *surfaces.plane(side, side), noisy.reshape(-1, 3))
    arguments = [
        "smooth",
        source,
        f"out{source[3:]}",
        "--patches",
        "on",
        "-n",
        "1",
        "-t",
        "0.5",
        "--threads",
        "1",
    ]
    command = [sys.executable, "-P", "-c", REPORTING.format(module=module, manifold=manifold), *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, cwd=tmp_path) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line == b"patches begin\n":
                break
        time.sleep(0.1)
        interrupted(process, signal.SIGINT)  # a second, where nothing else runs
    assert [path.name for path in tmp_path.iterdir()] == [source]
