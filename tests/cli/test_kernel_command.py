"""`beltrami kernel` as a user runs it; what it writes is tested in tests/jobs/test_kernel_file.py."""

from __future__ import annotations

import json
import math

import pytest

from cli.commands import SAMPLES, beltrami

HEAD = SAMPLES / "head-noisy.ply"


def test_options_of_the_kernel_apply(tmp_path):
    options = ("--at", "1234", "-t", "1.5", "--beta", "0", "--iteration", "2")
    run = beltrami("kernel", HEAD, tmp_path / "kernel.csv", *options)
    printed = run.stderr.decode()
    assert printed.startswith(f"{tmp_path / 'kernel.csv'}: kernel of the vertex 1234 in iteration 2 of ")
    assert printed.endswith(" away, beta 0\n")
    rows = (tmp_path / "kernel.csv").read_text().splitlines()
    assert f", {len(rows) - 1} samples up to" in printed
    distance, weight = map(float, rows[-1].split(",")[4:6])
    assert weight == pytest.approx(math.exp(-(distance**2) / (4 * 1.5)))


def test_a_table_goes_through_a_pipe_with_a_row_for_each_sample(tmp_path):
    run = beltrami("kernel", "-", "-", "--at", "1234", "-q", "--fast", stdin=HEAD.read_bytes())
    head, *rows = run.stdout.decode().splitlines()
    assert head == "vertex,x,y,z,distance,weight,red,green,blue"
    assert rows[0].startswith("1234,")
    assert float(rows[0].split(",")[4]) == 0
    assert run.stderr == b""


def test_an_existing_file_is_kept_unless_it_may_be_replaced(tmp_path):
    target = tmp_path / "k.csv"
    target.write_text("mine")
    beltrami("kernel", HEAD, target, "--at", "1", code=4)
    assert target.read_text() == "mine"
    beltrami("kernel", HEAD, target, "--at", "1", "--overwrite", "--fast")


@pytest.mark.parametrize(
    ("name", "at", "options"),
    [
        ("nonmanifold-noisy.ply", "100", ("--strength", "strong", "-n", 2)),
        ("mirrored-noisy.obj", "0.4,0.4", ("--fast",)),
        ("torus-two-noisy-dough.png", "90,70", ()),
    ],
)
@pytest.mark.slow
def test_kernel_info_and_smooth_say_the_same_parameters_of_a_file(name, at, options, tmp_path):
    source, record = SAMPLES / name, tmp_path / "run.json"
    smooth = beltrami("smooth", source, tmp_path / name, "--dry-run", "--report", record, *options)
    shown = beltrami("kernel", source, tmp_path / "kernel.csv", "--at", at, *options, text=True).stderr
    done = json.loads(record.read_text())
    done = done["vertices"] or done["image"] or done["textures"][0]
    info = json.loads(beltrami("info", source, "--json", *options).stdout)
    planned = info["smooth"] if "smooth" in info else info["textures"][0]["smooth"]
    for key in ("beta", "iterations"):
        assert done[key] == planned[key]
    assert f"in iteration 1 of {planned['iterations']}," in shown
    assert f"beta {planned['beta']:.3g}\n" in shown
    assert f"beta {planned['beta']:.3g}," in smooth.stderr.decode()


@pytest.mark.slow
def test_samples_of_a_kernel_are_said_of_the_first_iteration_or_of_all(tmp_path):
    record = tmp_path / "run.json"
    parameters = ("-n", 1, "-t", 2, "--beta", 8)
    smooth = beltrami("smooth", HEAD, tmp_path / "o.ply", "--report", record, *parameters)
    of_one = json.loads(record.read_text())["vertices"]["counts"]["samples_per_kernel"]
    planned = json.loads(beltrami("info", HEAD, "--json", *parameters).stdout)["smooth"]["samples_per_kernel"]
    assert planned == pytest.approx(of_one, rel=0.05)  # from some of the kernels
    assert f"{of_one:.0f} samples a kernel, mean" in smooth.stderr.decode()
    assert b"in the first iteration\n" in beltrami("info", HEAD, *parameters, "-v").stdout
    parameters = ("-n", 3, *parameters[2:])
    smooth = beltrami("smooth", HEAD, tmp_path / "p.ply", *parameters)
    assert b" samples a kernel on average over 3 iterations, mean" in smooth.stderr
    assert (
        b"in the first of 3 iterations; smooth gives the mean over all\n"
        in beltrami("info", HEAD, *parameters, "-v").stdout
    )
