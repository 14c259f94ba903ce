"""Level sets on the command line, as a user meets them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beltrami_cli.formats.registry import open_document
from cli.commands import beltrami, refused
from formats.volume_files import npz
from oracles.level_sets import CENTRE, sphere


@pytest.fixture(scope="module")
def volume(tmp_path_factory):
    """An occupancy whose sphere of radius 1 is at 0.5, in random colours."""
    values, steps, origin = sphere(0.15)
    colours = np.random.default_rng(1).normal(128, 30, (*values.shape, 3)).clip(0, 255).astype(np.uint8)
    path = tmp_path_factory.mktemp("volume") / "occupancy.npz"
    path.write_bytes(npz(values=0.5 - values, colours=colours, spacing=steps, origin=origin))
    return path


OPTIONS = ("--iso", 0.5, "--inside", "above")


@pytest.mark.parametrize("extension", ["ply", "obj", "glb", "gltf"])
def test_the_surface_is_written_in_the_format_of_the_name(extension, volume, tmp_path):
    result = tmp_path / f"out.{extension}"
    beltrami("smooth", volume, result, *OPTIONS, "--report", tmp_path / "report.json")
    painted = open_document(str(result)).painted()
    radii = np.linalg.norm(painted.positions - CENTRE, axis=1)
    np.testing.assert_allclose(radii, 1, atol=0.5 * 0.15**2)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["vertices"]["counts"]["vertices"] == len(radii)
    assert report["parameters"]["level_set"]["iso"] == 0.5


def test_a_pipe_takes_an_archive_and_gives_a_ply_file(volume):
    run = beltrami("smooth", "-", "-", *OPTIONS, stdin=volume.read_bytes())
    assert run.stdout[:4] == b"ply\n"


def test_info_describes_the_grid_and_of_its_surface(volume):
    facts = json.loads(beltrami("info", volume, "--json", *OPTIONS).stdout)
    assert facts["file"]["format"] == "level set"
    assert facts["file"]["level"] == 0.5
    assert facts["surface"]["boundary_edges"] == facts["surface"]["degenerate_faces"] == 0
    assert facts["smooth"]["samples_per_kernel"] > 1


def test_colours_that_are_not_there_are_named(volume, tmp_path):
    said = "missing.npz: cannot be read"
    refused(tmp_path, "smooth", volume, "out.ply", "--colours", "missing.npz", code=3, said=said)


def test_a_surface_too_large_for_the_memory_is_refused_and_does_not_end_the_process(tmp_path):
    # scikit-image writes past arrays that it cannot enlarge, so it must not come to that.
    values = np.random.default_rng(2).standard_normal((100, 100, 100)).astype(np.float16)
    path = tmp_path / "noise.npz"
    path.write_bytes(npz(values=values, colours=np.zeros((100, 100, 100, 1), np.uint8)))
    run = beltrami("smooth", path, tmp_path / "out.ply", "--max-memory", "80M", code=3)
    assert b"needs more than 80M" in run.stderr


@pytest.mark.slow
def test_a_level_set_can_be_unwrapped_to_a_texture(volume, tmp_path):
    beltrami("smooth", volume, tmp_path / "out.glb", *OPTIONS, "--unwrap", "--texture-size", 128)
    assert open_document(str(tmp_path / "out.glb")).slots() == ("baseColor",)
