"""The survey counts what it says, and sees what it is there to see."""

from __future__ import annotations

import os
import signal
import sys

import pytest

from hostile import survey
from small_models import COLOURED, ply

PLY = ply(COLOURED, [[0, 0, 0, 0, 0, 0], [1, 0, 0, 9, 9, 9], [0, 1, 0, 90, 90, 90]], [(0, 1, 2)])


@pytest.fixture
def folder(tmp_path):
    """Models of every outcome but failure."""
    made = tmp_path / "models"
    made.mkdir()
    (made / "a.ply").write_bytes(PLY)
    (made / "b.ply").write_bytes(PLY[:-8])
    (made / "c.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (made / "d.obj").write_text("mtllib d.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n")
    (made / "d.mtl").write_text("newmtl m\nmap_Kd gone.png\n")
    (made / "e.off").write_text("COFF\n3 1 0\n0 0 0 .1 .2 .3\n1 0 0 .1 .9 .3\n0 1 0 .1 .2 .5\n3 0 1 2\n")
    return made


def survey_of(folder, monkeypatch, *options):
    """Run the survey as from the command line."""
    monkeypatch.setattr(sys, "argv", ["survey", f"x={folder}", *options])
    return survey.main()


def test_every_outcome_has_its_column(folder, monkeypatch, capsys):
    assert survey_of(folder, monkeypatch, "--mutations", "2") == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| x")]
    assert "| x, .ply | 2 | 1 | 0 | 0 | 0 | 1 | 0 |" in rows
    assert "| x, .obj | 2 | 0 | 0 | 1 | 1 | 0 | 0 |" in rows
    assert "| x, .off | 1 | 0 | 1 | 0 | 0 | 0 | 0 |" in rows
    assert any(row.startswith("| x, mutations | 2 |") for row in rows)


def crash(*_, **__):
    """End the process as a crash of native code does."""
    os.kill(os.getpid(), signal.SIGKILL)


def move_a_vertex(source, target, *_, **__):
    """Write something else than colours."""
    target.write_bytes(source.read_bytes().replace(b"1 0 0 9", b"2 0 0 9"))


@pytest.mark.slow
@pytest.mark.parametrize("harm", [crash, move_a_vertex])
def test_harm_is_seen(harm, folder, monkeypatch, capsys):
    for path in folder.iterdir():
        if path.name != "a.ply":
            path.unlink()
    monkeypatch.setattr(survey, "smooth_file", harm)
    monkeypatch.setattr(survey, "PATIENCE", 1)
    assert survey_of(folder, monkeypatch) == 1
    assert "FAILED" in capsys.readouterr().err
