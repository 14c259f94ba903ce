"""The option --columns, for every command that reads points; and which texts a batch takes for points."""

import numpy as np
import pytest

from cli.commands import beltrami

SIDE = 12
NAMES = "x,y,z,r,g,b,scalar"


@pytest.fixture
def scan(tmp_path):
    """Points whose colours and intensities are both integers of 0 to 255."""
    rng = np.random.default_rng(0)
    row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
    shades = np.rint(rng.normal((200, 120, 60), 14, (SIDE * SIDE, 3)))
    numbers = np.column_stack([np.clip(shades, 0, 255), rng.integers(0, 256, SIDE * SIDE)])
    table = np.column_stack([row, column, 0 * row, numbers])
    path = tmp_path / "scan.txt"
    np.savetxt(path, table, "%d", ",")
    return path


COMMANDS = {
    "smooth": ["smooth", "scan.txt", "out.txt", "--fast"], "info": ["info", "scan.txt", "--fast"],
    "noise": ["noise", "scan.txt", "out.txt", "--sigma", "5%"], "check": ["check", "scan.txt", "scan.txt"],
    "compare": ["compare", "scan.txt", "scan.txt"], "kernel": ["kernel", "scan.txt", "out.csv", "--at", "5", "--fast"],
    "render": ["render", "scan.txt", "out.png", "--size", "64x64"],
    "report": ["report", "scan.txt", "scan.txt", "out.html"],
    "batch": ["batch", "scan.txt", "--out-dir", "out", "--fast", "-j", "1"],
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_that_reads_points_takes_their_columns(command, scan, monkeypatch):
    monkeypatch.chdir(scan.parent)
    arguments = COMMANDS[command]
    run = beltrami(*arguments, code=None)
    assert run.returncode != 0
    assert b"columns 4 to 6 or 5 to 7; give --columns" in run.stderr + run.stdout
    if command == "batch":
        arguments = [*arguments, "--overwrite"]
    beltrami(*arguments, "--columns", NAMES)


def test_columns_of_guides_are_their_own(scan):
    folder = scan.parent
    rows = np.loadtxt(scan, delimiter=",")
    np.savetxt(folder / "guide.xyz", rows[:, :6], "%d")
    guided = ("--guide", "guide.xyz", "--columns", NAMES, "--fast")
    beltrami("smooth", "scan.txt", "out.txt", *guided, cwd=folder)


def test_texts_and_tables_in_a_folder_are_no_points_unless_they_are_named(scan):
    folder = scan.parent
    (folder / "readme.txt").write_text("To whom it may concern\n")
    rows = np.loadtxt(scan, delimiter=",")
    np.savetxt(folder / "a.asc", rows[:, :6], "%d")
    np.savetxt(folder / "b.csv", rows[:, :6], "%d", ",", header="x,y,z,r,g,b", comments="")
    for inputs, outputs in ((".", ["a.asc"]), ("*.csv", ["b.csv"])):
        run = beltrami("batch", inputs, "--out-dir", "out", "--dry-run", cwd=folder, text=True)
        assert [line.rpartition("/")[2] for line in run.stdout.splitlines()] == outputs
    said = beltrami("batch", "b.csv", "--out-dir", "out", code=3, cwd=folder, text=True).stderr
    assert "no column called input; points in .csv are named by a glob in quotes, or in a manifest" in said
