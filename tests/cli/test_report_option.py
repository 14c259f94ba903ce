"""`--report FILE` is written like an output: whole or not at all, and over nothing that is precious."""

from __future__ import annotations

import json

import pytest

from cli.commands import SAMPLES, beltrami

NOISY = SAMPLES / "terrain-noisy.ply"


def test_an_existing_file_is_replaced_only_when_overwriting_is_asked_for(tmp_path):
    report = tmp_path / "report.json"
    report.write_text("precious")
    refused = beltrami("smooth", NOISY, tmp_path / "out.ply", "--report", report)
    assert refused.returncode == 4
    assert b"--overwrite" in refused.stderr
    assert report.read_text() == "precious"
    assert not (tmp_path / "out.ply").exists()
    assert (
        beltrami(
            "smooth", NOISY, tmp_path / "out.ply", "--fast", "--report", report, "--overwrite"
        ).returncode
        == 0
    )
    assert json.loads(report.read_text())["format"] == "ply"


@pytest.mark.parametrize("name", [".", "nowhere/report.json", "-", "out.ply", str(NOISY)])
def test_a_report_that_cannot_be_written_is_refused_before_anything_is_computed(name, tmp_path):
    run = beltrami("smooth", NOISY, "out.ply", "--fast", "--report", name, "--overwrite", cwd=tmp_path)
    assert run.returncode == 4, run.stderr
    assert run.stderr.count(b"\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_the_job_wrote_is_not_replaced_by_its_report(tmp_path):
    source = SAMPLES / "mirrored-noisy.obj"
    arguments = ("smooth", source, tmp_path / "out.obj", "-n", "1", "--overwrite")
    assert beltrami(*arguments).returncode == 0
    picture = next(tmp_path.glob("*.png"))
    refused = beltrami(*arguments, "--report", picture)
    assert refused.returncode == 4
    assert picture.read_bytes()[:4] == b"\x89PNG"
