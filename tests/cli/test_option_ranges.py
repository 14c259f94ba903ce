"""What options refuse, each in words of its own; and the last resort for what nobody foresaw."""

from __future__ import annotations

import os
import subprocess

import pytest

from cli.commands import COMMAND, SAMPLES, beltrami

NOISY = SAMPLES / "terrain-noisy.ply"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--threads", "0"], "range"),
        (["--threads", "1025"], "range"),
        (["--max-samples", "0"], "range"),
        (["--max-samples", str(2**31)], "range"),
        (["-n", "-1"], "range"),
        (["--metric-steps", "-1"], "range"),
        (["--window", "1"], "range"),
        (["--window", "100001"], "range"),
        (["--window", "4"], "odd"),
        (["--gutter", "²"], "gutter"),
        (["--gutter", "-1"], "gutter"),
        (["--gutter", "9" * 5000], "gutter"),
        (["--metric-scale", "1e-9"], "metric_scale"),
        (["--metric-scale", "nan"], "metric_scale"),
        (["--channels", ""], "--channels names nothing"),
        (["--channels", " , "], "--channels names nothing"),
        (["--slots", ""], "--slots names nothing"),
        (["--units", "world"], "--units world needs -t"),
        (["--units", "world", "--preset", "paper"], "--units world needs -t"),
    ],
)
def test_values_without_a_meaning_are_usage_errors(arguments, words, tmp_path):
    run = beltrami("smooth", NOISY, tmp_path / "out.ply", *arguments)
    assert run.returncode == 2, run.stderr
    assert words in run.stderr.decode()
    assert "Traceback" not in run.stderr.decode()
    assert list(tmp_path.iterdir()) == []


def test_units_of_the_file_are_taken_with_a_time_step_in_them(tmp_path):
    run = beltrami("smooth", NOISY, tmp_path / "out.ply", "--units", "world", "-t", "0.001")
    assert run.returncode == 0, run.stderr


@pytest.mark.parametrize(
    ("flags", "traceback"),
    [([], False), (["-v"], False), (["-vv"], True), (["-v", "-v"], True), (["--verbose", "--verbose"], True)],
)
def test_what_nobody_foresaw_ends_in_one_line_and_the_traceback_on_demand(flags, traceback, tmp_path):
    arguments = [*COMMAND, "smooth", str(SAMPLES / "mirrored-noisy.obj"), str(tmp_path / "out.obj"), *flags]
    run = subprocess.run(
        arguments, env={**os.environ, "BELTRAMI_SIMD": "foo"}, capture_output=True, check=False
    )
    assert run.returncode == 1
    *before, last = run.stderr.decode().splitlines()
    assert last.startswith("beltrami: unexpected error: ")
    assert last.endswith("run again with -vv and report it")
    assert ("Traceback" in "\n".join(before)) == traceback


def test_no_iterations_say_that_the_file_was_copied(tmp_path):
    copied = beltrami("smooth", NOISY, tmp_path / "out.ply", "-n", "0")
    assert b"copied unchanged" in copied.stderr
    converted = beltrami("smooth", NOISY, tmp_path / "out.obj", "-n", "0")
    assert converted.returncode == 0
    assert b"copied" not in converted.stderr
    assert b"colours are unchanged" in converted.stderr
