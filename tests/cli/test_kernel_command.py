"""`beltrami kernel` as a user runs it; what it writes is tested in tests/jobs/test_kernel_file.py."""

from __future__ import annotations

import json

from cli.commands import SAMPLES, beltrami

HEAD = SAMPLES / "head-noisy.ply"


def test_options_of_the_kernel_apply(tmp_path):
    target = tmp_path / "kernel.json"
    run = beltrami(
        "kernel", HEAD, target, "--at", "1234", "-t", "1.5", "--beta", "0", "--iteration", "2", "-v"
    )
    assert run.returncode == 0, run.stderr
    facts = json.loads(target.read_text())
    assert (facts["t"], facts["beta"], facts["iteration"]) == (1.5, 0, 2)
    printed = run.stderr.decode()
    assert printed.startswith(f"{target}: kernel of the vertex 1234, {facts['samples']} samples")
    assert "before: red" in printed


def test_a_table_goes_through_a_pipe_with_a_row_for_each_sample(tmp_path):
    run = beltrami("kernel", "-", "-", "--at", "1234", "-q", stdin=HEAD.read_bytes())
    assert run.returncode == 0, run.stderr
    head, *rows = run.stdout.decode().splitlines()
    assert head == "vertex,x,y,z,distance,weight,red,green,blue"
    assert rows[0].startswith("1234,")
    assert float(rows[0].split(",")[4]) == 0
    assert run.stderr == b""


def test_a_place_that_is_none_is_wrong_usage_in_one_line(tmp_path):
    run = beltrami("kernel", HEAD, tmp_path / "k.ply", "--at=-1")
    assert run.returncode == 2
    assert run.stderr.count(b"\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_kept_unless_it_may_be_replaced(tmp_path):
    target = tmp_path / "k.json"
    target.write_text("mine")
    run = beltrami("kernel", HEAD, target, "--at", "1")
    assert run.returncode == 4
    assert target.read_text() == "mine"
    assert beltrami("kernel", HEAD, target, "--at", "1", "--overwrite").returncode == 0
