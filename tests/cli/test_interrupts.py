"""Ctrl-C and SIGTERM end a command soon, whatever it does, and leave neither a file nor a process."""

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from cli.commands import interrupted
from cli.pictures import coloured_file
from formats.image_files import encode
from oracles import surfaces
from processes import children, is_running, wait_for

# Runs the command, and says when it begins a step: a function of a module or class.
REPORTING = """
import importlib, sys
from beltrami_cli.cli.main import main

module, holder, name = {step!r}
owner = importlib.import_module("beltrami_cli." + module)
owner = getattr(owner, holder) if holder else owner
own = getattr(owner, name)

def reported(*arguments, **others):
    print("the step begins", file=sys.stderr, flush=True)
    return own(*arguments, **others)

setattr(owner, name, reported)
main()
"""
FLOW = ("--beta", "0", "-t", "8", "-n", "9999")
PATCHES = ("--patches", "on", "-n", "1", "-t", "0.5", "--threads", "1")
MESH, GRID = (
    ("flow.manifolds.mesh.manifold", "MeshManifold"),
    ("flow.manifolds.grid.manifold", "GridManifold"),
)
STEPS = {
    "iterations on vertices": (("smooth", "in.ply", "out.ply", *FLOW), (*MESH, "average_in_place"), 0),
    "iterations on pixels": (("smooth", "in.png", "out.png", *FLOW), (*GRID, "average_in_place"), 0),
    "patches of vertices": (("smooth", "in.ply", "out.ply", *PATCHES), (*MESH, "collaborate"), 0),
    "patches of pixels": (("smooth", "in.png", "out.png", *PATCHES), (*GRID, "collaborate"), 0),
    "unwrapping": (("bake", "in.sphere.ply", "out.glb", "--to", "texture"), ("surface.unwrap", "", "ask"), 1),
    "pieces": (
        ("batch", "in.png", "--out-dir", ".", "--suffix", "-out", "--report", "r.jsonl", "--pieces", "2",
         "-j", "2", *FLOW),
        (*GRID, "average_in_place"), 2,
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def inputs(tmp_path_factory):
    """Meshes and an image on which every step takes seconds."""
    folder, random = tmp_path_factory.mktemp("large"), np.random.default_rng(0)
    positions, faces = surfaces.plane(280, 280)
    coloured_file(folder / "in.ply", positions, faces, random.random(positions.shape))
    positions, faces = surfaces.icosphere(5)
    coloured_file(folder / "in.sphere.ply", positions, faces, random.random(positions.shape))
    (folder / "in.png").write_bytes(encode(random.integers(0, 256, (800, 800, 3), np.uint8), "png"))
    return folder


# Up to 3 s: a command starts, loads its modules, and starts processes that load theirs.
@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="/proc lists the processes")
@pytest.mark.parametrize(("step", "number"), [*zip(STEPS, itertools.cycle([signal.SIGINT, signal.SIGTERM]))])
def test_an_interruption_ends_soon_and_leaves_no_file_and_no_process(step, number, inputs, tmp_path):
    words, place, expected = STEPS[step]
    (source,) = (word for word in words if word.startswith("in."))
    os.link(inputs / source, tmp_path / source)
    command = [sys.executable, "-P", "-c", REPORTING.format(step=place), *words]
    with subprocess.Popen(command, stderr=subprocess.PIPE, cwd=tmp_path) as process:
        assert any(line == b"the step begins\n" for line in process.stderr)
        time.sleep(0.1)
        wait_for(lambda: len(children(process.pid)) >= expected)
        workers = children(process.pid)
        # A second, where nothing else runs; minutes without an interruption.
        assert b"files are as they were" in interrupted(process, number, patience=30)
    if step == "pieces":  # a process that watches over the others ends when it sees that the command has
        wait_for(lambda: not any(map(is_running, workers)))
    assert not any(map(is_running, workers))
    assert {path.name for path in tmp_path.iterdir()} <= {source, "r.jsonl"}
