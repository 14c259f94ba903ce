"""Textures in another format: what is not converted says how it can be."""

from __future__ import annotations

import pytest

from beltrami_cli.formats.registry import open_document
from cli.commands import SAMPLES, beltrami


@pytest.mark.parametrize("iterations", ["0", "1"])
def test_a_textured_model_in_another_format_is_refused_with_the_way_out(iterations, tmp_path):
    run = beltrami("smooth", SAMPLES / "mirrored-noisy.obj", tmp_path / "out.glb", "-n", iterations, "--fast")
    assert run.returncode == 2
    assert b"obj to glb" in run.stderr
    assert b"--unwrap" in run.stderr
    assert not list(tmp_path.iterdir())


def test_that_way_out_converts(tmp_path):
    target = tmp_path / "out.glb"
    run = beltrami(
        "smooth",
        SAMPLES / "mirrored-noisy.obj",
        target,
        "-n",
        "1",
        "--fast",
        "--unwrap",
        "--texture-size",
        "64",
    )
    assert run.returncode == 0, run.stderr
    assert len(open_document(str(target)).textured("baseColor").textures) == 1
