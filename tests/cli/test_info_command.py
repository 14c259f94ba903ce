"""`beltrami info` tells what is there and what smoothing would do."""

from __future__ import annotations

import json

import pytest

from cli.commands import SAMPLES, beltrami


def info(name, *options):
    run = beltrami("info", SAMPLES / name, "--json", *options)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_a_non_manifold_mesh_is_described():
    told = info("nonmanifold-clean.ply")["surface"]
    assert told["non_manifold_edges"] > 0
    assert told["isolated_vertices"] == 1
    assert told["duplicate_faces"] == 1
    assert told["degenerate_faces"] == 1
    assert told["hard_edge_samples"] > 0


def test_a_closed_mesh_has_no_boundary_and_an_open_one_has():
    assert info("knot-clean.ply")["surface"]["boundary_edges"] == 0
    assert info("terrain-clean.ply")["surface"]["boundary_edges"] > 0


@pytest.mark.parametrize("extension", ["ply", "obj", "glb"])
def test_the_same_mesh_is_the_same_surface_in_every_format(extension):
    told, reference = info(f"terrain-clean.{extension}")["surface"], info("terrain-clean.ply")["surface"]
    for key in ("samples", "triangles", "edges", "boundary_edges", "isolated_vertices"):
        assert told[key] == reference[key]


def test_noise_is_told_in_units_of_full_scale():
    noisy, clean = info("head-noisy.ply")["noise"], info("head-clean.ply")["noise"]
    for channel in ("red", "green", "blue"):
        # Clipping takes some away, the pattern adds some.
        assert 15 / 255 < noisy[channel] < 27 / 255
        assert clean[channel] < 3 / 255


def test_a_larger_time_step_is_told_to_hold_more_samples():
    few, many = info("head-noisy.ply", "-t", "0.5")["smooth"], info("head-noisy.ply", "-t", "5")["smooth"]
    assert many["samples_per_kernel"] > 1.5 * few["samples_per_kernel"]


def test_what_is_told_for_people_has_the_same_sections():
    run = beltrami("info", SAMPLES / "head-noisy.ply")
    for section in ("file", "colours", "surface", "noise", "smooth"):
        assert f"\n{section}\n" in f"\n{run.stdout.decode()}"
    assert run.stderr == b""


def test_a_file_without_colours_is_refused(tmp_path):
    plain = tmp_path / "plain.obj"
    plain.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    run = beltrami("info", plain)
    assert run.returncode == 3
    assert run.stdout == b""
